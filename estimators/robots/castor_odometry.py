"""From encoder counts to the movement of each castor's pivot, with which the algorithms of this package start.

Doebbler III.B: "standard odometry equations as given by Borenstein are adapted to compensate for the offset of
the pivot from the wheel axis". A castor with two driven wheels is a differential-drive robot: the foot of its axle
(the axle's point on the centre line) moves along the rolling direction e, the pivot stands `offset` ahead of it.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation

Step = Literal["arc", "midpoint", "euler", "euler-axle"]


class CastorSteps(NamedTuple):
    """One sample's movement of n castors, each array (..., n), in the body frame as it stood before.

    x, y: displacement of the pivot, m. turn: change of the castor's heading in N, rad. swivel: change of its measured
    angle against the body, rad, as read: whole turns may be off.
    """

    x: Array
    y: Array
    turn: Array
    swivel: Array


class CastorOdometry:
    """Reads encoder counts of some castors of a robot, sample by sample. Arithmetic broadcasts.

    castors: their indices from 0. step: how the displacement in a sample follows from rolled distance and turn:

    - "arc": the wheels turn evenly between samples, so the foot runs on a circle; no further approximation
    - "midpoint": straight along the heading half way
    - "euler": straight along the heading at the end (heading first, as Borenstein's text has it), and the pivot's swing
      about the axle, offset times turn, is taken across that heading too
    - "euler-axle": the axle as in "euler", the pivot's swing about it exact

    Raises Declined where a castor lacks two driven standard wheels, or has no pivot encoder and is not fixed.
    """

    def __init__(self, geometry: Geometry, castors: Sequence[int], step: Step = "arc") -> None:
        if step not in get_args(Step):
            raise InputError(f"unknown step {step!r}; known: {', '.join(get_args(Step))}")
        driven = np.flatnonzero(~np.isnan(geometry.counts_per_rev))
        encoded = np.flatnonzero(~np.isnan(geometry.pivot_counts_per_rev))
        used = np.array(castors)
        left, right = np.array([_driven_pair(geometry, castor) for castor in castors]).T

        self._left, self._right = np.searchsorted(driven, left), np.searchsorted(driven, right)
        l_left, l_right = geometry.lateral[..., left], geometry.lateral[..., right]
        s_left = 2 * np.pi * geometry.radius[..., left] / geometry.counts_per_rev[left]
        s_right = 2 * np.pi * geometry.radius[..., right] / geometry.counts_per_rev[right]
        track = l_left - l_right
        # A wheel rolls s = ds - lateral * turn: both wheels solved for turn and ds, per count of each wheel.
        self._turn_left, self._turn_right = -s_left / track, s_right / track
        self._roll_left, self._roll_right = -s_left * l_right / track, s_right * l_left / track
        self._offset = geometry.offset[..., used]

        fixed = geometry.fixed[used]
        self._reads_pivots = not fixed.all()
        self._pivot = np.where(fixed, 0, np.searchsorted(encoded, used))
        self._angle_per_count = np.where(fixed, 0.0, 2 * np.pi / geometry.pivot_counts_per_rev[used])
        self._angle_zero = np.where(fixed, geometry.angle[..., used], -geometry.pivot_zero[..., used])
        self._angle: Array | None = None

        self._exact_roll, self._exact_swing = step == "arc", step in ("arc", "euler-axle")
        self._direction = 1.0 if step.startswith("euler") else 0.5

    def advance(self, observation: Observation) -> CastorSteps:
        """Take one sample and return what the castors did since the one before."""
        wheel = observation["wheel"]
        left, right = wheel[..., self._left], wheel[..., self._right]
        turn = self._turn_left * left + self._turn_right * right
        along = self._roll_left * left + self._roll_right * right
        across = self._offset * turn
        if self._exact_swing:
            # The swing is e+ - e- = sinc(turn / 2) turn n_mid; the chord of the foot's arc is sinc(turn / 2) ds long.
            chord = _sinc(0.5 * turn)
            across = chord * across
            if self._exact_roll:
                along = chord * along

        after = self._angles(observation)
        before = after if self._angle is None else self._angle
        self._angle = after
        bearing = before + self._direction * turn
        cos, sin = np.cos(bearing), np.sin(bearing)
        swing_cos, swing_sin = cos, sin
        if self._exact_swing and not self._exact_roll:
            # The axle moves along `bearing`, the swing is taken at the middle heading.
            swing_cos, swing_sin = np.cos(before + 0.5 * turn), np.sin(before + 0.5 * turn)
        return CastorSteps(cos * along - swing_sin * across, sin * along + swing_cos * across, turn, after - before)

    def _angles(self, observation: Observation) -> Array:
        """Return theta (..., n): gamma minus the model's beta; of a fixed castor the angle it is mounted at."""
        if not self._reads_pivots:
            return self._angle_zero
        return observation["pivot"][..., self._pivot] * self._angle_per_count + self._angle_zero


def several_castors(geometry: Geometry, left_out: int) -> tuple[tuple[int, ...], Array]:
    """Return indices (from 0) and pivots (..., n, 2) of all castors but number `left_out` (from 1; 0: none).

    Raises Declined where there is no such castor, fewer than two remain, or those that remain share one pivot.
    """
    if not 0 <= left_out <= geometry.n_castors:
        raise Declined(f"there is no castor {left_out} to leave out; the robot has {geometry.n_castors}")
    castors = tuple(castor for castor in range(geometry.n_castors) if castor != left_out - 1)
    if len(castors) < 2:
        without = f" without castor {left_out}" if left_out else ""
        raise Declined(f"needs at least two castors; the robot{without} has {len(castors)}")
    pivot = geometry.pivot[..., castors, :]
    if np.any(np.all(pivot == pivot[..., :1, :], axis=(-1, -2))):
        raise Declined("needs castors whose pivots stand apart; here all have the same pivot")
    return castors, pivot


def start(robot: RobotDescription | Geometry, pose: ArrayLike) -> tuple[Geometry, Array]:
    """Return the robot's geometry and a copy of the start pose (..., 3), m and rad."""
    return Geometry.of(robot), np.array(pose, dtype=float)


def displaced(pose: Array, x: Array, y: Array, turn: Array) -> Array:
    """Return the pose (..., 3) after a displacement x, y (m) in its own frame and a turn (rad)."""
    psi = pose[..., 2]
    cos, sin = np.cos(psi), np.sin(psi)
    new_x = pose[..., 0] + (cos * x - sin * y)
    new = np.empty((*new_x.shape, 3))
    new[..., 0], new[..., 1], new[..., 2] = new_x, pose[..., 1] + (sin * x + cos * y), psi + turn
    return new


def origin_displacement(point: tuple[Array, Array], x: Array, y: Array, turn: Array) -> tuple[Array, Array]:
    """Return how the body's origin moves when `point` of the body moves by x, y and the body turns.

    All lengths in m in the body frame before. Doebbler eqs. 11 and 12 subtracted, without the small angle:
    (x, y) = origin's displacement + (Rot(turn) - 1) point.
    """
    cos, sin = np.cos(turn), np.sin(turn)
    p, q = point
    return x + (p - cos * p + sin * q), y + (q - sin * p - cos * q)


def _sinc(angle: Array) -> Array:
    """Return sin(angle) / angle, 1 at 0."""
    angle = np.where(angle == 0.0, 1e-20, angle)
    return np.sin(angle) / angle


def _driven_pair(geometry: Geometry, castor: int) -> tuple[int, int]:
    """Return a castor's two driven wheels, left and right; raises InputError where it does not suit."""
    number = castor + 1
    pair = np.flatnonzero((geometry.wheel_castor == castor) & ~np.isnan(geometry.counts_per_rev))
    if len(pair) != 2:
        raise Declined(f"needs two driven wheels on castor {number}; there {_are(len(pair))}")
    if not geometry.standard[pair].all():
        raise Declined(f"needs driven wheels with grip 'standard' on castor {number}; there are omni wheels")
    if not geometry.fixed[castor] and np.isnan(geometry.pivot_counts_per_rev[castor]):
        raise Declined(f"needs a pivot encoder on castor {number}, which is not fixed; there is none")
    return int(pair[0]), int(pair[1])


def _are(number: int) -> str:
    return "is 1" if number == 1 else f"are {number}"
