"""Tracks of wheels in every step of logs: place on the floor, distance, and slip beyond prediction.

Reference poses give the places where wheels touch the floor (`contact_places`), and the smoother gives each wheel's
slip.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.contact_motion import contact_paths, contact_places
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.maximum_likelihood.fit import State
from estimators.likelihood.channels import Channels
from estimators.likelihood.log_likelihood import LogLikelihood
from estimators.likelihood.rolling import GAP

FLOOR = 1e-4
"""m that is added to a step's length for the variance of its slip."""


@dataclass(frozen=True, eq=False)
class Steps:
    """The tracks of all wheels in all steps of logs, M in all: those in which a slip is known.

    start, end (M, 2): where in N a wheel touched the floor, m. path: how far it went along its rolling direction, m.
    heading: of that direction in N, rad. slip: m. weight: over the variance, 1/m2. radius: m. track: a number for every
    wheel of every log. time: the step's number in its log.
    """

    start: Array
    end: Array
    path: Array
    heading: Array
    slip: Array
    weight: Array
    radius: Array
    track: NDArray[np.intp]
    time: NDArray[np.intp]

    @property
    def middle(self) -> Array:
        """Where in N (M, 2) a wheel was half way, m."""
        return (self.start + self.end) / 2

    def passes(self, chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return for the steps `chosen` (M,) the number of their pass: one wheel's steps without a break."""
        track, time = self.track[chosen], self.time[chosen]
        new = (np.diff(track, prepend=-1) != 0) | (np.diff(time, prepend=-9) > 2)
        return np.cumsum(new) - 1

    def only(self, chosen: NDArray[np.bool_]) -> "Steps":
        """Return the steps `chosen` (M,)."""
        return Steps(*(getattr(self, name)[chosen] for name in Steps.__dataclass_fields__))


def along_and_across(place: Array, direction: float) -> Array:
    """Return coordinates (2, n) of places (n, 2), m, along a direction (rad, in N) and to its left."""
    return rotate(place, -direction).T


def steps_of(robot: RobotDescription, motions: Sequence[Motion], slips: Sequence[Array]) -> Steps:
    """Return the steps of logs; slips: for each log those beyond prediction (K - 1, w), m, NaN where unknown."""
    parts, w = [], len(robot.wheels)
    radius = np.array([wheel.radius for wheel in robot.wheels])
    for k, (motion, slip) in enumerate(zip(motions, slips, strict=True)):
        places, path = contact_places(robot, motion), contact_paths(robot, motion)[:, :w]
        heading = motion.heading[:, None] + motion.half_way[:, list(robot.wheel_castors)]
        longest = np.abs(path).max(axis=1, keepdims=True) + FLOOR
        wheel, step = np.nonzero(np.isfinite(slip).T)
        weight = 1 / np.broadcast_to(longest, path.shape)
        columns = (values[step, wheel] for values in (places[:-1], places[1:], path, heading, slip, weight))
        parts.append((*columns, radius[wheel], k * w + wheel, step))
    steps = Steps(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    squares = float(np.sum(steps.weight * steps.slip**2))
    return dataclasses.replace(steps, weight=steps.weight * len(steps.slip) / max(squares, 1e-30))


def slips_of(robot: RobotDescription, model: LogLikelihood, log: Log, state: Array, expected: Array) -> Array:
    """Return the slips of wheels (K - 1, w), m, in a log at a state (K, m) beyond the expected slips (K - 1, rows), m.

    NaN for wheels without information, and beside gaps.
    """
    slips = np.full((len(log) - 1, len(robot.wheels)), np.nan)
    along = np.flatnonzero(model.rows < len(robot.wheels))
    slips[:, model.rows[along]] = (model.residuals(Geometry.of(robot.as_built()), state) - expected)[:, along]
    step = np.diff(log.t)
    gap = np.pad(step > GAP * np.median(step), 1)
    slips[gap[:-2] | gap[1:-1] | gap[2:]] = np.nan
    return slips


def placed(
    robot: RobotDescription, logs: Sequence[Log], at: State, slips: Sequence[Array]
) -> tuple[list[Motion], list[Array]]:
    """Return motions and slips of the logs that have reference poses."""
    posed = [k for k, log in enumerate(logs) if log.reference is not None and np.isfinite(log.reference[:, 0]).any()]
    motions = [Channels(robot).motion(logs[k], at.states[k], consistent_wheels=True) for k in posed]
    return motions, [slips[k] for k in posed]
