"""Swerve odometry without the modules that skid, by their skidding ratio, as FRC teams run it.

FRC team 1690 Orbit showed the method in its software session (https://youtu.be/N6ogT5DjGOk, from 27:54): the rotation
that fits all modules best is taken out of their velocities; what is left, the translational parts, is alike where no
wheel skids. The skidding ratio is the largest of them over the smallest. Teams publish it in their code, and some drop
modules by it: those of MA5951 count a module as skidding that is more than `SKIDS` times as fast as the slowest, and
add up the arcs of the others, never fewer than two (MAutils, ``SkidDetector`` and ``SwerveDriveEstimator``). The
heading is the gyro's; without one, that of the modules that are left.
"""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.peers.modules import Modules, along_arc, rigid_motion, rotation_taken_out
from estimators.protocol import Observation
from estimators.steps.castor_odometry import start
from estimators.steps.gyro import GyroTurns
from estimators.steps.rolling_equations import Motion, moved

SKIDS = 1.1
"""Skidding ratio above which a module is dropped: that of MAutils."""

STANDS = 0.1
"""m/s: below this slowest translational part no module is dropped. Ratios of small numbers are those of rounding."""


class SkidRatio:
    """Mean of the modules that do not skid; arcs between samples.

    When to use: a swerve whose wheels spin. A wheel is only ever taken to be too fast, so one that is blocked casts out
    good ones. Turning on the spot hides skids: nothing is left to compare.
    """

    batched = True

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises Declined for bases that are no swerve drives."""
        geometry, self._pose = start(robot, pose)
        self._modules, self._pivot, self._gyro = (
            Modules(geometry, at=0.5),
            geometry.pivot,
            GyroTurns(geometry.gyro, geometry.sample_period),
        )
        self._stands = STANDS * geometry.sample_period

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        path, swivel = self._modules.read(observation)
        path = along_arc(path, swivel)
        _, turn = rigid_motion(self._pivot, path, np.ones(path.shape[:-1]))
        kept = self._not_skidding(path, turn)
        displacement, turn = rigid_motion(self._pivot, path, kept)
        read = self._gyro.read(observation)
        if read.known.any():
            turn = np.where(read.known, read.turn, turn)
            parts = rotation_taken_out(self._pivot, path, turn)
            mean = np.sum(kept[..., None] * parts, axis=-2) / kept.sum(axis=-1)[..., None]
            displacement = np.where(read.known[..., None], mean, displacement)
        self._pose = moved(self._pose, Motion(along_arc(displacement, turn), turn))
        return self._pose.copy()

    def _not_skidding(self, path: Array, turn: Array) -> Array:
        """Return 1 for each module (..., n) that is kept, 0 for those that skid; the slowest two always are."""
        part = rotation_taken_out(self._pivot, path, turn)
        speed = np.hypot(part[..., 0], part[..., 1])
        ordered = np.sort(speed, axis=-1)
        slowest, second = ordered[..., :1], ordered[..., 1:2]
        kept = (speed <= SKIDS * slowest) | (speed <= second) | (slowest < self._stands)
        return kept.astype(np.float64)


ESTIMATORS = {"skid-ratio": SkidRatio}
