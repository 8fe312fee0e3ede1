"""Estimators for tests that are given whole logs."""

import numpy as np

from estimators import Declined, TrainOdometry, WheelOdometry


class Whole:
    """Odometry over a whole log; its last pose is in `last`."""

    def estimate(self, robot, pose, observations):
        is_train = hasattr(robot, "modules")
        if not is_train and len(robot.castors) > 4:
            raise Declined("has too many castors")
        inner = TrainOdometry() if is_train else WheelOdometry()
        inner.reset(robot, pose)
        return np.array([inner.update(seen) for seen in observations])


class Both(Whole):
    """Also online, where it stays at the start: that is what it is judged by."""

    def reset(self, robot, pose):
        self.pose = np.array(pose)

    def update(self, observation):
        return self.pose


class Shortened(Whole):
    def estimate(self, robot, pose, observations):
        return super().estimate(robot, pose, observations)[1:]


class Spoils(Whole):
    def estimate(self, robot, pose, observations):
        poses = super().estimate(robot, pose, observations)
        observations.wheel[:] = 0.0
        return poses


class Backwards(Whole):
    def estimate(self, robot, pose, observations):
        return super().estimate(robot, pose, observations)[::-1]


class LosesItself(Whole):
    def estimate(self, robot, pose, observations):
        poses = super().estimate(robot, pose, observations)
        poses[5] = np.nan
        return poses
