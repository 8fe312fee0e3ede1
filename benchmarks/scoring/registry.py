"""From an episode and estimated trajectories to scores: which metrics there are, and how people are shown them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.scoring import metrics, parameter_errors, train_metrics
from benchmarks.tasks.task import Episode, Run
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription


@dataclass(frozen=True)
class Metric:
    """A metric: its name, its SI unit (also as part of a JSON key), and how people are shown it.

    title: its heading; short: the one in a terminal. ranks: whether a task may rank by it, lower being better.
    """

    name: str
    unit: str
    key: str
    title: str
    short: str
    shown_unit: str
    factor: float
    description: str
    ranks: bool = True

    def shown(self, value: float | None) -> str:
        """Return a value in SI as text in the unit for people; what only rounding leaves is 0."""
        if value is None:
            return "–"
        return f"{value * self.factor if abs(value) > self.rounding else 0.0:#.4g}".rstrip(".")

    @property
    def rounding(self) -> float:
        """What rounding may leave of 0, in SI: 1e-6 of the unit for people, 1e-9 m: poses of 10 m round to 2e-15."""
        return 1e-6 / self.factor

    @property
    def within(self) -> tuple[float, float]:
        """Where its mean can lie: errors are not negative, and what is no error is a share, at most 1."""
        return (0.0, math.inf if self.ranks else 1.0)


_MM = {"unit": "m", "shown_unit": "mm", "factor": 1e3}
_DEG = {"unit": "rad", "shown_unit": "deg", "factor": 180.0 / np.pi}
_PER_CENT = {"unit": "1", "shown_unit": "%", "factor": 100.0}
_SHARE = {"unit": "1", "shown_unit": "%", "factor": 100.0, "ranks": False}

NEAR = 0.05
"""m: a train is near where it truly is if its axles are by less on average."""

STANDING_STILL = "ate_standing_still"
"""The ATE of an estimator that stays at the start: stored beside the metrics, to tell whom a closed path flatters."""

METRICS: dict[str, Metric] = {
    metric.name: metric
    for metric in (
        Metric(
            "E_max_syst",
            key="E_max_syst_m",
            title="E_max,syst",
            short="E_max",
            description="UMBmark, systematic",
            **_MM,
        ),
        Metric("r_cw", key="r_cw_m", title="r_cw", short="r_cw", description="UMBmark, clockwise centroid", **_MM),
        Metric("r_ccw", key="r_ccw_m", title="r_ccw", short="r_ccw", description="UMBmark, other centroid", **_MM),
        Metric(
            "orientation_error",
            key="orientation_error_rad",
            title="orientation",
            short="orient.",
            description="mean absolute return orientation error",
            **_DEG,
        ),
        Metric(
            "nonsystematic_orientation_error",
            key="nonsystematic_orientation_error_rad",
            title="orientation, non-syst.",
            short="non-syst.",
            description="extended UMBmark: the same less the mean error on the clean floor",
            **_DEG,
        ),
        Metric(
            "end_point_position",
            key="end_point_position_m",
            title="end point",
            short="end",
            description="position error of the last pose, mean over the runs",
            **_MM,
        ),
        Metric(
            "end_point_heading",
            key="end_point_heading_rad",
            title="end heading",
            short="end",
            description="heading error of the last pose, mean over the runs",
            **_DEG,
        ),
        Metric(
            "ate",
            key="ate_m",
            title="ATE",
            short="ATE",
            description="rms position error along the path, no alignment, mean over runs and a train's axles",
            **_MM,
        ),
        Metric(
            "rpe_translation",
            unit="m/m",
            key="rpe_translation_m_per_m",
            title="RPE",
            short="RPE",
            shown_unit="mm/m",
            factor=1e3,
            description="error of the motion over 1 m of true path, mean",
        ),
        Metric(
            "rpe_rotation",
            unit="rad/m",
            key="rpe_rotation_rad_per_m",
            title="RPE rotation",
            short="RPE",
            shown_unit="deg/m",
            factor=180.0 / np.pi,
            description="heading error over 1 m of true path, mean",
        ),
        Metric(
            "mean_axle_position",
            key="mean_axle_position_m",
            title="axle position",
            short="axles",
            description="train: position error, mean over the axles, the scored samples and the runs",
            **_MM,
        ),
        Metric(
            "final_axle_position",
            key="final_axle_position_m",
            title="final axle position",
            short="end",
            description="train: position error at the last sample, mean over the axles and the runs",
            **_MM,
        ),
        Metric(
            "final_axle_heading",
            key="final_axle_heading_rad",
            title="final axle heading",
            short="end",
            description="train: heading error at the last sample, mean over the axles and the runs",
            **_DEG,
        ),
        Metric(
            "share_within_5cm",
            key="share_within_5cm",
            title="within 5 cm",
            short="< 5 cm",
            description="train: share of the scored samples at which the axles are off by less than 5 cm on average",
            **_SHARE,
        ),
        Metric(
            "sound_axle_chosen",
            key="sound_axle_chosen",
            title="sound axle chosen",
            short="sound",
            description="snapshots: of the runs in which exactly one axle's pose is kept, the share where it was right",
            **_SHARE,
        ),
        Metric(
            "contradiction",
            key="contradiction_m",
            title="contradiction",
            short="contrad.",
            description="train: distance between where a frame's front axle is in the estimate and by its sensor, mean",
            **_MM,
        ),
        Metric(
            "offset_error",
            key="offset_error",
            title="r_c error",
            short="r_c",
            description="calibration: mean absolute relative error of the castors' offsets",
            **_PER_CENT,
        ),
        Metric(
            "radius_error",
            key="radius_error",
            title="r_w error",
            short="r_w",
            description="calibration: mean absolute relative error of the wheels' radii",
            **_PER_CENT,
        ),
        Metric(
            "half_track_error",
            key="half_track_error",
            title="d error",
            short="d",
            description="calibration: mean absolute relative error of the wheels' lateral distances",
            **_PER_CENT,
        ),
        Metric(
            "pivot_zero_error",
            key="pivot_zero_error_rad",
            title="beta error",
            short="beta",
            description="calibration: mean absolute error of the pivot encoders' zeros",
            **_DEG,
        ),
    )
}


def score(episode: Episode, estimates: Sequence[Array], calibrated: RobotDescription | None = None) -> dict[str, float]:
    """Return the scores of an estimator in an episode, in SI, by the names of `METRICS`.

    estimates: for each run, the estimated poses (M, 3) at `Run.samples`, of a train (N, M, 3). UMBmark's numbers need
    runs in both directions, the extended benchmark's also baseline runs in both; what a task's runs do not give is left
    out. Relative pose errors are NaN where a path is too short for them. calibrated: the robot as a calibration method
    returned it, which is scored too where the true one is known.
    """
    paths = []
    for run, estimate in zip(episode.runs, estimates, strict=True):
        true = run.truth
        if estimate.shape != true.shape:
            raise ValueError(f"estimates of shape {estimate.shape} for {true.shape} evaluated poses")
        paths.append((run, true, estimate))
    if isinstance(episode.robot, TrainDescription):
        return _train_scores([path for path in paths if not path[0].baseline])
    scores = {**_square_scores(paths), **_path_scores([path for path in paths if not path[0].baseline])}
    if calibrated is not None and episode.calibration is not None and episode.calibration.true_robot is not None:
        scores |= parameter_errors.parameter_errors(calibrated, episode.calibration.true_robot)
    return scores


def _square_scores(paths: list[tuple[Run, Array, Array]]) -> dict[str, float]:
    def errors(direction: str, baseline: bool) -> Array:
        chosen = [
            metrics.return_errors(true[0], true[-1], estimate[-1])
            for run, true, estimate in paths
            if run.direction == direction and run.baseline == baseline
        ]
        return np.reshape(chosen, (-1, 3))

    cw, ccw = errors("cw", False), errors("ccw", False)
    clean_cw, clean_ccw = errors("cw", True), errors("ccw", True)
    if not (len(cw) and len(ccw)):
        return {}
    square = metrics.umbmark(cw, ccw)
    scores = {
        "E_max_syst": float(square.e_max_syst),
        "r_cw": float(square.r_cw),
        "r_ccw": float(square.r_ccw),
        "orientation_error": float(metrics.orientation_error(cw[:, 2], ccw[:, 2])),
    }
    if len(clean_cw) and len(clean_ccw):
        bumps = metrics.orientation_error(cw[:, 2], ccw[:, 2], clean_cw[:, 2], clean_ccw[:, 2])
        scores["nonsystematic_orientation_error"] = float(bumps)
    return scores


def _path_scores(paths: list[tuple[Run, Array, Array]]) -> dict[str, float]:
    ends = [metrics.end_point_error(true, estimate) for _, true, estimate in paths]
    relative = [metrics.relative_pose_error(true, estimate) for _, true, estimate in paths]
    at_rest = [metrics.absolute_trajectory_error(true, np.broadcast_to(true[0], true.shape)) for _, true, _ in paths]
    along = [metrics.absolute_trajectory_error(true, estimate) for _, true, estimate in paths]
    scores = {
        "end_point_position": np.mean([end.position for end in ends]),
        "end_point_heading": np.mean([end.heading for end in ends]),
        "ate": np.mean(along),
        STANDING_STILL: np.mean(at_rest),
        "rpe_translation": np.mean([error.translation for error in relative]),
        "rpe_rotation": np.mean([error.rotation for error in relative]),
    }
    return {name: float(value) for name, value in scores.items()}


def _train_scores(paths: list[tuple[Run, Array, Array]]) -> dict[str, float]:
    position = [train_metrics.axle_position_errors(true, estimate) for _, true, estimate in paths]
    heading = [train_metrics.axle_heading_errors(true, estimate) for _, true, estimate in paths]
    scores = {
        "mean_axle_position": np.mean([np.mean(error) for error in position]),
        "final_axle_position": np.mean([np.mean(error[:, -1]) for error in position]),
        "final_axle_heading": np.mean([np.mean(error[:, -1]) for error in heading]),
        "share_within_5cm": np.mean([np.mean(np.mean(error, axis=0) < NEAR) for error in position]),
    }
    drives = [(true, estimate) for run, true, estimate in paths if run.belief is None]
    if drives:
        scores["ate"] = np.mean([metrics.absolute_trajectory_error(true, estimate) for true, estimate in drives])
        scores[STANDING_STILL] = np.mean([metrics.absolute_trajectory_error(true, true[:, :1]) for true, _ in drives])
    return {name: float(value) for name, value in (scores | _choices(paths) | _contradiction(paths)).items()}


def _choices(paths: list[tuple[Run, Array, Array]]) -> dict[str, float]:
    """Return how often a sound axle is kept in snapshots; empty where never exactly one axle is."""
    sound = [
        axle in run.sound
        for run, _, estimate in paths
        if run.belief is not None
        and run.sound
        and (axle := train_metrics.kept_axle(run.belief, estimate[:, -1])) is not None
    ]
    return {"sound_axle_chosen": float(np.mean(sound))} if sound else {}


def _contradiction(paths: list[tuple[Run, Array, Array]]) -> dict[str, float]:
    """Return the mean contradiction of the runs that have readings; empty where none has."""
    errors = [
        train_metrics.contradictions(estimate, run.log.rps[run.samples])
        for run, _, estimate in paths
        if run.log.rps is not None
    ]
    means = [float(np.nanmean(error)) for error in errors if np.isfinite(error).any()]
    return {"contradiction": float(np.mean(means))} if means else {}
