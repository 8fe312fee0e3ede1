"""By how much all encoders together are read early or late: differences of high order, along the counts' speeds.

A robot's motion is smooth, so that differences of high order hold little but rounding, whose variance is known, and
jitter, whose mean is nothing.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription

ORDER = 6
"""Of the differences in which a robot's motion, that is smooth, is nothing beside jitter."""

ALIKE = -0.8
"""The correlation of neighbouring differences from which on they are of white noise (-6/7), not of a jerky motion."""

BESIDE = 0.5
"""What each encoder does for itself, as a part of what all do together: more is a jerky motion."""

LEAST_JITTER = 3e-4
"""s: above what motion alone leaves of simulated robots in good order."""

MOVING = 0.3
"""Of the median squared speed: slower samples do not tell of time."""

STEADY, MEDIAN = 0.2, 0.455
"""Jitter is always there: what its median square says of the mean one is no less than such a part of it. The median of
a squared normal number."""

SPREAD = math.comb(2 * ORDER, ORDER)
"""Times the variance of single samples that such differences have: the sum of squared binomial coefficients."""


class Jitter(NamedTuple):
    """A standard deviation, s, its standard error, and the deviance that it takes away.

    seldom: where it is but at some times, when it is largest, in words.
    """

    value: float
    error: float
    gain: float
    seldom: str = ""


def jitter_of(robot: RobotDescription, logs: Sequence[Log]) -> Jitter | None:
    """Return the standard deviation (s) by which all encoders together are read early or late; None where none shows.

    Of differences of high order of all counts only what goes with the counts' own speeds is taken: what rounding leaves
    in it is known.
    """
    delays = [delays_of(robot, log) for log in logs]
    every, expected, beside = (np.concatenate([one[k] for one in delays]) for k in range(3))
    neighbours = sum(float(one.late[1:] @ one.late[:-1]) for one in delays)
    if len(every) < 10 * ORDER or neighbours > ALIKE * float(every @ every):
        return None
    if np.mean(beside - expected) > BESIDE * np.mean(every**2 - expected):
        return None
    variance = float(np.mean(every**2) - np.mean(expected)) / SPREAD
    value = np.sqrt(max(variance, 0.0))
    ratio = variance * SPREAD / expected
    gain = float(np.sum(ratio - np.log1p(ratio))) / ORDER
    if value < LEAST_JITTER:
        return None
    steadily = float(np.median(every**2)) / MEDIAN - float(np.mean(expected))
    seldom = "" if steadily > STEADY * variance * SPREAD else _when(delays)
    return Jitter(float(value), float(value * np.sqrt(ORDER / (2 * len(every)))), gain, seldom)


def _when(delays: Sequence["Delays"]) -> str:
    """Return in words when encoders are read most early or late."""
    worst = [float(np.abs(one.late).max(initial=0.0)) for one in delays]
    k = int(np.argmax(worst))
    return f"at {delays[k].t[np.argmax(np.abs(delays[k].late))]:.1f} s" + (
        f" of log {k + 1}" if len(delays) > 1 else ""
    )


class Delays(NamedTuple):
    """Of samples in which the robot moves: late, differences of the delay of all encoders together, s; what rounding
    alone leaves of their squares; the mean square of what is in the counts beside, in the same unit; and when, s."""

    late: Array
    rounding: Array
    beside: Array
    t: Array


def delays_of(robot: RobotDescription, log: Log) -> Delays:
    """Return by how much all encoders together were read early or late, in differences of order `ORDER`."""
    turn = Geometry.of(robot).pivot_counts_per_rev[list(robot.pivot_encoders)]
    pivot = [np.unwrap(column, period=period) for column, period in zip(log.pivot.T, turn, strict=True)]
    counts = np.column_stack([*pivot, log.wheel])
    if len(log) <= 2 * ORDER:
        return Delays(*np.zeros((4, 0)))
    weights = _weights(log.t)
    rows = len(weights)
    jumps = np.sum([weights[:, k, None] * counts[k : k + rows] for k in range(ORDER + 1)], axis=0)
    across = counts[ORDER:] - counts[:-ORDER]
    speed = across / (log.t[ORDER:] - log.t[:-ORDER])[:, None]
    squared = np.sum(speed**2, axis=1)
    moving = (squared > MOVING * np.median(squared)) & (squared > 0)
    jumps, speed, squared = jumps[moving], speed[moving], squared[moving]
    late = np.sum(speed * jumps, axis=1) / squared
    beside = (np.sum(jumps**2, axis=1) / squared - late**2) / max(counts.shape[1] - 1, 1)
    return Delays(late, np.sum(weights**2, axis=1)[moving] / 12 / squared, beside, log.t[ORDER // 2 :][:rows][moving])


def _weights(t: Array) -> Array:
    """Return the weights (rows, ORDER + 1) of differences at uneven times, as even times would have them."""
    rows = len(t) - ORDER
    times = np.stack([t[k : k + rows] for k in range(ORDER + 1)], axis=1)
    apart = times[:, :, None] - times[:, None, :] + np.eye(ORDER + 1)
    weights = 1 / np.prod(apart, axis=2)
    return weights * (np.linalg.norm(_binomial()) / np.linalg.norm(weights, axis=1))[:, None]


def _binomial() -> Array:
    weights = np.ones(1)
    for _ in range(ORDER):
        weights = np.convolve(weights, [1.0, -1.0])
    return weights
