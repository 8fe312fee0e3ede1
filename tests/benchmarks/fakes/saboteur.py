"""An estimator for tests that changes the process it runs in, to the harm of whoever runs there next."""

import os

import numpy as np


class Saboteur:
    def reset(self, robot, pose):
        self.pose = np.array(pose)
        np.cos = np.sin
        os.chdir("/")

    def update(self, observation):
        return self.pose


class Unspeakable(Saboteur):
    def reset(self, robot, pose):
        class RudeError(RuntimeError):
            def __str__(self):
                raise RuntimeError

        raise RudeError


class Surrogate(Saboteur):
    def reset(self, robot, pose):
        raise RuntimeError("\ud800 \x1b[31m")
