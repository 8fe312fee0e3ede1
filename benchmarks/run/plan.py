"""The run: record the episodes that are needed, let estimators follow them, score, store, and time their updates.

Only what is missing is computed, so the next run continues a run that was stopped in any way.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from benchmarks.progress import RunProgress, SilentProgress
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.asked import Asked, keep_asked, shown_spec
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import provenance
from benchmarks.results.rows import (
    ResultsStore,
    RowSummary,
    check_results_folder,
    clean_results_folder,
    older_rows,
)
from benchmarks.run.clusters import Cluster
from benchmarks.run.evaluate import KILLED, Competitor, Estimating, Work, owner_of
from benchmarks.run.record import record_episode, record_missing
from benchmarks.run.worker_estimate import Timed, observed_runs, time_updates, update_cost
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks.task import Case, Episode, Task, odometry_of, source_of
from castor_envs.files import writing
from castor_envs.processes import Done, InOrder, Job, run_jobs
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.registry import CalibrationEntry

STACK = 50
"""Most cases of a task that are stacked for one batched estimator."""


@dataclass(frozen=True)
class Assignment:
    """A task, the cases of it to run, and the estimators, or calibration methods, to run on them."""

    task: Task
    cases: tuple[Case, ...]
    estimators: tuple[Competitor, ...]

    def __post_init__(self):
        judges_methods = odometry_of(self.task) is not None
        for entry in self.estimators:
            if isinstance(entry, CalibrationEntry) != judges_methods:
                judged = "calibration methods" if judges_methods else "estimators"
                raise ValueError(f"task {self.task.name} judges {judged}, and {entry.name!r} is none")


def run(
    plan: Sequence[Assignment],
    results: Path,
    processes: int = 1,
    timeout: float = 60.0,
    progress: RunProgress | None = None,
    cluster: Cluster | None = None,
) -> dict[str, str]:
    """Run what is missing of a plan into a results folder; returns why tasks, or cases of them, could not be run.

    timeout: s, for an estimator in one episode. A row that failed by a shorter time limit is tried again. cluster: what
    records and runs estimators instead of this machine's processes; what an update costs is measured here all the same.

    Raises InputError if the results folder cannot be one, RuntimeError if a task cannot record an episode.
    """
    check_results_folder(results)
    clean_results_folder(results)
    return _Run(results, processes, timeout, progress or SilentProgress(), cluster).run(plan)


class _Run:
    def __init__(self, results: Path, processes: int, timeout: float, progress: RunProgress, cluster: Cluster | None):
        self.results, self.processes, self.timeout, self.progress = results, processes, timeout, progress
        self.cluster = cluster
        self.episodes = EpisodeStore(results)
        self.rows = ResultsStore(results)
        self.found: dict[tuple, tuple[str, float | None] | None] = {}

    def run(self, plan: Sequence[Assignment]) -> dict[str, str]:
        for assignment in plan:
            if assignment.task.metric not in BOARD_METRICS:
                raise ValueError(f"task {assignment.task.name}: unknown metric {assignment.task.metric!r}")
            if not BOARD_METRICS[assignment.task.metric].ranks:
                raise ValueError(f"task {assignment.task.name}: {assignment.task.metric!r} is larger for who is better")
        with writing(f"--results {self.results}"):
            self.results.mkdir(parents=True, exist_ok=True)
        missing = {a.task.name: a.task.missing for a in plan if a.task.missing is not None}
        plan = [assignment for assignment in plan if assignment.task.name not in missing]
        needed = [(a.task, case) for a in plan for case in a.cases if self._to_record(a, case)]
        problems = record_missing(self.results, needed, self.processes, self.progress, self.cluster)
        unrecorded = {a.task.name: _unrecorded(a, of) for a in plan if (of := problems.get(a.task.name))}
        recorded = [replace(a, cases=tuple(c for c in a.cases if c not in problems.get(a.task.name, {}))) for a in plan]
        plan = [assignment for assignment in recorded if assignment.cases]
        for assignment in plan:
            self._keep_asked(assignment)
        lacking = [self._lacking(assignment) for assignment in plan]
        rows = sum(len(entries) for cases in lacking for entries in cases.values())
        self.progress.start("running estimators", rows)
        works = (
            work
            for assignment, cases in zip(plan, lacking, strict=True)
            for work in self._works(assignment.task, cases)
        )
        Estimating(works, self.rows, self.timeout, self.progress).run(self.processes, self.cluster)
        self._time(plan)
        for error in {error.path: error for error in self.rows.corrupt}.values():
            self.progress.warn(f"{error}; it has been computed again")
        if self.rows.older_formats:
            self.progress.warn(older_rows(self.rows.older_formats, self.rows.root, "have been computed again"))
        return {**missing, **unrecorded}

    def _keep_asked(self, assignment: Assignment) -> None:
        """Keep which versions of estimators are asked for, so that boards show these, computed now or before."""
        folder = self.rows.of_task(assignment.task.name, assignment.task.version)
        of = {entry.name: Asked(entry.source_hash, shown_spec(entry.spec)) for entry in assignment.estimators}
        with writing(f"--results {self.results}"):
            keep_asked(folder, of)

    def _to_record(self, assignment: Assignment, case: Case) -> bool:
        """Return whether a case's episode is needed and missing, or was recorded by another version of the world."""
        task = assignment.task
        try:
            stored = self.episodes.digest(task.name, task.version, case, source_of(task, case))
        except CorruptFileError as error:
            self.progress.warn(f"{error}; it is recorded again")
            return True
        outdated = stored is None and self.episodes.path(task.name, task.version, case).exists()
        return outdated or (
            stored is None and any(self._lacks(task, entry, case, None) for entry in assignment.estimators)
        )

    def _lacking(self, assignment: Assignment) -> dict[Case, list[Competitor]]:
        """Return the cases for which estimators have no row, with these estimators."""
        task, lacking = assignment.task, {}
        for case in assignment.cases:
            episode = self.episodes.digest(task.name, task.version, case)
            entries = [entry for entry in assignment.estimators if self._lacks(task, entry, case, episode)]
            if entries:
                lacking[case] = entries
        return lacking

    def _lacks(self, task: Task, entry: Competitor, case: Case, episode: str | None) -> bool:
        """Return whether a row is to be computed.

        That is missing, of another episode, stopped by a shorter time limit, or killed from outside.
        """
        key = (task.name, task.version, entry.name, entry.source_hash, case)
        if key not in self.found:
            row = self._stored(task).get(key[2:]) or self.rows.load(*key)
            usable = (
                row is not None and row.failure != KILLED and (row.failure is not None or task.metric in row.scores)
            )
            self.found[key] = (row.episode, row.timeout) if row is not None and usable else None
        found = self.found[key]
        if found is None or (episode is not None and found[0] != episode):
            return True
        return found[1] is not None and found[1] < self.timeout

    @cache  # noqa: B019 - as long as the run
    def _stored(self, task: Task) -> dict[tuple[str, str, Case], RowSummary]:
        """Return the rows of a task that are there when the run begins."""
        summaries = ResultsStore(self.results).summaries(task.name, task.version)
        return {(row.estimator, row.source_hash, row.case): row for row in summaries}

    def _works(self, task: Task, lacking: dict[Case, list[Competitor]]) -> Iterator[Work]:
        """Yield the work in a task, a few cases at a time so that few episodes are in memory at once."""
        cases = list(lacking)
        for batch in (cases[k : k + STACK] for k in range(0, len(cases), STACK)):
            episodes = {case: self._load(task, case) for case in batch}
            for entry in dict.fromkeys(entry for case in batch for entry in lacking[case]):
                batch_episodes = {case: episodes[case] for case in batch if entry in lacking[case]}
                # A train's poses (N, 3) look like those of a stack of N robots, so trains are not stacked.
                robots = all(isinstance(episode.robot, RobotDescription) for episode in batch_episodes.values())
                stacked = entry.batched and robots
                if stacked and entry.builtin:
                    yield Work(task, entry, batch_episodes, stacked=True)
                else:
                    # Robots of different cases are not stacked: an estimator could average their errors away.
                    for case in batch_episodes:
                        yield Work(task, entry, {case: batch_episodes[case]}, stacked=stacked)

    def _load(self, task: Task, case: Case) -> Episode:
        try:
            return self.episodes.load(task.name, task.version, case)
        except CorruptFileError as error:
            self.progress.warn(f"{error}; it is recorded again")
            record_episode(self.results, task, case)
            return self.episodes.load(task.name, task.version, case)

    def _time(self, plan: Sequence[Assignment]) -> None:
        """Measure what an update costs, for each estimator on the first run it can follow in a task."""
        timings = [of for a in plan for entry in a.estimators if (of := self._timing(a, entry))]
        self.progress.start("timing updates", len(timings))
        passes: dict[tuple[str, str, str], list[Timed | None]] = {}
        jobs = InOrder(job for of in timings for job in of)
        with closing(run_jobs(jobs, self.processes)) as outcomes:
            for job, outcome in outcomes:
                task, entry = job.subject
                timed = passes.setdefault((task.name, entry.name, entry.source_hash), [])
                timed.append(outcome.value if isinstance(outcome, Done) and isinstance(outcome.value, Timed) else None)
                if len(timed) < _passes(entry):
                    continue
                whole = [one for one in timed if one is not None]
                if len(whole) == len(timed):
                    cost = update_cost(whole)
                    self.rows.save_time(task.name, task.version, entry.name, entry.source_hash, cost, provenance())
                self.progress.advance()

    def _timing(self, assignment: Assignment, entry: Competitor) -> list[Job]:
        """Return the jobs that time an estimator in a task: of a plug-in in two processes that have followed nothing.

        In one, what it keeps of a run in the first pass would make the second look cheap.
        """
        task = assignment.task
        if isinstance(entry, CalibrationEntry):  # has no updates
            return []
        if self.rows.load_time(task.name, task.version, entry.name, entry.source_hash) is not None:
            return []
        for case in assignment.cases:
            row = self.rows.load(task.name, task.version, entry.name, entry.source_hash, case)
            if row is not None and row.failure is None and self.episodes.path(task.name, task.version, case).exists():
                runs = observed_runs(self._load(task, case))
                arguments = (entry.spec, entry.source_hash, runs, not entry.builtin)
                # More than the time limit of an episode: each run is followed twice, and afresh thrice.
                limit = (2 if entry.builtin else 3) * self.timeout
                return [
                    Job(time_updates, arguments, (task, entry), limit, owner_of(entry, task.name, k))
                    for k in range(_passes(entry))
                ]
        return []


def _passes(entry: Competitor) -> int:
    """Return in how many processes the updates of an estimator are timed."""
    return 1 if entry.builtin else 2


def _unrecorded(assignment: Assignment, problems: Mapping[Case, str]) -> str:
    """Return which part of a task's cases could not be recorded, and what is wrong with the first of these."""
    some = len(problems) < len(assignment.cases)
    part = f"{len(problems)} of {len(assignment.cases)} cases: " if some else ""
    return part + next(problems[case] for case in assignment.cases if case in problems)
