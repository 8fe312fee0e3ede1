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


class Straightens(Started):
    """Believes a start that is said to be exact; of another it keeps the front axle, and puts the others behind it."""

    def reset(self, robot, pose, covariance=None):
        super().reset(robot, pose, covariance)
        self._believed = not self.covariance.any()
        self._straight = np.array(pose)
        behind = np.cumsum([0.0, *(frame.length for frame in robot.frames)])
        x, y, psi = self._straight[0]
        self._straight[:] = np.column_stack(
            [x - np.cos(psi) * behind, y - np.sin(psi) * behind, np.full(len(behind), psi)]
        )

    def update(self, observation):
        return super().update(observation) if self._believed else self._straight
