"""The equations of one log of a train, between its motion and the readings of sensors: one sparse linear problem.

Unknown of every sample are the axles' poses, how far wheels have rolled, and the frames' tension; of the whole
log its nuisances: offsets of the gauges, where the reference tracks each axle, and its clock.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import binary_dilation, uniform_filter1d

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse
from castor_envs.geometry.steps import path_of
from castor_envs.logs.log import Log
from castor_envs.sensors.posture import gauges_of
from castor_envs.vehicles.train import TrainDescription
from estimators.likelihood.trains import bending
from estimators.likelihood.trains.motion import Motion

LEAST_TRAVEL = 1e-4
"""m, added to the travel of a step: slip of standing wheels."""

ROUGH = (4e-5, 1e-4, 2e-4)
"""m, m, rad: error of a sensor's reading in addition to the noise of its gauges, as the bending model is
approximate."""

MOUNT, CLOCK = (5e-3, 5e-3, 0.02), 0.05
"""m, m, rad and s: standard deviations of a reference's tracked points and clock."""

SMOOTH = 9
"""Readings that are averaged for the start."""

CREEP = 1.0
"""Standard deviation of the relative excess of creep over the prediction: forces are known to a factor of two."""

SLIDING, NEARLY, AROUND = 0.002, 0.7, 5
"""Weight of an axle's step in which it may slide, by a slip of 0.1 m after 1 m or more; the part of its friction from
which on it may; and the steps before and after that are included."""

BENT = 1e-4
"""rad: step for numerical derivatives."""

RAISED = 0.06
"""Standard deviation of the part of its bow by which a frame's gauges read too much under tension: they are not points,
and represent the curvature between them."""

PULL = 1.0
"""Prior standard deviation of a frame's mean tension, in `bending.newtons`, as where wheels are held at a speed: it
drives the axles beside it to a mean slip of 0.1 %."""

TENSION_TIME = 5.0
"""s: correlation time of a frame's tension, as the causes of wheels' disagreement change slowly."""

START = 1.0
"""m, rad: standard deviations of the first axle's pose at the start."""


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives of rows: by the unknowns of every sample (rows, K B), and by nuisances (rows, n)."""

    by_sample: sparse.csr_array
    by_number: Array


@dataclass(frozen=True, eq=False)
class Bends:
    """ends (K, F, 2): curvature at the frames' ends, 1/m. by_gauge: of each frame (K, 3, gauges), derivative of its
    sensor's reading by an error of each gauge, m and rad per 1/m."""

    ends: Array
    by_gauge: list[Array]


class TrainLog:
    """One log of a train, ready to be compared with trains built in different ways.

    train: its effects are ignored. loose (K - 1, N): steps in which axles may slide, which have little weight; none by
    default (see `with_loose`).
    """

    def __init__(self, train: TrainDescription, log: Log) -> None:
        self.described = train.as_described()
        self.n, self.f, self.k = train.n_axles, len(train.frames), len(log)
        self.t = log.t - log.t[0]
        self.counts = log.wheel
        frames, nan = self.f, np.nan
        rps = np.full((self.k, frames, 3), nan) if log.rps is None else log.rps.reshape(self.k, frames, 3)
        age = np.zeros((self.k, frames)) if log.rps_age is None else log.rps_age
        self.rps, self.read = _at_their_times(self.t, rps, age)
        given = np.full((self.k, 3 * self.n), nan) if log.reference is None else log.reference
        self.at = np.flatnonzero(np.isfinite(given).all(axis=1))
        self.reference = given[self.at].reshape(-1, self.n, 3)
        self.block = 5 * self.n + frames
        self.gauges = np.cumsum([0, *(len(frame.gauge_positions) for frame in train.frames)])
        self.numbers = int(self.gauges[-1]) + 4 * self.n + 1 + 2 * frames
        self.creeping = int(self.gauges[-1]) + 3 * self.n + 1
        self.loose = np.zeros((self.k - 1, self.n), dtype=bool)
        self.lasting = np.exp(-np.diff(self.t) / TENSION_TIME)[:, None]
        self.turned, way = self._rolled(train)
        self.rolled = np.abs(way)
        self.travel = np.sqrt(self.rolled.mean(axis=2) + LEAST_TRAVEL)
        self.signed_travel = way.mean(axis=2)

    def without_reference(self) -> "TrainLog":
        """Return the log with counts and relative poses alone."""
        log = copy(self)
        log.at, log.reference = self.at[:0], self.reference[:0]
        return log

    def with_loose(self, loose: NDArray[np.bool_]) -> "TrainLog":
        """Return the log with other steps (K - 1, N) in which axles may slide."""
        log = copy(self)
        log.loose = loose
        return log

    def prior(self, train: TrainDescription) -> Array:
        """Return the prior standard deviations of the nuisances (n,)."""
        offsets = [
            np.full(len(frame.gauge_positions), max(frame.gauge_offset, 1e-6)) for frame in train.as_described().frames
        ]
        creep, raised, pull = np.full(self.n, CREEP), np.full(self.f, RAISED), np.full(self.f, PULL)
        return np.concatenate([*offsets, np.tile(MOUNT, self.n), [CLOCK], creep, raised, pull])

    def nuisances(self, motion: Motion) -> Array:
        """Return the nuisances (n,) of a motion."""
        clock = [motion.clock]
        return np.concatenate([motion.offsets, motion.mount.ravel(), clock, motion.creep, motion.raised, motion.pull])

    def start(self, built: TrainDescription) -> Motion:
        """Return a motion to begin with: the first axle by wheel counts, the other axles by sensors."""
        roll, way = self._rolled(built)
        turn, along = (way[..., 1] - way[..., 0]) / (2 * bending.half_track(built)), way.mean(axis=2)
        pose = np.zeros((self.k, self.n, 3))
        for i in range(self.n):
            path = path_of(np.column_stack([along[:, i], np.zeros(self.k - 1), turn[:, i]]))
            if i > 0 and self.read[:, i - 1].any():
                pose[:, i] = compose(pose[:, i - 1], inverse(self.smoothed(built, i - 1)))
            elif len(self.at):
                pose[:, i] = compose(compose(self.reference[0, i], inverse(path[self.at[0]])), path)
            elif i > 0:
                pose[:, i] = compose(compose(pose[0, i - 1], (-built.frames[i - 1].length, 0.0, 0.0)), path)
            else:
                pose[:, i] = path
        tension, offsets, mount = np.zeros((self.k, self.f)), np.zeros(int(self.gauges[-1])), np.zeros((self.n, 3))
        return Motion(pose, roll, tension, offsets, mount, 0.0, np.zeros(self.n), np.zeros(self.f), np.zeros(self.f))

    def _rolled(self, train: TrainDescription) -> tuple[Array, Array]:
        """Return how far wheels of a train have turned by the counts (K, 2N), rad, and roll in each step (K - 1, N, 2),
        m."""
        per_turn, radius, _ = _wheels(train)
        roll = (self.counts - self.counts[0]) * 2 * np.pi / per_turn
        return roll, (np.diff(roll, axis=0) * radius).reshape(-1, self.n, 2)

    def smoothed(self, built: TrainDescription, f: int) -> Array:
        """Return the relative poses (K, 3) of a frame by its sensor, smoothed, with gaps filled."""
        frame, valid = built.frames[f], self.read[:, f]
        width = min(SMOOTH, int(valid.sum()))
        seen = np.zeros((self.k, 3))
        for j in (1, 2):
            smooth = uniform_filter1d(self.rps[valid, f, j], width, mode="nearest")
            seen[:, j] = np.interp(self.t, self.t[valid], smooth)
        seen[:, 0] = bending.posture_of(frame, bending.ends(frame, seen))[:, 0]
        return seen

    def residuals(self, built: TrainDescription, motion: Motion, ends: Array | None = None) -> dict[str, Array]:
        """Return the residuals of every kind of equations for a train as it is built; rows first, not yet weighted."""
        per_turn, radius, lateral = _wheels(built)
        relative = motion.relative
        ends = self.ends(built, relative) if ends is None else ends
        left = {"counts": motion.roll * per_turn / (2 * np.pi) - (self.counts - self.counts[0])}

        along, across, turn, _ = self._steps(motion)
        slip = self.creep(built, motion, ends) + self.bent(motion, ends) * motion.creep[:, None]
        rolled = np.diff(motion.roll, axis=0) * radius
        ahead = np.repeat(along, 2, axis=1) - lateral * np.repeat(turn, 2, axis=1)
        left["rolling"] = ahead - rolled - slip[..., :2].reshape(-1, 2 * self.n)
        left["side"] = across - slip[..., 2]
        left["tension"] = motion.tension - motion.pull
        left["tension"][1:] -= self.lasting * left["tension"][:-1].copy()
        for f, frame in enumerate(built.frames):
            offsets = motion.offsets[self.gauges[f] : self.gauges[f + 1]]
            bowed = self._bowed(built, ends[:, f], motion.tension[:, f], f)
            read = bending.reading(frame, ends[:, f], offsets, self.t, bowed, motion.raised[f])
            left[f"gauges{f}"] = (self.rps[:, f] - read) * self.read[:, f, None]
        short = [self._short(built, ends[:, f], motion.tension[:, f], f) for f in range(self.f)]
        left["shape"] = relative[..., 0] - np.stack(short, axis=1)
        if len(self.at):
            tracked = compose(motion.pose[self.at] + motion.clock * self._rate(motion), motion.mount)
            left["position"], left["heading"] = (tracked - self.reference)[..., :2], (tracked - self.reference)[..., 2]
        left["start"] = np.zeros(3)
        return left

    def ends(self, built: TrainDescription, relative: Array) -> Array:
        """Return the curvature at the ends of every frame (K, F, 2), 1/m, in relative poses (K, F, 3)."""
        return np.stack([bending.ends(frame, relative[:, f]) for f, frame in enumerate(built.frames)], axis=1)

    def bends(self, built: TrainDescription, motion: Motion) -> Bends:
        """Return the bending of frames in a motion, and the derivatives of their sensors' readings."""
        ends = self.ends(built, motion.relative)
        return Bends(ends, [self._by_gauge(built, motion, ends, f) for f in range(self.f)])

    def weights(self, built: TrainDescription, bends: Bends) -> dict[str, Array]:
        """Return the weights of the residuals of every kind, apart from 1 / size; of gauges (K, 3, 3), for the noise
        that those of the train have."""
        side = np.where(self.loose, SLIDING, 1.0) / self.travel
        weights: dict[str, Array] = {
            "counts": np.full((self.k, 2 * self.n), 12**0.5),
            "rolling": np.repeat(side, 2, axis=1),
            "side": side,
            "tension": np.repeat(np.append(1.0, (1 - self.lasting**2) ** -0.5)[:, None], self.f, axis=1),
            "shape": np.ones((self.k, self.f)),
            "position": np.ones((len(self.at), self.n, 2)),
            "heading": np.ones((len(self.at), self.n)),
            "start": np.full(3, 1 / START),
        }
        for f, frame in enumerate(built.frames):
            by_gauge, live = bends.by_gauge[f], bending.live(frame)
            cov = by_gauge @ (by_gauge * (live * frame.gauge_noise**2)).transpose(0, 2, 1) + np.diag(np.square(ROUGH))
            cov[:, 0, 0] += bending.shortened_by_noise(frame)[1] ** 2
            whitening = np.linalg.inv(np.linalg.cholesky(cov)).astype(float)
            weights[f"gauges{f}"] = whitening * self.read[:, f, None, None]
        return weights

    def jacobians(self, built: TrainDescription, motion: Motion, bends: Bends) -> dict[str, Jacobian]:
        """Return the derivatives of every kind of `residuals`, rows in the same order."""
        n, k, block = self.n, self.k, self.block
        samples, axles = np.arange(k), np.arange(n)
        per_turn, radius, lateral = _wheels(built)
        ends = bends.ends
        found: dict[str, Jacobian] = {}

        columns = samples[:, None] * block + 3 * n + np.arange(2 * n)
        found["counts"] = self._sparse(columns[..., None], np.tile((per_turn / (2 * np.pi))[:, None], (k, 1, 1)))

        along, across, turn, (c, s) = self._steps(motion)
        longer = 1 / np.sinc(turn / (2 * np.pi))
        bend, grow = longer * across / 2, along * turn / 12
        by_tension, steps = self._by_tension(built, motion, ends), samples[:-1, None] * block
        poses = (steps + 3 * axles)[..., None] + np.array([0, 1, 2, block, block + 1, block + 2])
        tensions = np.broadcast_to((steps + 5 * n + np.arange(self.f))[:, None], (k - 1, n, self.f))
        places, values = [], []
        for side in range(2):
            arm, tread = lateral[side::2], np.broadcast_to(radius[side::2], along.shape)
            before = (-c * longer, -s * longer, bend - grow + arm)
            after = (c * longer, s * longer, bend + grow - arm)
            moved = np.stack([*before, *after, tread, -tread], axis=-1)
            wheel = (steps + 3 * n + 2 * axles + side)[..., None] + np.array([0, block])
            places.append(np.concatenate([poses, wheel, tensions], axis=-1))
            values.append(np.concatenate([moved, -by_tension[:, :, side]], axis=-1))
        slip = self.bent(motion, ends)
        turned, aside = np.zeros((k - 1, n, 2, self.numbers)), np.zeros((k - 1, n, self.numbers))
        turned[:, axles, :, self.creeping + axles] = -slip[..., :2].transpose(1, 0, 2)
        aside[:, axles, self.creeping + axles] = -slip[..., 2]
        found["rolling"] = self._sparse(
            np.stack(places, axis=2), np.stack(values, axis=2), turned.reshape(-1, self.numbers)
        )
        flat = along / longer
        moved = np.stack([s, -c, -flat / 2, -s, c, -flat / 2], axis=-1)
        found["side"] = self._sparse(
            np.concatenate([poses, tensions], axis=-1),
            np.concatenate([moved, -by_tension[:, :, 2]], axis=-1),
            aside.reshape(-1, self.numbers),
        )
        of_tension = samples[:, None] * block + 5 * n + np.arange(self.f)
        before = np.concatenate([of_tension[:1], of_tension[:-1]])
        kept = np.append(0.0, -self.lasting)[:, None] * np.ones(self.f)
        pulled = np.zeros((k, self.f, self.numbers))
        pulled[..., -self.f :] = -(1 + kept)[..., None] * np.eye(self.f)
        found["tension"] = self._sparse(
            np.stack([of_tension, before], axis=-1),
            np.stack([np.ones_like(kept), kept], axis=-1),
            pulled.reshape(-1, self.numbers),
        )

        by_pose, places = self._relative_derivatives(motion)
        bent = np.stack([bending.ends_by_posture(frame, ends[:, f]) for f, frame in enumerate(built.frames)], axis=1)
        for kind, by_bend in self._by_bend(built, motion, ends, bent, (by_pose, places)).items():
            found[kind] = replace(found[kind], by_sample=found[kind].by_sample + by_bend)
        short: list[Array] = []
        for f, frame in enumerate(built.frames):
            read, shape = self._bent_and_pulled(built, motion, ends, f)
            chained, shortened = (
                np.concatenate([of[..., :2] @ bent[:, f] @ by_pose[:, f, 1:], of[..., 2:]], axis=-1)
                for of in (read, shape)
            )
            shortened[..., :6] -= by_pose[:, f, :1]
            short.append(-shortened[:, 0])
            numbers = np.zeros((k, 3, self.numbers))
            numbers[..., self.gauges[f] : self.gauges[f + 1]] = -bends.by_gauge[f] * self.read[:, f, None, None]
            raised = self._bowed(built, ends[:, f], motion.tension[:, f], f) * self.read[:, f]
            numbers[..., self.creeping + n + f] = -(bends.by_gauge[f] @ gauges_of((frame,)).gain[0]) * raised[:, None]
            placed = np.concatenate([places[:, f], of_tension[:, f, None]], axis=-1)
            found[f"gauges{f}"] = self._sparse(
                np.broadcast_to(placed[:, None], (k, 3, 7)),
                -chained * self.read[:, f, None, None],
                numbers.reshape(3 * k, -1),
            )
        found["shape"] = self._sparse(np.concatenate([places, of_tension[..., None]], axis=-1), np.stack(short, axis=1))
        if len(self.at):
            found |= self._reference_derivatives(motion)
        found["start"] = self._sparse(np.arange(3)[:, None], np.ones((3, 1)))
        return found

    def offset_of(
        self, frame: int, gauge: int, built: TrainDescription, motion: Motion, ends: Array, residuals: dict[str, Array]
    ) -> tuple[int, tuple[str, Array]]:
        """Return the number of the nuisance that is a gauge's offset, and its column in a train in which that gauge
        works.

        frame, gauge: from 1. residuals: of this train. The offset of a dead gauge is unknown, as is the reading that it
        would have.
        """
        at, kind, small = int(self.gauges[frame - 1]) + gauge - 1, f"gauges{frame - 1}", 1e-4
        moved = replace(motion, offsets=motion.offsets + small * np.eye(len(motion.offsets))[at])
        return at, (kind, (self.residuals(built, moved, ends)[kind] - residuals[kind]) / small)

    def noise(self, built: TrainDescription, motion: Motion, f: int) -> tuple[float, int]:
        """Return the noise of a frame's gauges, relative to the described noise, and the number of readings used.

        It is estimated from changes of the sensor's heading from sample to sample beyond the motion of the frame.
        """
        ends = self.ends(built, motion.relative)
        left = self.residuals(built, motion, ends)[f"gauges{f}"][:, 2]
        pairs = self.read[1:, f] & self.read[:-1, f]
        heading = self._by_gauge(built, motion, ends, f)[:, 2]
        expected = built.frames[f].gauge_noise ** 2 * np.sum(bending.live(built.frames[f]) * heading**2, axis=1)
        expected = (expected[1:] + expected[:-1])[pairs]
        if not pairs.any() or not np.all(expected > 0):
            return 1.0, 0
        return float(np.sqrt(np.mean(np.diff(left)[pairs] ** 2 / expected))), int(pairs.sum())

    def _reference_derivatives(self, motion: Motion) -> dict[str, Jacobian]:
        """Return the derivatives of the reference's residuals. That rates follow the samples before and after, by the
        clock's offset over twice the period, is left out: equations depend on two samples that follow each other."""
        m, n = len(self.at), self.n
        first, rate = int(self.gauges[-1]), self._rate(motion)
        heading = (motion.pose[self.at] + motion.clock * rate)[..., 2]
        c, s, x, y = np.cos(heading), np.sin(heading), motion.mount[:, 0], motion.mount[:, 1]
        pose = self.at[:, None] * self.block + 3 * np.arange(n)
        ones = np.ones((m, n))
        swing = np.stack([-s * x - c * y, c * x - s * y], axis=-1)
        places = np.stack([np.stack([pose, pose + 2], -1), np.stack([pose + 1, pose + 2], -1)], axis=2)
        values = np.stack([np.stack([ones, swing[..., 0]], -1), np.stack([ones, swing[..., 1]], -1)], axis=2)
        numbers, turned = np.zeros((m, n, 2, self.numbers)), np.zeros((m, n, self.numbers))
        for i in range(n):
            at = first + 3 * i
            numbers[:, i, 0, at : at + 2] = np.stack([c[:, i], -s[:, i]], axis=-1)
            numbers[:, i, 1, at : at + 2] = np.stack([s[:, i], c[:, i]], axis=-1)
            turned[:, i, at + 2] = 1.0
        clock = first + 3 * n
        numbers[..., clock], turned[..., clock] = rate[..., :2] + swing * rate[..., 2:], rate[..., 2]
        return {
            "position": self._sparse(places, values, numbers.reshape(2 * m * n, -1)),
            "heading": self._sparse((pose + 2)[..., None], ones[..., None], turned.reshape(m * n, -1)),
        }

    def _relative_derivatives(self, motion: Motion) -> tuple[Array, NDArray[np.integer]]:
        """Return the derivatives (K, F, 3, 6) of relative poses by the poses of front and rear axle, and their
        places."""
        relative, heading = motion.relative, motion.pose[:, 1:, 2]
        c, s = np.cos(heading), np.sin(heading)
        zero, ones = np.zeros_like(c), np.ones_like(c)
        rows = [
            np.stack([c, s, zero, -c, -s, relative[..., 1]], axis=-1),
            np.stack([-s, c, zero, s, -c, -relative[..., 0]], axis=-1),
            np.stack([zero, zero, ones, zero, zero, -ones], axis=-1),
        ]
        frame = np.arange(self.k)[:, None] * self.block + 3 * np.arange(self.f)
        return np.stack(rows, axis=2), frame[..., None] + np.arange(6)

    def _bowed(self, built: TrainDescription, ends: Array, tension: Array, f: int) -> Array:
        """Return the curvature (K,) by which a frame bows under its tension (K,), 1/m; ends (K, 2): of this frame."""
        return bending.bow(built.frames[f], ends, bending.newtons(built)[f] * tension)[:, 0]

    def _short(self, built: TrainDescription, ends: Array, tension: Array, f: int) -> Array:
        """Return how far the front axle of a bent frame is ahead of the rear one (K,), m, as of `_bowed`."""
        return bending.posture_of(built.frames[f], ends, self._bowed(built, ends, tension, f))[:, 0]

    def _bent_and_pulled(self, built: TrainDescription, motion: Motion, ends: Array, f: int) -> tuple[Array, Array]:
        """Return the derivatives (K, 3, 3) of a frame's reading, and (K, 1, 3) of `_short`, by its two ends' curvature
        and by its tension."""
        offsets, raised = motion.offsets[self.gauges[f] : self.gauges[f + 1]], motion.raised[f]
        read, short = [], []
        for small in 1e-4 * np.eye(3):
            above, below = (
                (ends[:, f] + sign * small[:2], motion.tension[:, f] + sign * small[2]) for sign in (1.0, -1.0)
            )
            more, less = (
                bending.reading(built.frames[f], bent, offsets, self.t, self._bowed(built, bent, pulled, f), raised)
                for bent, pulled in (above, below)
            )
            read.append((more - less) / 2e-4)
            short.append((self._short(built, *above, f) - self._short(built, *below, f)) / 2e-4)
        return np.stack(read, axis=-1), np.stack(short, axis=-1)[:, None]

    def _by_gauge(self, built: TrainDescription, motion: Motion, ends: Array, f: int) -> Array:
        """Return the derivatives (K, 3, gauges) of a frame's reading by its gauges' errors."""
        frame, first, last = built.frames[f], self.gauges[f], self.gauges[f + 1]
        columns, bowed = [], self._bowed(built, ends[:, f], motion.tension[:, f], f)
        for gauge in range(last - first):
            small = 1e-4 * np.eye(last - first)[gauge]
            above, below = (
                bending.reading(frame, ends[:, f], motion.offsets[first:last] + d, self.t, bowed, motion.raised[f])
                for d in (small, -small)
            )
            columns.append((above - below) / 2e-4)
        return np.stack(columns, axis=-1)

    def creep(self, built: TrainDescription, motion: Motion, ends: Array, tension: Array | None = None) -> Array:
        """Return the predicted slips of left wheels, right wheels and axles in each step (K - 1, N, 3), m.

        tension (K, F): the frames' tension, in units of `bending.newtons`; None: the motion's.
        """
        slip = bending.creep(built, self._loads(built, motion, ends, motion.tension if tension is None else tension))
        return slip * self._travelled

    def _loads(
        self, built: TrainDescription, motion: Motion, ends: Array, tension: Array, change: Array | float = 0.0
    ) -> Array:
        """Return the loads of frames on the axles in each step (K - 1, N, 3), N and N m. change: added to relative
        poses (F, 3)."""
        relative, middle = motion.relative + change, (ends[1:] + ends[:-1]) / 2
        return bending.loads(built, (relative[1:] + relative[:-1]) / 2, middle, bending.newtons(built) * tension[:-1])

    def sliding(self, built: TrainDescription, motion: Motion) -> NDArray[np.bool_]:
        """Return the steps (K - 1, N) in which the force on a wheel is near the friction limit of its contact."""
        load = self._loads(built, motion, self.ends(built, motion.relative), motion.tension)
        turning = np.abs(load[..., 2]) / bending.half_track(built)
        used = np.hypot(np.abs(load[..., 0]) + turning, load[..., 1]) / bending.sliding_force(built)
        near = binary_dilation(used > NEARLY, iterations=AROUND, structure=np.array([[0, 1, 0]] * 3, dtype=bool))
        return np.asarray(near, dtype=bool)

    def _by_tension(self, built: TrainDescription, motion: Motion, ends: Array) -> Array:
        """Return the derivatives (K - 1, N, 3, F) of slips by the frames' tension."""
        no_tension, *unit_tensions = (
            np.broadcast_to(tension, (self.k, self.f)) for tension in (np.zeros(self.f), *np.eye(self.f))
        )
        without = self.creep(built, motion, ends, no_tension)
        return np.stack([self.creep(built, motion, ends, tension) - without for tension in unit_tensions], axis=-1)

    def _by_bend(
        self,
        built: TrainDescription,
        motion: Motion,
        ends: Array,
        by_y_phi: Array,
        relative: tuple[Array, NDArray[np.integer]],
    ) -> dict[str, sparse.csr_array]:
        """Return the derivatives of rolling and side-slip residuals by poses through the slip that bent frames drive.

        by_y_phi (K, F, 2, 2): derivatives of `ends`. relative: see `_relative_derivatives`.
        """
        k, n, no_tension, (by_pose, places) = self.k, self.n, np.zeros_like(motion.tension), relative
        by_relative = np.zeros((k - 1, n, 3, self.f, 2))
        steps = (np.array([0.0, BENT * self.described.frames[0].length, 0.0]), np.array([0.0, 0.0, BENT]))
        for first in range(min(2, self.f)):  # frames that share no axle, all at once
            chosen = (np.arange(self.f) % 2 == first)[:, None]
            for j, step in enumerate(steps):
                slips = []
                for change in (step, -step):
                    moved = ends + chosen * (by_y_phi @ change[1:])
                    load, described_load = (
                        self._loads(train, motion, moved, tension, chosen * change)
                        for train, tension in ((built, motion.tension), (self.described, no_tension))
                    )
                    creep = (
                        bending.creep(built, load)
                        + bending.creep(self.described, described_load) * motion.creep[:, None]
                    )
                    slips.append(creep * self._travelled)
                for f in np.flatnonzero(chosen[:, 0]):
                    by_relative[:, f : f + 2, :, f, j] = (slips[0] - slips[1])[:, f : f + 2] / (2 * step.sum())
        found = {kind: sparse.csr_array((rows, k * self.block)) for kind, rows in self._slipping.items()}
        for f in range(self.f):
            values = [by_relative[:, f : f + 2, :, f] @ (by_pose[at, f, 1:] / 2)[:, None] for at in self._both]
            by_samples = np.concatenate(values, axis=-1)
            columns = np.concatenate([places[at, f] for at in self._both], axis=-1)[:, None, None]
            for kind, part in (("rolling", by_samples[:, :, :2]), ("side", by_samples[:, :, 2:])):
                width = part.shape[2]
                rows = (np.arange(k - 1)[:, None, None] * n + np.array([f, f + 1])[:, None]) * width + np.arange(width)
                matrix = self._placed(rows[..., None], columns, -part, self._slipping[kind])
                found[kind] = sparse.csr_array(found[kind] + matrix)
        return found

    @property
    def _both(self) -> tuple[slice, slice]:
        """The samples at which steps begin, and end."""
        return slice(None, -1), slice(1, None)

    @property
    def _slipping(self) -> dict[str, int]:
        """The number of rows of the kinds with slip."""
        return {"rolling": 2 * self.n * (self.k - 1), "side": self.n * (self.k - 1)}

    @property
    def _travelled(self) -> Array:
        """The distances that left wheels, right wheels and axles roll in each step, forward or back, (K - 1, N, 3),
        m."""
        return np.concatenate([self.rolled, self.rolled.mean(axis=2, keepdims=True)], axis=2)

    def _placed(
        self, rows: NDArray[np.integer], columns: NDArray[np.integer], values: Array, total: int
    ) -> sparse.csr_array:
        """Return `total` rows of derivatives by samples, with values (...) at these rows and columns."""
        indices = tuple(np.broadcast_to(index, values.shape).ravel() for index in (rows, columns))
        return sparse.csr_array((values.ravel(), indices), shape=(total, self.k * self.block))

    def bent(self, motion: Motion, ends: Array) -> Array:
        """Return `creep` of the train as described, for frames without tension."""
        return self.creep(self.described, motion, ends, np.zeros_like(motion.tension))

    def _steps(self, motion: Motion) -> tuple[Array, Array, Array, tuple[Array, Array]]:
        """Return every axle's motion along its arc, across, and in heading in each step, and its middle direction."""
        step = np.diff(motion.pose, axis=0)
        middle, turn = (motion.pose[1:, :, 2] + motion.pose[:-1, :, 2]) / 2, step[..., 2]
        c, s = np.cos(middle), np.sin(middle)
        along = (c * step[..., 0] + s * step[..., 1]) / np.sinc(turn / (2 * np.pi))
        return along, c * step[..., 1] - s * step[..., 0], turn, (c, s)

    def _rate(self, motion: Motion) -> Array:
        """Return the rates of the axles' poses at the samples with a reference (M, N, 3), per second."""
        return np.gradient(motion.pose, self.t, axis=0)[self.at]

    def _sparse(self, places: NDArray[np.integer], values: Array, numbers: Array | None = None) -> Jacobian:
        """Return derivatives by samples whose rows (...,) have a few values (..., width) at these places."""
        width = values.shape[-1]
        columns, values = np.broadcast_to(places, values.shape).ravel(), values.reshape(-1, width)
        rows = np.repeat(np.arange(len(values)), width)
        shape = (len(values), self.k * self.block)
        matrix = sparse.csr_array((values.ravel(), (rows, columns)), shape=shape)
        return Jacobian(matrix, np.zeros((len(values), self.numbers)) if numbers is None else numbers)


def _at_their_times(t: Array, rps: Array, age: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return readings (K, F, 3) at the samples that are the nearest to when they were taken, and where there is one (K,
    F): the freshest, as slow sensors tell a reading again. Those from before the log are left out.

    rps (K, F, 3): NaN where there is none. age (K, F): s, of each reading.
    """
    taken = t[:, None] - age
    after = np.clip(np.searchsorted(t, taken), 1, len(t) - 1)
    nearest = after - (taken - t[after - 1] < t[after] - taken)
    told = np.isfinite(rps).all(axis=2) & (taken > t[0] - (t[1] - t[0]) / 2)
    found, read = np.zeros(rps.shape), np.zeros(told.shape, dtype=bool)
    for f in range(rps.shape[1]):
        rows = np.flatnonzero(told[:, f])
        rows = rows[np.argsort(-age[rows, f], kind="stable")]
        found[nearest[rows, f], f], read[nearest[rows, f], f] = rps[rows, f], True
    return found, read


def _wheels(train: TrainDescription) -> tuple[Array, Array, Array]:
    """Return counts a turn, radii and places to the left (2N,) of a train's wheels."""
    wheels = [wheel for module in train.modules for wheel in module.castors[0].wheels]
    per_turn = np.array([wheel.counts_per_rev for wheel in wheels], dtype=float)
    return per_turn, np.array([wheel.radius for wheel in wheels]), np.array([wheel.lateral for wheel in wheels])
