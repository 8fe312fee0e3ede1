"""A wheel's encoder that loses counts in bursts: now and then, and not as fast as the wheel turns.

When they come has to be found first, so it is no candidate as others are. What wheels slip beyond what is expected is
then of one wheel mostly, of one sense, and at some times only: at others it turns as fast and nothing is lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.encoders import TickLossBursts
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.log_likelihood import LogLikelihood

OF_ONE_WHEEL, OPPOSITE, OF_FAST = 0.5, 0.1, 0.6
"""Of the squares of slip in the worst steps, what one wheel has at least; of the steps in bursts, how many may be of
the opposite sense; and of the steps that are as fast, how many may be in bursts."""

CLEAR, TYPICAL = 6.0, 0.02
"""Slip in bursts over the median of all; and the part of all steps that are the worst: half of it is a burst's too."""

FEWEST, SAME, SCATTER = 4, 3, 0.1
"""Bursts that it takes; fewer, where the part that every step in them loses is the same but for so much of it."""

APART, COUNTS, SLOW = 3, 0.5, 5.0
"""Steps between two bursts at least; counts that a step in one loses; and counts in a step below
which it does not tell what part of it is lost."""

LEAST_KEPT = 0.1
"""The part of what a wheel loses that the others must contradict."""

EVEN, MOSTLY = 0.1, 0.75
"""Part of the period by which bursts may be off a steady beat, and how many of them must not be."""


@dataclass(frozen=True)
class Losing:
    """Counts that a wheel loses in bursts, with the standard error of the part lost, and the deviance that they take
    away; steady: whether in a beat."""

    effect: TickLossBursts
    error: float
    gain: float
    steady: bool


def losing(robot: RobotDescription, logs: Sequence[Log]) -> Losing | None:
    """Return what a wheel loses in bursts; None if none does, or the encoders cannot contradict each other."""
    geometry = Geometry.of(robot.as_built())
    both = [_missed(geometry, log) for log in logs]
    squares = np.concatenate([missed for missed, _ in both]) ** 2
    few = max(FEWEST, round(TYPICAL * len(squares)))
    squares = squares[np.argsort(squares.sum(axis=1))[-few:]].sum(axis=0)
    share = squares / max(squares.sum(), 1e-30)
    row = int(np.argmax(share))
    k = int(LogLikelihood(geometry, logs[0]).rows[row])
    if share[row] < OF_ONE_WHEEL or k >= len(geometry.radius):
        return None
    off = [one[0][:, row] / _kept(geometry, log, one, row, k) for log, one in zip(logs, both, strict=True)]
    turned = [rolled[:, row] + one for (_, rolled), one in zip(both, off, strict=True)]
    lost = [one * np.sign(truly) for one, truly in zip(off, turned, strict=True)]
    every, fast = np.concatenate(lost), np.abs(np.concatenate(turned))
    least = float(np.median(np.sort(every)[-few:])) / 2
    hit, count = every > least, float(2 * np.pi * geometry.radius[k] / geometry.counts_per_rev[k])
    usual = max(1.48 * float(np.median(np.abs(every))), count / np.sqrt(12))
    if least < max(CLEAR / 2 * usual, COUNTS * count) or np.sum(every < -least) > OPPOSITE * hit.sum():
        return None
    if hit[fast >= np.median(fast[hit])].mean() > OF_FAST:
        return None
    parts = every[hit] / fast[hit]
    value = float(np.clip(np.median(parts), 0.0, 1.0))
    error = float(np.std(parts) / np.sqrt(hit.sum()))
    bursts = []
    for log, one, way in zip(logs, lost, map(np.abs, turned), strict=True):
        shares = np.where(way > SLOW * count, one / np.maximum(way, count), 0.0) / value
        bursts.append(_bursts(log.t, one > least, shares))
    starts = [start for start, _ in bursts]
    if sum(map(len, starts)) < (SAME if np.std(parts) < SCATTER * value else FEWEST):
        return None
    width = float(np.median(np.concatenate([length for _, length in bursts])))
    beat = _beat(starts) if len(logs) == 1 else None
    period = sum(float(np.ptp(log.t)) for log in logs) / sum(map(len, starts)) if beat is None else beat[1]
    castor = int(robot.wheel_castors[k])
    effect = TickLossBursts(
        castor=castor + 1,
        wheel=1 + int(np.sum(np.asarray(robot.wheel_castors)[:k] == castor)),
        value=value,
        period=period,
        width=min(width, period),
        start=0.0 if beat is None else beat[0],
        seed=0 if beat is None else None,
    )
    gain = float(np.sum((every[hit] / usual) ** 2))
    return Losing(effect, error, gain, beat is not None)


def _missed(geometry: Geometry, log: Log) -> tuple[Array, Array]:
    """Return by how much odometry by least squares misses every constraint in every step, and what its wheel rolled (K
    - 1, rows), m."""
    model = LogLikelihood(geometry, log)
    state = np.column_stack([model.odometry(geometry), model.start(geometry)[:, 3:]])
    return model.missed(geometry, state), model.rolled(geometry, state)


def _kept(geometry: Geometry, log: Log, now: tuple[Array, Array], row: int, wheel: int) -> Array:
    """Return what part of a count too few least squares leave to its own row in every step (K - 1,); now: `_missed`."""
    column = int(np.sum(~np.isnan(geometry.counts_per_rev[:wheel])))
    counts = log.wheel.astype(np.float64)
    counts[:, column] += np.arange(len(counts))
    missed, rolled = (
        more - less for more, less in zip(_missed(geometry, replace(log, wheel=counts)), now, strict=True)
    )
    return np.maximum(-missed[:, row] / rolled[:, row], LEAST_KEPT)


def _bursts(t: Array, hit: NDArray[np.bool_], share: Array) -> tuple[Array, Array]:
    """Return when bursts of steps that are hit start, and how long they last, s; share: of each step that is lost."""
    steps = np.flatnonzero(hit)
    groups = np.split(steps, np.flatnonzero(np.diff(steps) > APART) + 1) if len(steps) else []
    weight, middle = np.clip(share, 0.0, 1.0) * np.diff(t), (t[1:] + t[:-1]) / 2
    starts, lengths = [], []
    for group in groups:
        own = slice(max(group[0] - 1, 0), group[-1] + 2)  # the steps beside may be lost in part
        length = weight[own].sum()
        starts.append(weight[own] @ middle[own] / length - length / 2)
        lengths.append(length)
    return np.array(starts), np.array(lengths)


def _beat(starts: Sequence[Array]) -> tuple[float, float] | None:
    """Return the first start and the period (s) of a steady beat that bursts of one log keep; None if they do not.

    Some beats may be missing: a wheel at rest loses nothing.
    """
    t = starts[0]
    for times in range(1, 4):
        period, first, kept = float(np.median(np.diff(t))) / times, t[0], np.full(len(t), True)
        for _ in range(2):
            beats = np.round((t - first) / period)
            if len(np.unique(beats)) < len(t) or kept.mean() < MOSTLY:
                break
            period, first = (float(one) for one in np.polyfit(beats[kept], t[kept], 1))
            kept = np.abs(t - first - period * beats) < EVEN * period
        else:
            if kept.mean() >= MOSTLY:
                return first - period * np.floor(first / period), period
    return None
