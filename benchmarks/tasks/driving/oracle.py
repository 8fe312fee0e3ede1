"""The oracle of drives: an estimator that is told the true robot, and how wheels would read if nothing disturbed them.

It is the filter, told that dimensions are exact. What is left are encoders' steps, creep of contacts, wheels that the
driver makes slip, and what happens between samples; by what it knows of these, an estimator may still do better.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.tolerances import Tolerances
from estimators.robots.calibrating_filter import CalibratingFilter


def followed(robot: RobotDescription, log: Log, start: Array, samples: NDArray[np.intp]) -> Array:
    """Return the oracle's poses (M, 3) at samples (M,) of a log that nothing disturbed. robot: the true one."""
    oracle = CalibratingFilter()
    oracle.reset(dataclasses.replace(robot, tolerances=Tolerances()), start)
    return np.array([oracle.update(seen) for seen in log.observations()])[samples]
