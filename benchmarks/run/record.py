"""The first stage of a run: record every episode that is needed and not there yet, in worker processes."""

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from benchmarks.progress import RunProgress
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.references import reference_store, save_references
from benchmarks.tasks.task import Case, Task
from castor_envs.errors import InputError
from castor_envs.processes import Done, InOrder, Job, Raised, run_jobs


def record_missing(
    results: Path, needed: Iterable[tuple[Task, Case]], processes: int, progress: RunProgress
) -> dict[str, str]:
    """Record and store episodes; returns, by name, what is wrong with the input of tasks that could not be recorded.

    Raises RuntimeError, with the traceback, if a task fails otherwise.
    """
    needed = list(needed)
    problems: dict[str, str] = {}
    progress.start("recording episodes", len(needed))
    jobs = InOrder(Job(record_episode, (results, task, case), (task, case)) for task, case in needed)
    with closing(run_jobs(jobs, processes)) as outcomes:
        for job, outcome in outcomes:
            task, case = job.subject
            match outcome:
                case Done(None):
                    pass
                case Done(str(problem)):
                    problems.setdefault(task.name, problem)
                case Raised() as raised:
                    raise raised.again(f"task {task.name}, case {case}: cannot be recorded")
                case _:
                    raise RuntimeError(f"task {task.name}, case {case}: cannot be recorded: {outcome}")
            progress.advance()
    return problems


def record_episode(results: Path, task: Task, case: Case) -> str | None:
    """Record and store the episode of a case, and its references; returns what is wrong with the task's input."""
    try:
        episode = task.record(case)
    except InputError as error:
        return str(error)
    EpisodeStore(results).save(task, case, episode)
    save_references(reference_store(results), task, case, episode)
    return None
