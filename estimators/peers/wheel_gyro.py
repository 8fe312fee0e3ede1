"""Wheels and a gyro, whose errors a Kalman filter learns while the robot drives.

An augmented Kalman filter: the pose and the systematic errors of odometry are one state (Martinelli, Tomatis, Tapus,
Siegwart, "Simultaneous localization and odometry calibration for mobile robot", IROS 2003, where a laser scanner
observes it). As intrinsics it has those that Lee, Eckenhoff, Yang, Geneva and Huang calibrate online ("Visual-inertial-
wheel odometry with online calibration", IROS 2020), the radius of each wheel and the track. As they do between images,
the wheels are integrated over a window, whose first heading is kept in the state; what observes them here is the gyro,

    gyro's turn in the window = heading - first heading + bias duration + noise.

So counts are rounded only at the ends of a window. The wheels' motion is the least-squares solution of
`wheel_odometry`; "track" is the scale of all lengths of the robot but its radii. The state of d wheels with encoders is

    pose (3)      in the frame of the start pose
    radius (d)    relative to those described
    track (1)     relative
    bias (1)      of the gyro beyond the robot file's, rad/s
    first (1)     heading at the start of the window, rad
"""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.steps.castor_odometry import start
from estimators.steps.gyro import GyroTurns, bias_deviation, gyro_of
from estimators.steps.rolling_equations import Equations, EquationsOfSamples, Motion, Rows, solve

RADIUS, TRACK = 1e-2, 1e-2
"""Relative: prior standard deviations of radii and track, as of robots that are measured with a ruler."""

SLIP = 5e-4
"""m after 1 m: standard deviation of the random walk of slip, along wheels and across."""

UNEVEN = 1.0
"""Standard deviation of a castor's angle half-way, as a part of what it swivels in a sample."""

WINDOW = 1.0
"""s: how long wheels are integrated before the gyro is compared with them."""

LEAST = 1e-12
"""rad2: least variance of a turn by the gyro, of one without noise."""


class WheelGyro:
    """The filter; serves every robot with a gyro whose wheels determine its motion.

    When to use: a robot with a gyro whose radii or track are not exactly known. A turn shows ratios of lengths alone:
    the common scale of radii and track stays as described. Not batched.
    """

    def reset(self, robot: RobotDescription, pose: ArrayLike) -> None:
        """Start at `pose` (3,); raises Declined without a gyro, and where wheels do not determine the motion."""
        geometry, self._start = start(robot, pose)
        gyro = gyro_of(robot)
        self._described, self._gyro = gyro, GyroTurns(gyro, geometry.sample_period)
        rows = Rows.of(geometry)
        self._equations, self._weight = EquationsOfSamples(rows), 1.0 / rows.variances()
        self._wheels = d = len(rows.wheels)
        self._rounded = np.zeros(len(rows.castor))
        self._rounded[:d] = rows.way_per_count**2 / 6
        prior = np.array([0.0, 0.0, 0.0, *[RADIUS] * d, TRACK, bias_deviation(gyro), 0.0])
        self._numbers, self._bias, self._first = slice(3, 4 + d), 4 + d, 5 + d
        self._state, self._covariance = np.zeros_like(prior), np.diag(prior**2)
        self._turned, self._duration, self._variance = 0.0, 0.0, LEAST  # of the gyro, in this window

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (3,). A window ends where the gyro is not read."""
        equations = self._as_learned(self._equations.read(observation))
        motion = solve(equations, self._weight)
        by_numbers, by_errors = self._derivatives(equations, motion.turn)
        rounded = float(by_errors[2] ** 2 @ self._rounded)
        read = self._gyro.read(observation)
        if not read.known and self._duration > 0:
            self._correct(rounded)
        self._move(motion, by_numbers, (by_errors * self._variances(equations)) @ by_errors.T)
        if not read.known:
            self._begin()
            return self.pose
        self._turned += float(read.turn)
        self._duration += float(read.duration)
        self._variance += float((self._described.noise * read.duration) ** 2 + read.variance)
        if self._duration > WINDOW - 1e-9:
            self._correct(rounded)
        return self.pose

    def _move(self, motion: Motion, by_numbers: Array, spread: Array) -> None:
        """Move the pose, and its errors by those of heading, numbers and the motion itself, covariance (3, 3)."""
        state = self._state
        by_motion = se2.rotation(state[2] + motion.turn / 2)
        step = by_motion[:2, :2] @ motion.displacement
        by_motion[:2, 2] = -step[1] / 2, step[0] / 2
        carried = np.eye(len(state))
        carried[:2, 2] = -step[1], step[0]
        carried[:3, self._numbers] = by_motion @ by_numbers
        self._covariance = carried @ self._covariance @ carried.T
        self._covariance[:3, :3] += by_motion @ spread @ by_motion.T
        state[:3] += [*step, motion.turn]

    def _correct(self, rounded: float) -> None:
        """Update with the turn by the gyro in this window, and begin the next one.

        rounded: variance of the turn by the wheels from counts at both ends, rad2.
        """
        state, covariance, first = self._state, self._covariance, self._first
        row = np.zeros(len(state))
        row[[2, self._bias, first]] = 1.0, self._duration, -1.0
        with_row = covariance @ row
        gain = with_row / (row @ with_row + self._variance + rounded)
        state += gain * (self._turned - row @ state)
        covariance -= np.outer(gain, with_row)
        self._begin()

    def _begin(self) -> None:
        """Begin a window."""
        state, covariance, first = self._state, self._covariance, self._first
        state[first], covariance[first] = state[2], covariance[2]
        covariance[:, first] = covariance[:, 2]
        self._turned, self._duration, self._variance = 0.0, 0.0, LEAST

    @property
    def pose(self) -> Array:
        """The pose (3,) now: x, y (m), psi (rad)."""
        return se2.compose(self._start, self._state[:3])

    @property
    def covariance(self) -> Array:
        """The covariance (3, 3) of x, y (m) and psi (rad), in the world's axes."""
        turn = se2.rotation(self._start[2])
        return turn @ self._covariance[:3, :3] @ turn.T

    @property
    def gyro_bias(self) -> float:
        """The bias of the gyro as learned so far, rad/s."""
        return self._described.bias + float(self._state[self._bias])

    def _as_learned(self, equations: Equations) -> Equations:
        """Return a sample's equations with the radii and the track learned so far."""
        matrix, rolled = equations.matrix.copy(), equations.rolled.copy()
        *radius, track = 1.0 + self._state[self._numbers]
        rolled[: self._wheels] *= radius
        matrix[:, 2] *= track
        return equations._replace(matrix=matrix, rolled=rolled, arm=equations.arm * track)

    def _variances(self, equations: Equations) -> Array:
        """Return the variance (m,), m2, of each equation in one sample, by slip and by castors that swivel unevenly."""
        way = np.abs(equations.rolled[: self._wheels]).max(initial=0.0)
        return SLIP**2 * way + (UNEVEN * equations.swivel * way) ** 2

    def _derivatives(self, equations: Equations, turn: Array) -> tuple[Array, Array]:
        """Return the derivatives of displacement (m) and turn (rad): (3, d + 1) by radii and track, (3, m) by errors of
        equations, m."""
        matrix, d = equations.matrix, self._wheels
        weighted = matrix.T * self._weight
        by_errors = np.linalg.pinv(weighted @ matrix) @ weighted
        by_errors[2] /= np.cos(turn / 2)  # the unknown is a = 2 sin(turn / 2)
        rolled = equations.rolled * np.sinc((turn + equations.swivel) / (2 * np.pi))
        by_numbers = np.zeros((len(matrix), d + 1))
        by_numbers[:d, :d] = np.diag(rolled[:d])
        by_numbers[:, d] = equations.right(turn) - rolled - matrix[:, 2] * 2 * np.sin(turn / 2)
        return by_errors @ by_numbers, by_errors


ESTIMATORS = {"wheel-gyro": WheelGyro}
