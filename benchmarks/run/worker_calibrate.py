"""What happens in a worker process for a calibration method: it calibrates, then the odometry follows the test runs.

The method gets the robot as described and the recordings; the odometry gets what the method returned. The truth of the
runs is not in this process.
"""

from dataclasses import dataclass
from typing import Any

from benchmarks.results.rows import DECLINED
from benchmarks.run.worker_estimate import (
    FailedError,
    Failure,
    ObservedRun,
    estimate_stacked,
    loaded,
    observed_runs,
    raised,
)
from benchmarks.tasks.task import Episode
from castor_envs.errors import InputError, message_of, one_line
from castor_envs.geometry.arrays import Array
from castor_envs.processes import end_if_forked
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording
from estimators.plugins.registry import declines, load_calibration

_LAYOUT = (
    ("", ("sample_period", "effects")),
    ("castor", ("steering", "pivot_counts_per_rev")),
    ("wheel", ("counts_per_rev", "grip", "roller_angle")),
)
"""Fields that calibration must not change, of the robot, its castors and its wheels."""


@dataclass(frozen=True, eq=False)
class ObservedCalibration:
    """What a worker gets of an episode: robot and recordings, the runs to follow, spec and source of the odometry."""

    robot: RobotDescription
    recordings: tuple[Recording, ...]
    runs: list[ObservedRun]
    odometry: str
    odometry_source: str


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What a worker returns: the robot as the method returned it, and for each run the odometry's poses (M, 3)."""

    robot: RobotDescription
    estimates: list[Array]


def observed_calibration(episode: Episode) -> ObservedCalibration:
    """Return what methods and odometry may see of an episode of a calibration task."""
    known = episode.calibration
    if known is None or not isinstance(episode.robot, RobotDescription):
        raise ValueError("the episode is not one of a calibration task")
    return ObservedCalibration(
        episode.robot, known.recordings, observed_runs(episode), known.odometry, known.odometry_source
    )


def calibrate_and_follow(spec: str, source_hash: str, seen: ObservedCalibration) -> Calibrated | Failure:
    """Return the robot that a method calibrates from the recordings, with the estimates, or how the method failed."""
    try:
        robot = _calibrated(spec, source_hash, seen)
    except FailedError as failure:
        return Failure(str(failure))
    runs = [ObservedRun(robot, run.start, run.observations, run.samples) for run in seen.runs]
    followed = estimate_stacked(seen.odometry, seen.odometry_source, [runs])
    answer = followed[0] if isinstance(followed, list) else followed
    if isinstance(answer, Failure):
        return Failure(f"{seen.odometry} with the calibrated robot: {answer.reason}")
    return Calibrated(robot, [estimate.poses for estimate in answer])


def _calibrated(spec: str, source_hash: str, seen: ObservedCalibration) -> RobotDescription:
    entry, stage = loaded(load_calibration, spec, source_hash), "when constructed"
    try:
        method = entry.factory()
        stage = "in calibrate"
        answer = method.calibrate(seen.robot, seen.recordings)
    except BaseException as error:
        end_if_forked()
        if stage == "in calibrate" and (reason := declines(error, seen.robot)) is not None:
            raise FailedError(DECLINED + reason) from None
        raise FailedError(f"{raised(error)} {stage}") from None
    end_if_forked()
    return _checked(answer, seen.robot)


def _checked(answer: Any, described: RobotDescription) -> RobotDescription:
    """Return a method's answer; raises FailedError for anything but a valid robot of the same layout."""
    if not isinstance(answer, RobotDescription):
        raise FailedError(f"returned {type(answer).__name__} instead of a RobotDescription")
    try:
        robot = RobotDescription.from_dict(answer.to_dict(), "robot")
    except InputError as error:
        raise FailedError(f"returned a robot that cannot be: {message_of(error)}") from None
    except Exception as error:
        raise FailedError(f"returned a robot that cannot be read: {one_line(error)}") from None
    if (difference := _other_layout(robot, described)) is not None:
        raise FailedError(f"returned a robot of another layout: {difference}")
    return robot


def _other_layout(robot: RobotDescription, described: RobotDescription) -> str | None:
    """Return the first difference in what calibration must not change, or None."""
    found = [len(castor.wheels) for castor in robot.castors]
    expected = [len(castor.wheels) for castor in described.castors]
    if found != expected:
        return f"wheels of its castors {found} instead of {expected}"
    parts = (((robot, described),), zip(robot.castors, described.castors, strict=True))
    wheels = zip(robot.wheels, described.wheels, strict=True)
    for (part, names), pairs in zip(_LAYOUT, (*parts, wheels), strict=True):
        for number, (returned_part, described_part) in enumerate(pairs, start=1):
            for name in names:
                if getattr(returned_part, name) != getattr(described_part, name):
                    label = f"{name} of {part} {number}" if part else name
                    return f"{label} is {getattr(returned_part, name)!r} instead of {getattr(described_part, name)!r}"
    return None
