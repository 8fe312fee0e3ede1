"""What a robot's wheels allow and show: the motions that it can make, and the constraints that its encoders determine.

Sources: degree of mobility and instantaneous centre of rotation after Campion, Bastin and D'Andrea-Novel, "Structural
Properties and Classification of Kinematic and Dynamic Models of Wheeled Mobile Robots", IEEE Transactions on Robotics
and Automation 12(1), 1996; the constraints are those of `castor_envs.motion.kinematics`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import KinematicController
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.motion.rolling import SIDEWAYS
from castor_envs.motion.trajectories import Run, Trajectory
from castor_envs.vehicles.robot import RobotDescription

AHEAD, ON_THE_SPOT = "m/s", "rad/s"
"""Units of speeds of runs: of those that go somewhere, and of turns on the spot."""

RANK = 1e-9
"""Singular values below this are 0. Rows are numbers near 1 and lengths in m, to a micrometre."""
SIDEWAYS_COST = 1e-3
"""Weight of sideways motion where `Mobility.nearest` has to give something up: of all, it is given up first."""


class Rows(NamedTuple):
    """The constraints in use, first the rolling of wheels (w,), then the side slip of castors (c,), by their indices
    (from 0). place, castor (w + c,): the row in `constraint_matrix`, and whose it is."""

    wheels: NDArray[np.intp]
    castors: NDArray[np.intp]
    place: NDArray[np.intp]
    castor: NDArray[np.intp]


def rows_in_use(geometry: Geometry, without_wheels: Sequence[int] = (), without_castors: Sequence[int] = ()) -> Rows:
    """Return the constraints that encoders determine, but for encoders of these wheels and pivots of these castors.

    A castor's rows are used where its angle is known: it is fixed or has a pivot encoder. The side slip of a
    castor's wheels is one row, as they stand on one axle, and is left out where all of them are omni wheels.
    """
    pointed = geometry.fixed | ~np.isnan(geometry.pivot_counts_per_rev)
    pointed[list(without_castors)] = False
    known = pointed[geometry.wheel_castor]
    wheels = np.setdiff1d(np.flatnonzero(known & ~np.isnan(geometry.counts_per_rev)), without_wheels)
    standard = np.flatnonzero(known & geometry.standard)
    castors, first = np.unique(geometry.wheel_castor[standard], return_index=True)
    return Rows(
        wheels=wheels,
        castors=castors,
        place=np.concatenate([wheels, len(geometry.wheel_castor) + standard[first]]),
        castor=np.concatenate([geometry.wheel_castor[wheels], castors]),
    )


@dataclass(frozen=True, eq=False)
class Mobility:
    """What one robot's wheels allow and show.

    motions (k, 3): an orthonormal basis of the twists (v_x, v_y, omega in B) in which no fixed wheel slips sideways.
    steered: indices of the castors that have to be turned first, since they do not trail. measured: how many
    constraints its encoders determine at a moment, and determined: how many of the three parts of a motion these fix.
    """

    motions: Array
    steered: tuple[int, ...]
    measured: int
    determined: int

    @classmethod
    def of(cls, robot: RobotDescription) -> "Mobility":
        """Return the mobility of a robot whose castors stand at no special angle."""
        geometry = Geometry.of(robot)
        all_rows, _ = constraint_matrix(geometry, _no_special_angles(geometry))
        held = geometry.fixed[geometry.wheel_castor] & geometry.standard
        _, size, motions = np.linalg.svd(all_rows[len(held) :][held])
        rows = rows_in_use(geometry)
        return cls(
            motions=motions[int(np.sum(size > RANK)) :],
            steered=tuple(np.flatnonzero(geometry.driven & ~geometry.trailing).tolist()),
            measured=len(rows.place),
            determined=int(np.linalg.matrix_rank(all_rows[rows.place], tol=RANK)) if len(rows.place) else 0,
        )

    @property
    def freedom(self) -> int:
        """How many of forward, sideways and turning are independent: 3 of omnidirectional robots, 2 of most others."""
        return len(self.motions)

    @property
    def redundancy(self) -> int:
        """How many constraints the encoders determine beyond those that the motion needs: what errors show in."""
        return self.measured - self.determined

    @property
    def omnidirectional(self) -> bool:
        """Whether it can move in any direction and turn at the same time."""
        return self.freedom == 3

    @cached_property
    def center(self) -> tuple[Array, Array | None] | None:
        """Where the instantaneous centre of rotation may be: a point (2,) in B, m, and the direction (2,) of the line
        through it, None where there is no other point; None where it may be anywhere or nowhere."""
        turning = [motion for motion in self.motions if abs(motion[2]) > RANK]
        if self.freedom in (0, 3) or not turning:
            return None
        # The centre of a twist is where its velocity is 0: (-v_y, v_x) / omega.
        fastest = max(turning, key=lambda motion: abs(motion[2]))
        point = np.array([-fastest[1], fastest[0]]) / fastest[2]
        if self.freedom == 1:
            return point + 0.0, None
        others = [motion - fastest * motion[2] / fastest[2] for motion in self.motions]  # do not turn
        shift = max(others, key=lambda motion: float(np.hypot(*motion[:2])))[:2]
        along = np.array([-shift[1], shift[0]]) / np.hypot(*shift)
        return point - (point @ along) * along + 0.0, along + 0.0  # no -0

    def nearest(self, twist: ArrayLike) -> Array:
        """Return the twist (3,) that the robot can make nearest to a desired one (3,).

        Forward motion and turning are kept where they can be; sideways motion follows from them on robots whose fixed
        axle does not pass through the origin.
        """
        weight = np.array([1.0, SIDEWAYS_COST, 1.0])
        desired = np.asarray(twist, dtype=float)
        share, *_ = np.linalg.lstsq((self.motions * weight).T, desired * weight, rcond=None)
        return share @ self.motions


def moves_sideways(robot: RobotDescription) -> bool:
    """Return whether a robot can move in any direction and turn at the same time."""
    return Mobility.of(robot).omnidirectional


def turned_by_motors(robot: RobotDescription) -> bool:
    """Return whether motors determine how fast the body turns, wheels rolling without slip.

    A base on one castor that is free to turn is not turned: its wheels move the pivot anywhere, and nothing but inertia
    holds the body on it. The same castor beside a fixed axle steers it.
    """
    geometry = Geometry.of(robot)
    a, b = constraint_matrix(geometry, _no_special_angles(geometry))
    free = np.flatnonzero(~geometry.fixed & ~geometry.driven)
    of_row = np.concatenate([geometry.wheel_castor, geometry.wheel_castor])
    set_by_motors = np.concatenate([~np.isnan(geometry.counts_per_rev), geometry.standard])
    # Unknown are the twist and the rates of free castors. A further row, the turning rate, tells nothing new where the
    # others determine it.
    rows = np.concatenate([a, b[:, None] * (of_row[:, None] == free)], axis=1)[set_by_motors]
    turning = np.eye(1, rows.shape[1], 2)
    return bool(
        np.linalg.matrix_rank(np.concatenate([rows, turning]), tol=RANK) == np.linalg.matrix_rank(rows, tol=RANK)
    )


def check_drivable(robot: RobotDescription, trajectory: Trajectory) -> None:
    """Raise InputError if a leg of a trajectory makes a fixed castor slip sideways, or turns a body that motors do not
    turn (`turned_by_motors`)."""
    geometry, motions = Geometry.of(robot), np.array([leg.motion for run in trajectory.runs for leg in run.legs])
    cannot = f"robot {robot.name!r} cannot drive the {trajectory.name}"
    slips = (np.abs(geometry.side_slip_of_fixed(motions)) > SIDEWAYS).any(axis=0)
    if slips.any():
        raise InputError(
            f"{cannot}: its fixed castor {int(np.argmax(slips)) + 1} would slip sideways; choose other corners or "
            "another trajectory"
        )
    if motions[:, 2].any() and not turned_by_motors(robot):
        raise InputError(
            f"{cannot}: its motors move its body, but cannot turn it, as nothing holds it on its castor; choose a "
            "trajectory without turns, such as corners='fixed'"
        )


@lru_cache(maxsize=64)
def check_fast_enough(robot: RobotDescription, trajectory: Trajectory) -> None:
    """Raise InputError, with the largest speeds possible, if the scripted driver commands wheels more on a trajectory
    than their motors can, rolling without slip."""
    controller, largest, slower = KinematicController(robot), dict[str, float](), trajectory
    while over := _too_fast(robot, *controller.rolled(slower)):
        largest |= over
        runs = (replace(run, speed=min(run.speed, largest.get(_unit(run), run.speed))) for run in slower.runs)
        slower = replace(slower, runs=tuple(runs))
    if largest:
        needed = float(np.abs(controller.rolled(trajectory)[0]).max())
        raise InputError(
            f"robot {robot.name!r} is too slow for the {trajectory.name}: its wheels reach {robot.max_wheel_speed:g} "
            f"rad/s, and it asks for {needed:.3g}; choose "
            + " and ".join(f"at most {speed:.2g} {unit}" for unit, speed in largest.items())
        )


def _unit(run: Run) -> str:
    return AHEAD if any(np.hypot(*leg.motion[:2]) for leg in run.legs) else ON_THE_SPOT


def _too_fast(robot: RobotDescription, wheels: Array, twists: Array) -> dict[str, float]:
    """Return the speeds that bring wheels' rates (K, w) at twists (K, 3) down to the motors' limit, where one is above,
    rounded down to two digits. Joints turn by the same angles along a path at any speed of it."""
    share = np.abs(wheels).max(axis=1) / robot.max_wheel_speed
    ahead = np.hypot(twists[:, 0], twists[:, 1])
    speeds = {AHEAD: ahead, ON_THE_SPOT: np.where(ahead > 0, 0.0, np.abs(twists[:, 2]))}
    most = {}
    for unit, speed in speeds.items():
        over = (share > 1) & (speed > 0)
        if over.any():
            speed_at_limit = float(np.min(speed[over] / share[over]))
            digit = 10.0 ** (np.floor(np.log10(speed_at_limit)) - 1)
            most[unit] = float(np.floor(speed_at_limit / digit) * digit)
    return most


def _no_special_angles(geometry: Geometry) -> Array:
    """Return castor angles (n,), rad, in which no castors stand alike, but for those of fixed ones."""
    return np.where(geometry.fixed, geometry.angle, 1.0 + np.arange(geometry.n_castors))
