"""The tracked point of a reference: any point of the body, with axes turned against the body's.

It is fitted beside the robot's parameters, so that it does not bias them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.mounting import turn_of_tracker
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from estimators.likelihood.log_likelihood import LogLikelihood

MOUNT = np.array([1.0, 1.0, 1.0])
"""m, m, rad: prior standard deviations of the tracked point and its heading; wide enough not to matter."""

TURNED = 0.25
"""rad: usual angle between a tracker's axes and the body's, which should be parallel."""

MOUNT_SEEN = 0.5
"""A number of the mount is seen if its standard error is less than this part of its prior standard deviation."""


def mount_prior(described: Geometry) -> Array:
    """Return the prior standard deviations (3,), m, m, rad, of a tracked point."""
    return np.array([described.reach, described.reach, TURNED])


def straightened(described: Geometry, logs: Sequence[Log]) -> tuple[list[Log], float]:
    """Return logs with the axes of their tracker nearly along the body's, and the angle by which they were turned.

    For a small angle the logs stay as they are: it is fitted with all other unknowns. turn: rad, to the left.
    """
    models = [LogLikelihood(described, log) for log in logs]
    turn = turn_of_tracker([model.ways(described) for model in models], described.reach)
    return [_turned(log, -turn) if turn else log for log in logs], turn


def _turned(log: Log, by: float) -> Log:
    return log if log.reference is None else replace(log, reference=log.reference + np.array([0.0, 0.0, by]))
