"""The first stage of a run: record every episode that is needed and not there yet, in worker processes."""

import tempfile
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from benchmarks.progress import RunProgress
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.references import reference_store, save_references
from benchmarks.run.clusters import Cluster
from benchmarks.tasks.task import Case, Task
from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.processes import Done, InOrder, Job, Raised, run_jobs


def record_missing(
    results: Path,
    needed: Iterable[tuple[Task, Case]],
    processes: int,
    progress: RunProgress,
    cluster: Cluster | None = None,
) -> dict[str, dict[Case, str]]:
    """Record and store episodes; returns, by task, what is wrong with the input of cases that could not be recorded.

    On a cluster, but for tasks on measured data, which are on this machine.

    Raises RuntimeError, with the traceback, if a task fails otherwise.
    """
    needed = list(needed)
    problems: dict[str, dict[Case, str]] = {}
    progress.start("recording episodes", len(needed))
    sent = [one for one in needed if cluster is not None and getattr(one[0], "data", None) is None]
    here = [one for one in needed if one not in sent]
    recorded = [run_jobs(InOrder(Job(record_episode, (results, *one), one) for one in here), processes)]
    if cluster is not None:
        recorded.append(cluster.run_jobs(InOrder(Job(record_files, one, one) for one in sent)))
    for part in recorded:
        with closing(part) as outcomes:
            for job, outcome in outcomes:
                task, case = job.subject
                match outcome:
                    case Done(None):
                        pass
                    case Done(str(problem)):
                        problems.setdefault(task.name, {})[case] = problem
                    case Done(dict(files)):
                        for name, content in files.items():
                            write_atomically(results / name, content)
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


def record_files(task: Task, case: Case) -> dict[str, bytes] | str:
    """Return the files of `record_episode` by their paths in a results folder, or what is wrong with the input."""
    with tempfile.TemporaryDirectory() as folder:
        problem = record_episode(Path(folder), task, case)
        files = (path for path in Path(folder).rglob("*") if path.is_file())
        return problem or {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
