"""What a robot in good order shows of each effect, differently in each log, and how logs speak beside that.

Sizes in log l are ``b + beta_l``, with ``beta_l ~ N(background, scatter)``: no model is right, and no motion the same.
Before clean logs are seen, background and scatter each have half of the variance that an effect's tolerance states, and
the background is expected to be none; clean logs tell both.
Every log comes as information and score, of the log-likelihood ``score . b - b . information b / 2``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from discrepancy.posterior.calibrated import FAULT, FREEDOM, REFITTED, SIGNATURE

ROUNDS, SETTLED = 60, 0.01
"""Most steps of expectation and maximisation, and the part of a variance by which none changes in the end."""


class Statistics(NamedTuple):
    """What logs say of m sizes, all else integrated out: information (m, m) and score (m,) at sizes of 0."""

    information: Array
    score: Array

    def at(self, size: Array) -> "Statistics":
        """Return the statistics as functions of what sizes are beyond `size` (m,)."""
        return Statistics(self.information, self.score - self.information @ size)

    def scattered(self, scatter: Array) -> "Statistics":
        """Return what is said of the mean of sizes that scatter about it by a covariance (m, m)."""
        blurred = np.eye(len(self.score)) + self.information @ scatter
        both: Array = np.linalg.solve(blurred, np.column_stack([self.information, self.score])).astype(np.float64)
        return Statistics((both[:, :-1] + both[:, :-1].T) / 2, both[:, -1])

    def doubted(self, far: Array, modelled: Array) -> "Statistics":
        """Return what is said where signatures are wrong by a part of what effects explain.

        far, modelled (m,): sizes that are believed but not in the model, and those that are.
        """
        wrong = SIGNATURE**2 * (far @ self.information @ far) + REFITTED**2 * (modelled @ self.information @ modelled)
        return Statistics(self.information / (1 + wrong), self.score / (1 + wrong))


@dataclass(frozen=True, eq=False)
class GoodOrder:
    """What robots in good order show: the sizes in a log are normal about ``background`` (m,), which is known with the
    covariance ``doubt`` (m, m), and scatter about it from log to log by the covariance ``scatter`` (m, m)."""

    background: Array
    doubt: Array
    scatter: Array

    def beyond(self, logs: Sequence[Statistics]) -> Statistics:
        """Return what logs say together of sizes beyond good order."""
        each = [log.at(self.background).scattered(self.scatter) for log in logs]
        return together(each).scattered(self.doubt)


def together(logs: Sequence[Statistics]) -> Statistics:
    """Return what independent logs say together."""
    information, score = (np.sum([log[k] for log in logs], axis=0) for k in (0, 1))
    return Statistics(np.asarray(information), np.asarray(score))


def good_order(tolerance: Array, pattern: Array, clean: Sequence[Statistics] = ()) -> GoodOrder:
    """Return what robots in good order show, given logs of one, if there are any.

    tolerance (C,): standard deviations of each of C effects' sizes. pattern (p, p): covariance of the p sizes that each
    effect has in b, which are the first C of m = p C, then the second ones, and so on, where the effect's is 1.

    By expectation and maximisation: the background of each effect is normal about 0 and its scatter normal about the
    background, each of a variance that has an inverse gamma distribution about half of the tolerance's square.
    """
    usual = tolerance**2
    begin = FAULT**2 if clean else 1.0  # from above: what begins too small is not believed, and stays so
    scatter, between = begin * usual / 2, begin * usual / 2
    first = np.arange(len(usual))
    background, doubt = np.zeros(len(pattern) * len(first)), _spread(pattern, between)
    for _ in range(ROUNDS if clean else 0):
        blurred = _spread(pattern, scatter)
        background, doubt = _posterior(together([log.scattered(blurred) for log in clean]), _spread(pattern, between))
        squares = np.zeros(len(first))
        for log in clean:
            away, unsure = _posterior(log.at(background), blurred)
            follows = unsure @ log.information
            unsure = unsure + follows @ doubt @ follows.T
            squares += away[first] ** 2 + unsure[first, first]
        last = np.concatenate([scatter, between])
        scatter = (FREEDOM * usual / 2 + squares) / (FREEDOM + len(clean))
        between = (FREEDOM * usual / 2 + background[first] ** 2 + doubt[first, first]) / (FREEDOM + 1)
        if np.all(np.abs(np.concatenate([scatter, between]) / last - 1) < SETTLED):
            break
    return GoodOrder(background, doubt, _spread(pattern, scatter))


def log_likelihood_of(parts: Array, logs: Sequence[Statistics], tolerance: Array, pattern: Array) -> Array:
    """Return how likely logs without faults are (natural logarithm, up to a constant) of a robot whose order is better
    than all tolerances state, by parts (k,) of these.

    As `good_order` has it, but of all effects together: few of them show, and all that do not tell how good it is.
    """
    root = np.kron(np.linalg.cholesky(pattern + 1e-12 * np.eye(len(pattern))), np.diag(tolerance))
    log_likelihood = np.zeros(len(parts))
    for log in logs:
        strength, way = np.linalg.eigh(root.T @ log.information @ root)
        strength, pull = np.maximum(strength, 0.0), (way.T @ (root.T @ log.score)) ** 2
        grown = 1 + parts[:, None] ** 2 * strength
        log_likelihood += np.sum(parts[:, None] ** 2 * pull / grown - np.log(grown), axis=1) / 2
    return log_likelihood


def _spread(pattern: Array, variance: Array) -> Array:
    """Return the covariance (m, m) of sizes of which effects have these variances (C,)."""
    return np.kron(pattern, np.diag(variance)).astype(np.float64)


def _posterior(said: Statistics, prior: Array) -> tuple[Array, Array]:
    """Return mean (m,) and covariance (m, m) of sizes with a normal prior about 0."""
    covariance: Array = np.linalg.solve(np.eye(len(prior)) + prior @ said.information, prior).astype(np.float64)
    covariance = (covariance + covariance.T) / 2
    return covariance @ said.score, covariance
