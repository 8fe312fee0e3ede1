"""Scores computed again from what is stored: the estimated trajectories and the recorded episodes."""

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.results.archives import CorruptFileError
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import provenance
from benchmarks.results.references import reference_store
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.scoring.registry import score
from benchmarks.tasks.task import Task

ROUNDED = 1e-12
"""Part by which sums of some thousand numbers may differ between machines."""


@dataclass(frozen=True)
class Rescored:
    """A row whose scores were computed anew.

    row: with the new scores; unchanged if it failed. changed: by metric, the score before and now, None where there is
    none; not of those that agree to rounding. problem: why the row could not be scored again; then the row is
    unchanged.
    """

    row: Row
    changed: dict[str, tuple[float | None, float | None]] = field(default_factory=dict)
    problem: str | None = None


def rescore(results: Path, task: str, version: int, store: ResultsStore | None = None) -> Iterator[Rescored]:
    """Yield all rows of a task version with their scores computed anew, no estimator run; writes nothing.

    store: the rows, those of estimators unless given; of the references that of `reference_store`.
    """
    episodes = EpisodeStore(results)
    for row in (ResultsStore(results) if store is None else store).rows(task, version):
        if row.failure is not None:
            yield Rescored(row)
            continue
        try:
            episode = episodes.load(task, version, row.case)
            if episode.digest != row.episode:
                yield Rescored(row, problem=f"case {row.case}: its episode was recorded again; run again")
                continue
            with np.errstate(all="ignore"):
                scores = score(episode, row.estimates, row.calibrated, row.covariances, row.stated)
        except (CorruptFileError, ValueError) as error:
            yield Rescored(row, problem=str(error))
            continue
        except FileNotFoundError:
            yield Rescored(row, problem=f"case {row.case}: its episode is not stored; run again")
            continue
        scores = {name: value for name, value in scores.items() if np.isfinite(value)}
        names = dict.fromkeys((*row.scores, *scores))
        scored = {name: (row.scores.get(name), scores.get(name)) for name in names}
        changed = {name: pair for name, pair in scored.items() if not _same(*pair)}
        yield Rescored(dataclasses.replace(row, scores=scores), changed)


def _same(before: float | None, now: float | None) -> bool:
    """Return whether two scores agree to rounding; None: there is none."""
    if before is None or now is None:
        return before is now
    return math.isclose(before, now, rel_tol=ROUNDED)


@dataclass(frozen=True)
class RescoredTask:
    """What scoring a task's rows again changed. rows, changed: of estimators, how many there are and changed.

    metrics: by estimator or reference and metric, how many rows changed.
    """

    task: str
    rows: int
    changed: int
    metrics: dict[tuple[str, str], int]
    problems: tuple[str, ...]


def rescore_task(results: Path, task: Task, write: bool) -> RescoredTask:
    """Score a task's rows again, store (write) those whose scores changed, and return what changed.

    So are the oracle's and those of standing still, between which boards say what an estimator attains. A stored row
    keeps its origin, and `rescored` in it says when.
    """
    changed, metrics, problems, rows = 0, Counter(), {}, 0
    judged, beside = ResultsStore(results), reference_store(results)
    for store, rescored in [
        (of, one) for of in (judged, beside) for one in rescore(results, task.name, task.version, of)
    ]:
        rows += store is judged
        if rescored.problem is not None:
            problems[rescored.problem] = None
        if rescored.changed:
            changed += store is judged
            metrics.update((rescored.row.estimator, name) for name in rescored.changed)
            if write:
                origin = dataclasses.replace(rescored.row.origin, rescored=provenance().created)
                store.save(dataclasses.replace(rescored.row, origin=origin))
    return RescoredTask(task.name, rows, changed, dict(sorted(metrics.items())), tuple(problems))
