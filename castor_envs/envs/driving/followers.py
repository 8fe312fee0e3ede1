"""Followers: scripted drivers that see what agents of the tracking environments see, and correct what goes wrong.

They are the baseline of policies, and what a policy may correct (`control="residual"`). They keep no state: what motors
are told is a function of the newest observation. One of several vehicles of a kind takes arrays with a leading axis.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array, Numbers, vectors
from castor_envs.geometry.se2 import rotate
from castor_envs.motion.controllers import ALONG, KinematicController, axle_wheel_rates, posture_correction
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

MOST = (0.25, 0.25, 0.5)
"""By how much policies may correct a twist: m/s ahead, m/s to the left, rad/s. The speed of the named courses, and the
rate of turning at which a wheel half a metre from the origin has it."""


class Follower(ABC):
    """A scripted driver: from an observation (the Dict of the tracking environments) to what motors are to do.

    fastest: the motors' greatest speeds (..., m), rad/s: of driven wheels, of which there are `wheels`, then of
    castors. corrections (n,): the numbers of its twists that a vehicle can choose, by their places in these, flat.
    """

    def __init__(self, wheel_speeds: Array, castor_speeds: Array, corrections: NDArray[np.bool_]) -> None:
        self.wheels, self.fastest = wheel_speeds.shape[-1], np.concatenate([wheel_speeds, castor_speeds], axis=-1)
        self.corrections = np.flatnonzero(corrections)
        self._most = np.resize(MOST, corrections.size)[self.corrections]

    @abstractmethod
    def twist(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the twist (..., 3), or the twists (..., N, 3) of a train's axles, for the next sample period."""

    @abstractmethod
    def motors(self, observation: Mapping[str, Numbers], twist: Array) -> Array:
        """Return the speeds (..., m) at which motors give a twist, (..., 3) or (..., N, 3), by rolling, rad/s."""

    def action(self, observation: Mapping[str, Numbers]) -> NDArray[np.float32]:
        """Return the action (m,) in [-1, 1] of the scripted driver where actions are speeds (`control="speed"`).

        Raises InputError for a vector of scaled numbers.
        """
        if not isinstance(observation, Mapping):
            raise InputError(
                "the scripted driver needs what is not scaled: give it env.unwrapped.unscaled, the same observation"
            )
        speeds = self.motors(observation, self.twist(observation))
        return np.clip(speeds / self.fastest, -1.0, 1.0).astype(np.float32)

    def corrected(self, observation: Mapping[str, Numbers], fraction: Array) -> Array:
        """Return the motors' speeds (..., m), rad/s, where a policy corrects twists by fractions (..., n) of `MOST`."""
        twist = self.twist(observation)
        twist.reshape(*fraction.shape[:-1], -1)[..., self.corrections] += self._most * fraction
        return np.clip(self.motors(observation, twist), -self.fastest, self.fastest)


class RobotFollower(Follower):
    """Drives a robot where its reference is: at the reference's twist, and back to it in proportion to the error.

    Robots that cannot move sideways steer back by the law of Kanayama et al. (1990), `posture_correction`. Motors get
    the speeds of perfect rolling (`KinematicController`).
    """

    def __init__(self, robot: RobotDescription | Sequence[RobotDescription]) -> None:
        self._controller, self._geometry = KinematicController(robot), Geometry.of(robot)
        one = isinstance(robot, RobotDescription)
        several = [robot] if one else robot
        self._sideways = moves_sideways(several[0])
        wheels = [np.full(len(each.driven_wheels), each.max_wheel_speed) for each in several]
        castors = [np.full(len(each.driven_castors), each.max_steering_speed) for each in several]
        speeds = (wheels[0], castors[0]) if one else (np.stack(wheels), np.stack(castors))
        super().__init__(*speeds, np.array([True, self._sideways, True]))

    def twist(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the twist (..., 3) in B for the next sample period."""
        error, reference = observation["reference"][..., :3], observation["reference_twist"]
        if not self._sideways:
            ahead, turning = posture_correction(reference[..., 0], error)
            forward = reference[..., 0] * np.cos(error[..., 2]) + ahead
            return vectors(forward, np.zeros_like(forward), reference[..., 2] + turning)
        along = rotate(reference[..., :2], error[..., 2]) + ALONG * error[..., :2]
        return vectors(along[..., 0], along[..., 1], reference[..., 2] + ALONG * error[..., 2])

    def motors(self, observation: Mapping[str, Numbers], twist: Array) -> Array:
        """Return the speeds of driven wheels, then of driven castors, rad/s, at a twist (..., 3)."""
        theta = castor_angles(self._geometry, observation["pivot"])
        return np.concatenate(self._controller.commands(theta, twist), axis=-1)


class TrainFollower(Follower):
    """Drives each axle of a train where its reference is, by the law of Kanayama et al. (1990)."""

    def __init__(self, train: TrainDescription | Sequence[TrainDescription]) -> None:
        one = isinstance(train, TrainDescription)
        modules = [module for each in ([train] if one else train) for module in each.modules]
        axles = (train if one else train[0]).n_axles
        self._geometry = Geometry.rolling(modules)
        speeds = np.repeat([module.max_wheel_speed for module in modules], 2)
        speeds = speeds if one else speeds.reshape(len(train), -1)
        super().__init__(speeds, speeds[..., :0], np.tile([True, False, True], axles))

    def twist(self, observation: Mapping[str, Numbers]) -> Array:
        """Return the axles' twists (..., N, 3) for the next sample period."""
        reference, places = observation["reference_twist"], observation["reference"]
        twist = reference.reshape(*reference.shape[:-1], -1, 3).copy()
        error, speed = places[..., : reference.shape[-1]].reshape(twist.shape), twist[..., 0].copy()
        ahead, turning = posture_correction(speed, error)
        twist[..., 0] = speed * np.cos(error[..., 2]) + ahead
        twist[..., 2] += turning
        return twist

    def motors(self, observation: Mapping[str, Numbers], twist: Array) -> Array:
        """Return the speeds of all wheels (..., 2N), axle by axle, rad/s, at the axles' twists (..., N, 3)."""
        return axle_wheel_rates(self._geometry, twist)
