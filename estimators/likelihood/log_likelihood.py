"""Log-likelihood of one log under a robot description: errors of counts, slip and reference poses in one least squares.

Unknown, beside the description, is the state: at every sample the body's pose, the castors' angles and the wheels'.
Known are

    counts                   rounded: off by an even spread of one count; errors of a run of equal counts correlate, as
                             the shaft moves by less than a count; within a backlash the reading stands still, and is
                             off by an even spread of the backlash
    rolling, no side slip    kept from sample to sample but for slip, of variance slip^2 times the distance rolled, and
                             turning^2 times the angle by which a motor that steers turns the contact on the floor
    reference poses          off by independent errors, where they were taken (`measurements.poses`)
    yaw rates of a gyro      off by noise, a bias and a latency, where the robot file describes it (`measurements.gyro`)

Each step ties two samples only, so the normal equations are banded (Cholesky's factors by LAPACK). Angles and twist are
linearised at the fitted state, not at the readings: rounded regressors would bias the parameters toward zero.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.geometry.alignment import aligned
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.geometry.steps import path_of, smoothed
from castor_envs.logs.log import Log, pivot_jumps, unwrapped
from castor_envs.motion.kinematics import Geometry
from estimators.likelihood.elimination import FEW, LARGE, Rows, blocks, information_on_states, log_determinant
from estimators.likelihood.measurements.gyro import GyroRates
from estimators.likelihood.measurements.poses import ReferencePoses
from estimators.likelihood.reduction import Leftover, Reduced, reduced
from estimators.likelihood.rolling import RollingConstraints
from estimators.likelihood.sparse_columns import ByBlocks
from estimators.likelihood.whitening import Whitening

FLOOR = 1e-7
"""m: slip of a step in which nothing moves; it keeps the equations regular."""

WITHIN = 2.0
"""How often the correlation of rounding errors decays by e while a reading stays the same: that of a shaft that turns
evenly through a count falls from 1 to -1."""

MOVED = 1e-5
"""m and rad: step for derivatives of the volume by the mount."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of noise.

    along, across: slip in the rolling direction and to the side, m after 1 m. position, heading: of reference poses, m
    along each axis and rad. gyro: of a reading, rad/s. turning: slip in either direction, m after the contact has
    turned on the floor by 1 rad: a wheel that is steered where it stands hardly holds.
    """

    along: float = 3e-5
    across: float = 3e-5
    position: float = 2e-3
    heading: float = 5e-3
    gyro: float = 1e-3
    turning: float = 3e-6


class ExtraColumns(NamedTuple):
    """R parameters beside those of the geometry, by the effect of a unit of each.

    readings (K, s + d, r): counts read too much, of the first r parameters; the others change no reading. slips: metres
    by which a step misses its constraints, parts (K - 1, rows, c) of successive parameters, R in all. rates (R,): rate
    of the reference's clock, s/s; sways (R,): by how much reference poses are off in proportion to the acceleration of
    the tracked point, s2; gyro_scales (R,): by which the gyro reads too much, as a part; None: 0.
    """

    readings: ByBlocks
    slips: tuple[ByBlocks, ...]
    rates: Array | None = None
    sways: Array | None = None
    gyro_scales: Array | None = None

    @property
    def parameters(self) -> int:
        """The number of parameters."""
        return sum(part.shape[-1] for part in self.slips)


class LogLikelihood(RollingConstraints):
    """One log of a robot of a known layout, with all that it measures."""

    def __init__(self, layout: Geometry, log: Log, number: int = 0) -> None:
        """number: of the log among those fitted together; it seeds the residuals that are drawn for it (`reduce`).

        If the same residuals were drawn for similar logs, the parameters would fit all of them at once: the expected
        residuals would be too small, and the estimated noise too large.
        """
        super().__init__(layout, log.t)
        self._number = number
        sensed = np.flatnonzero(~np.isnan(layout.pivot_counts_per_rev))
        per_pivot = layout.pivot_counts_per_rev[sensed]
        for column, (castor, turn) in enumerate(zip(sensed, per_pivot, strict=True)):
            if (jumps := pivot_jumps(log.pivot[:, column], turn)).size:
                raise InputError(f"pivot {castor + 1} jumps by over half a turn at row {jumps[0] + 1}; sample faster")
        self._counts = np.column_stack([unwrapped(log.pivot, per_pivot), log.wheel])
        self._alike, self._spread, self._length = np.stack([_of_runs(column) for column in self._counts.T], axis=-1)
        self._play, self._latencies = np.zeros(self._counts.shape), np.zeros(self._counts.shape[1])
        self._weigh_counts()
        self._poses, self._gyro = ReferencePoses(log, self._counts), GyroRates(layout, log)
        self._expected = np.zeros((len(log) - 1, len(self._used)))
        self._doubt: Array | float = 0.0
        self._released = np.zeros((len(log) - 1, len(self._used)), dtype=bool)
        self._jitter = 0.0
        self._stiffness: Array | None = None
        if self._poses.headless:
            self._poses.guess_headings(path_of(self._twist(layout)), self._way(layout), layout.reach)

    def correct(self, excess: Array, play: Array | float = 0.0, latencies: Array | None = None) -> None:
        """Subtract a known excess of readings from the counts (K, s + d). play: standard deviation, in counts, of
        readings that stand still while the encoder's shaft moves within its play; 0 of those that follow. latencies
        (s + d,): s, after which encoders were read; None: at once.

        A reading that stands still says where the shaft is to no better than the play, but what it reads is as certain
        as of any: as a density of the reading it is as high as others, and wider (`_of_play`).
        """
        self._counts = self._counts - excess
        self._play = np.broadcast_to(np.square(play), self._counts.shape)
        self._latencies = self._latencies if latencies is None else latencies
        self._weigh_counts()

    def _weigh_counts(self) -> None:
        """Set variances of errors of counts (K, s + d), the part of each error that is kept from the sample before, and
        one over the standard deviation of what is new in it."""
        when = [self._t + latency for latency in self._latencies.tolist()]
        alike, spread, length = (
            np.column_stack([np.interp(t, self._t, column) for t, column in zip(when, of.T, strict=True)])
            for of in (self._alike, self._spread, self._length)
        )
        free = self._play > 0  # within a play nothing holds the shaft
        alike, spread = np.where(free, 0.0, alike), np.where(free, length, spread)
        self._variances = (1 / 12 + self._play) * spread
        size = np.sqrt(self._variances)
        self._kept = alike * size / np.concatenate([size[:1], size[:-1]])
        self._readings = 1 / (size * np.sqrt(1 - alike**2))

    def expect(self, slips: Array, doubt: Array | float = 0.0) -> None:
        """Set the expected slips (K - 1, rows), m, of steps, instead of 0; doubt: their standard deviation about what
        is expected, beyond noise, m."""
        self._expected, self._doubt = slips, doubt

    def jitter(self, duration: float) -> None:
        """Let all encoders be read early or late together, at random with a standard deviation of `duration`, s: the
        robot is not quite where the reference saw it."""
        self._jitter = duration

    def scale_gyro(self, scale: float) -> None:
        """Let the gyro be known to read too much by `scale`, as a part."""
        self._gyro.scale = scale

    def balance(self, stiffness: Array | None) -> None:
        """Let contacts creep freely where their wheels disagree. stiffness (K - 1, rows): of their creep, in any unit;
        None: contacts do not creep.

        Each step then says only how the body, and castors that nothing drives, move by the balance of all contacts'
        forces. What contradicts that, creep compensates: no matter how much, as wheels held at speeds that disagree
        have to slip. How much they usually disagree is another question (`disagreement`).
        """
        self._stiffness = stiffness

    def release(self, steps: NDArray[np.bool_]) -> None:
        """Let contacts slip by as much as they roll in these steps (K - 1, rows)."""
        self._released = steps

    @property
    def counts(self) -> Array:
        """The counts (K, s + d) as read, unwrapped, less known errors (`correct`)."""
        return self._counts

    @property
    def stiffness(self) -> Array | None:
        """The stiffness of contacts (K - 1, rows) whose creep is free (`balance`); None: contacts do not creep."""
        return self._stiffness

    @property
    def poses(self) -> int:
        """The number of reference poses."""
        return len(self._poses.taken)

    @property
    def poses_used(self) -> int:
        """The number of reference poses in use: dense poses are not independent."""
        return len(self._poses.used)

    @property
    def headings(self) -> int:
        """The number of reference poses with a heading: of positions alone 0."""
        return int(np.isfinite(self._poses.poses[:, 2]).sum())

    @property
    def guessed(self) -> Array:
        """The reference poses (K, 3), NaN where none was taken, with headings to start from where they have none."""
        return self._poses.guessed

    def acceleration(self, state: Array, clock: Array, mount: Array) -> float:
        """Return the tracked point's acceleration where reference poses in use were taken, rms, m/s2; 0 without any."""
        return float(np.linalg.norm(self._poses.accelerations(state, clock, mount)) / max(self.poses_used, 1) ** 0.5)

    @property
    def gyro_steps(self) -> int:
        """The number of steps in which the gyro tells the body's turn."""
        return len(self._gyro.steps)

    def gyro_numbers(self, state: Array, noise: Noise) -> Array:
        """Return the most likely bias of the gyro at the log's start, rad/s, beyond the robot file's, by how much it
        walks in each piece of the log, and its latency, s, at a state."""
        return self._gyro.numbers(state, self._gyro.weights(noise.gyro))

    def in_deviations(self, slips: Array, geometry: Geometry, state: Array, noise: Noise) -> Array:
        """Return slips (K - 1, rows), m, in standard deviations of slip noise."""
        whitening = self._whitening(geometry, state, noise)
        return whitening.applied(slice(None), slips[..., None])[..., 0]

    def score_by_counts(self, state: Array) -> Array:
        """Return the score (K, s + d): derivatives of the log-likelihood by an excess of counts, at the most likely
        state."""
        score = self._readings**2 * self._new(self._counts - state[:, 3:])
        score[:-1] -= (self._kept * score)[1:]
        return score

    def _new(self, off: Array) -> Array:
        """Return errors of counts (K, s + d) less what those of the sample before let expect."""
        return np.concatenate([off[:1], off[1:] - self._kept[1:] * off[:-1]])

    def start(self, geometry: Geometry) -> Array:
        """Return a state (K, m) to begin with: counts as read, poses by odometry bent to meet all reference poses.

        Odometry's error between two reference poses, first of the heading and then of the place, is distributed in
        proportion to the distance rolled: a jump at the second pose would be too large for the linearisation.
        """
        twist, anchors = self._twist(geometry), self._poses.taken
        if len(anchors) < 2:
            return np.column_stack([self.odometry(geometry), self._counts])
        way = self._way(geometry)

        def shared_out(errors: Array) -> Array:
            return np.column_stack([np.interp(way, way[anchors], column) for column in errors.T])

        known = self._poses.guessed[anchors]
        turned = np.concatenate([[0.0], np.cumsum(twist[:, 2])])[:, None]
        twist[:, 2:] += np.diff(shared_out(known[:, 2:] - turned[anchors]), axis=0)
        path = path_of(twist)
        path = compose(known[0], relative_pose(path[anchors[0]], path))
        path += shared_out(known - path[anchors])
        return np.column_stack([path, self._counts])

    def odometry(self, geometry: Geometry, slips: Array | float = 0.0) -> Array:
        """Return poses (K, 3) from counts and from slips (K - 1, rows), m, by least squares in every step.

        From the first reference pose on, or from 0 at the first sample.
        """
        path = path_of(self._twist(geometry, slips))
        anchors = self._poses.taken[:1]
        return compose(self._poses.guessed[anchors[0]], relative_pose(path[anchors[0]], path)) if len(anchors) else path

    def ways(self, geometry: Geometry) -> tuple[Array, Array]:
        """Return poses by odometry and by the reference (k, 3), where whole reference poses are in use."""
        used = self._poses.used[np.isfinite(self._poses.poses[self._poses.used]).all(axis=1)]
        return self.odometry(geometry)[used], self._poses.poses[used]

    def _way(self, geometry: Geometry) -> Array:
        """Return how far the wheel that rolls furthest in each step has rolled until each sample (K,), m."""
        way = np.abs(self._rolled(geometry, self._counts)).max(axis=1)
        return np.concatenate([[0.0], np.cumsum(way + FLOOR)])

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

    def errors(self, geometry: Geometry, clock: Array, mount: Array, slips: Array | None = None) -> Array:
        """Return the error at every reference pose (poses, 3) of odometry that accounts for slips (K - 1, rows), m,
        None: those that are expected (`expect`); aligned with the reference. Of a position the heading's is NaN."""
        known = self._poses.taken
        at, part = self._poses.steps_of(known, clock)
        path = compose(self.odometry(geometry, self._expected if slips is None else slips), mount)
        part, reference = np.clip(part, 0.0, 1.0), self._poses.poses[known]
        return aligned((1 - part) * path[at] + part * path[at + 1], reference, geometry.reach) - reference

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
        residuals (each 1 or -1 as by a coin: of all draws of mean 0 and variance 1 that scatter estimated traces least,
        Hutchinson 1990; the same in each call, different for each log), from which expected sums of squares are
        estimated. extra: columns of the other P - G parameters. rate: of the reference's clock (s/s), if it is
        known.
        """
        residual = self.residuals(geometry, state)
        weights, slipping = self._weights(state, noise), self._whitening(geometry, state, noise, residual)
        values = self._values(residual, state, clock, mount, weights, slipping)
        kinds = self._linearised(geometry, changed, change, state, clock, mount, weights, values, slipping, extra)
        random = np.random.default_rng(self._number)
        for name, rows in kinds.items():
            signs = 2 * random.integers(2, size=(*rows.values.shape, probes), dtype=np.int8) - 1
            kinds[name] = rows._replace(drawn=signs)
        if self.gyro_steps:
            kinds["gyro"] = kinds["gyro"]._replace(drawn=self._gyro.drawn(random, noise.gyro, probes))
        prior = self._poses.clock_prior(rate)
        of_gyro = self.gyro_numbers(state, noise) if self.gyro_steps else np.zeros(0)

        def summed(values: dict[str, Array], state: Array, clock: Array) -> float:
            more = [self._gyro.prior.off(self._gyro.numbers(state, weights["gyro"]))] if self.gyro_steps else []
            return float(sum(np.sum(part**2) for part in (*values.values(), prior.off(clock), *more)))

        def squares(geometry: Geometry, state: Array, clock: Array, mount: Array) -> float:
            values = self._values(self.residuals(geometry, state), state, clock, mount, weights, slipping)
            return summed(values, state, clock)

        count = len(change) + (extra.parameters if extra else 0) + len(mount)
        fields = partial(self._by_fields, slipping=slipping)
        own, prior_of_own = np.concatenate([clock, of_gyro]), prior.joined(self._gyro.prior)
        found = reduced(kinds, state, own, prior_of_own, count, probes, fields, squares, summed(values, state, clock))

        def log_evidence() -> float:
            of_weights = [
                float(np.sum(np.log(np.broadcast_to(weight, kinds[name].values.shape))))
                for name, weight in weights.items()
            ]
            volume = self._log_volume(geometry, state) + self._of_play(found.variances)
            return found.log_evidence() + sum(of_weights) + slipping.log_density() + volume

        def finish(moved_by: Array, part: float = 1.0) -> tuple[Array, Array, Leftover]:
            state, clock, left = found.finish(moved_by, part)
            return state, clock, self._gyro.with_described(left, noise.gyro)

        return found._replace(log_evidence=log_evidence, finish=finish)

    def score_by_volume(
        self,
        geometry: Geometry,
        changed: Sequence[Geometry],
        change: Array,
        state: Array,
        clock: Array,
        mount: Array,
        noise: Noise,
    ) -> tuple[Array, Array]:
        """Return the derivatives of log evidence at a state by parameters of the geometry (G,) and by the mount (3,),
        but for those of the least squares (`reduce`): of the volume of likely states, and of the density of slips.

        changed: G geometries, in each of which one parameter is larger by change (G,). Both terms are large, and
        cancel each other where wheels roll as they turn; where a steering encoder stands still they do not, as the
        reference shows then how its castor turns, more or less well with other dimensions.
        """
        weights = self._weights(state, noise)

        def information(kinds: Collection[Rows]) -> Array:
            return information_on_states(kinds, *state.shape)

        def of_slips(geometry: Geometry, slipping: Whitening) -> Array:
            by_state = self._slips_by_state(geometry, state, slipping)
            return information([Rows(np.arange(len(state) - 1), self._expected, *by_state)])

        def of_poses(mount: Array) -> Array:
            values = {name: weights[name] * off for name, off in self._poses.off(state, clock, mount).items()}
            none, of_gyro = np.zeros(0), len(self._gyro.prior.deviation)
            return information(self._poses.rows(state, clock, mount, weights, values, none, none, of_gyro).values())

        def log_volume(information: Callable[[], Array]) -> float:
            return -log_determinant(information, rounded="position" not in weights) / 2

        def of_geometry(geometry: Geometry) -> float:
            slipping = self._whitening(geometry, state, noise)
            volume = self._log_volume(geometry, state) + log_volume(lambda: of_slips(geometry, slipping) + others)
            return volume + slipping.log_density() - float(np.sum((slipping.weight * slips) ** 2)) / 2

        def of_mount(mount: Array) -> float:
            return log_volume(lambda: beside_poses + of_poses(mount))

        first = self._whitening(geometry, state, noise)
        residual = self.residuals(geometry, state)
        off = first.applied(slice(None), (residual - self._expected)[..., None])
        slips = first.of_contacts(slice(None), off)[..., 0] / first.weight
        values = self._values(residual, state, clock, mount, weights, first)
        kinds = self._linearised(geometry, geometry, np.zeros(0), state, clock, mount, weights, values, first, None)
        of_sensors = information([kinds[name] for name in kinds if name in ("first", "counts", "gyro")])
        others, beside_poses = of_sensors + of_poses(mount), of_sensors + of_slips(geometry, first)
        at_first, at_mount = of_geometry(geometry), of_mount(mount)
        by_geometry = np.array([of_geometry(larger) - at_first for larger in changed]) / change
        by_mount = [of_mount(moved) - at_mount for moved in mount + MOVED * np.eye(3)]
        return by_geometry, np.array(by_mount) / MOVED

    def _of_play(self, variances: Callable[[], Array]) -> float:
        """Return the logarithm by which readings that stand still within a play are likelier than normal variables as
        wide as the play, where all other equations show the shaft better than that.

        Of a shaft that nothing else shows, where it is has no prior distribution, and nothing tells how likely it is
        that it stays within the play. variances: see `Reduced`.
        """
        free = self._play > 0
        if not np.any(free):
            return 0.0
        play = self._play[free]
        others = 1 / np.maximum(1 / variances()[:, 3:][free] - 1 / self._variances[free], 1e-12)
        return float(np.sum(np.log((1 / 12 + play) / (1 / 12 + np.minimum(play, others))))) / 2

    def _by_fields(self, name: str, left: Array, steps: slice, slipping: Whitening) -> list[tuple[str, Array]]:
        """Return the residuals (k, rows, c) of a kind of `_values` by the fields of `Noise`: of slips, those of
        each contact, their squares in proportion to the variances of which a slip's variance is the sum."""
        if name != "slips":
            return [(name, left)]
        left, rolling = slipping.of_contacts(steps, left), len(self._rolling)
        by_turning = slipping.by_turning[steps, :, None]
        rolled = np.sqrt(1 - by_turning) * left
        return [
            ("along", rolled[:, :rolling]),
            ("across", rolled[:, rolling:]),
            ("turning", np.sqrt(by_turning) * left),
        ]

    def _weights(self, state: Array, noise: Noise) -> dict[str, Array]:
        """Return one over the standard deviation of every equation at a state but for slips, by the kinds of
        `_values`."""
        of_poses = self._poses.weights(state, noise.position, noise.heading, self._jitter)
        of_gyro = {"gyro": self._gyro.weights(noise.gyro)} if self.gyro_steps else {}
        return {"first": self._readings[:1], "counts": self._readings[1:]} | of_poses | of_gyro

    def _whitening(self, geometry: Geometry, state: Array, noise: Noise, residual: Array | None = None) -> Whitening:
        """Return how slips at a state are made independent, each of standard deviation 1. residual: of the state, if it
        is known."""
        farthest = np.abs(self._rolled(geometry, state[:, 3:])).max(axis=1)
        sizes = np.repeat([noise.along, noise.across], [len(self._rolling), len(self._used) - len(self._rolling)])
        by_rolling = sizes**2 * farthest[:, None] + FLOOR**2
        by_turning = noise.turning**2 * np.abs(self.turned(geometry, state))
        slip = by_rolling + by_turning + np.square(self._doubt)
        by_turning /= by_rolling + by_turning
        free = np.where(self._released, farthest[:, None], 0.0)
        weight = 1 / np.sqrt(slip + free**2 + self._unsure(geometry, state, residual) ** 2)
        if self._stiffness is None:
            return Whitening(weight, by_turning)
        # contacts that slip for another reason hardly hold
        stiffness = slip * weight**2 * self._stiffness / self._stiffness.max(axis=1, keepdims=True)
        return Whitening.balanced(
            weight,
            by_turning,
            stiffness,
            lambda steps: self._moved(geometry, *self._matrices_in(geometry, state, steps)),
        )

    def _values(
        self,
        in_constraints: Array,
        state: Array,
        clock: Array,
        mount: Array,
        weights: dict[str, Array],
        slipping: Whitening,
    ) -> dict[str, Array]:
        """Return the residuals of a state in all equations, in standard deviations, by kind: "first" and the other
        "counts", "slips", "pinned", or the field of `Noise` that weights them. in_constraints: from `residuals`."""
        off = self._new(state[:, 3:] - self._counts)
        residuals = {"first": off[:1], "counts": off[1:]} | self._poses.off(state, clock, mount)
        if self.gyro_steps:
            residuals["gyro"] = self._gyro.off(state, self._gyro.numbers(state, weights["gyro"]))
        slips = slipping.applied(slice(None), (in_constraints - self._expected)[..., None])[..., 0]
        return {name: weights[name] * off for name, off in residuals.items()} | {"slips": slips}

    def _slips_by_state(
        self, geometry: Geometry, state: Array, slipping: Whitening
    ) -> tuple[Callable[[slice], Array], Callable[[slice], Array]]:
        """Return functions that map some steps to derivatives of slips, as independent numbers (k, p, m), by the state
        at their start and end."""
        by_start, by_end = self._derivatives(geometry, state)
        touched = np.any(by_start, axis=0) | np.any(by_end, axis=0)
        numbers_of = np.argsort(~touched, axis=1, kind="stable")[:, : touched.sum(axis=1).max(initial=1)]
        of_row = np.arange(len(numbers_of))[:, None]  # a row depends on few numbers of the state

        def by_state(chosen: slice, derivatives: Array) -> Array:
            by = np.zeros((*derivatives[chosen].shape[:2], state.shape[1]))
            by[:, of_row, numbers_of] = derivatives[chosen]
            return slipping.applied(chosen, by)

        few = (derivatives[:, of_row, numbers_of] for derivatives in (by_start, by_end))
        start, end = (_kept(partial(by_state, derivatives=derivatives), len(derivatives)) for derivatives in few)
        return start, end

    def _linearised(
        self,
        geometry: Geometry,
        changed: Geometry,
        change: Array,
        state: Array,
        clock: Array,
        mount: Array,
        weights: dict[str, Array],
        values: dict[str, Array],
        slipping: Whitening,
        extra: ExtraColumns | None,
    ) -> dict[str, Rows]:
        """Return all equations linearised about a state, by the kinds of `_values`, which are given."""
        samples, first = np.arange(len(state)), len(change)
        extra_count, slips = (extra.parameters, extra.slips) if extra else (0, ())
        of_gyro = len(self._gyro.prior.deviation)
        count = first + extra_count + len(mount) + len(clock) + of_gyro
        weight, kept = self._readings[..., None], self._kept[..., None]

        def read_first(chosen: slice, excess: ByBlocks) -> Array:
            by = np.zeros((*self._readings[chosen].shape, count))
            np.multiply(weight[chosen], excess[chosen], out=by[..., first : first + excess.shape[-1]])
            return by

        def read(chosen: slice, excess: ByBlocks) -> Array:
            of_samples, at = excess[chosen.start : chosen.stop + 1], slice(chosen.start + 1, chosen.stop + 1)
            by = np.zeros((*self._readings[at].shape, count))
            new = of_samples[1:] - kept[at] * of_samples[:-1]
            np.multiply(weight[at], new, out=by[..., first : first + excess.shape[-1]])
            return by

        of_last, of_this = (-weight * kept)[1:].__getitem__, weight[1:].__getitem__
        of_first, of_counts = (
            partial(by, excess=extra.readings) if extra and extra.readings.shape[-1] else None
            for by in (read_first, read)
        )
        kinds = {
            "first": Rows(samples[:1], values["first"], weight.__getitem__, numbers=of_first, own=3),
            "counts": Rows(samples[:-1], values["counts"], of_last, of_this, of_counts, own=3),
        }

        by_geometry = partial(self._by_change, geometry, changed, change, state)
        if count <= FEW:  # they are asked for three times
            by_geometry = np.concatenate([by_geometry(steps) for steps in blocks(len(state) - 1, LARGE)]).__getitem__

        def by_slips(chosen: slice) -> Array:
            columns = slipping.applied(
                chosen, np.concatenate([by_geometry(chosen), *(-part[chosen] for part in slips)], axis=-1)
            )
            return np.concatenate([columns, np.zeros((*columns.shape[:2], count - columns.shape[-1]))], axis=-1)

        numbers = by_slips if count > FEW else _kept(by_slips, len(state) - 1)
        kinds["slips"] = Rows(samples[:-1], values["slips"], *self._slips_by_state(geometry, state, slipping), numbers)
        rates, sways, scales = (
            np.zeros(first + extra_count) if of_extra is None else np.concatenate([np.zeros(first), of_extra])
            for of_extra in ((None,) * 3 if extra is None else (extra.rates, extra.sways, extra.gyro_scales))
        )
        kinds |= self._poses.rows(state, clock, mount, weights, values, rates, sways, of_gyro)
        if self.gyro_steps:
            others = len(mount) + len(clock)
            kinds["gyro"] = self._gyro.rows(state, weights["gyro"], values["gyro"], scales, others)
        return kinds


def _kept(by: Callable[[slice], Array], steps: int) -> Callable[[slice], Array]:
    """Return derivatives of so many steps, which are asked for several times: of as many as are in memory at a time,
    computed once."""
    return by if steps > LARGE else by(slice(0, steps)).__getitem__


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


def _of_runs(counts: Array) -> tuple[Array, Array, Array]:
    """Return the correlation of the error of every count (K,) with that of the count before, the variance of the error
    over that of an even spread of one count, and the length of the run of equal counts.

    While a run of equal counts lasts, the shaft moves by less than one count. A run is one reading: of a shaft that
    stands it tells as much as one count.
    """
    begins = np.concatenate([[True], np.diff(counts) != 0])
    run = np.cumsum(begins) - 1
    length = np.bincount(run)[run]
    alike = np.exp(-WITHIN / length)
    return np.where(begins, 0.0, alike), 1 + (length - 1) * (1 - alike) / (1 + alike), length.astype(np.float64)
