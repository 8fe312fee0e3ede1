"""Controllers: from the desired motion and sensor readings to motor commands, for robots and for trains."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry, castor_rates, inverse, pivot_velocity
from castor_envs.motion.paths import TrainPath, axles_behind
from castor_envs.motion.trajectories import Trajectory
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

SETTLED = 1e-12  # rad: castors that turn by less in a period, while the robot moves on as it does, have stopped turning
STANDSTILL = 1e-6  # m/s: a pivot slower than this has no direction to steer to

# Gains on the errors along (1/s), across (1/m2) and in heading (1/m): critically damped, within a third of a metre.
ALONG, ACROSS, TURN = 1.0, 9.0, 6.0


class Commands(NamedTuple):
    """Commands for one sample period: driven wheels (...,) and driven castors (...,), both in rad/s."""

    wheel: Array
    steering: Array


def trailing_angles(geometry: Geometry, twist: ArrayLike) -> Array:
    """Return the castor angles (..., n) of castors that have long trailed at a body twist (..., 3); 0 where at rest."""
    u = pivot_velocity(geometry, np.asarray(twist, dtype=float))
    moving = np.hypot(u[..., 0], u[..., 1]) > STANDSTILL
    return np.where(geometry.fixed, geometry.angle, np.where(moving, np.arctan2(u[..., 1], u[..., 0]), 0.0))


class KinematicController:
    """Maps a body twist to wheel and steering rates by the rolling constraints (Doebbler II.D), open loop in the pose.

    Commands hold for a sample period, in which castors go on turning: they are computed for the angles that the
    castors will have in its middle. Driven castors without an offset (swerve, tricycle) are steered to their pivot's
    direction of travel, or to its opposite if that is nearer.
    """

    def __init__(self, robot: RobotDescription | Sequence[RobotDescription]) -> None:
        """Take a robot, or several of one layout and sample period, for arrays with a leading axis of as many."""
        self._geometry = Geometry.of(robot)
        one = isinstance(robot, RobotDescription)
        first = robot if one else robot[0]
        most = robot.max_steering_speed if one else np.array([[each.max_steering_speed] for each in robot])
        self._period = first.sample_period
        self._limit = np.where(self._geometry.driven, most, np.inf)
        self._driven_wheels = np.array(first.driven_wheels, dtype=np.intp)
        self._driven_castors = np.array(first.driven_castors, dtype=np.intp)

    def commands(self, castor_angle: ArrayLike, twist: ArrayLike) -> Commands:
        """Return commands for measured castor angles (..., n) and the desired twist (..., 3) in B in mid-period."""
        wheel, rate = self._middle(np.asarray(castor_angle, dtype=float), np.asarray(twist, dtype=float))
        return Commands(wheel[..., self._driven_wheels], rate[..., self._driven_castors])

    def rolled(self, trajectory: Trajectory) -> tuple[Array, Array]:
        """Return what one robot's driven wheels (K, driven) are commanded in the K periods of a trajectory if all roll
        without slip, rad/s, and the twists (K, 3) in B in mid-period."""
        times = self._period * (0.5 + np.arange(int(np.ceil(trajectory.duration / self._period - 1e-9))))
        twists = trajectory.at(times)[1]
        theta = trailing_angles(self._geometry, trajectory.runs[0].legs[0].motion)
        wheels = np.empty((len(times), len(self._driven_wheels)))
        changes = np.flatnonzero(np.any(np.diff(twists, axis=0) != 0.0, axis=1)) + 1
        for start, end in pairwise([0, *changes.tolist(), len(times)]):
            for k in range(start, end):
                wheel, rate = self._middle(theta, twists[k])
                turned = self._period * rate
                if np.abs(turned).max() < SETTLED:
                    wheels[k:end] = wheel[self._driven_wheels]
                    break
                wheels[k], theta = wheel[self._driven_wheels], theta + turned
        return wheels, twists

    def _middle(self, theta: Array, twist: Array) -> tuple[Array, Array]:
        """Return the rates of all wheels (..., w) and castors (..., n) in mid-period, from castor angles (..., n)."""
        steered = self._steering_rates(theta, twist)
        middle = theta + 0.5 * self._period * self._rates(theta, twist, steered)
        rate = self._rates(middle, twist, steered)
        return inverse(self._geometry, middle, rate, twist).rate, rate

    def _rates(self, theta: Array, twist: Array, steered: Array) -> Array:
        """Return castor rates (..., n): of rolling where castors trail, else `steered`; within the motors' limit."""
        rate = np.where(self._geometry.trailing, castor_rates(self._geometry, theta, twist), steered)
        return np.minimum(np.maximum(rate, -self._limit), self._limit)

    def _steering_rates(self, theta: Array, twist: Array) -> Array:
        """Return rates (..., n) that turn driven castors to their pivots' direction of travel in a period; else 0."""
        u = pivot_velocity(self._geometry, twist)
        away = np.arctan2(u[..., 1], u[..., 0]) - theta
        nearest = away - np.pi * np.round(away / np.pi)
        turning = self._geometry.driven & (np.hypot(u[..., 0], u[..., 1]) > STANDSTILL)
        return np.where(turning, nearest / self._period, 0.0)


def posture_correction(speed: ArrayLike, error: Array) -> tuple[Array, Array]:
    """Return by how much to go faster (...), m/s, and turn faster (...), rad/s, at speed (...) with error (..., 3).

    The posture tracking law of Kanayama et al. (1990), for negative speeds too: backward, an error across is corrected
    by turning the other way, one of the heading is not. error: the target as seen from the axle, x, y (m), psi (rad).
    At rest there is nothing to correct: an axle that stands cannot go sideways.
    """
    speed = np.asarray(speed, dtype=float)
    ahead = ALONG * error[..., 0] * (speed != 0)
    return ahead, speed * (ACROSS * error[..., 1] + np.sign(speed) * TURN * np.sin(error[..., 2]))


def axle_wheel_rates(axles: Geometry, twists: Array) -> Array:
    """Return the wheels' rates (..., 2N), axle by axle, left then right, rad/s, by rolling at the axles' twists.

    axles: of all axles (k,) in a row. twists (..., N, 3): of as many.
    """
    rates = inverse(axles, axles.angle, np.zeros_like(axles.angle), twists.reshape(-1, 3)).rate
    return rates.reshape(*twists.shape[:-2], -1)


class TrainSteering:
    """Moves the axles of a train along a path, each corrected by the relative posture sensor to the axle ahead.

    The front axle is driven by the path (open loop in the pose, as `KinematicController`). Every other axle is driven
    by the path as well, and corrects its place behind the axle ahead by the sensor between them
    (`posture_correction`): the target is where the axle should stand as seen from where it is. The train
    starts on its path, so a sensor's first reading gives its zero: an offset of 4 degrees, taken for a posture, would
    drive the axles against each other. A reading that is missing or older than a sample period is not followed.
    """

    def __init__(self, train: TrainDescription) -> None:
        self._period = train.sample_period
        self._geometry = Geometry.rolling(train.modules)
        self._zero = np.full((len(train.frames), 3), np.nan)

    def twists(self, place: Array, after: Array, way: float, rps: ArrayLike, age: ArrayLike) -> Array:
        """Return the axles' twists (N, 3) for a sample period.

        place, after (N, 3): where the axles are to be at its begin and end. way: m along the path between these,
        negative backward. rps (F, 3) or (3F,): relative poses as measured now; age (F,): s.
        """
        v = np.full(len(place), way / self._period)
        turning = (after[:, 2] - place[:, 2]) / self._period
        expected = se2.relative_pose(place[1:], place[:-1])
        measured = np.reshape(np.asarray(rps, dtype=float), (-1, 3))
        sound = np.isfinite(measured).all(axis=-1) & (np.asarray(age) <= 1.5 * self._period)
        first = sound & np.isnan(self._zero[:, 0])
        self._zero[first] = (measured - expected)[first]
        seen = np.where(sound[:, None], measured - self._zero, expected)
        error = np.where(sound[:, None], se2.compose(seen, se2.inverse(expected)), 0.0)
        ahead, turn = posture_correction(v[1:], error)
        v[1:] += ahead
        turning[1:] += turn
        return np.stack([v, np.zeros_like(v), turning], axis=-1)

    def wheel_rates(self, twists: Array) -> Array:
        """Return the wheels' rates (2N,), axle by axle, rad/s, at which the axles have twists (N, 3)."""
        return axle_wheel_rates(self._geometry, twists)


class TrainDriver:
    """Commands wheel rates that take a train along a path. It knows time and the relative posture sensors alone."""

    def __init__(self, train: TrainDescription, path: TrainPath) -> None:
        self._period, self._path = train.sample_period, path
        self._behind = axles_behind([frame.length for frame in train.frames])
        self._steering = TrainSteering(train)

    def twists(self, time: float, rps: ArrayLike, age: ArrayLike) -> Array:
        """Return the axles' twists (N, 3) for the sample period that begins at `time` (s).

        rps (F, 3) or (3F,): relative poses as measured now; age (F,): s.
        """
        covered, _ = self._path.progress(np.array([time, time + self._period]))
        place, after = (self._path.at(length - self._behind)[0] for length in covered)
        return self._steering.twists(place, after, float(covered[1] - covered[0]), rps, age)

    def commands(self, time: float, rps: ArrayLike, age: ArrayLike) -> Array:
        """Return wheel rates (2N,), rad/s, for the sample period that begins at `time`; arguments as for `twists`."""
        return self._steering.wheel_rates(self.twists(time, rps, age))
