"""A yaw-rate gyro: it reads how fast the body turns, with its effects, bias and noise."""

import math

import numpy as np

from castor_envs.effects.catalogue import gyro_gain_of
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import Gyro, RobotDescription


class GyroSensor:
    """The gyro of a robot in one run, read sample by sample; its bias walks from where the robot file says it is."""

    def __init__(self, gyro: Gyro, gain: float, random: np.random.Generator) -> None:
        """gain: what it reads of a body that turns at 1 rad/s, but for its bias, rad/s."""
        self._gyro, self._gain, self._random = gyro, gain, random
        self._walked, self._last = 0.0, math.nan

    @classmethod
    def of(cls, robot: RobotDescription, random: np.random.Generator) -> "GyroSensor | None":
        """Return the gyro of a robot with its effects; None where it has none."""
        return None if robot.gyro is None else cls(robot.gyro, gyro_gain_of(robot.effects), random)

    def read(self, t: float, rate: float) -> float:
        """Return the reading at time t, s, of a body that turns at `rate`; both rad/s."""
        gyro = self._gyro
        if gyro.bias_walk and t > self._last:
            self._walked += gyro.bias_walk * math.sqrt(t - self._last) * self._random.standard_normal()
        self._last = t
        return self._gain * rate + gyro.bias + self._walked + gyro.noise * self._random.standard_normal()

    def readings(self, t: Array, rate: Array) -> Array:
        """Return the readings (K,) at times t (K,), s, of the yaw rates (K,); both rad/s."""
        return np.array([self.read(*sample) for sample in zip(t.tolist(), rate.tolist(), strict=True)])
