"""What a yaw-rate gyro tells: how much the body turned in a sample."""

import math
from typing import NamedTuple

import numpy as np

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import Gyro, RobotDescription
from estimators.protocol import Observation


def gyro_of(robot: RobotDescription | Geometry) -> Gyro:
    """Return the robot's gyro; raises Declined where it has none."""
    if robot.gyro is None:
        raise Declined("needs a gyro; the robot has none")
    return robot.gyro


class GyroTurn(NamedTuple):
    """The body's turn (...) since the sample before, rad, and the time (...), s.

    uneven (...): rad, standard deviation of the turn if the rate changed in one step, at any time in the sample.
    """

    turn: Array
    duration: Array
    uneven: Array


class GyroTurns:
    """Integrates readings by the trapezoid rule, sample by sample. Arithmetic broadcasts."""

    def __init__(self) -> None:
        self._last: tuple[Array, Array] | None = None

    def read(self, observation: Observation) -> GyroTurn | None:
        """Take one sample; the first turn is 0. None where the sample has no reading of a gyro."""
        if "gyro" not in observation:
            return None
        time, rate = np.array(observation["time"][..., 0]), np.array(observation["gyro"][..., 0])
        before, last = (time, rate) if self._last is None else self._last
        self._last = time, rate
        duration = time - before
        return GyroTurn(duration * (last + rate) / 2, duration, duration * np.abs(rate - last) / math.sqrt(12))
