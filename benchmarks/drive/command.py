"""``castor-bench drive``: a person drives a robot or a train; estimators follow it; the drive may become a log."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.drive.follower import Follower
from benchmarks.drive.robot import HandDrivenRobot
from benchmarks.drive.train import HandDrivenTrain
from benchmarks.drive.vehicle import HandDrivenEnv
from benchmarks.drive.window import DriveWindow, Events
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks.task import Episode, Run
from castor_envs.cli import command_line
from castor_envs.errors import InputError
from castor_envs.files import writing
from castor_envs.floor import Floor
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.vehicles.load import Vehicle, check_beside, file_name, load_vehicle
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.registry import load_estimator

DEFAULT_ESTIMATORS = {"robot": "wheel-odometry", "train": "train-odometry"}
"""By what is driven: they serve every robot whose encoders determine its motion, and every train."""
TOLD = ("end_point_position", "final_axle_position", "ate", "drift")
"""Metrics that are printed after a drive, as far as they apply."""


def drive(
    vehicle: str,
    floor: str | None,
    estimators: Sequence[str],
    record: Path | None,
    seed: int | None,
    longest: float,
    events: Events | None = None,
    real_time: bool = True,
) -> None:
    """Open the window, drive, say how far estimators were off, and write the log.

    vehicle: a preset's name or a file. record: the log's file, which must not exist yet; the vehicle's file goes beside
    it, and the floor's unless it is even; those that are there must say the same. longest: s. events, real_time: see
    `DriveWindow.run`. Raises InputError where anything does not suit.
    """
    env = hand_driven(load_vehicle(vehicle), floor)
    if record is not None:
        _check_record(record, env.vehicle, env.floor)
    recorder = RecordLog(env)
    observation, info = recorder.reset(seed=seed)
    entries = [load_estimator(spec) for spec in (estimators or [DEFAULT_ESTIMATORS[env.vehicle.scope]])]
    followers = [Follower(entry, env.vehicle, info["pose"], observation) for entry in entries]
    window = DriveWindow(env, recorder, followers, f"castor-envs: {env.vehicle.name}")
    with _kept(record, recorder, env):
        window.run(longest, events, real_time)
    log = recorder.log()
    if len(log) < 2:
        return
    episode = Episode(env.vehicle, (Run(log, floor=env.floor),))
    print("\n".join(_summary(episode, log, followers)))


def hand_driven(vehicle: Vehicle, floor: Floor | str | None = None) -> HandDrivenEnv[Any]:
    """Return the environment in which a robot or a train is driven by hand."""
    if isinstance(vehicle, TrainDescription):
        return HandDrivenTrain(vehicle, floor)
    return HandDrivenRobot(vehicle, floor)


@contextmanager
def _kept(record: Path | None, recorder: RecordLog, env: HandDrivenEnv[Any]) -> Iterator[None]:
    """Write the drive when this context ends, after Ctrl-C too."""

    def write() -> None:
        if record is not None:
            _write(record, recorder.log(), env.vehicle, env.floor)

    with command_line.ending_with(write):
        yield


def _check_record(record: Path, vehicle: Vehicle, floor: Floor) -> None:
    """Raise InputError, before the drive, for what would not let its log be written."""
    if record.suffix != ".csv":
        raise InputError(f"--record {record}: logs end in .csv; name one")
    if record.exists():
        raise InputError(f"--record {record}: is there already; name a new file")
    check_beside(record.parent, vehicle, f"--record {record}")
    ground = _floor_file(record)
    if ground.exists() and Floor.load(ground) != floor:
        raise InputError(f"--record {record}: {ground} is another floor; name a new file")
    with writing(f"--record {record}"):
        record.parent.mkdir(parents=True, exist_ok=True)


def _write(record: Path, log: Log, vehicle: Vehicle, floor: Floor) -> None:
    if len(log) < 2:
        print(f"not written: {record}: nothing was driven")
        return
    with writing(f"--record {record}"):
        write_log(record, log, vehicle)
        beside, ground = record.parent / file_name(vehicle), _floor_file(record)
        if not beside.exists():
            vehicle.save(beside)
        if floor != Floor() and not ground.exists():
            floor.save(ground)
    written = (record, beside, ground) if floor != Floor() else (record, beside)
    print(f"written: {', '.join(map(str, written))}")


def _floor_file(record: Path) -> Path:
    """Return where the floor of a log goes."""
    return record.with_name(f"{record.stem}-floor.json")


def _summary(episode: Episode, log: Log, followers: Sequence[Follower]) -> Iterator[str]:
    """Yield what the drive was, and the scores of each estimator."""
    (run,) = episode.runs
    front = run.truth if run.axles is None else run.truth[0]
    way = float(np.sum(np.hypot(*np.diff(front[:, :2], axis=0).T)))
    yield f"{way:.2f} m in {log.t[-1]:.1f} s"
    for follower in followers:
        if follower.problem is not None:
            yield f"{follower.name}: failed ({follower.problem})"
            continue
        scores = score(episode, [np.moveaxis(np.array(follower.poses)[run.samples], 0, -2)])  # axles first
        metrics = [(BOARD_METRICS[name], scores[name]) for name in TOLD if name in scores]
        parts = [f"{metric.title} {metric.shown(value)} {metric.shown_unit}" for metric, value in metrics]
        yield f"{follower.name}: {', '.join(parts)}"
