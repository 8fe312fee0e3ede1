"""Headings of a path of which a reference shows positions alone: as odometry has them, turned so that it follows these.

Around each position, odometry's steps are turned together so that they come nearest to those between positions
(`alignment`, of a part of the path), as heading drifts. A tracked point off the body's origin goes other ways where the
body turns, so its place is found beside that, by turns. These are headings to start from, not estimates.
"""

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.mounting import FIRM

AROUND = 8.0
"""Mean steps before and after a position that show how odometry is turned there: noise of positions is averaged, and
heading hardly drifts."""

ROUNDS = 10
"""How often the turns of odometry and the tracked point are found in turn."""


def headings_along(path: Array, seen: Array, way: Array, size: float) -> Array:
    """Return headings (k,) of a body, rad: as seen, or where these are NaN, those of a path by odometry, turned.

    path, seen (k, 3): poses of the body by odometry, and of a tracked point by a reference, each in its own world. way
    (k,): rolled until each, m, increasing. size: how far from the origin the tracked point may be, m. The answer turns
    with the reference's world, and does not depend on where either world's origin is.
    """
    body, tracked = path[:, :2] @ [1, 1j], seen[:, :2] @ [1, 1j]
    moved, went, arm = np.diff(body), np.diff(tracked), np.diff(np.exp(1j * path[:, 2]))
    told = size**2 * np.nan_to_num(np.exp(1j * (seen[:, 2] - path[:, 2])))
    reach = AROUND * (way[-1] - way[0]) / max(len(moved), 1)

    def around(products: Array, at: Array) -> Array:
        sums = np.concatenate([[0.0], np.cumsum(products)])
        first, last = np.searchsorted(at, way - reach, "left"), np.searchsorted(at, way + reach, "right")
        return np.asarray(sums[last] - sums[first])

    turn, point, known = np.zeros(len(way)), 0.0, np.isfinite(seen[:, 2])
    doubt = FIRM * float(np.vdot(went, went).real) / size**2 + np.finfo(float).tiny
    for _ in range(ROUNDS):
        shown = around(np.conj(moved + point * arm) * went, (way[1:] + way[:-1]) / 2) + around(told, way)
        turn = np.unwrap(np.angle(shown))
        left = went * np.exp(-1j * (turn[1:] + turn[:-1]) / 2) - moved
        point = np.vdot(arm, left) / (np.vdot(arm, arm).real + doubt)
    off = np.where(known, seen[:, 2] - path[:, 2] - turn, np.nan)
    whole = 0.0 if not known.any() else 2 * np.pi * np.round(off[known][0] / (2 * np.pi))
    return np.where(known, seen[:, 2], path[:, 2] + turn + whole)
