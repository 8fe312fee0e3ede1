"""What a yaw-rate gyro tells: how much the body turned in a sample."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import Gyro, RobotDescription
from estimators.protocol import Observation

BIAS = 0.1
"""rad/s: prior standard deviation of a bias of which the robot file says nothing: several times that of cheap gyros."""

SETTLED = 20
"""Samples after which their mean period is known well enough."""


def gyro_of(robot: RobotDescription | Geometry) -> Gyro:
    """Return the robot's gyro; raises Declined where it has none."""
    if robot.gyro is None:
        raise Declined("needs a gyro; the robot has none")
    return robot.gyro


def bias_deviation(gyro: Gyro) -> float:
    """Return the prior standard deviation of a gyro's bias about what the robot file says, rad/s."""
    return BIAS if gyro.bias_tolerance is None else gyro.bias_tolerance


class GyroTurn(NamedTuple):
    """The body's turn (...) since the sample before, rad, less the bias that the robot file states, and the time (...),
    s, that the bias left turns it.

    variance (...): rad^2, of what the turn is off but for the noise of readings, for the bias and for the scale. known
    (...): whether the gyro was read at both ends; where it was not, all others are 0, and wheels alone tell the turn.
    """

    turn: Array
    duration: Array
    variance: Array
    known: NDArray[np.bool_]


class GyroTurns:
    """Integrates readings by the trapezoid rule, sample by sample. Arithmetic broadcasts.

    The rate may have changed in one step, at any time in the sample. Time stamps may be early or late, as those of
    messages are that come in bursts: who reads evenly turns on for a sample period, whatever the stamps say. The period
    is that of the file or, of a log at another rate, the mean so far, whichever is nearer. A reading is missing where
    it is not finite, or the observation has none; the turns on either side of it are not known.
    """

    def __init__(self, gyro: Gyro | None, period: float) -> None:
        """gyro: as the robot file describes it; None: no bias. period: of samples, s, by the same file."""
        self._bias, self._period = 0.0 if gyro is None else gyro.bias, period
        self._last: tuple[Array, Array] | None = None
        self._first: Array = np.zeros(0)
        self._samples = 0

    def read(self, observation: Observation) -> GyroTurn:
        """Take one sample."""
        time = np.array(observation["time"][..., 0])
        rate = observation["gyro"][..., 0] - self._bias if "gyro" in observation else np.full(time.shape, np.nan)
        if self._last is None:
            self._first, self._last = time, (time, np.full(rate.shape, np.nan))
        (before, last), self._last = self._last, (time, rate)
        known, duration, mean = np.isfinite(last + rate), time - before, (last + rate) / 2
        late = np.abs(duration - self._period)
        if self._samples > SETTLED:
            late = np.minimum(late, np.abs(duration - (before - self._first) / (self._samples - 1)))
        self._samples += 1
        variance = (duration * (rate - last)) ** 2 / 12 + (mean * late) ** 2
        turn, duration, variance = (np.where(known, of, 0.0) for of in (duration * mean, duration, variance))
        return GyroTurn(turn, duration, variance, known)
