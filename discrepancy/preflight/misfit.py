"""The misfit of a log: the share of the robot's motion that is unexplained if the log is read in a given way.

There are two shares, each of sums of squares. Parity: the part of rolled distances and castor turns that no rigid
motion of the body on these wheels gives (castor_envs.motion.kinematics: rolling, and no side slip), summed over
windows of 0.4 s. Reference: the part of the motion between poses by which odometry misses them, after fitting where
the reference is mounted and how it is turned. The worst tenth of the windows is left out: wheels may slide there, or
poses jump.

For given pivot readings everything is linear in the counts. It is computed once for these readings (`_Pointed`); any
reading of the wheels then costs almost nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.reading import Channels, Reading
from discrepancy.preflight.stretches import WINDOW, Poses, stretches_of

KEPT = 0.9
"""The part of the windows that is used."""

SEEN = 5e-4
"""Least share of squares that contradicts the robot file: 2 % of a motion."""

STRAIGHT = 2.0
"""A reference is taken as not turned if the misfit without a turn is at most this multiple of the misfit with it: on
circles, a tracked point elsewhere on the robot looks the same as a turn."""

FEWEST = 5
"""Least number of windows with motion."""


class Misfit(NamedTuple):
    """parity, reference: shares of squares, 0 where nothing can be compared. yaw: angle of the reference's heading to
    the left of the body's direction of motion, rad."""

    parity: float
    reference: float
    yaw: float

    @property
    def total(self) -> float:
        """The sum of both shares."""
        return self.parity + self.reference

    @property
    def rms(self) -> float:
        """The larger of both shares, as rms."""
        return float(np.sqrt(max(self.parity, self.reference)))


class _Pointed(NamedTuple):
    """Quantities that depend on the angles of the castors alone. n windows, R rows, w wheels in use, c wheel channels.

    left (n, R, w, c), left_turning (n, R): residual in a window if a channel shows a wheel at one metre per count, and
    residual of the castors' turning. turning (n, R): the castors' turning before projection. way (V, 3, w, c),
    way_turning (V, 3): odometry between poses; the third row is the angle. None without poses.
    """

    left: Array
    left_turning: Array
    turning: Array
    way: Array | None
    way_turning: Array | None


@dataclass(frozen=True, eq=False)
class _Way:
    """The displacements between poses as complex numbers (V,): of the body, and per metre of offset of the tracked
    point."""

    moved: NDArray[np.complex128]
    arm: NDArray[np.complex128]
    turned: Array


class Misfits:
    """The misfit of some logs of one robot under any reading of them.

    dead: channels that never change and are left out. redundancy: number of rows beyond the unknowns of the motion.
    """

    def __init__(self, robot: RobotDescription, logs: Sequence[Log], dead: frozenset[int] = frozenset()) -> None:
        self._geometry = geometry = Geometry.of(robot)
        self._channels = channels = Channels(robot)
        self._driven = np.array(robot.driven_wheels, dtype=np.intp)
        self._sensed = np.array(robot.pivot_encoders, dtype=np.intp)
        dead_castors = {int(self._sensed[k - len(self._driven)]) for k in dead if k in channels.pivots}
        known = geometry.fixed | ~np.isnan(geometry.pivot_counts_per_rev)
        known[list(dead_castors)] = False
        usable = known[geometry.wheel_castor]
        live = [j for j, k in enumerate(self._driven) if usable[k] and j not in dead]
        self._wheels = np.array(live, dtype=np.intp)
        standard = np.flatnonzero(usable & geometry.standard)
        castors, first = np.unique(geometry.wheel_castor[standard], return_index=True)
        self._place = np.concatenate([self._driven[self._wheels], len(geometry.radius) + standard[first]])
        self._castor = np.concatenate([geometry.wheel_castor[self._driven[self._wheels]], castors]).astype(np.intp)
        self._metres = 2 * np.pi * geometry.radius[self._driven] / geometry.counts_per_rev[self._driven]
        self.length = float(np.sqrt(np.mean(np.sum(geometry.pivot**2, axis=-1)) + np.mean(geometry.lateral**2)))
        self._stretches = stretches_of(logs, geometry.pivot_counts_per_rev[self._sensed])
        self._pointed: dict[tuple[object, ...], _Pointed] = {}
        self.redundancy = 0
        if self._stretches is not None and len(self._place):
            a, _ = constraint_matrix(geometry, self._angles(channels.nominal(), self._stretches.start[:1]))
            self.redundancy = len(self._place) - int(np.linalg.matrix_rank(a[0, self._place], tol=1e-9))

    @property
    def poses(self) -> Poses | None:
        """The reference poses that are compared."""
        return None if self._stretches is None else self._stretches.reference

    @property
    def sees(self) -> bool:
        """Whether there is enough motion and redundancy, or poses, for any comparison."""
        if self._stretches is None or not len(self._place):
            return False
        windows = len(self._stretches.counted) // WINDOW
        return (self.redundancy > 0 and windows >= FEWEST) or self.sees_poses

    @property
    def sees_poses(self) -> bool:
        """Whether there are enough reference poses to compare."""
        return self.poses is not None and len(self.poses.first) >= FEWEST

    def of(self, reading: Reading) -> Misfit:
        """Return the misfit under a reading."""
        pointed = self._at(reading)
        channel, metres = self._wheels_of(reading)
        wheels = np.arange(len(channel))
        parity = 0.0
        if self.redundancy > 0:
            left = np.einsum("nrw,w->nr", pointed.left[:, :, wheels, channel], metres) + pointed.left_turning
            moved = pointed.turning.copy()
            moved[:, wheels] += self._counted[:, channel] * metres
            parity = _share(np.sum(left**2, axis=1), np.sum(moved**2, axis=1))
        if not self.sees_poses:
            return Misfit(parity, 0.0, 0.0)
        squares, way, yaw = self._squared_residuals(reading)
        return Misfit(parity, _share(squares, way), yaw)

    def residuals(self, reading: Reading) -> tuple[Array, Array]:
        """Return the error of odometry at each pose (V,), and the length of the ways (V,), both in m."""
        squares, way, _ = self._squared_residuals(reading)
        return np.sqrt(squares), np.sqrt(way)

    def _squared_residuals(self, reading: Reading) -> tuple[Array, Array, float]:
        """Return the squares of the errors of odometry and of the ways (V,), and the yaw of the reference."""
        pointed, poses = self._at(reading), self.poses
        assert poses is not None
        assert pointed.way is not None
        channel, metres = self._wheels_of(reading)
        odometry_step = (
            np.einsum("vqw,w->vq", pointed.way[:, :, np.arange(len(channel)), channel], metres) + pointed.way_turning
        )
        odometry, turned = odometry_step[:, 0] + 1j * odometry_step[:, 1], odometry_step[:, 2]
        moved = reading.lengths**-1 * (poses.after[:, :2] - poses.before[:, :2]) @ [1, 1j * reading.across]
        before, after = (np.exp(1j * pose[:, 2] / reading.headings) for pose in (poses.before, poses.after))
        angle = (poses.after[:, 2] - poses.before[:, 2]) / reading.headings
        arm = after - before
        kept = np.ones(len(moved), dtype=bool)
        total, straight, yaw = np.zeros(len(moved)), np.zeros(len(moved)), 0.0
        for _ in range(2):  # again without the worst
            size = np.vdot(arm[kept], arm[kept]).real + 1e-3 * np.vdot(moved[kept], moved[kept]).real / self.length**2
            free = [part - arm * (np.vdot(arm[kept], part[kept]) / (size + 1e-12)) for part in (odometry, moved)]
            product = np.vdot(free[1][kept], free[0][kept])
            turn = product / abs(product) if abs(product) > 0 else 1.0
            total = np.abs(free[0] - turn * free[1]) ** 2 + (self.length * (turned - angle)) ** 2
            kept = _kept(total)
            yaw = float(np.angle(turn))
            straight = np.abs(free[0] - free[1]) ** 2 + (self.length * (turned - angle)) ** 2
        way = (np.abs(odometry) ** 2 + np.abs(moved) ** 2 + self.length**2 * (turned**2 + angle**2)) / 2
        if _share(straight, way) <= STRAIGHT * max(_share(total, way), SEEN):
            return straight, way, 0.0
        return total, way, yaw

    def _wheels_of(self, reading: Reading) -> tuple[NDArray[np.intp], Array]:
        """Return for each wheel in use the channel that shows it, and its metres per count."""
        channel = np.array([reading.source.index(int(j)) for j in self._wheels], dtype=np.intp)
        return channel, self._metres[self._wheels] / np.array(reading.gain)[channel]

    def _angles(self, reading: Reading, counts: Array) -> Array:
        """Return theta (S, n) of all castors; 0 where unknown."""
        geometry, c = self._geometry, len(self._driven)
        theta = np.broadcast_to(np.where(geometry.fixed, geometry.angle, 0.0), (len(counts), geometry.n_castors)).copy()
        for j, i in enumerate(self._sensed):
            channel = reading.source.index(c + j)
            gain = reading.gain[channel]
            read = counts[:, channel - c] * 2 * np.pi / (geometry.pivot_counts_per_rev[i] * abs(gain))
            theta[:, i] = (read - geometry.pivot_zero[i] - reading.shift[channel]) * np.sign(gain)
        return theta

    def _at(self, reading: Reading) -> _Pointed:
        c = len(self._driven)
        key = (reading.source[c:], reading.gain[c:], reading.shift[c:], reading.headings)
        if key not in self._pointed:
            self._pointed[key] = self._point(reading)
        return self._pointed[key]

    def _point(self, reading: Reading) -> _Pointed:
        stretches = self._stretches
        assert stretches is not None
        start, end = (self._angles(reading, counts) for counts in (stretches.start, stretches.end))
        turned = end - start
        turned -= 2 * np.pi * np.round(turned / (2 * np.pi))
        a, b = (part[:, self._place] for part in constraint_matrix(self._geometry, start + turned / 2))
        square = np.einsum("kri,krj->kij", a, a)
        square += 1e-9 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        inverse = np.linalg.solve(square, np.swapaxes(a, 1, 2))
        left = np.eye(len(self._place)) - a @ inverse
        w = len(self._wheels)
        turning = -b * turned[:, self._castor]
        counted = stretches.counted
        steps, rows = len(counted), len(self._place)
        n = steps // WINDOW
        self._counted = counted.reshape(n, WINDOW, -1).sum(axis=1)
        blocks = left[:, :, :w].reshape(n, WINDOW, rows * w)
        summed = np.swapaxes(blocks, 1, 2) @ counted.reshape(n, WINDOW, -1)
        way = way_turning = None
        if self.sees_poses and self.poses is not None:
            way, way_turning = self._ways(self.poses, reading, inverse, counted, turning)
        return _Pointed(
            summed.reshape(n, rows, w, -1),
            np.einsum("krs,ks->kr", left, turning).reshape(n, WINDOW, rows).sum(axis=1),
            turning.reshape(n, WINDOW, rows).sum(axis=1),
            way,
            way_turning,
        )

    def _ways(
        self, poses: Poses, reading: Reading, inverse: Array, counted: Array, turning: Array
    ) -> tuple[Array, Array]:
        """Return odometry between poses, (V, 3, w, c) for the wheels' part and (V, 3) for the castors'."""
        w = len(self._wheels)
        heading = poses.heading / reading.headings
        cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
        turned = np.stack(
            [
                cos * inverse[:, 0] - sin * inverse[:, 1],
                sin * inverse[:, 0] + cos * inverse[:, 1],
                inverse[:, 2],
            ],
            axis=1,
        )
        of_wheels = turned[:, :, :w, None] * counted[:, None, None, :]
        of_castors = np.einsum("kqr,kr->kq", turned, turning)
        return _between(of_wheels, poses), _between(of_castors, poses)


def _between(steps: Array, poses: Poses) -> Array:
    """Return the sums of steps (S, ...) between poses (V, ...)."""
    sums = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
    return sums[poses.last] - sums[poses.first]


def _kept(squares: Array) -> NDArray[np.bool_]:
    """Return the windows that are used: all but the worst ones; `np.quantile` takes ten times as long."""
    last = int(KEPT * (len(squares) - 1))
    return squares <= np.partition(squares, last)[last]


def _share(squares: Array, sizes: Array) -> float:
    """Return the unexplained share of squares, without the worst windows."""
    kept = _kept(squares)
    total = float(sizes[kept].sum())
    return float(squares[kept].sum()) / total if total > 0 else 0.0
