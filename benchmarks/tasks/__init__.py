"""The official tasks: those that a module of this folder offers as ``tasks(measured)``. A new task is a new module."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.tasks.other_robots import OtherRobot, TaskName
from benchmarks.tasks.task import Task
from castor_envs.discovery import offers
from castor_envs.errors import InputError, did_you_mean


def official_tasks(measured: Path | None = None) -> tuple[Task, ...]:
    """Return all tasks, module by module in alphabetical order.

    measured: the folder with measured data, or None; tasks on measured data name in `missing` the data that they lack.
    """
    return tuple(task for tasks in offers(__name__, "tasks") for task in tasks(measured))


def tasks_on(user_robot: OtherRobot) -> tuple[Task, ...]:
    """Return the tasks on a user's robot: what modules of this folder offer as ``on_robot(user_robot)``."""
    return tuple(task for on_robot in offers(__name__, "on_robot") for task in on_robot(user_robot))


def select_tasks(tasks: Sequence[Task], names: Sequence[str], groups: Sequence[str] = ()) -> tuple[Task, ...]:
    """Return the named tasks and those of the named groups, or all if nothing is named.

    A task on another robot is also known by its official name, where no other task is. Raises InputError for an unknown
    name.
    """
    known = {task.name: task for task in tasks}
    for task in tasks:
        known.setdefault(TaskName.of(task.name).official, task)
    grouped = tasks_by_group(tasks)
    for name in names:
        if name not in known:
            meant = f"; --group {name} takes that group of tasks" if name in grouped else did_you_mean(name, known)
            raise InputError(f"unknown task {name!r}{meant}")
    for group in groups:
        if group not in grouped:
            raise InputError(f"unknown group of tasks {group!r}{did_you_mean(group, grouped)}")
    if not names and not groups:
        return tuple(tasks)
    chosen = [known[name] for name in names] + [task for group in groups for task in grouped[group]]
    return tuple({task.name: task for task in chosen}.values())


def tasks_by_group(tasks: Sequence[Task]) -> dict[str, list[Task]]:
    """Return tasks by their group, in the order of each group's first task."""
    grouped: dict[str, list[Task]] = {}
    for task in tasks:
        grouped.setdefault(task.group, []).append(task)
    return grouped
