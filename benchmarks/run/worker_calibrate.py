"""What happens in a worker process for a calibration method: it calibrates, then the odometry follows the test runs.

The method gets the robot as described and the recordings; the odometry gets what the method returned. The truth of the
runs is not in this process.
"""

import copy
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

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
from estimators.calibration.protocol import SEEN, UNITS, Recording, Report, ReportingMethod, Result
from estimators.plugins.registry import CalibrationEntry, declines, load_calibration

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


def report_calibration(
    spec: str, source_hash: str, robot: RobotDescription, recordings: Sequence[Recording], pivots: bool
) -> Report | RobotDescription | Failure:
    """Return what a method makes of a user's logs: its report, the robot alone if it gives none, or how it failed.

    pivots: whether it is to find the places of free castors' pivots too. A report holds plain data alone, so that the
    parent needs none of the method's own classes.
    """
    try:
        answer = _answer(loaded(load_calibration, spec, source_hash), robot, recordings, reporting=True, pivots=pivots)
        return _plain(answer, robot) if isinstance(answer, Report) else _checked(answer, robot)
    except FailedError as failure:
        return Failure(str(failure))


def _calibrated(spec: str, source_hash: str, seen: ObservedCalibration) -> RobotDescription:
    answer = _answer(loaded(load_calibration, spec, source_hash), seen.robot, seen.recordings)
    return _checked(answer, seen.robot)


def _answer(
    entry: CalibrationEntry,
    robot: RobotDescription,
    recordings: Sequence[Recording],
    reporting: bool = False,
    pivots: bool = False,
) -> Any:
    """Return what a method answers, unchecked; raises FailedError for what it raises. reporting: its report, if any."""
    stage, given = "when constructed", copy.deepcopy(robot)  # what a method writes into it changes no check
    try:
        method = entry.kind(pivots=True) if pivots else entry.factory()
        if reporting and isinstance(method, ReportingMethod):
            stage = "in report"
            answer = method.report(given, recordings)
        else:
            stage = "in calibrate"
            answer = method.calibrate(given, recordings)
    except BaseException as error:
        end_if_forked()
        if stage != "when constructed" and (reason := declines(error, given)) is not None:
            raise FailedError(DECLINED + reason) from None
        raise FailedError(f"{raised(error)} {stage}") from None
    end_if_forked()
    if stage == "in report" and not isinstance(answer, Report):
        raise FailedError(f"returned {type(answer).__name__} instead of a Report")
    return answer


def _plain(report: Report, described: RobotDescription) -> Report:
    """Return a report of plain data; raises FailedError for one that cannot be shown."""
    calibrated = _checked(report.calibrated, described)
    try:
        unseen = {str(what): str(sentence) for what, sentence in report.unseen.items()}
        more = json.loads(json.dumps(report.more, allow_nan=False))
        results = tuple(_plain_result(result, unseen) for result in report.results)
        return Report(results, calibrated, unseen, tuple(map(str, report.remarks)), more)
    except Exception as error:
        raise FailedError(f"returned a report that cannot be shown: {one_line(error)}") from None


def _plain_result(result: Result, unseen: Mapping[str, str]) -> Result:
    """Return a number of a report as plain data; raises an exception for what is none, or rests on nothing told."""
    error = result.standard_error
    numbers = (result.before, result.after, 0.0 if error is None else error)
    before, after, standard_error = (float(number) for number in numbers)
    if not np.isfinite((before, after, standard_error)).all():
        raise ValueError(f"{result.name}: {numbers} are not all finite")
    if result.unit not in UNITS or result.seen not in SEEN or not set(result.rests_on) <= set(unseen):
        raise ValueError(f"{result.name}: unit {result.unit!r}, seen {result.seen!r}, rests on {result.rests_on!r}")
    kept = None if error is None else standard_error
    return Result(
        str(result.name), str(result.unit), before, after, kept, result.seen, tuple(map(str, result.rests_on))
    )


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
