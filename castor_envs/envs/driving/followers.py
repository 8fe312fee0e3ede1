"""Followers: scripted drivers that see what agents of the tracking environments see, and correct what goes wrong.

What a driver without feedback is to the estimators' environments, these are to policies: the baseline to beat. They
keep no state: a command is a function of the newest observation.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array, Numbers
from castor_envs.geometry.se2 import rotate_single
from castor_envs.motion.controllers import ALONG, KinematicController, posture_correction
from castor_envs.motion.kinematics import Geometry, inverse, moves_sideways
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription


class Follower(ABC):
    """A scripted driver: from an observation (the Dict of the tracking environments) to what motors are to do.

    fastest: the motors' greatest speeds (m,), rad/s: of driven wheels, of which there are `wheels`, then of castors.
    """

    def __init__(self, wheel_speeds: Array, castor_speeds: Array) -> None:
        self.wheels, self.fastest = len(wheel_speeds), np.concatenate([wheel_speeds, castor_speeds])

    @abstractmethod
    def motors(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the motors' speeds (m,) for the next sample period, rad/s."""

    def action(self, observation: Mapping[str, Numbers]) -> NDArray[np.float32]:
        """Return the action (m,) in [-1, 1] that commands `motors` where actions are speeds (`control="speed"`)."""
        return np.clip(self.motors(observation) / self.fastest, -1.0, 1.0).astype(np.float32)


class RobotFollower(Follower):
    """Drives a robot where its reference is: at the reference's twist, and back to it in proportion to the error.

    Robots that cannot move sideways steer back by the law of Kanayama et al. (1990), `posture_correction`. Wheels get
    the speeds of perfect rolling (`KinematicController`).
    """

    def __init__(self, robot: RobotDescription) -> None:
        wheels, castors = len(robot.driven_wheels), len(robot.driven_castors)
        super().__init__(np.full(wheels, robot.max_wheel_speed), np.full(castors, robot.max_steering_speed))
        self._controller, self._geometry = KinematicController(robot), Geometry.of(robot)
        self._any_direction = moves_sideways(robot)

    def twist(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the twist (3,) in B that the robot is to have in the next sample period."""
        error, reference = observation["reference"][:3], observation["reference_twist"]
        if not self._any_direction:
            ahead, turning = posture_correction(reference[0], error)
            return np.array([reference[0] * np.cos(error[2]) + ahead, 0.0, reference[2] + turning])
        along = rotate_single(reference[:2], error[2]) + ALONG * error[:2]
        return np.array([*along, reference[2] + ALONG * error[2]])

    def motors(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the speeds of driven wheels, then of driven castors, rad/s."""
        theta = castor_angles(self._geometry, observation["pivot"])
        return np.concatenate(self._controller.commands(theta, self.twist(observation)))


class TrainFollower(Follower):
    """Drives each axle of a train where its reference is, by the law of Kanayama et al. (1990)."""

    def __init__(self, train: TrainDescription) -> None:
        super().__init__(np.repeat([module.max_wheel_speed for module in train.modules], 2), np.empty(0))
        self._geometry = [Geometry.of(module) for module in train.modules]

    def motors(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the speeds of all wheels (2N,), axle by axle, rad/s."""
        n = len(self._geometry)
        error = observation["reference"][: 3 * n].reshape(n, 3)
        twist = observation["reference_twist"].reshape(n, 3).copy()
        speed = twist[:, 0].copy()
        ahead, turning = posture_correction(speed, error)
        twist[:, 0] = speed * np.cos(error[:, 2]) + ahead
        twist[:, 2] += turning
        rates = [
            inverse(geometry, geometry.angle, np.zeros(1), of_axle).rate
            for geometry, of_axle in zip(self._geometry, twist, strict=True)
        ]
        return np.concatenate(rates)
