"""Cables and thresholds on the floor, as lines that make every wheel roll more where it crosses them.

A wheel rolls most where it crosses at a right angle. Lines are found by a scan over directions and offsets (as Hough's
transform), then refined. As a single event may lie anywhere, and any two events lie on a line, a line is judged by its
deviance without the largest events.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize

from castor_envs.effects.floor import Bump
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.hypotheses.wheel_tracks import Steps, placed, steps_of
from estimators.calibration.maximum_likelihood import State

DIRECTIONS, BIN = 180, 0.01
"""Grid of the scan for lines: directions in half a turn, and spacing of offsets, m."""

BANDS = 3, 5, 9
"""Widths of a line in the scan, bins."""

PEAKS, MOST = 6, 2
"""Lines of the scan that are refined, and that are proposed."""

THIN, THICK = 5e-4, 0.03
"""m: the range of diameters."""

APART, TURNED = 0.1, 0.1
"""m and rad: lines closer than this in place, where they are crossed, and in direction are the same line."""

BUMP_GAIN, PASSES, LARGEST = 20.0, 6, 2
"""Least deviance that a line must explain without its `LARGEST` passes, and least number of passes over it."""

NEAR = 0.05
"""m: a line has no more passes than there are this near to it in the scan."""


@dataclass(frozen=True)
class Line:
    """A straight cable through (x, y) along `direction` (rad, in N, 0 to pi) of some diameter, m.

    lasting: deviance that it explains without the `LARGEST` passes; passes: number of passes over it.
    """

    x: float
    y: float
    direction: float
    diameter: float
    lasting: float
    passes: int


def bumps_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> list[Candidate]:
    """Return the cables or thresholds for which logs give evidence, the best first; empty where there are none.

    motions: with poses in the reference's frame. slips: for each log those of wheels beyond prediction (K - 1, w), m;
    NaN where unknown.
    """
    lines = lines_of(steps_of(robot, motions, slips))
    return [candidate_of(line) for line in lines if line.passes >= PASSES]


def with_cables(
    known: Sequence[Candidate], robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array]
) -> list[Candidate]:
    """Return the cables known and those for which logs give evidence beside these, at the most likely states of logs.

    slips: of each log, from `slips_of`. Logs without reference poses are skipped, as they determine no places.
    """
    motions, slips = placed(robot, logs, at, slips)
    if not motions:
        return list(known)
    known_lines = _lines_in([*robot.effects, *(kind for candidate in known for kind in candidate.kinds)])
    new = [
        candidate
        for candidate in bumps_of(robot, motions, slips)
        if not any(same_line(line, known_line) for line in _lines_in(candidate.kinds) for known_line in known_lines)
    ]
    return [*known, *new]


def _lines_in(effects: Sequence[Effect]) -> list[Bump]:
    return [effect for effect in effects if isinstance(effect, Bump)]


def candidate_of(line: Line) -> Candidate:
    """Return a line as a candidate, named with its place."""
    x, y, direction = round(line.x, 3), round(line.y, 3), round(line.direction, 3)
    effect = Bump(x=x, y=y, direction=direction, value=line.diameter)
    return Candidate(described(effect), (effect,))


def lines_of(steps: Steps) -> list[Line]:
    """Return up to `MOST` lines that stand out, the best first; each is looked for in what those before it leave."""
    found: list[Line] = []
    while len(steps.slip) and len(found) < MOST:
        refined = [_refined(steps, *peak) for peak in _scan(steps) if _passes_near(steps, *peak) >= PASSES]
        best = max(refined, key=lambda line: line.lasting, default=None)
        if best is None or best.lasting < BUMP_GAIN:
            break
        found.append(best)
        shape = _rolls_more(steps, best.x, best.y, best.direction, best.diameter)
        power = float(np.sum(steps.weight * shape**2))
        part = -float(np.sum(steps.weight * shape * steps.slip)) / power if power > 0 else 0.0
        steps = dataclasses.replace(steps, slip=steps.slip + part * shape)
    return found


def same_line(first: Line | Bump, second: Line | Bump) -> bool:
    """Whether two lines are practically the same: in place, at the points by which they are given, and in direction."""
    turn = (first.direction - second.direction + math.pi / 2) % math.pi - math.pi / 2
    way = second.x - first.x, second.y - first.y
    off = max(abs(way[1] * math.cos(a) - way[0] * math.sin(a)) for a in (first.direction, second.direction))
    return abs(turn) < TURNED and off < APART


def _scan(steps: Steps) -> list[tuple[float, float]]:
    """Return the directions (rad) and offsets to the left of the origin (m) of the lines that stand out."""
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    middle = (steps.start + steps.end) / 2
    low = -float(np.max(np.hypot(*middle.T))) - BIN * max(BANDS)
    bins = int(-2 * low / BIN) + 2
    score, power = np.zeros((DIRECTIONS, bins)), np.zeros((DIRECTIONS, bins))
    for k, angle in enumerate(angles):
        across = middle[:, 1] * math.cos(angle) - middle[:, 0] * math.sin(angle)
        shape = -steps.path * np.sin(steps.heading - angle) ** 2
        at = ((across - low) / BIN).astype(np.intp)
        score[k] = np.bincount(at, steps.weight * shape * steps.slip, bins)
        power[k] = np.bincount(at, steps.weight * shape**2, bins)
    if not power.any():  # nothing moves
        return []
    least = np.median(power[power > 0])  # a line that is hardly crossed has no evidence
    gains = []
    for band in BANDS:
        summed = (uniform_filter1d(sums, band, axis=1, mode="constant") * band for sums in (score, power))
        band_score, band_power = summed
        gains.append(np.maximum(band_score, 0.0) ** 2 / np.maximum(band_power, least))
    gain = np.max(gains, axis=0)
    found = []
    offsets = low + (np.arange(bins) + 0.5) * BIN
    for _ in range(PEAKS):
        k, b = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if gain[k, b] <= 0:
            break
        found.append((float(angles[k]), float(offsets[b])))
        turn = (angles - angles[k] + np.pi / 2) % np.pi - np.pi / 2
        flipped = np.where(np.abs(angles - angles[k]) > np.pi / 2, -1.0, 1.0)  # half a turn on, left is right
        near = np.abs(flipped[:, None] * offsets - offsets[b]) < 2 * APART
        gain[(np.abs(turn) < TURNED)[:, None] & near] = 0.0
    return found


def _refined(steps: Steps, direction: float, offset: float) -> Line:
    """Return the line near one of the scan that explains the largest deviance, with the exact shape of its bump."""
    middle = (steps.start + steps.end) / 2
    across = middle[:, 1] * math.cos(direction) - middle[:, 0] * math.sin(direction)
    near = np.abs(across - offset) < 0.25
    near_steps = steps.only(near)
    crossing = np.abs(across - offset) < 0.03
    shape = (steps.weight * steps.path**2 * np.sin(steps.heading - direction) ** 4)[crossing]
    center = np.average(middle[crossing], axis=0, weights=shape) if shape.sum() > 0 else middle.mean(axis=0)
    left = np.array([-math.sin(direction), math.cos(direction)])
    center = center + (offset - center @ left) * left
    along = middle[crossing] @ [math.cos(direction), math.sin(direction)]
    size = max(float(np.std(along)), 0.1) if len(along) else 0.1

    def line_at(at: Array) -> tuple[float, float, float, float]:
        x, y = (center + at[1] * left).tolist()
        return x, y, direction + at[0] / size, float(np.clip(math.exp(at[2]), THIN, THICK))

    def negative_gain(at: Array) -> float:
        shape = _rolls_more(near_steps, *line_at(at))
        score, power = np.sum(near_steps.weight * shape * -near_steps.slip), np.sum(near_steps.weight * shape**2)
        return -float(max(score, 0.0) ** 2 / (power + 1e-12))

    begin = np.array([0.0, 0.0, math.log(4e-3)])
    simplex = begin + np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.015, 0], [0, 0, 0.5]])
    options = {"initial_simplex": simplex, "xatol": 2e-4, "fatol": 0.05, "maxfev": 150}
    best = minimize(negative_gain, begin, method="Nelder-Mead", options=options)
    x, y, direction, diameter = line_at(best.x)
    lasting, passes = _lasting(near_steps, _rolls_more(near_steps, x, y, direction, diameter))
    return Line(x, y, direction % math.pi, diameter, lasting, passes)


def _passes_near(steps: Steps, direction: float, offset: float) -> int:
    """Return how often wheels pass within `NEAR` of a line of the scan."""
    middle = (steps.start + steps.end) / 2
    across = middle[:, 1] * math.cos(direction) - middle[:, 0] * math.sin(direction)
    return int(steps.passes(np.abs(across - offset) < NEAR).max(initial=-1)) + 1


def _lasting(steps: Steps, shape: Array) -> tuple[float, int]:
    """Return the deviance that extra roll `shape` (M,) explains without the `LARGEST` passes, and the number of
    passes."""
    crossed = shape != 0.0
    number = steps.passes(crossed)
    passes = int(number[-1]) + 1 if len(number) else 0
    score = np.bincount(number, -(steps.weight * shape * steps.slip)[crossed], passes)
    power = np.bincount(number, (steps.weight * shape**2)[crossed], passes)
    kept = np.argsort(score)[: max(passes - LARGEST, 0)]
    lasting = max(score[kept].sum(), 0.0) ** 2 / (power[kept].sum() + 1e-12)
    strong = power > 0.1 * power.max(initial=0.0)
    return lasting, int(strong.sum())


def _rolls_more(steps: Steps, x: float, y: float, direction: float, diameter: float) -> Array:
    """Return the extra roll of wheels in every step (M,) over the path of their contacts, with the sign of the path, m.

    As `Bump.slip`, in closed form: of sqrt(1 + climb^2) - 1 the first two terms, along a straight step.
    """
    c, s = math.cos(direction), math.sin(direction)
    a, b = ((place[:, 1] - y) * c - (place[:, 0] - x) * s for place in (steps.start, steps.end))
    edge = np.sqrt(2 * steps.radius * diameter)
    away = b - a
    inside = np.clip(b, -edge, edge), np.clip(a, -edge, edge)
    excess = np.zeros_like(away)
    on = np.flatnonzero((inside[0] != inside[1]) | ((np.abs(a) < edge) & (np.abs(away) < 1e-9)))
    if not len(on):
        return excess
    reach = (steps.radius + diameter / 2)[on]
    sine = np.sin(steps.heading[on] - direction)
    flat = np.abs(away[on]) < 1e-9
    ends = [_climbed(reach_end[on], reach) for reach_end in inside]
    length = np.where(flat, 1.0, away[on])
    squares, fourths = ((end - start) / length for end, start in zip(*ends, strict=True))
    middle = a[on] ** 2 / (reach**2 - np.where(flat, a[on], 0.0) ** 2)
    squares, fourths = np.where(flat, middle, squares), np.where(flat, middle**2, fourths)
    excess[on] = steps.path[on] * (sine**2 * squares / 2 - sine**4 * fourths / 8)
    return excess


def _climbed(d: Array, reach: Array) -> tuple[Array, Array]:
    """Return the integrals from 0 to d of t^2 / (reach^2 - t^2) and of its square."""
    turn = reach * np.arctanh(d / reach)
    first = turn - d
    return first, d - 1.5 * turn + reach**2 * d / (2 * (reach**2 - d**2))
