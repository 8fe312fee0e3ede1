"""The misfit of a log: the share of the robot's motion that is unexplained if the log is read in a given way.

There are three shares, each of sums of squares. Parity: the part of rolled distances and castor turns that no rigid
motion of the body on these wheels gives (castor_envs.motion.kinematics: rolling, and no side slip), summed over
windows of 0.4 s. Reference: the part of the motion between poses by which odometry misses them, after fitting where
the reference is mounted and how it is turned. The worst tenth of the windows is left out: wheels may slide there, or
poses jump. Obedience: the part of what motors turn that their commands do not explain (`obedience`).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.motion.mobility import rows_in_use
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.obedience import Obedience
from discrepancy.preflight.reading import Channels, Reading
from discrepancy.preflight.stretches import WINDOW, Stretches, stretches_of
from discrepancy.validation.parity import WINDOWS

KEPT = 0.9
"""The part of the windows that is used."""

SEEN = 5e-4
"""Least share of squares that contradicts the robot file: 2 % of a motion."""

ALIKE = 2.0
"""Shares within this factor are similar. A reference is taken as not turned if the misfit without a turn is similar: on
circles, a tracked point elsewhere on the robot looks the same as a turn."""


Pivots = tuple[tuple[int, ...], tuple[float, ...], tuple[float, ...]]
"""Source, gain and shift of pivots in a reading, numbered from the first pivot on."""


class Misfit(NamedTuple):
    """parity, reference, commands: shares of squares, 0 where nothing can be compared. yaw: angle of the reference's
    heading to the left of the body's direction of motion, rad. disobedience: mean share of motors
    (`Obedience.each`)."""

    parity: float
    reference: float
    yaw: float
    commands: float
    disobedience: float

    @property
    def total(self) -> float:
        """The sum of all shares."""
        return self.parity + self.reference + self.commands

    @property
    def rms(self) -> float:
        """The larger of the shares of parity and reference, as rms."""
        return float(np.sqrt(max(self.parity, self.reference)))


class Misfits:
    """The misfit of some logs of one robot under any reading of them.

    dead: channels that never change and are left out. stretches: what is compared; None where nothing moves.
    redundancy: number of rows beyond the unknowns of the motion.
    """

    def __init__(self, robot: RobotDescription, logs: Sequence[Log], dead: frozenset[int] = frozenset()) -> None:
        self._geometry = geometry = Geometry.of(robot)
        channels, self._sensed = Channels(robot), np.array(robot.pivot_encoders, dtype=np.intp)
        driven = np.array(robot.driven_wheels, dtype=np.intp)
        rows = rows_in_use(
            geometry,
            without_wheels=[driven[k] for k in dead if k in channels.wheels],
            without_castors=[channels.castor[k] - 1 for k in dead if k in channels.pivots],
        )
        self._wheels, self._place, self._castor = np.searchsorted(driven, rows.wheels), rows.place, rows.castor
        self._metres = 2 * np.pi * geometry.radius[rows.wheels] / geometry.counts_per_rev[rows.wheels]
        self.length = float(np.sqrt(np.mean(np.sum(geometry.pivot**2, axis=-1)) + np.mean(geometry.lateral**2)))
        self.stretches = stretches_of(logs, geometry.pivot_counts_per_rev[self._sensed])
        self._constraints = lru_cache(maxsize=4)(self._constraints_at)  # most readings differ in wheels alone
        self._obedience = Obedience(robot, logs, dead)
        self.redundancy = 0
        if self.stretches is not None and len(self._place):
            a, _ = constraint_matrix(geometry, self._angles(self._pivots(channels.nominal()), self.stretches.start[:1]))
            self.redundancy = len(self._place) - int(np.linalg.matrix_rank(a[0, self._place], tol=1e-9))

    @property
    def sees(self) -> bool:
        """Whether there is enough motion and redundancy, or poses, for any comparison."""
        if self.stretches is None or not len(self._place):
            return False
        return (self.redundancy > 0 and len(self.stretches.counted) // WINDOW >= WINDOWS) or self.sees_poses

    @property
    def sees_poses(self) -> bool:
        """Whether there are enough reference poses to compare."""
        return self.stretches is not None and len(self.stretches.first) >= WINDOWS

    def of(self, reading: Reading) -> Misfit:
        """Return the misfit under a reading."""
        parity, (a, inverse, _), measured = 0.0, *self._measured(reading)
        commands = self._obedience.share(reading), self._obedience.each(reading)
        if self.redundancy > 0:
            left = measured - np.einsum("krq,kq->kr", a, np.einsum("kqr,kr->kq", inverse, measured))
            summed = (part.reshape(-1, WINDOW, part.shape[1]).sum(axis=1) for part in (left, measured))
            parity = _share(*(np.sum(part**2, axis=1) for part in summed))
        if not self.sees_poses:
            return Misfit(parity, 0.0, 0.0, *commands)
        squares, way, yaw = self._squared_residuals(reading)
        return Misfit(parity, _share(squares, way), yaw, *commands)

    def residuals(self, reading: Reading) -> tuple[Array, Array]:
        """Return the error of odometry at each pose (V,), and the length of the ways (V,), both in m."""
        squares, way, _ = self._squared_residuals(reading)
        return np.sqrt(squares), np.sqrt(way)

    def _squared_residuals(self, reading: Reading) -> tuple[Array, Array, float]:
        """Return the squares of the errors of odometry and of the ways (V,), and the yaw of the reference."""
        used = self._used
        odometry, turned = self._odometry(reading)
        moved = reading.lengths**-1 * (used.after[:, :2] - used.before[:, :2]) @ [1, 1j * reading.across]
        before, after = (np.exp(1j * pose[:, 2] / reading.headings) for pose in (used.before, used.after))
        angle = (used.after[:, 2] - used.before[:, 2]) / reading.headings
        arm, off_heading = after - before, (self.length * (turned - angle)) ** 2
        kept = np.ones(len(moved), dtype=bool)
        total, straight, yaw = np.zeros(len(moved)), np.zeros(len(moved)), 0.0
        for _ in range(2):  # again without the worst
            size = np.vdot(arm[kept], arm[kept]).real + 1e-3 * np.vdot(moved[kept], moved[kept]).real / self.length**2
            free = [part - arm * (np.vdot(arm[kept], part[kept]) / (size + 1e-12)) for part in (odometry, moved)]
            product = np.vdot(free[1][kept], free[0][kept])
            turn = product / abs(product) if abs(product) > 0 else 1.0
            total, straight = (np.abs(free[0] - by * free[1]) ** 2 + off_heading for by in (turn, 1.0))
            kept, yaw = _kept(total), float(np.angle(turn))
        way = (np.abs(odometry) ** 2 + np.abs(moved) ** 2 + self.length**2 * (turned**2 + angle**2)) / 2
        if _share(straight, way) <= ALIKE * max(_share(total, way), SEEN):
            return straight, way, 0.0
        return total, way, yaw

    def _odometry(self, reading: Reading) -> tuple[NDArray[np.complex128], Array]:
        """Return the motion between poses by odometry: of the body, complex (V,), m, and its turn (V,), rad."""
        (_, inverse, _), measured = self._measured(reading)
        used, twist = self._used, np.einsum("kqr,kr->kq", inverse, measured)
        moved = (twist[:, 0] + 1j * twist[:, 1]) * np.exp(1j * used.heading / reading.headings)
        way, heading = (np.concatenate([[0.0], np.cumsum(steps)]) for steps in (moved, twist[:, 2]))
        return way[used.last] - way[used.first], heading[used.last] - heading[used.first]

    @property
    def _used(self) -> Stretches:
        assert self.stretches is not None
        return self.stretches

    def _pivots(self, reading: Reading) -> Pivots:
        first = len(reading.source) - len(self._sensed)
        source = tuple(channel - first for channel in reading.source[first:])
        return source, reading.gain[first:], reading.shift[first:]

    def _measured(self, reading: Reading) -> tuple[tuple[Array, Array, Array], Array]:
        """Return the constraints in every step, and the distances (S, R) in m that are measured in their rows."""
        constraints = self._constraints(self._pivots(reading))
        channel = [reading.source.index(int(j)) for j in self._wheels]
        measured = constraints[2].copy()
        measured[:, : len(channel)] += self._used.counted[:, channel] * self._metres / np.array(reading.gain)[channel]
        return constraints, measured

    def _constraints_at(self, pivots: Pivots) -> tuple[Array, Array, Array]:
        """Return in every step the constraints (S, R, 3) on the body's motion, their inverse (S, 3, R) by least
        squares, and what castors' turning adds to the rows (S, R), m."""
        start, end = (self._angles(pivots, counts) for counts in (self._used.start, self._used.end))
        turned = end - start
        turned -= 2 * np.pi * np.round(turned / (2 * np.pi))
        a, b = (part[:, self._place] for part in constraint_matrix(self._geometry, start + turned / 2))
        square = np.einsum("kri,krj->kij", a, a)
        square += 1e-9 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        return a, np.linalg.solve(square, np.swapaxes(a, 1, 2)), -b * turned[:, self._castor]

    def _angles(self, pivots: Pivots, counts: Array) -> Array:
        """Return theta (S, n) of all castors; 0 where unknown."""
        geometry, (source, gain, shift) = self._geometry, pivots
        theta = np.broadcast_to(np.where(geometry.fixed, geometry.angle, 0.0), (len(counts), geometry.n_castors)).copy()
        for j, i in enumerate(self._sensed):
            k = source.index(j)
            read = counts[:, k] * 2 * np.pi / (geometry.pivot_counts_per_rev[i] * abs(gain[k]))
            theta[:, i] = (read - geometry.pivot_zero[i] - shift[k]) * np.sign(gain[k])
        return theta


def _kept(squares: Array) -> NDArray[np.bool_]:
    """Return the windows that are used: all but the worst ones; `np.quantile` takes ten times as long."""
    last = int(KEPT * (len(squares) - 1))
    return squares <= np.partition(squares, last)[last]


def _share(squares: Array, sizes: Array) -> float:
    """Return the unexplained share of squares, without the worst windows."""
    kept = _kept(squares)
    total = float(sizes[kept].sum())
    return float(squares[kept].sum()) / total if total > 0 else 0.0
