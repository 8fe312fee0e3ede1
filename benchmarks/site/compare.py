"""Two estimators, versions or sets of parameters on the same cases: better, worse, or not distinguishable."""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from benchmarks.leaderboard.ranking import FEWEST_CASES, Interval, different, interval
from benchmarks.results.asked import Asked, asked, latest_source
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.run.choose import entries_named
from benchmarks.run.evaluate import Competitor
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks.task import Case, Task
from castor_envs.errors import InputError, did_you_mean, shortened
from estimators.plugins.find import runs_others_code
from estimators.plugins.registry import CALIBRATION, ESTIMATOR, load_calibration, load_estimator

MOST_CASES = 3
"""That differ most, which are named and drawn."""
HASH = 8
"""Digits of a source hash that people see."""


class Verdict(StrEnum):
    """How the first stands against the second, by the test that ranks on boards."""

    BETTER = "better"
    WORSE = "worse"
    ALIKE = "not distinguishable"
    FEW = "too few cases"


@dataclass(frozen=True)
class Side:
    """One of the two: the name and the source hash that its rows have, the same in all tasks."""

    name: str
    source: str

    def rows(self, rows: Sequence[Row]) -> dict[Case, Row]:
        """Return its rows of a task by case."""
        return {row.case: row for row in rows if (row.estimator, row.source_hash) == (self.name, self.source)}


@dataclass(frozen=True)
class TaskDifference:
    """The first less the second on one task, over the cases (n,) that both have scores of.

    labels: what to call both. means: of both. difference: paired, with its interval; negative where the first is
    better. by_case: the difference of every case, in SI. failed: how many cases each failed. specs: what named both in
    the last run, None where that is not known.
    """

    task: Task
    metric: Metric
    labels: tuple[str, str]
    means: tuple[float, float]
    difference: Interval
    verdict: Verdict
    by_case: dict[Case, float]
    failed: tuple[int, int]
    rows: tuple[dict[Case, Row], dict[Case, Row]]
    specs: tuple[str | None, str | None]

    @property
    def most(self) -> list[Case]:
        """The cases that differ most, most first."""
        size = {case: abs(off) for case, off in self.by_case.items() if abs(off) > self.metric.rounding}
        return sorted(size, key=lambda case: (-size[case], str(case)))[:MOST_CASES]


def rows_by_task(tasks: Sequence[Task], results: Path) -> dict[str, list[Row]]:
    """Return the rows of tasks, by their names."""
    return {task.name: list(ResultsStore(results).rows(task.name, task.version)) for task in tasks}


def side_of(text: str, stored: Mapping[str, Sequence[Row]], results: Path, timeout: float) -> Side:
    """Return the side that a text names: a name or the spec of a plug-in, with parameters, each with @HASH or without.

    HASH: the beginning of its source's hash. Without, a name has the source that boards show, where they differ the one
    with the newest rows of these, and a plug-in is taken as it is now.

    timeout: s, that a plug-in may take to be loaded. Raises InputError for what has no rows.
    """
    sources: dict[str, set[str]] = {}
    for row in (row for rows in stored.values() for row in rows):
        sources.setdefault(row.estimator, set()).add(row.source_hash)
    name, at, source = text.rpartition("@")
    spec, version = (text, "") if text in sources or not at else (name, source)
    if spec not in sources:
        if (entry := _loaded(spec, sources, timeout)) is not None:
            spec, version = entry.name, version or entry.source_hash
        elif "?" in spec:
            spec = load_estimator(spec).name
    known = sources.get(spec)
    if known is None:
        meant = did_you_mean(text, sources) if sources else ""
        raise InputError(f"{text!r} has no rows in {results}; castor-bench run computes them{meant}")
    if not any(one.startswith(version) for one in known):
        raise InputError(
            f"{text!r}: {spec} has no rows of source {version[:HASH]} in {results}, only of {_hashes(known)}"
        )
    return Side(spec, _shown_source(spec, version, stored, results))


def _loaded(spec: str, known: Container[str], timeout: float) -> Competitor | None:
    """Return the estimator or the method of others that a spec names, the one whose name is known before the other.

    None for what is nobody's code; raises InputError where it can be loaded as neither.
    """
    found: list[Competitor] = []
    refused: list[InputError] = []
    for role, load in ((ESTIMATOR, load_estimator), (CALIBRATION, load_calibration)):
        if runs_others_code(spec, role):
            try:
                found += entries_named((spec,), timeout, load)
            except InputError as error:
                refused.append(error)
    if refused and not found:
        raise refused[0]
    return next((entry for entry in found if entry.name in known), next(iter(found), None))


def _shown_source(name: str, beginning: str, stored: Mapping[str, Sequence[Row]], results: Path) -> str:
    """Return the source that boards show of an estimator, of those that begin so: one for all tasks."""
    newest: dict[str, str] = {}
    for task, rows in stored.items():
        of = [row for row in rows if row.estimator == name and row.source_hash.startswith(beginning)]
        if of:
            last = asked(ResultsStore(results).of_task(task, of[0].version))
            source = latest_source(of, last.get(name))
            made = max(row.created for row in of if row.source_hash == source)
            newest[source] = max(made, newest.get(source, ""))
    return max(newest, key=newest.__getitem__)


def _hashes(sources: Iterable[str]) -> str:
    return ", ".join(sorted(source[:HASH] for source in sources))


def compare(
    first: Side, second: Side, stored: Mapping[str, Sequence[Row]], tasks: Sequence[Task], results: Path
) -> list[TaskDifference]:
    """Return how two stand against each other on every task in which both have rows.

    Raises InputError where they are the same, and where no task has rows of both.
    """
    if first == second:
        known = {row.source_hash for rows in stored.values() for row in rows if row.estimator == first.name}
        raise InputError(
            f"{first.name!r} is compared with itself; for two versions of it give NAME@HASH; "
            f"{results} has {_hashes(known)}"
        )
    found = []
    for task in tasks:
        sides = (first.rows(stored[task.name]), second.rows(stored[task.name]))
        last = asked(ResultsStore(results).of_task(task.name, task.version))
        if all(sides) and (of := _difference(task, sides, last)) is not None:
            found.append(of)
    if not found:
        raise InputError(f"{first.name!r} and {second.name!r} have no cases in common in {results}; run both on a task")
    return found


def of_other_sources(sides: Iterable[Side], stored: Mapping[str, Sequence[Row]]) -> list[str]:
    """Return what is left out of a comparison: tasks in which one of both has rows of other sources alone."""
    notes = []
    for side in sides:
        rows = {task: [row for row in of if row.estimator == side.name] for task, of in stored.items()}
        others = [task for task, of in rows.items() if of and not side.rows(of)]
        if others:
            tasks = shortened(", ".join(others))
            notes.append(f"left out, as {side.name}@{side.source[:HASH]} has not been run on them: {tasks}")
    return notes


def _difference(
    task: Task, sides: tuple[dict[Case, Row], dict[Case, Row]], last: Mapping[str, Asked]
) -> TaskDifference | None:
    a, b = sides
    metric = BOARD_METRICS[task.metric]
    cases = [
        case
        for case in a
        if case in b
        and a[case].episode == b[case].episode
        and metric.name in a[case].scores
        and metric.name in b[case].scores
    ]
    if not cases:
        return None
    scores = np.array([[side[case].scores[metric.name] for case in cases] for side in sides])
    off = scores[0] - scores[1]
    if len(cases) < FEWEST_CASES:
        verdict = Verdict.FEW
    elif not different(scores, metric.rounding)[0, 1]:
        verdict = Verdict.ALIKE
    else:
        verdict = Verdict.BETTER if float(np.mean(off)) < 0 else Verdict.WORSE
    return TaskDifference(
        task,
        metric,
        _labels(*(next(iter(side.values())) for side in sides)),
        (float(np.mean(scores[0])), float(np.mean(scores[1]))),
        interval(off),
        verdict,
        dict(zip(cases, off.tolist(), strict=True)),
        (sum(row.failure is not None for row in a.values()), sum(row.failure is not None for row in b.values())),
        sides,
        (_spec(a, last), _spec(b, last)),
    )


def _spec(side: dict[Case, Row], last: Mapping[str, Asked]) -> str | None:
    row = next(iter(side.values()))
    known = last.get(row.estimator)
    return known.spec if known is not None and known.source_hash == row.source_hash else None


def _labels(a: Row, b: Row) -> tuple[str, str]:
    """Return what to call both: their names, with the source where these are the same."""
    if a.estimator != b.estimator:
        return a.estimator, b.estimator
    return f"{a.estimator}@{a.source_hash[:HASH]}", f"{b.estimator}@{b.source_hash[:HASH]}"
