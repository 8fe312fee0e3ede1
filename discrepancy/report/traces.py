"""A log's motion, errors and slip over time and on the floor: for pictures, and to locate the discrepancy."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.effects.catalogue import radii_of
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, forward
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.replay import measured_in, poses_in
from estimators.likelihood.log_likelihood import LogLikelihood

WINDOW = 1.0
"""s: over which slip is added up."""


class Errors(NamedTuple):
    """By how much odometry is off the reference in a log: way (k,) driven until each reference pose, m; off (k, 3), m
    and rad."""

    way: Array
    off: Array


@dataclass(frozen=True, eq=False)
class Traces:
    """One log, as a robot's description explains it.

    path (K, 3): dead reckoning at `t` (K,), from where the body truly was at the first reference pose, or from 0.
    times (k,): of reference poses.
    channels: wheels' rolling and castors' side slip. middle (n,): of windows, s. place (n, 2): where the body was, m.
    slip (n, channels): by how much each misses perfect rolling in a window, m, added up with its sign.
    """

    t: Array
    path: Array
    times: Array
    channels: tuple[str, ...]
    middle: Array
    place: Array
    slip: Array

    def worst(self) -> dict[str, Any]:
        """Return where most slip is, plain data for JSON: its channel, time and place."""
        k, c = np.unravel_index(np.argmax(np.abs(self.slip)), self.slip.shape)
        share = np.sum(self.slip**2, axis=0) / max(float(np.sum(self.slip**2)), 1e-30)
        most = int(np.argmax(share))
        return {
            "channel": self.channels[most],
            "share_of_slip": float(share[most]),
            "most_slip_m": float(np.abs(self.slip[k, c])),
            "at_s": float(self.middle[k]),
            "x_m": float(self.place[k, 0]),
            "y_m": float(self.place[k, 1]),
        }


def traces_of(
    robot: RobotDescription,
    log: Log,
    state: Array,
    clock: ArrayLike = (0.0, 0.0),
    mount: ArrayLike = (0.0, 0.0, 0.0),
) -> Traces:
    """Return the traces of a log.

    robot: with its effects. state (K, m): what truly happened, as `LogLikelihood` has it; clock, mount: of the
    reference, as in `replay`.
    """
    geometry, model = Geometry.of(robot.as_built()), LogLikelihood(Geometry.of(robot.as_built()), log)
    t, path = dead_reckoning(robot, log)
    times, _ = poses_in(robot, log, clock, mount)
    if len(times):
        first = np.array([np.interp(times[0], t, column) for column in path.T])
        truly = np.array([np.interp(times[0], log.t, column) for column in state[:, :3].T])
        path = compose(truly, relative_pose(first, path))
    edges = _edges(log.t, WINDOW)
    middle = (log.t[edges[:-1]] + log.t[edges[1:]]) / 2
    place = np.stack([np.interp(middle, log.t, state[:, axis]) for axis in (0, 1)], axis=-1)
    slip = np.add.reduceat(model.residuals(geometry, state), edges[:-1], axis=0)
    return Traces(t, path, times, _names(robot, model.rows), middle, place, slip)


def along_the_way(log: Log, state: Array, clock: Array, off: Array) -> Errors:
    """Return errors of odometry at a log's reference poses (k, 3), with the way driven until these.

    state (K, m), clock: as in `traces_of`; the way is that of the state.
    """
    rows = np.zeros(0, dtype=np.intp) if log.reference is None else np.flatnonzero(np.isfinite(log.reference[:, 0]))
    taken = log.t[rows] + clock[0] + clock[1] * (log.t[rows] - log.t[0])
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(state[:, :2], axis=0).T))])
    return Errors(np.interp(taken, log.t, driven), off)


def dead_reckoning(robot: RobotDescription, log: Log) -> tuple[Array, Array]:
    """Return times (K,) and poses (K, 3) from 0 on, from what encoders counted less what the robot's effects add."""
    seen, geometry = measured_in(robot, log), Geometry.of(robot.as_built())
    turned, rolled, radii = np.diff(seen.castor, axis=0), np.diff(seen.wheel, axis=0), radii_of(robot)
    half_turned = seen.castor[:-1] + turned / 2
    if radii is not None:
        rolled = rolled * radii(half_turned) / geometry.radius
    twist = forward(geometry, half_turned, turned, rolled)
    heading = np.concatenate([[0.0], np.cumsum(twist[:, 2])])
    half_way = (heading[1:] + heading[:-1]) / 2
    chord = np.column_stack([twist[:, :2] * np.sinc(twist[:, 2:] / (2 * np.pi)), np.zeros(len(twist))])
    steps = compose(np.pad(half_way[:, None], ((0, 0), (2, 0))), chord)[:, :2]
    return seen.t, np.column_stack([np.pad(np.cumsum(steps, axis=0), ((1, 0), (0, 0))), heading])


def _edges(t: Array, window: float) -> NDArray[np.intp]:
    """Return the samples at which windows begin, and the last sample."""
    starts = np.searchsorted(t, np.arange(t[0], t[-1] - window / 2, window) - 1e-9)
    return np.unique(np.append(starts if len(starts) else [0], len(t) - 1))


def _names(robot: RobotDescription, rows: NDArray[np.intp]) -> tuple[str, ...]:
    w = len(robot.wheels)
    return tuple(
        f"wheel {robot.wheel_names[k]} rolling" if k < w else f"castor {robot.wheel_castors[k - w] + 1} side slip"
        for k in rows.tolist()
    )
