"""Scores computed again from what is stored: the estimated trajectories and the recorded episodes."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.scoring.registry import score


def rescore(results: Path, task: str, version: int) -> Iterator[Row]:
    """Yield all rows of a task version with their scores computed anew, no estimator run; writes nothing.

    Failed rows come as they are. Raises CorruptFileError or FileNotFoundError for an episode that cannot be read.
    """
    episodes = EpisodeStore(results)
    for row in ResultsStore(results).rows(task, version):
        if row.failure is None:
            scores = score(episodes.load(task, version, row.case), row.estimates, row.calibrated)
            yield dataclasses.replace(row, scores={k: value for k, value in scores.items() if np.isfinite(value)})
        else:
            yield row
