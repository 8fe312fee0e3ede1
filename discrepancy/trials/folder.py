"""The folder of a trial: its settings and numbered cases, and the processes that do missing cases.

Files that are there already are kept, so a trial that was interrupted continues.
"""

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np  # noqa: F401  # and with it linear algebra, before its threads are limited
from threadpoolctl import threadpool_limits

from castor_envs.errors import InputError
from castor_envs.files import read_json, remove_leftovers, write_json
from castor_envs.processes import Done, Job, Raised, run_jobs

Task = tuple[Callable[..., None], tuple[Any, ...]]
"""A function and its arguments."""


def begin(folder: Path, asked: dict[str, Any], parts: Sequence[str]) -> None:
    """Write the settings of a trial to its folder, with these subfolders; the number of cases may change.

    Raises InputError for a folder that holds another trial.
    """
    path = folder / "trial.json"
    if path.exists() and {**(stored := read_json(path)), "cases": 0} != {**asked, "cases": 0}:
        raise InputError(f"{folder}: holds another trial, {stored}; give another folder")
    for part in parts:
        (folder / part).mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder / part)
    write_json(path, asked)


def asked_of(folder: Path) -> dict[str, Any]:
    """Return the settings of a trial; raises InputError for a folder that holds none."""
    path = folder / "trial.json"
    if not path.exists():
        raise InputError(f"{path}: no trial there; make one first")
    return read_json(path)


def name_of(number: int) -> str:
    """Return the name of a case in all subfolders."""
    return f"case-{number:04}"


def do_all(tasks: Sequence[Task], jobs: int | None) -> None:
    """Do all tasks, `jobs` at a time (None: as many as there are processors), in new processes."""
    if not tasks:
        return
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    with closing(run_jobs(_InOrder(tasks), jobs)) as outcomes:
        for job, outcome in outcomes:
            match outcome:
                case Done():
                    pass
                case Raised() as raised:
                    raise raised.again(f"trial, {job.subject}")
                case _:
                    raise RuntimeError(f"trial, {job.subject}: {outcome}")


class _InOrder:
    """Tasks known from the start, one after another."""

    def __init__(self, tasks: Sequence[Task]):
        self._jobs = iter([Job(_in_one_thread, task, task[0].__name__.strip("_")) for task in tasks])

    def next_job(self) -> Job | None:
        return next(self._jobs, None)


def _in_one_thread(work: Callable[..., None], given: tuple[Any, ...]) -> None:
    """Do a task; linear algebra of this process uses one thread from then on."""
    threadpool_limits(1)
    work(*given)
