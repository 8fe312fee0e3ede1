"""Metrics of a train's localisation as pure functions on arrays.

Poses of a train are (N, M, 3): axles from the front, samples, and x, y (m), psi (rad). All compare an estimate with the
truth without any alignment. A train's heading matters as a direction alone, so heading errors are wrapped.
"""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose

KEPT = 1e-9
"""m and rad: an axle whose pose an estimator changes by less is one that it kept."""


def axle_position_errors(true: ArrayLike, estimated: ArrayLike) -> Array:
    """Return how far each axle is from where it truly is, (N, M), m."""
    off = np.asarray(estimated, dtype=float)[..., :2] - np.asarray(true, dtype=float)[..., :2]
    return np.hypot(off[..., 0], off[..., 1])


def axle_heading_errors(true: ArrayLike, estimated: ArrayLike) -> Array:
    """Return how far each axle's heading is off, the shorter way round, (N, M), rad, not negative."""
    off = np.asarray(estimated, dtype=float)[..., 2] - np.asarray(true, dtype=float)[..., 2]
    return np.abs(off - 2 * np.pi * np.round(off / (2 * np.pi)))


def kept_axle(belief: ArrayLike, estimated: ArrayLike) -> int | None:
    """Return the axle, from 1, whose pose of a belief (N, 3) an estimate (N, 3) keeps; None if not exactly one."""
    change = np.abs(np.asarray(estimated, dtype=float) - np.asarray(belief, dtype=float)).max(axis=-1)
    kept = np.flatnonzero(change < KEPT)
    return int(kept[0]) + 1 if len(kept) == 1 else None


def contradictions(estimated: ArrayLike, rps: ArrayLike) -> Array:
    """Return how far estimates contradict the relative posture sensors, (N - 1, M), m; NaN where there is no reading.

    rps (M, 3 (N - 1)): the sensors' readings. The contradiction of a frame is the distance between where the estimate's
    rear axle sees its front axle and where the sensor sees it, in the rear axle's frame.
    """
    poses, readings = np.asarray(estimated, dtype=float), np.asarray(rps, dtype=float)
    seen = relative_pose(poses[1:], poses[:-1])
    read = np.reshape(readings, (len(readings), -1, 3)).swapaxes(0, 1)
    return np.hypot(seen[..., 0] - read[..., 0], seen[..., 1] - read[..., 1])
