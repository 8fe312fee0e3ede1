"""From stored rows to a leaderboard: who is compared with whom, on what, and what is left out and why."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.leaderboard.ranking import Interval, interval, ranks
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.scoring.registry import METRICS, STANDING_STILL, Metric
from benchmarks.tasks.task import Case, Task, odometry_of


@dataclass(frozen=True)
class FailedCases:
    """Cases that an estimator failed for one reason."""

    reason: str
    cases: tuple[Case, ...]


@dataclass(frozen=True)
class NotServed:
    """An estimator that declines a task's robot, and why."""

    estimator: str
    reason: str


@dataclass(frozen=True)
class Entry:
    """One estimator on a task's board.

    rank: None if it failed or lacks cases, so that failing on hard cases never helps, or if it `stands_still`: its ATE
    is no better than that of the start pose, and a robot that returns to its start flatters whoever never left it.
    scores: by metric, over the `done` cases that it did. lacking: cases of the board that it has no row of.
    """

    rank: int | None
    estimator: str
    source_hash: str
    scores: dict[str, Interval]
    time_per_update_us: float | None
    done: int
    failed: tuple[FailedCases, ...]
    lacking: tuple[Case, ...]
    stands_still: bool


@dataclass(frozen=True)
class TaskBoard:
    """The board of a task.

    missing: why there are no results. not_served: estimators all of whose rows are refusals, with the reason.
    superseded: estimators with the hash and number of rows of their older sources. odometry: of a board of calibration
    methods, which then are its `estimator`s, the estimator that follows the calibrated robots; else None.
    """

    task: str
    version: int
    title: str
    description: str
    metric: Metric
    cases: tuple[Case, ...]
    entries: tuple[Entry, ...]
    not_served: tuple[NotServed, ...]
    missing: str | None
    superseded: tuple[tuple[str, str, int], ...]
    odometry: str | None = None


@dataclass(frozen=True)
class Leaderboard:
    """All boards. other_versions: of these tasks, of which there are rows that are not shown."""

    boards: tuple[TaskBoard, ...]
    other_versions: tuple[tuple[str, int], ...]
    corrupt: tuple[CorruptFileError, ...]


def build(
    tasks: Sequence[Task],
    results: Path,
    cases: int | None = None,
    missing: Mapping[str, str] | None = None,
    sources: Mapping[str, str] | None = None,
    left_out: Mapping[str, Sequence[NotServed]] | None = None,
) -> Leaderboard:
    """Return the leaderboard of some tasks from a results folder.

    cases: look at the first so many cases of each task only; None: at all that any estimator has a row of. missing:
    why tasks could not be run, by name, beyond what they say themselves. sources: source hashes by estimator; of
    estimators not in it the source with the newest row is shown. left_out: estimators that a run left out of tasks, by
    task.
    """
    store, episodes = ResultsStore(results), EpisodeStore(results)
    boards = []
    for task in tasks:
        rows = list(store.rows(task.name, task.version))
        if cases is not None:
            wanted = set(task.cases(cases)) if task.missing is None else {row.case for row in rows}
            rows = [row for row in rows if row.case in wanted]
        reason = (missing or {}).get(task.name) or task.missing
        boards.append(_board(task, rows, store, episodes, reason, sources or {}, (left_out or {}).get(task.name, ())))
    current = {task.name: task.version for task in tasks}
    others = tuple((name, version) for name, version in store.versions() if current.get(name, version) != version)
    return Leaderboard(tuple(boards), others, tuple(store.corrupt))


def _board(
    task: Task,
    rows: list[Row],
    store: ResultsStore,
    episodes: EpisodeStore,
    missing: str | None,
    current: Mapping[str, str],
    left_out: Sequence[NotServed],
) -> TaskBoard:
    recorded: dict[Case, str | None] = {}
    by_source: dict[str, dict[str, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if row.case not in recorded:
            recorded[row.case] = _digest(episodes, task, row.case) or row.episode
        if row.episode == recorded[row.case]:
            by_source[row.estimator][row.source_hash].append(row)
    newest, superseded = {}, []
    for name, sources in sorted(by_source.items()):
        latest = current.get(name)
        if latest not in sources:
            latest = max(sources, key=lambda source: max(row.origin.get("created", "") for row in sources[source]))
        newest[name] = sources[latest]
        superseded += [(name, source, len(own)) for source, own in sources.items() if source != latest]
    declining = [name for name, own in newest.items() if all(row.refusal is not None for row in own)]
    refused = {name: newest[name][0].refusal or "" for name in declining}
    not_served = {**{one.estimator: one.reason for one in left_out if one.estimator not in newest}, **refused}
    newest = {name: own for name, own in newest.items() if name not in refused}
    cases = tuple(sorted({row.case for own in newest.values() for row in own}, key=_case_order))
    ranking = {
        name: [row.scores[task.metric] for row in sorted(own, key=lambda row: _case_order(row.case))]
        for name, own in newest.items()
        if len(own) == len(cases) and all(row.failure is None for row in own) and not _stands_still(own)
    }
    placed = ranks(ranking)
    entries = [_entry(task, name, own, placed.get(name), cases, store) for name, own in newest.items()]
    entries.sort(key=lambda entry: _entry_order(entry, task.metric))
    return TaskBoard(
        task=task.name,
        version=task.version,
        title=task.title,
        description=task.description,
        metric=METRICS[task.metric],
        cases=cases,
        entries=tuple(entries),
        not_served=tuple(NotServed(name, reason) for name, reason in sorted(not_served.items())),
        missing=missing if not entries else None,
        superseded=tuple(superseded),
        odometry=odometry_of(task),
    )


def _entry(
    task: Task, name: str, rows: list[Row], rank: int | None, cases: tuple[Case, ...], store: ResultsStore
) -> Entry:
    good = sorted((row for row in rows if row.failure is None), key=lambda row: _case_order(row.case))
    reasons: dict[str, list[Case]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: _case_order(row.case)):
        if row.failure is not None:
            reasons[row.failure].append(row.case)
    present = {row.case for row in rows}
    source_hash = rows[0].source_hash
    return Entry(
        rank=rank,
        estimator=name,
        source_hash=source_hash,
        scores={
            metric: interval([row.scores[metric] for row in good])
            for metric in METRICS
            if good and all(metric in row.scores for row in good)
        },
        time_per_update_us=store.load_time(task.name, task.version, name, source_hash),
        done=len(good),
        failed=tuple(FailedCases(reason, tuple(own)) for reason, own in reasons.items()),
        lacking=tuple(case for case in cases if case not in present),
        stands_still=_stands_still(good),
    )


def _stands_still(rows: list[Row]) -> bool:
    """Return whether the paths of scored rows are, on the whole, no nearer to the truth than the start pose is."""
    return (
        sum(row.scores.get("ate", 0.0) - row.scores.get(STANDING_STILL, float("inf")) for row in rows) >= 0 < len(rows)
    )


def _digest(episodes: EpisodeStore, task: Task, case: Case) -> str | None:
    try:
        return episodes.digest(task.name, task.version, case)
    except CorruptFileError:
        return None


def _case_order(case: Case) -> tuple[bool, int, str]:
    """Seeds by number, then names."""
    return (False, case, "") if isinstance(case, int) else (True, 0, case)


def _entry_order(entry: Entry, metric: str) -> tuple[bool, float, str]:
    mean = entry.scores[metric].mean if metric in entry.scores else float("inf")
    return entry.rank is None, mean, entry.estimator
