"""The commands that repeat what a page shows."""

import shlex

from benchmarks.tasks.other_robots import TaskName
from castor_envs.errors import InputError
from estimators.plugins.registry import load_calibration, load_estimator


def run_command(task: str, estimator: str | None = None, of_methods: bool = False) -> str:
    """Return the line that computes a task's rows, of one estimator or method or of all."""
    return shlex.join(["castor-bench", "run", *_task(task), *_competitor(estimator, of_methods)])


def show_command(task: str, case: object, estimators: tuple[str, ...], of_methods: bool = False) -> str:
    """Return the line that shows one case."""
    named = [word for estimator in estimators for word in _competitor(estimator, of_methods)]
    return shlex.join(["castor-bench", "show", *_task(task), "--case", str(case), *named])


def _task(name: str) -> list[str]:
    """Return the options that name a task; that of a file of others, or on a user's robot, needs the file."""
    official, other = TaskName.of(name)
    if other is None:
        return ["--task", official]
    if "@" in other:
        return ["--task", official, "--robot", f"{other.rpartition('@')[0]}.json"]
    return ["--task", f"{official}.py"]


def _competitor(name: str | None, of_methods: bool) -> list[str]:
    """Return the options that name an estimator or a method; one that is not found by its name stands in a file."""
    if name is None:
        return []
    option, load = ("--method", load_calibration) if of_methods else ("--estimator", load_estimator)
    spec = name.removesuffix(" (smoother)")
    try:
        if ":" not in spec:
            load(spec)
            return [option, spec]
    except InputError:
        pass
    file, colon, kind = spec.partition(":")
    return [option, f"{file}.py:{kind}" if colon else spec]
