"""From stored rows to a leaderboard: which estimators are compared, on which cases, what is left out and why."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np

from benchmarks.leaderboard.ranking import Interval, intervals, ranks
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.asked import Asked, asked, latest_source, spec_of
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.references import CEILING, FLOOR, reference_store
from benchmarks.results.rows import DECLINED, ResultsStore, RowSummary, UpdateCost
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.path_metrics import ATTAINED, STANDING_STILL, attained
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks.task import Case, Task, odometry_of, source_of
from castor_envs.vehicles.train import TrainDescription


@dataclass(frozen=True)
class FailedCases:
    """Cases that an estimator failed for one reason. declined: it stated itself that it does not serve them."""

    reason: str
    cases: tuple[Case, ...]
    declined: bool = False


@dataclass(frozen=True)
class DeclinedEstimator:
    """An estimator that declines a task's robot, and why."""

    estimator: str
    reason: str


@dataclass(frozen=True)
class Entry:
    """One estimator on a task's board.

    rank: None if it failed or lacks cases, so that failing on hard cases never helps, or if it `stands_still`: its ATE
    is no better than that of the constant start pose, which has a small end error where a robot returns to its start.
    scores: by metric, over the `done` cases. lacking: cases of the board without a row of this estimator. spec: what
    named it in the last run, None where that is not known.
    """

    rank: int | None
    estimator: str
    source_hash: str
    scores: dict[str, Interval]
    cost: UpdateCost | None
    done: int
    failed: tuple[FailedCases, ...]
    lacking: tuple[Case, ...]
    stands_still: bool
    spec: str | None = None

    @property
    def costs(self) -> tuple[float, float] | tuple[None, None]:
        """CPU time of an update, microseconds, the mean and the worst; None where they are not known."""
        return (None, None) if self.cost is None else (self.cost.mean, self.cost.worst)

    @property
    def shown(self) -> str:
        """Its name for tables, with the number of its cases where it lacks some: its means are of these alone."""
        if not self.lacking:
            return self.estimator
        cases = self.done + sum(len(failed.cases) for failed in self.failed) + len(self.lacking)
        return f"{self.estimator} ({self.done} of {cases} cases)"


@dataclass(frozen=True)
class TaskBoard:
    """The board of a task. of_train: it judges estimators of trains.

    ceiling and floor: the oracle, where the task has one, and standing still; they are no estimators and have no rank.
    official: the cases that the task has (`Task.cases`), of which `cases` may be a part, or hold others beside: every
    seed is one; None where its data are missing.
    missing: why there are no results, or not of all cases. declined: estimators that declined every case, with the
    reason. superseded: estimators with the hash and number of rows of their older sources. odometry: on a board of
    calibration methods (then the `estimator`s of its entries) the estimator that follows the calibrated robots; else
    None. spec: what names a task of others in commands, None where its name does or that is not known.
    """

    task: str
    group: str
    of_train: bool
    version: int
    title: str
    description: str
    metric: Metric
    cases: tuple[Case, ...]
    entries: tuple[Entry, ...]
    declined: tuple[DeclinedEstimator, ...]
    missing: str | None
    superseded: tuple[tuple[str, str, int], ...]
    odometry: str | None = None
    spec: str | None = None
    ceiling: Entry | None = None
    floor: Entry | None = None
    official: Sequence[Case] | None = None

    @property
    def beyond(self) -> int:
        """How many of the cases are not among the task's own."""
        return 0 if self.official is None else len(set(self.cases).difference(self.official))

    @property
    def rows(self) -> tuple[Entry, ...]:
        """What a table of the board shows: the entries, and below them ceiling and floor."""
        return (*self.entries, *(entry for entry in (self.ceiling, self.floor) if entry is not None and self.entries))

    @property
    def given(self) -> str:
        """What names the task in commands, as far as that is known."""
        return self.spec or self.task


@dataclass(frozen=True)
class Leaderboard:
    """All boards of a folder of rows.

    other_versions: names and other versions of these tasks whose rows are not shown. refused: files of rows that cannot
    be used, with the reason; refused_episodes: the same for recorded episodes. older_formats: formats of rows that are
    not shown.
    """

    boards: tuple[TaskBoard, ...]
    other_versions: tuple[tuple[str, int], ...]
    refused: tuple[CorruptFileError, ...]
    refused_episodes: tuple[CorruptFileError, ...]
    older_formats: tuple[str, ...]
    folder: Path


def build(
    tasks: Sequence[Task],
    results: Path,
    cases: int | None = None,
    missing: Mapping[str, str] | None = None,
    left_out: Mapping[str, Sequence[DeclinedEstimator]] | None = None,
) -> Leaderboard:
    """Return the leaderboard of some tasks from a results folder.

    cases: number of cases of each task to look at, from the first; None: all cases that have a row. missing: why tasks,
    or cases of them, could not be run, by name; the reasons that tasks state count where there are no results.
    left_out: estimators that a run left out, by task. Of an estimator with several sources the one
    that a run asked for last is shown.
    """
    store, episodes, refused_episodes = ResultsStore(results), EpisodeStore(results), []
    boards = []
    for task in tasks:
        rows = _usable(task, store)
        if cases is not None:
            chosen = set(task.cases(cases)) if task.missing is None else {row.case for row in rows}
            rows = [row for row in rows if row.case in chosen]
        recorded = _recorded(task, [row.case for row in rows], episodes, refused_episodes)
        references = sorted(reference_store(results).summaries(task.name, task.version), key=_by_case)
        left = (left_out or {}).get(task.name, ())
        last = asked(store.of_task(task.name, task.version))
        boards.append(_board(task, rows, references, store, recorded, (missing or {}).get(task.name), last, left))
    current = {task.name: task.version for task in tasks}
    other_versions = tuple(
        (name, version) for name, version in store.versions() if current.get(name, version) != version
    )
    refused = {error.path: error for error in store.corrupt}
    return Leaderboard(
        tuple(boards),
        other_versions,
        tuple(refused.values()),
        tuple(refused_episodes),
        tuple(sorted(store.older_formats)),
        store.root,
    )


def _usable(task: Task, store: ResultsStore) -> list[RowSummary]:
    """Return the rows that a task's board can use, in the order of cases; others are marked as refused in `store`."""
    official = task.cases() if task.missing is None else None
    seeds, names = official is not None and isinstance(official[0], int), set(official or ())
    usable = []
    for row in store.summaries(task.name, task.version):
        if row.failure is None and task.metric not in row.scores:
            reason = f"has no score {task.metric}, by which {task.name} ranks"
        elif official is not None and not (
            isinstance(row.case, int) and row.case >= 0 if seeds else row.case in names
        ):  # any seed where cases are seeds, else a name of the task's list
            reason = f"holds case {row.case!r}, which {task.name} does not have"
        else:
            usable.append(row)
            continue
        path = store.path(row.task, row.version, row.estimator, row.source_hash, row.case)
        store.corrupt.append(CorruptFileError(path, reason))
    return sorted(usable, key=_by_case)


def _recorded(
    task: Task, cases: Iterable[Case], episodes: EpisodeStore, refused: list[CorruptFileError]
) -> dict[Case, str]:
    """Return the digests of stored episodes; those that cannot be used are added to `refused`."""
    digests: dict[Case, str] = {}
    for case in dict.fromkeys(cases):
        try:
            digest = episodes.digest(task.name, task.version, case, source_of(task, case))
        except CorruptFileError as error:
            refused.append(error)
            continue
        if digest is not None:
            digests[case] = digest
    return digests


def _board(
    task: Task,
    rows: list[RowSummary],
    references: Iterable[RowSummary],
    store: ResultsStore,
    recorded: dict[Case, str],
    missing: str | None,
    last: Mapping[str, Asked],
    left_out: Sequence[DeclinedEstimator],
) -> TaskBoard:
    by_source: dict[str, dict[str, list[RowSummary]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row.episode == recorded.setdefault(row.case, row.episode):
            by_source[row.estimator][row.source_hash].append(row)
    newest, superseded = {}, []
    for name, sources in sorted(by_source.items()):
        latest = latest_source((row for of in sources.values() for row in of), last.get(name))
        newest[name] = sources[latest]
        superseded += [(name, source, len(source_rows)) for source, source_rows in sources.items() if source != latest]
    declining = [name for name, entry_rows in newest.items() if all(row.refusal is not None for row in entry_rows)]
    refused = {name: newest[name][0].refusal or "" for name in declining}
    declined = {
        **{refusal.estimator: refusal.reason for refusal in left_out if refusal.estimator not in newest},
        **refused,
    }
    newest = {name: entry_rows for name, entry_rows in newest.items() if name not in refused}
    cases = tuple(sorted({row.case for entry_rows in newest.values() for row in entry_rows}, key=_case_order))
    ranking = {
        name: [row.scores[task.metric] for row in entry_rows]
        for name, entry_rows in newest.items()
        if len(entry_rows) == len(cases)
        and all(row.failure is None for row in entry_rows)
        and not _stands_still(entry_rows)
    }
    placed = ranks(ranking, BOARD_METRICS[task.metric].rounding)
    whole = _whole(references, {case: recorded[case] for case in cases})
    entries = [
        _entry(task, name, _with_attained(task, entry_rows, whole), placed.get(name), cases, store, last.get(name))
        for name, entry_rows in newest.items()
    ]
    beside = {name: _entry(task, name, of, None, cases, store) for name, of in whole.items()}
    entries.sort(key=lambda entry: _entry_order(entry, task.metric))
    return TaskBoard(
        task=task.name,
        group=task.group,
        of_train=isinstance(task.robot, TrainDescription),
        version=task.version,
        title=task.title,
        description=task.description,
        metric=BOARD_METRICS[task.metric],
        cases=cases,
        entries=tuple(entries),
        declined=tuple(DeclinedEstimator(name, reason) for name, reason in sorted(declined.items())),
        missing=missing or (task.missing if not entries else None),
        superseded=tuple(superseded),
        odometry=odometry_of(task),
        spec=spec_of(task),
        ceiling=beside.get(CEILING),
        floor=beside.get(FLOOR),
        official=task.cases() if task.missing is None else None,
    )


def _whole(rows: Iterable[RowSummary], episodes: dict[Case, str]) -> dict[str, list[RowSummary]]:
    """Return the rows of ceiling and floor, by name, where there is one of every recorded episode (digests by case)."""
    found: dict[str, list[RowSummary]] = defaultdict(list)
    for row in rows:
        if row.failure is None and episodes.get(row.case) == row.episode:
            found[row.estimator].append(row)
    return {name: of for name, of in found.items() if len(of) == len(episodes)}


def _with_attained(task: Task, rows: list[RowSummary], references: dict[str, list[RowSummary]]) -> list[RowSummary]:
    """Return an estimator's rows with what each attains between standing still and the oracle, where both are known.

    By the ATE, as on a closed square who stands still ends where the robot does; of snapshots by what ranks.
    """
    floor, ceiling = ({row.case: row.scores for row in references.get(name, [])} for name in (FLOOR, CEILING))
    both = [row for row in rows if row.failure is None and row.case in floor and row.case in ceiling]
    metrics = ["ate" if "ate" in row.scores else task.metric for row in both]
    pairs = list(zip(both, metrics, strict=True))
    parts = attained(
        [row.scores[metric] for row, metric in pairs],
        [floor[row.case][metric] for row, metric in pairs],
        [ceiling[row.case][metric] for row, metric in pairs],
    )
    known = {row.case: part for row, part in zip(both, parts.tolist(), strict=True) if isfinite(part)}
    return [
        replace(row, scores={**row.scores, ATTAINED: known[row.case]}) if row.case in known else row for row in rows
    ]


def _entry(
    task: Task,
    name: str,
    rows: list[RowSummary],
    rank: int | None,
    cases: tuple[Case, ...],
    store: ResultsStore,
    last: Asked | None = None,
) -> Entry:
    good = [row for row in rows if row.failure is None]
    reasons: dict[str, list[Case]] = defaultdict(list)
    for row in rows:
        if row.failure is not None:
            reasons[row.failure].append(row.case)
    present = {row.case for row in rows}
    source_hash = rows[0].source_hash
    shared = set(good[0].scores).intersection(*(row.scores for row in good)) if good else set()
    common = [key for key in BOARD_METRICS if key in shared]
    table = np.array([[row.scores[key] for row in good] for key in common])
    means = intervals(table, [BOARD_METRICS[key].within for key in common]) if common else []
    return Entry(
        rank=rank,
        estimator=name,
        source_hash=source_hash,
        scores=dict(zip(common, means, strict=True)),
        cost=store.load_time(task.name, task.version, name, source_hash),
        done=len(good),
        failed=tuple(
            FailedCases(reason, tuple(failed_cases), reason.startswith(DECLINED))
            for reason, failed_cases in reasons.items()
        ),
        lacking=tuple(case for case in cases if case not in present),
        stands_still=_stands_still(good),
        spec=last.spec if last is not None and last.source_hash == source_hash else None,
    )


def _stands_still(rows: list[RowSummary]) -> bool:
    """Return whether the paths of scored rows are, on the whole, no nearer to the truth than the start pose is."""
    if not all("ate" in row.scores and STANDING_STILL in row.scores for row in rows):
        return False
    return sum(row.scores["ate"] - row.scores[STANDING_STILL] for row in rows) >= 0 < len(rows)


def _case_order(case: Case) -> tuple[bool, int, str]:
    """Seeds by number, then names."""
    return (False, case, "") if isinstance(case, int) else (True, 0, case)


def _by_case(row: RowSummary) -> tuple[bool, int, str]:
    return _case_order(row.case)


def _entry_order(entry: Entry, metric: str) -> tuple[bool, float, str]:
    mean = entry.scores[metric].mean if metric in entry.scores else float("inf")
    return entry.rank is None, mean, entry.estimator
