"""The results store: one file a row, written whole, known by what it depends on.

    RESULTS/rows/<task>@<version>/<estimator>-<source hash>/<case>.npz    a row: metadata, scores, trajectories
    RESULTS/rows/<task>@<version>/<estimator>-<source hash>/time.json     the CPU time of an update in this task
    RESULTS/episodes/...                                                  see `episodes`

A row holds for one task version, one estimator's source and one recorded episode (by its digest, which covers the
robot); whatever differs in one of these is another row. Nothing is ever appended to or changed in place, so a run that
is killed leaves whole files only, and the next one computes what is missing.
"""

import contextlib
import json
import os
import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from benchmarks.results.archives import CorruptFileError, read_archive, write_archive
from benchmarks.results.episodes import file_name
from benchmarks.tasks.task import Case
from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription

ROW_FORMAT = "castor-row/1"
TIME_FORMAT = "castor-time/1"
NOT_SERVED = "not applicable: "
"""What a row's failure begins with where the estimator declined the robot; the estimator's reason follows."""
LEFT_OVER = 3600.0
"""s: older temporary files are left over from a run that was killed."""
_TEMPORARY = re.compile(r"\..+\.(npz|json)\.[a-z0-9_]{8}\.tmp")  # of castor_envs.files.write_atomically


@dataclass(frozen=True, eq=False)
class Row:
    """What one estimator did in one case of a task.

    episode, robot_hash: of the episode it ran on. failure: None, or why there are no scores. timeout: the limit that a
    row failed by, s, so that a longer one tries again. scores: SI, by the names of `evaluation.METRICS`. estimates: for
    each run the poses (M, 3) at `task.Run.samples`. calibrated: the robot as a calibration method returned it; then
    `estimator` names the method, and the estimates are those of the task's odometry. origin: versions, machine and
    time.
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
    estimates: tuple[Array, ...] = ()
    calibrated: RobotDescription | None = None
    origin: dict[str, Any] = field(default_factory=dict)

    @property
    def refusal(self) -> str | None:
        """Why the estimator declined the robot, None if it did not."""
        if self.failure is None or not self.failure.startswith(NOT_SERVED):
            return None
        return self.failure.removeprefix(NOT_SERVED)


class ResultsStore:
    """The rows under a results folder. Reading collects unreadable files in `corrupt` instead of passing over them."""

    def __init__(self, results: Path):
        self.root = results / "rows"
        self.corrupt: list[CorruptFileError] = []

    def folder(self, task: str, version: int, estimator: str, source_hash: str) -> Path:
        """Return the folder of an estimator's rows in a task."""
        return self.root / f"{task}@{version}" / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', estimator)}-{source_hash}"

    def _path(self, task: str, version: int, estimator: str, source_hash: str, case: Case) -> Path:
        return self.folder(task, version, estimator, source_hash) / file_name(case)

    def save(self, row: Row) -> None:
        """Store a row."""
        metadata = {
            "format": ROW_FORMAT,
            "task": row.task,
            "task_version": row.version,
            "estimator": row.estimator,
            "source_hash": row.source_hash,
            "case": row.case,
            "episode": row.episode,
            "robot_hash": row.robot_hash,
            "status": "ok" if row.failure is None else "failed",
            "failure": row.failure,
            "timeout_s": row.timeout,
            "scores": row.scores,
            "origin": row.origin,
        }
        if row.calibrated is not None:
            metadata["calibrated"] = row.calibrated.to_dict()
        folder = self.folder(row.task, row.version, row.estimator, row.source_hash)
        estimates = {f"estimate_{k}": estimate for k, estimate in enumerate(row.estimates)}
        write_archive(folder / file_name(row.case), metadata, estimates)

    def load(self, task: str, version: int, estimator: str, source_hash: str, case: Case) -> Row | None:
        """Return a stored row, None if there is none or it cannot be read (then it is in `corrupt`)."""
        row = self._read(self._path(task, version, estimator, source_hash, case))
        wanted = (task, version, estimator, source_hash, case)
        if row is None or (row.task, row.version, row.estimator, row.source_hash, row.case) != wanted:
            return None
        return row

    def rows(self, task: str, version: int) -> Iterator[Row]:
        """Yield all rows of a task version, estimator by estimator."""
        for path in sorted((self.root / f"{task}@{version}").glob("*/*.npz")):
            if not path.name.startswith("."):
                row = self._read(path)
                if row is None or (row.task, row.version) != (task, version):
                    continue
                # A copy under another name is no row of its own.
                if path == self._path(task, version, row.estimator, row.source_hash, row.case):
                    yield row

    def versions(self) -> list[tuple[str, int]]:
        """Return the names and versions of all tasks that there are rows of."""
        found = [re.fullmatch(r"(.+)@(\d+)", path.name) for path in sorted(self.root.glob("*"))]
        return [(match[1], int(match[2])) for match in found if match]

    def save_time(
        self, task: str, version: int, estimator: str, source_hash: str, time_us: float, origin: dict[str, Any]
    ) -> None:
        """Store the median CPU time of an update, microseconds."""
        metadata = {"format": TIME_FORMAT, "time_per_update_us": time_us, "origin": origin}
        path = self.folder(task, version, estimator, source_hash) / "time.json"
        write_atomically(path, json.dumps(metadata, indent=2, allow_nan=False) + "\n")

    def load_time(self, task: str, version: int, estimator: str, source_hash: str) -> float | None:
        """Return the stored time of an update, microseconds, None if there is none."""
        path = self.folder(task, version, estimator, source_hash) / "time.json"
        try:
            metadata = json.loads(path.read_text(encoding="utf-8"))
            if metadata["format"] != TIME_FORMAT:
                raise ValueError
            return float(metadata["time_per_update_us"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError):
            self.corrupt.append(CorruptFileError(path, "is damaged or incomplete"))
            return None

    def _read(self, path: Path) -> Row | None:
        try:
            metadata, arrays = read_archive(path, ROW_FORMAT)
            return _row(path, metadata, arrays)
        except FileNotFoundError:
            return None
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


def remove_leftovers(results: Path, older_than: float = LEFT_OVER) -> None:
    """Remove the temporary files of runs that were killed while they wrote; younger ones may be of a run going on."""
    for part in ("rows/*/*", "episodes/*"):
        for path in results.glob(f"{part}/.*.tmp"):
            with contextlib.suppress(OSError):
                if _TEMPORARY.fullmatch(path.name) and time.time() - path.lstat().st_mtime > older_than:
                    path.unlink()


def names_of(corrupt: Sequence[CorruptFileError], most: int = 3) -> str:
    """Return the paths of unreadable files in one line."""
    names = list(dict.fromkeys(str(error.path) for error in corrupt))
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _row(path: Path, metadata: dict[str, Any], arrays: dict[str, NDArray]) -> Row:
    try:
        calibrated = metadata.get("calibrated")
        return Row(
            task=metadata["task"],
            version=metadata["task_version"],
            estimator=metadata["estimator"],
            source_hash=metadata["source_hash"],
            case=metadata["case"],
            episode=metadata["episode"],
            robot_hash=metadata["robot_hash"],
            failure=metadata["failure"],
            timeout=metadata["timeout_s"],
            scores={str(name): float(value) for name, value in metadata["scores"].items()},
            estimates=tuple(arrays[f"estimate_{k}"] for k in range(len(arrays))),
            calibrated=None if calibrated is None else RobotDescription.from_dict(calibrated, str(path)),
            origin=dict(metadata["origin"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError):  # InputError is a ValueError
        raise CorruptFileError(path, "does not hold a row") from None
