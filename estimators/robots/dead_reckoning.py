"""Dead reckoning by one castor, without a second castor to correct the first."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.robots.castor_odometry import CastorOdometry, Step, displaced, origin_displacement, start


class DeadReckoning:
    """Heading and position from a single castor (Doebbler III.B), on which IPEC and CAST improve.

    The body turns as much as the castor does by its two wheels, minus the castor's swivel against the body. On a fixed
    castor this is the odometry of a differential drive, with exact arcs. castor: its number, from 1. step: see
    `CastorOdometry`.
    """

    batched = True

    def __init__(self, castor: int = 1, step: Step = "arc") -> None:
        self.castor = castor
        self.step: Step = step

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
        geometry, self._pose = start(robot, pose)
        if not 1 <= self.castor <= geometry.n_castors:
            raise Declined(f"there is no castor {self.castor}; the robot has {geometry.n_castors}")
        self._castor = CastorOdometry(geometry, [self.castor - 1], self.step)
        pivot = geometry.pivot[..., self.castor - 1, :]
        self._pivot = pivot[..., 0], pivot[..., 1]

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        steps = self._castor.advance(observation)
        # The castor's heading in N is psi + theta (Doebbler II.D): the body turns by the difference.
        turn = (steps.turn - wrap(steps.swivel))[..., 0]
        # The pivot is a point of the body, whose origin follows from it (Doebbler eqs. 11-12).
        x, y = origin_displacement(self._pivot, steps.x[..., 0], steps.y[..., 0], turn)
        self._pose = displaced(self._pose, x, y, turn)
        return self._pose.copy()


ESTIMATORS = {"dead-reckoning": DeadReckoning}
