"""A log's motion, errors and slip over time and on the floor: for pictures, and to locate the discrepancy."""

from typing import Any, NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.parity import WINDOW
from estimators.likelihood.log_likelihood import LogLikelihood


class Errors(NamedTuple):
    """By how much odometry is off the reference in a log: way (k,) driven until each reference pose, m; off (k, 3), m
    and rad."""

    way: Array
    off: Array


class Traces:
    """One log, as a robot's description explains it.

    path (K, 2): of the body, m. posed: whether it is where a reference saw it. channels: wheels' rolling and castors'
    side slip. middle (n,): of windows, s. place (n, 2): where the body was, m. slip (n, channels): by how much each
    misses perfect rolling in a window, m, added up with its sign.
    """

    def __init__(self, robot: RobotDescription, log: Log, state: Array) -> None:
        """robot: with its effects. state (K, m): what truly happened, as `LogLikelihood` has it."""
        geometry, w, castors = Geometry.of(robot.as_built()), len(robot.wheels), robot.wheel_castors
        model = LogLikelihood(geometry, log)
        starts = np.searchsorted(log.t, np.arange(log.t[0], log.t[-1] - WINDOW / 2, WINDOW) - 1e-9)
        edges = np.unique(np.append(starts if len(starts) else [0], len(log) - 1))
        self.path, self.posed = state[:, :2], model.poses > 0
        self.middle = (log.t[edges[:-1]] + log.t[edges[1:]]) / 2
        self.place = np.column_stack([np.interp(self.middle, log.t, state[:, axis]) for axis in (0, 1)])
        self.slip = np.add.reduceat(model.residuals(geometry, state), edges[:-1], axis=0)
        self.channels = tuple(
            f"wheel {robot.wheel_names[k]} rolling" if k < w else f"castor {castors[k - w] + 1} side slip"
            for k in model.rows.tolist()
        )

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


def along_the_way(log: Log, state: Array, clock: Array, off: Array) -> Errors:
    """Return errors of odometry at a log's reference poses (k, 3), with the way driven until these.

    state (K, m): as in `Traces`; the way is its way. clock: of the reference, as in `replay`.
    """
    rows = np.zeros(0, dtype=np.intp) if log.reference is None else np.flatnonzero(np.isfinite(log.reference[:, 0]))
    taken = log.t[rows] + clock[0] + clock[1] * (log.t[rows] - log.t[0])
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(state[:, :2], axis=0).T))])
    return Errors(np.interp(taken, log.t, driven), off)
