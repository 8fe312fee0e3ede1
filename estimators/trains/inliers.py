"""Truncated least squares over inlier sets: which axles' odometry to believe, considering all axles together.

An alternative to GRPEC of this project, from no paper. Relative poses always count. An axle's OD pose counts by its
squared residuals, as in Method 2 (`train_least_squares`), or, if the axle is an outlier, as the constant
`OUTLIER_COST`. Of all 2^N - 1 sets of inliers the one with the smallest cost wins, so that the fit ignores axles that
slipped.

Each set is tried by a filter that runs down the train from its first inlier, one small step an axle, all sets at
once; the best ones are then solved exactly.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.trains.configuration import DEFAULT_INTERVAL, Configuration, checked_interval
from estimators.trains.grpec import attached
from estimators.trains.least_squares import Solution, gauss_newton
from estimators.trains.pose_noise import ODOMETRY_SIGMA, RELATIVE_SIGMA

OUTLIER_COST = 16.27
"""Cost of leaving out an axle: a sound axle's three squared residuals add up to more in 0.1 % of all cases."""

NEAR_TIE = 1.0
"""Costs that differ by less do not decide: the odds of two Gaussian explanations are then below e^(1/2), 1.6 to 1.
Single inliers tie exactly: each fits its own OD pose and all relative poses."""

WIDE = 12.0
"""Sets whose cost by the filter differs from the smallest by at most this are solved exactly."""

MOST_SOLVED = 12
"""Sets that are solved exactly, at most."""


def inlier_costs(od: ArrayLike, relative: ArrayLike) -> tuple[NDArray[np.bool_], Array]:
    """Return all sets of inliers (S, N), S = 2^N - 1, and the cost (S,) of each.

    od: (N, 3), relative: (N - 1, 3). The filter is linearised once at each axle: costs near the smallest are right to
    some per cent, large costs only roughly.
    """
    od, relative = np.asarray(od, dtype=float), np.asarray(relative, dtype=float)
    n = len(od)
    prior, noise = np.diag(ODOMETRY_SIGMA**2), np.diag(RELATIVE_SIGMA**2)
    # For the inlier sets of the axles so far: the estimate of the present axle.
    sets, mean, covariance, cost = np.zeros((0, n), dtype=bool), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0)
    for i in range(n):
        if i > 0:
            seen = se2.inverse(relative[i - 1])
            before, mean = mean, se2.compose(mean, seen)
            by_front, by_frame = _derivatives(before, mean)
            covariance = by_front @ covariance @ np.swapaxes(by_front, -1, -2)
            covariance = covariance + by_frame @ noise @ np.swapaxes(by_frame, -1, -2)
        surprise = od[i] - mean
        surprise[:, 2] = wrap(surprise[:, 2])
        gain = covariance @ (information := np.linalg.inv(covariance + prior))
        distance = np.einsum("si,sij,sj->s", surprise, information, surprise)
        inlier = np.zeros(n, dtype=bool)
        inlier[i] = True
        sets = np.concatenate([sets, sets | inlier, inlier[None]])
        mean = np.concatenate([mean, mean + np.einsum("sij,sj->si", gain, surprise), od[i][None]])
        covariance = np.concatenate([covariance, covariance - gain @ covariance, prior[None]])
        cost = np.concatenate([cost + OUTLIER_COST, cost + distance, [OUTLIER_COST * i]])
    return sets, cost


def best_fit(od: ArrayLike, relative: ArrayLike) -> tuple[Solution, NDArray[np.bool_]]:
    """Return the poses (N, 3) of the best fit, and which axles (N,) are its inliers.

    Among sets whose costs are within `NEAR_TIE` of the smallest, the fit wins whose positions are nearest to all OD
    positions (the sum of eqs. 3 and 5 of Vogt and Minor, theta_xy: of a single inlier it is that of its attachment).
    """
    od = np.asarray(od, dtype=float)
    sets, cost = inlier_costs(od, relative)
    near = np.argsort(cost, kind="stable")[:MOST_SOLVED]
    sets = sets[near[cost[near] <= cost[near[0]] + WIDE]]
    solved = gauss_newton(od, relative, priors=sets, start=attached(od, relative)[np.argmax(sets, axis=-1)])
    cost = solved.cost + OUTLIER_COST * np.sum(~sets, axis=-1)
    theta_xy = np.hypot(solved.poses[..., 0] - od[:, 0], solved.poses[..., 1] - od[:, 1]).sum(axis=-1)
    k = np.argmin(np.where(cost <= cost.min() + NEAR_TIE, theta_xy, np.inf))
    return Solution(solved.poses[k], cost[k], solved.iterations, solved.converged, solved.rank[k]), sets[k]


class InlierLeastSquares:
    """At intervals replaces the OD poses by the best fit of all inlier sets; odometry goes on from it.

    interval: sample periods between corrections. inliers: the axles (from 1) whose odometry the last correction
    used, None before. status: why relative poses cannot be used now, or None.
    """

    def __init__(self, interval: int = DEFAULT_INTERVAL) -> None:
        self.interval = checked_interval(interval)

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises InputError for anything but a train, and for poses of another shape."""
        self._configuration = Configuration(train, poses, self.interval)
        self.inliers: tuple[int, ...] | None = None

    @property
    def status(self) -> str | None:
        """Which frame's relative pose cannot be used now, and why; None while all can."""
        return self._configuration.status

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (N, 3)."""
        relative = self._configuration.advance(observation)
        if relative is not None:
            solution, inliers = best_fit(self._configuration.poses, relative)
            self.inliers = tuple(int(i) + 1 for i in np.flatnonzero(inliers))
            self._configuration.correct(solution.poses)
        return self._configuration.poses.copy()


def _derivatives(front: Array, rear: Array) -> tuple[Array, Array]:
    """Return how the rear axle's pose (..., 3, 3) changes with the front axle's, and with the frame's relative pose."""
    x, y = front[..., 0] - rear[..., 0], front[..., 1] - rear[..., 1]
    cos, sin = np.cos(rear[..., 2]), np.sin(rear[..., 2])
    zeros, ones = np.zeros_like(x), np.ones_like(x)
    by_front = [[ones, zeros, y], [zeros, ones, -x], [zeros, zeros, ones]]
    by_frame = [[-cos, sin, -y], [-sin, -cos, x], [zeros, zeros, -ones]]
    return _matrices(by_front), _matrices(by_frame)


def _matrices(rows: list[list[Array]]) -> Array:
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


ESTIMATORS = {"inlier-least-squares": InlierLeastSquares}
