"""Tasks on a user's robot: the squares of the official tasks, on boards that never mix with the official ones."""

import re
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np

from castor_envs.errors import InputError
from castor_envs.motion.mobility import check_drivable
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import umbmark
from castor_envs.vehicles.load import Vehicle, load_vehicle
from castor_envs.vehicles.robot import RobotDescription

T = TypeVar("T", bound=Any)


@dataclass(frozen=True)
class OtherRobot:
    """A user's robot, for tasks in place of their official robot. label: its name on boards.

    The hash beside the label changes with every parameter, so that an edited file gets new boards.
    """

    label: str
    robot: RobotDescription

    @classmethod
    def load(cls, spec: str) -> "OtherRobot":
        """Return the robot of a preset's name or a robot file; raises InputError for trains and what cannot be read."""
        robot = load_vehicle(spec)
        stem = re.split(r"[/\\]", spec)[-1].removesuffix(".json")
        # Names that begin with a dot are those of temporary files.
        label = re.sub(r"[^A-Za-z0-9_.-]", "_", stem).lstrip(".") or "robot"
        return cls(label, single_robot(robot, f"--robot {spec}"))

    @property
    def key(self) -> str:
        """Label and hash, which distinguish its boards from those of other robots; safe in a path."""
        return f"{self.label}@{self.robot.hash()}"

    def of(self, task: T, **changes: Any) -> T:
        """Return an official task on this robot; `changes`: further fields that differ, such as ``missing``."""
        return replace(
            task,
            name=f"{task.name}[{self.key}]",
            title=f"{task.title}: {self.label} (not official)",
            robot=self.robot,
            **changes,
        )


def single_robot(vehicle: Vehicle, source: str) -> RobotDescription:
    """Return a vehicle that is a single robot; raises InputError for a train."""
    if not isinstance(vehicle, RobotDescription):
        raise InputError(f"{source}: is a train, and squares are driven by single robots")
    return vehicle


class TaskName(NamedTuple):
    """A task's name in its parts.

    robot: label and hash of a user's robot, None on the task's own robot. source: hash of the file of a task of others,
    None of official tasks.
    """

    official: str
    robot: str | None
    source: str | None

    @classmethod
    def of(cls, name: str) -> "TaskName":
        """Return the parts of a name."""
        official, _, beside = name.partition("[")
        beside = beside.removesuffix("]")
        return cls(official, beside, None) if "@" in beside else cls(official, None, beside or None)


@cache
def cannot_roll_square(robot: RobotDescription) -> str | None:
    """Return why a robot cannot drive the square of UMBmark and turn at its corners without slip, None if it can."""
    square = umbmark("ccw")
    try:
        rolled = roll(robot, square)
        check_drivable(robot, square)
    except InputError as error:
        return str(error)
    needed = float(np.max(np.abs(np.diff(rolled.wheel_angle, axis=0)))) / robot.sample_period
    if needed > robot.max_wheel_speed:
        return (
            f"robot {robot.name!r} is too slow: its wheels reach {robot.max_wheel_speed:g} rad/s, and the square asks "
            f"for {needed:.3g}"
        )
    return None


def cannot_roll_as_described(robot: RobotDescription) -> str | None:
    """Return why a robot cannot drive the square of UMBmark in perfect rolling, as its file says; None if it can."""
    if robot.effects:
        names = ", ".join(effect.name for effect in robot.effects)
        return f"robot {robot.name!r} has effects ({names}), and perfect rolling knows none; leave them out"
    return cannot_roll_square(robot)
