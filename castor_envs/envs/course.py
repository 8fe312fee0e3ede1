"""Courses: what vehicles are to follow from the origin."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.motion.paths import TrainPath
from castor_envs.motion.trajectories import Trajectory

DRAWN = 400
"""Points of a course that is drawn."""


class Course(ABC):
    """What a vehicle is to follow from the origin: (..., 3) of a robot stands for (..., N, 3) of a train's axles."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """Time taken, s."""

    @abstractmethod
    def target(self, time: ArrayLike) -> Array:
        """Return the poses (..., 3) in N at times (...), s."""

    @abstractmethod
    def twist(self, time: ArrayLike) -> Array:
        """Return the twists (..., 3) at times (...), s, each in its own frame."""

    @abstractmethod
    def line(self) -> Array:
        """Return poses (k, 3) all along it, to be drawn."""


@dataclass(frozen=True, eq=False)
class RobotCourse(Course):
    """A trajectory that a robot's body follows."""

    trajectory: Trajectory

    @property
    def duration(self) -> float:
        """Time taken, s."""
        return self.trajectory.duration

    def target(self, time: ArrayLike) -> Array:
        """Return the poses (..., 3) in N at times (...), s."""
        return self.trajectory.at(time)[0]

    def twist(self, time: ArrayLike) -> Array:
        """Return the twists (..., 3) in B at times (...), s."""
        return self.trajectory.at(time)[1]

    def line(self) -> Array:
        """Return poses (k, 3) all along it, to be drawn."""
        return self.target(np.linspace(0.0, self.duration, DRAWN))


@dataclass(frozen=True, eq=False)
class TrainCourse(Course):
    """A path that all axles of a train follow. behind (N,): how far each is behind the front one along it, m."""

    path: TrainPath
    behind: Array

    @property
    def duration(self) -> float:
        """Time taken, s."""
        return self.path.duration

    def target(self, time: ArrayLike) -> Array:
        """Return the poses (..., N, 3) in N at times (...), s."""
        covered, _ = self.path.progress(time)
        return self.path.at(covered[..., None] - self.behind)[0]

    def twist(self, time: ArrayLike) -> Array:
        """Return the twists (..., N, 3) at times (...), s, each in its axle's frame."""
        covered, speed = self.path.progress(time)
        turn = self.path.at(covered[..., None] - self.behind)[1]
        return speed[..., None, None] * np.stack([np.ones_like(turn), np.zeros_like(turn), turn], axis=-1)

    def line(self) -> Array:
        """Return poses (k, 3) all along it, to be drawn."""
        return self.path.at(np.linspace(-self.behind[-1], self.path.length, DRAWN))[0]
