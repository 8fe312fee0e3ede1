"""Effects of wrong wiring: encoders swapped or reversed. They are there or not: their value is always 1."""

from functools import partial
from itertools import combinations
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG
from castor_envs.effects.parts import (
    castor_of,
    channel,
    on_channels,
    pivot_channel,
    pivot_encoders,
    wheel_channel,
    wheel_encoders,
)
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect, Number, SensorModel, ThereOrNot
from castor_envs.vehicles.robot import Castor, RobotDescription


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class EncodersSwapped(Effect[RobotDescription]):
    """The encoders of a castor's left and right wheel are swapped."""

    name: Literal["encoders_swapped"] = "encoders_swapped"
    castor: Number
    value: ThereOrNot = 1.0
    title = "left and right encoder swapped"
    unit = "1"
    step = 1.0
    tolerance = 3e-3  # present or absent
    binary = True
    check = "Turn one wheel of the castor by hand and see which counts change."
    wiring = True

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["EncodersSwapped", ...]:
        """Return an instance for each castor with two wheels that have encoders."""
        return tuple(cls(castor=i) for i, castor in enumerate(robot.castors, start=1) if _is_pair(castor))

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that gives each of the two wheels the other's counts."""
        if not _is_pair(castor_of(robot, self.castor, self.name)):
            raise InputError(f"effect {self.name}: castor {self.castor} has not two wheels with encoders")
        pair = [wheel_channel(robot, self.castor, j, self.name) for j in (1, 2)]
        return _exchanged(robot, pair, pair[::-1])


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class EncoderReversed(Effect[RobotDescription]):
    """One encoder counts backwards: a wheel's, or the castor's pivot encoder where `wheel` is left out (-theta)."""

    name: Literal["encoder_reversed"] = "encoder_reversed"
    castor: Number
    wheel: Number | None = None
    value: ThereOrNot = 1.0
    title = "encoder reversed"
    unit = "1"
    step = 1.0
    tolerance = 3e-3  # present or absent
    binary = True
    check = "Turn the wheel or castor by hand, forward or counter-clockwise, and see whether its counts rise."
    wiring = True

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["EncoderReversed", ...]:
        """Return an instance for each encoder."""
        places = [*wheel_encoders(robot), *((i, None) for i in pivot_encoders(robot))]
        return tuple(cls(castor=i, wheel=j) for i, j in places)

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that turns the sign."""
        return on_channels(robot, [channel(robot, self.castor, self.wheel, self.name)], _reversed)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CastorOrder(Effect[RobotDescription]):
    """The encoders of two castors are exchanged: those of either castor are connected as those of the other."""

    name: Literal["castor_order"] = "castor_order"
    castor: Number
    exchanged_with: Number
    value: ThereOrNot = 1.0
    title = "two castors' encoders exchanged"
    unit = "1"
    step = 1.0
    tolerance = 3e-3  # present or absent
    binary = True
    check = "Turn one castor by hand and see which castor's counts change."
    wiring = True

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["CastorOrder", ...]:
        """Return an instance for each pair of castors that have encoders, and the same ones."""
        kinds = {i: _encoders(castor) for i, castor in enumerate(robot.castors, start=1)}
        pairs = combinations([i for i, kind in kinds.items() if any(kind)], 2)
        return tuple(cls(castor=i, exchanged_with=j) for i, j in pairs if kinds[i] == kinds[j])

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that gives each castor the other's counts."""
        ends = (self.castor, self.exchanged_with)
        kinds = [_encoders(castor_of(robot, i, self.name)) for i in ends]
        if self.castor == self.exchanged_with or kinds[0] != kinds[1] or not any(kinds[0]):
            raise InputError(
                f"effect {self.name}: castors {ends[0]} and {ends[1]} are not two castors with the same encoders"
            )
        first, second = (
            [wheel_channel(robot, i, j, self.name) for j, driven in enumerate(kinds[0][:-1], start=1) if driven]
            + ([pivot_channel(robot, i, self.name)] if kinds[0][-1] else [])
            for i in ends
        )
        return _exchanged(robot, first + second, second + first)


def _is_pair(castor: Castor) -> bool:
    return len(castor.wheels) == 2 and all(wheel.driven for wheel in castor.wheels)


def _encoders(castor: Castor) -> tuple[bool, ...]:
    """Return which wheels of a castor have encoders and, last, whether its pivot has one."""
    return (*(wheel.driven for wheel in castor.wheels), castor.pivot_counts_per_rev is not None)


def _exchanged(robot: RobotDescription, channels: list[int], sources: list[int]) -> SensorModel:
    """Return a model in which each channel gets its source's counts, read by the channel's counts a turn and zero."""
    per_rev = np.array(
        [wheel.counts_per_rev for wheel in robot.wheels] + [castor.pivot_counts_per_rev for castor in robot.castors],
        dtype=float,
    )
    zero = np.array([0.0] * len(robot.wheels) + [castor.pivot_zero for castor in robot.castors])
    order = [channels.index(source) for source in sources]
    scale, channel_zero, source_zero = per_rev[sources] / per_rev[channels], zero[channels], zero[sources]
    return on_channels(robot, channels, partial(_in_order, order, source_zero, scale, channel_zero))


def _in_order(order: list[int], source_zero: Array, scale: Array, channel_zero: Array, t: Array, angle: Array) -> Array:
    return (angle[:, order] + source_zero) * scale - channel_zero


def _reversed(t: Array, angle: Array) -> Array:
    return -angle
