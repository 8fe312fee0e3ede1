"""CAST: least squares over the pivots of two or more castors, linear in a small turn (Doebbler eqs. 11-22)."""

import math
import warnings

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.steps.castor_odometry import CastorEstimator, Step, compiled, displace, moved, several_castors

LARGEST_DRIFT = 4e-4
"""Of the path: the relative error of wheel radii after calibration, and so of any path (Doebbler's Table I: 0.04 %)."""


class SmallTurnWarning(UserWarning):
    """CAST's small-turn assumption costs more than the errors of calibrated wheels; `CASTArc` does not need it."""


def _advance(castors, solution, pose, wheel, pivot, step):
    """Take one sample; solution (B, 6 n): eq. 15's matrix, row by row. See `compiled`."""
    n = castors.shape[1]
    for robot in range(castors.shape[0]):
        x, y, turn = 0.0, 0.0, 0.0
        for i in range(n):
            east, north, _, _ = moved(castors, robot, i, wheel, pivot, step)
            # Eq. 15, with eq. 16's y: first the x of all pivots, then their y.
            x += solution[robot, i] * east + solution[robot, n + i] * north
            y += solution[robot, 2 * n + i] * east + solution[robot, 3 * n + i] * north
            turn += solution[robot, 4 * n + i] * east + solution[robot, 5 * n + i] * north
        # The castors' headings follow from the new psi and their measured angles, at the next step.
        displace(pose, robot, x, y, turn)


class CAST(CastorEstimator):
    """Pose change that fits the displacements of all pivots best (Doebbler eqs. 13-21), about any body origin.

    left_out: number of the castor not used, as in CAST-i; 0 uses all. step: see `moved`.

    Eq. 13 is linear in the turn of a sample, delta. A pivot at p moves by t + (Rot(delta) - 1) p; from this, least
    squares give sin(delta) for the turn, and t - (1 - cos delta) c for the displacement of the origin, with c the
    centroid of the pivots used. So, with sample period T and turning rate omega,

    - about any origin the heading falls short by delta^2 / 6 of every turn: 0.03 % at 45 deg/s and 20 Hz
    - about an origin off that centroid the position drifts by delta^2 / 2 |c| a sample, omega^2 T |c| / 2 m/s, towards
      the side of the body opposite to c; turning the other way does not undo it, a whole circle does

    `CASTArc` has neither error. `reset` warns (`SmallTurnWarning`) where the second may exceed `LARGEST_DRIFT`; a
    `Geometry`, which has neither a sample period nor speeds, gives no warning.
    """

    kernel = compiled(__name__, "_advance")

    def __init__(self, left_out: int = 0, step: Step = "arc") -> None:
        super().__init__(step)
        self.left_out = left_out

    @staticmethod
    def variants(robot: RobotDescription) -> tuple[int, ...]:
        """Return the numbers that leave out each castor in turn, and none."""
        return (*range(1, len(robot.castors) + 1), 0)

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises InputError where the castors used do not suit or are fewer than two."""
        geometry = Geometry.of(robot)
        castors, pivot = several_castors(geometry, self.left_out)
        # In the body frame before the step psi- is 0: H is always the same, and eq. 15 one fixed matrix.
        h = design_matrix(pivot, 0.0)
        solution = normal_inverse(pivot, 0.0) @ np.swapaxes(h, -1, -2)
        self.begin(geometry, castors, solution.reshape(*solution.shape[:-2], -1), pose)
        if isinstance(robot, RobotDescription):
            self._warn(robot)

    def _warn(self, robot: RobotDescription) -> None:
        drift = small_turn_drift(robot, self.left_out)
        if drift > LARGEST_DRIFT:
            warnings.warn(
                f"CAST-{self.left_out} takes every turn as small, and the centroid of the pivots it uses is not the "
                f"origin of robot {robot.name!r}: at its top speed it may drift by {100 * drift:.2g} % of the path; "
                f"use cast-arc-{self.left_out} (CASTArc)",
                SmallTurnWarning,
                stacklevel=3,
            )


def small_turn_drift(robot: RobotDescription, left_out: int = 0) -> float:
    """Return CAST's drift by its small-turn assumption, as a part of the path, driven as fast as the wheels allow.

    That is omega^2 T |c| / 2 (see `CAST`) over v, where half of the wheels' top speed V drives the body and half turns
    it: v = V / 2, omega = V / (2 R), with R the distance of the farthest pivot from the origin; so V T |c| / (4 R^2).
    Raises InputError as `CAST.reset` does.
    """
    castors, pivot = several_castors(Geometry.of(robot), left_out)
    speed = robot.max_wheel_speed * max(wheel.radius for i in castors for wheel in robot.castors[i].wheels)
    away = math.hypot(*pivot.mean(axis=0).tolist())
    return speed * robot.sample_period * away / (4 * float(np.max(np.sum(pivot**2, axis=-1))))


def design_matrix(pivot: Array, psi: ArrayLike) -> Array:
    """Return H (..., 2n, 3) of eq. 17 for pivots (..., n, 2) in B at heading psi (...): rows of eq. 13, then 14."""
    x, y = pivot[..., 0], pivot[..., 1]  # R cos phi, R sin phi
    cos, sin = np.cos(psi)[..., None], np.sin(psi)[..., None]
    east = x * cos - y * sin  # R cos(psi- + phi)
    north = y * cos + x * sin  # R sin(psi- + phi)
    ones, zeros = np.ones_like(east), np.zeros_like(east)
    return np.concatenate([np.stack([ones, zeros, -north], -1), np.stack([zeros, ones, east], -1)], axis=-2)


def normal_inverse(pivot: Array, psi: ArrayLike) -> Array:
    """Return (H^T H)^-1 (..., 3, 3) by eqs. 18-21, with m_y in eq. 19 where the print has m_v."""
    n = pivot.shape[-2]
    m_x, m_y = pivot[..., 0].mean(axis=-1), pivot[..., 1].mean(axis=-1)
    b = -n * (m_y * np.cos(psi) + m_x * np.sin(psi))  # eq. 19
    c = n * (m_x * np.cos(psi) - m_y * np.sin(psi))  # eq. 20
    d = np.sum(pivot**2, axis=(-1, -2)) + 0.0 * b  # eq. 21, of the shape of the others
    rows = [
        [c**2 - n * d, -b * c, n * b],
        [-b * c, b**2 - n * d, n * c],
        [n * b, n * c, np.full_like(b, -(n**2))],
    ]
    matrix = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return matrix / (n * (b**2 + c**2 - n * d))[..., None, None]  # eq. 18


def centred_solution(pivot: Array, psi: ArrayLike, x: Array, y: Array) -> Array:
    """Return the changes (..., 3) of x_c, y_c and psi by eq. 22, for displacements x, y (..., n) of the pivots in N.

    Right only where the body's origin is the centroid of the pivots and all stand at one distance R from it (the
    print names the first condition alone). `CAST` uses the general solution, which is equal there.
    """
    radius, phi = np.hypot(pivot[..., 0], pivot[..., 1]), np.arctan2(pivot[..., 1], pivot[..., 0])
    bearing = np.asarray(psi)[..., None] + phi
    turns = (y * np.cos(bearing) - x * np.sin(bearing)) / radius
    return np.stack([x.mean(axis=-1), y.mean(axis=-1), turns.mean(axis=-1)], axis=-1)


ESTIMATORS = {"cast": CAST}
