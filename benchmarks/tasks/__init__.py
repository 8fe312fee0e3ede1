"""The official tasks. Each module here offers ``tasks(measured)``; a new task is a new module, found by itself."""

import importlib
import pkgutil
from collections.abc import Sequence
from pathlib import Path

from benchmarks.task import Task
from castor_envs.errors import InputError, did_you_mean


def official_tasks(measured: Path | None = None) -> tuple[Task, ...]:
    """Return all tasks, module by module in alphabetical order.

    measured: the folder with measured data, or None; tasks on measured data say in `missing` what they lack.
    """
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return tuple(task for name in modules for task in importlib.import_module(f"{__name__}.{name}").tasks(measured))


def select_tasks(tasks: Sequence[Task], names: Sequence[str]) -> tuple[Task, ...]:
    """Return the named tasks, or all if there are no names; raises InputError for an unknown name."""
    known = {task.name: task for task in tasks}
    for name in names:
        if name not in known:
            raise InputError(f"unknown task {name!r}{did_you_mean(name, known)}")
    return tuple(tasks) if not names else tuple(known[name] for name in dict.fromkeys(names))
