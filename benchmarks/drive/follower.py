"""An estimator that watches a drive as it happens; what goes wrong in it ends it alone."""

import numpy as np

from castor_envs.envs.actions import finite
from castor_envs.errors import Declined, InputError, one_line
from castor_envs.geometry.arrays import Array
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.load import Vehicle
from estimators.plugins.registry import EstimatorEntry


class Follower:
    """One estimator from the start of a drive. poses: what it believed after each sample. problem: why it has ended."""

    def __init__(self, entry: EstimatorEntry, vehicle: Vehicle, pose: Array, first: Observation) -> None:
        """Start at `pose`, (3,), of a train (N, 3), with the first sample; raises InputError where it does not serve
        the vehicle."""
        if entry.smoother:
            raise InputError(f"{entry.name} needs the whole log; --record a drive and judge it on that")
        self.name, self.problem = entry.name, None
        self.poses: list[Array] = []
        self._shape = pose.shape
        try:
            self._estimator = entry.factory()
            self._estimator.reset(vehicle, pose.copy())
        except Declined as error:
            raise InputError(f"{entry.name} does not serve {vehicle.name!r}: {error}") from None
        except (Exception, SystemExit) as error:
            raise InputError(f"{entry.name} failed to start: {one_line(error)}") from None
        self.take(first)

    @property
    def pose(self) -> Array:
        """What it believes now, (3,) or (N, 3); NaN once it has failed."""
        return self.poses[-1]

    def take(self, observation: Observation) -> None:
        """Give it a sample."""
        pose = np.full(self._shape, np.nan)
        if self.problem is None:
            try:
                given = self._estimator.update({k: v.copy() for k, v in observation.items()})
                if given is None:
                    raise ValueError("update returns None")
                pose = finite(given, self._shape, "what update returns").copy()
            except (Exception, SystemExit) as error:
                self.problem = one_line(error)
        self.poses.append(pose)
