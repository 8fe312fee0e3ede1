"""Odometry metrics as pure functions on arrays.

Poses are (..., 3) = x, y (m), psi (rad, unwrapped). All compare an estimate with the truth from the same start pose and
without any alignment: aligning a planar path can hide an error that mirrors it. Heading errors are plain differences of
unwrapped headings, so a missed turn of 2 pi counts as one.

Sources:

- UMBmark: Borenstein and Feng, "UMBmark: A Method for Measuring, Comparing, and Correcting Dead-reckoning Errors in
  Mobile Robots", University of Michigan UM-MEAM-94-22, 1994
- extended UMBmark: the same, "UMBmark: A Benchmark Test for Measuring Odometry Errors in Mobile Robots", SPIE 1995
- ATE: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, here without alignment
- relative error over a distance: Geiger, Lenz and Urtasun, "Are we ready for Autonomous Driving? The KITTI Vision
  Benchmark Suite", CVPR 2012, here in the plane
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose


def return_errors(start: ArrayLike, true_end: ArrayLike, estimated_end: ArrayLike) -> Array:
    """Return UMBmark's return errors (..., 3): eps_x, eps_y (m), eps_theta (rad) = true minus odometry.

    All poses (..., 3). The errors are in the frame of the start pose, which UMBmark puts in the corner of two walls.
    """
    return relative_pose(start, true_end) - relative_pose(start, estimated_end)


class UMBmark(NamedTuple):
    """UMBmark's numbers, m: centroids (..., 2) of both clusters, their distances from 0 and the larger one (...)."""

    centroid_cw: Array
    centroid_ccw: Array
    r_cw: Array
    r_ccw: Array
    e_max_syst: Array


def umbmark(cw: ArrayLike, ccw: ArrayLike) -> UMBmark:
    """Return UMBmark's measure of systematic errors from return errors (..., n, 2 or 3) of clockwise and ccw runs.

    The centres of gravity of both clusters of errors lie r_cw and r_ccw from the origin, and E_max,syst is the larger
    of the two (Borenstein and Feng 1994).
    """
    centroid_cw = np.mean(np.asarray(cw, dtype=float)[..., :2], axis=-2)
    centroid_ccw = np.mean(np.asarray(ccw, dtype=float)[..., :2], axis=-2)
    r_cw, r_ccw = np.linalg.norm(centroid_cw, axis=-1), np.linalg.norm(centroid_ccw, axis=-1)
    return UMBmark(centroid_cw, centroid_ccw, r_cw, r_ccw, np.maximum(r_cw, r_ccw))


def orientation_error(
    cw: ArrayLike, ccw: ArrayLike, clean_cw: ArrayLike | None = None, clean_ccw: ArrayLike | None = None
) -> Array:
    """Return the extended UMBmark's average absolute orientation error (...), rad.

    cw, ccw: return orientation errors (..., n), rad, of the runs over bumps. clean_cw, clean_ccw: those of the same
    robot on the clean floor (..., m); their mean in each direction is the systematic error, which is taken off before
    the absolute value, so that only what the bumps did is left. Without them nothing is taken off. The two directions'
    means of |eps_theta| are averaged. Positions are not used: they depend on where the bumps lay, the orientation does
    not (Borenstein and Feng 1995).
    """

    def mean_absolute(errors: ArrayLike, clean: ArrayLike | None) -> Array:
        bias = 0.0 if clean is None else np.mean(np.asarray(clean, dtype=float), axis=-1, keepdims=True)
        return np.mean(np.abs(np.asarray(errors, dtype=float) - bias), axis=-1)

    return (mean_absolute(cw, clean_cw) + mean_absolute(ccw, clean_ccw)) / 2


class EndPointError(NamedTuple):
    """How far the last pose is off: position, m, and heading, rad, both (...) and not negative."""

    position: Array
    heading: Array


def end_point_error(true: ArrayLike, estimated: ArrayLike) -> EndPointError:
    """Return the error of the last pose of paths (..., N, 3)."""
    off = np.asarray(estimated, dtype=float)[..., -1, :] - np.asarray(true, dtype=float)[..., -1, :]
    return EndPointError(np.hypot(off[..., 0], off[..., 1]), np.abs(off[..., 2]))


def absolute_trajectory_error(true: ArrayLike, estimated: ArrayLike) -> Array:
    """Return the root mean square over the samples of the position error, (...), m, of paths (..., N, 3)."""
    off = np.asarray(estimated, dtype=float)[..., :2] - np.asarray(true, dtype=float)[..., :2]
    return np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=-1))


class RelativeError(NamedTuple):
    """Mean relative pose error: translation as a fraction of the distance, rotation in rad a metre, both (...)."""

    translation: Array
    rotation: Array


def relative_pose_error(true: ArrayLike, estimated: ArrayLike, distance: float = 1.0) -> RelativeError:
    """Return the mean error of the motion over segments of a fixed true distance (m), as KITTI does, in the plane.

    true (N, 3), estimated (..., N, 3). A segment starts at every sample and ends at the first one by which the robot
    has truly travelled `distance` (the path length along the samples; turning on the spot is no distance). The error is
    the true end of the segment as seen from the estimated one, both in the frame of their segment's start; it is
    divided by the length really travelled and averaged over the segments. NaN where the whole path is shorter than
    `distance`.
    """
    true, estimated = np.asarray(true, dtype=float), np.asarray(estimated, dtype=float)
    steps = np.linalg.norm(np.diff(true[:, :2], axis=0), axis=-1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    end = np.searchsorted(travelled, travelled + distance * (1.0 - 1e-9))
    start = np.flatnonzero(end < len(true))
    end = end[start]
    if not start.size:
        return RelativeError(*np.full((2, *estimated.shape[:-2]), np.nan))
    wanted = relative_pose(true[start], true[end])
    moved = relative_pose(estimated[..., start, :], estimated[..., end, :])
    off = relative_pose(moved, np.broadcast_to(wanted, moved.shape))
    length = travelled[end] - travelled[start]
    translation = np.hypot(off[..., 0], off[..., 1]) / length
    return RelativeError(np.mean(translation, axis=-1), np.mean(np.abs(off[..., 2]) / length, axis=-1))
