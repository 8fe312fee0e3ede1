"""Dead reckoning by one castor, without a second castor to correct the first."""

import numpy as np
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
    wrapped,
)


def _advance(castors, pivots, pose, wheel, pivot, step):
    """Take one sample; pivots (B, 2): x and y of the castor's. See `compiled`."""
    for robot in range(castors.shape[0]):
        east, north, turn_of_castor, swivel = moved(castors, robot, 0, wheel, pivot, step)
        # The castor's heading in N is psi + theta (Doebbler II.D): the body turns by the difference.
        turn = turn_of_castor - wrapped(swivel)
        # The pivot is a point of the body, whose origin follows from it (Doebbler eqs. 11-12).
        x, y = origin_displacement(pivots[robot, 0], pivots[robot, 1], east, north, turn)
        displace(pose, robot, x, y, turn)


class DeadReckoning(CastorEstimator):
    """Heading and position from a single castor (Doebbler III.B), on which IPEC and CAST improve.

    The body turns as much as the castor does by its two wheels, minus the castor's swivel against the body. On a fixed
    castor this is the odometry of a differential drive, with exact arcs. castor: its number, from 1. step: see
    `moved`.
    """

    kernel = compiled(__name__, "_advance")

    def __init__(self, castor: int = 1, step: Step = "arc") -> None:
        super().__init__(step)
        self.castor = castor

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple[int, ...]:
        """Return the number of the first castor that suits, if one does."""
        for castor in range(1, len(robot.castors) + 1):
            try:
                cls(castor).reset(robot, np.zeros(3))
            except Declined:
                continue
            return (castor,)
        return ()

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises InputError where the robot lacks the castor or it does not suit."""
        geometry = Geometry.of(robot)
        if not 1 <= self.castor <= geometry.n_castors:
            raise Declined(f"there is no castor {self.castor}; the robot has {geometry.n_castors}")
        self.begin(geometry, [self.castor - 1], geometry.pivot[..., self.castor - 1, :], pose)


ESTIMATORS = {"dead-reckoning": DeadReckoning}
