"""A train: differential axle modules joined by compliant frames (CFMMR), front first. One description for all.

Module i's body frame has its origin at the middle of the axle, x forward. A frame is an elastic beam clamped to the
middle of two neighbouring axles; straight, it puts the front axle at (length, 0, 0) in the rear axle's frame. Frames
are lettered from the front: A lies between axles 1 and 2. SI units and radians throughout.

Source: Vogt and Minor, "Localization for Multi-Axle Train Configured CFMMRs".
"""

import dataclasses
import os
import string
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass

from castor_envs import description
from castor_envs.description import CONFIG, Coordinate, DurationOrNone
from castor_envs.vehicles.effect import Effect, EffectOf, apply_effects
from castor_envs.vehicles.robot import RobotDescription

FORMAT = "castor-train/1"
MOST_AXLES = 10

#: Gain factor of a gauge: beyond a hundred times more or less it would be another gauge.
Gain = Annotated[float, Field(ge=-100, le=100)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Frame:
    """A compliant frame and the strain gauges of its relative posture sensor.

    length: m. bending_stiffness: E I, N m2. linear_density: kg/m. damping: moment a rate of curvature (Kelvin-Voigt), N
    m2 s. links: rigid links that stand for the beam in physics. gauges: where curvature is measured, m from the rear
    axle, increasing; None puts four, after 1/8, 3/8, 5/8 and 7/8 of the length. gauge_noise: white noise of every
    reading, 1/m, one standard deviation. gauge_offset: standard deviation of each gauge's constant offset, drawn anew
    for every episode, 1/m. gauge_gains: the factor of every gauge (empty: all 1); set by effects. gauge_drift: growth
    of all readings, 1/m a second; set by effects. dead_gauges: numbers (from 1) of gauges that read 0; set by effects.
    foreshortening_left_out: share of the bent frame's shortening that the computed x lacks; set by effects. rps_stops:
    time after which the sensor repeats its last reading, s; set by effects. rps_length: length of the frame by which
    the sensor computes postures, m; None: the true one; set by effects.

    What effects set is left at its default in descriptions.
    """

    length: Annotated[float, Field(ge=1e-3, le=1e3)]
    bending_stiffness: Annotated[float, Field(ge=1e-6, le=1e6)] = 0.5
    linear_density: Annotated[float, Field(ge=1e-6, le=1e4)] = 0.5
    damping: Annotated[float, Field(ge=0, le=1e3)] = 0.001
    links: Annotated[int, Field(ge=3, le=24)] = 6
    gauges: Annotated[tuple[Coordinate, ...], Field(min_length=1)] | None = None
    gauge_noise: Annotated[float, Field(ge=0, le=20)] = 0.1  # twice what effects add
    gauge_offset: Annotated[float, Field(ge=0, le=10)] = 0.4
    gauge_gains: tuple[Gain, ...] = ()
    gauge_drift: Annotated[float, Field(ge=-10, le=10)] = 0.0
    dead_gauges: tuple[Annotated[int, Field(ge=1)], ...] = ()
    foreshortening_left_out: Annotated[float, Field(ge=0, le=1)] = 0.0
    rps_stops: DurationOrNone | None = None
    # Files of trains whose sensors know the length, and so their hashes, are as they were before one could not.
    rps_length: Annotated[float | None, Field(ge=1e-3, le=1e3, exclude_if=lambda value: value is None)] = None

    @property
    def gauge_positions(self) -> tuple[float, ...]:
        """Where the gauges are, m from the rear axle."""
        if self.gauges is not None:
            return self.gauges
        return tuple(self.length * (k + 0.5) / 4 for k in range(4))

    @property
    def computed_length(self) -> float:
        """The length by which the sensor computes postures, m."""
        return self.length if self.rps_length is None else self.rps_length

    @model_validator(mode="after")
    def _possible(self) -> Self:
        places = self.gauge_positions
        if list(places) != sorted(set(places)) or places[0] < 0 or places[-1] > self.length:
            raise ValueError(f"gauges must increase and lie on the frame, between 0 and its length {self.length} m")
        if self.gauge_gains and len(self.gauge_gains) != len(places):
            raise ValueError(f"gauge_gains needs a number for each of the {len(places)} gauges, or none at all")
        if any(number > len(places) for number in self.dead_gauges):
            raise ValueError(f"dead_gauges names a gauge that is not there; the frame has {len(places)}")
        return self


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class TrainDescription:
    """A train of N = 2 to 10 axle modules, front first, and its N - 1 frames: frozen and validated.

    name: what people read. modules: robots with a single fixed castor at the origin, heading forward, with two driven
    standard wheels; each may have effects. frames: from the front, one fewer than modules. effects: what the real train
    does beyond this description; `as_built` folds all in.
    """

    name: Annotated[str, Field(min_length=1)]
    modules: tuple[RobotDescription, ...]
    frames: tuple[Frame, ...]
    effects: tuple[Annotated[Effect, EffectOf("train")], ...] = ()
    scope: ClassVar[Literal["train"]] = "train"

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if not 2 <= len(self.modules) <= MOST_AXLES:
            raise ValueError(f"a train has 2 to {MOST_AXLES} modules, one for each axle; got {len(self.modules)}")
        if len(self.frames) != len(self.modules) - 1:
            raise ValueError(
                f"a train of {len(self.modules)} modules has {len(self.modules) - 1} frames, got {len(self.frames)}"
            )
        for number, module in enumerate(self.modules, start=1):
            if (problem := _not_an_axle(module)) is not None:
                raise ValueError(f"module {number} ({module.name!r}) {problem}")
            if module.sample_period != self.sample_period:
                raise ValueError(f"module {number}: all modules of a train need the same sample_period")
        return self

    @property
    def n_axles(self) -> int:
        """How many axles the train has."""
        return len(self.modules)

    @property
    def sample_period(self) -> float:
        """Period of control and sensors, s."""
        return self.modules[0].sample_period

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Letters of the frames, from the front."""
        return tuple(string.ascii_uppercase[: len(self.frames)])

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """Log names of all wheels: ``1l``, ``1r``, ``2l`` and so on, axle by axle."""
        return tuple(f"{i}{side}" for i in range(1, self.n_axles + 1) for side in "lr")

    def with_effects(self, *effects: Effect) -> "TrainDescription":
        """Return this train with `effects` added to those it has."""
        return dataclasses.replace(self, effects=(*self.effects, *effects))

    def as_built(self) -> "TrainDescription":
        """Return the train as it really is: every effect, its modules' too, applied to what it disturbs."""
        modules = tuple(module.as_built() for module in self.modules)
        return apply_effects(dataclasses.replace(self, modules=modules, effects=()), self.effects)

    def as_described(self) -> "TrainDescription":
        """Return the train as its user believes it to be, without effects: what drivers and estimators get."""
        modules = tuple(module.as_described() for module in self.modules)
        return dataclasses.replace(self, modules=modules, effects=())

    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain data, ``format`` first."""
        return description.to_data(_ADAPTER, self, FORMAT)

    def hash(self) -> str:
        """Return a hash of all parameters (the train's name does not count), by which a train is recognised."""
        return description.fingerprint(self.to_dict())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the description as JSON; the file is complete or not there."""
        description.save(path, self.to_dict())

    @classmethod
    def from_dict(cls, data: Any, source: str = "train") -> "TrainDescription":
        """Read a description from plain data; raises InputError that names `source` and the offending keys."""
        return description.with_possible_effects(description.from_data(_ADAPTER, data, FORMAT, source), source)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "TrainDescription":
        """Read a description from a JSON file; raises InputError that names file and key."""
        return description.with_possible_effects(description.load(_ADAPTER, path, FORMAT), str(path))


def _not_an_axle(module: RobotDescription) -> str | None:
    """Return what keeps a robot from being an axle module of a train, or None."""
    if len(module.castors) != 1:
        return f"has {len(module.castors)} castors; an axle module has one"
    castor = module.castors[0]
    if castor.steering != "fixed" or castor.angle != 0.0 or castor.offset != 0.0 or castor.pivot != (0.0, 0.0):
        return "needs its castor fixed at the origin: steering 'fixed', pivot [0, 0], angle 0, offset 0"
    if len(castor.wheels) != 2 or not all(wheel.driven and wheel.grip == "standard" for wheel in castor.wheels):
        return "needs two driven wheels with grip 'standard'"
    for name in ("gyro", "fixes"):
        if getattr(module, name) is not None:
            return f"has {name!r}, which trains do not read; leave it out"
    return None


_ADAPTER = TypeAdapter(TrainDescription)
