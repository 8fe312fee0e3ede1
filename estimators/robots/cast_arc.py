"""CAST without its small-angle assumption: the rigid motion that carries the pivots best."""

import math

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.steps.castor_odometry import (
    CastorEstimator,
    Step,
    compiled,
    displace,
    moved,
    origin_displacement,
    several_castors,
)


def _advance(castors, pivots, pose, wheel, pivot, step):
    """Take one sample; pivots (B, 2 n + 2): q_x and q_y of each, then the centroid. See `compiled`."""
    n = castors.shape[1]
    for robot in range(castors.shape[0]):
        # Least squares over d_i = t + (Rot(turn) - 1) q_i, q_i the pivots about their centroid and d_i what they
        # moved: the rotation carries the q_i onto the q_i + d_i ...
        cross, dot, east, north = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            x, y, _, _ = moved(castors, robot, i, wheel, pivot, step)
            q_x, q_y = pivots[robot, 2 * i], pivots[robot, 2 * i + 1]
            cross += q_x * y - q_y * x
            dot += q_x * (q_x + x) + q_y * (q_y + y)
            east += x / n
            north += y / n
        turn = math.atan2(cross, dot)
        # ... and the centroid moves by the mean displacement (as in eq. 22), the origin with it (eqs. 11-12).
        x, y = origin_displacement(pivots[robot, 2 * n], pivots[robot, 2 * n + 1], east, north, turn)
        # The castors' headings follow from the new psi and their measured angles, at the next step.
        displace(pose, robot, x, y, turn)


class CASTArc(CastorEstimator):
    """Finite rotation and translation that fit all pivots best (Doebbler eqs. 11-12 subtracted, not linearised).

    Least squares in closed form: rigid registration of the pivots before and after the step (Procrustes in the
    plane). left_out: number of the castor not used; 0 uses all. step: see `moved`.
    """

    kernel = compiled(__name__, "_advance")

    def __init__(self, left_out: int = 0, step: Step = "arc") -> None:
        super().__init__(step)
        self.left_out = left_out

    @staticmethod
    def variants(robot: RobotDescription) -> tuple[int, ...]:
        """Return 0: no castor is left out."""
        return (0,)

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises InputError where the castors used do not suit or are fewer than two."""
        geometry = Geometry.of(robot)
        castors, pivot = several_castors(geometry, self.left_out)
        centroid = pivot.mean(axis=-2)
        about = pivot - centroid[..., None, :]
        self.begin(geometry, castors, np.concatenate([about.reshape(*about.shape[:-2], -1), centroid], axis=-1), pose)


ESTIMATORS = {"cast-arc": CASTArc}
