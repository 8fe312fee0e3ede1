"""Estimators for tests that fail, each in its own way; before sample 7 they return the start pose."""

import gc
import os
import sys
import time

import numpy as np

from castor_envs.errors import Declined
from castor_envs.processes import MOST_MEMORY


class Good:
    def reset(self, robot, pose):
        self.pose, self.k = np.array(pose), -1

    def update(self, observation):
        self.k += 1
        return self.fail() if self.k == 7 else self.pose

    def fail(self) -> object:
        return self.pose


class Raises(Good):
    def fail(self):
        raise ValueError("no idea\nwhere I am")


class ReturnsNaN(Good):
    def fail(self):
        return np.array([0.0, np.nan, 0.0])


class WrongShape(Good):
    def fail(self):
        return np.zeros(2)


class ReturnsNothing(Good):
    def fail(self):
        return None


class ReturnsText(Good):
    def fail(self):
        return "lost"


class ReturnsComplex(Good):
    def fail(self):
        return self.pose + 5j


class ReturnsDigits(Good):
    def fail(self):
        return np.array(["1", "2", "3"])


class Interrupts(Good):
    def fail(self):
        raise KeyboardInterrupt


class Overflows(Good):
    def update(self, observation):
        return np.full(3, 1e300)


class Exits(Good):
    def fail(self):
        sys.exit(0)


class Dies(Good):
    def fail(self):
        os._exit(0)


class Hangs(Good):
    def fail(self):
        time.sleep(1000)


class HangsInReset(Good):
    def reset(self, robot, pose):
        while True:
            pass


class Beats(Good):
    """Hangs, and shows that it still runs by making a file longer."""

    def fail(self):
        with open(os.environ["HEARTBEAT"], "ab", buffering=0) as file:
            while True:
                file.write(b".")
                time.sleep(0.01)


class Refuses(Good):
    def reset(self, robot, pose):
        raise Declined("needs six legs")


class RaisesInReset(Good):
    def reset(self, robot, pose):
        super().reset(robot, np.zeros((2, 2)) + np.zeros(3))


class Forks(Good):
    """Forks in an update; what comes of it goes on as if it were the worker."""

    def fail(self):
        os.fork()
        return self.pose


class TakesMemory(Good):
    def fail(self):
        return bytearray(MOST_MEMORY)


class Prints(Good):
    def fail(self):
        while True:
            sys.stderr.write("here I am\n" * 1000)


class CannotBeMade(Good):
    def __init__(self):
        raise RuntimeError("no")


class LooksForTruth(Good):
    """Raises if there is a log, a run or an episode anywhere in its process."""

    def fail(self):
        kinds = {"Log", "Run", "Episode"}
        found = {type(item).__name__ for item in gc.get_objects()} & kinds
        if found:
            raise RuntimeError(f"found {found}")
        return self.pose
