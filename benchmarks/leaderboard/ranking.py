"""Which estimator is better, and whether the cases show it: paired tests of all pairs, corrected for their number;
intervals.

All estimators are scored on the same cases, so what counts for a rank is the paired difference of two, which scatters
far less than the scores themselves. The best of many is selected by its score: among equally good estimators the
luckiest looks better than most. So all pairs are tested together.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.geometry.arrays import Array

LEVEL = 0.95
"""Of intervals; 1 - LEVEL is the probability that any two equally good estimators of a board are distinguished."""
FEWEST_CASES = 6
"""With fewer cases no difference can be shown at this level: of their 2^n sign flips, two are as extreme as the cases
themselves when one estimator is better in every case, and 2 / 2^5 is more than 5 %."""
GENERATORS = 11
"""Sign flips are the 2^11 products of so many. That is all of them for up to 11 cases; for more, 5 % are 102 of 2048,
and a p-value near 5 % is that of all flips within 0.5 % (one standard deviation)."""
BLOCK = 5000
"""Cases whose sign flips are in memory at once: 80 MB."""
ROUNDING = 1e-9
"""Relative differences up to this count as none: algebraically equal estimators differ by rounding, and sums of
1e5 terms lose at most 1e-11."""
MOST_NEWTON = 50
"""Steps of Newton's method: far more than it takes, were it not for the rounding of its last digits."""


@dataclass(frozen=True)
class Interval:
    """A mean over cases with its 95 % interval; low and high are None where there are too few cases for one."""

    mean: float
    low: float | None
    high: float | None


def interval(scores: ArrayLike, within: tuple[float, float] = (-math.inf, math.inf)) -> Interval:
    """Return the mean of scores (cases,) with its interval; `within` is where a mean can lie, such as above 0."""
    return intervals(np.asarray(scores, dtype=float)[None], [within])[0]


def intervals(scores: Array, within: Sequence[tuple[float, float]]) -> list[Interval]:
    """Return the means of scores (k, cases) with their intervals; `within` says for each where a mean can lie.

    Student's t, corrected for skewness by Hall's cubic transformation (P. Hall, "On the removal of skewness by
    transformation", J. R. Statist. Soc. B 54, 1992): with the skewness g of n scores, T = (mean - true mean) / s,

        T + g T^2 / 3 + g^2 T^3 / 27 + g / (6 n)

    is symmetric up to terms of 1 / n, so its limits are +-t / sqrt(n), and each has one T. Upper ends are too low where
    few cases spread widely, as log-normally with sigma 1 and more; docs/benchmark.md tells by how much.
    """
    n = scores.shape[1]
    scale = np.max(np.abs(scores), axis=1, initial=0.0, keepdims=True)
    scale[scale == 0] = 1.0  # squares of very large and very small scores stay finite
    values = scores / scale
    mean = np.mean(values, axis=1, keepdims=True)
    if n < FEWEST_CASES:
        return [Interval(of, None, None) for of in (mean * scale)[:, 0].tolist()]
    deviation = np.std(values, axis=1, keepdims=True)
    scatter = (values - mean) / np.where(deviation > 0, deviation, 1.0)
    skewness = np.mean(scatter * scatter * scatter, axis=1, keepdims=True)
    limit = student_t((1 + LEVEL) / 2, n - 1) / math.sqrt(n)
    limits = _before_transformation(np.array([limit, -limit]), skewness, n)
    ends = (mean - limits * deviation * math.sqrt(n / (n - 1))) * scale
    low, high = np.clip(ends.T, *np.transpose(within))
    return list(map(Interval, (mean * scale)[:, 0].tolist(), low.tolist(), high.tolist()))


@lru_cache(maxsize=64)
def student_t(probability: float, freedom: int) -> float:
    """Return the quantile of Student's t distribution, of a probability above a half.

    Newton's method on the finite sums for whole degrees of freedom (M. Abramowitz and I. Stegun, *Handbook of
    Mathematical Functions*, 1964, 26.7.3 and 26.7.4). SciPy has it too, and takes a quarter of a second to import.
    """
    k = np.arange(1, freedom // 2)
    odd = freedom % 2
    ratios = 2 * k / (2 * k + 1) if odd else (2 * k - 1) / (2 * k)
    log_density = math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2) - math.log(math.pi * freedom) / 2
    t = NormalDist().inv_cdf(probability)
    for _ in range(MOST_NEWTON):
        angle = math.atan(t / math.sqrt(freedom))
        cos2 = math.cos(angle) ** 2
        total = 1 + float(np.sum(np.cumprod(ratios * cos2)))
        if freedom == 1:
            within = 2 * angle / math.pi
        elif odd:
            within = 2 / math.pi * (angle + math.sin(angle) * math.cos(angle) * total)
        else:
            within = math.sin(angle) * total
        density = math.exp(log_density - (freedom + 1) / 2 * math.log1p(t * t / freedom))
        step = (probability - (1 + within) / 2) / density
        t += step
        if abs(step) <= 1e-13 * t:
            break
    return t


def ranks(scores: Mapping[str, ArrayLike], rounding: float = 0.0) -> dict[str, int]:
    """Return a rank for each name, best first; scores are errors on the same cases, in the same order.

    From the smallest mean on: an estimator that does not differ significantly from the best of the current group (see
    `different`) belongs to the group and shares its rank; the next estimator opens a new group, whose rank counts all
    before it (1, 1, 3). rounding: differences up to this size, in the scores' unit, count as none.
    """
    given = {name: np.asarray(values, dtype=float) for name, values in scores.items()}
    if not given:
        return {}
    table, scale = _scaled(np.stack(list(given.values())))
    means = dict(zip(given, np.mean(table, axis=1), strict=True))
    names = sorted(given, key=lambda name: (means[name], name))
    place = {name: k for k, name in enumerate(given)}
    differ = different(table[[place[name] for name in names]], rounding / scale)
    best, found = 0, {}
    for k, name in enumerate(names):
        if differ[best, k]:
            best = k
        found[name] = best + 1
    return found


def places(ranks: Mapping[str, int | None]) -> dict[str, float]:
    """Return each name's place on a board, 1 to n: the mean of the places that those who share its rank take together.

    Ranks 1, 1, 1, 4 become places 2, 2, 2, 4: three who share the first rank have not won as one alone has. The places
    of a board always sum to n (n + 1) / 2, so means over boards can be compared (J. Demšar, "Statistical comparisons of
    classifiers over multiple data sets", J. Machine Learning Research 7, 2006). Those without a rank (None) share the
    places behind all who have one.
    """
    order = {name: math.inf if rank is None else rank for name, rank in ranks.items()}
    found = {}
    for name, rank in order.items():
        before = sum(other < rank for other in order.values())
        beside = sum(other == rank for other in order.values())
        found[name] = before + (beside + 1) / 2
    return found


def different(scores: ArrayLike, rounding: float = 0.0) -> NDArray[np.bool_]:
    """Return which estimators' means differ significantly, (estimators, estimators), by scores (estimators, cases).

    Each pair's statistic is u = abs(mean d) / rms d of its paired differences d, from 0 to 1; it grows with Student's
    t, t^2 = (n - 1) u^2 / (1 - u^2), and without any scatter it is 1. If two estimators are equally good, the sign of d
    is a coin's in each case, so u is compared with what flipped signs give, the same flips for all pairs.

    A pair differs if at most 5 % of the flips bring the largest u of all pairs that are not more significant up to the
    pair's u (Westfall and Young's step-down maximum, 1993). The probability that any two equally good ones are told
    apart is then at most 5 %, however many there are and with few cases too, if differences are distributed
    symmetrically.
    """
    table = np.asarray(scores, dtype=float)
    estimators, cases = table.shape
    differ = np.zeros((estimators, estimators), dtype=bool)
    first, second = np.triu_indices(estimators, 1)
    if cases < FEWEST_CASES or not len(first):
        return differ
    d = table[second] - table[first]
    rms = np.sqrt(np.mean(d**2, axis=1))
    level = np.mean(np.abs(table), axis=1)
    real = rms > np.maximum(ROUNDING * np.maximum(level[first], level[second]), rounding)
    d = np.where(real[:, None], d / np.where(real, rms, 1.0)[:, None], 0.0)
    sums = sum(_sign_flips(cases, k) @ d[:, k : k + BLOCK].T for k in range(0, cases, BLOCK))
    flipped = np.abs(sums) / cases  # the first of the flips flips none
    order = np.argsort(flipped[0], kind="stable")
    seen = flipped[0, order]
    largest = np.maximum.accumulate(flipped[:, order], axis=1)
    p = np.mean(largest >= seen - ROUNDING, axis=0)
    p = np.maximum.accumulate(p[::-1])[::-1]  # no pair is more significant than one with a larger u
    shown = order[p <= 1 - LEVEL + ROUNDING]
    differ[first[shown], second[shown]] = differ[second[shown], first[shown]] = True
    return differ


@lru_cache(maxsize=8)
def _sign_flips(cases: int, first: int = 0) -> Array:
    """Return sign flips (flips, cases), +-1, that form a group: the product of any two is one of them too.

    Only with a group is the level exact when not all flips are taken (J. Hemerik and J. Goeman, "Exact testing with
    random group invariance tests", TEST 27, 2018); a fixed random choice of flips keeps it only on average. Of many
    cases only those of a block, from the first on.
    """
    n = min(cases, GENERATORS)
    generators = np.random.default_rng(0).integers(2, size=(n, cases))
    generators[:, :n] = np.eye(n, dtype=int)
    block = 1.0 - 2.0 * generators[:, first : first + BLOCK]
    flips = np.ones((1, block.shape[1]))
    for generator in block:
        flips = np.concatenate([flips, flips * generator])
    return flips


def _before_transformation(limits: Array, skewness: Array, cases: int) -> Array:
    """Return the T (k, 2) that Hall's transformation maps to the given limits (2,), with skewnesses (k, 1)."""
    moved = limits - skewness / (6 * cases)
    linear = np.abs(skewness) < 1e-6  # the transformation is linear to 1e-6 then, and the division would lose digits
    divisor = np.where(linear, 1.0, skewness)
    return np.where(linear, limits, 3 * (np.cbrt(1 + skewness * moved) - 1) / divisor)


def _scaled(values: Array) -> tuple[Array, float]:
    """Return values of size 1 at most and their scale: squares of very large and very small scores stay finite."""
    scale = float(np.max(np.abs(values), initial=0.0)) or 1.0
    return values / scale, scale
