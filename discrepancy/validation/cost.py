"""Cost of an effect in use: the error of odometry over 10 m if the effect is ignored."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from estimators.likelihood.channels import Channels
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


def gap_of(errors: Iterable[Array]) -> tuple[float, float] | None:
    """Return the root mean square of errors (k, 3) of poses in position, m, and in heading, rad, NaN if no heading is
    known; None if there are no errors."""
    off = np.concatenate([np.zeros((0, 3)), *errors])
    if not len(off):
        return None
    turned = off[np.isfinite(off[:, 2]), 2]
    heading = float(np.sqrt(np.mean(turned**2))) if len(turned) else np.nan
    return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1)))), heading


def odometry(robot: RobotDescription, log: Log) -> Array:
    """Return the path (N, 3) by odometry with a robot's effects known: least squares over all encoders, sample by
    sample."""
    geometry, channels = Geometry.of(robot.as_built()), Channels(robot)
    model = LogLikelihood(geometry, log)
    counts = model.start(geometry)[:, 3:]
    model.correct(channels.read(robot, log, counts) - counts)
    return model.odometry(geometry)


def cost_of_sizes(errors: Iterable[Array], pose: Array) -> Array:
    """Return the accumulated errors of odometry (2, C), rms: m after `WAY`, and rad after a turn.

    errors: of each step, in B, m and rad, by C causes; successive blocks (k, 3, C) of all K - 1 steps. pose (K, 3).
    Shorter drives are scaled up; 0 where a drive is shorter than a tenth of the way, or does not turn by half a turn.
    """
    driven, swept = (
        np.concatenate([[0.0], np.cumsum(steps)])
        for steps in (np.hypot(*np.diff(pose[:, :2], axis=0).T), np.abs(np.diff(pose[:, 2])))
    )
    way, turn = min(WAY, float(driven[-1])), min(2 * np.pi, float(swept[-1]))
    (starts, ends), (turn_starts, turn_ends) = _stretches(driven, way), _stretches(swept, turn)
    at = np.unique(np.concatenate([starts, ends, turn_starts, turn_ends]))
    sums = _sums_at(at, errors, pose)

    def over(first: NDArray[np.intp], last: NDArray[np.intp]) -> Array:
        return sums[np.searchsorted(at, last)] - sums[np.searchsorted(at, first)]

    cost = np.zeros((2, sums.shape[2]))
    if way >= WAY / 10:
        within = over(starts, ends)
        moved, turned, swung = within[:, :2], within[:, 2], within[:, 3:]
        off = moved + (pose[ends, :2, None] * turned[:, None, :] - swung)[:, ::-1] * np.array([-1.0, 1.0])[:, None]
        cost[0] = np.sqrt(np.mean(np.sum(off**2, axis=1), axis=0)) * WAY / way
    if swept[-1] >= np.pi:
        cost[1] = np.sqrt(np.mean(over(turn_starts, turn_ends)[:, 2] ** 2, axis=0)) * 2 * np.pi / turn
    return cost


def _stretches(driven: Array, way: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the samples at which up to `WINDOWS` stretches of a way begin and end, given the way (K,) up to each."""
    starts = np.unique(np.searchsorted(driven, np.linspace(0.0, driven[-1] - way, WINDOWS)))
    return starts, np.minimum(np.searchsorted(driven, driven[starts] + way), len(driven) - 1)


def _sums_at(at: NDArray[np.intp], errors: Iterable[Array], pose: Array) -> Array:
    """Return sums up to some samples (k, 5, C) of the errors of place and heading, in N, and of the place in a step
    times the error of heading. errors, pose: as in `cost_of_sizes`."""
    heading, place = pose[:-1, 2] + np.diff(pose[:, 2]) / 2, (pose[1:, :2] + pose[:-1, :2]) / 2
    first, total, sums = 0, None, []
    for error in errors:
        steps = slice(first, first + len(error))
        c, s = np.cos(heading[steps])[:, None], np.sin(heading[steps])[:, None]
        x, y, turned = np.moveaxis(error, 1, 0)
        px, py = place[steps].T[..., None]
        parts = np.stack([c * x - s * y, s * x + c * y, turned, px * turned, py * turned], axis=1)
        begin = np.zeros_like(parts[:1]) if total is None else total
        parts = np.concatenate([begin, parts]).cumsum(axis=0)
        last = np.searchsorted(at, steps.stop, side="right")
        sums.append(parts[at[sum(map(len, sums)) : last] - first])
        first, total = steps.stop, parts[-1:]
    return np.concatenate(sums)
