"""CAST without its small-angle assumption: the rigid motion that carries the pivots best."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.robots.castor_odometry import (
    CastorOdometry,
    Step,
    displaced,
    origin_displacement,
    several_castors,
    start,
)


class CASTArc:
    """Finite rotation and translation that fit all pivots best (Doebbler eqs. 11-12 subtracted, not linearised).

    Least squares in closed form: rigid registration of the pivots before and after the step (Procrustes in the
    plane). left_out: number of the castor not used; 0 uses all. step: see `CastorOdometry`.
    """

    batched = True

    def __init__(self, left_out: int = 0, step: Step = "arc") -> None:
        self.left_out = left_out
        self.step: Step = step

    @staticmethod
    def variants(robot: RobotDescription) -> tuple[int, ...]:
        """Return 0: no castor is left out."""
        return (0,)

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises InputError where the castors used do not suit or are fewer than two."""
        geometry, self._pose = start(robot, pose)
        castors, pivot = several_castors(geometry, self.left_out)
        self._castors = CastorOdometry(geometry, castors, self.step)
        centroid = pivot.mean(axis=-2)
        self._centroid = centroid[..., 0], centroid[..., 1]
        self._q_x, self._q_y = pivot[..., 0] - centroid[..., :1], pivot[..., 1] - centroid[..., 1:]
        self._spread = np.sum(self._q_x**2 + self._q_y**2, axis=-1)

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        steps = self._castors.advance(observation)
        # Least squares over d_i = t + (Rot(turn) - 1) q_i, q_i the pivots about their centroid and d_i what they
        # moved: the rotation carries the q_i onto the q_i + d_i ...
        cross = np.vecdot(self._q_x, steps.y) - np.vecdot(self._q_y, steps.x)
        dot = self._spread + np.vecdot(self._q_x, steps.x) + np.vecdot(self._q_y, steps.y)
        turn = np.arctan2(cross, dot)
        # ... and the centroid moves by the mean displacement (as in eq. 22), the origin with it (eqs. 11-12).
        x, y = origin_displacement(self._centroid, steps.x.mean(axis=-1), steps.y.mean(axis=-1), turn)
        # The castors' headings follow from the new psi and their measured angles, at the next step.
        self._pose = displaced(self._pose, x, y, turn)
        return self._pose.copy()


ESTIMATORS = {"cast-arc": CASTArc}
