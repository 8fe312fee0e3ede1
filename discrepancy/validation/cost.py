"""What an effect costs in use: the error of odometry over 10 m that ignoring it makes."""

from collections.abc import Sequence

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Channels
from estimators.calibration.log_likelihood import LogLikelihood

WAY = 10.0
"""m: what is driven."""


def cost_of(robot: RobotDescription, effect: Effect, logs: Sequence[Log]) -> float | None:
    """Return by how far (m, rms) odometry ends elsewhere after 10 m without the effect than with it, on these drives.

    Odometry is least squares over all encoders, sample by sample. Shorter drives are scaled up; None for drives of less
    than a tenth of the way.
    """
    errors: list[Array] = []
    for log in logs:
        without, with_it = (_odometry(variant, log) for variant in (robot, robot.with_effects(effect)))
        driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(without[:, :2], axis=0).T))])
        way = min(WAY, float(driven[-1]))
        if way < WAY / 10:
            continue
        starts = np.flatnonzero(driven <= driven[-1] - way + 1e-9)
        ends = np.minimum(np.searchsorted(driven, driven[starts] + way), len(driven) - 1)
        off = relative_pose(without[starts], without[ends]) - relative_pose(with_it[starts], with_it[ends])
        errors.append(np.hypot(off[:, 0], off[:, 1]) * WAY / way)
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else None


def _odometry(robot: RobotDescription, log: Log) -> Array:
    geometry, channels = Geometry.of(robot.as_built()), Channels(robot)
    model = LogLikelihood(geometry, log)
    counts = model.start(geometry)[:, 3:]
    model.correct(channels.read(robot, log, counts) - counts)
    return model.odometry(geometry)
