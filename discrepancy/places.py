"""Where on the floor something may lie that robots slip at: a cable or threshold, or a slippery patch.

Reference poses tell where wheels touch the floor (`contact_places`), and the smoother by how much each wheel slips
beyond what is expected. A cable makes every wheel roll more where it crosses one line, the more the squarer it crosses:
a scan over directions and offsets (as Hough's transform), then a refinement. A slippery patch makes slips large, of
either sign, in one rectangle: a scan over rectangles for two variances, then replays of the logs in simulation.

One event may lie anywhere, and any two lie on a line: what counts is what is left without the largest ones.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize

from castor_envs.effects import Bump, Effect, FrictionPatch, Motion
from castor_envs.effects.motion import contact_paths, contact_places
from castor_envs.errors import InputError
from castor_envs.kinematics import Array, Geometry
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from discrepancy.candidates import Candidate, Channels, described
from discrepancy.replay import replay
from estimators.calibration.log_likelihood import GAP, LogLikelihood
from estimators.calibration.maximum_likelihood import State

DIRECTIONS, BIN = 180, 0.01
"""Of the scan for lines: directions in half a turn, and offsets, m."""

BANDS = 3, 5, 9
"""Bins that a line is taken to be wide in the scan."""

PEAKS, MOST = 6, 2
"""Lines of the scan that are refined, and that are proposed."""

THIN, THICK = 5e-4, 0.03
"""m: the diameters that are looked for."""

APART, TURNED = 0.1, 0.1
"""m and rad: lines that lie and point alike to this much, where they are crossed, are one."""

BUMP_GAIN, PASSES, LARGEST = 20.0, 6, 2
"""Deviance that a line must take away from the slips without its `LARGEST` passes, and how many it must have."""

CELL, SIDES, TILTS = 0.1, (2, 3, 4, 6, 8, 12), 6
"""Of the scan for rectangles: m, sides in cells, directions in a quarter turn."""

NARROWEST, FINEST = 0.1, 0.025
"""m: the shortest side of a patch, and the step in which its sides are found."""

SHARPENED = 8
"""Power of the wheels' slips by which they share what a step slips in all: the smoother spreads one wheel's slip."""

CAPPED, FEWEST, LARGEST_PART = 0.99, 20, 1 / 3
"""Steps count no more than the worst but 1 %; a patch has so many of them, and no larger part of all."""

HOT, HOT_PASSES, HOT_WHEELS = 4.0, 4, 3
"""A pass slips so many times more, in square, than is usual elsewhere; so many do, of so many wheels."""

PATCHES = 5
"""Rectangles of the scan that are replayed."""

ROUGHLY = 0.5
"""What friction is left is known no better than by this part of itself, as the rectangle is not."""

SLIPPERY = (0.75, 0.85, 0.9, 0.94, 0.97, 0.99)
"""Fractions of friction missing that are tried."""

REPLAYED, PATCH_GAIN, LIKELY = 2.0, 12.0, 0.5
"""s of a window; the deviance that a patch must take away from what replays miss; what takes away this part of the most
is likely as well."""

FLOOR = 1e-4
"""m that is added to a step's length for the variance of its slip."""


@dataclass(frozen=True, eq=False)
class Steps:
    """What all wheels did in all steps of logs, M in all: those in which a slip is known.

    start, end (M, 2): where in N a wheel touched the floor, m. path: how far it went along its rolling direction, m.
    heading: of that direction in N, rad. slip: m. weight: over the variance, 1/m2. radius: m. track: a number for every
    wheel of every log. time: the step's number in its log.
    """

    start: Array
    end: Array
    path: Array
    heading: Array
    slip: Array
    weight: Array
    radius: Array
    track: NDArray[np.intp]
    time: NDArray[np.intp]

    def passes(self, there: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return for the steps `there` (M,) the number of their pass: one wheel's steps without a break."""
        track, time = self.track[there], self.time[there]
        new = (np.diff(track, prepend=-1) != 0) | (np.diff(time, prepend=-9) > 2)
        return np.cumsum(new) - 1


def steps_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> Steps:
    """Return the steps of logs; slips (K - 1, w) of each, m, beyond what is expected, NaN where they are not known."""
    parts: list[tuple[NDArray[Any], ...]] = []
    w = len(robot.wheels)
    radius = np.array([wheel.radius for wheel in robot.wheels])
    for k, (motion, slip) in enumerate(zip(motions, slips, strict=True)):
        places, path = contact_places(robot, motion), contact_paths(robot, motion)[:, :w]
        heading = motion.heading[:, None] + motion.half_way[:, list(robot.wheel_castors)]
        longest = np.abs(path).max(axis=1, keepdims=True) + FLOOR
        wheel, step = np.nonzero(np.isfinite(slip).T)
        weight = 1 / np.broadcast_to(longest, path.shape)
        own = (one[step, wheel] for one in (places[:-1], places[1:], path, heading, slip, weight))
        parts.append((*own, radius[wheel], k * w + wheel, step))
    steps = Steps(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    squares = float(np.sum(steps.weight * steps.slip**2))
    return dataclasses.replace(steps, weight=steps.weight * len(steps.slip) / max(squares, 1e-30))


@dataclass(frozen=True)
class Line:
    """A straight cable through (x, y) along `direction` (rad, in N, 0 to pi) of some diameter, m.

    gain: deviance that it takes away from the slips; lasting: the same without the `LARGEST` passes; passes: over it.
    """

    x: float
    y: float
    direction: float
    diameter: float
    gain: float
    lasting: float
    passes: int


def bumps_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> list[Candidate]:
    """Return the cables or thresholds that logs speak for, the best first; none where nothing stands out.

    motions: with poses in the reference's frame. slips (K - 1, w) of each: of wheels beyond what is expected, m; NaN
    where they are not known.
    """
    lines = lines_of(steps_of(robot, motions, slips))
    return [candidate_of(one) for one in lines if one.lasting >= BUMP_GAIN and one.passes >= PASSES][:MOST]


def with_cables(
    known: Sequence[Candidate], robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array]
) -> list[Candidate]:
    """Return the cables known and those that logs speak for beside them, at their most likely state.

    slips: as `slips_of` of each log. Logs without reference poses tell no places.
    """
    motions, slips = _placed(robot, logs, at, slips)
    if not motions:
        return list(known)
    own = _lines_in([*robot.effects, *(kind for one in known for kind in one.kinds)])
    new = [
        one
        for one in bumps_of(robot, motions, slips)
        if not any(same_line(line, other) for line in _lines_in(one.kinds) for other in own)
    ]
    return [*known, *new]


def _lines_in(effects: Sequence[Effect]) -> list[Bump]:
    return [one for one in effects if isinstance(one, Bump)]


def _placed(
    robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array]
) -> tuple[list[Motion], list[Array]]:
    """Return motions and slips of the logs that have reference poses."""
    posed = [
        k for k, log in enumerate(logs) if log.reference is not None and bool(np.isfinite(log.reference[:, 0]).any())
    ]
    motions = [Channels(robot).motion(logs[k], at.states[k], agreeing=True) for k in posed]
    return motions, [slips[k] for k in posed]


def slips_of(robot: RobotDescription, model: LogLikelihood, log: Log, state: Array, expected: Array) -> Array:
    """Return by how much wheels slip in a log at a state (K, m) beyond what is expected (K - 1, rows), m (K - 1, w).

    NaN of wheels that nothing is known of, and beside gaps.
    """
    slips = np.full((len(log) - 1, len(robot.wheels)), np.nan)
    along = np.flatnonzero(model.rows < len(robot.wheels))
    slips[:, model.rows[along]] = (model.missed(Geometry.of(robot.as_built()), state) - expected)[:, along]
    step = np.diff(log.t)
    gap = np.pad(step > GAP * np.median(step), 1)
    slips[gap[:-2] | gap[1:-1] | gap[2:]] = np.nan
    return slips


def candidate_of(line: Line) -> Candidate:
    """Return a line as a candidate that tells its place."""
    x, y, direction = round(line.x, 3), round(line.y, 3), round(line.direction, 3)
    effect = Bump(x=x, y=y, direction=direction, value=line.diameter)
    return Candidate(described(effect), (effect,))


def lines_of(steps: Steps) -> list[Line]:
    """Return up to `MOST` lines, the best one first; each is looked for in what those before it leave."""
    found: list[Line] = []
    while len(steps.slip) and len(found) < MOST:
        refined = [_refined(steps, *one) for one in _scan(steps)]
        if not refined:
            break
        best = max(refined, key=lambda one: one.lasting)
        found.append(best)
        shape = _rolls_more(steps, best.x, best.y, best.direction, best.diameter)
        power = float(np.sum(steps.weight * shape**2))
        part = -float(np.sum(steps.weight * shape * steps.slip)) / power if power > 0 else 0.0
        steps = dataclasses.replace(steps, slip=steps.slip + part * shape)
    return found


def same_line(one: Line | Bump, other: Line | Bump) -> bool:
    """Whether two lines can hardly be told apart: at the points by which they are given, and in direction."""
    turn = (one.direction - other.direction + math.pi / 2) % math.pi - math.pi / 2
    way = other.x - one.x, other.y - one.y
    off = max(abs(way[1] * math.cos(a) - way[0] * math.sin(a)) for a in (one.direction, other.direction))
    return abs(turn) < TURNED and off < APART


def _scan(steps: Steps) -> list[tuple[float, float]]:
    """Return the directions (rad) and offsets to the left of the origin (m) of the lines that stand out."""
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    middle = (steps.start + steps.end) / 2
    low = -float(np.max(np.hypot(*middle.T))) - BIN * max(BANDS)
    bins = int(-2 * low / BIN) + 2
    pull, power = np.zeros((DIRECTIONS, bins)), np.zeros((DIRECTIONS, bins))
    for k, angle in enumerate(angles):
        across = middle[:, 1] * math.cos(angle) - middle[:, 0] * math.sin(angle)
        shape = -steps.path * np.sin(steps.heading - angle) ** 2
        at = ((across - low) / BIN).astype(np.intp)
        pull[k] = np.bincount(at, steps.weight * shape * steps.slip, bins)
        power[k] = np.bincount(at, steps.weight * shape**2, bins)
    if not power.any():  # nothing moves
        return []
    least = np.median(power[power > 0])  # a line that is hardly crossed tells nothing
    gains = []
    for band in BANDS:
        both = (uniform_filter1d(one, band, axis=1, mode="constant") * band for one in (pull, power))
        some_pull, some_power = both
        gains.append(np.maximum(some_pull, 0.0) ** 2 / np.maximum(some_power, least))
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
    """Return the line that takes away most near one of the scan, with its own shape."""
    middle = (steps.start + steps.end) / 2
    across = middle[:, 1] * math.cos(direction) - middle[:, 0] * math.sin(direction)
    near = np.abs(across - offset) < 0.25
    here = _some(steps, near)
    crossing = np.abs(across - offset) < 0.03
    shape = (steps.weight * steps.path**2 * np.sin(steps.heading - direction) ** 4)[crossing]
    center = np.average(middle[crossing], axis=0, weights=shape) if shape.sum() > 0 else middle.mean(axis=0)
    left = np.array([-math.sin(direction), math.cos(direction)])
    center = center + (offset - center @ left) * left
    along = middle[crossing] @ [math.cos(direction), math.sin(direction)]
    size = max(float(np.std(along)), 0.1) if len(along) else 0.1

    def told(at: Array) -> tuple[float, float, float, float]:
        x, y = (center + at[1] * left).tolist()
        return x, y, direction + at[0] / size, float(np.clip(math.exp(at[2]), THIN, THICK))

    def missed(at: Array) -> float:
        shape = _rolls_more(here, *told(at))
        pull, power = np.sum(here.weight * shape * -here.slip), np.sum(here.weight * shape**2)
        return -float(max(pull, 0.0) ** 2 / (power + 1e-12))

    begin = np.array([0.0, 0.0, math.log(4e-3)])
    simplex = begin + np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.015, 0], [0, 0, 0.5]])
    options = {"initial_simplex": simplex, "xatol": 2e-4, "fatol": 0.05, "maxfev": 150}
    best = minimize(missed, begin, method="Nelder-Mead", options=options)
    x, y, direction, diameter = told(best.x)
    gain, lasting, passes = _gain(here, _rolls_more(here, x, y, direction, diameter), len(steps.slip))
    return Line(x, y, direction % math.pi, diameter, gain, lasting, passes)


def _gain(here: Steps, shape: Array, every: int) -> tuple[float, float, int]:
    """Return the deviance that what wheels roll more, `shape` (M,) in some of `every` steps, takes away, the same
    without the `LARGEST` passes, and how many passes there are."""
    there = shape != 0.0
    number = here.passes(there)
    passes = int(number[-1]) + 1 if len(number) else 0
    pull = np.bincount(number, -(here.weight * shape * here.slip)[there], passes)
    power = np.bincount(number, (here.weight * shape**2)[there], passes)
    kept = np.argsort(pull)[: max(passes - LARGEST, 0)]
    gains = [max(pull[own].sum(), 0.0) ** 2 / (power[own].sum() + 1e-12) for own in (np.arange(passes), kept)]
    strong = power > 0.1 * power.max(initial=0.0)
    return gains[0], gains[1], int(strong.sum())


def _rolls_more(steps: Steps, x: float, y: float, direction: float, diameter: float) -> Array:
    """Return how much more wheels roll in every step (M,) than their contacts move, with the sign of their path, m.

    As `Bump.slip`, in closed form: of sqrt(1 + climb^2) - 1 the first two terms, along a straight step.
    """
    c, s = math.cos(direction), math.sin(direction)
    a, b = ((place[:, 1] - y) * c - (place[:, 0] - x) * s for place in (steps.start, steps.end))
    edge = np.sqrt(2 * steps.radius * diameter)
    away = b - a
    inside = np.clip(b, -edge, edge), np.clip(a, -edge, edge)
    more = np.zeros_like(away)
    on = np.flatnonzero((inside[0] != inside[1]) | ((np.abs(a) < edge) & (np.abs(away) < 1e-9)))
    if not len(on):
        return more
    reach = (steps.radius + diameter / 2)[on]
    sine = np.sin(steps.heading[on] - direction)
    flat = np.abs(away[on]) < 1e-9
    ends = [_climbed(one[on], reach) for one in inside]
    length = np.where(flat, 1.0, away[on])
    squares, fourths = ((one - other) / length for one, other in zip(*ends, strict=True))
    middle = a[on] ** 2 / (reach**2 - np.where(flat, a[on], 0.0) ** 2)
    squares, fourths = np.where(flat, middle, squares), np.where(flat, middle**2, fourths)
    more[on] = steps.path[on] * (sine**2 * squares / 2 - sine**4 * fourths / 8)
    return more


def _climbed(d: Array, reach: Array) -> tuple[Array, Array]:
    """Return the integrals from 0 to d of t^2 / (reach^2 - t^2) and of its square."""
    turn = reach * np.arctanh(d / reach)
    first = turn - d
    return first, d - 1.5 * turn + reach**2 * d / (2 * (reach**2 - d**2))


def _some(steps: Steps, there: NDArray[np.bool_]) -> Steps:
    return Steps(*(getattr(steps, name)[there] for name in Steps.__dataclass_fields__))


class Slippery(NamedTuple):
    """A slippery patch. error: of its value. gain: deviance that it takes away from what replays of the logs miss, over
    one that is nowhere slippery. passes: how many slide in it."""

    effect: FrictionPatch
    error: float
    gain: float
    passes: int


def patches_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> list[Slippery]:
    """Return the rectangles in which wheels slip far more than elsewhere, the best first; none where none stands out.

    As `bumps_of`. What friction they leave, and so their `gain`, is not told by slips: see `slippery_in`.
    """
    steps = steps_of(robot, motions, slips)
    if len(steps.slip) == 0:
        return []
    steps = _shared(steps, len(robot.wheels))
    found: list[tuple[float, Slippery]] = []
    for box in _boxes(steps)[: 8 * PATCHES : 8]:
        box, gain = _fitted(steps, box)
        passes, wheels = _hot(steps, box, len(robot.wheels))
        if passes >= HOT_PASSES and wheels >= HOT_WHEELS:
            x, y, length, width, angle = box
            angle = (angle + math.pi / 2) % math.pi - math.pi / 2
            x, y, length, width, angle = (round(one, 3) for one in (x, y, length, width, angle))
            effect = FrictionPatch(x=x, y=y, length=length, width=width, angle=angle, value=FrictionPatch.step)
            found.append((gain, Slippery(effect, math.nan, 0.0, passes)))
    return [one for _, one in sorted(found, key=lambda one: -one[0])]


def slippery_in(robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array]) -> Slippery | None:
    """Return the patch, and the friction in it, with which simulation repeats logs best; None where none helps much.

    at: the logs' most likely state. slips: as `slips_of` of each.
    """
    tried: list[Slippery] = []
    motions, slips = _placed(robot, logs, at, slips)
    patches = patches_of(robot, motions, slips) if motions else []
    if not patches:
        return None
    try:
        plain = _missed_by(robot, logs, at)
    except InputError:  # a robot that cannot be replayed
        return None
    for patch, value in itertools.product(patches, SLIPPERY):
        effect = dataclasses.replace(patch.effect, value=value)
        gain = float(np.sum(plain - _missed_by(robot.with_effects(effect), logs, at)))
        tried.append(Slippery(effect, 0.0, gain, patch.passes))
    best = max(tried, key=lambda one: one.gain, default=None)
    if best is None or best.gain < PATCH_GAIN:
        return None
    k = SLIPPERY.index(best.effect.value)
    likely = [one.effect.value for one in tried if one.gain >= LIKELY * best.gain]
    around = float(np.diff(SLIPPERY)[max(k - 1, 0) : k + 1].mean())
    rough = ROUGHLY * (1 - best.effect.value)
    return best._replace(error=math.hypot((max(likely) - min(likely)) / 2, around / 2, rough))


def slides_there(
    robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array], effect: FrictionPatch
) -> tuple[int, float]:
    """Return how many steps of wheels lie in a patch, and how many times larger than elsewhere the squares of slip are
    in it."""
    motions, slips = _placed(robot, logs, at, slips)
    if not motions:
        return 0, 0.0
    steps = _shared(steps_of(robot, motions, slips), len(robot.wheels))
    inside = _inside(steps, (effect.x, effect.y, effect.length, effect.width, effect.angle))
    if not inside.any() or inside.all():
        return int(inside.sum()), 0.0
    mean = [float(np.mean(steps.slip[own] ** 2)) for own in (inside, ~inside)]
    return int(inside.sum()), mean[0] / max(mean[1], 1e-30)


def _missed_by(robot: RobotDescription, logs: Sequence[Log], at: State) -> Array:
    """Return the logarithms of the squares by which windows of logs, replayed, end elsewhere: wheels, pivots, place."""
    geometry = Geometry.of(robot.as_built())
    roll = np.nanmedian(2 * np.pi * geometry.radius / geometry.counts_per_rev)
    turn = np.nan_to_num(np.nanmedian(2 * np.pi / geometry.pivot_counts_per_rev))
    missed = []
    for log, clock in zip(logs, at.clocks, strict=True):
        if len(log) > 1 and log.reference is not None:
            left = replay(robot, log, REPLAYED, clock=clock, mount=at.mount)
            place = np.nan_to_num(np.sum(left.body[:, :2] ** 2, axis=1))
            pivots = np.mean(left.pivots**2, axis=1) if left.pivots.shape[1] else 0 * place
            wheels = np.mean(left.wheels**2, axis=1)
            missed.append(np.log([wheels + roll**2 / 6, pivots + turn**2 / 6 + 1e-8, place + 4e-6]))
    return np.concatenate(missed, axis=1)


def _shared(steps: Steps, w: int) -> Steps:
    """Return steps with slips whose squares are what each wheel has of what its step slips in all; without weights."""
    log_step = (steps.track // w).astype(np.int64) * (int(steps.time.max(initial=0)) + 1) + steps.time
    squares = steps.weight * steps.slip**2
    sharp = (squares / max(float(squares.max(initial=0.0)), 1e-300)) ** (SHARPENED / 2) + 1e-300
    own = sharp / np.bincount(log_step, sharp)[log_step] * np.bincount(log_step, squares)[log_step]
    moving = 1 / steps.weight > np.quantile(1 / steps.weight, 0.1)
    own = np.minimum(own, np.quantile(own, CAPPED))
    return _some(dataclasses.replace(steps, slip=np.sqrt(own), weight=np.ones_like(own)), moving)


def _ratio(n: Array, total: Array, every: float, whole: float) -> Array:
    """Return the deviance by which `n` of `every` squares, `total` of the `whole`, have another, larger variance."""
    within = np.where((n >= FEWEST) & (n < LARGEST_PART * every) & (total > 0) & (total < whole), 1.0, 0.0)
    n, total = np.where(within > 0, n, 1.0), np.where(within > 0, total, whole / every)
    inside, outside = total / n, (whole - total) / (every - n)
    told = every * math.log(whole / every) - n * np.log(inside) - (every - n) * np.log(outside)
    return np.where((within > 0) & (inside > outside), told, 0.0)


Box = tuple[float, float, float, float, float]
"""Centre x, y, length and width, m, and angle, rad."""


def _boxes(steps: Steps) -> list[Box]:
    """Return rectangles of a scan, the one whose variance differs most first."""
    middle, squares = (steps.start + steps.end) / 2, steps.slip**2
    if not len(squares):  # nothing moves
        return []
    every, whole = float(len(squares)), float(squares.sum())
    found: list[tuple[float, Box]] = []
    for angle in np.arange(TILTS) * np.pi / 2 / TILTS:
        c, s = math.cos(angle), math.sin(angle)
        place = np.column_stack([c * middle[:, 0] + s * middle[:, 1], c * middle[:, 1] - s * middle[:, 0]])
        low = place.min(axis=0) - CELL
        cell = ((place - low) / CELL).astype(np.intp)
        shape = cell.max(axis=0) + 2
        flat = np.ravel_multi_index((cell[:, 0], cell[:, 1]), shape)
        number, total = (
            np.pad(np.bincount(flat, own, int(shape.prod())).reshape(shape).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
            for own in (None, squares)
        )
        for a, b in itertools.product(SIDES, SIDES):
            if a > shape[0] or b > shape[1]:
                continue
            n, t = (one[a:, b:] - one[:-a, b:] - one[a:, :-b] + one[:-a, :-b] for one in (number, total))
            gain = _ratio(n.astype(float), t, every, whole)
            i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
            right, up = low + (np.array([i, j]) + np.array([a, b]) / 2) * CELL
            box = float(c * right - s * up), float(s * right + c * up), a * CELL, b * CELL, float(angle)
            found.append((float(gain[i, j]), box))
    return [box for gain, box in sorted(found, key=lambda one: -one[0]) if gain > 0]


def _fitted(steps: Steps, box: Box) -> tuple[Box, float]:
    """Return the rectangle near another whose variance differs most without its hottest pass, and the deviance."""
    gain, step = _lasting(steps, box), 4 * FINEST
    while step >= FINEST:
        tried = [(one, _lasting(steps, one)) for one in _near(box, step)]
        best = max(tried, key=lambda one: one[1])
        if best[1] > gain:
            box, gain = best
        else:
            step /= 2
    return box, gain


def _near(box: Box, step: float) -> Iterator[Box]:
    """Yield rectangles with one side moved, or turned."""
    x, y, length, width, angle = box
    c, s = math.cos(angle), math.sin(angle)
    for by, way in itertools.product((step, -step), (1, -1)):
        if length + by >= NARROWEST:
            yield x + way * by / 2 * c, y + way * by / 2 * s, length + by, width, angle
        if width + by >= NARROWEST:
            yield x - way * by / 2 * s, y + way * by / 2 * c, length, width + by, angle
    for turn in (2 * step, -2 * step):
        yield x, y, length, width, angle + turn


def _inside(steps: Steps, box: Box) -> NDArray[np.bool_]:
    x, y, length, width, angle = box
    c, s = math.cos(angle), math.sin(angle)
    right, up = ((steps.start + steps.end) / 2 - (x, y)).T
    return (np.abs(c * right + s * up) <= length / 2) & (np.abs(c * up - s * right) <= width / 2)


def _lasting(steps: Steps, box: Box) -> float:
    inside = _inside(steps, box)
    number = steps.passes(inside)
    squares = steps.slip**2
    if not len(number):
        return 0.0
    n, total = np.bincount(number).astype(float), np.bincount(number, squares[inside])
    hottest = int(np.argmax(total))
    every, whole = len(squares) - n[hottest], float(squares.sum() - total[hottest])
    return float(_ratio(n.sum() - n[hottest], total.sum() - total[hottest], every, whole))


def _hot(steps: Steps, box: Box, w: int) -> tuple[int, int]:
    """Return how many passes through a rectangle slip far more than is usual outside, and of how many wheels."""
    inside = _inside(steps, box)
    number = steps.passes(inside)
    if not len(number):
        return 0, 0
    usual = float(np.mean(steps.slip[~inside] ** 2))
    mean = np.bincount(number, steps.slip[inside] ** 2) / np.bincount(number)
    hot = mean > HOT * usual
    return int(hot.sum()), len(np.unique(steps.track[inside][hot[number]] % w))
