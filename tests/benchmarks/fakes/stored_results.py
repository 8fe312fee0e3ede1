"""A results folder whose rows are put in by hand: errors by case and estimator, with paths that show them."""

import dataclasses
from datetime import UTC, datetime

import numpy as np

from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import provenance
from benchmarks.results.rows import ResultsStore, Row, UpdateCost

HOSTILE = "<script>alert(1)</script>"
LONG = "very-long-name?" + "&".join(f"parameter_{k}=0.123456789" for k in range(5))
UNICODE = "ψ/../../odometry: Größe “5 °”"
NAMES = ("good", "equal", "worse", "failing", HOSTILE, LONG, UNICODE)
HARD = np.linspace(0.01, 0.08, 8)
"""m: errors of the eight cases."""


class Results:
    """Rows of one task; the paths of an estimator are off by its error in x, at the end of each run."""

    def __init__(self, folder, task):
        self.folder, self.task = folder, task
        self.store, self.episodes = ResultsStore(folder), {}
        for case in task.cases():
            self.episodes[case] = task.record(case)
            EpisodeStore(folder).save(task, case, self.episodes[case])

    def put(self, estimator, errors, source_hash="a" * 16, created=2021, failed=()):
        for case, error in enumerate(errors):
            episode = self.episodes[case]
            off = [np.linspace(0, 1, len(run.truth))[:, None] * [error, 0, 0] for run in episode.runs]
            reason = "lost <b>its</b> way" if case in failed else None
            row = Row(
                task=self.task.name,
                version=self.task.version,
                estimator=estimator,
                source_hash=source_hash,
                case=case,
                episode=episode.digest,
                robot_hash="d" * 16,
                failure=reason,
                scores={} if reason else {self.task.metric: error, "ate": error / 2},
                estimates=() if reason else tuple(run.truth + d for run, d in zip(episode.runs, off, strict=True)),
                origin=dataclasses.replace(provenance(), created=datetime(created, 1, 1, tzinfo=UTC)),
            )
            self.store.save(row)
        self.store.save_time(
            self.task.name, self.task.version, estimator, source_hash, UpdateCost(12.0, 34.0), provenance()
        )


def made(folder, task):
    """Return a folder with rows of good, worse, equal, failing and hostile estimators on a task of eight cases."""
    results = Results(folder, task)
    results.put("good", HARD)
    results.put("equal", HARD + 1e-4 * np.array([1, -1, 1, -1, 1, -1, 1, -1]))
    results.put("worse", HARD + np.array([1, 2, 3, 4, 5, 6, 7, 40]) * 1e-3)
    results.put("failing", HARD * 2, failed=(0, 3))
    results.put("good", HARD + 0.01, "b" * 16, created=2020)
    for k, name in enumerate((HOSTILE, LONG, UNICODE)):
        results.put(name, HARD * (3 + k))
    return results
