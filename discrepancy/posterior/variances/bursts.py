"""Counts lost in bursts: whether they keep a steady beat, and which part of what the wheel turns they lose.

How far a wheel turned further than its encoder shows, as the other wheels tell, is folded with a period, and a box that
begins and ends at two phases says when counts are lost (box least squares: Kovacs, Zucker and Mazeh, Astronomy and
Astrophysics 391, 2002). A beat is likely if its box leaves so much less than a loss of the same part all the time, as
of a wheel that is too large, and than counts gained in a box, that no choice among so many boxes makes up for it, if
what else contradicts lasts for `WINDOW`. That the wheel turned further in every burst is chance for any other cause
than lost counts.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.encoders import TickLossBursts
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.measurement.design_matrix import DesignMatrix
from discrepancy.posterior.calibrated import CREDIBLE, LOG_ODDS
from discrepancy.posterior.linearise import Linearised
from estimators.likelihood.disagreement import QUICK, WINDOW, slip_of_row

SELDOM = 0.5
"""Largest part of the time that bursts last: what a wheel does for longer has another cause, as that it slides."""

FEWEST = 3
"""Bursts that make a beat."""

BEGINNING = 100.0
"""s: the part of a log in which all periods are tried; the likeliest one is refined with more and more of the log."""

LEAST_LEFT = 1e-3
"""Part of what is lost that a box leaves at least: steps in which bursts begin and end are lost in part."""

AROUND = 20
"""Number of periods that are tried on either side of a beat's, each farther by a step in all of its bursts."""


class Box(NamedTuple):
    """Bursts of a steady beat: when they start, s after the log begins, their period and how long they last, s; which
    steps (K - 1,) are in them, and the number of the beat (K - 1,) that each step belongs to; and the log Bayes
    factor (natural logarithm) of a fault in them."""

    start: float
    period: float
    width: float
    inside: NDArray[np.bool_]
    number: NDArray[np.intp]
    log_factor: float


class Bursts(NamedTuple):
    """Counts lost in bursts, the standard error of the part lost, and the log odds (natural logarithm) of lost counts
    against another cause."""

    effect: TickLossBursts
    error: float
    log_odds: float


def losses(design: DesignMatrix, row: int) -> tuple[Array, Array]:
    """Return how far the wheel of a row turned further than its encoder shows in every step (K - 1,), and its way, m;
    the way is positive."""
    lost, _ = slip_of_row(design.model, design.geometry, design.state, row)
    way = design.model.rolled(design.geometry, design.state)[:, row] + lost
    return lost * np.sign(way), np.abs(way)


def steady_box(t: Array, lost: Array, way: Array) -> Box | None:
    """Return the likeliest bursts of a steady beat, by what is lost (K - 1,) of the way in steps, m, between times t
    (K,), s; None where nothing is lost, or the log is too short for `FEWEST` bursts."""
    middle, step = (t[1:] + t[:-1]) / 2 - t[0], float(np.median(np.diff(t)))
    if np.ptp(t) < FEWEST * _shortest(step):
        return None
    always = float(lost @ way) ** 2 / max(float(way @ way), 1e-12)
    found, tried = _likeliest(middle, lost, way, step)
    gained, _ = _likeliest(middle, -lost, way, step)
    total, (explained, start, period, width) = float(np.sum(lost**2)), found
    if explained <= 0:
        return None
    left = total - min(explained, (1 - LEAST_LEFT) * total)
    factor = np.ptp(t) / WINDOW / 2 * math.log((total - max(always, gained[0])) / left + 1e-12) - math.log(tried)
    beat = (middle - start) / period
    return Box(start, period, width, beat % 1 * period < width, np.floor(beat).astype(np.intp), float(factor))


_Found = tuple[float, float, float, float]
"""By how much a box lessens the squares of what is lost, m2; when it starts, its period and its width, s."""


def _likeliest(middle: Array, lost: Array, way: Array, step: float) -> tuple[_Found, int]:
    """Return the best box of all periods, and how many boxes were compared at first."""
    whole = float(middle[-1] - middle[0])
    span, coarse = min(whole, BEGINNING), max(QUICK, step)
    begin, shortest, longest = middle < span, _shortest(step), max(span / FEWEST, _shortest(step))
    found, tried = (0.0, 0.0, shortest, 0.0), 1
    for period in np.geomspace(shortest, longest, math.ceil(np.log(longest / shortest) * span / coarse) + 1).tolist():
        box, boxes = _boxed(middle[begin], lost[begin], way[begin], period, coarse, SELDOM * period)
        found, tried = max(found, box), tried + boxes
    while True:
        _, _, known, width = found
        part, periods = middle < span, known + step * known / span * np.arange(-AROUND, AROUND + 1)
        periods = periods[periods >= _shortest(step) / 2]
        found = max(_boxed(middle[part], lost[part], way[part], one, step, 2 * width)[0] for one in periods.tolist())
        if span >= whole:
            return found, tried
        span = min(2 * span, whole)


def _shortest(step: float) -> float:
    """Return the shortest period that is looked for, s, in a log with this step."""
    return 4 * max(QUICK, step)


def _boxed(middle: Array, lost: Array, way: Array, period: float, step: float, longest: float) -> tuple[_Found, int]:
    """Return the best box of a period, and how many boxes were compared, in steps (s) and no longer than `longest`."""
    count = max(round(period / step), 2)
    phase = (middle / period % 1 * count).astype(np.intp)
    sums = [np.bincount(phase, part, count) for part in (lost * way, way**2)]
    sums = [np.concatenate([[0.0], np.cumsum(np.tile(part, 2))]) for part in sums]
    starts = np.arange(count)[:, None]
    lengths = np.arange(1, max(int(min(SELDOM * count, longest / step)), 1) + 1)
    score, information = (of[starts + lengths] - of[starts] for of in sums)
    explained = np.maximum(score, 0.0) ** 2 / np.maximum(information, 1e-12)
    begin, length = np.unravel_index(np.argmax(explained), explained.shape)
    unit = period / count
    best = float(explained[begin, length]), float(begin * unit), period, float(lengths[length] * unit)
    return best, explained.size


def bursts_of(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, row: int, active: Sequence[Array]
) -> Bursts | None:
    """Return the bursts in which the wheel of a row loses counts; None for a castor's row, or if another cause is
    likelier. active: for each log the probability (W,) that the fault is active in a window."""
    k = int(seen.designs[0].model.rows[row])
    if k >= len(robot.wheels):
        return None
    castor, wheel = robot.wheel_places[k]
    ways = [losses(design, row) for design in seen.designs]
    shares = [lost / np.maximum(way, 1e-12) for lost, way in ways]
    fast_steps = [way > np.median(way) / 4 for _, way in ways]  # in slower steps the part lost is uncertain
    box = steady_box(logs[0].t, *ways[0]) if len(logs) == 1 else None
    if box is not None and box.log_factor > LOG_ODDS and np.any(fast := box.inside & fast_steps[0]):
        inside, (start, period, width, _, number, _), seed = shares[0][fast], box, None
        value = float(np.clip(np.median(inside), 0.0, 1.0))
        lost, way = (np.bincount(number[fast] - number.min(), of[fast]) for of in ways[0])
        shown = np.abs(lost) > value / 2 * way
        log_odds = _log_odds(np.full(int(shown.sum()), CREDIBLE), lost[shown] > 0)
    else:
        parts, windows, hits, log_odds = [], [], [], 0.0
        by_log = zip(seen.disagreements, active, ways, shares, fast_steps, strict=True)
        for disagreement, probability, (lost, way), share, fast in by_log:
            windows.append(np.repeat(np.arange(len(probability)), disagreement.steps))
            sums = (np.bincount(windows[-1], part, len(probability)) for part in (lost, way))
            by_window, farthest = (np.asarray(of_window, dtype=np.float64) for of_window in sums)
            fewer = (by_window > 0) & (by_window <= farthest)
            likely = probability > 0.5
            log_odds += _log_odds(*_by_run(likely, probability, np.where(by_window <= farthest, by_window, -by_window)))
            hits.append(fewer & likely)
            parts.append(share[fast & hits[-1][windows[-1]]])
        inside = np.concatenate(parts)
        if log_odds <= 0 or not len(inside):
            return None
        largest = np.sort(inside)[-sum(int(hit.sum()) for hit in hits) :]  # a step of each window, or more
        inside = inside[inside > np.median(largest) / 2]
        value = float(np.clip(np.median(inside), 0.0, 1.0))
        widths = [
            _widths(log.t, hit, window, fast, share / value)
            for hit, window, fast, share, log in zip(hits, windows, fast_steps, shares, logs, strict=True)
        ]
        width = float(np.median(np.concatenate(widths)))
        period, start, seed = sum(float(np.ptp(log.t)) for log in logs) / sum(map(len, widths)), 0.0, 0
        if width > SELDOM * period:
            return None
    error = float(np.std(inside) / np.sqrt(len(inside)))
    effect = TickLossBursts(castor=castor, wheel=wheel, value=value, period=period, width=width, start=start, seed=seed)
    return Bursts(effect, error, log_odds)


def _by_run(likely: NDArray[np.bool_], active: Array, lost: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return for each run of windows (W,) in which a fault is likely the largest probability that it is active there,
    and whether more counts were lost (W,), m, than gained: a fault that lasts is one, however long it lasts."""
    starts = np.flatnonzero(likely & ~np.concatenate([[False], likely[:-1]]))
    if not len(starts):
        return np.zeros(0), np.zeros(0, dtype=bool)
    of_active, of_lost = np.where(likely, active, 0.0), np.where(likely, lost, 0.0)
    return np.maximum.reduceat(of_active, starts), np.add.reduceat(of_lost, starts) > 0


def _log_odds(active: Array, fewer: NDArray[np.bool_]) -> float:
    """Return the log odds (natural logarithm) of lost counts against another cause, given the runs of windows, or
    bursts, (W,) in which the encoder shows less than the wheel turns.

    Where the fault is active, lost counts always show less and another cause does with probability 1/2; where it is
    not, either sign says nothing.
    """
    least = np.finfo(float).tiny  # of a window that certainly contradicts
    return float(np.sum(np.log(np.maximum(1 + np.where(fewer, active, -active), least))))


def _widths(
    t: Array, hit: NDArray[np.bool_], window: NDArray[np.intp], fast: NDArray[np.bool_], share: Array
) -> list[float]:
    """Return how long bursts last, s: one in every run of windows that are hit (W,).

    window (K - 1,): window of each step. fast: steps in which the part lost can be estimated; share: this part,
    relative to the part that bursts lose.
    """
    length, widths = np.diff(t), list[float]()
    near = np.convolve(hit, np.ones(3), "same") > 0  # a burst may begin or end in the neighbouring window
    for run in np.split(np.arange(len(hit)), np.flatnonzero(np.diff(near)) + 1):
        steps = np.flatnonzero(np.isin(window, run) & fast & (share > 0.5)) if near[run[0]] else np.zeros(0, np.intp)
        if not len(steps):
            continue
        around = np.arange(max(steps[0] - 1, 0), min(steps[-1] + 2, len(share)))  # neighbours may be lost in part
        between = (around > steps[0]) & (around < steps[-1])
        weight = np.where(between, 1.0, np.clip(np.where(fast[around], share[around], 0.0), 0.0, 1.0)) * length[around]
        widths.append(float(weight.sum()))
    return widths
