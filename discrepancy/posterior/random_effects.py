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
from scipy.sparse import csr_array

from castor_envs.geometry.arrays import Array
from discrepancy.posterior.calibrated import FAULT, FREEDOM, REFITTED, SIGNATURE

ROUNDS, CONVERGED = 60, 0.01
"""Most steps of expectation and maximisation, and the relative change of variances at which they end."""


class Statistics(NamedTuple):
    """Sufficient statistics of m sizes, nuisances integrated out: information (m, m) and score (m,) at sizes of 0."""

    information: Array
    score: Array

    def at(self, size: Array) -> "Statistics":
        """Return the statistics of the difference between sizes and `size` (m,)."""
        return Statistics(self.information, self.score - self.information @ size)

    def scattered(self, scatter: Array) -> "Statistics":
        """Return the statistics of the mean of sizes that scatter about it by a covariance (m, m)."""
        blurred = np.eye(len(self.score)) + self.information @ scatter
        solved: Array = np.linalg.solve(blurred, np.column_stack([self.information, self.score])).astype(np.float64)
        return Statistics((solved[:, :-1] + solved[:, :-1].T) / 2, solved[:, -1])

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

    def beyond(self, logs: Sequence[Statistics]) -> Statistics:
        """Return the joint statistics of logs for sizes beyond good order."""
        scattered = [log.at(self.background).scattered(self.scatter) for log in logs]
        return summed(scattered).scattered(self.doubt)


def summed(logs: Sequence[Statistics]) -> Statistics:
    """Return the joint statistics of independent logs."""
    information, score = (np.sum([log[k] for log in logs], axis=0) for k in (0, 1))
    return Statistics(np.asarray(information), np.asarray(score))


def good_order(tolerance: Array, pattern: Array, clean: Sequence[Statistics] = ()) -> GoodOrder:
    """Return the distribution of sizes in robots in good order, updated by clean logs if there are any.

    tolerance (C,): standard deviations of each of C effects' sizes. pattern (p, p): covariance of the p sizes that each
    effect has in b, which are the first C of m = p C, then the second ones, and so on, where the effect's is 1.

    By expectation and maximisation: the background of each effect is normal about 0 and its scatter normal about the
    background, each of a variance that has an inverse gamma distribution about half of the tolerance's square.
    """
    usual, first = tolerance**2, np.arange(len(tolerance))
    begin = FAULT**2 if clean else 1.0  # from above: a variance that begins too small would stay so
    scatter, between = begin * usual / 2, begin * usual / 2
    background, doubt = np.zeros(len(pattern) * len(usual)), _spread(pattern, between)
    for _ in range(ROUNDS if clean else 0):
        by_log = [_Scattered.of(log, pattern, scatter) for log in clean]
        about_zero = _Scattered.of(summed([log.of_mean for log in by_log]), pattern, between)
        background, doubt = about_zero.mean, about_zero.covariance
        squares = np.zeros(len(usual))
        for log in by_log:
            away, follows = log.mean - log.follows @ background, log.follows[first]
            squares += away[first] ** 2 + log.covariance[first, first] + np.sum(follows @ doubt * follows, axis=1)
        last = np.concatenate([scatter, between])
        scatter = (FREEDOM * usual / 2 + squares) / (FREEDOM + len(clean))
        between = (FREEDOM * usual / 2 + background[first] ** 2 + doubt[first, first]) / (FREEDOM + 1)
        if np.all(np.abs(np.concatenate([scatter, between]) / last - 1) < CONVERGED):
            break
    return GoodOrder(background, doubt, _spread(pattern, scatter))


class _Scattered(NamedTuple):
    """A log whose sizes scatter about a mean: the statistics of the mean (`Statistics.scattered`), and, where the mean
    is 0, the posterior mean (m,) of the sizes and their covariance (m, m).

    follows (m, m): by how much nearer to 0 the sizes' differences from the mean are, per unit of the mean.
    """

    of_mean: Statistics
    mean: Array
    covariance: Array
    follows: Array

    @classmethod
    def of(cls, log: Statistics, pattern: Array, variance: Array) -> "_Scattered":
        """Return this for the variances (C,) of sizes.

        With R, the root of their covariance, and I, the information, all follows from the inverse of 1 + R' I R.
        """
        from scipy.linalg import lapack  # slow to import

        root, inverse_root = (
            np.kron(mixing, np.diag(scale))
            for mixing, scale in (
                (np.linalg.cholesky(pattern), np.sqrt(variance)),
                (np.linalg.inv(np.linalg.cholesky(pattern)), 1 / np.sqrt(variance)),
            )
        )
        root, inverse_root = csr_array(root), csr_array(inverse_root)
        factor, _ = lapack.dpotrf(np.eye(len(log.score)) + (root.T @ (root.T @ log.information).T), lower=True)
        kept = np.tril(lapack.dpotri(factor, lower=True)[0])
        kept = kept + np.tril(kept, -1).T
        lost = np.eye(len(kept)) - kept
        of_mean = Statistics(inverse_root.T @ (inverse_root.T @ lost).T, inverse_root.T @ (kept @ (root.T @ log.score)))
        covariance = root @ (root @ kept).T
        return cls(of_mean, covariance @ log.score, covariance, root @ (inverse_root.T @ lost).T)


def log_likelihood_of(parts: Array, logs: Sequence[Statistics], tolerance: Array, pattern: Array) -> Array:
    """Return the log-likelihood (k,) (natural logarithm, up to a constant) of clean logs where all tolerances are
    multiplied by each of the factors `parts` (k,).

    The model is that of `good_order`, but with one factor for all effects: few of them are visible, and also the
    effects that are not visible are evidence of how small the tolerances are.
    """
    root = np.kron(np.linalg.cholesky(pattern + 1e-12 * np.eye(len(pattern))), np.diag(tolerance))
    log_likelihood = np.zeros(len(parts))
    for log in logs:
        strength, way = np.linalg.eigh(root.T @ log.information @ root)
        strength, squared_score = np.maximum(strength, 0.0), (way.T @ (root.T @ log.score)) ** 2
        grown = 1 + parts[:, None] ** 2 * strength
        log_likelihood += np.sum(parts[:, None] ** 2 * squared_score / grown - np.log(grown), axis=1) / 2
    return log_likelihood


def _spread(pattern: Array, variance: Array) -> Array:
    """Return the covariance (m, m) of the sizes of effects with these variances (C,)."""
    return np.kron(pattern, np.diag(variance)).astype(np.float64)
