"""From encoder counts to the movement of each castor's pivot, with which the algorithms of this package start.

Doebbler III.B: "standard odometry equations as given by Borenstein are adapted to compensate for the offset of
the pivot from the wheel axis". A castor with two driven wheels is a differential-drive robot: the foot of its axle
(the axle's point on the centre line) moves along the rolling direction e, the pivot stands `offset` ahead of it.

`CastorEstimator` is what dead reckoning, IPEC and CAST share. Their arithmetic is for one robot at a time and is
compiled (`castor_envs.kernels`).
"""

import math
from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.kernels.arguments import INTEGER, array
from castor_envs.kernels.kernel import Kernel
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.protocol import Observation
from estimators.steps.stacked import Part, Stack

Step = Literal["arc", "midpoint", "euler", "euler-axle"]
ARC, MIDPOINT, EULER, EULER_AXLE = range(4)
"""`Step` as compiled code knows it."""

CASTOR = np.dtype(
    [
        # where its counts stand in an observation: of both wheels, and of its pivot (fixed: any)
        ("left", np.int64),
        ("right", np.int64),
        ("pivot", np.int64),
        # its turn in N, rad, and the way of its foot, m, for a count of each wheel
        ("turn_left", float),
        ("turn_right", float),
        ("roll_left", float),
        ("roll_right", float),
        ("offset", float),
        # theta, its angle against the body, rad, for a count of its pivot and at count 0 (the model's -beta)
        ("angle_per_count", float),
        ("angle_zero", float),
        # state: theta at the sample before, NaN before the first
        ("angle", float),
    ],
    align=True,
)

NO_PIVOTS = np.zeros(1)
"""What a robot without pivot encoders is taken to read: its castors' angles do not depend on it."""


def castor_records(geometry: Geometry, castors: Sequence[int]) -> NDArray[np.void]:
    """Return records (..., n) of type `CASTOR` of some castors, by their indices from 0, before the first sample.

    Raises Declined where a castor lacks two driven standard wheels, or has no pivot encoder and is not fixed.
    """
    driven = np.flatnonzero(~np.isnan(geometry.counts_per_rev))
    encoded = np.flatnonzero(~np.isnan(geometry.pivot_counts_per_rev))
    used = np.array(castors)
    left, right = np.array([_driven_pair(geometry, castor) for castor in castors]).T
    fixed = geometry.fixed[used]

    record = np.zeros((*geometry.offset.shape[:-1], len(used)), CASTOR)
    record["left"], record["right"] = np.searchsorted(driven, left), np.searchsorted(driven, right)
    record["pivot"] = np.where(fixed, 0, np.searchsorted(encoded, used))
    l_left, l_right = geometry.lateral[..., left], geometry.lateral[..., right]
    s_left = 2 * np.pi * geometry.radius[..., left] / geometry.counts_per_rev[left]
    s_right = 2 * np.pi * geometry.radius[..., right] / geometry.counts_per_rev[right]
    track = l_left - l_right
    # A wheel rolls s = ds - lateral * turn: both wheels solved for turn and ds, per count of each wheel.
    record["turn_left"], record["turn_right"] = -s_left / track, s_right / track
    record["roll_left"], record["roll_right"] = -s_left * l_right / track, s_right * l_left / track
    record["offset"] = geometry.offset[..., used]
    record["angle_per_count"] = np.where(fixed, 0.0, 2 * np.pi / geometry.pivot_counts_per_rev[used])
    record["angle_zero"] = np.where(fixed, geometry.angle[..., used], -geometry.pivot_zero[..., used])
    record["angle"] = np.nan
    return record


def moved(castors, robot, i, wheel, pivot, step):
    """Take one sample of castor i of a robot; return its pivot's displacement x, y (m), its turn in N and swivel (rad).

    In the body frame as it stood before. castors (B, n), wheel and pivot, the counts, (B, ...): of all robots, as views
    of single robots take compiled code longer than the arithmetic. The swivel is the change of its
    measured angle against the body, as read: whole turns may be off. step: how the displacement follows from rolled
    distance and turn:

    - arc: the wheels turn evenly between samples, so the foot runs on a circle; no further approximation
    - midpoint: straight along the heading half way
    - euler: straight along the heading at the end (heading first, as Borenstein's text has it), and the pivot's swing
      about the axle, offset times turn, is taken across that heading too
    - euler-axle: the axle as in euler, the pivot's swing about it exact
    """
    castor = castors[robot, i]
    left, right = wheel[robot, castor.left], wheel[robot, castor.right]
    turn = castor.turn_left * left + castor.turn_right * right
    along = castor.roll_left * left + castor.roll_right * right
    across = castor.offset * turn
    after = castor.angle_zero + castor.angle_per_count * pivot[robot, castor.pivot]
    before = after if math.isnan(castor.angle) else castor.angle
    castor.angle = after

    half_way = before + 0.5 * turn
    if step in (ARC, EULER_AXLE):
        # The swing is e+ - e- = sinc(turn / 2) turn n_mid; the chord of the foot's arc is sinc(turn / 2) ds long.
        chord = sinc(0.5 * turn)
        across *= chord
        if step == ARC:
            along *= chord
    bearing = half_way if step in (ARC, MIDPOINT) else before + turn
    cos, sin = math.cos(bearing), math.sin(bearing)
    swing_cos, swing_sin = cos, sin
    if step == EULER_AXLE:
        swing_cos, swing_sin = math.cos(half_way), math.sin(half_way)
    x = cos * along - swing_sin * across
    y = sin * along + swing_cos * across
    return x, y, turn, after - before


class CastorSteps(NamedTuple):
    """One sample's movement of castors, each array of their shape, in the body frame as it stood before.

    x, y: displacement of the pivot, m. turn: change of the castor's heading in N, rad. swivel: change of its measured
    angle against the body, rad, as read: whole turns may be off.
    """

    x: Array
    y: Array
    turn: Array
    swivel: Array


def castor_steps(castors: NDArray[np.void], wheel: Array, pivot: Array = NO_PIVOTS, step: Step = "arc") -> CastorSteps:
    """Take one sample of castors (B, n) of type `CASTOR`; wheel (B, w) and pivot (B, p): counts. See `moved`."""
    found = np.empty((4, *castors.shape))
    pivot = np.ascontiguousarray(np.broadcast_to(pivot, (len(castors), pivot.shape[-1])))
    _ALL_MOVED.bind(castors, np.ascontiguousarray(wheel), pivot, get_args(Step).index(step), found)()
    return CastorSteps(found[0], found[1], found[2], found[3])


def _all_moved(castors, wheel, pivot, step, found):
    for robot in range(castors.shape[0]):
        for i in range(castors.shape[1]):
            one = moved(castors, robot, i, wheel, pivot, step)
            found[0, robot, i], found[1, robot, i], found[2, robot, i], found[3, robot, i] = one


def sinc(angle):
    """Return sin(angle) / angle, 1 at 0; below 0.1 rad by its series, three times as fast and as exact (1e-17)."""
    if abs(angle) > 0.1:
        return math.sin(angle) / angle
    square = angle * angle
    return 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0)))


def displace(pose, robot, x, y, turn):
    """Move the pose of a robot (B, 3) in place by x, y (m) in its own frame and a turn (rad)."""
    cos, sin = math.cos(pose[robot, 2]), math.sin(pose[robot, 2])
    pose[robot, 0] += cos * x - sin * y
    pose[robot, 1] += sin * x + cos * y
    pose[robot, 2] += turn


def origin_displacement(p, q, x, y, turn):
    """Return how the body's origin moves when its point (p, q) moves by x, y and the body turns.

    All lengths in m in the body frame before. Doebbler eqs. 11 and 12 subtracted, without the small angle:
    (x, y) = origin's displacement + (Rot(turn) - 1) (p, q).
    """
    cos, sin = math.cos(turn), math.sin(turn)
    return x + (p - cos * p + sin * q), y + (q - sin * p - cos * q)


def wrapped(angle):
    """Return an angle wrapped into (-pi, pi], rad, as `castor_envs.geometry.se2.wrap` does."""
    return math.pi - (math.pi - angle) % (2 * math.pi)


_ALL_MOVED = Kernel(
    __name__, "_all_moved", (array(CASTOR, 2), array(float, 2), array(float, 2), INTEGER, array(float, 3))
)


def compiled(module: str, name: str) -> Kernel:
    """Return the kernel of an estimator, the function `name(castors, constants, pose, wheel, pivot, step)`.

    It takes a sample of each of B robots and moves their poses (B, 3): castors (B, n) of type `CASTOR`, constants (B,
    c) the estimator's own numbers, wheel and pivot the counts (B, ...), step one of `ARC` to `EULER_AXLE`.
    """
    return Kernel(module, name, (array(CASTOR, 2), *(array(float, 2),) * 4, INTEGER))


class CastorEstimator:
    """What the estimators of castors share: one sample at a time, of one robot or a stack of robots."""

    batched = True
    kernel: ClassVar[Kernel]

    def __init__(self, step: Step = "arc") -> None:
        if step not in get_args(Step):
            raise InputError(f"unknown step {step!r}; known: {', '.join(get_args(Step))}")
        self.step: Step = step

    def begin(self, geometry: Geometry, castors: Sequence[int], constants: Array, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3) with castors, by their indices from 0, and the estimator's constants (..., c)."""
        parts = map(Part, (castor_records(geometry, castors), constants, np.array(pose, dtype=float)))
        self._stack = Stack(self.kernel, geometry, list(parts), [get_args(Step).index(self.step)])

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3); raises InputError where it has another number of counts."""
        self._stack.advance(observation)
        return self._stack.parts[-1].copy()


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
