"""What every effect is, how files hold it, and what physics gives it of contacts.

An effect stands in the file of its robot or train as ``{"name": "pivot_bias", "castor": 2, "value": 0.013}``. Effects
themselves are in `castor_envs.effects`; vehicles come before them, as an effect changes the vehicle that has it.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Generic, Literal, Protocol, Self, TypeVar, Union, get_args

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter, ValidationInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from castor_envs.discovery import modules_of
from castor_envs.errors import InputError, did_you_mean
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion, Slip

EFFECTS = "castor_envs.effects"
"""The package whose modules define effects. It is imported when effects are first asked for by name."""

Scope = Literal["robot", "train"]
Number = Annotated[int, Field(ge=1)]
"""Castors, wheels, frames, gauges and axles are counted from 1."""

ThereOrNot = Annotated[float, Field(ge=1.0, le=1.0)]
"""The value of effects without a size: always 1."""

SensorModel = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Called with all samples of a run in order of time, in batches of any size, with the same result: (times (k,), true
wheel angles (k, w), true castor angles (k, n)) -> both angles as encoders see them.

Angles are in rad, not rounded and not wrapped; t is in s. The arrays given are left alone.
"""

RadiusChange = Callable[[Array], Array]
"""Called with castor angles (k, n), rad; returns the relative increase (k, w) of wheel radii over those as built."""

V = TypeVar("V")


class Contacts(Protocol[V]):
    """What the contacts of a robot do in a known motion: computed by physics, used by effects.

    `castor_envs.physics.contact_motion.ContactMotion` is one.
    """

    @property
    def robot(self) -> V:
        """The robot that has these contacts, built as described: effects in it are not applied."""
        ...

    @property
    def motion(self) -> Motion:
        """What truly happened, K samples."""
        ...

    def of(self, robot: V) -> "Contacts[V]":
        """Return the contacts of another robot in the same motion."""
        ...

    def paths(self) -> Array:
        """Return how far contacts move in each step (K - 1, 2w), m: all along rolling directions, then to the left."""
        ...

    def places(self) -> Array:
        """Return where in N each wheel touches the floor at every sample (K, w, 2), m."""
        ...

    def creep(self, floor: Floor | None = None, creep_compliance: float = 0.0) -> Slip:
        """Return by how much contacts creep on a floor (None: an even one), of which the slope counts.

        creep_compliance: m/s for each N, at which contacts slip in addition to their creep in rolling.
        """
        ...


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect(Generic[V]):
    """One thing that a real robot or train (`V`) does and its description leaves out. Each subclass is one such thing.

    name: in files. value: the amplitude, in `unit`; at 0 the effect does nothing. scope: what it is an effect of, as
    its `V` says. title: what people read. step: a small typical amplitude, to take derivatives with. tolerance: the
    amplitude's standard deviation among vehicles in good order, and from log to log of one. least: no real vehicle has
    a smaller amplitude, though files may hold one. check: what to look at on the vehicle. indistinguishable_from: the
    names of effects that no log distinguishes, this effect among them, the one to report first; empty where logs
    distinguish it from all others. binary: whether it is there or not: its value is always 1. wiring: whether encoders
    are connected wrongly; applied twice it is undone. timing: whether all encoders together, or the reference, are read
    at other times. discrete: whether it acts by whole counts, so that its size depends on fractions of a count. creep:
    what it changes about the creep of contacts: their compliance, or the forces on them.
    """

    name: str
    value: float
    scope: ClassVar[Scope]
    title: ClassVar[str]
    unit: ClassVar[str]
    step: ClassVar[float]
    tolerance: ClassVar[float]
    least: ClassVar[float] = -math.inf
    check: ClassVar[str]
    indistinguishable_from: ClassVar[tuple[str, ...]] = ()
    binary: ClassVar[bool] = False
    wiring: ClassVar[bool] = False
    timing: ClassVar[bool] = False
    discrete: ClassVar[bool] = False
    creep: ClassVar[Literal["compliance", "forces"] | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for base in cls.__dict__.get("__orig_bases__", ()):  # Effect[RobotDescription], as the class is declared
            (vehicle,) = get_args(base)
            cls.scope = vehicle.scope

    @classmethod
    def variants(cls, vehicle: V, /) -> tuple[Self, ...]:
        """Return one instance of size `step` for everything on the vehicle that may have this effect.

        Empty for effects at a place or at times that the vehicle's file cannot tell: those have to be found in logs
        first.
        """
        raise NotImplementedError

    def where(self) -> tuple[str, ...]:
        """Return in words where on the vehicle or the floor it is, and in which motion; what people read."""
        places = ((name, getattr(self, name, None)) for name in ("castor", "wheel"))
        return tuple(f"{name} {number}" for name, number in places if number is not None)

    def apply(self, vehicle: V, /) -> V:
        """Return the vehicle with its dimensions as they really are; unchanged by effects on encoders.

        Raises InputError where the vehicle does not have what the effect changes.
        """
        self.sensor_model(vehicle)  # refuses what is not there
        return vehicle

    def sensor_model(self, vehicle: V, /) -> SensorModel | None:
        """Return a new sensor model, for one run, of what this effect does to the angles that encoders see, or None."""
        return None

    def radius_change(self, vehicle: V, /) -> RadiusChange | None:
        """Return how radii change as castors turn, given the vehicle before this effect; None: they do not."""
        return None

    def reference_time(self, t: Array) -> Array:
        """Return when (s, on the log's clock) the reference pose in the row of time `t` was really taken."""
        return t

    def reference_pose(self, pose: Array) -> Array:
        """Return the poses (K, 3) that the reference shows of a body that truly stands at `pose` (K, 3)."""
        return pose

    def gyro_gain(self) -> float:
        """Return what the gyro reads of a body that turns at 1 rad/s, but for its bias, rad/s."""
        return 1.0

    def floor(self, vehicle: V, floor: Floor, /) -> Floor:
        """Return the floor as it really is under this vehicle, given how it is described."""
        return floor

    def creep_compliance(self) -> float:
        """Return how fast (m/s) each contact slips for every N on it, in addition to its creep in rolling."""
        return 0.0

    def slip(self, contacts: Contacts[V]) -> Slip | None:
        """Return the slip that this effect adds to that of the contacts given; None: nothing.

        Effects on dimensions need none: they change what rolling without slip is.
        """
        return None


def known_effects(scope: Scope) -> dict[str, type[Effect]]:
    """Return the effects of robots or of trains, by their names: those of `EFFECTS`, and those that others defined.

    First those of `EFFECTS`, in the order of their modules' names, whichever was imported first.
    """
    modules_of(EFFECTS)
    found: dict[str, type[Effect]] = {}
    kinds = (kind for kind in Effect.__subclasses__() if kind.scope == scope)
    for kind in sorted(kinds, key=lambda kind: (not kind.__module__.startswith(f"{EFFECTS}."), kind.__module__)):
        name = kind.__dataclass_fields__["name"].default
        known = found.setdefault(name, kind)
        if _whole_name(known) != _whole_name(kind):
            raise InputError(f"{_whole_name(kind)} has the name {name!r} of {_whole_name(known)}; give it another one")
        found[name] = kind  # defined again, as in a notebook: the last one counts
    return found


def _whole_name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


@dataclasses.dataclass(frozen=True)
class EffectOf:
    """Lets a description hold any effect of its scope: ``effects: tuple[Annotated[Effect, EffectOf("robot")], ...]``.

    Effects in files are looked up by name when one is read: a description comes before the effects that change it.
    """

    scope: Scope

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by `read`."""
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe the effects that are defined now; an effect in a file needs its name."""
        found = handler(_any_of(tuple(known_effects(self.scope).values())).core_schema)
        for kind in found["oneOf"]:
            of_kind = handler.resolve_ref_schema(kind)
            of_kind["required"] = ["name", *of_kind.get("required", ())]
        return {"oneOf": found["oneOf"]}

    def read(self, given: Any, info: ValidationInfo) -> Effect:
        """Return the effect given as such, or as plain data; raises ValueError for what is none of this scope."""
        if isinstance(given, Effect):
            if given.scope != self.scope:
                raise ValueError(f"effect {given.name!r} is one of a {given.scope}, not of a {self.scope}")
            return given
        known = known_effects(self.scope)
        name = given.get("name") if isinstance(given, dict) else None
        if isinstance(name, str) and name not in known:
            raise ValueError(f"unknown effect {name!r}{did_you_mean(name, known)}")
        adapter = _any_of(tuple(known.values()))
        if info.mode == "json":
            return adapter.validate_json(json.dumps(given), strict=True)
        return adapter.validate_python(given)


@functools.cache
def _any_of(kinds: tuple[type[Effect], ...]) -> TypeAdapter[Effect]:
    by_name: Any = Annotated[Union[kinds], Field(discriminator="name")]  # noqa: UP007  # pyright: ignore
    return TypeAdapter(by_name)


def apply_effects(vehicle: V, effects: tuple[Effect[V], ...]) -> V:
    """Return the vehicle as effects build it, applied in order; raises InputError for one that it cannot have."""
    for effect in effects:
        vehicle = effect.apply(vehicle)
    return vehicle
