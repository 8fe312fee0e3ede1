"""Metrics along a path: of its end, of the whole path, and of its segments.

Poses are (..., 3) = x, y (m), psi (rad, unwrapped). All compare an estimate with the truth from the same start pose and
without any alignment: aligning a planar path can hide an error that mirrors it. Heading errors are plain differences of
unwrapped headings, so a missed turn of 2 pi counts as one.

Sources:

- ATE: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, here without alignment
- relative error over a distance: Geiger, Lenz and Urtasun, "Are we ready for Autonomous Driving? The KITTI Vision
  Benchmark Suite", CVPR 2012, here in the plane
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.scoring.metric import DEG, MM, PER_CENT, Column, Judged, Metric, shared
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose

STANDING_STILL = "ate_standing_still"
"""The ATE of an estimator that stays at the start; stored, since on a closed path such an estimator can score well."""

ATTAINED = "attained"
"""Computed by boards (`attained`), as it needs the scores of two references beside the estimator's."""

SEGMENT = 1.0
"""m, over which relative errors are taken."""

DRIFT_DISTANCES = (10.0, 20.0, 50.0, 100.0)
"""m, over which the error per distance is taken; as KITTI's, for robots in halls instead of cars on roads."""


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


def relative_pose_error(true: ArrayLike, estimated: ArrayLike, distance: float = SEGMENT) -> RelativeError:
    """Return the mean error of the motion over segments of a fixed true distance (m), as KITTI does, in the plane.

    true (N, 3), estimated (..., N, 3). A segment starts at every sample and ends at the first one by which the robot
    has truly travelled `distance` (the path length along the samples; turning on the spot is no distance). The error is
    the true end of the segment as seen from the estimated one, both in the frame of their segment's start; it is
    divided by the length really travelled and averaged over the segments. NaN where the whole path is shorter than
    `distance`.
    """
    true, estimated = np.asarray(true, dtype=float), np.asarray(estimated, dtype=float)
    travelled = _travelled(true)
    end = np.searchsorted(travelled, travelled + _reached(distance))
    start = np.flatnonzero(end < len(true))
    end = end[start]
    if not start.size:
        return RelativeError(*np.full((2, *estimated.shape[:-2]), np.nan))
    moved_truly = relative_pose(true[start], true[end])
    moved = relative_pose(estimated[..., start, :], estimated[..., end, :])
    off = relative_pose(moved, np.broadcast_to(moved_truly, moved.shape))
    length = travelled[end] - travelled[start]
    translation = np.hypot(off[..., 0], off[..., 1]) / length
    return RelativeError(np.mean(translation, axis=-1), np.mean(np.abs(off[..., 2]) / length, axis=-1))


def _travelled(true: Array) -> Array:
    """Return how far a path (N, 3) has come at its samples (N,), m."""
    steps = np.linalg.norm(np.diff(true[:, :2], axis=0), axis=-1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _reached(distance: float) -> float:
    """Return from which way on a distance counts as travelled, but for rounding."""
    return distance * (1.0 - 1e-9)


@shared
def _ends(judged: Judged) -> list[EndPointError] | None:
    """Return how far the ends of a robot's paths are off; None of trains, whose axles have separate metrics."""
    return None if judged.of_train else [end_point_error(true, estimate) for _, true, estimate in judged.scored]


@shared
def _relative(judged: Judged) -> list[RelativeError]:
    """Return the relative errors of those of a robot's runs that are long enough for them."""
    paths = [] if judged.of_train else judged.scored
    return [
        relative_pose_error(true, estimate) for _, true, estimate in paths if _travelled(true)[-1] >= _reached(SEGMENT)
    ]


def _end_point_position(judged: Judged) -> np.floating | None:
    ends = _ends(judged)
    return None if ends is None else np.mean([end.position for end in ends])


def _end_point_heading(judged: Judged) -> np.floating | None:
    ends = _ends(judged)
    return None if ends is None else np.mean([end.heading for end in ends])


def _rpe_translation(judged: Judged) -> np.floating | None:
    errors = _relative(judged)
    return np.mean([error.translation for error in errors]) if errors else None


def _rpe_rotation(judged: Judged) -> np.floating | None:
    errors = _relative(judged)
    return np.mean([error.rotation for error in errors]) if errors else None


def _ate(judged: Judged) -> np.floating | None:
    """Return None of snapshots, which have no path."""
    drives = [path for path in judged.scored if path.run.belief is None]
    return np.mean([absolute_trajectory_error(p.true, p.estimate) for p in drives]) if drives else None


def _ate_standing_still(judged: Judged) -> np.floating | None:
    drives = [path for path in judged.scored if path.run.belief is None]
    return np.mean([absolute_trajectory_error(p.true, p.true[..., :1, :]) for p in drives]) if drives else None


def drift(true: ArrayLike, estimated: ArrayLike) -> float | None:
    """Return the error of the motion over `DRIFT_DISTANCES`, divided by the distance and averaged over them.

    true, estimated (N, 3). Of distances longer than the path nothing is taken; None where all are.
    """
    way = _travelled(np.asarray(true, dtype=float))[-1]
    reached = [distance for distance in DRIFT_DISTANCES if way >= _reached(distance)]
    errors = [relative_pose_error(true, estimated, distance).translation for distance in reached]
    return float(np.mean(errors)) if errors else None


def _drift(judged: Judged) -> float | None:
    if judged.of_train:
        return None
    errors = [drift(true, estimate) for _, true, estimate in judged.scored]
    known = [error for error in errors if error is not None]
    return float(np.mean(known)) if known else None


def attained(score: ArrayLike, still: ArrayLike, oracle: ArrayLike) -> Array:
    """Return how far scores (...) are on the way from that of standing still, 0, to that of the oracle, 1, at most 1.

    By the logarithm: errors of odometry span orders of magnitude, and half of the way is the geometric mean of both
    ends. NaN where the oracle is no better than standing still.
    """
    with np.errstate(all="ignore"):
        still, score, oracle = (np.log(np.asarray(of, dtype=float)) for of in (still, score, oracle))
        part = np.clip((still - score) / (still - oracle), 0.0, 1.0)
        return np.where((still > oracle) & np.isfinite(part), part, np.nan)


METRICS = (
    Metric(
        "end_point_position",
        _end_point_position,
        key="end_point_position_m",
        title="end point",
        short="end",
        description="position error of the last pose, mean over the runs",
        place=60,
        column=Column(place=40, keep=60),
        **MM,
    ),
    Metric(
        "end_point_heading",
        _end_point_heading,
        key="end_point_heading_rad",
        title="end heading",
        short="end",
        description="heading error of the last pose, mean over the runs",
        place=70,
        column=Column(place=50, keep=30),
        **DEG,
    ),
    Metric(
        "ate",
        _ate,
        key="ate_m",
        title="ATE",
        short="ATE",
        description="rms position error along the path, no alignment, mean over runs and a train's axles",
        place=80,
        column=Column(place=130, keep=70),
        **MM,
    ),
    Metric(
        STANDING_STILL,
        _ate_standing_still,
        key="ate_standing_still_m",
        title="ATE of standing still",
        short="still",
        description="ATE of an estimator that stays at the start",
        place=85,
        ranks=False,
        on_boards=False,
        **MM,
    ),
    Metric(
        ATTAINED,
        lambda judged: None,
        key="attained",
        title="attained",
        short="attained",
        description="part of the way from standing still (0 %) to the oracle (100 %), by the logarithm of the ATE",
        place=87,
        ranks=False,
        column=Column(place=135, keep=65),
        **PER_CENT,
    ),
    Metric(
        "drift",
        _drift,
        unit="m/m",
        key="drift_m_per_m",
        title="drift",
        short="drift",
        shown_unit="mm/m",
        factor=1e3,
        description="error of the motion over 10, 20, 50 and 100 m of true path, by distance, mean",
        place=88,
        column=Column(place=138, keep=55),
    ),
    Metric(
        "rpe_translation",
        _rpe_translation,
        unit="m/m",
        key="rpe_translation_m_per_m",
        title="RPE",
        short="RPE",
        shown_unit="mm/m",
        factor=1e3,
        description="error of the motion over 1 m of true path, mean over the runs that are as long",
        place=90,
        column=Column(place=140, keep=50),
    ),
    Metric(
        "rpe_rotation",
        _rpe_rotation,
        unit="rad/m",
        key="rpe_rotation_rad_per_m",
        title="RPE rotation",
        short="RPE",
        shown_unit="deg/m",
        factor=180.0 / np.pi,
        description="heading error over 1 m of true path, mean over the runs that are as long",
        place=100,
    ),
)
