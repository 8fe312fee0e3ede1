"""The commands that repeat what a page shows."""

import shlex
from collections.abc import Mapping

from benchmarks.tasks.other_robots import TaskName
from castor_envs.errors import InputError
from estimators.plugins.registry import load_calibration, load_estimator


def run_command(task: str, estimator: str | None = None, of_methods: bool = False, spec: str | None = None) -> str:
    """Return the line that computes a task's rows, of one estimator or method or of all. spec: as in `place_note`."""
    return shlex.join(["castor-bench", "run", *_task(task), *_competitor(estimator, of_methods, spec)])


def show_command(task: str, case: object, specs: Mapping[str, str | None], of_methods: bool = False) -> str:
    """Return the line that shows one case. specs: of estimators or methods by name, as in `place_note`."""
    named = [word for name, spec in specs.items() for word in _competitor(name, of_methods, spec)]
    return shlex.join(["castor-bench", "show", *_task(task), "--case", str(case), *named])


def place_note(estimator: str, of_methods: bool = False, spec: str | None = None) -> str | None:
    """Say from where a command names the file of an estimator or method; None where it names no file.

    spec: what named it in the run that computed its rows, as far as that is known.
    """
    _, shown = _competitor(estimator, of_methods, spec)
    if ".py" not in shown.partition("?")[0]:
        return None
    if spec is not None:
        return "Files are named from the folder in which the run was made."
    return "In which folder this file was when the run was made is not stored: put its path there."


def _task(name: str) -> list[str]:
    """Return the options that name a task; that of a file of others, or on a user's robot, needs the file."""
    official, other = TaskName.of(name)
    if other is None:
        return ["--task", official]
    if "@" in other:
        return ["--task", official, "--robot", f"{other.rpartition('@')[0]}.json"]
    return ["--task", f"{official}.py"]


def _competitor(name: str | None, of_methods: bool, spec: str | None = None) -> list[str]:
    """Return the options that name an estimator or a method: by its spec where that is known.

    Else one that is not found by its name is taken to stand in a file.
    """
    if name is None:
        return []
    option, load = ("--method", load_calibration) if of_methods else ("--estimator", load_estimator)
    if spec is not None:
        return [option, spec]
    guess = name.removesuffix(" (smoother)")
    try:
        if ":" not in guess:
            load(guess)
            return [option, guess]
    except InputError:
        pass
    file, colon, kind = guess.partition(":")
    return [option, f"{file}.py:{kind}" if colon else guess]
