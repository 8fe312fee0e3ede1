"""Mean of the modules: the odometry of swerve drives in ros2_controllers.

Its documentation, "Mobile Robot Kinematics", section Swerve Drive Robots, Odometry (doc/mobile_robot_kinematics.rst of
ros-controls/ros2_controllers), takes the body's velocity as the mean of those of the modules, and its yaw rate as

    omega = sum_i (l_ix v_iy - l_iy v_ix) / sum_i (l_ix^2 + l_iy^2)

with l_i where module i stands. Both are least squares where the modules' centre is the body's origin. The controller
that is proposed with it (pull request 1694) turns that velocity by the heading before the sample and adds it up.
"""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry, left_of
from castor_envs.vehicles.robot import RobotDescription
from estimators.peers.modules import Modules
from estimators.protocol import Observation
from estimators.steps.castor_odometry import displaced, start

CENTRED = 1e-3
"""m: how far the modules' centre may be from the body's origin."""


class ModuleMean:
    """The mean of the modules' velocities at the angles read last, stepped along the heading before the sample.

    When to use: to see what such a controller reports. First order in the sample period, twice: by the angles and by
    the heading. A wheel that slips moves the mean by its share.
    """

    batched = True

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises Declined for all but swerves whose modules are centred on the origin."""
        geometry, self._pose = start(robot, pose)
        self._modules, self._pivot = Modules(geometry, at=1.0), geometry.pivot
        if np.any(np.abs(geometry.pivot.mean(axis=-2)) > CENTRED):
            raise Declined("needs modules whose centre is the body's origin; the formula for omega holds only there")

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        path = self._modules.read(observation).path
        mean = path.mean(axis=-2)
        turn = np.sum(left_of(self._pivot) * path, axis=(-1, -2)) / np.sum(self._pivot**2, axis=(-1, -2))
        self._pose = displaced(self._pose, mean[..., 0], mean[..., 1], turn)
        return self._pose.copy()


ESTIMATORS = {"module-mean": ModuleMean}
