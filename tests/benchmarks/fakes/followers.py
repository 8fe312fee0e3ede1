"""Estimators for tests that work: dead reckoning of a differential robot."""

import time

import numpy as np

from castor_envs.motion.kinematics import Geometry


class Follower:
    batched = True

    def reset(self, robot, pose):
        geometry = Geometry.of(robot)
        self.roll = geometry.radius * 2 * np.pi / geometry.counts_per_rev
        self.track = geometry.lateral[..., 0] - geometry.lateral[..., 1]
        self.x, self.y, self.psi = pose[..., 0], pose[..., 1], pose[..., 2]

    def update(self, observation):
        rolled = self.roll * observation["wheel"]
        along, turn = rolled.mean(axis=-1), (rolled[..., 1] - rolled[..., 0]) / self.track
        self.x = self.x + along * np.cos(self.psi + turn / 2)
        self.y = self.y + along * np.sin(self.psi + turn / 2)
        self.psi = self.psi + turn
        return np.stack([self.x, self.y, self.psi], axis=-1)


class Single(Follower):
    batched = False


class Slow(Single):
    def reset(self, robot, pose):
        time.sleep(0.05)
        super().reset(robot, pose)


class Pretends(Follower):
    """Says that it is batched, and is not."""

    def update(self, observation):
        return super().update(observation).reshape(3)


class Remembers(Single):
    """Counts in its class how often it was reset, and believes wheels to be larger each time."""

    resets = 0

    def reset(self, robot, pose):
        super().reset(robot, pose)
        Remembers.resets += 1
        self.roll = self.roll * (1 + 0.01 * Remembers.resets)


class Guesses(Single):
    """Adds noise that no seed fixes."""

    def update(self, observation):
        return super().update(observation) + np.random.default_rng().normal(0, 0.01, 3)


class Rounds(Single):
    """Rounds otherwise each time, as sums in another order do."""

    def update(self, observation):
        return super().update(observation) + np.random.default_rng().normal(0, 1e-12, 3)


class Pauses(Single):
    """Computes for a millisecond in every tenth update."""

    def reset(self, robot, pose):
        super().reset(robot, pose)
        self.k = 0

    def update(self, observation):
        self.k += 1
        until = time.process_time() + 1e-3
        while self.k % 10 == 0 and time.process_time() < until:
            pass
        return super().update(observation)
