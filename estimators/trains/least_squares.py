"""Method 2 of Vogt and Minor: least squares over the whole train, "all axles to have a relative degree of trust".

The paper gives no equation for it, and reports that it does not converge (Fig. 4). Here it is a Gauss-Newton iteration
on the poses of all axles. Its residuals, each divided by its standard deviation:

- prior of axle i: its pose minus its OD pose
- frame f: the pose of the front axle in the rear axle's frame, minus the measured relative pose

With priors it converges. Without them the residuals do not change when the whole train is moved or turned: the normal
matrix has rank 3 (N - 1) of 3 N, no step is determined, and nothing can converge. That may be what Fig. 4 shows.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.trains.configuration import DEFAULT_INTERVAL, Configuration, checked_interval, next_to
from estimators.trains.pose_noise import ODOMETRY_SIGMA, RELATIVE_SIGMA

MOST_ITERATIONS = 100
CONVERGED = 1e-9
"""m and rad: the largest change of any pose in the last iteration."""


class Solution(NamedTuple):
    """What `gauss_newton` found, over leading axes (...).

    poses: (..., N, 3), psi next to the OD headings. cost: (...), sum of squared residuals there. iterations: the
    largest number over (...). converged: whether all of them converged. rank: (...), of the normal matrix, whose size
    is 3 N.
    """

    poses: Array
    cost: Array
    iterations: int
    converged: bool
    rank: NDArray[np.intp]


def residuals(poses: ArrayLike, od: ArrayLike, relative: ArrayLike) -> tuple[Array, Array]:
    """Return the residuals of the priors (..., N, 3) and of the frames (..., N - 1, 3), in standard deviations."""
    poses = np.asarray(poses, dtype=float)
    prior = poses - np.asarray(od, dtype=float)
    frame = se2.relative_pose(poses[..., 1:, :], poses[..., :-1, :]) - np.asarray(relative, dtype=float)
    prior[..., 2], frame[..., 2] = wrap(prior[..., 2]), wrap(frame[..., 2])
    return prior / ODOMETRY_SIGMA, frame / RELATIVE_SIGMA


def jacobian(poses: ArrayLike, priors: ArrayLike) -> Array:
    """Return the derivatives (..., 6 N - 3, 3 N) of the residuals by all poses (..., N, 3): priors, then frames.

    priors: (..., N), which axles' priors count; the rows of the others are 0.
    """
    poses, priors = np.asarray(poses, dtype=float), np.asarray(priors)
    n = poses.shape[-2]
    matrix = np.zeros((*poses.shape[:-2], 2 * n - 1, 3, n, 3))
    seen = se2.relative_pose(poses[..., 1:, :], poses[..., :-1, :])
    cos, sin = np.cos(poses[..., 1:, 2]), np.sin(poses[..., 1:, 2])
    for i in range(n):
        for k in range(3):
            matrix[..., i, k, i, k] = priors[..., i] / ODOMETRY_SIGMA[k]
    for f in range(n - 1):
        c, s, row = cos[..., f], sin[..., f], matrix[..., n + f, :, :, :]
        row[..., 0, f, 0], row[..., 0, f, 1] = c, s
        row[..., 1, f, 0], row[..., 1, f, 1] = -s, c
        row[..., 2, f, 2] = 1.0
        row[..., f + 1, :] = -row[..., f, :]
        # Turning the rear axle turns what it sees the other way.
        row[..., 0, f + 1, 2], row[..., 1, f + 1, 2] = seen[..., f, 1], -seen[..., f, 0]
        row /= RELATIVE_SIGMA[:, None, None]
    return matrix.reshape(*poses.shape[:-2], 3 * (2 * n - 1), 3 * n)


def gauss_newton(
    od: ArrayLike, relative: ArrayLike, *, priors: bool | ArrayLike = True, start: ArrayLike | None = None
) -> Solution:
    """Return the poses (..., N, 3) that fit OD poses (..., N, 3) and relative poses (..., N - 1, 3) best.

    priors: whether OD poses count, for all axles or each (..., N). start: where to begin, (..., N, 3); None: at the OD
    poses. Without any prior the start is returned, not converged, with the rank that shows why.
    """
    od, relative = np.asarray(od, dtype=float), np.asarray(relative, dtype=float)
    first = od if start is None else np.asarray(start, dtype=float)
    n = od.shape[-2]
    axes = np.broadcast_shapes(first.shape[:-2], od.shape[:-2], relative.shape[:-2], np.shape(priors)[:-1])
    used = np.broadcast_to(np.asarray(priors), (*axes, n))
    poses = next_to(od[..., 2], np.broadcast_to(first, (*axes, n, 3)))
    anchored = used.any(axis=-1)
    # The prior of a single axle holds the train in place: then all 3 N unknowns are determined.
    h = jacobian(poses, used)
    rank = np.linalg.matrix_rank(h) if not anchored.all() else np.full(axes, 3 * n)
    iterations, step = 0, np.full_like(poses, np.inf)
    while anchored.all() and iterations < MOST_ITERATIONS and np.abs(step).max(initial=0.0) > CONVERGED:
        r = _stacked(poses, od, relative, used)
        transposed = np.swapaxes(h, -1, -2)
        step = -np.linalg.solve(transposed @ h, transposed @ r[..., None])[..., 0].reshape(poses.shape)
        poses = poses + step
        h = jacobian(poses, used)
        iterations += 1
    cost = np.sum(_stacked(poses, od, relative, used) ** 2, axis=-1)
    converged = bool(np.abs(step).max(initial=0.0) <= CONVERGED)
    return Solution(next_to(od[..., 2], poses), cost, iterations, converged, rank)


class TrainLeastSquares:
    """At intervals replaces the OD poses by the least-squares fit of all data; odometry goes on from it.

    interval: sample periods between corrections. solution: the last correction's, None before. status: why relative
    poses cannot be used now, or None.
    """

    def __init__(self, interval: int = DEFAULT_INTERVAL) -> None:
        self.interval = checked_interval(interval)

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises InputError for anything but a train, and for poses of another shape."""
        self._configuration = Configuration(train, poses, self.interval)
        self.solution: Solution | None = None

    @property
    def status(self) -> str | None:
        """Which frame's relative pose cannot be used now, and why; None while all can."""
        return self._configuration.status

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (N, 3)."""
        relative = self._configuration.advance(observation)
        if relative is not None:
            self.solution = gauss_newton(self._configuration.poses, relative)
            self._configuration.correct(self.solution.poses)
        return self._configuration.poses.copy()


def _stacked(poses: Array, od: Array, relative: Array, used: NDArray[np.bool_]) -> Array:
    """Return all residuals (..., 6 N - 3) in the order of `jacobian`, 0 for priors that do not count."""
    prior, frame = residuals(poses, od, relative)
    rows = np.concatenate([prior * used[..., None], frame], axis=-2)
    return rows.reshape(*rows.shape[:-2], -1)


ESTIMATORS = {"train-least-squares": TrainLeastSquares}
