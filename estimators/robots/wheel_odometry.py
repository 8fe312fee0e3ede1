"""Odometry of any robot: weighted least squares over all rolling and no-side-slip equations of a sample.

The equations are those of `rolling_equations`. Equally weighted and with straight steps this is the odometry of
Holmberg and Khatib, "Development and Control of a Holonomic Mobile Robot for Mobile Manipulation Tasks", Int. J. of
Robotics Research 19 (2000). TidyBot++ (Wu et al. 2024) runs it with the pivot angles read last.
"""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.kernels.arguments import INTEGER, REAL, array
from castor_envs.kernels.kernel import Kernel
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.steps.castor_odometry import displace
from estimators.steps.rolling_equations import CASTOR, NUMBERS, ROW, Rows, set_up, solved, swivelled, went
from estimators.steps.stacked import Part, Stack


def _advance(castors, rows, pose, wheel, pivot, equations, at, arc):
    """Take one sample of each of B robots and move their poses (B, 3).

    castors (B, n) and rows (B, m): of types `CASTOR` and `ROW`. wheel and pivot: the counts (B, ...). equations (1, m,
    7): room for those of one robot. at: where in the step castor angles are taken, 0.5 half-way, 1.0 at its end. arc:
    0 for straight steps.
    """
    for robot in range(castors.shape[0]):
        swivelled(castors, robot, pivot, at)
        set_up(castors, rows, robot, wheel, equations, 0, arc)
        x, y, turn = solved(equations, 0, arc)
        if arc:
            went(castors, robot, x, y, turn)
        pose[robot, 2] += 0.5 * turn
        displace(pose, robot, x, y, 0.5 * turn)


_ADVANCE = Kernel(
    __name__,
    "_advance",
    (array(CASTOR, 2), array(ROW, 2), *(array(float, 2),) * 3, array(float, 3), REAL, INTEGER),
)


class WheelOdometry:
    """Weighted least squares over all equations of a sample, for every robot whose wheels determine its motion.

    Weights are by what the description implies (`Rows.variances`). Exact where wheels and castors turn evenly within
    samples; else the error falls with the square of the sample period. When to use: any robot; it knows no slip and
    learns nothing.
    """

    batched = True
    at = 0.5
    arc = True

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises Declined where the wheels do not determine how the robot moves."""
        geometry = Geometry.of(robot)
        rows = Rows.of(geometry)
        parts = *rows.records(self._weights(rows)), np.array(pose, dtype=float)
        room = np.zeros((1, len(rows.castor), NUMBERS))
        self._stack = Stack(_ADVANCE, geometry, list(map(Part, parts)), (room, self.at, int(self.arc)))

    def _weights(self, rows: Rows) -> Array:
        return 1.0 / rows.variances()

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3); raises InputError where it has another number of counts."""
        self._stack.advance(observation)
        return self._stack.parts[-1].copy()


class HolmbergKhatib(WheelOdometry):
    """All rolling and no-side-slip equations of all wheels equally weighted, at the castor angles half-way.

    Holmberg and Khatib (2000). Steps are straight, along the heading half-way.
    """

    arc = False

    def _weights(self, rows: Rows) -> Array:
        return rows.contacts


class TidyBot(HolmbergKhatib):
    """The same at the castor angles read last, as the base of TidyBot++ runs it: first order in the sample period."""

    at = 1.0


ESTIMATORS = {"wheel-odometry": WheelOdometry, "holmberg-khatib": HolmbergKhatib, "tidybot": TidyBot}
