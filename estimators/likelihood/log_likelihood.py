"""Log-likelihood of one log under a robot description: errors of counts, slip and reference poses in one least squares.

Unknown, beside the description, is the state: at every sample the body's pose, the castors' angles and the wheels'.
Known are

    counts                   rounded: off by an even spread of one count; a run of equal counts is one reading
    rolling, no side slip    kept from sample to sample but for slip, of variance slip^2 times the distance rolled
    reference poses          off by independent errors, where they were taken

The rolling constraints are those of castor_envs.motion.kinematics, integrated over a step to fourth order in its
length: half-way values alone would bias castors that swing in. Each step ties two samples only, so the normal equations
are banded (Cholesky's factors by LAPACK). Angles and twist are linearised at the fitted state, not at the readings:
rounded regressors would bias the parameters toward zero.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.geometry.steps import body_motion, even_steps, half_way, integrated, smoothed
from castor_envs.logs.log import Log, pivot_jumps
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.sensors.encoders import castor_angles
from estimators.likelihood.elimination import LARGE, Rows, blocks, eliminated, information_on_states
from estimators.likelihood.sparse_columns import ByBlocks
from estimators.likelihood.whitening import Whitening

FLOOR = 1e-7
"""m: slip of a step in which nothing moves; it keeps the equations regular."""

GAP = 3.5
"""Steps longer than this many median steps are gaps: the motion in them is unknown."""

TIMED = 5
"""Least number of reference poses with which the offset of their clock is fitted."""

EXTENDED, FADED = 2.0, 6.0
"""A moving robot's motion is extended beyond a log's ends to poses from beyond: steps up to which these have full
weight, and at which their weight has faded to 0. (A pose that dropped out at once could come back in the next
iteration, and so on without end.)"""

REST = 6
"""Samples at a log's end in which no count may change by more than one, so that a pose from beyond the end is assigned
to it."""

PINNED = 1e-4
"""m and rad: without reference poses the first one is 0 by convention, to this much."""

APART, DENSE = 3.0, 0.5
"""s: of reference poses that follow each other faster than `DENSE`, as a tracker streams them, one in `APART` is used.
Errors of such poses within seconds (jitter of clocks, a filter) are correlated."""

CLOCK = np.array([1.0, 0.05])
"""s and 1: prior standard deviations of the reference's clock, at the start and in rate; wide enough not to matter."""

REACH = 2
"""Steps before and after a step with which its residuals are integrated to fourth order."""

UNMOVED = 1e-12
"""m2: keeps the logarithm finite for a motion that no contact notices."""

RATE_KNOWN = 1e-6
"""s/s: standard deviation of a known rate."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of noise.

    along, across: slip in the rolling direction and to the side, m after 1 m. position, heading: of reference poses, m
    along each axis and rad.
    """

    along: float = 3e-5
    across: float = 3e-5
    position: float = 2e-3
    heading: float = 5e-3


class Leftover(NamedTuple):
    """Residuals by the fields of `Noise`: sums of squares over variances, and their expected values."""

    squares: dict[str, float]
    expected: dict[str, float]


class Reduced(NamedTuple):
    """Statistics of P parameters in one log, state and clock eliminated, linearised about a state.

    information (P, P); gradient (P, 1 + probes): of half the sum of squares, then of the same with drawn residuals.
    clock (2, 2): information on the clock, given the parameters. log_evidence: log-likelihood of the log with the
    parameters unchanged, state and clock integrated out (natural logarithm, up to a constant of the log). finish: maps
    changes of the parameters (P, 1 + probes) and the part of the step that is taken to the changed state and clock, and
    the remaining residuals. squares: maps any geometry, state, clock and mount to the sum of squares there, with the
    weights of this state.
    """

    information: Array
    gradient: Array
    clock: Array
    log_evidence: float
    finish: Callable[..., tuple[Array, Array, Leftover]]
    squares: Callable[[Geometry, Array, Array, Array], float]


class ExtraColumns(NamedTuple):
    """R parameters beside those of the geometry, by the effect of a unit of each.

    readings (K, s + d, r): counts read too much, of the first r parameters; the others change no reading. slips: metres
    by which a step misses its constraints, parts (K - 1, rows, c) of successive parameters, R in all. rates (R,): rate
    of the reference's clock, s/s; None: 0.
    """

    readings: ByBlocks
    slips: tuple[ByBlocks, ...]
    rates: Array | None = None

    @property
    def parameters(self) -> int:
        """The number of parameters."""
        return sum(part.shape[-1] for part in self.slips)


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


class LogLikelihood:
    """One log of a robot of a known layout.

    The state (K, m = 3 + s + d) holds at every sample the body's x, y (m) and psi (rad), then the unwrapped counts of s
    pivot and d wheel encoders, as they would be were they not rounded.
    """

    def __init__(self, layout: Geometry, log: Log, number: int = 0) -> None:
        """number: of the log among those fitted together; it seeds the residuals that are drawn for it (`reduce`).

        If the same residuals were drawn for similar logs, the parameters would fit all of them at once: the expected
        residuals would be too small, and the estimated noise too large.
        """
        self._number = number
        sensed = np.flatnonzero(~np.isnan(layout.pivot_counts_per_rev))
        per_pivot = layout.pivot_counts_per_rev[sensed]
        for column, (castor, turn) in enumerate(zip(sensed, per_pivot, strict=True)):
            if (jumps := pivot_jumps(log.pivot[:, column], turn)).size:
                raise InputError(f"pivot {castor + 1} jumps by over half a turn at row {jumps[0] + 1}; sample faster")
        steps = np.diff(log.pivot, axis=0, prepend=log.pivot[:1])
        pivot = log.pivot[0] + np.cumsum(steps - per_pivot * np.round(steps / per_pivot), axis=0)
        self._counts = np.column_stack([pivot, log.wheel])
        self._readings = np.sqrt(12 * np.apply_along_axis(_share_of_reading, 0, self._counts))
        self._sensed, self._wheels = len(sensed), np.flatnonzero(~np.isnan(layout.counts_per_rev))

        self._wheel_count, self._radius = len(layout.radius), float(np.mean(layout.radius[self._wheels]))

        known = (layout.fixed | ~np.isnan(layout.pivot_counts_per_rev))[layout.wheel_castor]
        self._rolling = np.flatnonzero(known & ~np.isnan(layout.counts_per_rev))
        standing = np.flatnonzero(known & layout.standard)
        _, first = np.unique(layout.wheel_castor[standing], return_index=True)
        self._used = np.concatenate([self._rolling, len(layout.radius) + standing[first]])
        self._castor = np.tile(layout.wheel_castor, 2)[self._used]
        self._reference = np.full((len(log), 3), np.nan) if log.reference is None else log.reference
        self._posed = np.isfinite(self._reference[:, 0])
        self._used_poses = _apart(np.flatnonzero(self._posed), log.t)
        self._expected = np.zeros((len(log) - 1, len(self._used)))
        self._doubt: Array | float = 0.0
        self._released = np.zeros((len(log) - 1, len(self._used)), dtype=bool)
        self._jitter = 0.0
        self._stiffness: Array | None = None

        self._rests = tuple(
            bool(np.ptp(counts, axis=0).max() <= 1) for counts in (self._counts[:REST], self._counts[-REST:])
        )

        self._t = log.t
        self._even = even_steps(self._t)

    def correct(self, excess: Array) -> None:
        """Subtract a known excess of readings from the counts (K, s + d)."""
        self._counts = self._counts - excess

    def expect(self, slips: Array, doubt: Array | float = 0.0) -> None:
        """Set the expected slips (K - 1, rows), m, of steps, instead of 0; doubt: their standard deviation about what
        is expected, beyond noise, m."""
        self._expected, self._doubt = slips, doubt

    def jitter(self, duration: float) -> None:
        """Let all encoders be read early or late together, at random with a standard deviation of `duration`, s: the
        robot is not quite where the reference saw it."""
        self._jitter = duration

    def balance(self, stiffness: Array | None) -> None:
        """Let contacts creep freely where their wheels disagree. stiffness (K - 1, rows): of their creep, in any unit;
        None: contacts do not creep.

        Each step then says only how the body, and castors that nothing drives, move by the balance of all contacts'
        forces. What contradicts that, creep compensates: no matter how much, as wheels held at speeds that disagree
        have to slip. How much they usually disagree is another question (`disagreement`).
        """
        self._stiffness = stiffness

    def in_deviations(self, slips: Array, geometry: Geometry, state: Array, noise: Noise) -> Array:
        """Return slips (K - 1, rows), m, in standard deviations of slip noise."""
        whitening = self._whitening(geometry, state, noise)
        return whitening.applied(slice(None), slips[..., None])[..., 0]

    def release(self, steps: NDArray[np.bool_]) -> None:
        """Let contacts slip by as much as they roll in these steps (K - 1, rows)."""
        self._released = steps

    def rows_of(self, rolling: Array, side: Array) -> Array:
        """Return slips of wheels (K - 1, w) and, to the side, of castors (K - 1, n) as the rows of `residuals`."""
        return np.concatenate([rolling, side], axis=1)[:, self.slip_rows]

    @property
    def slip_rows(self) -> list[int]:
        """The place of every row of `residuals` among the slips of wheels and, to the side, of castors (w + n,)."""
        first = len(self._rolling)
        return [*self._rolling.tolist(), *(self._wheel_count + self._castor[first:]).tolist()]

    def rolled(self, geometry: Geometry, state: Array) -> Array:
        """Return the distance that every row's wheel rolled in every step (K - 1, rows), m; for side slip the mean of
        its castor's wheels."""
        rolled = self._rolled(geometry, state[:, 3:])
        first = len(self._rolling)
        in_castor = self._castor[:first] == self._castor[first:, None]
        rolled[:, first:] = rolled[:, :first] @ (in_castor / np.maximum(in_castor.sum(axis=1, keepdims=True), 1)).T
        return rolled

    def score_by_counts(self, state: Array) -> Array:
        """Return the score (K, s + d): derivatives of the log-likelihood by an excess of counts, at the most likely
        state."""
        return self._readings**2 * (self._counts - state[:, 3:])

    @property
    def stiffness(self) -> Array | None:
        """The stiffness of contacts (K - 1, rows) whose creep is free (`balance`); None: contacts do not creep."""
        return self._stiffness

    @property
    def counts(self) -> Array:
        """The counts (K, s + d) as read, unwrapped, less known errors (`correct`)."""
        return self._counts

    @property
    def rows(self) -> NDArray[np.intp]:
        """The rows of the constraints in use, by their place in `constraint_matrix`."""
        return self._used

    @property
    def poses(self) -> int:
        """The number of reference poses."""
        return int(self._posed.sum())

    @property
    def poses_used(self) -> int:
        """The number of reference poses in use: dense poses are not independent."""
        return len(self._used_poses)

    def start(self, geometry: Geometry) -> Array:
        """Return a state (K, m) to begin with: counts as read, poses by odometry bent to meet all reference poses.

        Odometry's error between two reference poses, first of the heading and then of the place, is distributed in
        proportion to the distance rolled: a jump at the second pose would be too large for the linearisation.
        """
        twist, anchors = self._twist(geometry), np.flatnonzero(self._posed)
        if len(anchors) < 2:
            return np.column_stack([self.odometry(geometry), self._counts])
        way = np.abs(self._rolled(geometry, self._counts)).max(axis=1)
        way = np.concatenate([[0.0], np.cumsum(way + FLOOR)])

        def shared_out(errors: Array) -> Array:
            return np.column_stack([np.interp(way, way[anchors], column) for column in errors.T])

        known = self._reference[anchors]
        turned = np.concatenate([[0.0], np.cumsum(twist[:, 2])])[:, None]
        twist[:, 2:] += np.diff(shared_out(known[:, 2:] - turned[anchors]), axis=0)
        path = _chained(twist)
        path = compose(known[0], relative_pose(path[anchors[0]], path))
        path += shared_out(known - path[anchors])
        return np.column_stack([path, self._counts])

    def odometry(self, geometry: Geometry, slips: Array | float = 0.0) -> Array:
        """Return poses (K, 3) from counts and from slips (K - 1, rows), m, by least squares in every step.

        From the first reference pose on, or from 0 at the first sample.
        """
        path = _chained(self._twist(geometry, slips))
        anchors = np.flatnonzero(self._posed)[:1]
        return compose(self._reference[anchors[0]], relative_pose(path[anchors[0]], path)) if len(anchors) else path

    def ways(self, geometry: Geometry) -> tuple[Array, Array]:
        """Return poses by odometry and by the reference (used poses, 3), where reference poses are in use."""
        used = self._used_poses
        return self.odometry(geometry)[used], self._reference[used]

    def _twist(self, geometry: Geometry, slips: Array | float = 0.0) -> Array:
        """Return the body's motion (K - 1, 3) in every step, in B, from counts and slips: by least squares or, where
        contacts creep freely (`balance`), by the balance of their forces."""
        angle = self._angles(geometry, self._counts)
        a, b = self._matrices(geometry, (angle[1:] + angle[:-1]) / 2)
        right = self._rolled(geometry, self._counts) - b * np.diff(angle, axis=0)[:, self._castor]
        right += slips / self._magnified(geometry)[..., 0]
        motion = (np.linalg.pinv(a, rcond=1e-10) @ right[..., None])[..., 0]
        if self._stiffness is None:
            return motion
        disagreeing = smoothed(right - (a @ motion[..., None])[..., 0])  # what rounding adds is no motion
        stiff = np.sqrt(self._stiffness / self._stiffness.max(axis=1, keepdims=True))
        balanced = np.linalg.pinv(stiff[..., None] * self._moved(geometry, a, b), rcond=1e-10)
        return motion + (balanced[:, :3] @ (stiff * disagreeing)[..., None])[..., 0]

    def errors(self, geometry: Geometry, state: Array, clock: Array, mount: Array, slips: Array | None = None) -> Array:
        """Return the error at every reference pose (poses, 3) of odometry that accounts for slips (K - 1, rows), m,
        None: those that are expected (`expect`); it starts at the state's first pose."""
        known = np.flatnonzero(self._posed)
        at, part = self._steps_of_poses(known, clock)
        path = compose(self.odometry(geometry, self._expected if slips is None else slips), mount)
        truly = compose(state[:, :3], mount)
        part = np.clip(part, 0.0, 1.0)
        path, truly = ((1 - part) * poses[at] + part * poses[at + 1] for poses in (path, truly))
        return compose(truly[0], relative_pose(path[0], path)) - self._reference[known]

    def _steps_of_poses(self, samples: NDArray[np.intp], clock: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the sample after which each of these samples' reference was taken, and the part (k, 1) of the step up
        to it.

        The part is below 0 or above 1 for poses that were taken before or after the log.
        """
        t = self._t
        taken = t[samples] + clock[0] + clock[1] * (t[samples] - t[0])
        at = np.clip(np.searchsorted(t, taken, side="right") - 1, 0, len(t) - 2)
        return at, ((taken - t[at]) / (t[at + 1] - t[at]))[:, None]

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

    def reduce(
        self,
        geometry: Geometry,
        changed: Geometry,
        change: Array,
        state: Array,
        clock: Array,
        mount: Array,
        noise: Noise,
        probes: int = 0,
        extra: ExtraColumns | None = None,
        rate: float | None = None,
    ) -> Reduced:
        """Return the log's statistics of P parameters, linearised about a state (K, m).

        changed: geometries (G,), in each of which one parameter is larger by change (G,). probes: number of draws of
        residuals (standard normal, the same in each call, different for each log), from which expected sums of squares
        are estimated. extra: columns of the other P - G parameters. rate: of the reference's clock (s/s), if it is
        known.
        """
        from scipy.linalg import cho_solve_banded, cholesky_banded  # slow to import

        weights, slipping = self._weights(state, noise), self._whitening(geometry, state, noise)
        kinds = self._linearised(geometry, changed, change, state, clock, mount, weights, slipping, extra)
        size, p = state.shape[1], len(change) + (extra.parameters if extra else 0) + len(mount)
        n = p + len(clock)
        random = np.random.default_rng(self._number)
        for name, rows in kinds.items():
            groups = np.split(rows.values, [len(self._rolling)] if name == "slips" else [], axis=1)
            drawn = [random.normal(size=(*group.shape, probes)) for group in groups]
            kinds[name] = rows._replace(drawn=np.concatenate(drawn, axis=1))
        information = information_on_states(kinds.values(), len(state), size)
        factors = cholesky_banded(information, overwrite_ab=True, check_finite=False)
        numbers_block = eliminated(kinds.values(), factors, n, n + 1 + probes)
        least = float(numbers_block[n, n])
        numbers_block = numbers_block[:n]
        clock_deviation, expected_clock = CLOCK if self.poses_used >= TIMED else CLOCK * 1e-6, np.zeros(2)
        if rate is not None:
            clock_deviation, expected_clock = np.array([clock_deviation[0], RATE_KNOWN]), np.array([0.0, rate])
        numbers_block[p:, p:n] += np.diag(clock_deviation**-2.0)
        numbers_block[p:, n] += (clock - expected_clock) / clock_deviation**2
        least += float(np.sum(((clock - expected_clock) / clock_deviation) ** 2))
        clocks = np.linalg.solve(numbers_block[p:, p:n], np.delete(numbers_block[p:], np.s_[p:n], axis=1))
        reduced = np.delete(numbers_block[:p], np.s_[p:n], axis=1) - numbers_block[:p, p:n] @ clocks
        least -= float(numbers_block[p:, n] @ clocks[:, p])
        log_evidence = -least / 2 - float(np.sum(np.log(factors[-1])))
        log_evidence -= float(np.linalg.slogdet(numbers_block[p:, p:n])[1]) / 2
        for name, weight in weights.items():
            log_evidence += float(np.sum(np.log(np.broadcast_to(weight, kinds[name].values.shape))))
        log_evidence += slipping.log_density + self._log_volume(geometry, state)

        def finish(moved_by: Array, part: float = 1.0) -> tuple[Array, Array, Leftover]:
            set_by = -(clocks[:, p:] + clocks[:, :p] @ moved_by)
            all_by = np.concatenate([moved_by, set_by])
            columns = np.zeros((len(state), size, 1 + probes))
            for block in blocks(len(state), LARGE):
                for rows in kinds.values():
                    chosen = rows.within(block.start, block.stop)
                    if chosen.start < chosen.stop:
                        rows.add_by_state(columns, 0, chosen, rows.left(chosen, all_by))
            away = -cho_solve_banded((factors, False), columns.reshape(-1, 1 + probes), check_finite=False)
            away = away.reshape(len(state), size, 1 + probes)
            if part < 1:
                away[..., 0], all_by[:, 0], set_by[:, 0] = part * away[..., 0], part * all_by[:, 0], part * set_by[:, 0]
            total: dict[str, Array] = {}
            for name, rows in kinds.items():
                for block in blocks(len(state), LARGE):
                    some = rows.within(block.start, block.stop)
                    left = rows.left(some, all_by) + rows.by_state(some, away)
                    for field, residuals in self._by_fields(name, left, slipping, some):
                        total[field] = total.get(field, np.zeros(1 + probes)) + np.sum(residuals**2, axis=(0, 1))
            squares = {field: float(sums[0]) for field, sums in total.items()}
            expected = {field: float(np.mean(sums[1:])) if probes else 0.0 for field, sums in total.items()}
            return state + away[..., 0], clock + set_by[:, 0], Leftover(squares, expected)

        def squares_at(geometry: Geometry, state: Array, clock: Array, mount: Array) -> float:
            values = self._values(self.residuals(geometry, state), state, clock, mount, weights, slipping)
            return float(
                sum(np.sum(part**2) for part in (*values.values(), (clock - expected_clock) / clock_deviation))
            )

        return Reduced(
            (reduced[:, :p] + reduced[:, :p].T) / 2,
            reduced[:, p:],
            numbers_block[p:, p:n],
            log_evidence,
            finish,
            squares_at,
        )

    def _by_fields(self, name: str, left: Array, slipping: Whitening, steps: slice) -> list[tuple[str, Array]]:
        """Return the residuals (k, rows, c) of a kind of `_values` by the fields of `Noise`: of slips, those of
        each contact."""
        if name != "slips":
            return [(name, left)]
        left, rolling = slipping.of_contacts(steps, left), len(self._rolling)
        return [("along", left[:, :rolling]), ("across", left[:, rolling:])]

    def _weights(self, state: Array, noise: Noise) -> dict[str, Array]:
        """Return one over the standard deviation of every equation at a state but for slips, by the kinds of
        `_values`."""
        found = {"counts": self._readings}
        if not self.poses:
            return found | {"pinned": np.full((1, 3), 1 / PINNED)}
        rate = self._jitter * np.gradient(state[:, :3], self._t, axis=0)[self._used_poses]
        found["position"] = 1 / np.hypot(noise.position, rate[:, :2])
        return found | {"heading": 1 / np.hypot(noise.heading, rate[:, 2:])}

    def _whitening(self, geometry: Geometry, state: Array, noise: Noise) -> Whitening:
        """Return how slips at a state are made independent, each of standard deviation 1."""
        farthest = np.abs(self._rolled(geometry, state[:, 3:])).max(axis=1)
        sizes = np.repeat([noise.along, noise.across], [len(self._rolling), len(self._used) - len(self._rolling)])
        slip = sizes**2 * farthest[:, None] + FLOOR**2 + np.square(self._doubt)
        free = np.where(self._released, farthest[:, None], 0.0)
        weight = 1 / np.sqrt(slip + free**2 + self._unsure(geometry, state) ** 2)
        if self._stiffness is None:
            return Whitening(weight, None, float(np.sum(np.log(weight))))
        # contacts that slip for another reason hardly hold
        stiffness = slip * weight**2 * self._stiffness / self._stiffness.max(axis=1, keepdims=True)
        return Whitening.balanced(
            weight,
            stiffness,
            lambda steps: self._moved(geometry, *self._matrices_in(geometry, state, steps)),
        )

    def _turning(self, geometry: Geometry) -> NDArray[np.bool_]:
        """Return which castors (n,) turn freely."""
        return ~geometry.fixed & ~geometry.driven

    def _moved(self, geometry: Geometry, a: Array, b: Array) -> Array:
        """Return how far every row's contact moves (k, rows, 3 + f) for a unit of the body's motion, and of the turning
        of each castor that nothing drives, m. a, b: from `_matrices`."""
        turning = self._castor[:, None] == np.flatnonzero(self._turning(geometry))
        return np.concatenate([a, turning * b[..., None]], axis=-1)

    def _values(
        self,
        in_constraints: Array,
        state: Array,
        clock: Array,
        mount: Array,
        weights: dict[str, Array],
        slipping: Whitening,
    ) -> dict[str, Array]:
        """Return the residuals of a state in all equations, in standard deviations, by kind: "counts", "slips",
        "pinned", or the field of `Noise` that weights them. in_constraints: from `residuals`."""
        residuals = {"counts": state[:, 3:] - self._counts}
        if self.poses:
            at, part, known = self._shown(clock)
            off = compose((1 - part) * state[at, :3] + part * state[at + 1, :3], mount)
            off = known * (off - self._reference[self._used_poses])
            residuals |= {"position": off[:, :2], "heading": off[:, 2:]}
        else:
            residuals["pinned"] = state[:1, :3]
        slips = slipping.applied(slice(None), (in_constraints - self._expected)[..., None])[..., 0]
        return {name: weights[name] * off for name, off in residuals.items()} | {"slips": slips}

    def _shown(self, clock: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the sample after which each used reference pose was taken, the part (k, 1) of the step up to it, and
        its weight (k, 1), which fades out beyond the log's ends."""
        at, part = self._steps_of_poses(self._used_poses, clock)
        held = np.clip(part, 0.0 if self._rests[0] else -np.inf, 1.0 if self._rests[1] else np.inf)
        outside = np.abs(held - np.clip(held, 0.0, 1.0))
        return at, np.clip(held, -FADED, 1 + FADED), np.clip((FADED - outside) / (FADED - EXTENDED), 0.0, 1.0)

    def _linearised(
        self,
        geometry: Geometry,
        changed: Geometry,
        change: Array,
        state: Array,
        clock: Array,
        mount: Array,
        weights: dict[str, Array],
        slipping: Whitening,
        extra: ExtraColumns | None,
    ) -> dict[str, Rows]:
        """Return all equations linearised about a state, by the kinds of `_values`."""
        samples, eye, first = np.arange(len(state)), np.eye(state.shape[1]), len(change)
        extra_count, slips = (extra.parameters, extra.slips) if extra else (0, ())
        count = first + extra_count + len(mount) + len(clock)
        residual, (by_start, by_end) = self.residuals(geometry, state), self._derivatives(geometry, state)
        touched = np.any(by_start, axis=0) | np.any(by_end, axis=0)
        numbers_of = np.argsort(~touched, axis=1, kind="stable")[:, : touched.sum(axis=1).max(initial=1)]
        of_row = np.arange(len(numbers_of))[:, None]  # a row depends on few numbers of the state
        by_start, by_end = by_start[:, of_row, numbers_of], by_end[:, of_row, numbers_of]
        values = self._values(residual, state, clock, mount, weights, slipping)

        def read(chosen: slice) -> Array:
            by = np.zeros((*self._readings[chosen].shape, count))
            if extra:
                end = first + extra.readings.shape[-1]
                np.multiply(self._readings[chosen, :, None], extra.readings[chosen], out=by[..., first:end])
            return by

        def by_state(chosen: slice, derivatives: Array) -> Array:
            by = np.zeros((*derivatives[chosen].shape[:2], len(eye)))
            by[:, of_row, numbers_of] = derivatives[chosen]
            return slipping.applied(chosen, by)

        kinds = {
            "counts": Rows(
                samples, values["counts"], lambda chosen: self._readings[chosen, :, None] * eye[3:], numbers=read
            )
        }

        by_geometry = partial(self._by_change, geometry, changed, change, state)
        if extra is None:  # a fit of the geometry asks for its few columns again and again
            by_geometry = np.concatenate([by_geometry(steps) for steps in blocks(len(residual))]).__getitem__

        def by_slips(chosen: slice) -> Array:
            columns = slipping.applied(
                chosen, np.concatenate([by_geometry(chosen), *(-part[chosen] for part in slips)], axis=-1)
            )
            return np.concatenate([columns, np.zeros((*columns.shape[:2], count - columns.shape[-1]))], axis=-1)

        start, end = (partial(by_state, derivatives=derivatives) for derivatives in (by_start, by_end))
        kinds["slips"] = Rows(samples[:-1], values["slips"], start, end, by_slips)
        if not self.poses:
            kinds["pinned"] = Rows(samples[:1], values["pinned"], (eye[None, :3] / PINNED).__getitem__)
            return kinds

        at, part, known = self._shown(clock)
        since = self._t[self._used_poses] - self._t[0]
        body = (1 - part) * state[at, :3] + part * state[at + 1, :3]
        seen = compose(body, mount)
        by_body = np.tile(eye[:3], (len(at), 1, 1))
        by_body[:, 0, 2], by_body[:, 1, 2] = body[:, 1] - seen[:, 1], seen[:, 0] - body[:, 0]
        c, s, zeros, ones = np.cos(body[:, 2]), np.sin(body[:, 2]), np.zeros(len(at)), np.ones(len(at))
        by_mount = np.array([[c, -s, zeros], [s, c, zeros], [zeros, zeros, ones]]).transpose(2, 0, 1)
        speed = (state[at + 1, :3] - state[at, :3]) / (self._t[at + 1] - self._t[at])[:, None]
        by_clock = (by_body[..., :3] @ speed[..., None]) * np.column_stack([ones, since])[:, None, :]
        rates = np.zeros(extra_count) if extra is None or extra.rates is None else extra.rates
        by_extra = np.concatenate([np.zeros((len(at), 3, first)), by_clock[..., 1:] * rates], axis=-1)
        numbers = np.concatenate([by_extra, by_mount, by_clock], axis=-1)
        parts = ((1 - part)[..., None] * by_body, part[..., None] * by_body, numbers)
        for name, axes in (("position", slice(0, 2)), ("heading", slice(2, 3))):
            weight = (weights[name] * known)[..., None]
            start, end, by_numbers = ((weight * slope[:, axes]).__getitem__ for slope in parts)
            kinds[name] = Rows(at, values[name], start, end, by_numbers)
        return kinds

    def _derivatives(
        self, geometry: Geometry, state: Array, even: NDArray[np.bool_] | None = None
    ) -> tuple[Array, Array]:
        """Return the derivatives of `residuals` by the state at the start and end of every step, to second order."""
        even = self._even if even is None else even
        angle, body, s = self._angles(geometry, state[:, 3:]), body_motion(state, even), self._sensed
        middle = (angle[1:] + angle[:-1]) / 2
        a, b = self._matrices(geometry, middle)
        # A is a part that turns with the castors and one that stays; half a turn on, the first is reversed.
        opposite, quarter = (self._matrices(geometry, middle + by)[0] for by in (np.pi, np.pi / 2))
        pointing = ((quarter - (a + opposite) / 2) @ body[..., None])[..., 0]

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

    def masked_by_creep(self, changes: Changes, stiffness: Array) -> Array:
        """Return the slips (K - 1, rows, G + R) by which wheels compensate contradictions between their counts, per
        unit of changes of geometry and readings.

        Wheels whose held speeds contradict each other creep with the least loss of power: weighted least squares with
        the stiffness of each row (K - 1, rows), of the residuals that no motion of body and castors explains.
        """
        geometry, masked = changes.geometry, []
        for steps in blocks(len(stiffness)):
            stiff = np.sqrt(stiffness[steps] / stiffness[steps].max(axis=1, keepdims=True))
            moved = self._moved(geometry, *self._matrices_in(geometry, changes.state, steps))
            contradicting = self.contradicting(changes, steps)
            by_motion = np.linalg.pinv(stiff[..., None] * moved, rcond=1e-10)
            masked.append(contradicting - moved @ (by_motion @ (stiff[..., None] * contradicting)))
            masked[-1][np.abs(masked[-1]) <= 1e-12 * np.abs(contradicting).max()] = 0.0  # without contradiction
        return np.concatenate(masked)

    def missing(self, changes: Changes, steps: slice) -> Array:
        """Return the error of odometry in the body's motion in some steps (k, 3, G + R), in B, m and rad, per unit of
        changes."""
        return self.as_motion(changes.geometry, changes.state[_samples_of(steps)], self._decreasing(changes, steps))

    def as_motion(self, geometry: Geometry, state: Array, slips: Array) -> Array:
        """Return the motion of the body in every step (K - 1, 3, n), in B, that odometry computes from slips (K - 1,
        rows, n)."""
        angle = self._angles(geometry, state[:, 3:])
        a, _ = self._matrices(geometry, (angle[1:] + angle[:-1]) / 2)
        return np.linalg.pinv(a, rcond=1e-10) @ slips

    def explained(self, geometry: Geometry, state: Array, slips: Array) -> Array:
        """Return the part of slips (K - 1, rows) that a motion of the body explains, by least squares."""
        angle = self._angles(geometry, state[:, 3:])
        a, _ = self._matrices(geometry, (angle[1:] + angle[:-1]) / 2)
        return (a @ self.as_motion(geometry, state, slips[..., None]))[..., 0]

    def disagreement(self, geometry: Geometry, state: Array) -> Array:
        """Return the disagreement of wheels (K - 1, rows), m: the residuals of the constraints that no motion of the
        body explains."""
        seen = self.residuals(geometry, state)
        return seen - self.explained(geometry, state, seen)

    def agreement_by(self, changes: Changes, steps: slice) -> Array:
        """Return the decrease of the disagreement in some steps (k, rows, G + R), per unit of changes."""
        decrease = self._decreasing(changes, steps)
        a, _ = self._matrices_in(changes.geometry, changes.state, steps)
        return decrease - a @ (np.linalg.pinv(a, rcond=1e-10) @ decrease)

    def _decreasing(self, changes: Changes, steps: slice) -> Array:
        """Return the decrease of the residuals of some steps (k, rows, G + R), per unit of changes."""
        contradicting = self.contradicting(changes, steps)
        contradicting[..., len(changes.change) :] -= changes.slips[steps]
        return np.negative(contradicting, out=contradicting)

    def contradicting(self, changes: Changes, steps: slice) -> Array:
        """Return the change of the residuals of some steps (k, rows, G + R), per unit of changes of geometry and
        readings."""
        near, inner = self._near(steps)
        start, end = self._derivatives(changes.geometry, changes.state[_samples_of(near)], self._even[near])
        by_change = self._by_change(changes.geometry, changes.changed, changes.change, changes.state, steps)
        read = changes.readings[_samples_of(steps)]
        by_reading = -(start[inner, :, 3:] @ read[:-1] + end[inner, :, 3:] @ read[1:])
        return np.concatenate([by_change, by_reading], axis=-1)

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

    def _rolled(self, geometry: Geometry, counts: Array) -> Array:
        """Return the distances that wheels rolled in every step (..., K - 1, rows), m; 0 in rows of side slip."""
        length = (2 * np.pi * geometry.radius / geometry.counts_per_rev)[..., None, self._rolling]
        counted = np.diff(counts[:, self._sensed :], axis=0)[:, np.searchsorted(self._wheels, self._rolling)]
        rolled = counted * length
        idle = np.zeros((*rolled.shape[:-1], len(self._used) - len(self._rolling)))
        return np.concatenate([rolled, idle], axis=-1)

    def _unsure(self, geometry: Geometry, state: Array) -> Array:
        """Return the error estimate of the integration over every step (K - 1, rows), m.

        Second order: the difference to fourth order; fourth order: this difference times the squared angle by which the
        fastest castor turns in a step, the ratio between successive orders. In gaps: unbounded.
        """
        angle = self._angles(geometry, state[:, 3:])[:, np.unique(self._castor)]
        turned = np.abs(np.diff(angle, axis=0)).max(axis=1, initial=0.0)
        around = np.maximum.reduce([turned, np.append(turned[1:], 0.0), np.append(0.0, turned[:-1])])
        second, fourth = (self.residuals(geometry, state, np.full(len(turned), order)) for order in (False, True))
        unsure = np.abs(fourth - second) * np.where(self._even, around**2, 1.0)[:, None]
        step = np.diff(self._t)
        rolled = np.abs(self._rolled(geometry, state[:, 3:])).max(axis=1)
        return unsure + np.where(step > GAP * np.median(step), 10 * rolled, 0.0)[:, None]

    def _magnified(self, geometry: Geometry) -> Array:
        """Return the factor (..., 1, 1) by which the wheels are smaller than described."""
        return self._radius / np.mean(geometry.radius[..., self._wheels], axis=-1)[..., None, None]


def _samples_of(steps: slice) -> slice:
    """Return the samples between which steps lie."""
    return slice(steps.start, steps.stop + 1)


def _chained(twist: Array) -> Array:
    """Return poses (K, 3) from 0 on after constant body motions (K - 1, 3)."""
    heading = np.concatenate([[0.0], np.cumsum(twist[:, 2])])
    middle = (heading[1:] + heading[:-1]) / 2
    way = (twist[:, 0] + 1j * twist[:, 1]) * np.sinc(twist[:, 2] / (2 * np.pi)) * np.exp(1j * middle)
    x, y = (np.concatenate([[0.0], np.cumsum(part)]) for part in (way.real, way.imag))
    return np.column_stack([x, y, heading])


def moved_along(state: Array, step: Array) -> Array:
    """Return a state (K, m) moved by a step, applied as changes of each pose relative to the pose before.

    A large step applied in the world distorts a path that turns: a path that turns as a whole by 0.1 rad is lengthened
    by half a per cent if every point moves straight, which wheels do not slip.
    """
    moved, heading = state + step, state[:-1, 2]
    motion, change = relative_pose(state[:-1, :3], state[1:, :3])[:, :2], np.diff(step[:, :2], axis=0)
    motion = motion @ [1, 1j] * (1 - 1j * step[:-1, 2]) + change @ [1, 1j] * np.exp(-1j * heading)
    way = np.cumsum(motion * np.exp(1j * moved[:-1, 2]))
    moved[1:, :2] = moved[0, :2] + np.column_stack([way.real, way.imag])
    return moved


def _apart(samples: NDArray[np.intp], t: Array) -> NDArray[np.intp]:
    """Return these samples or, if they are dense, the first, the last, and between them one in `APART`."""
    if len(samples) < 2 or np.median(np.diff(t[samples])) >= DENSE:
        return samples
    kept: list[int] = []
    for k in samples.tolist():
        if not kept or t[k] - t[kept[-1]] >= APART * (1 - 1e-9) or k == samples[-1]:
            kept.append(k)
    return np.array(kept, dtype=np.intp)


def _share_of_reading(counts: Array) -> Array:
    """Return for every count (K,) one over the length of the run of equal counts that it is in."""
    begins = np.concatenate([[True], np.diff(counts) != 0])
    run = np.cumsum(begins) - 1
    return 1.0 / np.bincount(run)[run]
