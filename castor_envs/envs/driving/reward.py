"""What an agent that drives is paid for: being where it should be."""

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap

LOST = 0.5  # m from the target, mean over a train's axles: what is worth nothing, and ends an episode
HEADING = 0.25  # m for each radian: what an error of heading weighs beside a distance


def tracking_error(pose: Array, target: Array) -> tuple[float, float]:
    """Return the distance from the target, m, and the size of the error of heading, rad: means over a train's axles.

    pose, target: (3,) of a robot, (N, 3) of a train.
    """
    away = target - pose
    distance, turn = np.hypot(away[..., 0], away[..., 1]), np.abs(wrap(away[..., 2]))
    return float(distance.mean()), float(turn.mean())


def quality(position_error: float, heading_error: float) -> float:
    """Return how well a target is tracked: 1 on it, less in proportion to errors (m and rad), 0 from `LOST` on.

    It is never negative: an agent gains nothing by ending an episode early.
    """
    return max(0.0, 1.0 - (position_error + HEADING * heading_error) / LOST)
