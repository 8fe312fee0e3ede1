"""Every effect there is, and what all effects of a robot do together.

Effects change the vehicle that the physics builds (`as_built`), or radii as castors turn (`radii_of`), or what the
encoders make of true angles (`readings`), or the gyro of a turn (`gyro_gain_of`), or when and of which point the
reference is taken (`reference`), or the floor (`floor_of`), or how contacts creep (`creep_compliance_of`). `slip_of`
predicts by how much they make contacts slip in a known motion.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, Field, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter, ValidationError

from castor_envs.description import explain
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Slip
from castor_envs.vehicles.effect import Contacts, Effect, RadiusChange, Scope, SensorModel, known_effects
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

EFFECTS: dict[str, type[Effect[RobotDescription]]] = known_effects("robot")
"""Every effect of robots by its name."""

TRAIN_EFFECTS: dict[str, type[Effect[TrainDescription]]] = known_effects("train")
"""Every effect of trains by its name."""


def catalogue(vehicle: RobotDescription | TrainDescription) -> tuple[Effect[Any], ...]:
    """Return every effect that the robot or train may have, each in the size of its `step`."""
    return tuple(effect for kind in known_effects(vehicle.scope).values() for effect in kind.variants(vehicle))


def floor_of(robot: RobotDescription, floor: Floor) -> Floor:
    """Return the floor as it really is under the robot: with its effects on the floor, in order.

    Raises InputError where an effect makes the floor an impossible one.
    """
    for effect in robot.effects:
        try:
            floor = effect.floor(robot, floor)
        except ValidationError as error:
            raise InputError(f"effect {effect.name} is too large for this floor: {explain(error)}") from None
    return floor


def creep_compliance_of(robot: RobotDescription) -> float:
    """Return how fast (m/s) each contact of the robot slips for every N on it, in addition to its creep in rolling."""
    return sum(effect.creep_compliance() for effect in robot.effects)


def gyro_gain_of(effects: Sequence[Effect[Any]]) -> float:
    """Return what a gyro with these effects reads of a body that turns at 1 rad/s, but for its bias, rad/s."""
    return math.prod(effect.gyro_gain() for effect in effects)


def radii_of(robot: RobotDescription) -> Callable[[Array], Array] | None:
    """Return a function from castor angles (k, n), rad, to wheel radii (k, w), m; None if the radii do not change."""
    changes, built = [], robot.as_described()
    for effect in robot.effects:
        change = effect.radius_change(built)
        changes += [] if change is None else [change]
        built = effect.apply(built)
    if not changes:
        return None
    radius = np.array([wheel.radius for wheel in built.wheels])
    return partial(_changed, radius, changes)


def _changed(radius: Array, changes: Sequence[RadiusChange], castor_angle: Array) -> Array:
    return radius * np.prod([1.0 + change(castor_angle) for change in changes], axis=0)


def slip_of(contacts: Contacts[RobotDescription]) -> Slip:
    """Return the slip of a robot's contacts in a motion that all its effects add to that of the robot as described.

    Each effect is given the contacts of the robot to which the effects before it have been applied.
    """
    robot = contacts.robot
    total, built = Slip.none(contacts.motion), robot.as_described()
    for effect in robot.effects:
        slip = effect.slip(contacts.of(built))
        total = total if slip is None else total + slip
        built = effect.apply(built)
    return total


def sensor_model_of(robot: RobotDescription) -> SensorModel:
    """Return the sensor models of all the robot's effects in one, in order."""
    built = robot.as_built()
    return partial(_in_turn, [model for effect in robot.effects if (model := effect.sensor_model(built)) is not None])


def _in_turn(models: Sequence[SensorModel], t: Array, wheel: Array, castor: Array) -> tuple[Array, Array]:
    for model in models:
        wheel, castor = model(t, wheel, castor)
    return wheel, castor


def readings(
    robot: RobotDescription, t: ArrayLike, wheel_angle: ArrayLike, castor_angle: ArrayLike
) -> tuple[Array, Array]:
    """Return what the robot's encoders see, before they round: angles of wheels (K, w) and castors (K, n), rad.

    t (K,), increasing, s. wheel_angle (K, w), castor_angle (K, n): the true angles, unwrapped.
    """
    wheel, castor = np.array(wheel_angle, dtype=float), np.array(castor_angle, dtype=float)
    return sensor_model_of(robot)(np.asarray(t, dtype=float), wheel, castor)


def reference(robot: RobotDescription, t: ArrayLike, pose: ArrayLike) -> Array:
    """Return the poses (K, 3) that a log shows as reference in its rows of time t (K,), given the true ones.

    Interpolated linearly between samples; before the first the robot stood still, after the last there is no reference
    (NaN). Effects on the tracked point act in order, each in the axes that the earlier ones have produced.
    """
    t, pose = np.asarray(t, dtype=float), np.asarray(pose, dtype=float)
    taken = t
    for effect in robot.effects:
        taken = effect.reference_time(taken)
        pose = effect.reference_pose(pose)
    columns = [np.interp(taken, t, column, right=np.nan) for column in pose.T]
    return np.stack(columns, axis=-1)


def _with_default(field: Field[Any]) -> str:
    """Return the name of a field of an effect's class, as Markdown, with its default, if it has one."""
    default = "none" if field.default is None else field.default
    return f"`{field.name}`" + ("" if default is MISSING else f" ({default})")


def table(scope: Scope) -> str:
    """Return the table of all effects of robots or of trains, as Markdown."""
    columns = "Name", "Meaning", "Fields beside `value`", "Unit", "Least", "Most", "In good order", "Step", "Check"
    rows = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for name, kind in known_effects(scope).items():
        value = TypeAdapter(kind).json_schema()["properties"]["value"]
        meaning = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
        bounds = " | ".join(f"{value[end]:.4g}" if end in value else "-" for end in ("minimum", "maximum"))
        alike = [twin for twin in kind.indistinguishable_from if twin != name]
        note = f" Indistinguishable from `{alike[0]}`." if alike else ""
        others = ", ".join(map(_with_default, (field for field in fields(kind) if field.name not in ("name", "value"))))
        usual = "-" if kind.binary else f"{kind.tolerance:g}"
        cells = f"`{name}`", meaning + note, others, kind.unit, bounds, usual, f"{kind.step:g}", kind.check
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"
