"""``castor-bench show``: one case of a task, or one log, followed by estimators now."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.results.provenance import provenance
from benchmarks.results.rows import DECLINED
from benchmarks.run.choose import entries_named
from benchmarks.run.evaluate import Competitor
from benchmarks.run.task_plugins import given_as
from benchmarks.run.worker_calibrate import Calibrated
from benchmarks.run.worker_estimate import Estimate, Failure
from benchmarks.scoring.registry import score
from benchmarks.show.drives import Drive, Shown, drive_of, drives_of
from benchmarks.show.follow import failures, follow, poses
from benchmarks.show.repeat import show_command, show_log_command
from benchmarks.tasks.task import Case, Episode, Run, Task, odometry_of
from castor_envs.errors import InputError
from castor_envs.floor import load_floor
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.load import Vehicle, load_vehicle
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.registry import CALIBRATION, builtin_names, load_calibration, load_estimator

USUAL = ("wheel-odometry", "filter", "cast-0", "dead-reckoning-1")
HEADLESS = (
    "; its reference has positions alone: estimates start at the first one, with the heading of odometry that is "
    "turned to follow those after it, and are compared in position"
)
USUAL_OF_TRAINS = ("train-odometry", "train-filter", "grpec-xy")
"""Those of the built-in estimators that are shown where none is named, as far as they serve the vehicle."""


@dataclass(frozen=True)
class Following:
    """Who follows: specs of estimators and of calibration methods, s that each may take, processes."""

    estimators: Sequence[str] = ()
    methods: Sequence[str] = ()
    timeout: float = 60.0
    processes: int = 1

    def competitors(self, vehicle: Vehicle, of_methods: bool) -> tuple[Competitor, ...]:
        """Return those who are named, or the usual ones; raises InputError for the wrong kind and unknown names."""
        if of_methods:
            if self.estimators:
                raise InputError("--estimator: this task judges calibration methods; name them with --method")
            return entries_named(self.methods or tuple(CALIBRATION.built_in), self.timeout, load_calibration)
        if self.methods:
            raise InputError("--method: calibration methods are shown in calibration tasks alone; name --task")
        usual = USUAL_OF_TRAINS if isinstance(vehicle, TrainDescription) else USUAL
        serving = [name for name in usual if name in builtin_names(vehicle)]
        return entries_named(self.estimators or serving, self.timeout, load_estimator)


def told_failing(failed: Mapping[str, str], by: Following) -> list[str]:
    """Say on stdout who gave no poses, and why; return those who count as failing.

    Who declines counts if it was named: of the usual ones, some serve and some do not.
    """
    for name, reason in failed.items():
        print(f"{name} gave no poses: {reason}")
    named = bool(by.estimators or by.methods)
    return [name for name, reason in failed.items() if named or not reason.startswith(DECLINED)]


def case_of(task: Task, text: str | None) -> Case:
    """Return the case of a task that a text names, None: the first; raises InputError for one that it does not have."""
    if task.missing is not None:
        raise InputError(f"task {task.name}: {task.missing}")
    official = task.cases()
    if text is None:
        return official[0]
    if isinstance(official[0], int):
        if not text.isdecimal() or not text.isascii() or int(text) >= 2**63:
            raise InputError(f"--case {text}: cases of {task.name} are numbers; 0 to {len(official) - 1} are official")
        return int(text)
    if text not in official:
        raise InputError(f"--case {text}: {task.name} has no such case; it has {', '.join(map(str, official))}")
    return text


def show_case(task: Task, case: Case, by: Following, robot: str | None = None) -> Shown:
    """Record one case of a task, let estimators or methods follow it, and return what is shown of it.

    robot: what named the robot of a task on another one, for the line that repeats the page. The scores are those that
    a run of the benchmark gives.
    """
    episode = task.record(case)
    who = by.competitors(episode.robot, of_methods=odometry_of(task) is not None)
    followed, failed, scores = _followed(episode, who, by)
    specs = {entry.name: entry.spec for entry in who}
    return Shown(
        title=f"{task.title}, case {case}",
        subtitle=task.description,
        drives=followed,
        failed=failed,
        scores=scores,
        commands=[show_command(given_as(task), case, specs, odometry_of(task) is not None, robot)],
        origin={"task": f"{task.name}, version {task.version}", "episode": episode.digest} | _now(),
    )


def show_log(path: Path, robot: str, floor: str | None, by: Following) -> Shown:
    """Read a log, let estimators follow it, and return what is shown of it; without a reference, or with one of
    positions alone, there are no scores."""
    vehicle = load_vehicle(robot)
    ground = None if floor is None else load_floor(floor)
    drive = drive_of(path.name, vehicle, read_log(path, vehicle), ground)
    who = by.competitors(vehicle, of_methods=False)
    if not drive.headed.any():
        answers = follow([drive], who, by.timeout, by.processes)
        followed, failed, scores = [drive.followed(poses(answers, 0))], failures(answers), {}
    else:
        run = Run(drive.log, floor=ground)
        drive = replace(drive, samples=np.union1d(drive.samples, run.samples))
        followed, failed, scores = _followed(Episode(vehicle, (run,)), who, by, [drive])
    return Shown(
        title=path.name,
        subtitle=f"A log of {vehicle.name}{HEADLESS if drive.known.any() and not drive.headed.any() else ''}",
        drives=followed,
        failed=failed,
        scores=scores,
        commands=[show_log_command(str(path), robot, floor, {entry.name: entry.spec for entry in who})],
        origin={"robot": vehicle.hash()} | _now(),
    )


def _followed(
    episode: Episode, who: Sequence[Competitor], by: Following, drives: Sequence[Drive] | None = None
) -> tuple[list[Drive], dict[str, str], dict[str, dict[str, float]]]:
    """Return an episode's drives with estimates, why others failed, and the scores."""
    drives = drives_of(episode) if drives is None else drives
    answers = follow(drives, who, by.timeout, by.processes, episode)
    scores = {
        name: _scores(episode, drives, answer) for name, answer in answers.items() if not isinstance(answer, Failure)
    }
    return [drive.followed(poses(answers, k)) for k, drive in enumerate(drives)], failures(answers), scores


def _scores(episode: Episode, drives: Sequence[Drive], answer: list[Estimate] | Calibrated) -> dict[str, float]:
    """Return the scores, by what is estimated at the samples that a run of the benchmark compares."""
    places = [np.searchsorted(drive.samples, run.samples) for run, drive in zip(episode.runs, drives, strict=True)]
    if isinstance(answer, Calibrated):
        compared = [poses[..., at, :] for poses, at in zip(answer.estimates, places, strict=True)]
        found = score(episode, compared, answer.robot)
    else:
        estimates = [estimate.among(at) for estimate, at in zip(answer, places, strict=True)]
        covariances, stated = [one.covariance for one in estimates], [one.stated for one in estimates]
        found = score(episode, [one.poses for one in estimates], None, covariances, stated)
    return {name: value for name, value in found.items() if np.isfinite(value)}


def _now() -> dict[str, str]:
    """Return by what the page was made."""
    origin = provenance()
    return {
        "made": origin.created.strftime("%Y-%m-%d %H:%M UTC"),
        "versions": ", ".join(f"{name} {version}" for name, version in origin.versions.items()),
        "world": origin.world,
    }
