"""Rigid alignment of a path with a reference: where both worlds are to each other is no error of odometry.

Sum over poses of the squared distances and, times `size` squared, of the squared chords of the headings' errors is
least (Umeyama, IEEE Trans. Pattern Analysis and Machine Intelligence 13(4), 1991, without scale; a robot that turns on
the spot hardly moves, so headings take part).
"""

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate


def aligned(path: Array, reference: Array, size: float) -> Array:
    """Return a path (K, 3) moved and turned as a whole so that it comes nearest to a reference (K, 3), m and rad.

    size: m, by which errors of headings count as distances; of a vehicle, how far it reaches. Headings of the reference
    that are NaN do not count.
    """
    middle, middle_seen = path[:, :2].mean(axis=0), reference[:, :2].mean(axis=0)
    way, way_seen = ((poses[:, :2] - at) @ [1, 1j] for poses, at in ((path, middle), (reference, middle_seen)))
    known = np.isfinite(reference[:, 2])
    headings = np.sum(np.exp(1j * (reference[known, 2] - path[known, 2])))
    turn = float(np.angle(np.vdot(way, way_seen) + size**2 * headings))
    return np.column_stack([rotate(path[:, :2] - middle, np.full(len(path), turn)) + middle_seen, path[:, 2] + turn])
