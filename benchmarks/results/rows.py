"""The results store: a file for each row, written whole, identified by everything that the row depends on.

    RESULTS/rows/<task>@<version>/<estimator>-<source hash>/<case>.npz    a row: metadata, scores, trajectories
    RESULTS/rows/<task>@<version>/<estimator>-<source hash>/time.json     cost of an update, whether poses repeat
    RESULTS/references/...                                                the same; see `references`
    RESULTS/rows/<task>@<version>/summary.json  what boards need of its rows; see `kept`
    RESULTS/rows/<task>@<version>/asked.json    which of them the last run asked for; see `asked`
    RESULTS/episodes/...                                                  see `episodes`

A row holds for one task version, one estimator's source and one recorded episode (by its digest, which covers the
robot); if any of these differs, it is another row. Files are written whole or not at all, so a run that is killed
leaves only whole files, and the next run computes what is missing.
"""

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from datetime import UTC
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass as checked_dataclass

from benchmarks.results.archives import CorruptFileError, OlderFormatError, checked, read_archive, write_archive
from benchmarks.results.episodes import Hash, Name, StoredCase, file_name
from benchmarks.results.kept import kept_beside
from benchmarks.results.provenance import Machine, Origin, provenance
from benchmarks.tasks.task import Case
from castor_envs.description import CONFIG, Duration
from castor_envs.errors import InputError
from castor_envs.files import remove_leftovers, write_json
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.uncertainty import invalid

ROW_FORMAT = "castor-row/2"
TIME_FORMAT = "castor-time/4"
SUMMARY_FORMAT = "castor-summary/2"
DECLINED = "declined: "
"""Beginning of a row's failure where the estimator declined the robot; the estimator's reason follows."""


@dataclass(eq=False)  # not frozen: boards make 1e5 of them
class RowSummary:
    """What one estimator did in one case of a task: what boards and plans need of it.

    episode, robot_hash: of the episode it ran on. failure: None, or why there are no scores. timeout: the time limit
    that a failed row exceeded, s; a run with a longer limit tries again. scores: SI, by the names of metrics. created:
    when, UTC, in ISO 8601.
    """

    task: str
    version: int
    estimator: str
    source_hash: str
    case: Case
    episode: str
    robot_hash: str
    failure: str | None = None
    timeout: float | None = None
    scores: dict[str, float] = field(default_factory=dict)
    created: str = ""

    @property
    def refusal(self) -> str | None:
        """Why the estimator declined the robot, None if it did not."""
        return refusal_of(self.failure)


@dataclass(eq=False)
class Row(RowSummary):
    """A row with its trajectories, as it is stored.

    estimates: for each run the poses (M, 3) at `task.Run.samples`. covariances, stated: what the estimator said beside,
    as in `scoring.metric.Judged`. calibrated: the robot as a calibration method returned it; then `estimator` names the
    method, and the estimates are those of the task's odometry. origin: versions, machine and time, which `created`
    repeats.
    """

    estimates: tuple[Array, ...] = ()
    covariances: tuple[Array | None, ...] = ()
    stated: tuple[NDArray[np.bool_] | None, ...] = ()
    calibrated: RobotDescription | None = None
    origin: Origin = field(default_factory=provenance)

    def __post_init__(self):
        self.created = self.origin.created.astimezone(UTC).isoformat()


_SUMMARISED = tuple(part.name for part in fields(RowSummary))[2:]
"""What is kept of a row beside its file, whose folder says task and version."""


def refusal_of(failure: str | None) -> str | None:
    """Return why an estimator declined a robot, by the failure of its row; None if it did not."""
    return failure.removeprefix(DECLINED) if failure is not None and failure.startswith(DECLINED) else None


@dataclass(frozen=True)
class UpdateCost:
    """What following runs twice showed: CPU time of an update of a single vehicle, microseconds, the mean and that of
    the most expensive update; whether both passes gave the same poses; and on which machine, where that is stored.
    """

    mean: float
    worst: float
    repeats: bool = True
    machine: Machine | None = None


@checked_dataclass(frozen=True, kw_only=True, config=CONFIG)
class _Metadata:
    """A row without its estimates, as it is stored; a row that failed has a reason and no scores."""

    format: str
    task: Name
    task_version: int
    estimator: Name
    source_hash: Hash
    case: StoredCase
    episode: Hash
    robot_hash: Hash
    status: Literal["ok", "failed"]
    failure: Annotated[str, Field(min_length=1)] | None
    timeout_s: Duration | None
    scores: dict[str, NonNegativeFloat]
    origin: Origin
    calibrated: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        failed = self.status == "failed"
        if failed != (self.failure is not None) or failed == bool(self.scores):
            raise ValueError("status, failure and scores contradict each other")
        return self


@checked_dataclass(frozen=True, kw_only=True, config=CONFIG)
class _TimeMetadata:
    format: str
    mean_us: NonNegativeFloat
    worst_us: NonNegativeFloat
    poses_repeat: bool
    origin: Origin


_ADAPTER = TypeAdapter(_Metadata)
_TIME_ADAPTER = TypeAdapter(_TimeMetadata)


class ResultsStore:
    """The rows under a results folder. kind: the folder in it that holds them (see also `references`).

    Reading collects files that cannot be used in `corrupt`, and the formats of rows in older formats in
    `older_formats`.
    """

    def __init__(self, results: Path, kind: str = "rows"):
        self.root = results / kind
        self.corrupt: list[CorruptFileError] = []
        self.older_formats: set[str] = set()

    def of_task(self, task: str, version: int) -> Path:
        """Return the folder of a task's rows."""
        return self.root / f"{task}@{version}"

    def folder(self, task: str, version: int, estimator: str, source_hash: str) -> Path:
        """Return the folder of an estimator's rows in a task."""
        return self.of_task(task, version) / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', estimator)}-{source_hash}"

    def path(self, task: str, version: int, estimator: str, source_hash: str, case: Case) -> Path:
        """Return the file of a row."""
        return self.folder(task, version, estimator, source_hash) / file_name(case)

    def save(self, row: Row) -> None:
        """Store a row."""
        metadata = _Metadata(
            format=ROW_FORMAT,
            task=row.task,
            task_version=row.version,
            estimator=row.estimator,
            source_hash=row.source_hash,
            case=row.case,
            episode=row.episode,
            robot_hash=row.robot_hash,
            status="ok" if row.failure is None else "failed",
            failure=None if row.failure is None else _utf8(row.failure),
            timeout_s=row.timeout,
            scores=row.scores,
            origin=row.origin,
            calibrated=None if row.calibrated is None else row.calibrated.to_dict(),
        )
        folder = self.folder(row.task, row.version, row.estimator, row.source_hash)
        parts = {"estimate": row.estimates, "covariance": row.covariances, "stated": row.stated}
        arrays = {f"{part}_{k}": a for part, of in parts.items() for k, a in enumerate(of) if a is not None}
        write_archive(folder / file_name(row.case), _ADAPTER, metadata, arrays)

    def load(self, task: str, version: int, estimator: str, source_hash: str, case: Case) -> Row | None:
        """Return a stored row, None if there is none or it cannot be read (then it is in `corrupt`)."""
        return self._read(self.path(task, version, estimator, source_hash, case), task, version)

    def rows(self, task: str, version: int) -> Iterator[Row]:
        """Yield all rows of a task version, estimator by estimator."""
        for path in sorted(self.of_task(task, version).glob("*/*.npz")):
            if not path.name.startswith("."):
                row = self._read(path, task, version)
                if row is not None:
                    yield row

    def summaries(self, task: str, version: int) -> list[RowSummary]:
        """Return all rows of a task version without their trajectories, estimator by estimator.

        A file is opened once, as long as it stays the same (see `kept`).
        """

        def read(path: Path) -> list[Any] | None:
            row = self._read(path, task, version)
            return None if row is None else [getattr(row, name) for name in _SUMMARISED]

        kept = kept_beside(self.of_task(task, version), SUMMARY_FORMAT, read)
        return [RowSummary(task, version, *stored) for _, _, *stored in kept.values()]

    def versions(self) -> list[tuple[str, int]]:
        """Return the names and versions of all tasks that have rows."""
        found = [re.fullmatch(r"(.+)@(\d+)", path.name) for path in sorted(self.root.glob("*"))]
        return [(match[1], int(match[2])) for match in found if match]

    def save_time(
        self, task: str, version: int, estimator: str, source_hash: str, cost: UpdateCost, origin: Origin
    ) -> None:
        """Store what an update costs."""
        metadata = _TimeMetadata(
            format=TIME_FORMAT, mean_us=cost.mean, worst_us=cost.worst, poses_repeat=cost.repeats, origin=origin
        )
        path = self.folder(task, version, estimator, source_hash) / "time.json"
        write_json(path, _TIME_ADAPTER.dump_python(metadata, mode="json"))

    def load_time(self, task: str, version: int, estimator: str, source_hash: str) -> UpdateCost | None:
        """Return what an update costs, None if that is not stored, or in an older format."""
        path = self.folder(task, version, estimator, source_hash) / "time.json"
        try:
            text = path.read_text(encoding="utf-8")
            stored = checked(path, text, TIME_FORMAT, _TIME_ADAPTER)
            return UpdateCost(stored.mean_us, stored.worst_us, stored.poses_repeat, stored.origin.machine)
        except (FileNotFoundError, OlderFormatError):
            return None
        except CorruptFileError as error:
            self.corrupt.append(error)
        except (OSError, UnicodeDecodeError):
            self.corrupt.append(CorruptFileError(path, "is damaged or incomplete"))
        return None

    def _read(self, path: Path, task: str, version: int) -> Row | None:
        try:
            row = _row(path, *read_archive(path, ROW_FORMAT, _ADAPTER))
            # A copy under another name is not a separate row.
            if path != self.path(task, version, row.estimator, row.source_hash, row.case) or (
                (row.task, row.version) != (task, version)
            ):
                held = f"{row.task} version {row.version}, {row.estimator} at {row.source_hash}, case {row.case!r}"
                raise CorruptFileError(path, f"holds a row of {held}, which does not belong here")
            return row
        except FileNotFoundError:
            pass
        except OlderFormatError as error:
            self.older_formats.add(error.form)
        except CorruptFileError as error:
            self.corrupt.append(error)
        return None


def check_results_folder(results: Path, write: bool = True) -> None:
    """Raise InputError if a results folder cannot be one, or (write) cannot be written to; writes nothing."""
    if results.is_symlink() and not results.exists():
        raise InputError(f"--results {results}: is a link that leads nowhere; name a folder")
    for place in (results, *results.parents):
        if place.exists():
            if not place.is_dir():
                raise InputError(f"--results {results}: {place} is a file; name a folder")
            if write and not os.access(place, os.W_OK | os.X_OK):
                raise InputError(f"--results {results}: {place} may not be written to; name another folder")
            return


def clean_results_folder(results: Path) -> None:
    """Remove the temporary files of runs that were killed while they wrote; those of a run going on stay."""
    for part in ("rows/*", "rows/*/*", "references/*", "references/*/*", "episodes/*", "robots"):
        for folder in results.glob(part):
            remove_leftovers(folder)


def older_rows(formats: Iterable[str], folder: Path, outcome: str) -> str:
    """Return the note on rows of older formats in a folder; outcome: what happens to these rows."""
    return f"rows of an older format ({', '.join(sorted(formats))}) in {folder} {outcome}"


def _utf8(text: str) -> str:
    """Return text that UTF-8 can encode: a plug-in's message may hold half of a surrogate pair."""
    return text.encode(errors="replace").decode()


def _row(path: Path, metadata: _Metadata, arrays: dict[str, NDArray]) -> Row:
    runs = sum(name.startswith("estimate_") for name in arrays)
    names = [f"estimate_{k}" for k in range(runs)]
    beside = {f"{part}_{k}" for part in ("covariance", "stated") for k in range(runs)}
    if not set(names) <= set(arrays) or not all(_poses(arrays[name]) for name in names):
        raise CorruptFileError(path, "does not hold poses as estimates")
    covariances = tuple(arrays.get(f"covariance_{k}") for k in range(runs))
    stated = tuple(arrays.get(f"stated_{k}") for k in range(runs))
    shapes = [arrays[name].shape for name in names]
    if not (
        set(arrays) <= {*names, *beside}
        and all(map(_covariances, covariances, shapes))
        and all(map(_stated, stated, shapes))
    ):
        raise CorruptFileError(path, "holds covariances or states that do not belong to its estimates")
    try:
        stored = metadata.calibrated
        calibrated = None if stored is None else RobotDescription.from_dict(stored, str(path))
    except (InputError, RecursionError):
        raise CorruptFileError(path, "does not hold a calibrated robot") from None
    return Row(
        task=metadata.task,
        version=metadata.task_version,
        estimator=metadata.estimator,
        source_hash=metadata.source_hash,
        case=metadata.case,
        episode=metadata.episode,
        robot_hash=metadata.robot_hash,
        failure=metadata.failure,
        timeout=metadata.timeout_s,
        scores=metadata.scores,
        estimates=tuple(arrays[name] for name in names),
        covariances=covariances,
        stated=stated,
        calibrated=calibrated,
        origin=metadata.origin,
    )


def _poses(array: NDArray) -> bool:
    """Return whether an array holds poses, (M, 3) of a robot or (N, M, 3) of a train."""
    return (
        array.dtype == np.float64 and array.ndim in (2, 3) and array.shape[-1] == 3 and bool(np.isfinite(array).all())
    )


def _covariances(array: NDArray | None, poses: tuple[int, ...]) -> bool:
    """Return whether an array holds covariances of poses of a shape, or is None."""
    return array is None or (array.dtype == np.float64 and array.shape == (*poses, 3) and invalid(array) is None)


def _stated(array: NDArray | None, poses: tuple[int, ...]) -> bool:
    """Return whether an array holds a yes or no for each sample of poses of a shape, or is None."""
    return array is None or (array.dtype == bool and array.shape == poses[-2:-1])
