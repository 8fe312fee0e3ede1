"""Estimators for tests that say how sure they are, rightly or not."""

import numpy as np


class Unsure:
    """Stays at the start, 20 cm and 0.2 rad unsure; states so after the first sample."""

    covariance = np.diag([0.04, 0.04, 0.04])

    def reset(self, robot, pose):
        self.pose, self.status = np.array(pose), None

    def update(self, observation):
        if observation["time"] > 0:
            self.status = "I stand still"
        return self.pose


class OfOneNumber(Unsure):
    covariance = 0.01


class OfComplexNumbers(Unsure):
    covariance = np.diag([0.01, 0.01, 0.01]) + 1j


class Negative(Unsure):
    covariance = np.diag([0.01, -0.01, 0.01])


class Infinite(Unsure):
    covariance = np.diag([0.01, np.inf, 0.01])


class Lopsided(Unsure):
    covariance = np.array([[0.01, 0.005, 0], [0, 0.01, 0], [0, 0, 0.01]])


class OverCorrelated(Unsure):
    covariance = np.array([[0.01, 0.02, 0], [0.02, 0.01, 0], [0, 0, 0.01]])


class Sometimes(Unsure):
    """Gives a covariance at the start alone."""

    def update(self, observation):
        self.covariance = np.eye(3) if observation["time"] == 0 else None
        return self.pose


class StatesNumbers(Unsure):
    def update(self, observation):
        self.status = 7
        return self.pose
