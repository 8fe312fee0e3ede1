"""Who is better, and whether the cases show it: paired bootstrap over cases, shared ranks.

All estimators are scored on the same cases, so the cases are resampled, all estimators together (Efron and Tibshirani,
"An Introduction to the Bootstrap", 1993: percentile intervals). What counts for a rank is the interval of the paired
difference of two means, which is far narrower than their own intervals suggest.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array

RESAMPLES = 4000
LEVEL = 0.95
FEWEST_CASES = 6
"""With fewer cases no difference can be shown at this level: a paired sign-flip test of n cases has p >= 2 / 2^n."""


@dataclass(frozen=True)
class Interval:
    """A mean over cases with its bootstrap interval; low and high are None where there are too few cases for one."""

    mean: float
    low: float | None
    high: float | None


def resampled_means(scores: ArrayLike, seed: int = 0, resamples: int = RESAMPLES) -> Array:
    """Return the means (resamples, ...) over resampled cases of scores (cases, ...): one resampling for all columns."""
    scores = np.asarray(scores, dtype=float)
    return np.tensordot(_weights(len(scores), seed, resamples), scores, axes=1)


@lru_cache(maxsize=4)
def _weights(cases: int, seed: int, resamples: int) -> Array:
    """Return how much each case counts in each resampling, (resamples, cases)."""
    drawn = np.random.default_rng(seed).integers(cases, size=(resamples, cases))
    weights = np.zeros((resamples, cases))
    np.add.at(weights, (np.arange(resamples)[:, None], drawn), 1.0 / cases)
    return weights


def interval(scores: ArrayLike, seed: int = 0) -> Interval:
    """Return the mean of scores (cases,) with its percentile interval."""
    scores = np.asarray(scores, dtype=float)
    if len(scores) < FEWEST_CASES:
        return Interval(float(np.mean(scores)), None, None)
    low, high = _percentiles(resampled_means(scores, seed))
    return Interval(float(np.mean(scores)), float(low), float(high))


def ranks(scores: Mapping[str, ArrayLike], seed: int = 0) -> dict[str, int]:
    """Return a rank for each name, best first; scores are errors on the same cases, in the same order.

    From the smallest mean on: whoever's paired difference to the best of the current group has an interval that
    includes 0 belongs to the group and shares its rank; the next one opens a group, whose rank counts all before it
    (1, 1, 3). Differences of 1e-9 of a score are none: algebraically equal estimators differ by rounding.
    """
    given = {name: np.asarray(values, dtype=float) for name, values in scores.items()}
    names = sorted(given, key=lambda name: (np.mean(given[name]), name))
    if not names:
        return {}
    table = np.stack([given[name] for name in names])
    means = resampled_means(table.T, seed)
    best, found = 0, {}
    for k, name in enumerate(names):
        differs = table.shape[1] >= FEWEST_CASES and _percentiles(means[:, k] - means[:, best])[0] > 1e-9 * np.mean(
            table[best]
        )
        if differs:
            best = k
        found[name] = best + 1
    return found


def _percentiles(values: Array) -> tuple[float, float]:
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
