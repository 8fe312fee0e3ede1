"""IPEC, Internal Position Error Correction: Borenstein's method, on two castors with offset pivots."""

import math

from numpy.typing import ArrayLike

from castor_envs.errors import Declined
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
    wrapped,
)


def _advance(castors, pivots, pose, wheel, pivot, step):
    """Take one sample; pivots (B, 4): x and y of the first, then of the second. See `compiled`."""
    for robot in range(castors.shape[0]):
        first_x, first_y = pivots[robot, 0], pivots[robot, 1]
        east, north, _, _ = moved(castors, robot, 0, wheel, pivot, step)
        second_east, second_north, _, _ = moved(castors, robot, 1, wheel, pivot, step)
        # The line between the pivots, in the body frame before the step, and where both arrive by their own odometry.
        line_x, line_y = pivots[robot, 2] - first_x, pivots[robot, 3] - first_y
        bearing = math.atan2(line_y + second_north - north, line_x + second_east - east)
        # Eq. 10, with the quadrant and without the body's own bearing of that line.
        turn = wrapped(bearing - math.atan2(line_y, line_x))
        # The first pivot stays there. The second goes where heading and known distance put it ("the position of
        # the second castor is updated to be consistent with the pose of the first"): the body's pose holds both.
        x, y = origin_displacement(first_x, first_y, east, north, turn)
        # The castors' headings follow from the new psi and their measured angles, at the next step.
        displace(pose, robot, x, y, turn)


class IPEC(CastorEstimator):
    """Heading from the displacements of two castors, not from how they turned (Doebbler III.B, eq. 10).

    left_out: number of the castor not used, as in IPEC-i; 0 on a robot with two castors. step: see
    `moved`.
    """

    kernel = compiled(__name__, "_advance")

    def __init__(self, left_out: int = 0, step: Step = "arc") -> None:
        super().__init__(step)
        self.left_out = left_out

    @staticmethod
    def variants(robot: RobotDescription) -> tuple[int, ...]:
        """Return the numbers that leave out no castor and each in turn."""
        return tuple(range(len(robot.castors) + 1))

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises InputError where not just two castors remain, or they do not suit."""
        geometry = Geometry.of(robot)
        castors, pivot = several_castors(geometry, self.left_out)
        if len(castors) != 2:
            advice = ": leave out one of them" if len(castors) == 3 and self.left_out == 0 else ""
            raise Declined(f"uses two castors, and {len(castors)} are given{advice}")
        self.begin(geometry, castors, pivot.reshape(*pivot.shape[:-2], 4), pose)


ESTIMATORS = {"ipec": IPEC}
