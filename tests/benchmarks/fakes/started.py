"""Estimators for tests that want the covariance of their start."""

import numpy as np

from estimators import TrainOdometry, WheelOdometry


class Started:
    """Odometry; before the first update its covariance is that of the start, and stays so."""

    def reset(self, robot, pose, covariance=None):
        self.covariance = np.zeros((*np.shape(pose), 3)) if covariance is None else np.array(covariance)
        self._odometry = TrainOdometry() if hasattr(robot, "modules") else WheelOdometry()
        self._odometry.reset(robot, pose)

    def update(self, observation):
        return self._odometry.update(observation)


class Demanding:
    """Cannot do without."""

    def __init__(self):
        self._started = Started()

    def reset(self, robot, pose, covariance):
        self._started.reset(robot, pose, covariance)
        self.covariance = self._started.covariance

    def update(self, observation):
        return self._started.update(observation)


class Divides(Started):
    """Has not thought of a true start."""

    def reset(self, robot, pose, covariance=None):
        super().reset(robot, pose, covariance)
        if covariance is not None:
            np.linalg.inv(covariance)
