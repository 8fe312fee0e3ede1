"""What it costs to send jobs to worker processes and clusters, and to store what comes back."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from benchmarks.results.episodes import EpisodeStore
from benchmarks.run.clusters import Cluster, connect
from benchmarks.run.plan import Assignment, run
from benchmarks.run.worker_estimate import observed_runs
from benchmarks.speed.figures import Effort, Figure, Group
from benchmarks.tasks import official_tasks
from benchmarks.tasks.task import Episode, Task
from castor_envs.errors import InputError
from castor_envs.processes import Done, Job, run_jobs
from estimators.plugins.registry import load_estimator

TASK, ESTIMATOR = "umbmark-kinematic-calibrated", "cast-0"
WAYS: tuple[str | None, ...] = (None, "loky", "dask", "ray")
"""This machine's own worker processes, then backends."""


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield the CPU time of a row of a recorded episode in the parent: to plan, send, score and store it. Then of a job
    that gets and returns the observations of an episode, in the parent and in all processes, by one worker on this
    machine; Dask's parent has its scheduler in it too. Backends that are not installed are left out."""
    task = next(task for task in official_tasks() if task.name == TASK)
    episode = task.record(0)
    yield Figure("row of an episode, in the parent", 1e3 * _of_a_row(task, episode, effort.jobs), "ms")
    for way in WAYS:
        try:
            cluster = None if way is None else connect(way, None, 1)
        except InputError:
            continue
        name = way or "own worker processes"
        try:
            parent, everywhere = _of_a_job(cluster, observed_runs(episode), effort.jobs)
            yield Figure(f"job through {name}, in the parent", 1e3 * parent, "ms")
            yield Figure(f"job through {name}, in all processes", 1e3 * everywhere, "ms")
        finally:
            if cluster is not None:
                cluster.close()


def _of_a_job(cluster: Cluster | None, arguments: Any, jobs: int) -> tuple[float, float]:
    """Return the CPU time of a job that returns its arguments, s: in this process, and in all."""

    def spent() -> list[float]:
        """Return what this process, the cluster's worker and the job's process have taken."""
        agenda.append(Job(_spent, ()))
        inside = _value(next(outcomes))
        return [time.process_time(), 0.0 if cluster is None else cluster.submit(_spent).result(), inside]

    agenda = _Jobs()
    with closing(run_jobs(agenda, 1) if cluster is None else cluster.run_jobs(agenda)) as outcomes:
        before = spent()
        agenda += [Job(_given, (arguments,)) for _ in range(jobs)]
        for _ in range(jobs):
            _value(next(outcomes))
        took = [(end - begin) / jobs for begin, end in zip(before, spent(), strict=True)]
    return took[0], sum(took)


class _Jobs(list[Job]):
    """Jobs that are added while they run."""

    def next_job(self) -> Job | None:
        return self.pop(0) if self else None


def _value(ended: tuple[Job, Any]) -> Any:
    assert isinstance(ended[1], Done), ended[1]
    return ended[1].value


def _spent() -> float:
    return time.process_time()


def _given(value: Any) -> Any:
    return value


def _of_a_row(task: Task, episode: Episode, rows: int) -> float:
    """Return what a row costs this process, s, where its episode is stored already."""
    with tempfile.TemporaryDirectory() as folder:
        for case in range(rows):
            EpisodeStore(Path(folder)).save(task, case, episode)
        began = time.process_time()
        run([Assignment(task, tuple(range(rows)), (load_estimator(ESTIMATOR),))], Path(folder))
        return (time.process_time() - began) / rows


GROUP = Group("Past this process", figures)
