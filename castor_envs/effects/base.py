"""What every effect is, and how it finds the castor, wheel or encoder that it changes."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, Union

import numpy as np
from pydantic import Field, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.steps import Motion, Slip
from castor_envs.vehicles.description import explain

if TYPE_CHECKING:
    from castor_envs.vehicles.robot import Castor, RobotDescription

Number = Annotated[int, Field(ge=1)]
Reader = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Called with all samples of a run in order of time, one, some or all at once, which makes no difference: (times (k,),
true wheel angles (k, w), true castor angles (k, n)) -> as encoders see them.

Angles are in rad, not rounded and not wrapped; t is in s. The arrays given are left alone.
"""

Rolling = Callable[[Array], Array]
"""Called with castor angles (k, n), rad: by what part of themselves, as built, wheels' radii (k, w) are larger."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """One thing that a real robot does and its description leaves out. Each subclass is one such thing.

    name: in files. value: the amplitude, in `unit`; at 0 the effect does nothing. title: what people read. step: a
    small typical amplitude, to take derivatives with. check: what to look at on the robot. same_as: the names, this
    one's own among them, that no log tells apart, the one to report first; empty where the effect stands alone.
    """

    name: str
    value: float
    title: ClassVar[str]
    unit: ClassVar[str]
    step: ClassVar[float]
    check: ClassVar[str]
    same_as: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def variants(cls, robot: "RobotDescription") -> tuple[Self, ...]:
        """Return one instance of size `step` for everything on the robot that may have this effect.

        None for effects at a place or at times that the robot's file cannot tell: those have to be found first.
        """
        raise NotImplementedError

    def apply(self, robot: "RobotDescription") -> "RobotDescription":
        """Return the robot with its dimensions as they really are; unchanged by effects on sensors.

        Raises InputError where the robot does not have what the effect changes.
        """
        self.reader(robot)  # refuses what is not there
        return robot

    def reader(self, robot: "RobotDescription") -> Reader | None:
        """Return what this effect makes of angles on their way to the encoders, new for each run; None: nothing."""
        return None

    def rolling(self, robot: "RobotDescription") -> Rolling | None:
        """Return how wheels' radii change as castors turn, given the robot before this effect; None: they do not."""
        return None

    def reference_time(self, t: Array) -> Array:
        """Return when (s, on the log's clock) the reference pose in the row of time `t` was really taken."""
        return t

    def reference_pose(self, pose: Array) -> Array:
        """Return the poses (K, 3) that the reference shows of a body that truly stands at `pose` (K, 3)."""
        return pose

    def floor(self, robot: "RobotDescription", floor: Floor) -> Floor:
        """Return the floor as it really is under this robot, given how it is described."""
        return floor

    def yielding(self) -> float:
        """Return how fast (m/s) each contact slips for every N on it, beside its creep in rolling."""
        return 0.0

    def slip(self, robot: "RobotDescription", motion: Motion) -> Slip | None:
        """Return by how much contacts slip more by this effect in a motion than the robot as given; None: nothing.

        Effects on dimensions need none: they change what rolling without slip is.
        """
        return None

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let files hold any of the subclasses, told apart by their names."""
        if cls is not Effect:
            return handler(source)
        return handler.generate_schema(Annotated[Union[tuple(cls.__subclasses__())], Field(discriminator="name")])  # noqa: UP007


def castor_of(robot: "RobotDescription", number: int, effect: str) -> "Castor":
    """Return castor `number` (from 1); raises InputError where the robot has no such castor."""
    if number > len(robot.castors):
        raise InputError(f"effect {effect}: robot {robot.name!r} has no castor {number}")
    return robot.castors[number - 1]


def with_castor(robot: "RobotDescription", number: int, effect: str, **changes: object) -> "RobotDescription":
    """Return the robot with some fields of castor `number` (from 1) replaced; raises InputError if that cannot be."""
    castors = list(robot.castors)
    try:
        castors[number - 1] = dataclasses.replace(castor_of(robot, number, effect), **changes)
    except ValidationError as error:
        raise InputError(f"effect {effect} is too large for castor {number}: {explain(error)}") from None
    return dataclasses.replace(robot, castors=tuple(castors))


def with_wheels(
    robot: "RobotDescription", castor: int, effect: str, wheel: int | None = None, **scales: float
) -> "RobotDescription":
    """Return the robot with some fields of one wheel (from 1) or all wheels (None) of a castor multiplied."""
    wheels = list(castor_of(robot, castor, effect).wheels)
    if wheel is not None and wheel > len(wheels):
        raise InputError(f"effect {effect}: castor {castor} has no wheel {wheel}")
    for k in range(len(wheels)) if wheel is None else [wheel - 1]:
        changes = {name: getattr(wheels[k], name) * scale for name, scale in scales.items()}
        try:
            wheels[k] = dataclasses.replace(wheels[k], **changes)
        except ValidationError as error:
            raise InputError(f"effect {effect} is too large for castor {castor}: {explain(error)}") from None
    return with_castor(robot, castor, effect, wheels=tuple(wheels))


def standing_loads(robot: "RobotDescription", castor_angle: Array | None = None) -> Array:
    """Return the load on each wheel (w,) on a level floor, N; raises InputError where the robot would tip.

    castor_angle (K, n): with castors at such angles, (K, w); None: the mean over all.
    """
    from castor_envs.physics.statics import swung_loads, wheel_loads  # physics is built on effects

    gravity = Floor().normal_gravity
    return wheel_loads(robot, gravity) if castor_angle is None else swung_loads(robot, gravity, castor_angle)


def wheel_channel(robot: "RobotDescription", castor: int, wheel: int, effect: str) -> int:
    """Return the channel of a wheel's encoder; raises InputError where there is none.

    Channels: all wheels, then all castors, in the robot file's order.
    """
    wheels = castor_of(robot, castor, effect).wheels
    if wheel > len(wheels):
        raise InputError(f"effect {effect}: castor {castor} has no wheel {wheel}")
    if not wheels[wheel - 1].driven:
        raise InputError(f"effect {effect}: wheel {wheel} of castor {castor} has no encoder")
    return robot.wheel_castors.index(castor - 1) + wheel - 1


def pivot_channel(robot: "RobotDescription", castor: int, effect: str) -> int:
    """Return the channel of a castor's pivot encoder; raises InputError where there is none."""
    if castor_of(robot, castor, effect).pivot_counts_per_rev is None:
        raise InputError(f"effect {effect}: castor {castor} has no pivot encoder")
    return len(robot.wheels) + castor - 1


def channel(robot: "RobotDescription", castor: int, wheel: int | None, effect: str) -> int:
    """Return the channel of a wheel's encoder, or of the castor's pivot encoder where wheel is None."""
    if wheel is None:
        return pivot_channel(robot, castor, effect)
    return wheel_channel(robot, castor, wheel, effect)


def wheel_encoders(robot: "RobotDescription") -> list[tuple[int, int]]:
    """Return (castor, wheel), both from 1, of every wheel with an encoder."""
    return [
        (i, j)
        for i, castor in enumerate(robot.castors, start=1)
        for j, wheel in enumerate(castor.wheels, start=1)
        if wheel.driven
    ]


def pivot_encoders(robot: "RobotDescription") -> list[int]:
    """Return the castors (from 1) with a pivot encoder."""
    return [i + 1 for i in robot.pivot_encoders]


def all_channels(robot: "RobotDescription") -> list[int]:
    """Return the channels of all encoders of the robot."""
    return [*robot.driven_wheels, *(len(robot.wheels) + i for i in robot.pivot_encoders)]


def through(robot: "RobotDescription", channels: Sequence[int], read: Callable[[Array, Array], Array]) -> Reader:
    """Return a reader that passes angles (k, c) of some channels through `read(t, angles)` and leaves the others."""
    w, own = len(robot.wheels), np.array(channels, dtype=np.intp)

    def reader(t: Array, wheel: Array, castor: Array) -> tuple[Array, Array]:
        angles = np.concatenate([wheel, castor], axis=1)
        angles[:, own] = read(t, angles[:, own])
        return angles[:, :w], angles[:, w:]

    return reader


def in_turn(read: Callable[[float, Array], Array]) -> Callable[[Array, Array], Array]:
    """Return what passes samples through `read(t, angles (c,))` one after another."""
    return lambda t, angle: np.stack([read(*one) for one in zip(t.tolist(), angle, strict=True)])
