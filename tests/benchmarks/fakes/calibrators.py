"""Calibration methods for tests: one that knows the truth, and some that fail, each in its own way."""

import dataclasses
import gc
import os
import time

from castor_envs.errors import Declined
from castor_envs.vehicles.presets import differential, preset
from castor_envs.vehicles.robot import RobotDescription


class Truth:
    """Returns the robot in the file that TRUE_ROBOT names; without it the differential preset."""

    def calibrate(self, robot, recordings):
        path = os.environ.get("TRUE_ROBOT")
        return differential() if path is None else RobotDescription.load(path)


class Raises:
    def calibrate(self, robot, recordings):
        raise RuntimeError("no\nidea")


class Refuses:
    def calibrate(self, robot, recordings):
        raise Declined("needs six legs")


class ReturnsText:
    def calibrate(self, robot, recordings):
        return "calibrated"


class OtherRobot:
    def calibrate(self, robot, recordings):
        return preset("3-castor")


class OtherEncoders:
    def calibrate(self, robot, recordings):
        (castor,) = robot.castors
        wheels = tuple(dataclasses.replace(wheel, counts_per_rev=7.0) for wheel in castor.wheels)
        return dataclasses.replace(robot, castors=(dataclasses.replace(castor, wheels=wheels),))


class Impossible:
    def calibrate(self, robot, recordings):
        object.__setattr__(robot.castors[0].wheels[0], "radius", -1.0)
        return robot


class Hangs:
    def calibrate(self, robot, recordings):
        time.sleep(1000)


class Dies:
    def calibrate(self, robot, recordings):
        os._exit(0)


class CannotBeMade:
    def __init__(self):
        raise RuntimeError("no")

    def calibrate(self, robot, recordings):
        return robot


class LooksForTruth:
    """Raises if there is a run or an episode anywhere in its process, or a robot other than the described one."""

    def calibrate(self, robot, recordings):
        found = {type(item).__name__ for item in gc.get_objects()} & {"Run", "Episode"}
        if found:
            raise RuntimeError(f"found {found}")
        return robot
