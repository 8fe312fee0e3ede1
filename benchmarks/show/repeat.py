"""The commands that repeat what a page shows.

A task is given by its name, one of a file of others by its spec where that is known. robot: what named the robot of
tasks on another one; where that is not known, a label that is a preset of the same robot, else a file of that name.
Tasks on measured data need the folder `DIR` that holds them. specs: of estimators or methods by name, each as in
`place_note`.
"""

import shlex
from collections.abc import Mapping
from functools import cache

from benchmarks.tasks import official_tasks
from benchmarks.tasks.other_robots import OtherRobot, TaskName
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import preset_names
from estimators.plugins.registry import load_calibration, load_estimator


def run_command(task: str, estimator: str | None = None, of_methods: bool = False, spec: str | None = None) -> str:
    """Return the line that computes a task's rows, of one estimator or method or of all."""
    return shlex.join(["castor-bench", "run", *_task(task), *_competitor(estimator, of_methods, spec)])


def show_command(
    task: str, case: object, specs: Mapping[str, str | None], of_methods: bool = False, robot: str | None = None
) -> str:
    """Return the line that shows one case."""
    return shlex.join(
        ["castor-bench", "show", *_task(task, robot), "--case", str(case), *_competitors(specs, of_methods)]
    )


def show_log_command(log: str, robot: str, floor: str | None, specs: Mapping[str, str | None]) -> str:
    """Return the line that shows a log. robot and floor: what named them."""
    on = [] if floor is None else ["--floor", floor]
    return shlex.join(["castor-bench", "show", log, "--robot", robot, *on, *_competitors(specs)])


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


def _task(name: str, robot: str | None = None) -> list[str]:
    """Return the options that name a task; that of a file of others, or on a user's robot, needs the file."""
    official, on, source = TaskName.of(name)
    if source is not None:
        return ["--task", f"{official}.py"]
    if on is None:
        return ["--task", official, *(["--measured", "DIR"] if official in _measured() else [])]
    return ["--task", official, "--robot", robot or _robot(on)]


@cache
def _measured() -> frozenset[str]:
    """Return the names of the tasks on measured data."""
    return frozenset(task.name for task in official_tasks() if task.missing is not None)


def _robot(key: str) -> str:
    """Return the preset that a robot's label and hash say, or else the file that it may have come from."""
    label = key.rpartition("@")[0]
    return label if label in preset_names() and OtherRobot.load(label).key == key else f"{label}.json"


def _competitors(specs: Mapping[str, str | None], of_methods: bool = False) -> list[str]:
    """Return the options that name some."""
    return [word for name, spec in specs.items() for word in _competitor(name, of_methods, spec)]


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
