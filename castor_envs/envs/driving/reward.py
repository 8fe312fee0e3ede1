"""What an agent that drives is paid for: being where it should be."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap

LOST = 0.5  # m from the target, mean over a train's axles: what is worth nothing, and ends an episode
HEADING = 0.25  # m for each radian: what an error of heading weighs beside a distance


def tracking_error(pose: Array, target: Array) -> tuple[Array, Array]:
    """Return the distance from the target, m, and the size of the error of heading, rad: means over a train's axles.

    pose, target: (3,) of a robot, (N, 3) of a train, (B, N, 3) of B trains, N = 1 of B robots; both are () or (B,).
    """
    away = target - pose
    distance, turn = np.hypot(away[..., 0], away[..., 1]), np.abs(wrap(away[..., 2]))
    return (distance.mean(axis=-1), turn.mean(axis=-1)) if away.ndim > 1 else (distance, turn)


def quality(position_error: ArrayLike, heading_error: ArrayLike) -> Array:
    """Return how well a target is tracked: 1 on it, less in proportion to errors (m and rad), 0 from `LOST` on.

    It is never negative: an agent gains nothing by ending an episode early.
    """
    return np.maximum(0.0, 1.0 - (np.asarray(position_error) + HEADING * np.asarray(heading_error)) / LOST)
