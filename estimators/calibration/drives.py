"""Drives that may be proposed for a robot, simple ones first, and the logs that it would record on them."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory, pivoting, umbmark, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.robot import RobotDescription
from estimators.likelihood.log_likelihood import Noise

TYPICAL = Noise(along=1e-3, across=1e-3, position=2e-3, heading=5e-3)
"""Noise that is assumed of proposed drives."""

Poses = Literal["none", "ends", "all"]

REFERENCE: dict[Poses, str] = {
    "none": "without reference poses",
    "ends": "with reference poses at start and end",
    "all": "with reference poses throughout",
}
"""Where poses are taken, in words."""


def log_of(robot: RobotDescription, trajectory: Trajectory, poses: Poses) -> Log:
    """Return the log of a robot that rolls perfectly along a trajectory."""
    return logged(robot, roll(robot, trajectory), poses)


def logged(robot: RobotDescription, rolled: Rolled, poses: Poses) -> Log:
    """Return the log of a robot that has rolled perfectly; a gyro, if it has one, reads its turning and its bias."""
    geometry = Geometry.of(robot)
    encoders = Encoders(geometry, np.zeros(len(robot.driven_wheels)))
    reference = np.full((len(rolled.t), 3), np.nan)
    rows = {"none": [], "ends": [0, -1], "all": slice(None)}[poses]
    reference[rows] = rolled.pose[rows]
    gyro = None if robot.gyro is None else robot.gyro.bias + np.gradient(rolled.pose[:, 2], rolled.t)
    wheel, pivot = encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle)
    return Log(rolled.t, wheel, pivot, reference=reference, gyro=gyro)


def _straight(_: RobotDescription) -> list[Trajectory]:
    return [Trajectory("a straight line", (Run((Leg((1.0, 0.0, 0.0), 2.0),), 0.25, 0.5),))]


def _turns(_: RobotDescription) -> list[Trajectory]:
    return [pivoting((0.0, 0.0), way) for way in ("cw", "ccw")]


def _squares(_: RobotDescription) -> list[Trajectory]:
    return [umbmark(way) for way in ("cw", "ccw")]


def _about_castors(robot: RobotDescription) -> list[Trajectory]:
    return [pivoting(castor.pivot, way) for castor in robot.castors for way in ("cw", "ccw")]


def _random_path(robot: RobotDescription) -> list[Trajectory]:
    return [wander(np.random.default_rng(0), holonomic=moves_sideways(robot))]


DRIVES: dict[str, Callable[[RobotDescription], list[Trajectory]]] = {
    "a straight line of 2 m": _straight,
    "a turn on the spot, both ways,": _turns,
    "squares of 1.5 m, both ways,": _squares,
    "turns about each castor, both ways,": _about_castors,
    "a random path of 60 s": _random_path,
}
"""Names of drives, and functions that return a drive for a robot; these raise InputError where the robot cannot drive
it."""
