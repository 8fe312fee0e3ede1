"""Odometry of any robot: weighted least squares over all rolling and no-side-slip equations of a sample.

The equations are those of `castor_envs.motion.kinematics`, integrated over one sample. Where wheels and castors turn
evenly in it, each pivot runs on a circle, and in the body's axes as they stand half-way

    g . t + (g . J p - h cos(d_theta / 2)) a = sinc(turn / 2) rolled + 2 h cos(d_psi / 2) sin(d_theta / 2)

holds exactly, with t the displacement of the body's origin, d_psi its turn and a = 2 sin(d_psi / 2), p the pivot and J
the turn by +90 degrees, d_theta the castor's swivel against the body, turn = d_psi + d_theta its turn in N, and with e
and n the castor's rolling direction half-way and its left:

    rolling        g = e + tan(roller angle) n    h = lateral + tan(roller angle) offset    rolled = radius d_phi
    no side slip   g = n                          h = offset                                rolled = 0

Equally weighted and with straight steps (cosines and sinc 1, sines their angles) this is the odometry of Holmberg and
Khatib, "Development and Control of a Holonomic Mobile Robot for Mobile Manipulation Tasks", Int. J. of Robotics
Research 19 (2000). TidyBot++ (Wu et al. 2024) runs it with the pivot angles read last.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array, vectors
from castor_envs.geometry.se2 import wrap
from castor_envs.motion.kinematics import Geometry, left_of, unit
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.robots.castor_odometry import displaced, start

RADIUS, LATERAL, OFFSET = 4e-4, 4e-4, 9e-4
ANGLE = math.radians(0.01)
"""Relative errors of lengths, and rad, that calibration leaves: means of Doebbler's Table I. Normal driving makes
wheels slip along their rolling direction by about as much as their radii are off, and hardly sideways."""

TURNS, SWIVEL = 4, 1.0
"""Revolutions of a wheel, and rad that a castor swivels, over which errors of equations are compared: those of
dimensions grow on the way, those of wheels' rounded counts do not, and those of pivots' counts average out."""

REFINEMENTS = 6
"""Times that the right sides are computed anew from the turn found: where the body turns by half a radian in a sample,
which is more than any does, an error of 1e-10 is left."""

SINGULAR = 1e-12
"""Of the largest eigenvalue of the normal matrix: below it a motion counts as undetermined, and is taken as small."""


class Equations(NamedTuple):
    """The m equations of one sample, for (t_x, t_y, a): matrix (..., m, 3) and what both right sides are made of.

    rolled (..., m): m. arm (..., m): h, m. swivel (..., m): d_theta, rad.
    """

    matrix: Array
    rolled: Array
    arm: Array
    swivel: Array

    def right(self, turn: Array, arc: bool = True) -> Array:
        """Return the right sides (..., m), m, where the body turns by `turn` (...), rad; arc False: straight steps."""
        if not arc:
            return self.rolled + self.arm * self.swivel
        turn = turn[..., None]
        chord = np.sinc((turn + self.swivel) / (2 * np.pi))
        return chord * self.rolled + 2 * self.arm * np.cos(turn / 2) * np.sin(self.swivel / 2)


class EquationsOfSamples:
    """Sets up the equations of one sample after another from encoder readings. Arithmetic broadcasts.

    geometry: the robot. at: where in the step castor angles are taken, 0.5 half-way, 1.0 at its end. Rows are first the
    rolling of each wheel with an encoder (`wheels`), then no side slip of each castor with a standard wheel
    (`castors`); `castor` is the castor of each row. Castors whose angle nobody knows are left out. Raises Declined if
    the equations do not determine how the body moves at any angles of the castors.
    """

    def __init__(self, geometry: Geometry, at: float = 0.5, arc: bool = True) -> None:
        known = geometry.fixed | ~np.isnan(geometry.pivot_counts_per_rev)
        driven = ~np.isnan(geometry.counts_per_rev)
        standard = np.bincount(geometry.wheel_castor, weights=geometry.standard, minlength=geometry.n_castors)
        self.geometry, self._at, self._arc = geometry, at, arc
        self.wheels = np.flatnonzero(driven & known[geometry.wheel_castor])
        self.castors = np.flatnonzero((standard > 0) & known)
        self.castor = np.concatenate([geometry.wheel_castor[self.wheels], self.castors])
        self.standard_wheels = standard[self.castors].astype(np.float64)
        self.read_wheels = np.searchsorted(np.flatnonzero(driven), self.wheels)
        self.angle_per_count = 2 * np.pi / geometry.counts_per_rev[self.wheels]
        roller = geometry.roller[..., self.wheels]
        self.roller = np.concatenate([roller, np.zeros((*roller.shape[:-1], len(self.castors)))], axis=-1)
        of_wheels = geometry.lateral[..., self.wheels] + roller * geometry.offset[..., self.castor[: len(self.wheels)]]
        self.arm = np.concatenate([of_wheels, geometry.offset[..., self.castors]], axis=-1)
        self._left_of_pivot = geometry.left_of_pivot[..., self.castor, :]
        self._angle: Array | None = None
        self._determined()

    def _determined(self) -> None:
        """Raise Declined if the motion is undetermined at any of some angles: at special ones it may always be."""
        if len(self.castor) == 0:
            raise Declined("needs wheels with encoders or standard wheels, on castors whose angles are known; has none")
        angle = np.where(self.geometry.fixed, self.geometry.angle, np.arange(1.0, 1.0 + self.geometry.n_castors))
        matrix = self._matrix(angle, np.zeros_like(angle))
        if np.any(np.linalg.matrix_rank(matrix, tol=1e-6) < 3):
            raise Declined(
                "needs wheels that determine how the body moves; here it may move though no wheel with an encoder "
                "turns, no castor with one swivels and no standard wheel slips sideways"
            )

    def read(self, observation: Observation) -> Equations:
        """Take one sample and return its equations; the first is taken to have begun at the angles that it shows."""
        after = castor_angles(self.geometry, observation.get("pivot", np.empty(0)))
        before = after if self._angle is None else self._angle
        self._angle = after
        swivel = wrap(after - before)
        matrix = self._matrix(after - (1.0 - self._at) * swivel, swivel)
        rolled = np.zeros(matrix.shape[:-1])
        wheel = observation["wheel"][..., self.read_wheels] * self.angle_per_count
        rolled[..., : len(self.wheels)] = wheel * self.geometry.radius[..., self.wheels]
        return Equations(matrix, rolled, self.arm, swivel[..., self.castor])

    def _matrix(self, angle: Array, swivel: Array) -> Array:
        """Return the matrix (..., m, 3) at castor angles (..., n) of castors that swivel by (..., n)."""
        e = unit(angle)[..., self.castor, :]
        across = len(self.wheels)
        direction = e + self.roller[..., None] * left_of(e)
        direction[..., across:, :] = left_of(e[..., across:, :])
        swing = self.arm * np.cos(swivel[..., self.castor] / 2) if self._arc else self.arm
        leverage = np.sum(self._left_of_pivot * direction, axis=-1) - swing
        return vectors(direction[..., 0], direction[..., 1], leverage)

    def variances(self) -> Array:
        """Return the variance (..., m) of each equation, m2, over `TURNS` and `SWIVEL`.

        Wheels' counts are rounded at both ends; dimensions are off by `RADIUS`, `LATERAL`, `OFFSET` and `ANGLE`.
        """
        geometry = self.geometry
        count = geometry.radius[..., self.wheels] * self.angle_per_count
        swivel = np.where(geometry.fixed, 0.0, SWIVEL)
        by_lateral = LATERAL * geometry.lateral[..., self.wheels] * swivel[geometry.wheel_castor[self.wheels]]
        by_offset = OFFSET * geometry.offset[..., self.castors] * swivel[self.castors]
        way = 2 * np.pi * TURNS * geometry.radius
        on = geometry.wheel_castor == self.castors[:, None]
        across = way @ (on / on.sum(axis=1, keepdims=True)).T  # mean of each castor's wheels
        rolling = count**2 / 6 + (RADIUS * way[..., self.wheels]) ** 2 + by_lateral**2
        return np.concatenate([rolling, (ANGLE * across) ** 2 + by_offset**2], axis=-1)


class Motion(NamedTuple):
    """The body's motion in one sample: displacement (..., 2) in the axes half-way, m, and turn (...), rad."""

    displacement: Array
    turn: Array


def solve(equations: Equations, weight: Array, arc: bool = True) -> Motion:
    """Return the motion that fits equations with weights (..., m), 1 / variance up to a factor, best.

    Motions that the equations do not determine at these angles are taken as small.
    """
    weighted = np.swapaxes(equations.matrix * weight[..., None], -1, -2)
    normal = weighted @ equations.matrix
    size = np.trace(normal, axis1=-2, axis2=-1)
    solution = np.linalg.solve(normal + SINGULAR * size[..., None, None] * np.eye(3), weighted)
    turn, found = np.zeros(equations.rolled.shape[:-1]), np.zeros(3)
    for _ in range(REFINEMENTS if arc else 1):
        found = np.einsum("...ij,...j->...i", solution, equations.right(turn, arc))
        turn = 2 * np.arcsin(np.clip(found[..., 2] / 2, -1.0, 1.0)) if arc else found[..., 2]
    return Motion(found[..., :2], turn)


def moved(pose: Array, motion: Motion) -> Array:
    """Return the pose (..., 3) after a motion."""
    half_way = pose + np.multiply.outer(motion.turn, (0.0, 0.0, 0.5))
    return displaced(half_way, motion.displacement[..., 0], motion.displacement[..., 1], motion.turn / 2)


class WheelOdometry:
    """Weighted least squares over all equations of a sample, for every robot whose wheels determine its motion.

    Weights are by what the description implies (`EquationsOfSamples.variances`). Exact where wheels and castors turn
    evenly within samples; else the error falls with the square of the sample period. When to use: any robot; it knows
    no slip and learns nothing.
    """

    batched = True
    at = 0.5
    arc = True

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises Declined where the wheels do not determine how the robot moves."""
        geometry, self._pose = start(robot, pose)
        self._equations = EquationsOfSamples(geometry, self.at, self.arc)
        self._weight = self._weights(self._equations)

    def _weights(self, equations: EquationsOfSamples) -> Array:
        return 1.0 / equations.variances()

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        self._pose = moved(self._pose, solve(self._equations.read(observation), self._weight, self.arc))
        return self._pose.copy()


class HolmbergKhatib(WheelOdometry):
    """All rolling and no-side-slip equations of all wheels equally weighted, at the castor angles half-way.

    Holmberg and Khatib (2000). Steps are straight, along the heading half-way.
    """

    arc = False

    def _weights(self, equations: EquationsOfSamples) -> Array:
        """Return 1 for each wheel that has the equation: two wheels on one axle both forbid its side slip."""
        return np.concatenate([np.ones(len(equations.wheels)), equations.standard_wheels])


class TidyBot(HolmbergKhatib):
    """The same at the castor angles read last, as the base of TidyBot++ runs it: first order in the sample period."""

    at = 1.0


ESTIMATORS = {"wheel-odometry": WheelOdometry, "holmberg-khatib": HolmbergKhatib, "tidybot": TidyBot}
