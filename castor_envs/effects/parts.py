"""Finds the castor, wheel or encoder of a robot that an effect changes; an error says which is missing."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from castor_envs.description import explain
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import SensorModel
from castor_envs.vehicles.robot import Castor, RobotDescription


def castor_of(robot: RobotDescription, number: int, effect: str) -> Castor:
    """Return castor `number` (from 1); raises InputError where the robot has no such castor."""
    if number > len(robot.castors):
        raise InputError(f"effect {effect}: robot {robot.name!r} has no castor {number}")
    return robot.castors[number - 1]


def with_castor(robot: RobotDescription, number: int, effect: str, **changes: object) -> RobotDescription:
    """Return the robot with some fields of castor `number` (from 1) replaced; raises InputError if that is invalid."""
    castors = list(robot.castors)
    try:
        castors[number - 1] = dataclasses.replace(castor_of(robot, number, effect), **changes)
    except ValidationError as error:
        raise InputError(f"effect {effect} is too large for castor {number}: {explain(error)}") from None
    return dataclasses.replace(robot, castors=tuple(castors))


def with_wheels(
    robot: RobotDescription, castor: int, effect: str, wheel: int | None = None, **scales: float
) -> RobotDescription:
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


def wheel_channel(robot: RobotDescription, castor: int, wheel: int, effect: str) -> int:
    """Return the channel of a wheel's encoder; raises InputError where there is none.

    Channels: all wheels, then all castors, in the robot file's order.
    """
    wheels = castor_of(robot, castor, effect).wheels
    if wheel > len(wheels):
        raise InputError(f"effect {effect}: castor {castor} has no wheel {wheel}")
    if not wheels[wheel - 1].driven:
        raise InputError(f"effect {effect}: wheel {wheel} of castor {castor} has no encoder")
    return robot.wheel_castors.index(castor - 1) + wheel - 1


def pivot_channel(robot: RobotDescription, castor: int, effect: str) -> int:
    """Return the channel of a castor's pivot encoder; raises InputError where there is none."""
    if castor_of(robot, castor, effect).pivot_counts_per_rev is None:
        raise InputError(f"effect {effect}: castor {castor} has no pivot encoder")
    return len(robot.wheels) + castor - 1


def channel(robot: RobotDescription, castor: int, wheel: int | None, effect: str) -> int:
    """Return the channel of a wheel's encoder, or of the castor's pivot encoder where wheel is None."""
    if wheel is None:
        return pivot_channel(robot, castor, effect)
    return wheel_channel(robot, castor, wheel, effect)


def wheel_encoders(robot: RobotDescription) -> list[tuple[int, int]]:
    """Return (castor, wheel), both from 1, of every wheel with an encoder."""
    return [
        (i, j)
        for i, castor in enumerate(robot.castors, start=1)
        for j, wheel in enumerate(castor.wheels, start=1)
        if wheel.driven
    ]


def pivot_encoders(robot: RobotDescription) -> list[int]:
    """Return the castors (from 1) with a pivot encoder."""
    return [i + 1 for i in robot.pivot_encoders]


def all_channels(robot: RobotDescription) -> list[int]:
    """Return the channels of all encoders of the robot."""
    return [*robot.driven_wheels, *(len(robot.wheels) + i for i in robot.pivot_encoders)]


def on_channels(robot: RobotDescription, channels: Sequence[int], read: Callable[[Array, Array], Array]) -> SensorModel:
    """Return a sensor model that passes angles (k, c) of some channels, and no others, through `read(t, angles)`."""
    return partial(_on_columns, np.array(channels, dtype=np.intp), read)


def _on_columns(
    columns: NDArray[np.intp], read: Callable[[Array, Array], Array], t: Array, wheel: Array, castor: Array
) -> tuple[Array, Array]:
    angles, w = np.concatenate([wheel, castor], axis=1), wheel.shape[1]
    angles[:, columns] = read(t, angles[:, columns])
    return angles[:, :w], angles[:, w:]


def sample_by_sample(read: Callable[[float, Array], Array]) -> Callable[[Array, Array], Array]:
    """Return a function that passes samples through `read(t, angles (c,))` one after another."""
    return partial(_each_sample, read)


def _each_sample(read: Callable[[float, Array], Array], t: Array, angle: Array) -> Array:
    return np.stack([read(*sample) for sample in zip(t.tolist(), angle, strict=True)])
