"""What stored rows hold of the cases of a task: true and estimated poses, errors along the way, where runs end."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.leaderboard.board import Entry, TaskBoard
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.show.drives import Drive, drives_of
from benchmarks.tasks.task import Case, Episode
from castor_envs.geometry.arrays import Array


@dataclass(frozen=True, eq=False)
class StoredCases:
    """The rows of a task and the episodes that they are of, read once for all its pages."""

    rows: dict[tuple[str, str], dict[Case, Row]]
    episodes: dict[Case, Episode]

    @classmethod
    def of(cls, results: Path, task: str, version: int) -> "StoredCases":
        """Return those of a results folder; episodes that cannot be read, and rows of others, are left out."""
        rows: dict[tuple[str, str], dict[Case, Row]] = {}
        episodes: dict[Case, Episode | None] = {}
        store = EpisodeStore(results)
        for row in ResultsStore(results).rows(task, version):
            if row.case not in episodes:
                episodes[row.case] = _episode(store, task, version, row.case)
            rows.setdefault((row.estimator, row.source_hash), {})[row.case] = row
        return cls(rows, {case: episode for case, episode in episodes.items() if episode is not None})

    def of_entry(self, entry: Entry) -> dict[Case, Row]:
        """Return the rows of an estimator on the board, by case."""
        return self.rows.get((entry.estimator, entry.source_hash), {})

    def drives(self, case: Case, rows: Mapping[str, Row]) -> list[Drive]:
        """Return the drives of a case that are scored, with the poses of rows by what to call them.

        None where the episode is not stored, or where no row is of it.
        """
        episode = self.episodes.get(case)
        if episode is None:
            return []
        usable = {name: row for name, row in rows.items() if row.failure is None and row.episode == episode.digest}
        if not usable:
            return []
        drives = [
            drive.followed({name: row.estimates[k] for name, row in usable.items()})
            for k, drive in enumerate(drives_of(episode, stored=True))
        ]
        return [drive for drive, run in zip(drives, episode.runs, strict=True) if not run.baseline]


def typical_cases(board: TaskBoard, rows: dict[Case, Row]) -> dict[str, Case]:
    """Return the best, the median and the worst of the cases that have a score, by these words; fewer of few cases."""
    metric = board.metric.name
    order = sorted((row.scores[metric], str(case), case) for case, row in rows.items() if metric in row.scores)
    if not order:
        return {}
    chosen = {"best": order[0], "median": order[(len(order) - 1) // 2], "worst": order[-1]}
    if len(order) < 3:
        del chosen["median"]
    return {word: of[2] for word, of in chosen.items() if len(order) > 1 or word == "best"}


def end_errors(drive: Drive, name: str) -> Array:
    """Return by how much the last pose is off in x and y (2,), m; of a train that of the front axle."""
    off = drive.estimates[name][..., -1, :2] - drive.truth[..., -1, :2]
    return off if off.ndim == 1 else off[0]


def _episode(store: EpisodeStore, task: str, version: int, case: Case) -> Episode | None:
    try:
        return store.load(task, version, case)
    except (CorruptFileError, FileNotFoundError):
        return None
