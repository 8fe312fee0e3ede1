"""Effects: what a real robot does that its description leaves out. Each is one class, with one meaning everywhere.

An effect stands in the robot file as ``{"name": "pivot_bias", "castor": 2, "value": 0.013}``. It changes the robot that
the physics builds (`apply_effects`), or its radii as castors turn (`radii_of`), or what the encoders make of true
angles (`readings`), or when and of which point the reference is taken (`reference`), or the floor (`floor_of`), or how
contacts yield (`yielding_of`). What it makes contacts slip in a motion that is known is predicted by `slip_of`. To add
one, add a class to a module of this package: files, catalogue, table and tests find it there.
"""

import importlib
import pkgutil
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter, ValidationError

from castor_envs.effects.base import Effect, Reader
from castor_envs.effects.clocks import AllLatency, ClockOffset, ClockSkew, EncoderLatency, SampleJitter
from castor_envs.effects.contact import ContactCreep, SlipStiffness, SlipStiffnessLateral
from castor_envs.effects.dimensions import (
    AllWheelRadius,
    CountsPerRev,
    LoadRadius,
    PivotBias,
    PivotOffset,
    PivotPositionX,
    PivotPositionY,
    Track,
    WheelRadius,
)
from castor_envs.effects.encoders import (
    LostRemainders,
    PivotBacklash,
    PivotEccentricity,
    PivotGain,
    TickLoss,
    TickLossBursts,
    WheelEccentricity,
)
from castor_envs.effects.floor import Bump, FloorSlope, FrictionPatch
from castor_envs.effects.reference import ReferenceLeverX, ReferenceLeverY, ReferenceYaw
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.steps import Motion, Slip
from castor_envs.vehicles.description import explain

if TYPE_CHECKING:
    from castor_envs.vehicles.robot import RobotDescription

__all__ = [
    "EFFECTS",
    "AllLatency",
    "AllWheelRadius",
    "Bump",
    "CastorOrder",
    "ClockOffset",
    "ClockSkew",
    "ContactCreep",
    "CountsPerRev",
    "Effect",
    "EncoderLatency",
    "EncoderReversed",
    "EncodersSwapped",
    "FloorSlope",
    "FrictionPatch",
    "LoadRadius",
    "LostRemainders",
    "Motion",
    "PivotBacklash",
    "PivotBias",
    "PivotEccentricity",
    "PivotGain",
    "PivotOffset",
    "PivotPositionX",
    "PivotPositionY",
    "Reader",
    "ReferenceLeverX",
    "ReferenceLeverY",
    "ReferenceYaw",
    "SampleJitter",
    "Slip",
    "SlipStiffness",
    "SlipStiffnessLateral",
    "TickLoss",
    "TickLossBursts",
    "Track",
    "WheelEccentricity",
    "WheelRadius",
    "apply_effects",
    "catalogue",
    "floor_of",
    "radii_of",
    "reader_of",
    "readings",
    "reference",
    "slip_of",
    "table",
    "yielding_of",
]


for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)

EFFECTS: dict[str, type[Effect]] = {kind.__dataclass_fields__["name"].default: kind for kind in Effect.__subclasses__()}
"""Every effect by its name."""


def catalogue(robot: "RobotDescription") -> tuple[Effect, ...]:
    """Return every effect that the robot may have, each in the size of its `step`."""
    return tuple(effect for kind in EFFECTS.values() for effect in kind.variants(robot))


def apply_effects(robot: "RobotDescription", effects: tuple[Effect, ...]) -> "RobotDescription":
    """Return the robot as effects build it, applied in order; raises InputError for one that it cannot have."""
    for effect in effects:
        robot = effect.apply(robot)
    return robot


def floor_of(robot: "RobotDescription", floor: Floor) -> Floor:
    """Return the floor as it really is under the robot: with its effects on the floor, in order.

    Raises InputError where an effect makes it one that cannot be.
    """
    for effect in robot.effects:
        try:
            floor = effect.floor(robot, floor)
        except ValidationError as error:
            raise InputError(f"effect {effect.name} is too large for this floor: {explain(error)}") from None
    return floor


def yielding_of(robot: "RobotDescription") -> float:
    """Return how fast (m/s) each contact of the robot slips for every N on it, beside its creep in rolling."""
    return sum(effect.yielding() for effect in robot.effects)


def radii_of(robot: "RobotDescription") -> Callable[[Array], Array] | None:
    """Return what gives the robot's radii (k, w), m, with castors at angles (k, n), rad; None: they do not change."""
    parts, built = [], robot.as_described()
    for effect in robot.effects:
        own = effect.rolling(built)
        parts += [] if own is None else [own]
        built = effect.apply(built)
    if not parts:
        return None
    radius = np.array([wheel.radius for wheel in built.wheels])
    return lambda castor_angle: radius * np.prod([1.0 + own(castor_angle) for own in parts], axis=0)


def slip_of(robot: "RobotDescription", motion: Motion) -> Slip:
    """Return by how much contacts slip more in a motion than those of the robot as described, by all its effects.

    Each effect meets the robot as those before it have built it.
    """
    total, built = Slip.none(motion), robot.as_described()
    for effect in robot.effects:
        own = effect.slip(built, motion)
        total = total if own is None else total + own
        built = effect.apply(built)
    return total


def reader_of(robot: "RobotDescription") -> Reader:
    """Return the readers of all the robot's effects in one, in order."""
    built = robot.as_built()
    readers = [own for effect in robot.effects if (own := effect.reader(built)) is not None]

    def read(t: Array, wheel: Array, castor: Array) -> tuple[Array, Array]:
        for own in readers:
            wheel, castor = own(t, wheel, castor)
        return wheel, castor

    return read


def readings(
    robot: "RobotDescription", t: ArrayLike, wheel_angle: ArrayLike, castor_angle: ArrayLike
) -> tuple[Array, Array]:
    """Return what the robot's encoders see, before they round: angles of wheels (K, w) and castors (K, n), rad.

    t (K,), increasing, s. wheel_angle (K, w), castor_angle (K, n): the true angles, unwrapped.
    """
    wheel, castor = np.array(wheel_angle, dtype=float), np.array(castor_angle, dtype=float)
    return reader_of(robot)(np.asarray(t, dtype=float), wheel, castor)


def reference(robot: "RobotDescription", t: ArrayLike, pose: ArrayLike) -> Array:
    """Return the poses (K, 3) that a log shows as reference in its rows of time t (K,), given the true ones.

    Straight lines between samples; before the first the robot stood still, after the last there is no reference (NaN).
    Effects on the tracked point act in order, each on the axes that those before it leave.
    """
    t, pose = np.asarray(t, dtype=float), np.asarray(pose, dtype=float)
    taken = t
    for effect in robot.effects:
        taken = effect.reference_time(taken)
        pose = effect.reference_pose(pose)
    columns = [np.interp(taken, t, column, right=np.nan) for column in pose.T]
    return np.stack(columns, axis=-1)


def table() -> str:
    """Return the table of all effects, as Markdown."""
    rows = ["| Name | Meaning | Unit | Least | Most | Step | Check |", "|---|---|---|---|---|---|---|"]
    for name, kind in EFFECTS.items():
        value = TypeAdapter(kind).json_schema()["properties"]["value"]
        meaning = (kind.__doc__ or "").split("\n\n")[0].replace("\n", " ")
        bounds = f"{value['minimum']:.4g} | {value['maximum']:.4g}"
        same = [other for other in kind.same_as if other != name]
        told = f" Not to be told from `{same[0]}`." if same else ""
        rows.append(f"| `{name}` | {meaning}{told} | {kind.unit} | {bounds} | {kind.step:g} | {kind.check} |")
    return "\n".join(rows) + "\n"
