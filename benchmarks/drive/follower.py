"""An estimator that watches a drive as it happens; what goes wrong in it ends it alone."""

import numpy as np

from castor_envs.errors import Declined, InputError, one_line
from castor_envs.geometry.arrays import Array
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.registry import EstimatorEntry


class Follower:
    """One estimator from the start of a drive. poses: what it believed after each sample. problem: why it has ended."""

    def __init__(self, entry: EstimatorEntry, robot: RobotDescription, pose: Array, first: Observation) -> None:
        """Start at `pose` (3,) with the first sample; raises InputError where it does not serve the robot."""
        if entry.smoother:
            raise InputError(f"{entry.name} needs the whole log; --record a drive and judge it on that")
        self.name, self.problem = entry.name, None
        self.poses: list[Array] = []
        try:
            self._estimator = entry.factory()
            self._estimator.reset(robot, pose.copy())
        except Declined as error:
            raise InputError(f"{entry.name} does not serve {robot.name!r}: {error}") from None
        except Exception as error:
            raise InputError(f"{entry.name} failed to start: {one_line(error)}") from None
        self.take(first)

    @property
    def pose(self) -> Array:
        """What it believes now, (3,); NaN once it has failed."""
        return self.poses[-1]

    def take(self, observation: Observation) -> None:
        """Give it a sample."""
        pose = np.full(3, np.nan)
        if self.problem is None:
            try:
                given = np.array(self._estimator.update({k: v.copy() for k, v in observation.items()}), dtype=float)
                if given.shape != (3,) or not np.isfinite(given).all():
                    raise ValueError(f"a pose is three finite numbers, got {given}")
                pose = given
            except Exception as error:
                self.problem = one_line(error)
        self.poses.append(pose)
