"""The likelihood of a log under any reading of it: how well encoders, reference and commands agree.

A log is cut into windows. What contradicts in a window is a share of the squares that are measured in it. In a robot in
good order it is `USUAL` squared, with the tails of a Cauchy distribution, as wheels may slide and poses jump: a share q
costs ln(1 + q / USUAL²). What contradicts in one window does so in the next, too. So all windows together are one
observation, with the mean of their costs. Observations are:

- encoders against each other: what no rigid motion of the body on its wheels gives (`castor_envs.motion.kinematics`:
  rolling, and no side slip);
- odometry against the reference, after fitting where this is mounted and how it is turned: a pose has three numbers, so
  it costs twice as much (`POSE`). Without headings, odometry between three positions in succession is turned as it fits
  best, window by window, which leaves three numbers of the two ways;
- each motor against its command. A motor turns its own wheel or castor, whatever its encoder is connected to. How well
  it obeys shows in the encoder that follows it best; another costs the logarithm of how many times as much it leaves.

A robot that is steered by wrong readings makes these agree, and its wheels slide. So where there are commands, encoders
and reference cost no more under any reading than as read.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.mounting import TURNED, fit_mount, fit_positions
from castor_envs.geometry.se2 import relative_pose, rotate
from castor_envs.logs.log import Log, poses_taken, positions_taken
from castor_envs.motion.kinematics import constraint_matrix
from castor_envs.motion.mobility import RANK, rows_in_use
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.validation.parity import WINDOWS
from estimators.likelihood.channels import Channels
from estimators.likelihood.rolling import GAP

STEP, WINDOW, MOST = 0.05, 1.5, 40
"""s: samples closer together are left out, as counts are rounded; least length of a window, in which a robot goes much
further than a tracker's noise. Most windows that are used, spread over all motion."""

USUAL = 0.005
"""The part of a motion, as rms, that a robot in good order contradicts: below twice as much in all three simulators of
`castor-diagnose trial`."""


POSE = 2.0
"""What a pose costs, in ln(1 + q / USUAL²): (1 + d) / 2 of d numbers that are Cauchy distributed together. Wheels that
contradict count as one number: how many do depends on the robot."""


class Misfit(NamedTuple):
    """encoders, reference, commands: the parts that contradict, as rms; 0 where nothing can be compared. turn: of the
    reference's heading to the left of the body's front, rad; 0.0 if small or unclear. cost: minus the log-likelihood.
    """

    encoders: float
    reference: float
    commands: float
    turn: float
    cost: float


class WiringLikelihood:
    """The likelihood of some logs of one robot under any reading of them, in S steps of V windows.

    dead: columns of encoders that never change, and are left out. sees: whether there is enough motion for encoders and
    reference to contradict anything. sees_poses: whether there are enough reference poses. headed: whether these have
    headings; without any, positions are taken instead.
    """

    def __init__(self, robot: RobotDescription, logs: Sequence[Log], dead: frozenset[int] = frozenset()) -> None:
        self._channels, self._dead, self.sees, self.sees_poses = Channels(robot), sorted(dead), False, False
        self._geometry, self._size = self._channels.geometry, self._channels.geometry.reach
        self._columns, self._pivots = len(self._channels.names), len(self._channels.sensed)
        positions = any(len(positions_taken(log)) for log in logs)
        self.headed = not positions or any(len(poses_taken(log)) for log in logs)
        found = [window for number, log in enumerate(logs) for window in self._windows(robot, number, log)]
        if not found:
            return
        chosen = (found[k] for k in np.unique(np.linspace(0, len(found) - 1, MOST).astype(int)))
        counts, legs, *others = zip(*chosen, strict=True)
        self._at, self._poses, self._told = map(np.array, others)
        self._start, self._end = (np.concatenate([each[ends] for each in counts]) for ends in (np.s_[:-1], np.s_[1:]))
        self._first = np.cumsum([0, *(len(each) - 1 for each in counts[:-1])])
        self._legs = self._first[:, None] + np.array(legs)
        self._posed = np.isfinite(self._poses[..., : 3 if self.headed else 2]).all(axis=(1, 2))
        self._constraints = lru_cache(maxsize=4)(self._constraints_at)  # most readings differ in wheels alone
        nominal = np.eye(self._columns + 4)
        (a, *_), _, motion = self._rolled(nominal)
        self._turned_as_read = np.abs(np.add.reduceat(motion[:, 2], self._legs.ravel()).reshape(self._legs.shape))
        redundant = bool(len(a) > np.linalg.matrix_rank(a, tol=RANK))
        self.sees_poses = len(a) > 0 and int(self._posed.sum()) >= WINDOWS
        self.sees = self.sees_poses or (redundant and len(counts) >= WINDOWS)
        self._motors = np.setdiff1d(np.flatnonzero(np.nan_to_num(self._told[:, 0]).any(axis=0)), self._dead)
        self._heard = np.isfinite(self._told[:, :, self._motors]).all(axis=1)
        self._told = np.nan_to_num(self._told[:, :, self._motors])
        self._followed = np.linalg.pinv(np.einsum("vkm,vlm->mkl", self._told, self._told))
        self._as_read, self._least = np.full(2, np.inf), np.zeros(0)
        if len(self._motors):
            size = np.sum(np.add.reduceat(self._steps(nominal), self._first)[:, self._motors] ** 2, axis=0)
            self._doubt = USUAL**2 * size.mean() / size.clip(RANK)  # noise does not shrink with turns
            left = np.minimum(*(self._left(way * self._steps(nominal)) for way in (1, -1)))
            self._as_read, self._least = self._agreement(nominal)[0], np.delete(left, self._dead, axis=1).min(axis=1)

    def of(self, reading: Array) -> Misfit:
        """Return the misfit under a reading (c + 4, c + 4)."""
        undo, commands = np.linalg.inv(reading).astype(float), 0.0
        costs, turn = self._agreement(undo)
        cost = float(np.minimum(costs, self._as_read) @ (1.0, POSE))
        if len(self._motors):
            left = self._left(self._steps(undo))[np.arange(len(self._motors)), self._motors]
            cost += float(np.log((left + self._doubt) / (self._least + self._doubt)).sum())
            commands = float(np.sqrt((left - self._least).clip(0.0).mean()))
        encoders, reference = (USUAL * np.sqrt(np.expm1(costs))).tolist()
        return Misfit(encoders, reference, commands, turn, cost)

    def missed(self, reading: Array) -> Iterator[tuple[float, int, int, int]]:
        """Yield by how much odometry misses poses that it misses far more than others, m, the log's number, and the
        rows of the pose before and of this one."""
        undo = np.linalg.inv(reading).astype(float)
        squares, sizes, _ = self._against_poses(undo, self._rolled(undo)[-1])
        far = np.log1p(squares / _usual(sizes)) > _cost(squares, sizes) + 2 * LOG_ODDS
        for error, at in zip(np.sqrt(squares)[far].tolist(), self._at[self._posed][far].tolist(), strict=True):
            yield error, *at

    def _agreement(self, undo: Array) -> tuple[Array, float]:
        """Return what encoders and reference cost (2,), and the turn of the reference."""
        (a, measured, motion), costs, turn = self._rolled(undo), np.zeros(2), 0.0
        parts = (measured - (a @ motion[:, :, None])[:, :, 0], measured)
        costs[0] = _cost(*(np.sum(np.add.reduceat(part, self._first) ** 2, axis=1) for part in parts))
        if self.sees_poses:
            squares, sizes, turn = self._against_poses(undo, motion)
            costs[1] = _cost(squares, sizes)
        return costs, turn

    def _steps(self, undo: Array) -> Array:
        """Return how far each encoder turns in each step (S, c), rad; castors the shorter way round."""
        counts = (self._end - self._start) @ undo[: self._columns, : self._columns].T
        steps = counts * (2 * np.pi / self._channels.per_rev)
        steps[:, : self._pivots] -= 2 * np.pi * np.round(steps[:, : self._pivots] / (2 * np.pi))
        return steps

    def _rolled(self, undo: Array) -> tuple[Array, Array, Array]:
        """Return in each step the constraints (S, R, 3), what is measured in them (S, R), m, and the motion of the body
        (S, 3) by least squares, m and rad."""
        dead = np.flatnonzero(undo[: self._columns, self._dead].any(axis=1)).tolist()
        wheels, a, inverse, swung = self._constraints(undo[: self._pivots].tobytes(), tuple(dead))
        columns, measured = self._pivots + np.searchsorted(self._channels.driven, wheels), swung.copy()
        measured[:, : len(wheels)] += self._steps(undo)[:, columns] * self._geometry.radius[wheels]
        return a, measured, ((measured[:, None] @ a) @ inverse)[:, 0]

    def _constraints_at(self, pivots: bytes, dead: tuple[int, ...]) -> tuple[NDArray[np.intp], Array, Array, Array]:
        """Return the wheels whose rolling is known (w,), and in every step the constraints on the body's motion (S, R,
        3), the inverse of their squares (S, 3, 3), and what castors' turning adds to them (S, R), m.

        pivots: the rows of the matrix that undoes a reading.
        """
        geometry, channels, undo = self._geometry, self._channels, np.eye(self._columns + 4)
        undo[: self._pivots] = np.frombuffer(pivots).reshape(self._pivots, self._columns + 4)
        wheels = [int(channels.driven[k - self._pivots]) for k in dead if k >= self._pivots]
        rows = rows_in_use(geometry, wheels, [int(channels.sensed[k]) for k in dead if k < self._pivots])
        _, castor = channels.angles(self._start @ undo[: self._columns, : self._columns].T + undo[: self._columns, -1])
        turned = np.zeros_like(castor)
        turned[:, channels.sensed] = self._steps(undo)[:, : self._pivots]
        a, b = (part[:, rows.place] for part in constraint_matrix(geometry, castor + turned / 2))
        square = np.swapaxes(a, 1, 2) @ a
        square += RANK * np.trace(square, axis1=1, axis2=2)[:, None, None].clip(RANK) * np.eye(3)
        return rows.wheels, a, np.linalg.inv(square), -b * turned[:, rows.castor]

    def _against_poses(self, undo: Array, motion: Array) -> tuple[Array, Array, float]:
        """Return the squares of odometry's errors and of the ways (P,), m2, between poses, and the reference's turn."""
        turns = np.cumsum(motion[:, 2])
        steps = rotate(motion[:, :2], turns - motion[:, 2] / 2)
        poses = self._poses[self._posed] * np.diag(undo)[self._columns : -1]
        if not self.headed:
            return *self._against_positions(motion[:, 2], steps, turns, poses[..., :2] @ [1, 1j]), 0.0
        moved = rotate(np.add.reduceat(steps, self._first), (motion[:, 2] - turns)[self._first])
        moved = np.column_stack([moved, np.add.reduceat(motion[:, 2], self._first)])[self._posed]
        seen, scale = relative_pose(poses[:, 0], poses[:, 1]), np.array([1, 1, self._size])
        sizes = np.sum((moved * scale) ** 2 + (seen * scale) ** 2, axis=1) / 2
        off_heading = (self._size * (moved[:, 2] - seen[:, 2])) ** 2
        _, _, error = fit_mount(moved, seen, self._size, np.ones(len(moved)))
        weight = 1 / (1 + (error + off_heading) / _usual(sizes))
        turn, *errors = fit_mount(moved, seen, self._size, weight)  # with less weight on what contradicts
        straight, turned = (error + off_heading for error in errors)
        if abs(turn) <= TURNED:  # as trackers are mounted: no mistake
            return turned, sizes, 0.0
        if _cost(straight, sizes) - _cost(turned, sizes) > LOG_ODDS:
            return turned, sizes, turn
        return straight, sizes, 0.0

    def _against_positions(self, turn: Array, steps: Array, turns: Array, positions: Array) -> tuple[Array, Array]:
        """Return the squares of odometry's errors and of the ways (P,), m2, of the tracked point between positions
        (P, 3), as complex numbers.

        turn (S,): in each step, rad; turns: their sums. steps (S, 2): ways, in axes that are the body's at the first.
        """
        shape, ahead = self._legs.shape, np.exp(1j * (turn - turns)[self._first])[:, None]
        moved = (np.add.reduceat(steps @ [1, 1j], self._legs.ravel()).reshape(shape) * ahead)[self._posed]
        turned = np.add.reduceat(turn, self._legs.ravel()).reshape(shape)[self._posed]
        arm, seen = np.diff(np.exp(1j * np.cumsum(turned, axis=1)), prepend=1.0), np.diff(positions)
        spun = np.minimum(np.abs(turned), self._turned_as_read[self._posed])  # no reading gains by one that spins
        sizes_seen = np.sum(np.abs(seen) ** 2 + 2 * (self._size * spun) ** 2, axis=1)
        error, ways = fit_positions(moved, arm, seen, self._size, np.ones(len(moved)))
        weight = 1 / (1 + error / _usual((ways + sizes_seen) / 2))
        error, ways = fit_positions(moved, arm, seen, self._size, weight)
        return error, (ways + sizes_seen) / 2

    def _left(self, steps: Array) -> Array:
        """Return the part of the squares of what encoders turn (S, c) that motors' commands leave (motors, c).

        A command is followed in any proportion above 0, as counts per turn may be wrong, and with any small delay.
        """
        turned = np.add.reduceat(steps, self._first)
        product = np.einsum("vkm,vc->mkc", self._told, turned)
        followed = self._followed @ product
        size = np.einsum("vm,vc->mc", self._heard, turned**2)
        explained = np.where(followed[:, 0] > 0, np.sum(product * followed, axis=1), 0.0)
        return 1.0 - explained / size.clip(np.finfo(float).tiny)

    def _windows(
        self, robot: RobotDescription, number: int, log: Log
    ) -> Iterator[tuple[Array, list[int], Array, Array, Array]]:
        """Yield the windows of a log in which encoders count: the counts at the ends of steps (k, c); the steps with
        which its legs begin, of which it has two where there are no headings; the number of the log, the first and last
        row (3,); the reference's poses at the ends of legs (legs + 1, 3), NaN without; by how much the motor of each
        encoder was to turn, and its speed to change (2, c), NaN where nobody said."""
        counts, steps = np.column_stack([log.pivot, log.wheel]), np.diff(log.t)
        poses = np.full((len(log), 3), np.nan) if log.reference is None else log.reference
        told, period = np.full(counts.shape, np.nan), float(np.median(steps))
        if log.command is not None:
            told[:, self._pivots :] = log.command
        if log.steering_command is not None:
            for i, column in zip(robot.driven_castors, log.steering_command.T, strict=True):
                told[:, np.flatnonzero(self._channels.sensed == i)] = column[:, None]
        turns = np.where(steps > GAP * period, np.nan, steps)[:, None] * told[:-1]
        ends = list(_ends(log, poses_taken(log) if self.headed else positions_taken(log)))
        if not self.headed:
            ends = [(a, b, c) for (a, b), (again, c) in pairwise(ends) if again == b]
        for marks in ends:
            legs = [np.arange(*leg, max(1, round(STEP / period))) for leg in pairwise(marks)]
            (a, b), rows = (marks[0], marks[-1]), np.append(np.concatenate(legs), marks[-1])
            if np.ptp(counts[rows], axis=0).any():
                commands = np.array([turns[a:b].sum(axis=0), told[b - 1] - told[a]])
                begin = [0, *(len(leg) for leg in legs[:-1])]
                yield counts[rows], begin, np.array([number, a, b]), poses[list(marks)], commands


def _ends(log: Log, taken: NDArray[np.intp]) -> Iterator[tuple[int, ...]]:
    """Yield the first and last rows of windows: of `WINDOW` s, or from pose to pose, if the next comes soon after.
    taken: the rows with a pose."""
    a = 0
    while True:
        b = int(np.searchsorted(log.t, log.t[a] + WINDOW - RANK))  # which is far below a period
        k = np.searchsorted(taken, b if a in taken else a + 1)
        if k < len(taken) and log.t[taken[k]] - log.t[a] <= 2 * WINDOW:
            b = int(taken[k])
        if b >= len(log):
            return
        if log.t[b] - log.t[a] <= 2 * WINDOW:
            yield a, b
        a = b


def _usual(sizes: Array) -> Array:
    """Return the squares (V,) that usually contradict where these are measured; noise does not shrink with them."""
    return USUAL**2 * (sizes + sizes.mean()) / 2 + np.finfo(float).tiny


def _cost(squares: Array, sizes: Array) -> float:
    """Return what windows cost in which these squares (V,) contradict, where these (V,) are measured."""
    return float(np.mean(np.log1p(squares / _usual(sizes))))
