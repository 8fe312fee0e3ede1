"""The rolling constraints of a robot in one log: a wheel rolls as far as its contact moves, and does not move sideways.

They are those of castor_envs.motion.kinematics, integrated over a step to fourth order in its length: half-way values
alone would bias castors that swing in. Each step ties two samples only.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import body_motion, even_steps, half_way, integrated
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.sensors.encoders import castor_angles
from estimators.likelihood.elimination import blocks
from estimators.likelihood.sparse_columns import ByBlocks
from estimators.steps.gaps import GAP

REACH = 2
"""Steps before and after a step with which its residuals are integrated to fourth order."""

DETERMINED = 1e-3
"""Least pivot, as a part of the largest, of constraints whose normal equations are solved: it costs six digits."""

UNMOVED = 1e-12
"""m2: keeps the logarithm finite for a motion that no contact notices."""


@dataclass(frozen=True, eq=False)
class Changes:
    """Changes about a state (K, m) of a robot: `changed` geometries (G,), in each of which one parameter is larger by
    change (G,); and R of readings (K, s + d, R), counts read too much per unit, and of slips (K - 1, rows, R), m per
    unit."""

    geometry: Geometry
    changed: Geometry
    change: Array
    state: Array
    readings: ByBlocks
    slips: ByBlocks


class RollingConstraints:
    """The constraints of a robot of a known layout in one log.

    A state (K, m = 3 + s + d) holds at every sample the body's x, y (m) and psi (rad), then the unwrapped counts of s
    pivot and d wheel encoders, as they would be were they not rounded.
    """

    def __init__(self, layout: Geometry, t: Array) -> None:
        """t (K,): times of samples, s."""
        self._sensed = int(np.sum(~np.isnan(layout.pivot_counts_per_rev)))
        self._wheels = np.flatnonzero(~np.isnan(layout.counts_per_rev))
        self._wheel_count, self._radius = len(layout.radius), float(np.mean(layout.radius[self._wheels]))
        known = (layout.fixed | ~np.isnan(layout.pivot_counts_per_rev))[layout.wheel_castor]
        self._rolling = np.flatnonzero(known & ~np.isnan(layout.counts_per_rev))
        standing = np.flatnonzero(known & layout.standard)
        _, first = np.unique(layout.wheel_castor[standing], return_index=True)
        self._used = np.concatenate([self._rolling, len(layout.radius) + standing[first]])
        self._castor = np.tile(layout.wheel_castor, 2)[self._used]
        self._t = t
        self._even = even_steps(t)

    @property
    def rows(self) -> NDArray[np.intp]:
        """The rows of the constraints in use, by their place in `constraint_matrix`."""
        return self._used

    @property
    def slip_rows(self) -> list[int]:
        """The place of every row of `residuals` among the slips of wheels and, to the side, of castors (w + n,)."""
        first = len(self._rolling)
        return [*self._rolling.tolist(), *(self._wheel_count + self._castor[first:]).tolist()]

    def rows_of(self, rolling: Array, side: Array) -> Array:
        """Return slips of wheels (K - 1, w) and, to the side, of castors (K - 1, n) as the rows of `residuals`."""
        return np.concatenate([rolling, side], axis=1)[:, self.slip_rows]

    def residuals(self, geometry: Geometry, state: Array, even: NDArray[np.bool_] | None = None) -> Array:
        """Return the residuals of a state in every constraint (..., K - 1, rows), m; the geometry may have leading
        axes.

        In metres of the robot as described: the residual does not scale with the robot, as otherwise the fit would
        shrink all robots. even (K - 1,): the steps to integrate to fourth order in their length, not to second; None:
        those that are.
        """
        even = self._even if even is None else even
        angle, body = self._angles(geometry, state[:, 3:]), body_motion(state, even)
        a, b = self._matrices(geometry, half_way(angle, even))
        along = integrated(a, body, even)
        turned = np.diff(angle, axis=-2)[..., self._castor]
        return (along + b * turned - self._rolled(geometry, state[:, 3:])) * self._magnified(geometry)

    def rolled(self, geometry: Geometry, state: Array) -> Array:
        """Return the distance that every row's wheel rolled in every step (K - 1, rows), m; for side slip the mean of
        its castor's wheels."""
        rolled = self._rolled(geometry, state[:, 3:])
        first = len(self._rolling)
        in_castor = self._castor[:first] == self._castor[first:, None]
        rolled[:, first:] = rolled[:, :first] @ (in_castor / np.maximum(in_castor.sum(axis=1, keepdims=True), 1)).T
        return rolled

    def disagreement(self, geometry: Geometry, state: Array) -> Array:
        """Return the disagreement of wheels (K - 1, rows), m: the residuals of the constraints that no motion of the
        body explains."""
        seen = self.residuals(geometry, state)
        return seen - self.explained(geometry, state, seen)

    def explained(self, geometry: Geometry, state: Array, slips: Array) -> Array:
        """Return the part of slips (K - 1, rows) that a motion of the body explains, by least squares."""
        angle = self._angles(geometry, state[:, 3:])
        a, _ = self._matrices(geometry, (angle[1:] + angle[:-1]) / 2)
        return (a @ self.as_motion(geometry, state, slips[..., None]))[..., 0]

    def as_motion(self, geometry: Geometry, state: Array, slips: Array) -> Array:
        """Return the motion of the body in every step (K - 1, 3, n), in B, that odometry computes from slips (K - 1,
        rows, n)."""
        angle = self._angles(geometry, state[:, 3:])
        a, _ = self._matrices(geometry, (angle[1:] + angle[:-1]) / 2)
        return _inverse_of(a) @ slips

    def missing(self, changes: Changes, steps: slice) -> Array:
        """Return the error of odometry in the body's motion in some steps (k, 3, G + R), in B, m and rad, per unit of
        changes."""
        return self.as_motion(changes.geometry, changes.state[_samples_of(steps)], self._decreasing(changes, steps))

    def agreement_by(self, changes: Changes, steps: slice) -> Array:
        """Return the decrease of the disagreement in some steps (k, rows, G + R), per unit of changes."""
        decrease = self._decreasing(changes, steps)
        a, _ = self._matrices_in(changes.geometry, changes.state, steps)
        return decrease - a @ (_inverse_of(a) @ decrease)

    def _decreasing(self, changes: Changes, steps: slice) -> Array:
        """Return the decrease of the residuals of some steps (k, rows, G + R), per unit of changes."""
        near, inner = self._near(steps)
        start, end = self._derivatives(changes.geometry, changes.state[_samples_of(near)], self._even[near])
        by_change = self._by_change(changes.geometry, changes.changed, changes.change, changes.state, steps)
        read = changes.readings[_samples_of(steps)]
        by_reading = -(start[inner, :, 3:] @ read[:-1] + end[inner, :, 3:] @ read[1:])
        increase = np.concatenate([by_change, by_reading - changes.slips[steps]], axis=-1)
        return np.negative(increase, out=increase)

    def _near(self, steps: slice) -> tuple[slice, slice]:
        """Return some steps with those by which they are integrated, and the steps' place among these."""
        near = slice(max(steps.start - REACH, 0), min(steps.stop + REACH, len(self._even)))
        return near, slice(steps.start - near.start, steps.stop - near.start)

    def _by_change(self, geometry: Geometry, changed: Geometry, change: Array, state: Array, steps: slice) -> Array:
        """Return the change of residuals in some steps (k, rows, G), per unit of changes of the geometry."""
        if not len(change):
            return np.zeros((steps.stop - steps.start, len(self._used), 0))
        near, inner = self._near(steps)
        at, even = state[_samples_of(near)], self._even[near]
        difference = self.residuals(changed, at, even) - self.residuals(geometry, at, even)
        return np.moveaxis(difference[:, inner] / change[:, None, None], 0, -1)

    def _derivatives(
        self, geometry: Geometry, state: Array, even: NDArray[np.bool_] | None = None
    ) -> tuple[Array, Array]:
        """Return the derivatives of `residuals` by the state at the start and end of every step, to second order."""
        even = self._even if even is None else even
        angle, body, s = self._angles(geometry, state[:, 3:]), body_motion(state, even), self._sensed
        middle = (angle[1:] + angle[:-1]) / 2
        a, b = self._matrices(geometry, middle)
        # A turns with the castors, but for B in its last column; its derivative is what turns, a quarter turn on
        quarter, _ = self._matrices(geometry, middle + np.pi / 2)
        pointing = (quarter @ body[..., None])[..., 0] - b * body[:, None, 2]

        heading, turn = (state[1:, 2] + state[:-1, 2]) / 2, np.diff(state[:, 2])
        c, sn, chord = np.cos(heading), np.sin(heading), np.sinc(turn / (2 * np.pi))
        by_place = a[:, :, :2] @ (np.array([[c, sn], [-sn, c]]).transpose(2, 0, 1) / chord[:, None, None])
        by_direction = a[:, :, 0] * body[:, None, 1] - a[:, :, 1] * body[:, None, 0]
        by_turn = a[:, :, 2] + (a[:, :, :2] @ body[:, :2, None])[..., 0] * turn[:, None] / 12
        shape = (*pointing.shape, state.shape[1])
        start, end = np.zeros(shape), np.zeros(shape)
        start[..., :2], end[..., :2] = -by_place, by_place
        start[..., 2], end[..., 2] = by_direction / 2 - by_turn, by_direction / 2 + by_turn
        rows = np.arange(len(self._used))
        for column, castor in enumerate(np.flatnonzero(~np.isnan(geometry.pivot_counts_per_rev))):
            castor_rows, count = rows[self._castor == castor], 2 * np.pi / geometry.pivot_counts_per_rev[castor]
            start[:, castor_rows, 3 + column] = (pointing / 2 - b)[:, castor_rows] * count
            end[:, castor_rows, 3 + column] = (pointing / 2 + b)[:, castor_rows] * count
        for row, wheel in enumerate(self._rolling):
            column = 3 + s + int(np.searchsorted(self._wheels, wheel))
            length = 2 * np.pi * geometry.radius[wheel] / geometry.counts_per_rev[wheel]
            start[:, row, column], end[:, row, column] = length, -length
        start *= self._magnified(geometry)
        end *= self._magnified(geometry)
        return start, end

    def _angles(self, geometry: Geometry, counts: Array) -> Array:
        """Return the castors' angles (..., K, n) at counts (K, s + d)."""
        return castor_angles(geometry.expand(1), counts[:, : self._sensed])

    def _matrices(self, geometry: Geometry, angle: Array) -> tuple[Array, Array]:
        """Return A (..., K - 1, rows, 3) and B (..., K - 1, rows) of the rows in use (`constraint_matrix`)."""
        a, b = constraint_matrix(geometry.expand(1), angle)
        return a[..., self._used, :], b[..., self._used]

    def _matrices_in(self, geometry: Geometry, state: Array, steps: slice) -> tuple[Array, Array]:
        """Return A (k, rows, 3) and B (k, rows) half-way through some steps of a state (K, m)."""
        angle = self._angles(geometry, state[_samples_of(steps), 3:])
        return self._matrices(geometry, (angle[1:] + angle[:-1]) / 2)

    def _turning(self, geometry: Geometry) -> NDArray[np.bool_]:
        """Return which castors (n,) turn freely."""
        return ~geometry.fixed & ~geometry.driven

    def _moved(self, geometry: Geometry, a: Array, b: Array) -> Array:
        """Return how far every row's contact moves (k, rows, 3 + f) for a unit of the body's motion, and of the turning
        of each castor that nothing drives, m. a, b: from `_matrices`."""
        turning = self._castor[:, None] == np.flatnonzero(self._turning(geometry))
        return np.concatenate([a, turning * b[..., None]], axis=-1)

    def _rolled(self, geometry: Geometry, counts: Array) -> Array:
        """Return the distances that wheels rolled in every step (..., K - 1, rows), m; 0 in rows of side slip."""
        length = (2 * np.pi * geometry.radius / geometry.counts_per_rev)[..., None, self._rolling]
        counted = np.diff(counts[:, self._sensed :], axis=0)[:, np.searchsorted(self._wheels, self._rolling)]
        rolled = counted * length
        idle = np.zeros((*rolled.shape[:-1], len(self._used) - len(self._rolling)))
        return np.concatenate([rolled, idle], axis=-1)

    def turned(self, geometry: Geometry, state: Array) -> Array:
        """Return the angle by which every row's contact turned on the floor in every step (K - 1, rows), rad, to the
        left, if its castor is steered by a motor; 0 of others, which turn as they roll."""
        heading = self._angles(geometry, state[:, 3:]) + state[:, 2:3]
        return (np.diff(heading, axis=0) * geometry.driven)[:, self._castor]

    def _unsure(self, geometry: Geometry, state: Array, residual: Array | None) -> Array:
        """Return the error estimate of the integration over every step (K - 1, rows), m. residual: of the state, if it
        is known.

        Second order: the difference to fourth order; fourth order: this difference times the squared angle by which the
        fastest castor turns in a step, the ratio between successive orders. In gaps: unbounded.
        """
        angle = self._angles(geometry, state[:, 3:])[:, np.unique(self._castor)]
        turned = np.abs(np.diff(angle, axis=0)).max(axis=1, initial=0.0)
        around = np.maximum.reduce([turned, np.append(turned[1:], 0.0), np.append(0.0, turned[:-1])])
        known = residual is not None and self._even[1:-1].all()
        orders = (np.full(len(turned), order) for order in (False, True)[: 1 if known else 2])
        second, fourth = [*(self.residuals(geometry, state, order) for order in orders), residual][:2]
        unsure = np.abs(fourth - second) * np.where(self._even, around**2, 1.0)[:, None]
        step = np.diff(self._t)
        rolled = np.abs(self._rolled(geometry, state[:, 3:])).max(axis=1)
        return unsure + np.where(step > GAP * np.median(step), 10 * rolled, 0.0)[:, None]

    def _log_volume(self, geometry: Geometry, state: Array) -> float:
        """Return the logarithm of how far contacts move for a unit of the body's motion, summed over all steps.

        Before a log is seen, all that its wheels may roll is as likely, whatever the robot's dimensions. If all motions
        of the body were as likely instead, a track larger by 1 % would make a log of K steps less likely by 0.01 K, as
        the same counts turn the body less. (It is the term of the residual likelihood for the design matrix: Harville,
        Biometrika 61, 1974.)
        """
        total = 0.0
        for steps in blocks(len(state) - 1):
            a = self._matrices_in(geometry, state, steps)[0] * self._magnified(geometry)
            total += float(np.sum(np.linalg.slogdet(np.swapaxes(a, -1, -2) @ a + UNMOVED * np.eye(3))[1])) / 2
        return total

    def _magnified(self, geometry: Geometry) -> Array:
        """Return the factor (..., 1, 1) by which the wheels are smaller than described."""
        return self._radius / np.mean(geometry.radius[..., self._wheels], axis=-1)[..., None, None]


def _inverse_of(a: Array) -> Array:
    """Return the pseudo-inverses (k, 3, rows) of matrices (k, rows, 3)."""
    turned = np.swapaxes(a, 1, 2)
    with suppress(np.linalg.LinAlgError):  # several times faster than singular values, where none is near zero
        pivots = np.diagonal(np.linalg.cholesky(turned @ a), axis1=1, axis2=2)
        if np.all(pivots.min(axis=1) > DETERMINED * pivots.max(axis=1)):
            return np.asarray(np.linalg.solve(turned @ a, turned), dtype=np.float64)
    return np.asarray(np.linalg.pinv(a, rcond=1e-10), dtype=np.float64)


def _samples_of(steps: slice) -> slice:
    """Return the samples between which steps lie."""
    return slice(steps.start, steps.stop + 1)
