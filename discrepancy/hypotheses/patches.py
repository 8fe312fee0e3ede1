"""Slippery patches of the floor, as rectangles in which wheels slip far more than elsewhere, of either sign.

A scan over rectangles compares the variances inside and outside. As a single event may lie anywhere, a rectangle is
judged without its largest pass.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.floor import FrictionPatch
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.wheel_tracks import Steps, along_and_across, steps_of

CELL, SIDES, TILTS = 0.1, (2, 3, 4, 6, 8, 12), 6
"""Grid of the scan for rectangles: cell, m, which is also the shortest side of a patch and the step in which replays
move sides; sides in cells; directions in a quarter turn. The scan finds sides to a quarter of a cell."""

SHARPENED = 8
"""Power of the wheels' slips in proportion to which they share the total squared slip of a step, as the smoother
spreads one wheel's slip over all wheels."""

CAPPED, FEWEST, LARGEST_PART = 0.99, 20, 1 / 3
"""Squares of slips are clipped at their 99th percentile; least number of steps in a patch, and largest part of all
steps."""

PATCHES = 3
"""Rectangles of the scan that are proposed."""


Box = tuple[float, float, float, float, float]
"""Centre x, y, length and width, m, and angle, rad."""


def patches_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> list[FrictionPatch]:
    """Return the rectangles in which wheels slip most compared with elsewhere, the best first, with the value of their
    step, as slips do not determine the friction that is left.

    Arguments as for `cables.bumps_of`.
    """
    steps = steps_of(robot, motions, slips)
    if len(steps.slip) == 0:
        return []
    steps = _shared(steps, len(robot.wheels))
    found = sorted((_fitted(steps, box) for box in _boxes(steps)[: 8 * PATCHES : 8]), key=lambda fit: -fit[1])
    return list(dict.fromkeys(patch_at(box) for box, gain in found if gain > 0))


def patch_at(box: Box) -> FrictionPatch:
    """Return the patch of a rectangle, to the millimetre."""
    x, y, length, width, angle = box
    angle = (angle + math.pi / 2) % math.pi - math.pi / 2
    x, y, length, width, angle = (round(number, 3) for number in (x, y, length, width, angle))
    return FrictionPatch(x=x, y=y, length=length, width=width, angle=angle, value=FrictionPatch.step)


def box_of(patch: FrictionPatch) -> Box:
    """Return the rectangle of a patch."""
    return patch.x, patch.y, patch.length, patch.width, patch.angle


def within(places: Array, box: Box) -> NDArray[np.bool_]:
    """Return which places (n, 2) lie in a rectangle."""
    x, y, length, width, angle = box
    along, across = along_and_across(places - (x, y), angle)
    return (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)


def _shared(steps: Steps, w: int) -> Steps:
    """Return steps with slips whose squares are each wheel's share of the total squared slip of its step; without
    weights."""
    log_step = (steps.track // w).astype(np.int64) * (int(steps.time.max(initial=0)) + 1) + steps.time
    squares = steps.weight * steps.slip**2
    sharp = (squares / max(float(squares.max(initial=0.0)), 1e-300)) ** (SHARPENED / 2) + 1e-300
    share = sharp / np.bincount(log_step, sharp)[log_step] * np.bincount(log_step, squares)[log_step]
    moving = 1 / steps.weight > np.quantile(1 / steps.weight, 0.1)
    share = np.minimum(share, np.quantile(share, CAPPED))
    return dataclasses.replace(steps, slip=np.sqrt(share), weight=np.ones_like(share)).only(moving)


def _ratio(n: Array, total: Array, count: float, overall: float) -> Array:
    """Return the deviance by which `n` of `count` squares, summing to `total` of `overall`, have a larger variance."""
    within = np.where((n >= FEWEST) & (n < LARGEST_PART * count) & (total > 0) & (total < overall), 1.0, 0.0)
    n, total = np.where(within > 0, n, 1.0), np.where(within > 0, total, overall / count)
    inside, outside = total / n, (overall - total) / (count - n)
    log_factor = count * math.log(overall / count) - n * np.log(inside) - (count - n) * np.log(outside)
    return np.where((within > 0) & (inside > outside), log_factor, 0.0)


def _boxes(steps: Steps) -> list[Box]:
    """Return rectangles of a scan, the one whose variance differs most first."""
    squares = steps.slip**2
    if not len(squares):  # nothing moves
        return []
    count, overall = float(len(squares)), float(squares.sum())
    found: list[tuple[float, Box]] = []
    for angle in np.arange(TILTS) * np.pi / 2 / TILTS:
        c, s = math.cos(angle), math.sin(angle)
        place = along_and_across(steps.middle, angle).T
        low = place.min(axis=0) - CELL
        cell = ((place - low) / CELL).astype(np.intp)
        shape = cell.max(axis=0) + 2
        flat = np.ravel_multi_index((cell[:, 0], cell[:, 1]), shape)
        number, total = (
            np.pad(np.bincount(flat, weights, int(shape.prod())).reshape(shape).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
            for weights in (None, squares)
        )
        for a, b in itertools.product(SIDES, SIDES):
            if a > shape[0] or b > shape[1]:
                continue
            n, t = (sums[a:, b:] - sums[:-a, b:] - sums[a:, :-b] + sums[:-a, :-b] for sums in (number, total))
            gain = _ratio(n.astype(float), t, count, overall)
            i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
            right, up = low + (np.array([i, j]) + np.array([a, b]) / 2) * CELL
            box = float(c * right - s * up), float(s * right + c * up), a * CELL, b * CELL, float(angle)
            found.append((float(gain[i, j]), box))
    return [box for gain, box in sorted(found, key=lambda entry: -entry[0]) if gain > 0]


def _fitted(steps: Steps, box: Box) -> tuple[Box, float]:
    """Return the rectangle near another whose variance differs most without its hottest pass, and the deviance."""
    gain, step = _lasting(steps, box), CELL
    while step >= CELL / 4:
        tried = [(moved, _lasting(steps, moved)) for moved in near(box, step)]
        best = max(tried, key=lambda entry: entry[1])
        if best[1] > gain:
            box, gain = best
        else:
            step /= 2
    return box, gain


def near(box: Box, step: float) -> Iterator[Box]:
    """Yield rectangles with one side moved, or turned."""
    x, y, length, width, angle = box
    c, s = math.cos(angle), math.sin(angle)
    for by, way in itertools.product((step, -step), (1, -1)):
        if length + by >= CELL:
            yield x + way * by / 2 * c, y + way * by / 2 * s, length + by, width, angle
        if width + by >= CELL:
            yield x - way * by / 2 * s, y + way * by / 2 * c, length, width + by, angle
    for turn in (2 * step, -2 * step):
        yield x, y, length, width, angle + turn


def _lasting(steps: Steps, box: Box) -> float:
    """Return the deviance by which the variance in a rectangle differs without its hottest pass."""
    inside, squares = within(steps.middle, box), steps.slip**2
    number = steps.passes(inside)
    if not len(number):
        return 0.0
    n, total = np.bincount(number).astype(float), np.bincount(number, squares[inside])
    hottest = int(np.argmax(total))
    count, overall = len(squares) - n[hottest], float(squares.sum() - total[hottest])
    return float(_ratio(n.sum() - n[hottest], total.sum() - total[hottest], count, overall))
