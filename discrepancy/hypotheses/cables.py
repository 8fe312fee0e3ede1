"""Cables and thresholds on the floor, as lines that make every wheel roll more where it crosses them.

A wheel rolls most where it crosses at a right angle. Lines are found by a scan over directions and offsets (as Hough's
transform), then refined. As a single event may lie anywhere, and any two events lie on a line, a line is judged by its
deviance without the largest events.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize

from castor_envs.effects.floor import Bump
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.hypotheses.wheel_tracks import Steps, along_and_across, placed, steps_of
from estimators.calibration.maximum_likelihood.fit import State

DIRECTIONS, BIN = 180, 0.01
"""Grid of the scan for lines: directions in half a turn, and spacing of offsets, m."""

BANDS = 3, 5, 9
"""Widths of a line in the scan, bins."""

PEAKS, MOST = 6, 2
"""Lines of the scan that are refined, and that are proposed."""

THIN, THICK = 5e-4, 0.03
"""m: the range of diameters."""

APART = 0.1
"""m and rad: lines closer than this in place, where they are crossed, and in direction are the same line."""

BUMP_GAIN, PASSES, LARGEST = 20.0, 6, 2
"""Least deviance that a line must explain without its `LARGEST` passes, and least number of passes over it."""

NEAR, CROSSED, REACH = 0.05, 0.03, 0.25
"""m: a line has no more passes than there are this near to it in the scan; how near steps are that cross it, and those
with which it is refined."""


class Line(NamedTuple):
    """A straight cable through (x, y) along `direction` (rad, in N, 0 to pi) of some diameter, m."""

    x: float
    y: float
    direction: float
    diameter: float


def with_cables(
    known: Sequence[Candidate], robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array]
) -> list[Candidate]:
    """Return the cables known and those for which logs give evidence beside these, at the most likely states of logs.

    slips: of each log, from `slips_of`. Logs without reference poses are skipped, as they determine no places.
    """
    motions, slips = placed(robot, logs, at, slips)
    if not motions:
        return list(known)
    effects = [*robot.effects, *(kind for candidate in known for kind in candidate.kinds)]
    lines = [effect for effect in effects if isinstance(effect, Bump)]
    new = [
        candidate
        for candidate in bumps_of(robot, motions, slips)
        if not any(same_line(bump, line) for bump in candidate.kinds if isinstance(bump, Bump) for line in lines)
    ]
    return [*known, *new]


def bumps_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> list[Candidate]:
    """Return up to `MOST` cables or thresholds for which logs give evidence, named with their places, the best first;
    each is looked for in what those before it leave.

    motions: with poses in the reference's frame. slips: for each log those of wheels beyond prediction (K - 1, w), m;
    NaN where unknown.
    """
    steps, found = steps_of(robot, motions, slips), []
    for _ in range(MOST if len(steps.slip) else 0):
        refined = [_refined(steps, *peak) for peak in _scan(steps) if _passes_near(steps, *peak) >= PASSES]
        line, lasting, passes = max(refined, key=lambda entry: entry[1], default=(Line(0, 0, 0, 0), 0.0, 0))
        if lasting < BUMP_GAIN:
            break
        if passes >= PASSES:
            x, y, direction = (round(number, 3) for number in line[:3])
            effect = Bump(x=x, y=y, direction=direction, value=line.diameter)
            found.append(Candidate(described(effect), (effect,)))
        shape = _rolls_more(steps, *line)
        score, power = _evidence(steps, shape)
        steps = dataclasses.replace(steps, slip=steps.slip + (score / power if power > 0 else 0.0) * shape)
    return found


def same_line(first: Bump, second: Bump) -> bool:
    """Whether two lines are practically the same: in place, at the points by which they are given, and in direction."""
    turn = (first.direction - second.direction + math.pi / 2) % math.pi - math.pi / 2
    way = np.array([[second.x - first.x, second.y - first.y]])
    off = max(abs(float(along_and_across(way, line.direction)[1][0])) for line in (first, second))
    return abs(turn) < APART and off < APART


def _scan(steps: Steps) -> list[tuple[float, float]]:
    """Return the directions (rad) and offsets to the left of the origin (m) of the lines that stand out."""
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    low = -float(np.max(np.hypot(*steps.middle.T))) - BIN * max(BANDS)
    bins = int(-2 * low / BIN) + 2
    score, power = np.zeros((DIRECTIONS, bins)), np.zeros((DIRECTIONS, bins))
    for k, angle in enumerate(angles):
        _, across = along_and_across(steps.middle, angle)
        shape = -steps.path * np.sin(steps.heading - angle) ** 2
        at = ((across - low) / BIN).astype(np.intp)
        score[k] = np.bincount(at, steps.weight * shape * steps.slip, bins)
        power[k] = np.bincount(at, steps.weight * shape**2, bins)
    if not power.any():  # nothing moves
        return []
    least = np.median(power[power > 0])  # a line that is hardly crossed has no evidence
    gain, found = np.zeros_like(score), []
    for band in BANDS:
        band_score, band_power = (uniform_filter1d(of, band, axis=1, mode="constant") * band for of in (score, power))
        gain = np.maximum(gain, np.maximum(band_score, 0.0) ** 2 / np.maximum(band_power, least))
    offsets = low + (np.arange(bins) + 0.5) * BIN
    for _ in range(PEAKS):
        k, b = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[k, b] <= 0:
            break
        found.append((float(angles[k]), float(offsets[b])))
        turn = (angles - angles[k] + np.pi / 2) % np.pi - np.pi / 2
        flipped = np.where(np.abs(angles - angles[k]) > np.pi / 2, -1.0, 1.0)  # half a turn on, left is right
        near = np.abs(flipped[:, None] * offsets - offsets[b]) < 2 * APART
        gain[(np.abs(turn) < APART)[:, None] & near] = 0.0
    return found


def _refined(steps: Steps, direction: float, offset: float) -> tuple[Line, float, int]:
    """Return the line near one of the scan that explains the largest deviance, with the exact shape of its bump; the
    deviance without the `LARGEST` passes; and the number of passes over it."""
    along, across = along_and_across(steps.middle, direction)
    near, crossing = steps.only(np.abs(across - offset) < REACH), np.abs(across - offset) < CROSSED
    shape = (steps.weight * steps.path**2 * np.sin(steps.heading - direction) ** 4)[crossing]
    middle = steps.middle
    center = np.average(middle[crossing], axis=0, weights=shape) if shape.sum() > 0 else middle.mean(axis=0)
    left = np.array([-math.sin(direction), math.cos(direction)])
    center = center + (offset - center @ left) * left
    size = max(float(np.std(along[crossing])), 0.1) if crossing.any() else 0.1

    def line_at(at: Array) -> Line:
        x, y = (center + at[1] * left).tolist()
        return Line(x, y, direction + at[0] / size, float(np.clip(math.exp(at[2]), THIN, THICK)))

    def negative_gain(at: Array) -> float:
        score, power = _evidence(near, _rolls_more(near, *line_at(at)))
        return -float(max(score, 0.0) ** 2 / (power + 1e-12))

    begin = np.array([0.0, 0.0, math.log(4e-3)])
    simplex = begin + np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.015, 0], [0, 0, 0.5]])
    options = {"initial_simplex": simplex, "xatol": 2e-4, "fatol": 0.05, "maxfev": 150}
    line = line_at(minimize(negative_gain, begin, method="Nelder-Mead", options=options).x)
    return line._replace(direction=line.direction % math.pi), *_lasting(near, _rolls_more(near, *line))


def _passes_near(steps: Steps, direction: float, offset: float) -> int:
    """Return how often wheels pass within `NEAR` of a line of the scan."""
    _, across = along_and_across(steps.middle, direction)
    return int(steps.passes(np.abs(across - offset) < NEAR).max(initial=-1)) + 1


def _evidence(steps: Steps, shape: Array) -> tuple[float, float]:
    """Return the score and the information of extra roll `shape` (M,)."""
    return -float(np.sum(steps.weight * shape * steps.slip)), float(np.sum(steps.weight * shape**2))


def _lasting(steps: Steps, shape: Array) -> tuple[float, int]:
    """Return the deviance that extra roll `shape` (M,) explains without the `LARGEST` passes, and the number of
    passes."""
    crossed = shape != 0.0
    number = steps.passes(crossed)
    passes = int(number.max(initial=-1)) + 1
    score = np.bincount(number, -(steps.weight * shape * steps.slip)[crossed], passes)
    power = np.bincount(number, (steps.weight * shape**2)[crossed], passes)
    kept = np.argsort(score)[: max(passes - LARGEST, 0)]
    strong = power > 0.1 * power.max(initial=0.0)
    return max(score[kept].sum(), 0.0) ** 2 / (power[kept].sum() + 1e-12), int(strong.sum())


def _rolls_more(steps: Steps, x: float, y: float, direction: float, diameter: float) -> Array:
    """Return the extra roll of wheels in every step (M,) over the path of their contacts, with the sign of the path, m.

    As `Bump.slip`, in closed form: of sqrt(1 + climb^2) - 1 the first two terms, along a straight step.
    """
    a, b = (along_and_across(place - (x, y), direction)[1] for place in (steps.start, steps.end))
    edge = np.sqrt(2 * steps.radius * diameter)
    inside = np.clip(b, -edge, edge), np.clip(a, -edge, edge)
    excess, on = np.zeros_like(edge), np.flatnonzero(inside[0] != inside[1])
    reach, sine = (steps.radius + diameter / 2)[on], np.sin(steps.heading[on] - direction)
    ends = (_climbed(end[on], reach) for end in inside)
    squares, fourths = ((end - start) / (b - a)[on] for end, start in zip(*ends, strict=True))
    excess[on] = steps.path[on] * (sine**2 * squares / 2 - sine**4 * fourths / 8)
    return excess


def _climbed(d: Array, reach: Array) -> tuple[Array, Array]:
    """Return the integrals from 0 to d of t^2 / (reach^2 - t^2) and of its square."""
    turn = reach * np.arctanh(d / reach)
    first = turn - d
    return first, d - 1.5 * turn + reach**2 * d / (2 * (reach**2 - d**2))
