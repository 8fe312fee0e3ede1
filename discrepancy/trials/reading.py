"""From angles to counts and back, and from an exact log to a log as it would be recorded (rounded, with noise)."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a reference pose, m and rad, those of a good tracker, and how many samples apart poses
    are."""

    position: float = 1e-3
    heading: float = 1e-3
    every: int = 20

    def sparse(self, pose: Array, random: np.random.Generator) -> Array:
        """Return the poses (K, 3 N) of a log's reference: with noise where one is taken, NaN elsewhere."""
        sigma = np.tile([self.position, self.position, self.heading], pose.shape[1] // 3)
        seen = pose + random.normal(size=pose.shape) * sigma
        seen[np.arange(len(seen)) % self.every > 0] = np.nan
        return seen


USUAL = Noise()
EXACT = Noise(0.0, 0.0, every=1)
"""The true pose in every row, with which the strength of an effect is measured."""


def counts_of(robot: RobotDescription, angle: Array, phase: Array | float = 0.0) -> tuple[Array, Array]:
    """Return counts of wheels (K, d) and pivots (K, s), neither rounded nor wrapped, of angles as seen (K, w + n).

    phase (d,): start values of the wheels' encoders, in counts.
    """
    built, w = Geometry.of(robot.as_built()), len(robot.wheels)
    driven, sensed = list(robot.driven_wheels), list(robot.pivot_encoders)
    wheel = angle[:, driven] * built.counts_per_rev[driven] / (2 * np.pi) + phase
    pivot = (angle[:, w:] + built.pivot_zero)[:, sensed] * built.pivot_counts_per_rev[sensed] / (2 * np.pi)
    return wheel, pivot


def angles_of(robot: RobotDescription, log: Log) -> Array:
    """Return the angles (K, w + n), rad, by the counts of a robot: wheels from 0, castors unwrapped.

    Idle wheels stand still; castors without encoder stand at their angle.
    """
    built, driven = Geometry.of(robot.as_built()), list(robot.driven_wheels)
    wheel, castor = np.zeros((len(log), len(robot.wheels))), np.unwrap(castor_angles(built, log.pivot), axis=0)
    wheel[:, driven] = (log.wheel - log.wheel[0]) * 2 * np.pi / built.counts_per_rev[driven]
    castor -= 2 * np.pi * np.round(castor[:1] / (2 * np.pi))
    return np.column_stack([wheel, np.where(np.isnan(castor), built.angle, castor)])


def as_recorded(
    robot: RobotDescription, exact: Log, random: np.random.Generator, noise: Noise = USUAL, rounded: bool = True
) -> Log:
    """Return an exact log (every pose, counts not rounded) as it would be recorded: rounded, with few, noisy poses."""
    assert exact.reference is not None
    poses = noise.sparse(exact.reference, random)
    log = dataclasses.replace(exact, reference=poses)
    if not rounded:
        return log
    turn = Geometry.of(robot.as_built()).pivot_counts_per_rev[list(robot.pivot_encoders)]
    return dataclasses.replace(log, wheel=np.round(log.wheel), pivot=np.mod(np.round(log.pivot), turn))
