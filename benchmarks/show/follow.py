"""Estimators follow drives, and methods calibrate for them, in worker processes, as in a run of the benchmark."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace

from benchmarks.results.rows import DECLINED
from benchmarks.run.evaluate import Competitor, answered, owner_of
from benchmarks.run.worker_calibrate import Calibrated, calibrate_and_follow, observed_calibration
from benchmarks.run.worker_estimate import Estimate, Failure, estimate_singly
from benchmarks.show.drives import Drive
from benchmarks.tasks.task import Episode
from castor_envs.geometry.arrays import Array
from castor_envs.processes import InOrder, Job, run_jobs
from estimators.plugins.registry import CalibrationEntry

Answer = list[Estimate] | Calibrated | Failure


def follow(
    drives: Sequence[Drive],
    competitors: Sequence[Competitor],
    timeout: float,
    processes: int = 1,
    episode: Episode | None = None,
) -> dict[str, Answer]:
    """Return what each estimator or method made of all drives, by its name, or how it failed.

    timeout: s, for each of them. episode: that the drives are of, where methods calibrate.
    """
    jobs, answers = [], {}
    for entry in competitors:
        reason = entry.applicable(drives[0].vehicle)
        if reason is not None:
            answers[entry.name] = Failure(DECLINED + reason)
            continue
        runs = [drive.observed for drive in drives]
        if isinstance(entry, CalibrationEntry):
            assert episode is not None
            function, seen = calibrate_and_follow, replace(observed_calibration(episode), runs=runs)
        else:
            function, seen = estimate_singly, runs
        jobs.append(Job(function, (entry.spec, entry.source_hash, seen), entry, timeout, owner_of(entry)))
    with closing(run_jobs(InOrder(jobs), processes)) as outcomes:
        for job, outcome in outcomes:
            answers[job.subject.name] = answered(outcome, timeout, f"estimator {job.subject.name}")
    return {entry.name: answers[entry.name] for entry in competitors}


def failures(answers: Mapping[str, Answer]) -> dict[str, str]:
    """Return why estimators gave no poses, by name."""
    return {name: answer.reason for name, answer in answers.items() if isinstance(answer, Failure)}


def poses(answers: Mapping[str, Answer], k: int) -> dict[str, Array]:
    """Return the poses of drive k, by estimator."""
    found = {}
    for name, answer in answers.items():
        if isinstance(answer, Calibrated):
            found[name] = answer.estimates[k]
        elif not isinstance(answer, Failure):
            found[name] = answer[k].poses
    return found
