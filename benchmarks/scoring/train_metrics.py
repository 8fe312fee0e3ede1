"""Metrics of a train's localisation as pure functions on arrays.

Poses of a train are (N, M, 3): axles from the front, samples, and x, y (m), psi (rad). All compare an estimate with the
truth without any alignment. A train's heading matters as a direction alone, so heading errors are wrapped.
"""

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.scoring.metric import DEG, MM, PER_CENT, Column, Judged, Metric, shared
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose

NEAR = 0.05
"""m: a train counts as near the truth if its axles are off by less than this on average."""

KEPT = 1e-9
"""m and rad: an estimator that changes an axle's pose by less than this has kept it."""


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


@shared
def _positions(judged: Judged) -> list[Array] | None:
    """Return how far axles are off, (N, M) of each run; None of robots."""
    return [axle_position_errors(p.true, p.estimate) for p in judged.scored] if judged.of_train else None


def _mean_axle_position(judged: Judged) -> np.floating | None:
    errors = _positions(judged)
    return None if errors is None else np.mean([np.mean(error) for error in errors])


def _final_axle_position(judged: Judged) -> np.floating | None:
    errors = _positions(judged)
    return None if errors is None else np.mean([np.mean(error[:, -1]) for error in errors])


def _final_axle_heading(judged: Judged) -> np.floating | None:
    if not judged.of_train:
        return None
    return np.mean([np.mean(axle_heading_errors(p.true, p.estimate)[:, -1]) for p in judged.scored])


def _share_within_5cm(judged: Judged) -> np.floating | None:
    errors = _positions(judged)
    return None if errors is None else np.mean([np.mean(np.mean(error, axis=0) < NEAR) for error in errors])


def _sound_axle_chosen(judged: Judged) -> np.floating | None:
    """Return how often the kept axle is a sound one in snapshots; None where never exactly one axle is kept."""
    sound = [
        axle in run.sound
        for run, _, estimate in judged.scored
        if run.belief is not None and run.sound and (axle := kept_axle(run.belief, estimate[:, -1])) is not None
    ]
    return np.mean(sound) if sound else None


def _contradiction(judged: Judged) -> np.floating | None:
    """Return the mean contradiction over the runs that have readings; None where no run has any."""
    errors = [
        contradictions(estimate, run.log.rps[run.samples])
        for run, _, estimate in judged.scored
        if run.log.rps is not None
    ]
    means = [float(np.nanmean(error)) for error in errors if np.isfinite(error).any()]
    return np.mean(means) if means else None


METRICS = (
    Metric(
        "mean_axle_position",
        _mean_axle_position,
        key="mean_axle_position_m",
        title="axle position",
        short="axles",
        description="train: position error, mean over the axles, the scored samples and the runs",
        place=110,
        column=Column(place=20, keep=130),
        **MM,
    ),
    Metric(
        "final_axle_position",
        _final_axle_position,
        key="final_axle_position_m",
        title="final axle position",
        short="end",
        description="train: position error at the last sample, mean over the axles and the runs",
        place=120,
        column=Column(place=30, keep=120),
        **MM,
    ),
    Metric(
        "final_axle_heading",
        _final_axle_heading,
        key="final_axle_heading_rad",
        title="final axle heading",
        short="end",
        description="train: heading error at the last sample, mean over the axles and the runs",
        place=130,
        **DEG,
    ),
    Metric(
        "share_within_5cm",
        _share_within_5cm,
        key="share_within_5cm",
        title="within 5 cm",
        short="< 5 cm",
        description="train: share of the scored samples at which the axles are off by less than 5 cm on average",
        place=140,
        ranks=False,
        column=Column(place=60, keep=140),
        **PER_CENT,
    ),
    Metric(
        "sound_axle_chosen",
        _sound_axle_chosen,
        key="sound_axle_chosen",
        title="sound axle chosen",
        short="sound",
        description="snapshots: of the runs in which exactly one axle's pose is kept, the share where it was right",
        place=150,
        ranks=False,
        column=Column(place=70, keep=150),
        **PER_CENT,
    ),
    Metric(
        "contradiction",
        _contradiction,
        key="contradiction_m",
        title="contradiction",
        short="contrad.",
        description="train: distance between where a frame's front axle is in the estimate and by its sensor, mean",
        place=160,
        column=Column(place=80, keep=20),
        **MM,
    ),
)
