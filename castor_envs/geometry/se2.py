"""Poses in the plane: (..., 3) = x, y (m), psi (rad). Arithmetic broadcasts; headings are never wrapped here."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array


def compose(pose: ArrayLike, seen: ArrayLike) -> Array:
    """Return in N what is `seen` (..., 3) from `pose` (..., 3)."""
    pose, seen = np.asarray(pose, dtype=float), np.asarray(seen, dtype=float)
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = pose[..., 0] + c * seen[..., 0] - s * seen[..., 1]
    y = pose[..., 1] + s * seen[..., 0] + c * seen[..., 1]
    return np.stack([x, y, pose[..., 2] + seen[..., 2]], axis=-1)


def relative_pose(start: ArrayLike, end: ArrayLike) -> Array:
    """Return the pose `end` (..., 3) as seen from the pose `start` (..., 3)."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    c, s = np.cos(start[..., 2]), np.sin(start[..., 2])
    x, y = end[..., 0] - start[..., 0], end[..., 1] - start[..., 1]
    return np.stack([c * x + s * y, c * y - s * x, end[..., 2] - start[..., 2]], axis=-1)


def inverse(seen: ArrayLike) -> Array:
    """Return where the observer is, (..., 3), as seen from what it sees at `seen` (..., 3)."""
    return relative_pose(seen, np.zeros(3))
