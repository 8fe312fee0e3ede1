"""The second stage of a run: estimators follow recorded episodes in worker processes; the parent scores and stores.

The workers get observations, the robot and the start pose; for calibration methods the recordings too. The truth stays
here.
"""

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.progress import RunProgress
from benchmarks.results.provenance import provenance
from benchmarks.results.rows import DECLINED, ResultsStore, Row
from benchmarks.run.clusters import Cluster
from benchmarks.run.worker_calibrate import Calibrated, calibrate_and_follow, observed_calibration
from benchmarks.run.worker_estimate import Estimate, Failure, estimate_singly, estimate_stacked, observed_runs
from benchmarks.scoring.registry import score
from benchmarks.tasks.task import Case, Episode, Task
from castor_envs.processes import Died, Done, Exceeded, Job, Outcome, Raised, TimedOut, run_jobs
from estimators.plugins.registry import CalibrationEntry, EstimatorEntry

MOST_TIMEOUTS = 3
"""After this many time-outs of an estimator in a task, its remaining episodes in that task are not tried."""

KILLED = "its process was killed from outside (signal 9), perhaps for want of memory; the next run tries again"
"""Reason of a failure that is none of the estimator's, so that the next run tries again."""

Competitor = EstimatorEntry | CalibrationEntry


@dataclass(frozen=True, eq=False)
class Work:
    """Cases of a task that an estimator is to follow in one job. stacked: as stacks of runs of one layout; else one
    case.

    A calibration method calibrates one case in a job, and the task's odometry follows its runs.
    """

    task: Task
    entry: Competitor
    episodes: dict[Case, Episode]
    stacked: bool

    @property
    def key(self) -> tuple[str, str, str]:
        """Task and estimator, to count by."""
        return self.task.name, self.entry.name, self.entry.source_hash


def owner_of(entry: Competitor, *job: object) -> tuple[object, ...] | str:
    """Return the owner of an estimator's code: a plug-in shares a worker process with no other code.

    job: what the process is to be for alone.
    """
    return "built in" if entry.builtin else (entry.spec, entry.source_hash, *job)


def answered(outcome: Outcome, timeout: float, doing: str) -> Any:
    """Return what an estimator's job returned, or how it failed within a time limit (s).

    Raises what the job raised, if that is no failure of the estimator's; `doing` then says what was going on.
    """
    match outcome:
        case Done(value):
            return value
        case TimedOut():
            return Failure(f"took over {timeout:g} s")
        case Died(exit_code) if exit_code == -9:
            return Failure(KILLED)
        case Died(exit_code):
            return Failure(f"ended its process (exit code {exit_code})")
        case Exceeded(excess):
            return Failure(excess)
        case Raised() as raised:
            raise raised.again(doing)


class Estimating:
    """Turns work into jobs and stores a row for each case, also where the job fails."""

    def __init__(self, works: Iterator[Work], rows: ResultsStore, timeout: float, progress: RunProgress):
        self._works = works
        self._rows = rows
        self._timeout = timeout
        self._progress = progress
        self._timeouts: Counter[tuple[str, str, str]] = Counter()
        self._again: deque[Work] = deque()

    def run(self, processes: int, cluster: Cluster | None = None) -> None:
        """Do all work, in processes of this machine or on a cluster."""
        with closing(run_jobs(self, processes) if cluster is None else cluster.run_jobs(self)) as outcomes:
            for job, outcome in outcomes:
                self._take(job.subject, outcome)

    def next_job(self) -> Job | None:
        """Return the job of the next work that can be tried; rows of work that cannot are stored as failed."""
        while True:
            work = self._again.popleft() if self._again else next(self._works, None)
            if work is None:
                return None
            reason = work.entry.applicable(next(iter(work.episodes.values())).robot)
            if reason is not None:
                self._store_all(work, Failure(DECLINED + reason))
            elif self._timeouts[work.key] >= MOST_TIMEOUTS:
                reason = f"not tried after {MOST_TIMEOUTS} episodes took over {self._timeout:g} s each"
                self._store_all(work, Failure(reason), timeout=self._timeout)
            else:
                return self._job(work)

    def _job(self, work: Work) -> Job:
        entry, episodes = work.entry, list(work.episodes.values())
        if isinstance(entry, CalibrationEntry):
            function, seen = calibrate_and_follow, observed_calibration(episodes[0])
        elif work.stacked:
            function, seen = estimate_stacked, [observed_runs(episode) for episode in episodes]
        else:
            function, seen = estimate_singly, observed_runs(episodes[0])
        return Job(function, (entry.spec, entry.source_hash, seen), work, self._limit(work), owner_of(entry))

    def _limit(self, work: Work) -> float:
        """Return how long a job may take, s: as long as its episodes one after another."""
        return self._timeout * len(work.episodes)

    def _take(self, work: Work, outcome: Outcome) -> None:
        """Store the outcome of a job; a stack that failed as a whole is tried again case by case."""
        answer = answered(outcome, self._limit(work), f"task {work.task.name}, estimator {work.entry.name}")
        if isinstance(outcome, Done) and not (work.stacked or isinstance(answer, Failure)):
            answer = [answer]
        if isinstance(answer, list):
            for (case, episode), result in zip(work.episodes.items(), answer, strict=True):
                self._store(work, case, episode, result)
        elif work.stacked and not answer.reason.startswith(DECLINED):
            self._progress.warn(
                f"{work.entry.name} on stacked runs of {work.task.name}: {answer.reason}; trying case by case"
            )
            for case, episode in work.episodes.items():
                self._again.append(Work(work.task, work.entry, {case: episode}, stacked=False))
        else:
            late = isinstance(outcome, TimedOut)
            self._timeouts[work.key] += late
            self._store_all(work, answer, self._timeout if late else None)

    def _store_all(self, work: Work, failure: Failure, timeout: float | None = None) -> None:
        for case, episode in work.episodes.items():
            self._store(work, case, episode, failure, timeout)

    def _store(
        self,
        work: Work,
        case: Case,
        episode: Episode,
        result: list[Estimate] | Calibrated | Failure,
        timeout: float | None = None,
    ) -> None:
        failure, calibrated, estimates, covariances, stated, scores = None, None, (), (), (), {}
        match result:
            case Failure(reason):
                failure = reason
            case Calibrated(calibrated, followed):
                estimates = tuple(followed)
            case _:
                estimates = tuple(estimate.poses for estimate in result)
                covariances = tuple(estimate.covariance for estimate in result)
                stated = tuple(estimate.stated for estimate in result)
        if failure is None:
            with np.errstate(all="ignore"):
                scores = score(episode, estimates, calibrated, covariances, stated)
            if work.task.metric not in scores:
                failure, scores, estimates = f"the runs of this episode give no {work.task.metric}", {}, ()
            elif not np.isfinite(scores[work.task.metric]):
                failure, scores, estimates = "returned poses too large to be scored", {}, ()
        row = Row(
            task=work.task.name,
            version=work.task.version,
            estimator=work.entry.name,
            source_hash=work.entry.source_hash,
            case=case,
            episode=episode.digest,
            robot_hash=episode.robot.hash(),
            failure=failure,
            timeout=timeout,
            scores={name: value for name, value in scores.items() if np.isfinite(value)},
            estimates=estimates,
            covariances=covariances if failure is None else (),
            stated=stated if failure is None else (),
            calibrated=calibrated if failure is None else None,
            origin=provenance(),
        )
        self._rows.save(row)
        self._progress.advance()
