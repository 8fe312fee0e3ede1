"""A wheel's encoder that loses counts in bursts: intermittently, independently of speed.

A wheel may contradict the other wheels intermittently (`at_times`) for many reasons. If it turns further than its
encoder shows wherever it does, counts were lost: any other cause would have either sign with the same probability in
each window. A window in which the fault is likelier active than not counts by the probability that it is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.encoders import TickLossBursts
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.linearise import Linearised
from estimators.likelihood.disagreement import slip_of_row

EVEN, MOSTLY = 0.1, 0.75
"""Largest deviation of bursts from a steady beat, as a part of the period, and the part of bursts that must keep within
it."""


class Bursts(NamedTuple):
    """Counts lost in bursts, the standard error of the part lost, and the log odds (natural logarithm) of lost counts
    against another cause."""

    effect: TickLossBursts
    error: float
    log_odds: float


def bursts_of(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, row: int, active: Sequence[Array]
) -> Bursts | None:
    """Return the bursts in which the wheel of a row loses counts; None for a castor's row, or if another cause is
    likelier. active: for each log the probability (W,) that the fault is active in a window."""
    k = int(seen.designs[0].model.rows[row])
    if k >= len(robot.wheels):
        return None
    shares, parts, fast_steps, windows, hits, log_odds = [], [], [], [], [], 0.0
    for design, disagreement, probability in zip(seen.designs, seen.disagreements, active, strict=True):
        windows.append(np.repeat(np.arange(len(probability)), disagreement.steps))
        lost, _ = slip_of_row(design.model, design.geometry, design.state, row)  # m in each step, as the way
        way = design.model.rolled(design.geometry, design.state)[:, row] + lost
        lost, way = lost * np.sign(way), np.abs(way)
        by_window, farthest = (np.bincount(windows[-1], part, len(probability)) for part in (lost, way))
        fewer = (by_window > 0) & (by_window <= farthest)
        likely = probability > 0.5
        log_odds += _log_odds(probability[likely], fewer[likely])
        hit = fewer & likely
        hits.append(hit)
        fast_steps.append(way > np.median(way) / 4)  # in slower steps the part lost is uncertain
        shares.append(lost / np.maximum(way, 1e-12))
        parts.append(shares[-1][fast_steps[-1] & hit[windows[-1]]])
    inside = np.concatenate(parts)
    if log_odds <= 0 or not len(inside):
        return None
    largest = np.sort(inside)[-sum(int(hit.sum()) for hit in hits) :]  # a step of each window, or more
    inside = inside[inside > np.median(largest) / 2]
    value = float(np.clip(np.median(inside), 0.0, 1.0))
    bursts = [
        _bursts(log.t, hit, window, fast, share / value)
        for log, hit, window, fast, share in zip(logs, hits, windows, fast_steps, shares, strict=True)
    ]
    all_starts, all_widths = zip(*bursts, strict=True)
    beat = _beat(all_starts[0]) if len(logs) == 1 else None
    width = float(np.median(np.concatenate(all_widths)))
    period = sum(float(np.ptp(log.t)) for log in logs) / sum(map(len, all_starts)) if beat is None else beat[1]
    castor, wheel = robot.wheel_places[k]
    effect = TickLossBursts(
        castor=castor,
        wheel=wheel,
        value=value,
        period=period,
        width=min(width, period),
        start=0.0 if beat is None else beat[0],
        seed=0 if beat is None else None,
    )
    return Bursts(effect, float(np.std(inside) / np.sqrt(len(inside))), log_odds)


def _log_odds(active: Array, fewer: NDArray[np.bool_]) -> float:
    """Return the log odds (natural logarithm) of lost counts against another cause, given the windows (W,) in which
    the encoder shows less than the wheel turns.

    Where the fault is active, lost counts always show less and another cause does with probability 1/2; where it is
    not, either sign says nothing.
    """
    least = np.finfo(float).tiny  # of a window that certainly contradicts
    return float(np.sum(np.log(np.maximum(1 + np.where(fewer, active, -active), least))))


def _bursts(
    t: Array, hit: NDArray[np.bool_], window: NDArray[np.intp], fast: NDArray[np.bool_], share: Array
) -> tuple[Array, Array]:
    """Return when bursts start, and how long they last, s: one in every run of windows that are hit (W,).

    window (K - 1,): window of each step. fast: steps in which the part lost can be estimated; share: this part,
    relative to the part that bursts lose.
    """
    middle, length, starts, widths = (t[1:] + t[:-1]) / 2, np.diff(t), [], []
    near = np.convolve(hit, np.ones(3), "same") > 0  # a burst may begin or end in the neighbouring window
    for run in np.split(np.arange(len(hit)), np.flatnonzero(np.diff(near)) + 1):
        steps = np.flatnonzero(np.isin(window, run) & fast & (share > 0.5)) if near[run[0]] else np.zeros(0, np.intp)
        if not len(steps):
            continue
        around = np.arange(max(steps[0] - 1, 0), min(steps[-1] + 2, len(share)))  # neighbours may be lost in part
        between = (around > steps[0]) & (around < steps[-1])
        weight = np.where(between, 1.0, np.clip(np.where(fast[around], share[around], 0.0), 0.0, 1.0)) * length[around]
        starts.append(weight @ middle[around] / weight.sum() - weight.sum() / 2)
        widths.append(float(weight.sum()))
    return np.array(starts), np.array(widths)


def _beat(t: Array) -> tuple[float, float] | None:
    """Return the first start and the period (s) of a steady beat that bursts keep; None if they do not.

    Beats may be missing, as a wheel at rest loses nothing.
    """
    if len(t) < 3:
        return None
    for times in range(1, 4):
        period, first, kept = float(np.median(np.diff(t))) / times, t[0], np.full(len(t), True)
        for _ in range(2):
            beats = np.round((t - first) / period)
            if len(np.unique(beats)) < len(t) or kept.mean() < MOSTLY:
                break
            period, first = (float(coefficient) for coefficient in np.polyfit(beats[kept], t[kept], 1))
            kept = np.abs(t - first - period * beats) < EVEN * period
        else:
            if kept.mean() >= MOSTLY:
                return first - period * np.floor(first / period), period
    return None
