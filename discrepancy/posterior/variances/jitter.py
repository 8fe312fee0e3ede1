"""Sample jitter, a random timing error that all encoders share: its probability and standard deviation.

Jitter has mean 0, so it is a variance and not a column of the linear problem. A robot's motion is smooth, so
differences of high order, projected on the speeds of the counts, contain little but jitter and rounding, whose variance
is known.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import expit

from castor_envs.effects.clocks import SampleJitter
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log, unwrapped
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, prior_log_odds
from discrepancy.validation.cost import cost_of
from estimators.likelihood.channels import Channels
from estimators.likelihood.disagreement import MEDIAN

SIZES = np.geomspace(0.01, 300.0, 201)
"""Sizes of jitter, in tolerances: a grid to integrate over, up to the largest that the effect may have."""

GOOD_ORDER = -(SIZES**2) / 2
"""Log density of each size in good order, up to a constant."""

ORDER = 6
"""Order of the differences, in which a robot's smooth motion is negligible beside jitter."""

ALIKE = -0.8
"""Largest correlation of neighbouring differences that counts as white noise (-6/7) and not as jerky motion."""

BESIDE = 0.5
"""Largest variance of the encoders' separate parts relative to the variance of their shared part: above it, the motion
is jerky."""

LEAST_JITTER = 3e-4
"""s: above the residuals of motion in simulated robots in good order."""

MOVING = 0.3
"""Least squared speed of a sample that is used, as a part of the median: slow samples carry no information on time."""

STEADY = 0.2
"""Steady jitter: the variance estimated from the median of squares is at least this part of the variance from their
mean."""

SPREAD = math.comb(2 * ORDER, ORDER)
"""Variance of such differences relative to that of single samples: the sum of squared binomial coefficients."""


def jitter_answer(
    robot: RobotDescription, logs: Sequence[Log], held_out: Sequence[Log], clean: Sequence[Log], names: int
) -> Answer | None:
    """Return the answer that samples jitter more than in clean logs; None if its probability is below `CREDIBLE`.

    names: number of other possible answers, all of the same prior probability.
    """
    seen = jitter_of(robot, logs)
    if seen is None:
        return None
    in_clean = jitter_of(robot, clean) if clean else None
    usual = 0.0 if in_clean is None else in_clean.value
    elsewhere = _log_likelihood(robot, held_out, usual) if held_out else None
    found = excess_of(SampleJitter.tolerance, _log_likelihood(robot, logs, usual), elsewhere, names)
    if found is None:
        return None
    probability, size, error, confirmed = found
    (kind,) = SampleJitter.variants(robot)
    candidate = Candidate(described(kind), (kind,))
    if seen.seldom:
        candidate = Candidate(f"all encoders are read early or late together at some times, most {seen.seldom}")
    cost = np.array([cost_of(robot, dataclasses.replace(kind, value=size), logs) or 0.0, 0.0])
    return Answer.judged_apart(candidate, probability, size, error, cost, confirmed)


def _log_likelihood(robot: RobotDescription, logs: Sequence[Log], usual: float) -> Array:
    """Return the log-likelihood of logs (natural logarithm, up to a constant) with jitter of `SIZES` added to the usual
    jitter (s).

    Neighbouring differences share all but one of their samples, so `ORDER` of them count as one.
    """
    total = np.zeros(len(SIZES))
    for log in logs:
        late, rounding, *_ = delays_of(robot, log)
        deviation = SampleJitter.deviation(SIZES * SampleJitter.tolerance, float(np.median(np.diff(log.t))))
        variance = rounding + SPREAD * (usual**2 + deviation[:, None] ** 2)
        total -= np.sum(np.log(variance) + late**2 / variance, axis=1) / 2 / ORDER
    return total


def excess_of(
    tolerance: float, logs: Array, held_out: Array | None, names: int
) -> tuple[float, float, float, float | None] | None:
    """Return the probability of noise beyond good order, its size and the standard error of that in the effect's unit,
    and the log-likelihood ratio of held-out logs with and without it; None if the probability is below `CREDIBLE`.

    logs, held_out: log-likelihood of these and of held-out logs (None: there are none) with each of `SIZES`. names:
    number of possible answers, all of the same prior probability. Priors as for every other effect: in good order
    normal, with the tolerance as standard deviation; a fault is Cauchy distributed.
    """
    fault = -np.log1p((SIZES / FAULT) ** 2)
    log_odds = _averaged(logs, fault) - _averaged(logs, GOOD_ORDER)
    probability = float(expit(log_odds + prior_log_odds(names)))
    if probability < CREDIBLE:
        return None
    weight = np.exp(logs + fault - np.max(logs + fault)) * SIZES
    size = float(np.average(SIZES, weights=weight))
    error = float(np.sqrt(np.average((SIZES - size) ** 2, weights=weight)))
    confirmed = None if held_out is None else float(np.interp(size, SIZES, held_out)) - _averaged(held_out, GOOD_ORDER)
    return probability, size * tolerance, error * tolerance, confirmed


def _averaged(log_likelihood: Array, log_density: Array) -> float:
    """Return the log of the mean likelihood over sizes with this log density, up to a constant; the grid is even in log
    size."""
    steps = np.log(SIZES)
    return float(np.logaddexp.reduce(log_likelihood + log_density + steps) - np.logaddexp.reduce(log_density + steps))


class Jitter(NamedTuple):
    """The standard deviation of jitter, s. seldom: for intermittent jitter the time at which it is largest, in words;
    else empty."""

    value: float
    seldom: str


def jitter_of(robot: RobotDescription, logs: Sequence[Log]) -> Jitter | None:
    """Return the standard deviation (s) of the timing error that all encoders share; None where none is visible.

    Differences of high order of all counts are projected on the speeds of these counts; the variance that rounding adds
    to this projection is known.
    """
    delays = [delays_of(robot, log) for log in logs]
    late, expected, beside = (np.concatenate([of_log[k] for of_log in delays]) for k in range(3))
    if len(late) < 10 * ORDER or np.mean(beside - expected) > BESIDE * np.mean(late**2 - expected):
        return None
    variance = float(np.mean(late**2) - np.mean(expected)) / SPREAD
    if variance < LEAST_JITTER**2:
        return None
    steady = bool(np.median(late**2) / MEDIAN**2 - np.mean(expected) > STEADY * variance * SPREAD)
    if _correlation(delays, beyond_pauses=not steady) > ALIKE:
        return None
    return Jitter(math.sqrt(variance), "" if steady else _when(delays))


def _correlation(delays: Sequence["Delays"], beyond_pauses: bool) -> float:
    """Return the correlation of neighbouring differences.

    beyond_pauses: whether those before and after a pause, which jitter does not make alike, count as neighbours: errors
    at some times only may be a robot that jerks as it starts, so that a log with pauses does not tell.
    """
    product, square = 0.0, 1e-30
    for of_log in delays:
        after = np.flatnonzero(beyond_pauses | (np.diff(of_log.row) == 1))
        first, second = of_log.late[after], of_log.late[after + 1]
        product, square = product + float(first @ second), square + float(first @ first + second @ second) / 2
    return product / square


def _when(delays: Sequence["Delays"]) -> str:
    """Return in words when the timing error is largest."""
    k = int(np.argmax([np.abs(of_log.late).max(initial=0.0) for of_log in delays]))
    time = delays[k].t[np.argmax(np.abs(delays[k].late))]
    return f"at {time:.1f} s" + (f" of log {k + 1}" if len(delays) > 1 else "")


class Delays(NamedTuple):
    """Samples in which the robot moves. late: differences of the delay that all encoders share, s; rounding: expected
    square of these from rounding, s^2; beside: mean square of the counts' part orthogonal to it, s^2; t: time, s; row:
    the place of each difference among all."""

    late: Array
    rounding: Array
    beside: Array
    t: Array
    row: NDArray[np.intp]


def delays_of(robot: RobotDescription, log: Log) -> Delays:
    """Return the delays that all encoders share, in differences of order `ORDER`.

    Motors that steer all castors at once, from rest, make their encoders jerk together: where there are wheels that
    tell, these castors are left out.
    """
    channels = Channels(robot)
    steered = channels.geometry.driven[channels.sensed] & (log.wheel.shape[1] > 1)
    pivots = unwrapped(log.pivot, channels.per_rev[: len(channels.sensed)])[:, ~steered]
    counts = np.column_stack([pivots, log.wheel])
    if len(log) <= 2 * ORDER:
        return Delays(*[np.zeros(0)] * 4, row=np.zeros(0, dtype=np.intp))
    times = sliding_window_view(log.t, ORDER + 1)
    weights = 1 / np.prod(times[:, :, None] - times[:, None, :] + np.eye(ORDER + 1), axis=2)  # at uneven times
    weights *= math.sqrt(SPREAD) / np.linalg.norm(weights, axis=1, keepdims=True)
    jumps = np.einsum("rk,rck->rc", weights, sliding_window_view(counts, ORDER + 1, axis=0))
    across = counts[ORDER:] - counts[:-ORDER]
    speed = across / (log.t[ORDER:] - log.t[:-ORDER])[:, None]
    squared = np.sum(speed**2, axis=1)
    moving = (squared > MOVING * np.median(squared)) & (squared > 0)
    jumps, speed, squared = jumps[moving], speed[moving], squared[moving]
    late = np.sum(speed * jumps, axis=1) / squared
    beside = (np.sum(jumps**2, axis=1) / squared - late**2) / max(counts.shape[1] - 1, 1)
    return Delays(late, SPREAD / 12 / squared, beside, times[moving, ORDER // 2], np.flatnonzero(moving))
