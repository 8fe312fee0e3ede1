"""Cost of an effect in use: the error of odometry over 10 m if the effect is ignored."""

from collections.abc import Iterable, Sequence

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Channels
from estimators.likelihood.log_likelihood import LogLikelihood

WAY = 10.0
"""m: distance over which errors are measured."""

WINDOWS = 40
"""Most stretches of a drive over which the error is averaged."""


def cost_of(robot: RobotDescription, effect: Effect, logs: Sequence[Log]) -> float | None:
    """Return the rms distance (m) after 10 m between odometry without the effect and with it, on these drives.

    Shorter drives are scaled up; None for drives of less than a tenth of the way.
    """
    real = robot.with_effects(effect)
    return rms_of(apart(odometry(robot, log), odometry(real, log)) for log in logs)


def apart(path: Array, second_path: Array) -> Array:
    """Return the distances (m) between two paths (N, 3) of one drive after 10 m of the first, from every place on it.

    Each path is taken relative to its pose at the start of these 10 m. Empty for a drive of less than a tenth of the
    way.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    way = min(WAY, float(driven[-1]))
    if way < WAY / 10:
        return np.zeros(0)
    starts = np.flatnonzero(driven <= driven[-1] - way + 1e-9)
    ends = np.minimum(np.searchsorted(driven, driven[starts] + way), len(driven) - 1)
    off = relative_pose(path[starts], path[ends]) - relative_pose(second_path[starts], second_path[ends])
    return np.hypot(off[:, 0], off[:, 1]) * WAY / way


def rms_of(parts: Iterable[Array]) -> float | None:
    """Return the root mean square of all values; None if there are none."""
    values = np.concatenate([np.zeros(0), *parts])
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def odometry(robot: RobotDescription, log: Log) -> Array:
    """Return the path (N, 3) by odometry with a robot's effects known: least squares over all encoders, sample by
    sample."""
    geometry, channels = Geometry.of(robot.as_built()), Channels(robot)
    model = LogLikelihood(geometry, log)
    counts = model.start(geometry)[:, 3:]
    model.correct(channels.read(robot, log, counts) - counts)
    return model.odometry(geometry)


def cost_of_sizes(error: Array, pose: Array) -> Array:
    """Return the accumulated errors of odometry (2, C), rms: m after `WAY`, and rad after a turn.

    error (K - 1, 3, C): of each step, in B, m and rad, by C causes. pose (K, 3). Shorter drives are scaled up; 0 where
    a drive is shorter than a tenth of the way, or does not turn by half a turn.
    """
    heading, place = pose[:-1, 2] + np.diff(pose[:, 2]) / 2, (pose[1:, :2] + pose[:-1, :2]) / 2
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    moved = np.stack([c * error[:, 0] - s * error[:, 1], s * error[:, 0] + c * error[:, 1]], axis=1)
    turned = error[:, 2]
    sums = [
        np.concatenate([np.zeros_like(part[:1]), np.cumsum(part, axis=0)])
        for part in (moved, turned, place[:, :, None] * turned[:, None, :])
    ]
    driven, swept = (
        np.concatenate([[0.0], np.cumsum(steps)])
        for steps in (np.hypot(*np.diff(pose[:, :2], axis=0).T), np.abs(np.diff(pose[:, 2])))
    )
    cost, way = np.zeros((2, error.shape[2])), min(WAY, float(driven[-1]))
    if way >= WAY / 10:
        starts = np.unique(np.searchsorted(driven, np.linspace(0.0, driven[-1] - way, WINDOWS)))
        ends = np.minimum(np.searchsorted(driven, driven[starts] + way), len(driven) - 1)
        moved, turned, swung = (total[ends] - total[starts] for total in sums)
        off = moved + (pose[ends, :2, None] * turned[:, None, :] - swung)[:, ::-1] * np.array([-1.0, 1.0])[:, None]
        cost[0] = np.sqrt(np.mean(np.sum(off**2, axis=1), axis=0)) * WAY / way
    if swept[-1] >= np.pi:
        turn = min(2 * np.pi, float(swept[-1]))
        starts = np.unique(np.searchsorted(swept, np.linspace(0.0, swept[-1] - turn, WINDOWS)))
        ends = np.minimum(np.searchsorted(swept, swept[starts] + turn), len(swept) - 1)
        cost[1] = np.sqrt(np.mean((sums[1][ends] - sums[1][starts]) ** 2, axis=0)) * 2 * np.pi / turn
    return cost
