"""Invariant extended Kalman filter with a slip observer, in the plane.

After Yu, Teng, Chakhachiro, Tong, Li, Lin, Koehler, Ahumada, Walls and Ghaffari, "Fully proprioceptive slip-velocity-
aware state estimation for mobile robots via invariant Kalman filtering and disturbance observer" (arXiv 2209.15140),
and the authors' program (UMich-CURLY/slip_detection_DOB). Theirs is a right-invariant filter on SE_3(3) of rotation,
velocity v, position p and slip velocity u, all in the world's axes. A gyro and an accelerometer propagate it, u decays
at a rate `DECAY`, and the wheels measure the body's velocity with the slip in it,

    velocity by wheels = R^T (v + u) + noise,    so the innovation is R (velocity by wheels) - v - u.

Here rotation is psi and the group SE_3(2). There is no accelerometer: v is a random walk of density `ACCELERATION`
instead, and with that the filter loses what tells a slip that lasts from a true velocity; left is that wheels which
change their speed faster than bodies do are believed a little less. The gyro's bias, which the program holds fixed in
yaw, is the mean reading while all wheels stand, outside the filter. What follows the program is the propagation of u,
the innovation and its derivative, the right-invariant update, and how noise is made discrete; the matrices in the plane
are derived here from the error eta = X^ X^-1, not taken from numbered equations of the paper. The wheels' velocity is
that of `wheel_odometry`.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.steps.castor_odometry import start
from estimators.steps.gyro import GyroTurns, bias_deviation, gyro_of
from estimators.steps.rolling_equations import EquationsOfSamples, Rows, solve

DECAY = 2.5
"""1/s: how fast a slip velocity dies away, that of the program."""

ACCELERATION = 0.2
"""m/s^1.5: density of the random walk of the velocity, which takes the place of the accelerometer."""

SLIP = 0.02
"""m/s^1.5: density of the slip velocity's noise; with `DECAY`, slip of 9 mm/s is usual."""

WHEELS = 2e-3
"""m/s: standard deviation of the velocity by wheels."""

STANDS = 5e-3
"""rad/s: standard deviation of the yaw rate of a body whose wheels count nothing."""

SETTLED = 0.25
"""s that wheels must stand before the body does: between a drive and a turn they may count nothing in a sample."""

V, P, U = slice(1, 3), slice(3, 5), slice(5, 7)
"""Where velocity, position and slip stand in the error; the heading stands first."""

LEFT = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Turns a vector by +90 degrees."""


class InvariantEKF:
    """The filter; serves every robot with a gyro whose wheels determine its motion.

    When to use: to compare with such filters. Without an accelerometer it is the wheels' displacement along the gyro's
    heading. Not batched.
    """

    def reset(self, robot: RobotDescription, pose: ArrayLike) -> None:
        """Start at `pose` (3,), at rest; raises Declined without a gyro, and if wheels do not determine the motion."""
        geometry, self._start = start(robot, pose)
        gyro = gyro_of(robot)
        self._noise, self._gyro = gyro.noise, GyroTurns(gyro, geometry.sample_period)
        rows = Rows.of(geometry)
        self._equations, self._weight = EquationsOfSamples(rows), 1.0 / rows.variances()
        self._heading, self._bias, self._bias_variance = 0.0, 0.0, bias_deviation(gyro) ** 2
        self._velocity, self._position, self._slip = np.zeros(2), np.zeros(2), np.zeros(2)  # in the start pose's axes
        self._time: float | None = None
        self._stood = 0.0
        self._covariance = np.zeros((7, 7))

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (3,). Where the gyro was not read at both ends, the wheels tell the turn."""
        equations, read = self._equations.read(observation), self._gyro.read(observation)
        motion = solve(equations, self._weight)
        time = float(observation["time"][0])
        duration, self._time = (0.0 if self._time is None else time - self._time), time
        if duration <= 0:
            return self.pose
        turn, variance = float(motion.turn), 0.0
        if read.known:
            turn = float(read.turn) - self._bias * duration
            variance = float(read.variance) + (self._noise * duration) ** 2
        self._propagate(turn, duration, variance)
        self._correct_velocity(se2.rotate_single(motion.displacement / duration, self._heading - turn / 2))
        self._stood = 0.0 if equations.rolled.any() else self._stood + duration
        if read.known and self._stood > SETTLED:
            self._correct_bias(turn / duration)
        return self.pose

    @property
    def pose(self) -> Array:
        """The pose (3,) now: x, y (m), psi (rad)."""
        return se2.compose(self._start, np.array([*self._position, self._heading]))

    @property
    def slip_velocity(self) -> Array:
        """The slip velocity (2,) of the body, u, in the world's axes, m/s."""
        return se2.rotate_single(self._slip, float(self._start[2]))

    def _propagate(self, turn: float, duration: float, variance: float) -> None:
        """Propagate the covariance of the right-invariant error, and the state, by a turn with a variance, rad2."""
        decayed = math.exp(-DECAY * duration)
        step, by_gyro = np.eye(7), np.zeros(7)
        step[P, V], step[U, U] = duration * np.eye(2), decayed * np.eye(2)
        # An error of the turn moves the error of heading, and those of vectors x by minus the turn of x: Ad_X.
        by_gyro[0] = 1.0
        for part, vector in ((V, self._velocity), (P, self._position), (U, self._slip)):
            by_gyro[part] = -LEFT @ vector
        noise = variance * np.outer(by_gyro, by_gyro)
        noise[V, V] += ACCELERATION**2 * duration * np.eye(2)
        noise[U, U] += SLIP**2 * duration * np.eye(2)
        self._covariance = step @ (self._covariance + noise) @ step.T
        self._heading += turn
        self._position = self._position + duration * self._velocity
        self._slip = decayed * self._slip

    def _correct_velocity(self, measured: Array) -> None:
        """Update with the velocity by wheels (2,), m/s, in the axes of the start: X becomes exp(K innovation) X."""
        derivative = np.zeros((2, 7))
        derivative[:, V] = derivative[:, U] = np.eye(2)
        with_error = self._covariance @ derivative.T
        gain = with_error @ np.linalg.inv(derivative @ with_error + WHEELS**2 * np.eye(2))
        change = gain @ (measured - self._velocity - self._slip)
        turn, turning = _exponential(float(change[0]))
        self._velocity, self._position, self._slip = (
            turn @ vector + turning @ change[part]
            for part, vector in ((V, self._velocity), (P, self._position), (U, self._slip))
        )
        self._heading += float(change[0])
        rest = np.eye(7) - gain @ derivative
        self._covariance = rest @ self._covariance @ rest.T + WHEELS**2 * gain @ gain.T

    def _correct_bias(self, rate: float) -> None:
        """Update the bias beyond the robot file's with the gyro's rate, rad/s, less both, while the wheels stand."""
        gain = self._bias_variance / (self._bias_variance + self._noise**2 + STANDS**2)
        self._bias += gain * rate
        self._bias_variance *= 1.0 - gain


def _exponential(angle: float) -> tuple[Array, Array]:
    """Return the rotation (2, 2) by an angle, rad, and what vectors get in the exponential of SE_k(2), (2, 2)."""
    half = math.sin(angle / 2)
    sine, rest = (math.sin(angle) / angle, 2 * half**2 / angle) if angle else (1.0, 0.0)
    turn = math.cos(angle) * np.eye(2) + math.sin(angle) * LEFT
    return turn, sine * np.eye(2) + rest * LEFT


ESTIMATORS = {"invariant-ekf": InvariantEKF}
