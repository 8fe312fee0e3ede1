"""Odometry of a train: each axle by its two wheels alone, as if no frame joined the axles."""

from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.trains.configuration import Configuration


class TrainOdometry:
    """The odometry-derived poses that Vogt and Minor start from (eq. 1), never corrected."""

    status: str | None = None

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises InputError for anything but a train, and for poses of another shape."""
        self._configuration = Configuration(train, poses, None)

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (N, 3)."""
        self._configuration.advance(observation)
        return self._configuration.poses.copy()


ESTIMATORS = {"train-odometry": TrainOdometry}
