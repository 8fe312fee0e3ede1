"""Method 1 of Vogt and Minor: RMSPEC, a method for two axles, applied to a train pair by pair.

The paper says of Method 1 that it "selects the most trustworthy frame followed by selecting the most trustworthy axle
of that frame corresponding to RMSPEC deviation metrics", and prints no equation. RMSPEC itself (Minor and Merrell, Int.
J. Robotics Research 26, 2007) keeps an extended Kalman filter for each axle and fuses them by covariance intersection
(CI). The reading here:

1. Every axle has a covariance, which grows as it rolls (`ROLLING_SIGMA`, `TURNING_SIGMA`).
2. Every frame is a train of two axles. The deviation angle of an attachment (eqs. 6, 7) measures the trust in its axle:
   the smaller angle marks the trusted axle, and is that of the frame.
3. Frame by frame, the most trustworthy first, the OD pose of the trusted axle predicts the other one's pose through the
   relative pose, and the other axle is fused with it: by CI, whose weight makes the determinant of the covariance
   smallest. The discrepancy of the two counts against the distrusted axle: its square is added to that axle's
   covariance. Without this CI would keep the OD pose as it is, since a prediction is never surer than what it is
   predicted from.

Every frame uses its two axles and their odometry alone; an axle inside the train belongs to two frames, and may be
trusted by one frame and moved by the other. So the belief contradicts the relative poses after the update, for which
the paper rejects this method (Fig. 2).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.trains.configuration import DEFAULT_INTERVAL, Configuration, checked_interval, next_to
from estimators.trains.grpec import Errors, attached, errors, select
from estimators.trains.pose_noise import ODOMETRY_SIGMA, RELATIVE_SIGMA

ROLLING_SIGMA = np.array([0.01, 0.005, np.radians(1.0)])
"""Error (along m, across m, heading rad) of odometry after 1 m, assumed; in proportion to the root of the distance."""

TURNING_SIGMA = np.radians(1.0)
"""Error of heading after turning by 1 rad, rad: an assumption. Grows with the square root of the angle."""


class Belief(NamedTuple):
    """Poses (N, 3) of the axles in N, and the covariance (N, 3, 3) of each."""

    poses: Array
    covariances: Array


def deviations(od: ArrayLike, relative: ArrayLike) -> Array:
    """Return the deviation angle (..., F, 2), rad, of every frame attached to its front and to its rear axle."""
    return _of_frames(od, relative).theta_dev


def updated(belief: Belief, relative: ArrayLike) -> Belief:
    """Return the belief after the updates of all frames, for relative poses (N - 1, 3)."""
    relative = np.asarray(relative, dtype=float)
    poses, covariances = belief.poses.copy(), belief.covariances.copy()
    found = _of_frames(poses, relative)
    trusted_axle = select(found.theta_dev, found.theta_xy)
    for frame in np.argsort(found.theta_dev.min(axis=-1), kind="stable"):
        trusted, doubted = (frame, frame + 1) if trusted_axle[frame] == 0 else (frame + 1, frame)
        pair = slice(frame, frame + 2)
        prediction = attached(belief.poses[pair], relative[frame : frame + 1])[trusted - frame, doubted - frame]
        sure = _predicted(belief.poses[trusted], belief.covariances[trusted], prediction, front=trusted == frame)
        discrepancy = prediction - poses[doubted]
        discrepancy[2] = wrap(discrepancy[2])
        doubted_covariance = covariances[doubted] + np.outer(discrepancy, discrepancy)
        gain, covariances[doubted] = intersection(doubted_covariance, sure)
        poses[doubted] = poses[doubted] + gain @ discrepancy
    return Belief(poses, covariances)


def intersection(first: Array, second: Array) -> tuple[Array, Array]:
    """Fuse two estimates of unknown correlation by covariance intersection (Julier and Uhlmann, 1997).

    first, second: their covariances (3, 3). Returns the gain (3, 3) that moves the first estimate towards the second,
    and the covariance: P^-1 = w A^-1 + (1 - w) B^-1, w in [0, 1] such that the determinant of P is smallest.
    """
    a, b = np.linalg.inv(first), np.linalg.inv(second)
    # det P^-1 = det B^-1 (1 + w x) (1 + w y) (1 + w z) with the eigenvalues of B A^-1 - 1; its slope is quadratic in w
    x, y, z = np.linalg.eigvals(second @ a).real - 1
    stationary = np.roots([3 * x * y * z, 2 * (x * y + y * z + z * x), x + y + z]).real
    w = max(0.0, 1.0, *np.clip(stationary, 0.0, 1.0).tolist(), key=lambda w: (1 + w * x) * (1 + w * y) * (1 + w * z))
    covariance = np.linalg.inv(w * a + (1 - w) * b).astype(float)
    return (1 - w) * covariance @ b, covariance


class RMSPEC:
    """At intervals corrects the OD poses frame by frame; odometry goes on from them.

    interval: sample periods between corrections. status: why relative poses cannot be used now, or None.
    """

    def __init__(self, interval: int = DEFAULT_INTERVAL) -> None:
        self.interval = checked_interval(interval)

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises InputError for anything but a train, and for poses of another shape."""
        self._configuration = Configuration(train, poses, self.interval)
        self._covariances = np.tile(np.diag(ODOMETRY_SIGMA**2), (train.n_axles, 1, 1))

    @property
    def status(self) -> str | None:
        """Which frame's relative pose cannot be used now, and why; None while all can."""
        return self._configuration.status

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (N, 3)."""
        before = self._configuration.poses
        relative = self._configuration.advance(observation)
        self._covariances = grown(self._covariances, before, self._configuration.poses)
        if relative is not None:
            od = self._configuration.poses
            poses, self._covariances = updated(Belief(od, self._covariances), relative)
            self._configuration.correct(next_to(od[:, 2], poses))
        return self._configuration.poses.copy()


def grown(covariances: ArrayLike, before: ArrayLike, after: ArrayLike) -> Array:
    """Return the covariances (..., 3, 3) of poses (..., 3) after odometry moved them: the filter's prediction."""
    before, after = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    step = after - before
    rolled, turned = np.hypot(step[..., 0], step[..., 1]), np.abs(step[..., 2])
    by_pose = _moved_by_heading(step)
    variance = rolled[..., None] * ROLLING_SIGMA**2
    variance[..., 2] += turned * TURNING_SIGMA**2
    turn = se2.rotation(0.5 * (before[..., 2] + after[..., 2]))
    noise = (turn * variance[..., None, :]) @ np.swapaxes(turn, -1, -2)
    return by_pose @ np.asarray(covariances, dtype=float) @ np.swapaxes(by_pose, -1, -2) + noise


def _of_frames(od: ArrayLike, relative: ArrayLike) -> Errors:
    """Return the errors (..., F, 2) of every frame as a train of two axles."""
    od, relative = np.asarray(od, dtype=float), np.asarray(relative, dtype=float)
    pairs = np.stack([od[..., :-1, :], od[..., 1:, :]], axis=-2)
    return errors(pairs, relative[..., None, :])


def _predicted(pose: Array, covariance: Array, prediction: Array, front: bool) -> Array:
    """Return the covariance (3, 3) of a pose predicted through a relative pose from an axle: the front one, or not."""
    step = prediction - pose
    by_pose = _moved_by_heading(step)
    # From the front axle the relative pose is taken backwards: its error of heading swings the rear axle about it.
    by_relative = _moved_by_heading(step) @ -se2.rotation(prediction[2]) if front else se2.rotation(pose[2])
    noise = np.diag(RELATIVE_SIGMA**2)
    return by_pose @ covariance @ by_pose.T + by_relative @ noise @ by_relative.T


def _moved_by_heading(step: Array) -> Array:
    """Return how a pose (..., 3, 3) that lies `step` (..., 3) from another, in N, moves with the other."""
    matrix = np.zeros((*step.shape[:-1], 3, 3))
    matrix[..., [0, 1, 2], [0, 1, 2]] = 1.0
    matrix[..., 0, 2], matrix[..., 1, 2] = -step[..., 1], step[..., 0]
    return matrix


ESTIMATORS = {"rmspec": RMSPEC}
