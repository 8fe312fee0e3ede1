"""A simulated train as its sensors report it: what the environments of trains share."""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from castor_envs.effects import reader_of
from castor_envs.envs.sensed_robot import Observation
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.kinematics import Geometry
from castor_envs.physics.stepper import Drive
from castor_envs.physics.train_world import TrainWorld
from castor_envs.sensors.encoders import Encoders
from castor_envs.sensors.posture import PostureSensors
from castor_envs.vehicles.train import TrainDescription

MOST_BENT = 100.0  # rad: no reading of a relative heading goes beyond


class SensedTrain:
    """A train in a world, seen through its wheel encoders and relative posture sensors.

    train: with its effects; `described` is what drivers and estimators may know. The state is made anew by `reset`.
    """

    def __init__(self, train: TrainDescription, floor: Floor) -> None:
        self.train, self.floor = train, floor
        self.described = train.as_described()
        self._built = train.as_built()
        self._geometries = [Geometry.of(module) for module in self._built.modules]
        self.world = TrainWorld(train, floor)  # refuses what cannot stand or be computed; `reset` makes it anew

    def reset(self, random: np.random.Generator) -> None:
        """Put the train straight, its front axle at the origin, at rest; draws encoder phases and gauge offsets."""
        self._encoders = [Encoders(geometry, Encoders.random_phase(geometry, random)) for geometry in self._geometries]
        self._readers = [reader_of(module) for module in self.train.modules]
        self._sensors = PostureSensors(self._built, random)
        self.world = TrainWorld(self.train, self.floor)
        self._counts: Array | None = None
        self._sense()

    def advance(self, command: ArrayLike, drive: Drive = "servo") -> None:
        """Drive for one sample period and read the sensors; command (2N,) as for `TrainWorld.advance`."""
        self.world.advance(command, drive)
        self._sense()

    def _read_encoders(self) -> Array:
        now, angles = np.array([self.world.time]), self.world.wheel_angles.reshape(-1, 1, 2)
        seen = [
            read(now, pair, geometry.angle[None])[0][0]
            for read, pair, geometry in zip(self._readers, angles, self._geometries, strict=True)
        ]
        return np.concatenate([own.wheel(pair) for own, pair in zip(self._encoders, seen, strict=True)])

    def _sense(self) -> None:
        counts = self._read_encoders()
        rps, age = self._sensors.read(self.world.joint_angles, self.world.time)
        self.observation: Observation = {
            "wheel": counts - (counts if self._counts is None else self._counts),
            "rps": rps.ravel(),
            "rps_age": age,
            "time": np.array([self.world.time]),
        }
        self._counts = counts

    def sliding(self) -> NDArray[np.bool_]:
        """Return which wheels (2N,) slide: their force is at the friction limit."""
        wheels = self.world.wheels
        force = np.hypot(wheels["force_long"], wheels["force_lat"])
        return (wheels["limit"] > 0) & (force >= wheels["limit"] * (1 - 1e-9))

    def observation_space(self, duration: float) -> spaces.Space[Any]:
        """Return the space of observations in an episode of at most `duration` s."""
        period, frames = self._built.sample_period, self._built.frames
        per_rev = np.concatenate([geometry.counts_per_rev for geometry in self._geometries])
        speed = np.repeat([module.max_wheel_speed for module in self._built.modules], 2)
        # Twice the fastest turn a period: a wheel pushed by the others may run ahead of its own limit.
        fastest = 2 * speed * period * per_rev / (2 * np.pi) + 1
        reach = np.concatenate([[frame.length, frame.length, MOST_BENT] for frame in frames])
        latest = duration + period
        return spaces.Dict(
            {
                "wheel": spaces.Box(-fastest, fastest, dtype=np.float64),
                "rps": spaces.Box(-reach, reach, dtype=np.float64),
                "rps_age": spaces.Box(0.0, latest, (len(frames),), dtype=np.float64),
                "time": spaces.Box(0.0, latest, (1,), dtype=np.float64),
            }
        )
