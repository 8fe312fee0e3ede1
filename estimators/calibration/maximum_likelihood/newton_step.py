"""One step of Gauss and Newton's method: of parameters, and of numbers that all logs share, by their joint information.

Changes of parameters on which the logs hold next to no information keep the robot file's numbers (`UNSEEN`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from estimators.likelihood.reduction import Reduced

UNSEEN = 0.03
"""A change of the parameters is unseen if its standard error is larger: as a part of each length, or in rad. Rounding
errors are not quite random, and estimates of hardly seen changes would consist of them."""


class Solution(NamedTuple):
    """step (P, 1 + probes), in scales; shared (n, 1 + probes) and its covariance (n, n): of the factors of creep, if it
    is fitted, and the mount; moved: in standard errors.

    strength (P,), way (P, P): eigenvalues and eigenvectors (columns) of the information, in scales; seen (P,): which
    directions the logs show.
    """

    step: Array
    shared: Array
    shared_covariance: Array
    moved: float
    strength: Array
    way: Array
    seen: NDArray[np.bool_]


def solved(
    reductions: list[Reduced],
    seen_apart: tuple[Array, Array],
    scale: Array,
    shared: Array,
    deviations: Array,
    away: Array,
    farthest: float,
) -> Solution:
    """Return the next step; seen_apart: further information (P, P) and score (P,), in scales; shared (n,): numbers of
    `Solution.shared` beyond their prior means, with prior standard deviations; away (P,): current deviation from the
    robot file, in scales."""
    information = np.sum([reduced.information for reduced in reductions], axis=0)
    gradient = np.sum([reduced.gradient for reduced in reductions], axis=0)
    n = len(scale)
    information[:n, :n] += seen_apart[0] / np.outer(scale, scale)
    gradient[:n, 0] -= seen_apart[1] / scale
    information[n:, n:] += np.diag(deviations**-2.0)
    gradient[n:, 0] += shared / deviations**2
    solved = np.linalg.solve(information[n:, n:], np.column_stack([information[n:, :n], gradient[n:]]))
    eliminated = np.outer(scale, scale) * (information[:n, :n] - information[:n, n:] @ solved[:, :n])
    slope = scale[:, None] * (gradient[:n] - information[:n, n:] @ solved[:, n:])
    strength, way = np.linalg.eigh(eliminated)
    seen = strength > UNSEEN**-2
    along = -(way.T @ slope) / np.where(seen, strength, np.inf)[:, None]
    along[~seen, 0] = -(way.T @ away)[~seen]
    along[:, 0] *= min(1.0, farthest / max(float(np.abs(way @ along[:, 0]).max(initial=0.0)), 1e-12))
    moved = float(np.sqrt(np.sum(along[seen, 0] ** 2 * strength[seen])))
    step = way @ along
    set_by = -(solved[:, n:] + solved[:, :n] @ (scale[:, None] * step))
    by_seen = solved[:, :n] @ (scale[:, None] * way[:, seen])
    covariance = np.linalg.inv(information[n:, n:]) + (by_seen / strength[seen]) @ by_seen.T
    return Solution(step, set_by, covariance, moved, strength, way, seen)
