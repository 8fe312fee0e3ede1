"""A vehicle in physics that moves as it is wished to: an environment without course or reward, to be recorded."""

from abc import abstractmethod
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from castor_envs.envs.sensed import SensedRobot, SensedTrain
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.sensors.observation import Observation, copied
from castor_envs.vehicles.load import Vehicle

Sensed = TypeVar("Sensed", SensedRobot, SensedTrain)

FASTEST, FASTEST_TURN = 0.6, 1.5
"""m/s and rad/s: a slow walk, and a turn in four seconds; less where the wheels cannot."""
PART = 0.5
"""Of the wheels' fastest turning that a drive by hand uses, so that castors can swing beside it."""
RAMP = 0.5
"""s from rest to full speed."""
LONGEST = 3600.0
"""s that observations reach: an hour."""


class HandDrivenEnv(gym.Env[Observation, Array], Generic[Sensed]):
    """A vehicle that starts at rest at the origin; the action (3,) is where it is to go, each part in [-1, 1].

    Parts: forward, to its left, turning left, of `limits` (3,). They change within `RAMP`. vehicle: as estimators may
    know it. floor: in N. sideways: whether the second part means anything.
    """

    limits: Array
    sideways: bool = False

    def __init__(self, sensed: Sensed) -> None:
        self._sensed = sensed
        self.floor: Floor = sensed.floor
        self.vehicle: Vehicle = sensed.described
        self.observation_space = sensed.observation_space(LONGEST)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float64)
        self._motion = np.zeros(3)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the vehicle at the origin, at rest, straight or with castors trailing for forward motion."""
        super().reset(seed=seed)
        self._motion = np.zeros(3)
        commands = self._start()
        return copied(self._sensed.observation), {"pose": self._sensed.pose, **commands}

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for one sample period."""
        wished = np.clip(np.asarray(action, dtype=float), -1.0, 1.0) * self.limits
        most = self.limits * self.vehicle.sample_period / RAMP
        self._motion = self._motion + np.clip(wished - self._motion, -most, most)
        commands = self._move(self._motion)
        return copied(self._sensed.observation), 0.0, False, False, {"pose": self._sensed.pose, **commands}

    def stop(self) -> None:
        """Wish for rest at once, without a ramp: wheels slip where they have to."""
        self._motion = np.zeros(3)

    @property
    def pose(self) -> Array:
        """The true pose (3,), of a train those of its axles (N, 3)."""
        return self._sensed.pose

    @property
    def shape(self) -> Any:
        """What a picture needs beside the pose (`Renderer.draw`)."""
        return self._sensed.shape

    def sliding(self) -> NDArray[np.bool_]:
        """Return which wheels (w,) slide."""
        return self._sensed.sliding()

    def reference(self, t: ArrayLike, pose: Array) -> Array:
        """Return what a tracker reports of true poses, for recorders."""
        return self._sensed.reference(t, pose)

    @abstractmethod
    def _start(self) -> dict[str, Array]:
        """Put the sensed vehicle at the start; return the commands at rest, by their keys in `info`."""

    @abstractmethod
    def _move(self, motion: Array) -> dict[str, Array]:
        """Drive for a sample period, with motion (3,) as far as the vehicle can; return the commands given."""
