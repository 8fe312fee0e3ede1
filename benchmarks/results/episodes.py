"""Recorded episodes, kept so that every estimator is judged on the same episodes and scores can be computed again."""

import contextlib
import json
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, PositiveInt, TypeAdapter
from pydantic.dataclasses import dataclass

from benchmarks.results.archives import (
    CorruptFileError,
    OlderFormatError,
    read_archive,
    read_metadata,
    write_archive,
)
from benchmarks.results.kept import kept_beside
from benchmarks.results.provenance import Origin, provenance, world_digest
from benchmarks.tasks.task import Calibration, Case, Episode, Run, Task, source_of
from castor_envs.description import CONFIG, Length
from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.floor import Floor
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.logs.reference import ReferenceNoise
from castor_envs.vehicles.load import file_name as vehicle_file_name
from castor_envs.vehicles.load import vehicle_from_dict
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording
from estimators.plugins.registry import load_estimator

FORMAT = "castor-episode/3"
BELIEFS_FORMAT = "castor-beliefs/1"
RECORDINGS_FORMAT = "castor-recordings/1"
SUMMARY_FORMAT = "castor-episodes/2"
_PARTS = ("t", "wheel", "pivot", "command", "steering_command", "reference", "gyro", "fix", "fix_age", "rps", "rps_age")


_CASE_NAME = r"[A-Za-z0-9_-][A-Za-z0-9_.-]*"
StoredCase = Annotated[int, Field(ge=-(2**63), lt=2**63)] | Annotated[str, Field(pattern=f"^{_CASE_NAME}$")]
"""A case in a file's metadata: a seed that fits into 64 bits, or a name that fits into a file's."""
Hash = Annotated[str, Field(pattern="^[0-9a-f]{16}$")]
Name = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class _RunMetadata:
    direction: Literal["cw", "ccw"] | None
    baseline: bool
    sound: tuple[PositiveInt, ...]
    reference_noise: tuple[PositiveFloat, PositiveFloat] | None = None
    floor: dict[str, Any] | None = None


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class _RecordingMetadata:
    held: PositiveInt | None
    side: Length | None


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class _CalibrationMetadata:
    recordings: tuple[_RecordingMetadata, ...]
    odometry: Annotated[str, Field(pattern="^[a-z0-9-]+$")]  # a name: a file must not say which code to load
    odometry_source: Hash
    true_robot: dict[str, Any] | None


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class _Metadata:
    format: str
    task: Name
    task_version: int
    case: StoredCase
    digest: Hash
    robot: dict[str, Any]
    runs: tuple[_RunMetadata, ...]
    origin: Origin
    calibration: _CalibrationMetadata | None = None
    source: Name | None = None  # a hash of the data that the task has it from


_ADAPTER = TypeAdapter(_Metadata)


def file_name(case: Case) -> str:
    """Return the file name of a case; raises ValueError for a name that does not fit into one."""
    if not re.fullmatch(_CASE_NAME, str(case)):
        raise ValueError(f"case {case!r}: use letters, digits and _ . - only")
    return f"{case}.npz"


class EpisodeStore:
    """The episodes under RESULTS/episodes/<task>@<version>/<case>.npz."""

    def __init__(self, results: Path):
        self.root = results / "episodes"
        self._kept: dict[Path, dict[str, list[Any]]] = {}

    def path(self, task: str, version: int, case: Case) -> Path:
        """Return the file of an episode."""
        return self.root / f"{task}@{version}" / file_name(case)

    def digest(self, task: str, version: int, case: Case, source: str | None = None) -> str | None:
        """Return the digest of a stored episode; raises CorruptFileError.

        None if it is not there, or if it was recorded by another version of the world or of the tasks, of other data,
        or for another version of the odometry that follows calibrated robots: then it is recorded again, and if it
        differs, its rows are computed again too. source: of the data that are there (`source_of`); None: any will do.
        """
        path = self.path(task, version, case)
        try:
            status = path.stat()
            stored = self._stored(path, [status.st_mtime_ns, status.st_size])
        except (OSError, OlderFormatError):
            return None
        _check_place(path, stored, task, version, case)
        try:
            current = (
                stored.world == world_digest()
                and (source is None or stored.source == source)
                and (stored.odometry is None or stored.odometry_source == _source_now(stored.odometry))
            )
        except InputError as error:
            raise CorruptFileError(path, str(error)) from None
        return stored.digest if current else None

    def load(self, task: str, version: int, case: Case) -> Episode:
        """Return a stored episode; raises CorruptFileError if it is damaged, FileNotFoundError if it is not there."""
        path = self.path(task, version, case)
        metadata, arrays = read_archive(path, FORMAT, _ADAPTER)
        _check_place(path, metadata, task, version, case)
        try:
            runs = tuple(
                Run(
                    _log(arrays, f"{k}"),
                    direction=entry.direction,
                    baseline=entry.baseline,
                    belief=arrays.get(f"{k}.belief"),
                    belief_covariance=arrays.get(f"{k}.belief_covariance"),
                    sound=entry.sound,
                    oracle=arrays.get(f"{k}.oracle"),
                    reference_noise=None if entry.reference_noise is None else ReferenceNoise(*entry.reference_noise),
                    floor=None if entry.floor is None else Floor.from_dict(entry.floor, str(path)),
                )
                for k, entry in enumerate(metadata.runs)
            )
            calibration = _calibration(metadata.calibration, arrays, str(path))
            episode = Episode(vehicle_from_dict(metadata.robot, str(path)), runs, calibration)
            digest = episode.digest
        except Exception:  # arrays of any shape and kind may stand there
            raise CorruptFileError(path, "does not hold an episode") from None
        if digest != metadata.digest:
            raise CorruptFileError(path, "does not hold what its digest says")
        return episode

    def save(self, task: Task, case: Case, episode: Episode) -> None:
        """Store an episode; columns that the vehicle does not explain are left out."""
        calibration = episode.calibration
        metadata = _Metadata(
            format=FORMAT,
            task=task.name,
            task_version=task.version,
            case=case,
            digest=episode.digest,
            robot=episode.robot.to_dict(),
            runs=tuple(
                _RunMetadata(
                    direction=run.direction,
                    baseline=run.baseline,
                    sound=tuple(run.sound),
                    reference_noise=run.reference_noise,
                    floor=None if run.floor is None else run.floor.to_dict(),
                )
                for run in episode.runs
            ),
            origin=provenance(),
            calibration=None if calibration is None else _calibration_metadata(calibration),
            source=source_of(task, case),
        )
        logs = {f"{k}": run.log for k, run in enumerate(episode.runs)}
        if calibration is not None:
            logs |= {f"recording-{k}": recording.log for k, recording in enumerate(calibration.recordings)}
        arrays = {
            f"{name}.{part}": _compact(getattr(log, part))
            for name, log in logs.items()
            for part in _PARTS
            if getattr(log, part) is not None
        }
        arrays |= {
            f"{k}.{part}": array
            for k, run in enumerate(episode.runs)
            for part in ("belief", "belief_covariance", "oracle")
            if (array := getattr(run, part)) is not None
        }
        write_archive(self.path(task.name, task.version, case), _ADAPTER, metadata, arrays)

    def _stored(self, path: Path, stamp: list[int]) -> "_Stored":
        """Return what a file says with this time of change (ns) and size; it is read once."""
        folder = path.parent
        if folder not in self._kept:
            self._kept[folder] = kept_beside(folder, SUMMARY_FORMAT, _summary)
        entry = self._kept[folder].get(path.name)
        if entry is None or entry[:2] != stamp:
            entry = self._kept[folder][path.name] = [*stamp, *_read(path)]
        return _Stored(*entry[2:])


def write_episode(folder: Path, episode: Episode) -> None:
    """Write an episode for people and other programs: robot.json or train.json and a log a run, such as run-01-cw.csv.

    The name of a run on the clean floor that only gives the systematic error ends in -baseline. Where runs start from a
    belief instead of the log's first reference, beliefs.json holds the axles' poses, m and rad, by the log's name.
    The floor of a run, where it is known and not even, is beside it, such as run-01-cw-floor.json.
    Calibration methods get logs such as recording-01.csv; recordings.json says which castor was held, the side of the
    square (m), and the odometry that follows the runs; true-robot.json has the true parameters.
    """
    episode.robot.save(folder / vehicle_file_name(episode.robot))
    beliefs: dict[str, Any] = {}
    for k, run in enumerate(episode.runs, start=1):
        stem = run_name(k, run)
        name = f"{stem}.csv"
        write_log(folder / name, run.log, episode.robot)
        write_floor(folder, stem, run)
        if run.belief is not None:
            beliefs[name] = run.belief.tolist()
    if beliefs:
        write_atomically(folder / "beliefs.json", json.dumps({"format": BELIEFS_FORMAT, **beliefs}, indent=2) + "\n")
    if (calibration := episode.calibration) is not None:
        known: dict[str, Any] = {"format": RECORDINGS_FORMAT, "odometry": calibration.odometry}
        for k, recording in enumerate(calibration.recordings, start=1):
            write_log(folder / f"recording-{k:02d}.csv", recording.log, episode.robot)
            known[f"recording-{k:02d}.csv"] = {"held": recording.held, "side_m": recording.side}
        write_atomically(folder / "recordings.json", json.dumps(known, indent=2) + "\n")
        if calibration.true_robot is not None:
            calibration.true_robot.save(folder / "true-robot.json")


def run_name(number: int, run: Run) -> str:
    """Return what files of a run are called, its number counted from 1, such as run-02-ccw-baseline."""
    return "-".join(filter(None, [f"run-{number:02d}", run.direction, "baseline" if run.baseline else None]))


def write_floor(folder: Path, name: str, run: Run) -> None:
    """Write the floor of a run beside its other files, where it is known and not even."""
    if run.floor is not None and run.floor != Floor():
        run.floor.save(folder / f"{name}-floor.json")


class _Stored(NamedTuple):
    """What says whether a stored episode is current."""

    task: str
    task_version: int
    case: Case
    digest: str
    world: str
    source: str | None
    odometry: str | None
    odometry_source: str | None


def _read(path: Path) -> _Stored:
    metadata = read_metadata(path, FORMAT, _ADAPTER)
    odometry = metadata.calibration
    of = (None, None) if odometry is None else (odometry.odometry, odometry.odometry_source)
    place = (metadata.task, metadata.task_version, metadata.case)
    return _Stored(*place, metadata.digest, metadata.origin.world, metadata.source, *of)


def _summary(path: Path) -> list[Any] | None:
    with contextlib.suppress(CorruptFileError, OSError):
        return list(_read(path))
    return None


@cache
def _source_now(odometry: str) -> str:
    return load_estimator(odometry).source_hash


def _log(arrays: dict[str, Any], name: str) -> Log:
    return Log(**{part: arrays[f"{name}.{part}"] for part in _PARTS if f"{name}.{part}" in arrays})


def _check_place(path: Path, metadata: _Metadata | _Stored, task: str, version: int, case: Case) -> None:
    """Raise CorruptFileError for an episode that is stored under the name of another."""
    if (metadata.task, metadata.task_version, metadata.case) != (task, version, case):
        held = f"{metadata.task} version {metadata.task_version}, case {metadata.case!r}"
        raise CorruptFileError(path, f"holds the episode of {held}, which does not belong here")


def _calibration_metadata(calibration: Calibration) -> _CalibrationMetadata:
    true = calibration.true_robot
    return _CalibrationMetadata(
        recordings=tuple(_RecordingMetadata(held=r.held, side=r.side) for r in calibration.recordings),
        odometry=calibration.odometry,
        odometry_source=calibration.odometry_source,
        true_robot=None if true is None else true.to_dict(),
    )


def _calibration(stored: _CalibrationMetadata | None, arrays: dict[str, Any], path: str) -> Calibration | None:
    if stored is None:
        return None
    recordings = tuple(
        Recording(_log(arrays, f"recording-{k}"), entry.held, entry.side) for k, entry in enumerate(stored.recordings)
    )
    true = None if stored.true_robot is None else RobotDescription.from_dict(stored.true_robot, path)
    return Calibration(recordings, stored.odometry, stored.odometry_source, true)


def _compact(array: NDArray) -> NDArray:
    """Return whole numbers as 32-bit integers, which Log turns back into the same float64."""
    if np.isfinite(array).all() and (np.abs(array) < 2**31).all() and (array == np.rint(array)).all():
        return array.astype(np.int32) if not np.signbit(array[array == 0]).any() else array
    return array
