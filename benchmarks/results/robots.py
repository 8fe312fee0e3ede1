"""Users' robots, on which the official tasks were run, kept beside their rows so that their boards can be shown again.

RESULTS/robots/<label>@<robot hash>.json
"""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.results.archives import CorruptFileError
from benchmarks.tasks import tasks_on
from benchmarks.tasks.other_robots import OtherRobot
from benchmarks.tasks.task import Task
from castor_envs.errors import InputError
from castor_envs.vehicles.robot import RobotDescription


def save_robot(results: Path, user_robot: OtherRobot) -> None:
    """Keep a robot in a results folder."""
    user_robot.robot.save(results / "robots" / f"{user_robot.key}.json")


def tasks_on_stored_robots(results: Path) -> tuple[tuple[Task, ...], tuple[CorruptFileError, ...]]:
    """Return the tasks on a folder's robots that have rows there, and the robot files that cannot be used."""
    tasks: list[Task] = []
    refused = []
    for path in sorted((results / "robots").glob("*@*.json")):
        if path.name.startswith("."):
            continue
        try:
            user_robot = OtherRobot(path.name.rpartition("@")[0], RobotDescription.load(path))
        except InputError:
            refused.append(CorruptFileError(path, "is damaged or incomplete"))
            continue
        if path.stem != user_robot.key:
            refused.append(CorruptFileError(path, "does not hold the robot that its name says"))
            continue
        tasks += [task for task in tasks_on(user_robot) if (results / "rows" / f"{task.name}@{task.version}").is_dir()]
    return tuple(tasks), tuple(refused)


def with_stored_robots(tasks: Sequence[Task], results: Path) -> tuple[Task, ...]:
    """Return tasks and, after them, those on a folder's robots; raises InputError for a robot file that is damaged."""
    on_stored, refused = tasks_on_stored_robots(results)
    if refused:
        raise InputError(f"{refused[0]}; castor-bench run --robot writes it again, or delete it")
    return (*tasks, *on_stored)
