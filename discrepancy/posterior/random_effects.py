"""Random effects: how much of each effect a robot in good order shows, differently in each log; statistics beyond that.

Sizes in log l are ``b + beta_l``, with ``beta_l ~ N(background, scatter)``: no model is exact, and no two motions are
the same. Without clean logs, background and scatter each have half of the variance that an effect's tolerance states,
and the background has mean 0; clean logs update both. Every log is given by information and score of the log-likelihood
``score . b - b . information b / 2``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from discrepancy.posterior.calibrated import FAULT, FREEDOM, REFITTED, SIGNATURE
from estimators.likelihood.statistics import scattered

ROUNDS, CONVERGED = 60, 0.01
"""Most steps of expectation and maximisation, and the relative change of variances at which they end."""

SEEN = 1e-6
"""Least strength, as a part of the largest, of a combination of sizes that logs determine."""


class Statistics(NamedTuple):
    """Sufficient statistics of m sizes, nuisances integrated out: information (m, m) and score (m,) at sizes of 0."""

    information: Array
    score: Array

    def at(self, size: Array) -> "Statistics":
        """Return the statistics of the difference between sizes and `size` (m,)."""
        return Statistics(self.information, self.score - self.information @ size)

    def gain(self, size: Array) -> float:
        """Return the log-likelihood ratio (natural logarithm) of sizes (m,) against 0."""
        return float(self.score @ size - size @ self.information @ size / 2)

    def of_combinations(self, basis: Array) -> "Statistics":
        """Return the statistics of the combinations a of sizes, where the sizes are basis (m, m) times a."""
        return Statistics(basis.T @ self.information @ basis, basis.T @ self.score)

    def scattered(self, scatter: Array) -> "Statistics":
        """Return the statistics of the mean of sizes that scatter about it by a covariance (m, m)."""
        return Statistics(*scattered(*self, scatter))

    def doubted(self, far: Array, modelled: Array) -> "Statistics":
        """Return the statistics with the error of signatures, a part of what effects explain, added to the noise.

        far, modelled (m,): expected sizes that are not in the model, and sizes in the model.
        """
        wrong = SIGNATURE**2 * (far @ self.information @ far) + REFITTED**2 * (modelled @ self.information @ modelled)
        return Statistics(self.information / (1 + wrong), self.score / (1 + wrong))


@dataclass(frozen=True, eq=False)
class GoodOrder:
    """Distribution of sizes in robots in good order: in a log they are normal about ``background`` (m,), which is known
    with the covariance ``doubt`` (m, m), and scatter about it from log to log with the covariance ``scatter`` (m,
    m)."""

    background: Array
    doubt: Array
    scatter: Array

    def of_sizes(self, basis: Array) -> "GoodOrder":
        """Return the distribution of the sizes that are basis (m, m) times those that this one is about."""
        doubt, scatter = (basis @ covariance @ basis.T for covariance in (self.doubt, self.scatter))
        return GoodOrder(basis @ self.background, doubt, scatter)

    def beyond(self, logs: Sequence[Statistics]) -> Statistics:
        """Return the joint statistics of logs for sizes beyond good order."""
        scattered = [log.at(self.background).scattered(self.scatter) for log in logs]
        return summed(scattered).scattered(self.doubt)


def agreeing(logs: Sequence[Statistics], lasting: NDArray[np.intp]) -> list[Statistics]:
    """Return the statistics of logs with the noise of lasting effects by how well the logs agree on them.

    lasting: numbers of the sizes of effects that add up over a whole log, as a wheel's radius does. Noise is estimated
    from one reference pose to the next. If it is not white, as where a tracker errs by place, it adds up otherwise:
    measured logs agree on radii several times better than white noise lets them. A factor on the information along the
    signatures of these effects has a gamma prior about 1, of `FREEDOM` degrees of freedom, which deviations of single
    logs from their joint sizes update. One log alone stays as it is, and so do logs that agree worse: what is missing
    in some of them is for other hypotheses to say.
    """
    if len(logs) < 2 or not len(lasting):
        return list(logs)
    blocks = [log.information[np.ix_(lasting, lasting)] for log in logs]
    scale = 1 / np.sqrt(np.maximum(np.diag(np.sum(blocks, axis=0)), 1e-300))
    strength, way = np.linalg.eigh(np.sum(blocks, axis=0) * np.outer(scale, scale))
    seen = scale[:, None] * way[:, strength > SEEN * strength.max()]  # combinations of sizes that the logs determine
    along = [(seen.T @ block @ seen, seen.T @ log.score[lasting]) for block, log in zip(blocks, logs, strict=True)]
    inverse = [np.linalg.pinv(information, rcond=SEEN, hermitian=True) for information, _ in along]
    joint = np.linalg.solve(np.sum([information for information, _ in along], axis=0), np.sum([s for _, s in along], 0))
    left = [score - information @ joint for information, score in along]
    squares = sum(float(part @ by @ part) for part, by in zip(left, inverse, strict=True))
    freedom = sum(np.linalg.matrix_rank(information, SEEN, hermitian=True) for information, _ in along) - seen.shape[1]
    more = max((FREEDOM + freedom) / (FREEDOM + squares) - 1, 0.0)
    agreed = []
    for log, by in zip(logs, inverse, strict=True):
        onto = log.information[:, lasting] @ seen @ by
        information = log.information + more * onto @ (seen.T @ log.information[lasting])
        score = log.score + more * onto @ (seen.T @ log.score[lasting])
        agreed.append(Statistics((information + information.T) / 2, score))
    return agreed


def summed(logs: Sequence[Statistics]) -> Statistics:
    """Return the joint statistics of independent logs."""
    information, score = (np.sum([log[k] for log in logs], axis=0) for k in (0, 1))
    return Statistics(np.asarray(information), np.asarray(score))


def good_order(tolerance: Array, clean: Sequence[Statistics] = (), alike: NDArray[np.intp] | None = None) -> GoodOrder:
    """Return the distribution of sizes in robots in good order, updated by clean logs if there are any.

    tolerance (m,): standard deviations of the sizes, which are independent. alike (m,): number of the group of each, as
    of the latencies of all castors; sizes of a group scatter alike, in parts of their tolerances. None: each by itself.

    The background of each size is normal about 0 and its scatter normal about the background, each of a variance that
    has an inverse gamma distribution about half of the tolerance's square. The most likely variances are found by
    MacKay's fixed point (Neural Computation 4(3), 1992).
    """
    groups = np.arange(len(tolerance)) if alike is None else alike
    usual = tolerance**2
    begin = FAULT**2 if clean else 1.0  # from above: a variance that begins too small would stay so
    scatter, between = begin * usual / 2, begin * usual / 2
    background, doubt = np.zeros(len(usual)), np.diag(between)
    for _ in range(ROUNDS if clean else 0):
        by_log = [_Scattered(log, scatter) for log in clean]
        about_zero = _Scattered(summed([log.of_mean for log in by_log]), between)
        background, doubt = about_zero.mean, about_zero.covariance
        squares, shown = np.zeros(len(usual)), np.zeros(len(usual))
        for log in by_log:
            away = log.mean - log.follows @ background
            squares += (away**2 + np.sum(log.follows @ doubt * log.follows, axis=1)) / usual
            shown += 1 - np.diag(log.covariance) / scatter
        last = np.concatenate([scatter, between])
        squares, shown = np.bincount(groups, squares), np.bincount(groups, shown)
        scatter = usual * ((FREEDOM / 2 + squares) / (FREEDOM + shown))[groups]
        between = (FREEDOM * usual / 2 + background**2 + np.diag(doubt)) / (FREEDOM + 1)
        if np.all(np.abs(np.concatenate([scatter, between]) / last - 1) < CONVERGED):
            break
    return GoodOrder(background, doubt, np.diag(scatter))


class _Scattered:
    """A log whose sizes scatter about a mean: the statistics of the mean (`Statistics.scattered`), and, where the mean
    is 0, the posterior mean (m,) of the sizes and their covariance (m, m).

    follows (m, m): by how much nearer to 0 the sizes' differences from the mean are, per unit of the mean.
    """

    def __init__(self, log: Statistics, variance: Array) -> None:
        """variance (m,): of the sizes.

        With R, the root of their covariance, and I, the information, all follows from the inverse of 1 + R' I R.
        """
        from scipy.linalg import get_lapack_funcs  # slow to import

        root, factor = np.sqrt(variance), _root_of_grown(log, variance)
        (inverse_of_product,) = get_lapack_funcs(("potri",), (factor,))
        kept = np.tril(inverse_of_product(factor, lower=True)[0])
        kept = kept + np.tril(kept, -1).T
        lost = np.eye(len(kept)) - kept
        self.of_mean = Statistics(lost / np.outer(root, root), (kept @ (root * log.score)) / root)
        self.covariance: Array = kept * np.outer(root, root)
        self.mean, self.follows = self.covariance @ log.score, lost * root[:, None] / root


def log_likelihood_of(logs: Sequence[Statistics], tolerance: Array) -> float:
    """Return the log-likelihood (natural logarithm, up to a constant) of clean logs whose sizes are independent, each
    normal about 0 with these standard deviations (m,) in each log.

    Few of the sizes are visible, and also those that are not are evidence of how small the tolerances are.
    """
    from scipy.linalg import solve_triangular  # slow to import

    log_likelihood = 0.0
    for log in logs:
        factor = _root_of_grown(log, tolerance**2)
        seen = solve_triangular(factor, tolerance * log.score, lower=True)
        log_likelihood += float(seen @ seen / 2 - np.sum(np.log(np.diag(factor))))
    return log_likelihood


def _root_of_grown(log: Statistics, variance: Array) -> Array:
    """Return the lower Cholesky factor of 1 + R' I R, of the information I and the root R of variances (m,)."""
    root = np.sqrt(variance)
    grown: Array = (np.eye(len(root)) + root[:, None] * log.information * root).astype(np.float64)
    return np.asarray(np.linalg.cholesky(grown), dtype=np.float64)
