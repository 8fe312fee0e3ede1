"""A robot driven by hand: its twist is as wished, as far as its wheels allow."""

import numpy as np

from benchmarks.drive.vehicle import FASTEST, FASTEST_TURN, PART, HandDrivenEnv
from castor_envs.envs.sensed import SensedRobot
from castor_envs.errors import InputError
from castor_envs.floor import Floor, load_floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import KinematicController
from castor_envs.motion.mobility import Mobility
from castor_envs.vehicles.robot import RobotDescription


class HandDrivenRobot(HandDrivenEnv[SensedRobot]):
    """A robot that moves by a twist of at most `limits` (3,), m/s, m/s and rad/s.

    What its wheels do not allow is left out (`Mobility.nearest`). Raises InputError where they allow nothing.
    """

    def __init__(self, robot: RobotDescription, floor: Floor | str | None = None) -> None:
        super().__init__(SensedRobot(robot, load_floor(floor)))
        described: RobotDescription = self._sensed.described
        self._mobility = Mobility.of(described)
        if self._mobility.freedom == 0:
            raise InputError(f"robot {described.name!r}: its fixed wheels hold it; turn one or leave it out")
        self.sideways = self._mobility.omnidirectional
        self.limits = limits(described)
        self._controller = KinematicController(described)

    def _start(self) -> dict[str, Array]:
        robot = self._sensed.described
        self._sensed.reset(self.np_random, np.zeros(len(robot.castors)))
        return _named(np.zeros(len(robot.driven_wheels)), np.zeros(len(robot.driven_castors)))

    def _move(self, motion: Array) -> dict[str, Array]:
        commands = self._controller.commands(self._sensed.measured_castor_angles(), self._mobility.nearest(motion))
        self._sensed.advance(commands)
        return _named(*commands)


def _named(wheel: Array, steering: Array) -> dict[str, Array]:
    return {"command": wheel, "steering_command": steering}


def limits(robot: RobotDescription) -> Array:
    """Return how fast a robot is driven forward and sideways, m/s, and turned, rad/s: what its wheels reach easily."""
    rim = PART * robot.max_wheel_speed * min(robot.wheels[k].radius for k in robot.driven_wheels)
    reach = max(
        np.hypot(*castor.pivot) + castor.offset + max(abs(wheel.lateral) for wheel in castor.wheels)
        for castor in robot.castors
    )
    speed = min(FASTEST, rim)
    return np.array([speed, speed, min(FASTEST_TURN, rim / max(float(reach), 1e-3))])
