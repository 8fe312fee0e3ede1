"""IPEC, Internal Position Error Correction: Borenstein's method, on two castors with offset pivots."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
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


class IPEC:
    """Heading from the displacements of two castors, not from how they turned (Doebbler III.B, eq. 10).

    left_out: number of the castor not used, as in IPEC-i; 0 on a robot with two castors. step: see
    `CastorOdometry`.
    """

    batched = True

    def __init__(self, left_out: int = 0, step: Step = "arc") -> None:
        self.left_out = left_out
        self.step: Step = step

    @staticmethod
    def variants(robot: RobotDescription) -> tuple[int, ...]:
        """Return the numbers that leave out no castor and each in turn."""
        return tuple(range(len(robot.castors) + 1))

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises InputError where not just two castors remain, or they do not suit."""
        geometry, self._pose = start(robot, pose)
        castors, pivot = several_castors(geometry, self.left_out)
        if len(castors) != 2:
            advice = ": leave out one of them" if len(castors) == 3 and self.left_out == 0 else ""
            raise Declined(f"uses two castors, and {len(castors)} are given{advice}")
        self._castors = CastorOdometry(geometry, castors, self.step)
        self._first, self._second = ((pivot[..., k, 0], pivot[..., k, 1]) for k in (0, 1))
        self._bearing = np.arctan2(self._second[1] - self._first[1], self._second[0] - self._first[0])

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        steps = self._castors.advance(observation)
        # Where each pivot arrives by its own odometry, in the body frame before the step.
        x1, y1 = self._first[0] + steps.x[..., 0], self._first[1] + steps.y[..., 0]
        x2, y2 = self._second[0] + steps.x[..., 1], self._second[1] + steps.y[..., 1]
        # Eq. 10, with the quadrant and without the body's own bearing of the line between the pivots.
        turn = wrap(np.arctan2(y2 - y1, x2 - x1) - self._bearing)
        # The first pivot stays there. The second goes where heading and known distance put it ("the position of
        # the second castor is updated to be consistent with the pose of the first"): the body's pose holds both.
        x, y = origin_displacement(self._first, steps.x[..., 0], steps.y[..., 0], turn)
        # The castors' headings follow from the new psi and their measured angles, at the next step.
        self._pose = displaced(self._pose, x, y, turn)
        return self._pose.copy()


ESTIMATORS = {"ipec": IPEC}
