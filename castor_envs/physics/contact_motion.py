"""How far contacts creep in a motion, by the forces that it needs and by wheels that are driven against each other.

A rolling contact slips at a speed in proportion to its force (`castor_envs.physics.tyre`, in steady rolling)

    s = -(V / C + creep_compliance) F        V rolling speed, C = slip stiffness * load

With A the rows of `castor_envs.motion.kinematics.constraint_matrix`, any deviation delta of the robot's speeds changes
slips by A delta, and Newton's law, M q'' = A' F + gravity, says which slips are true: those that dissipate the least
power. How far wheels disagree does not change with delta, so it is known from what they roll, however well the body's
motion is. Wheels without motor carry no force along; castors turned by a motor add no free speed to delta.

Where a contact's force would be beyond the friction circle it yields as much more as brings it back there. Left out are
bristles that have yet to build up their force (a relaxation length of rolling, as after reversals); but what wheels
disagree is averaged over a part of that way, as at a stop bristles take it up, and no contact creeps.
"""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.geometry.steps import Motion, Slip, integrated
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.weight import castor_center, chassis, wheel_loads

LEAST = 0.02
"""Lowest rolling speed assumed, of the fastest wheel's: bristles average over a relaxation length."""

ROUNDS, CONVERGED = 20, 1e-3
"""Iterations for the yields of sliding contacts: their largest number, and the relative change that ends them."""

EVENED = 0.15
"""Part of a relaxation length over which slip is averaged. Over half of it, slip of contacts that slide is off by up to
2.4 % (`pytest tests/castor_envs/effects/test_slip.py -k slides`); over a twentieth, fits of robots that stop and go do
not settle."""

STANDING = 1e-6
"""m/s: rolling speed of a robot at rest, to divide by."""


@dataclass(frozen=True, eq=False)
class ContactMotion:
    """What the contacts of a robot built as described do in a motion: the `Contacts` that effects are handed."""

    robot: RobotDescription
    motion: Motion

    def of(self, robot: RobotDescription) -> "ContactMotion":
        """Return the contacts of another robot in the same motion."""
        return ContactMotion(robot, self.motion)

    def paths(self) -> Array:
        """Return `contact_paths`."""
        return contact_paths(self.robot, self.motion)

    def places(self) -> Array:
        """Return `contact_places`."""
        return contact_places(self.robot, self.motion)

    def creep(self, floor: Floor | None = None, creep_compliance: float = 0.0) -> Slip:
        """Return `creep` of these contacts; floor None: an even floor."""
        return creep(self.robot, self.motion, floor or Floor(), creep_compliance)


def contact_paths(robot: RobotDescription, motion: Motion) -> Array:
    """Return how far contacts move in each step (K - 1, 2w), m: all along their rolling directions, then to the left.

    Along is what a wheel without slip rolls; to the left is 0 without slip, but for wheels on rollers. Even steps are
    integrated to fourth order in their length: half-way values alone are off by more than wheels that disagree creep.
    """
    geometry = Geometry.of(robot)
    by_body, by_castor = constraint_matrix(geometry, motion.half_way)
    turned = motion.turned[:, np.tile(geometry.wheel_castor, 2)]
    return integrated(by_body, motion.body, motion.even) + by_castor * turned


def contact_places(robot: RobotDescription, motion: Motion) -> Array:
    """Return where in N each wheel touches the floor at every sample (K, w, 2), m."""
    places = []
    for castor, angle in zip(robot.castors, motion.castor_angle.T, strict=True):
        for wheel in castor.wheels:
            arm = np.array(castor.pivot) + rotate(np.array([-castor.offset, wheel.lateral]), angle)
            places.append(motion.pose[:, :2] + rotate(arm, motion.pose[:, 2]))
    return np.stack(places, axis=1)


def creep(robot: RobotDescription, motion: Motion, floor: Floor, creep_compliance: float = 0.0) -> Slip:
    """Return by how much a robot's contacts creep in a motion; arguments as of `ForceBalance`."""
    return ForceBalance(robot, motion, floor, creep_compliance).creep(agree=motion.consistent_wheels)


class ForceBalance:
    """The balance of forces on a robot's contacts in a motion, from which it follows how far they creep."""

    def __init__(self, robot: RobotDescription, motion: Motion, floor: Floor, creep_compliance: float = 0.0) -> None:
        """floor: of it only the slope matters. creep_compliance: m/s for each N, at which contacts slip in addition to
        their creep in rolling. Raises InputError for a robot that cannot stand by itself."""
        geometry, w = Geometry.of(robot), len(robot.wheels)
        by_body, by_castor = constraint_matrix(geometry, motion.half_way)
        of_wheel = np.tile(geometry.wheel_castor, 2)
        path = contact_paths(robot, motion)

        free = np.flatnonzero(~geometry.fixed & ~geometry.driven)
        rows = np.concatenate([by_body, by_castor[..., None] * (of_wheel[:, None] == free)], axis=-1)
        carrying = np.flatnonzero(np.concatenate([~np.isnan(geometry.counts_per_rev), geometry.standard]))

        speed = motion.averaged(np.abs(path[:, :w]) / motion.period[:, None])
        speed = np.maximum(speed, LEAST * speed.max(axis=1, keepdims=True)) + STANDING
        contact, loads = robot.contact, wheel_loads(robot, floor.normal_gravity)
        stiffness = np.concatenate([contact.slip_stiffness_long * loads, contact.slip_stiffness_lat * loads])
        path[:, :w] -= np.diff(motion.wheel_angle, axis=0) * geometry.radius
        self._geometry, self._motion, self._carrying, self._path = geometry, motion, carrying, path
        self._speed, self._relaxation = speed[:, carrying % w], contact.relaxation_length
        self._rows, self._rolling = rows[:, carrying], (np.tile(speed, 2) / stiffness + creep_compliance)[:, carrying]
        self._needed = _needed(robot, motion, floor)[:, [0, 1, 2, *(3 + free)]]
        # Rollers at an angle push aside as well: of a contact's force the part along is limited.
        along = np.sqrt(1.0 + geometry.roller**2)
        self._limits = (contact.friction * loads / along)[carrying % w]
        self._most = np.maximum(speed.max(axis=1, keepdims=True) / (self._rolling * self._limits), 1.0)

    def creep(self, known: Array | None = None, agree: bool = False) -> Slip:
        """Return by how much contacts creep.

        Disagreement between wheels that changes from step to step makes them creep less: bristles absorb it. known
        (K - 1, w): m by which contacts move further than wheels roll for another reason. agree: whether wheels agree,
        so that contacts creep under the forces of the motion alone.
        """
        geometry, w = self._geometry, len(self._geometry.radius)
        if agree:
            speed, _ = self._slipping(np.zeros_like(self._rolling))
        elif known is None:
            speed, _ = self._as_seen
        else:
            speed, _ = self._slipping(self._seen(self._path - np.pad(known, ((0, 0), (0, w)))))
        slip = np.zeros((len(speed), 2 * w))
        slip[:, self._carrying] = speed * self._motion.period[:, None]
        side = np.zeros_like(self._motion.half_way)
        side[:, geometry.wheel_castor[geometry.standard]] = slip[:, w:][:, geometry.standard]
        return Slip(slip[:, :w], side)

    @property
    def yields(self) -> Array:
        """How much contacts yield in each step (K - 1, 2w), m/s for each N, in the order of `contact_paths`: those
        beyond the friction circle by as much as they slide; 0 where a contact carries no force."""
        found = np.zeros(self._path.shape)
        found[:, self._carrying] = self._as_seen[1]
        return found

    @cached_property
    def _as_seen(self) -> tuple[Array, Array]:
        """How fast contacts slip, m/s, and how much they yield (K - 1, rows), where wheels roll as they turn."""
        return self._slipping(self._seen(self._path))

    def _seen(self, path: Array) -> Array:
        """Return how fast contacts are seen to creep (K - 1, rows), m/s, by how far they move beyond what wheels
        roll."""
        slipping = self._motion.averaged(path[:, self._carrying] / self._motion.period[:, None])
        return evened(slipping, self._speed, self._motion.period, EVENED * self._relaxation)

    def _slipping(self, seen: Array) -> tuple[Array, Array]:
        wheel = self._carrying % len(self._geometry.radius)
        return _within_friction(self._rows, seen, self._needed, self._rolling, self._limits, self._most, wheel)


def evened(slipping: Array, speed: Array, period: Array, length: float) -> Array:
    """Return slip speeds (k, rows), m/s, of which the slip for each metre rolled is averaged over a length, m.

    slipping, speed (k, rows): how fast contacts slip, and roll, m/s; period (k,), s. With x the way rolled, the average
    follows s - length^2 d2s/dx2 = what it averages: places count by exp(-|x| / length), and no slip is lost.
    """
    from scipy.linalg import solveh_banded  # slow to import

    rolled, slipped, average = speed * period[:, None], slipping * period[:, None], np.empty_like(slipping)
    held = np.pad(2.0 * length**2 / (rolled[1:] + rolled[:-1]), ((1, 1), (0, 0)))
    for row in range(slipping.shape[1]):
        bands = np.stack([-held[:-1, row], rolled[:, row] + held[:-1, row] + held[1:, row]])
        average[:, row] = solveh_banded(bands, slipped[:, row], check_finite=False)
    return average * speed


def _within_friction(
    rows: Array, seen: Array, needed: Array, yields: Array, limits: Array, most: Array, wheel: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return how fast contacts slip (k, rows), m/s: the `seen` slips, changed by deviation delta; and how much they
    yield (k, rows).

    needed (k, e): forces on all that the rows (k, rows, e) move. yields (k, rows): m/s for each N while a contact
    rolls. limits (rows,): N, of the force along of each row's wheel, whose number is `wheel` (rows,). most (k, rows):
    times as much, a contact yields at most. It then slides, at its limit, as fast as the fastest wheel rolls; a motion
    that needs larger forces is none, and has no slips that could give them.
    """
    slip = _balanced(rows, seen, needed, yields)
    sliding, slack, of_wheel = np.arange(len(rows)), np.ones_like(yields), wheel[:, None] == wheel
    for _ in range(ROUNDS):
        forces = np.sqrt((slip[sliding] / yields[sliding]) ** 2 @ of_wheel)
        slack_needed = np.clip(forces / limits, 1.0, most[sliding])
        moved = np.any(np.abs(slack_needed / slack[sliding] - 1) > CONVERGED, axis=1)
        sliding = sliding[moved]
        if not len(sliding):
            break
        slack[sliding] = slack_needed[moved]
        parts = (part[sliding] for part in (rows, seen, needed, yields * slack))
        slip[sliding] = _balanced(*parts)
    return slip, yields * slack


def _balanced(rows: Array, seen: Array, needed: Array, yields: Array) -> Array:
    """Return the slips (k, rows) that dissipate the least power where contacts yield at rates `yields`."""
    scale = yields.min(axis=1)[:, None]
    held = np.swapaxes(rows, 1, 2) @ (rows * (scale / yields)[..., None])
    force = scale * needed + (np.swapaxes(rows, 1, 2) @ (scale / yields * seen)[..., None])[..., 0]
    return seen - (rows @ _solved(held, force[..., None]))[..., 0]


def _solved(matrices: Array, right: Array) -> Array:
    """Return the solutions (k, e, 1) of least norm of positive semidefinite systems (k, e, e) with sides (k, e, 1)."""
    with suppress(np.linalg.LinAlgError):  # an order of magnitude faster than eigenvalues, where none is zero
        pivots = np.diagonal(np.linalg.cholesky(matrices), axis1=1, axis2=2)
        if np.all(pivots.min(axis=1) > 1e-4 * pivots.max(axis=1)):
            return np.asarray(np.linalg.solve(matrices, right), dtype=np.float64)
    return np.asarray(np.linalg.pinv(matrices, rcond=1e-10, hermitian=True) @ right, dtype=np.float64)


def _needed(robot: RobotDescription, motion: Motion, floor: Floor) -> Array:
    """Return the forces that contacts have to provide in each step (K - 1, 3 + n).

    Force (2, N) and moment about B's origin on all, in B, and the moment about each castor's pivot (N m).
    """
    n = len(robot.castors)
    needed = np.zeros((len(motion.period), 3 + n))
    mass, inertia, center = chassis(robot)
    parts: list[tuple[float, float, Array, int | None]] = [(mass, inertia, np.tile(center, (len(motion.t), 1)), None)]
    for i, castor in enumerate(robot.castors):
        if castor.steering != "fixed":
            trailing = rotate(castor_center(robot, i), motion.castor_angle[:, i])
            parts.append((castor.mass, castor.inertia, np.array(castor.pivot) + trailing, i))
    for mass, inertia, place, castor in parts:
        course = motion.pose[:, :2] + rotate(place, motion.pose[:, 2])
        acceleration = motion.acceleration_of(course) - np.array(floor.downhill_gravity)
        force = mass * motion.in_body(acceleration)
        angle = motion.pose[:, 2] if castor is None else motion.pose[:, 2] + motion.castor_angle[:, castor]
        moment = inertia * motion.acceleration_of(angle)
        needed[:, :2] += force
        needed[:, 2] += moment + _cross((place[1:] + place[:-1]) / 2, force)
        if castor is not None:
            arm = (place[1:] + place[:-1]) / 2 - np.array(robot.castors[castor].pivot)
            needed[:, 3 + castor] = moment + _cross(arm, force)
    return needed


def _cross(arm: Array, force: Array) -> Array:
    return arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
