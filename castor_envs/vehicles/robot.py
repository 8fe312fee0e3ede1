"""One robot description: it serves physics, estimators, calibration and diagnosis.

Frames: body B has x forward and y left. Castor i pivots at `pivot` in B; its angle theta is measured from
the body's x axis to the castor's rolling direction, and its axle trails the pivot by `offset`. SI units and
radians throughout.
"""

import dataclasses
import itertools
import os
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PlainSerializer, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass

from castor_envs import description
from castor_envs.description import (
    CONFIG,
    FINEST,
    Angle,
    Coordinate,
    Counts,
    Duration,
    DurationOrNone,
    Friction,
    Inertia,
    Length,
    LengthOrNone,
    Mass,
    RateLimit,
    Stiffness,
    Torque,
    Vector,
)
from castor_envs.vehicles.effect import Effect, EffectOf, apply_effects
from castor_envs.vehicles.tolerances import Tolerances

FORMAT = "castor-robot/1"


def _whole_if_possible(count: float) -> int | float:
    return int(count) if count == int(count) else count


#: Counts a turn of a pivot encoder, of any size: with a gear they need not be whole. Whole numbers are written
#: as such, so that files and hashes of robots are the same however a number was given.
PivotCounts = Annotated[float, Field(ge=1e-3, le=2**32), PlainSerializer(_whole_if_possible)]
#: rad: rollers whose axes lie within 4 degrees of the wheel's own axle would leave it unable to push.
STEEPEST_ROLLER = 1.5


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Wheel:
    """One wheel of a castor.

    lateral: distance to the left of the castor's centre line, m. radius: m. inertia: about the axle, kg m2.
    counts_per_rev: encoder counts a turn of the wheel; None is an idle wheel without motor or encoder.
    grip: "standard", or "omni", which lets the wheel slip freely along its rollers. roller_angle: of an omni wheel's
    roller axes from the rolling direction, rad (0 of ordinary omni wheels, pi/4 of Mecanum wheels).
    """

    radius: Length
    lateral: Coordinate = 0.0
    inertia: Inertia = 1e-4
    counts_per_rev: Counts | None = 1200.0
    grip: Literal["standard", "omni"] = "standard"
    roller_angle: Annotated[float, Field(ge=-STEEPEST_ROLLER, le=STEEPEST_ROLLER)] = 0.0

    @property
    def driven(self) -> bool:
        """Whether the wheel has a motor and an encoder."""
        return self.counts_per_rev is not None

    @model_validator(mode="after")
    def _rollers_only_on_omni_wheels(self) -> Self:
        if self.grip == "standard" and self.roller_angle != 0.0:
            raise ValueError("roller_angle is for wheels with grip 'omni'; this one has grip 'standard'")
        return self


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Castor:
    """A castor: a fork on a vertical pivot, carrying wheels on one axle.

    pivot: position in B, m. wheels: on one axle, from left to right. steering: "free", "driven" (a motor turns it) or
    "fixed". angle: of a fixed castor, from x to its rolling direction, rad. offset: how far the axle trails the pivot,
    m. mass: of fork and wheels, kg; its centre is taken to lie on the axle behind the pivot. inertia: about this
    centre, kg m2. pivot_counts_per_rev: of the absolute pivot encoder, not necessarily a whole number, None where there
    is none; a castor that turns needs one to be driven in an environment. pivot_zero: the model's beta in measured
    angle = theta + beta (Doebbler eq. 2), rad.
    """

    pivot: Vector
    wheels: Annotated[tuple[Wheel, ...], Field(min_length=1)]
    steering: Literal["free", "driven", "fixed"] = "free"
    angle: Angle = 0.0
    offset: LengthOrNone = 0.0
    mass: Mass = 1.0
    inertia: Inertia = 0.005
    pivot_counts_per_rev: PivotCounts | None = None
    pivot_zero: Angle = 0.0

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.steering == "free" and self.offset == 0.0:
            raise ValueError("a castor with free steering needs an offset above 0, or nothing turns it")
        if self.steering == "fixed" and self.pivot_counts_per_rev is not None:
            raise ValueError("a fixed castor has no pivot encoder: leave pivot_counts_per_rev out")
        if self.steering != "fixed" and self.angle != 0.0:
            raise ValueError("angle is for castors with steering 'fixed'")
        if len({wheel.lateral for wheel in self.wheels}) < len(self.wheels):
            raise ValueError("two wheels of one castor have the same lateral position")
        if list(self.wheels) != sorted(self.wheels, key=lambda wheel: -wheel.lateral):
            raise ValueError("wheels go from left (largest lateral) to right")
        if any(left.lateral - right.lateral < FINEST for left, right in itertools.pairwise(self.wheels)):
            raise ValueError(f"two wheels of one castor stand less than {FINEST:g} m apart")
        return self


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Contact:
    """How wheels and floor touch: a brush tyre with relaxation length.

    friction: Coulomb coefficient where the floor does not say otherwise. slip_stiffness_long, slip_stiffness_lat: force
    a unit of slip, along and across the rolling direction, divided by the wheel's load. relaxation_length: rolled
    distance in which the force builds up, m. damping: of the bristles, as a time (damping coefficient / bristle
    stiffness), s.
    """

    friction: Friction = 0.8
    slip_stiffness_long: Stiffness = 80.0
    slip_stiffness_lat: Stiffness = 80.0
    relaxation_length: Length = 0.01
    damping: DurationOrNone = 1e-3


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Gyro:
    """A yaw-rate gyro.

    noise: white, one standard deviation a sample, rad/s. bias: constant, rad/s. bias_tolerance: standard deviation of
    the true bias about it, as a data sheet states it, rad/s; None where nobody says. bias_walk: by how much the bias
    wanders, one standard deviation after 1 s, rad/s; after t seconds it is sqrt(t) times that. scale_tolerance:
    standard deviation of how much too far the gyro says that the body turns, as a part; 0: it is exact.

    The bounds of noise and bias are far above those of any gyro; a reading stays within the 100 rad/s of observation
    spaces.
    """

    noise: Annotated[float, Field(ge=0, le=5)] = 0.0
    bias: Annotated[float, Field(ge=-10, le=10)] = 0.0
    # Files that say nothing of these, and so their hashes, are as they were before they could.
    bias_tolerance: Annotated[float | None, Field(ge=0, le=10, exclude_if=lambda value: value is None)] = None
    bias_walk: Annotated[float, Field(ge=0, le=1, exclude_if=lambda value: value == 0)] = 0.0
    scale_tolerance: Annotated[float, Field(ge=0, le=0.3, exclude_if=lambda value: value == 0)] = 0.0


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Fixes:
    """External fixes of the pose, as of a lidar against a map, of markers, beacons or satellites.

    noise_position: standard deviation of x and of y, m. noise_heading: of psi, rad. When fixes come, how late, and
    which are wrong, no description tells.
    """

    noise_position: Annotated[float, Field(gt=0, le=100)]
    noise_heading: Annotated[float, Field(gt=0, le=4)] = 4.0


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class RobotDescription:
    """A robot on castors: frozen, validated, and the same to physics, estimators, calibration and diagnosis.

    name: what people read. castors: in the order of their numbers, from 1. sample_period: of control and encoders, s.
    mass: of the chassis without its castors, kg. inertia: of the same about its centre of mass, kg m2. center_of_mass:
    of the same in B, m. max_wheel_speed: of each driven wheel, rad/s. max_wheel_torque: of the same, N m.
    max_steering_speed: of each driven castor, rad/s. max_steering_torque: of the same, N m. contact: how wheels and
    floor touch. gyro: None where there is none. tolerances: how exact these dimensions are, None where nobody says.
    fixes: how exact external fixes of the pose are, None where there are none. effects: what the real robot does beyond
    this description; `as_built` folds them in.
    """

    name: Annotated[str, Field(min_length=1)]
    castors: Annotated[tuple[Castor, ...], Field(min_length=1)]
    sample_period: Duration = 0.05
    mass: Mass = 10.0
    inertia: Inertia = 0.5
    center_of_mass: Vector = (0.0, 0.0)
    max_wheel_speed: RateLimit = 20.0
    max_wheel_torque: Torque = 1.0
    max_steering_speed: RateLimit = 10.0
    max_steering_torque: Torque = 5.0
    contact: Contact = Contact()
    gyro: Gyro | None = None
    # Files of robots without tolerances or fixes, and so their hashes, are as they were before there were any.
    tolerances: Annotated[Tolerances | None, Field(exclude_if=lambda value: value is None)] = None
    fixes: Annotated[Fixes | None, Field(exclude_if=lambda value: value is None)] = None
    effects: tuple[Annotated[Effect, EffectOf("robot")], ...] = ()
    scope: ClassVar[Literal["robot"]] = "robot"

    @property
    def wheels(self) -> tuple[Wheel, ...]:
        """All wheels, castor by castor in file order."""
        return tuple(wheel for castor in self.castors for wheel in castor.wheels)

    @property
    def wheel_castors(self) -> tuple[int, ...]:
        """For each wheel, the index (from 0) of its castor."""
        return tuple(i for i, castor in enumerate(self.castors) for _ in castor.wheels)

    @property
    def wheel_places(self) -> tuple[tuple[int, int], ...]:
        """For each wheel its castor's number and its number on it, both from 1, as effects have them."""
        return tuple((i, k) for i, castor in enumerate(self.castors, 1) for k in range(1, len(castor.wheels) + 1))

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """Log names of all wheels: ``1l``, ``1r`` on castors with two wheels, ``1`` on castors with one."""
        names = []
        for i, castor in enumerate(self.castors, start=1):
            match len(castor.wheels):
                case 1:
                    names.append(f"{i}")
                case 2:
                    names += [f"{i}l", f"{i}r"]
                case n:
                    names += [f"{i}_{k}" for k in range(1, n + 1)]
        return tuple(names)

    @property
    def driven_wheels(self) -> tuple[int, ...]:
        """Indices (from 0) of the wheels with motor and encoder."""
        return tuple(k for k, wheel in enumerate(self.wheels) if wheel.driven)

    @property
    def driven_castors(self) -> tuple[int, ...]:
        """Indices (from 0) of the castors with a steering motor."""
        return tuple(i for i, castor in enumerate(self.castors) if castor.steering == "driven")

    @property
    def pivot_encoders(self) -> tuple[int, ...]:
        """Indices (from 0) of the castors with a pivot encoder."""
        return tuple(i for i, castor in enumerate(self.castors) if castor.pivot_counts_per_rev is not None)

    def with_effects(self, *effects: Effect) -> "RobotDescription":
        """Return this robot with `effects` added to those it has."""
        return dataclasses.replace(self, effects=(*self.effects, *effects))

    def as_built(self) -> "RobotDescription":
        """Return the robot as it really is: every effect applied to the parameter it disturbs, none left over."""
        return apply_effects(self.as_described(), self.effects)

    def as_described(self) -> "RobotDescription":
        """Return the robot as its user believes it to be: without effects. Controllers and estimators get this one."""
        return dataclasses.replace(self, effects=())

    def drawn(self, random: np.random.Generator) -> "RobotDescription":
        """Return a robot as it may truly be, made within the tolerances of this one; without any, this one.

        Errors are normal, cut at three standard deviations, and drawn castor by castor: pivot x and y, zero or angle,
        offset, then radius and lateral of each wheel; wheels again where they would stand on or beyond each other.
        """
        if self.tolerances is None:
            return self
        within = self.tolerances

        def off() -> float:
            return float(np.clip(random.standard_normal(), -3.0, 3.0))

        def wheel(w: Wheel) -> Wheel:
            radius = w.radius * (1 + within.radius * off())
            return dataclasses.replace(w, radius=radius, lateral=w.lateral * (1 + within.lateral * off()))

        def castor(c: Castor) -> Castor:
            pivot = (c.pivot[0] + within.pivot * off(), c.pivot[1] + within.pivot * off())
            turned = within.pivot_zero * off()
            turn = {"angle": c.angle + turned} if c.steering == "fixed" else {"pivot_zero": c.pivot_zero + turned}
            offset = c.offset * (1 + within.offset * off())
            wheels = tuple(wheel(w) for w in c.wheels)
            while any(left.lateral - right.lateral < FINEST for left, right in itertools.pairwise(wheels)):
                wheels = tuple(wheel(w) for w in c.wheels)
            return dataclasses.replace(c, pivot=pivot, offset=offset, wheels=wheels, **turn)

        return dataclasses.replace(self, castors=tuple(castor(c) for c in self.castors))

    def to_dict(self) -> dict[str, Any]:
        """Return the description as plain data, ``format`` first."""
        return description.to_data(_ADAPTER, self, FORMAT)

    def hash(self) -> str:
        """Return a hash of all parameters (the name does not count), by which a robot is recognised."""
        return description.fingerprint(self.to_dict())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the description as JSON; the file is complete or not there."""
        description.save(path, self.to_dict())

    @classmethod
    def from_dict(cls, data: Any, source: str = "robot") -> "RobotDescription":
        """Read a description from plain data; raises InputError that names `source` and the offending keys."""
        return description.with_possible_effects(description.from_data(_ADAPTER, data, FORMAT, source), source)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "RobotDescription":
        """Read a description from a JSON file; raises InputError that names file and key."""
        return description.with_possible_effects(description.load(_ADAPTER, path, FORMAT), str(path))


_ADAPTER = TypeAdapter(RobotDescription)
