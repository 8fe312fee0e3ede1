"""A robot in physics that moves as it is wished to: an environment without course or reward, to be recorded."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from castor_envs.envs.sensed import SensedRobot
from castor_envs.errors import InputError
from castor_envs.floor import Floor, load_floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import Commands, KinematicController
from castor_envs.motion.mobility import Mobility
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.robot import RobotDescription

FASTEST, FASTEST_TURN = 0.6, 1.5
"""m/s and rad/s: a slow walk, and a turn in four seconds; less where the wheels cannot."""
PART = 0.5
"""Of the wheels' fastest turning that a drive by hand uses, so that castors can swing beside it."""
RAMP = 0.5
"""s from rest to full speed."""
LONGEST = 3600.0
"""s that observations reach: an hour."""


class HandDrivenEnv(gym.Env[Observation, Array]):
    """A robot that starts at rest at the origin; the action (3,) is where it is to go, each part in [-1, 1].

    Parts: forward, to its left, turning left, of `limits` (3,), m/s and rad/s. What its wheels do not allow is left out
    (`Mobility.nearest`), and speeds change within `RAMP`.
    """

    def __init__(self, robot: RobotDescription | str, floor: Floor | str | None = None) -> None:
        self.floor = load_floor(floor)
        self._sensed = SensedRobot(load_robot(robot), self.floor)
        self.vehicle = self.robot = self._sensed.described
        self.mobility = Mobility.of(self.robot)
        if self.mobility.freedom == 0:
            raise InputError(f"robot {self.robot.name!r}: its fixed wheels hold it; turn one or leave it out")
        self._controller = KinematicController(self.robot)
        self.limits = limits(self.robot)
        self.observation_space = self._sensed.observation_space(LONGEST)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float64)
        self._twist = np.zeros(3)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the robot at the origin, at rest, its castors trailing for forward motion."""
        super().reset(seed=seed)
        self._sensed.reset(self.np_random, np.zeros(len(self.robot.castors)))
        self._twist = np.zeros(3)
        none = Commands(np.zeros(len(self.robot.driven_wheels)), np.zeros(len(self.robot.driven_castors)))
        return self._sensed.observation, self._info(none)

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for one sample period."""
        wished = np.clip(np.asarray(action, dtype=float), -1.0, 1.0) * self.limits
        most = self.limits * self.robot.sample_period / RAMP
        self._twist = self._twist + np.clip(wished - self._twist, -most, most)
        twist = self.mobility.nearest(self._twist)
        commands = self._controller.commands(self._sensed.measured_castor_angles(), twist)
        self._sensed.advance(commands)
        return self._sensed.observation, 0.0, False, False, self._info(commands)

    def stop(self) -> None:
        """Wish for rest at once, without a ramp: wheels slip where they have to."""
        self._twist = np.zeros(3)

    @property
    def pose(self) -> Array:
        """The true pose (3,)."""
        return self._sensed.pose

    @property
    def castor_angles(self) -> Array:
        """The true castor angles (n,), rad."""
        return self._sensed.shape

    def sliding(self) -> NDArray[np.bool_]:
        """Return which wheels (w,) slide."""
        return self._sensed.sliding()

    def reference(self, t: ArrayLike, pose: Array) -> Array:
        """Return what a tracker reports of true poses, for recorders."""
        return self._sensed.reference(t, pose)

    def _info(self, commands: Commands) -> dict[str, Any]:
        return {"pose": self._sensed.pose, "command": commands.wheel, "steering_command": commands.steering}


def limits(robot: RobotDescription) -> Array:
    """Return how fast a robot is driven forward and sideways, m/s, and turned, rad/s: what its wheels reach easily."""
    rim = PART * robot.max_wheel_speed * min(robot.wheels[k].radius for k in robot.driven_wheels)
    reach = max(
        np.hypot(*castor.pivot) + castor.offset + max(abs(wheel.lateral) for wheel in castor.wheels)
        for castor in robot.castors
    )
    speed = min(FASTEST, rim)
    return np.array([speed, speed, min(FASTEST_TURN, rim / max(float(reach), 1e-3))])
