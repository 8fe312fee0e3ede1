"""Two estimators, versions or sets of parameters on the same cases: better, worse, or not distinguishable."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from benchmarks.leaderboard.ranking import FEWEST_CASES, Interval, different, interval
from benchmarks.results.asked import Asked, asked, latest_source
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.run.choose import entries_named
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks.task import Case, Task
from castor_envs.errors import InputError, did_you_mean
from estimators.plugins.find import runs_others_code
from estimators.plugins.registry import ESTIMATOR, load_estimator

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
    """One of the two: the name that rows have, and the source hash or its beginning; None: the one on the board."""

    name: str
    source: str | None = None

    def rows(self, rows: Sequence[Row], last: Mapping[str, Asked]) -> dict[Case, Row]:
        """Return its rows of a task by case, all of one source. last: what runs asked for last."""
        found = [row for row in rows if row.estimator == self.name and row.source_hash.startswith(self.source or "")]
        if not found:
            return {}
        source = latest_source(found, last.get(self.name))
        return {row.case: row for row in found if row.source_hash == source}


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

    HASH: the beginning of its source's hash; without, of a name the one on the board, and a plug-in as it is now.

    timeout: s, that a plug-in may take to be loaded. Raises InputError for what has no rows.
    """
    sources: dict[str, set[str]] = {}
    for row in (row for rows in stored.values() for row in rows):
        sources.setdefault(row.estimator, set()).add(row.source_hash)
    name, at, source = text.rpartition("@")
    spec, version = (text, None) if text in sources or not at else (name, source)
    side = Side(spec, version)
    if spec not in sources and runs_others_code(spec, ESTIMATOR):
        (entry,) = entries_named((spec,), timeout, load_estimator)
        side = Side(entry.name, version or entry.source_hash)
    elif spec not in sources and "?" in spec:
        side = Side(load_estimator(spec).name, version)
    known = sources.get(side.name)
    if known is None:
        meant = did_you_mean(text, sources) if sources else ""
        raise InputError(f"{text!r} has no rows in {results}; castor-bench run computes them{meant}")
    if side.source is not None and not any(one.startswith(side.source) for one in known):
        of = ", ".join(sorted(one[:HASH] for one in known))
        raise InputError(f"{text!r}: {side.name} has no rows of source {side.source[:HASH]} in {results}, only of {of}")
    return side


def compare(
    first: Side, second: Side, stored: Mapping[str, Sequence[Row]], tasks: Sequence[Task], results: Path
) -> list[TaskDifference]:
    """Return how two stand against each other on every task in which both have rows.

    Raises InputError where they are the same, and where no task has rows of both.
    """
    if first == second:
        raise InputError(
            f"{first.name!r} is compared with itself; for two versions of it give NAME@HASH, "
            "with the hashes that castor-bench leaderboard TASK tells"
        )
    found = []
    for task in tasks:
        rows, last = stored[task.name], asked(ResultsStore(results).of_task(task.name, task.version))
        sides = (first.rows(rows, last), second.rows(rows, last))
        if all(sides) and (of := _difference(task, sides, last)) is not None:
            found.append(of)
    if not found:
        raise InputError(f"{first.name!r} and {second.name!r} have no cases in common in {results}; run both on a task")
    return found


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
