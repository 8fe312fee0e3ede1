"""Slippery patches of the floor, as rectangles in which wheels slip far more than elsewhere, of either sign.

A scan over rectangles for two variances, then replays of the logs in simulation. One event may lie anywhere: what
counts is what is left without the largest ones.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.floor import FrictionPatch
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.wheel_tracks import Steps, placed, steps_of
from discrepancy.validation.replay import replay
from estimators.calibration.maximum_likelihood import State

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


class Slippery(NamedTuple):
    """A slippery patch. error: of its value. gain: deviance that it takes away from what replays of the logs miss, over
    one that is nowhere slippery. passes: how many slide in it."""

    effect: FrictionPatch
    error: float
    gain: float
    passes: int


def patches_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> list[Slippery]:
    """Return the rectangles in which wheels slip far more than elsewhere, the best first; none where none stands out.

    As `cables.bumps_of`. What friction they leave, and so their `gain`, is not told by slips: see `slippery_in`.
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
    motions, slips = placed(robot, logs, at, slips)
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
    motions, slips = placed(robot, logs, at, slips)
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
    return dataclasses.replace(steps, slip=np.sqrt(own), weight=np.ones_like(own)).only(moving)


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
