"""IPEC for two trucks, as Borenstein invented it: the line between the trucks serves both as a compass.

Borenstein, "Internal correction of dead-reckoning errors with a dual-drive compliant linkage mobile robot", Journal of
Robotic Systems 12(4), 1995, pp. 257-273, and "Experimental results from internal odometry error correction with the
OmniMate mobile robot", IEEE Trans. Robotics and Automation 14(6), 1998. A bump turns a truck at once (its orientation
error grows fast), but moves it sideways only as it drives on (its lateral error grows slowly). So the bearing of the
line between two trucks, from their momentary positions, is right where their headings are not, and every truck measures
the same bearing from itself by the encoders of the linkage. Here the relative pose replaces these encoders.
`estimators.robots.ipec` is the same idea on two castors of one body.

Steps at a correction, axle 1 in front:

1. odometry of both trucks gives the bearing of the line from the rear one to the front one;
2. the linkage gives the same bearing in each truck's own frame;
3. the difference is each truck's heading, free of error but for the slow lateral one;
4. the rear truck's position is made consistent with the front one's: on that line, at the linkage's length
   (as Doebbler et al. describe IPEC, III.B).
"""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.trains.configuration import Configuration, checked_interval, next_to


def corrected(od: ArrayLike, relative: ArrayLike) -> Array:
    """Return the corrected poses (..., 2, 3) for OD poses (..., 2, 3) and the relative pose (..., 1, 3)."""
    od, front_seen = np.array(od, dtype=float), np.asarray(relative, dtype=float)[..., 0, :]
    rear_seen = se2.inverse(front_seen)
    line = od[..., 0, :2] - od[..., 1, :2]
    bearing = np.arctan2(line[..., 1], line[..., 0])  # step 1
    length = np.hypot(front_seen[..., 0], front_seen[..., 1])
    poses = od.copy()
    # Steps 2 and 3. The front truck looks back along the line.
    poses[..., 0, 2] = bearing + np.pi - np.arctan2(rear_seen[..., 1], rear_seen[..., 0])
    poses[..., 1, 2] = bearing - np.arctan2(front_seen[..., 1], front_seen[..., 0])
    poses[..., 1, 0] = od[..., 0, 0] - length * np.cos(bearing)  # step 4
    poses[..., 1, 1] = od[..., 0, 1] - length * np.sin(bearing)
    return next_to(od[..., 2], poses)


class TwoTruckIPEC:
    """Corrects both headings by the line between the two axles, and the distance of the rear axle, at every sample.

    interval: sample periods between corrections; 1, as Borenstein has it: errors are corrected as they occur.
    status: why relative poses cannot be used now, or None.
    """

    def __init__(self, interval: int = 1) -> None:
        self.interval = checked_interval(interval)

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (2, 3); raises InputError for all but a train of two axles, and poses of another shape."""
        self._configuration = Configuration(train, poses, self.interval)
        if train.n_axles != 2:
            raise Declined(f"joins two axles, and {train.name!r} has {train.n_axles}; grpec-xy serves any number")

    @property
    def status(self) -> str | None:
        """Why the frame's relative pose cannot be used now; None while it can."""
        return self._configuration.status

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (2, 3)."""
        relative = self._configuration.advance(observation)
        if relative is not None:
            self._configuration.correct(corrected(self._configuration.poses, relative))
        return self._configuration.poses.copy()


ESTIMATORS = {"two-truck-ipec": TwoTruckIPEC}
