"""The folder of a trial: its settings, its numbered cases and the answers to them, made in separate processes.

    trial.json               settings
    cases/case-0001/         log.csv, holdout.csv and the vehicle's file, without effects: the files for the finder
    labels/case-0001.json    the hidden effects
    outcomes/posterior/      the finder's answers

Files that are there already are kept, so a trial that was interrupted continues. To judge the finder again, delete its
outcomes.
"""

import os
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np  # noqa: F401  # and with it linear algebra, before its threads are limited
from threadpoolctl import threadpool_limits

from castor_envs.errors import InputError
from castor_envs.files import read_json, remove_leftovers, write_json
from castor_envs.processes import Done, InOrder, Job, Raised, run_jobs
from discrepancy.trials.said import Said

Task = tuple[Callable[..., None], tuple[Any, ...]]
"""A function and its arguments."""

LOGS = ("log.csv", "holdout.csv")

FORMAT, FINDER = "castor-trial-case/2", "posterior"
"""Format of labels and answers, and the finder that answers."""


@dataclass(frozen=True)
class Settings:
    """The settings of a trial. robots: presets' names. duration: of each log, s."""

    cases: int
    seed: int
    generator: str
    robots: list[str]
    duration: float

    def beforehand(self, missing: Sequence[int], folder: Path) -> Sequence[Task]:
        """Return what must be made before missing cases can be judged."""
        return ()

    def make_case(self, number: int, folder: Path) -> dict[str, Any]:
        """Write the files of a case, and return its label."""
        raise NotImplementedError

    def together(self, number: int) -> str:
        """Return what cases share that are best judged one after another."""
        return ""

    def answer(self, name: str, folder: Path) -> Said:
        """Return the finder's answer on a case."""
        raise NotImplementedError


def make(plan: Settings, folder: str | os.PathLike[str], *, jobs: int | None = None) -> None:
    """Make the cases of a trial that are not there yet, `jobs` at a time (None: as many as there are processors), each
    in another process; their number may change.

    Raises InputError for a folder that holds another trial.
    """
    folder = Path(folder)
    path, asked = folder / "trial.json", asdict(plan)
    if path.exists() and {**(stored := read_json(path)), "cases": 0} != {**asked, "cases": 0}:
        raise InputError(f"{folder}: holds another trial, {stored}; give another folder")
    for part in ("cases", "labels", "outcomes"):
        (folder / part).mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder / part)
    write_json(path, asked)
    missing = [k for k in range(1, plan.cases + 1) if not label_file(folder, name_of(k)).exists()]
    do_all([*plan.beforehand(missing, folder), *((_make_case, (plan, k, folder)) for k in missing)], jobs)


def judge(plan: Settings, folder: str | os.PathLike[str], *, jobs: int | None = None) -> None:
    """Run the finder on every case that has no answer yet."""
    folder, outcomes = Path(folder), Path(folder) / "outcomes" / FINDER
    outcomes.mkdir(parents=True, exist_ok=True)
    remove_leftovers(outcomes)
    made = [k for k in range(1, plan.cases + 1) if label_file(folder, name_of(k)).exists()]
    missing = [k for k in made if not (outcomes / f"{name_of(k)}.json").exists()]
    do_all([(_judge_case, (plan, k, folder)) for k in sorted(missing, key=plan.together)], jobs)


def asked_of(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the settings of a trial; raises InputError for a folder that holds none."""
    path = Path(folder) / "trial.json"
    if not path.exists():
        raise InputError(f"{path}: no trial there; make one first")
    return read_json(path)


def judged(folder: str | os.PathLike[str]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Return labels and answers of all judged cases of a trial; raises InputError if there are none."""
    folder = Path(folder)
    paths = sorted((folder / "outcomes" / FINDER).glob("case-*.json"))
    if not paths:
        raise InputError(f"{folder}: the finder has no answers yet; judge the cases first")
    return [(read_json(label_file(folder, path.stem)), read_json(path)) for path in paths]


def name_of(number: int) -> str:
    """Return the name of a case in all subfolders."""
    return f"case-{number:04}"


def label_file(folder: Path, name: str) -> Path:
    """Return where a case's label is."""
    return folder / "labels" / f"{name}.json"


def _make_case(plan: Settings, number: int, folder: Path) -> None:
    started, name = time.process_time(), name_of(number)
    (folder / "cases" / name).mkdir(exist_ok=True)
    label = {"format": FORMAT, "case": number} | plan.make_case(number, folder)
    write_json(label_file(folder, name), label | {"seconds": time.process_time() - started})


def _judge_case(plan: Settings, number: int, folder: Path) -> None:
    started, name = time.process_time(), name_of(number)
    try:
        said = plan.answer(name, folder)
    except InputError as error:
        said = Said("refused", reason=str(error))
    except Exception:  # a finder that breaks fails its own case, no other
        said = Said("broken", reason=traceback.format_exc())
    head = {"format": FORMAT, "finder": FINDER, "case": number, "seconds": time.process_time() - started}
    write_json(folder / "outcomes" / FINDER / f"{name}.json", head | asdict(said))


def do_all(tasks: Sequence[Task], jobs: int | None) -> None:
    """Do all tasks, `jobs` at a time (None: as many as there are processors), in new processes."""
    if not tasks:
        return
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    listed = InOrder(Job(_in_one_thread, task, task[0].__name__.strip("_")) for task in tasks)
    with closing(run_jobs(listed, jobs)) as outcomes:
        for job, outcome in outcomes:
            match outcome:
                case Done():
                    pass
                case Raised() as raised:
                    raise raised.again(f"trial, {job.subject}")
                case _:
                    raise RuntimeError(f"trial, {job.subject}: {outcome}")


def _in_one_thread(work: Callable[..., None], given: tuple[Any, ...]) -> None:
    """Do a task; linear algebra of this process uses one thread from then on."""
    threadpool_limits(1)
    work(*given)
