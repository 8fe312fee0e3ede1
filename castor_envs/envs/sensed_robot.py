"""A simulated robot as its sensors report it: what all environments share."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from castor_envs.effects import reader_of
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.kinematics import Geometry
from castor_envs.motion.controllers import Commands
from castor_envs.physics.robot_world import World
from castor_envs.physics.stepper import Drive
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.vehicles.robot import RobotDescription

Observation = dict[str, Array]


class SensedRobot:
    """A robot in a world, seen through its encoders (and gyro).

    robot: with its effects; `described` is what controllers and estimators may know. held: the castor (from 1) whose
    wheels are blocked. The state is made anew by `reset`. sensed_angles: of wheels (w,) and castors (n,), rad, as
    effects on sensors leave them for the encoders to round.
    """

    def __init__(self, robot: RobotDescription, floor: Floor, held: int | None = None) -> None:
        blind = [
            castor for castor in robot.castors if castor.steering != "fixed" and castor.pivot_counts_per_rev is None
        ]
        if blind:
            raise InputError(
                f"robot {robot.name!r}: the castor at {blind[0].pivot} turns but has no pivot encoder; "
                "give it pivot_counts_per_rev"
            )
        if not robot.driven_wheels:
            raise InputError(f"robot {robot.name!r} has no driven wheel; give one wheel counts_per_rev")
        self.robot, self.floor = robot, floor
        self.described = robot.as_described()
        self._held = held
        self.world = World(robot, floor, held=held)  # refuses what cannot stand or be computed; `reset` makes it anew
        self._built = Geometry.of(robot.as_built())
        self._believed = Geometry.of(self.described)

    def reset(self, random: np.random.Generator, theta: Array) -> None:
        """Put the robot at the origin, at rest, castors at theta (n,); encoder phases are drawn from `random`."""
        self._random = random
        self._encoders = Encoders(self._built, Encoders.random_phase(self._built, random))
        self._read = reader_of(self.robot)
        self.world = World(self.robot, self.floor, castor_angles=theta, held=self._held)
        self._counts: Array | None = None
        self._sense()

    def advance(self, commands: Commands, drive: Drive = "servo") -> None:
        """Drive for one sample period and read the sensors."""
        self.world.advance(commands.wheel, commands.steering, drive)
        self._sense()

    def _sense(self) -> None:
        world = self.world
        wheel, castor = self._read(np.array([world.time]), world.wheel_angles[None], world.castor_angles[None])
        self.sensed_angles = wheel[0], castor[0]
        counts = self._encoders.wheel(self.sensed_angles[0])
        self.observation: Observation = {
            "wheel": counts - (counts if self._counts is None else self._counts),
            "pivot": self._encoders.pivot(self.sensed_angles[1]),
            "time": np.array([self.world.time]),
        }
        self._counts = counts
        if self.robot.gyro is not None:
            noise = self.robot.gyro.noise * self._random.standard_normal()
            self.observation["gyro"] = np.array([self.world.twist[2] + self.robot.gyro.bias + noise])

    def measured_castor_angles(self) -> Array:
        """Theta (n,) as the robot believes it to be, from its pivot encoders."""
        return castor_angles(self._believed, self.observation["pivot"])

    def sliding(self) -> NDArray[np.bool_]:
        """Return which wheels (w,) slide: their force is at the friction limit."""
        wheels = self.world.wheels
        force = np.hypot(wheels["force_long"], wheels["force_lat"])
        return (wheels["limit"] > 0) & (force >= wheels["limit"] * (1 - 1e-9))

    def observation_space(self, duration: float) -> spaces.Space[Any]:
        """Return the space of observations in an episode of `duration` s."""
        robot = self.robot
        per_rev = self._built.counts_per_rev[np.array(robot.driven_wheels)]
        # Twice the fastest turn a period: a wheel pushed by the others may run ahead of its own limit.
        fastest = 2 * robot.max_wheel_speed * robot.sample_period * per_rev / (2 * np.pi) + 1
        turn = self._built.pivot_counts_per_rev[np.array(robot.pivot_encoders, dtype=np.intp)]
        parts: dict[str, Any] = {
            "wheel": spaces.Box(-fastest, fastest, dtype=np.float64),
            "pivot": spaces.Box(np.zeros_like(turn), turn - 1, dtype=np.float64),
            "time": spaces.Box(0.0, duration + robot.sample_period, (1,), dtype=np.float64),
        }
        if robot.gyro is not None:
            parts["gyro"] = spaces.Box(-100.0, 100.0, (1,), dtype=np.float64)
        return spaces.Dict(parts)
