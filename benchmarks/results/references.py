"""Rows of no estimator that boards show beside those of estimators, unranked: standing still, and the oracle.

They say what an error means: what is reached by never moving, and by being told what nobody can know, a yardstick and
no strict bound. They are stored in a folder of their own (`reference_store`) whenever an episode is recorded.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.results.rows import ResultsStore, Row
from benchmarks.scoring.registry import score
from benchmarks.tasks.task import Case, Episode, Task, odometry_of
from castor_envs.geometry.arrays import Array

CEILING, FLOOR = "(oracle)", "(standing still)"


def reference_store(results: Path) -> ResultsStore:
    """Return the references of a results folder."""
    return ResultsStore(results, "references")


def save_references(store: ResultsStore, task: Task, case: Case, episode: Episode) -> None:
    """Store the rows of a recorded episode; the oracle's where the task has one, none of tasks of calibration."""
    if odometry_of(task) is not None:
        return
    still = [np.broadcast_to(run.start[..., None, :], run.truth.shape).copy() for run in episode.runs]
    told = [run.oracle for run in episode.runs if run.oracle is not None]
    _save(store, task, case, episode, FLOOR, still)
    if len(told) == len(episode.runs):
        _save(store, task, case, episode, CEILING, told)


def _save(store: ResultsStore, task: Task, case: Case, episode: Episode, name: str, poses: Sequence[Array]) -> None:
    with np.errstate(all="ignore"):
        scores = {metric: value for metric, value in score(episode, poses).items() if np.isfinite(value)}
    if task.metric in scores:
        row = Row(
            task=task.name,
            version=task.version,
            estimator=name,
            source_hash=hashlib.sha256(name.encode()).hexdigest()[:16],
            case=case,
            episode=episode.digest,
            robot_hash=episode.robot.hash(),
            scores=scores,
            estimates=tuple(poses),
        )
        store.save(row)
