"""Whether wheels and reference of a log tell of one drive: wrong units and signs of a map show in that.

From the reference's motion follows how far each wheel rolls (`castor_envs.motion.kinematics`). Only what is far off is
said; what a robot's numbers truly are, calibration and diagnosis find.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log, poses_taken, positions_taken
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.vehicles.robot import RobotDescription

WINDOW, LONGEST = 0.5, 1.0
"""s: motions are compared over windows, in which a robot goes further than a tracker's noise; longest time between
poses, in which a robot may turn far."""

FAR, MUCH = 0.02, 0.05
"""m, rad: a motion in a window that is no noise of a tracker, of mm and mrad. Windows without any are left out."""

LEAST = 0.2
"""m: from such a way on, in all, wheels and reference are compared."""

FACTOR = 5.0
"""Units differ by 10 (cm) or more; slip, wrong radii and a tracker off the middle by less than this."""

PIECE = 4096
"""Steps between poses that are computed at once: some MB."""

ALIKE = 0.9
"""Correlation from which a wheel rolls with the reference, or against it."""


def agreement_notes(robot: RobotDescription, log: Log) -> Iterator[str]:
    """Yield what is far off between wheels and reference of a log; nothing where there is no reference or no motion."""
    rows = poses_taken(log)
    if not len(rows):  # without a heading only how far it goes is compared
        rows = positions_taken(log)
    if len(rows) < 2 or not np.size(log.wheel):
        return
    geometry = Geometry.of(robot.as_built())
    motion, rolled, expected = _windows(geometry, log, rows)
    way, turn = np.hypot(motion[:, 0], motion[:, 1]), np.abs(motion[:, 2])
    if not (headed := bool(np.isfinite(turn).all())):
        turn = np.zeros(len(turn))
    kept = (way > FAR) | (turn > MUCH) | (np.abs(rolled) > FAR).any(axis=1)
    way, turn, rolled, expected = way[kept], turn[kept], rolled[kept], expected[kept]
    gone, turned, most = float(way[way > FAR].sum()), float(turn[turn > MUCH].sum()), float(_most(rolled).sum())
    if max(gone, most, turned * _span(geometry)) < LEAST:
        return
    names, right, alike = [*LogColumns.of(robot).wheel], *_compared(rolled, expected)
    along, against, seen = right & (alike > ALIKE), alike < -ALIKE, np.isfinite(alike)
    if against.any() and np.all(against[seen]):
        yield (
            "wheels: all roll against the way that the reference goes: are their signs right, or is its heading that "
            "of the rear?"
        )
        return
    if along.any():
        for k in np.flatnonzero(against):
            yield f"{names[k]}: rolls against the way that the reference goes, others with it: is its sign right?"
        for k in np.flatnonzero(seen & ~right):
            yield (
                f"{names[k]}: rolls {np.abs(rolled[:, k]).sum():.3g} m, by the reference it would "
                f"{np.abs(expected[:, k]).sum():.3g} m, while others agree: is its unit right, and its counts_per_rev?"
            )
        return
    turns = f" and turns by {turned:.3g} rad" if headed else ""
    told = f"the reference goes {gone:.3g} m{turns} in all, wheels roll {most:.3g} m"
    # The middle of a body goes no further than the fastest of the wheels around it, and two wheels turn it together.
    too_far, too_much = gone > FACTOR * most, turned * _span(geometry) / 2 > FACTOR * most
    if (too_far and too_much) or (headed and most > FACTOR * (way.sum() + geometry.reach * turn.sum())):
        yield f"wheels: {told}: are the units of the wheels right, their counts_per_rev and radius, and that of ref_x?"
    elif too_far:
        yield f"ref_x: {told}: is the unit right, and those of the wheels?"
    elif too_much:
        yield f"ref_psi: {told}: is the unit right?"


def _compared(rolled: Array, expected: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return which wheels (d,) roll about as far in windows as expected, both (W, d), m; and their correlations (d,).

    NaN and False of those that do not roll, and those of which nothing is known.
    """
    size, wanted = np.sqrt((rolled**2).sum(axis=0)), np.sqrt((expected**2).sum(axis=0))
    seen = np.maximum(np.abs(rolled).sum(axis=0), np.abs(expected).sum(axis=0)) > LEAST  # False of NaN
    right = seen & (size < FACTOR * wanted) & (wanted < FACTOR * size)
    product = (rolled * expected).sum(axis=0)
    return right, np.where(seen, product / np.maximum(size * wanted, np.finfo(float).tiny), np.nan)


def _windows(geometry: Geometry, log: Log, rows: NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Return of W windows the reference's motion (W, 3), m and rad, how far each wheel with an encoder rolled (W, d),
    m, and how far it would by that motion; NaN where its castor's angle is not known.

    rows: those with a pose, or with a position alone: the motion is then in the reference's axes, its turn NaN.
    """
    assert log.reference is not None
    t, driven = np.asarray(log.t)[rows], ~np.isnan(geometry.counts_per_rev)
    read = np.asarray(log.pivot) * (2 * np.pi / geometry.pivot_counts_per_rev[geometry.sensed])
    turned = np.unwrap(read, axis=0)[rows] - geometry.pivot_zero[geometry.sensed]
    per_count = 2 * np.pi * geometry.radius[driven] / geometry.counts_per_rev[driven]
    near = np.diff(t) <= LONGEST
    window = np.full(len(near), -1)
    _, window[near] = np.unique(np.floor((t[:-1] - t[0]) / WINDOW)[near], return_inverse=True)
    sums = tuple(np.zeros((window.max(initial=-1) + 1, width)) for width in (3, len(per_count), len(per_count)))
    for first in range(0, len(near), PIECE):
        steps, points = slice(first, first + PIECE), slice(first, first + PIECE + 1)
        pose = np.asarray(log.reference)[rows[points]]
        castor = np.tile(geometry.known_angle, (len(pose), 1))
        castor[:, geometry.sensed] = turned[points]
        a, b = (part[:, : len(driven)] for part in constraint_matrix(geometry, (castor[1:] + castor[:-1]) / 2))
        moved = np.diff(pose, axis=0)
        way = rotate(moved[:, :2], -(pose[1:, 2] + pose[:-1, 2]) / 2)
        moved[:, :2] = np.where(np.isnan(way), moved[:, :2], way)
        rolled = np.diff(np.asarray(log.wheel)[rows[points]], axis=0) * per_count
        expected = (a @ moved[..., None])[..., 0] + b * np.diff(castor, axis=0)[:, geometry.wheel_castor]
        for total, part in zip(sums, (moved, rolled, expected[:, driven]), strict=True):
            np.add.at(total, window[steps][near[steps]], part[near[steps]])
    return sums[0], sums[1], sums[2]


def _most(rolled: Array) -> Array:
    return np.abs(rolled).max(axis=1, initial=0.0)


def _span(geometry: Geometry) -> float:
    """Return the largest distance of two wheels, m, with all castors straight ahead."""
    at = geometry.pivot[geometry.wheel_castor] + np.column_stack(
        [-geometry.offset[geometry.wheel_castor], geometry.lateral]
    )
    return float(np.linalg.norm(at[:, None] - at, axis=-1).max())
