"""A filter of the whole train: it learns the gauges' offsets, predicts creep, and doubts the axles that slip.

An extended Kalman filter of the poses of all axles, two constant offsets of every frame's sensor and the wheels' radii.
Odometry predicts, relative poses correct. Of two axles that contradict each other nobody can tell at once which one
slipped: so a bank of such filters runs side by side, each with its own history of which axles slipped and how, weighed
by how well it explains all readings. Evidence that comes late then still decides.

State, for N axles and F = N - 1 frames: x, y (m) and psi (rad) of every axle in N; offsets of y (m) and phi (rad) of
every frame's readings, whose prior is that of its gauges' offsets in the train file; errors of the wheels' radii, part
of them, whose prior is the tolerance that modules of the train file state, `RADII` where they state none. One step is a
block of samples (`BLOCK`):

1. Prediction. Every axle moves by its odometry, corrected by the radii, and by its slip (along, across, turn), which is
   normal with a mean and a covariance that depend on its mode:
   - *grips*: the mean is the creep of its tyres under the loads of the bent frames (`likelihood.trains.bending`), the
     covariance that of `GRIP` and of rounded counts;
   - *slides*: it gives way to these loads `SLIDING` times as much, give or take as much again, and `SLIDING_SPREAD`;
   - *left* or *right wheel runs ahead*: it rolls farther than the ground beneath is long, over bumps or spinning, by
     `AHEAD` of the way;
   - *is lost*: pushed, or its wheels spin on the spot. They tell nothing of its motion, which is `LOST_SPREAD` at most.
2. Measurement, for every frame: y and phi of the mean reading, as it would be at the end of the block, with the noise
   of the gauges. The x of readings is not used: a bent frame is shortened by its bend, and this is known far better
   (`SHAPE`) than gauges measure it.
3. Test. Every filter of the bank branches: one of its axles may change its mode, with the probabilities of `SLIPS`,
   `TOGETHER` and `LASTS`, and those of `LOSES` and `LOST_LASTS`. A branch's weight is multiplied by the likelihood of
   its innovation. The `MOST` heaviest are kept; those with equal modes in the last `LAG` blocks become one, with the
   mean and the covariance of their mixture: to keep the heaviest alone would forget how unsure the filter was. On clean
   floors an axle that grips is thought to slip (probability above 1/2) in 0.4 % of the blocks; the tests allow 1 %.

A reading that repeats the last one bit for bit, while wheels say that the frame bends (`BENDS`), is of a frozen sensor,
which is as good as none: gauges are noisy, so that a live sensor never does, and no clean log is changed by this test.

A start that contradicts the first block's readings (`WRONG_START`) is no truth, but a belief: then the filter begins at
the best fit of both, as `inliers` finds it.

The estimate is the mean of the bank. References: Blom and Bar-Shalom, "The interacting multiple model algorithm", IEEE
Trans. Automatic Control 33(8), 1988, for modes that jump; Reid, "An algorithm for tracking multiple targets", IEEE
Trans. Automatic Control 24(6), 1979, for histories that are kept until evidence decides. Constants that come from no
paper were chosen on drives that no leaderboard uses.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.sensors.posture import posture
from castor_envs.vehicles.train import Frame, TrainDescription
from estimators.likelihood.trains import bending
from estimators.protocol import Observation
from estimators.steps.gaps import GAP, off_path
from estimators.trains.configuration import MAX_AGE, SLACK, Configuration
from estimators.trains.inliers import best_fit
from estimators.trains.pose_noise import ODOMETRY_SIGMA

GRIPS, SLIDES, LEFT_AHEAD, RIGHT_AHEAD, LOST = MODES = range(5)
"""How an axle moves on the ground."""

BLOCK = 0.25
"""s: samples of so long are taken together. A train at 0.25 m/s moves by 6 cm, and bends by a few degrees."""

START = np.array([5e-4, 5e-4, 1e-3])
"""Standard deviation of the poses at the start, m and rad: they are given, and taken to be true."""

RADII = 5e-4
"""Standard deviation of the error of each wheel's radius, part of it, where nobody states it: calibrated ones are right
to 0.04 % on average (Doebbler's Table I)."""

WRONG_START = 4.75
"""Standard deviations of a normal variable that one in a million exceeds."""

GRIP = np.array([2e-3, 6e-4, 3e-3])
"""Slip of an axle that grips, beyond predicted creep, after 1 m: along m, across m, turn rad; it grows with the square
root of the way. Tension of frames causes it, and all that the models leave out. In a block it is half as much; but that
of successive blocks is correlated (by 0.7 along, 0.3 turning), so that more adds up over a drive."""

SLIDING = 150.0
"""How much more an axle that slides gives way than by creep. Friction of 0.02 to 0.05 carries a tenth of a frame's
load, and what is left moves the axle until the frame is straight."""

SLIDING_SPREAD = np.array([0.06, 0.06, 0.3])
"""Further slip of an axle that slides, standard deviation for each metre: along m, across m, turn rad."""

AHEAD, AHEAD_SPREAD = 0.03, 0.02
"""By how much a wheel runs ahead, part of the way, mean and standard deviation: over cables of 1 cm every 10 cm."""

SLIPS, TOGETHER = 1 / 60.0, 1 / 20.0
"""1/s: how often an axle that grips begins to slide, or one of its two wheels to run ahead: once in a minute each; and
while another axle slips, or has slipped in the last `LAG` blocks, as what makes one slip lies in the way of others."""

LASTS = 4.0
"""s: how long an axle slips, on average."""

LOSES, LOST_LASTS = 1 / 600.0, 0.5
"""1/s and s: how often an axle is lost, moving or not, and for how long: a push, or wheels that spin on the spot."""

BOTH = 0.1
"""How probably, where an axle is lost, a certain other one is lost in the same moment."""

LOST_SPREAD = np.array([0.1, 0.1, 0.4])
"""Standard deviation of the motion of a lost axle in a block, m, m, rad, whatever its wheels say."""

FAR, AGAIN = 0.1, 3
"""rad: where readings turn an axle by more, they are linearised again about what they gave, so many times."""

LEAST_WAY = 1e-4
"""m: in a block in which no axle rolls farther, no mode changes."""

MOST, NEGLIGIBLE = 30, 15.0
"""Filters in the bank, and the logarithm of how much lighter than the heaviest they may be."""

LAG = 6
"""Blocks after which it no longer counts when an axle began or ceased to slip: such filters become one."""

BENDS = 1e-6
"""m and rad: a frame bends if odometry moves one of its ends so far as seen from the other. One count moves it more."""

SHAPE, UNSURE = 1.5e-4, 0.03
"""Standard deviation of a frame's length along x, m; and a part of its shortening, as tension bends it, too."""

ROUGH = np.array([1e-4, 5e-4])
"""Error of a reading (y m, phi rad) that is no noise: frames and gauges are not ideal."""


class Bank(NamedTuple):
    """Filters side by side, H of them.

    poses (H, N, 3). offsets (H, F, 2): of y, m, and phi, rad. radii (H, N, 2): by which part of its way each axle's
    left and right wheel rolls farther than it should. covariance (H, n, n): of all these in this order, n = 7N - 2.
    history (H, LAG, N): the modes of the last blocks. weight (H,): logarithm, of the heaviest 0.
    """

    poses: Array
    offsets: Array
    radii: Array
    covariance: Array
    history: NDArray[np.intp]
    weight: Array


class Slip(NamedTuple):
    """Slip of every axle by mode in every filter: mean (H, N, 4, 3) and covariance (H, N, 4, 3, 3), in N."""

    mean: Array
    covariance: Array


class Measured(NamedTuple):
    """innovation (H, 3F), its derivatives (H, 3F, n) by poses and offsets, and the noise (H, 3F, 3F): of y, phi and x
    of every frame."""

    innovation: Array
    derivative: Array
    noise: Array


class TrainFilter:
    """Estimates all axles' poses from all samples so far.

    After every update: covariance (N, 3, 3), of the poses at the end of the last block, m and rad; slipping (N,), the
    probability that each axle slips; offsets (F, 2), of the readings of y (m) and phi (rad). status: which frame's
    relative pose cannot be used now, and why; the others' are used.
    """

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises Declined for anything but a train, InputError for poses of another shape."""
        self._odometry = Configuration(train, poses, 1)
        self._train = train
        n, f = train.n_axles, len(train.frames)
        by_gauge = [_by_gauge(frame) for frame in train.frames]
        read = [frame.gauge_noise**2 * by @ by.T for frame, by in zip(train.frames, by_gauge, strict=True)]
        self._noise = np.array(read)
        stated = [module.tolerances for module in train.modules]
        radii = np.repeat([RADII if within is None else within.radius for within in stated], 2)
        covariance = np.diag(np.concatenate([np.tile(START**2, n), np.zeros(2 * f), radii**2]))
        for k, (frame, by) in enumerate(zip(train.frames, by_gauge, strict=True)):
            at = slice(3 * n + 2 * k, 3 * n + 2 * k + 2)
            covariance[at, at] = frame.gauge_offset**2 * by @ by.T
        wheels = [module.castors[0].wheels for module in train.modules]
        self._left, self._right = np.array([[wheel.lateral for wheel in pair] for pair in wheels]).T
        counted = [2 * np.pi * pair[0].radius / (pair[0].counts_per_rev or np.inf) for pair in wheels]
        track = self._left - self._right
        self._lateral = np.stack([self._left, self._right], axis=-1)
        # What an axle does, along, across and turning, for each metre that its left or right wheel rolls too far.
        unit, none = np.ones(n), np.zeros(n)
        too_far = [[self._right, none, unit], [-self._left, none, -unit]]
        self._too_far = np.array(too_far).transpose(2, 0, 1) / track[:, None, None]
        # Of each count two roundings are in a block's increment, 1/12 each: of both wheels along, and against.
        self._rounding = np.array(counted)[:, None] ** 2 / 6 * np.stack([0.5 + 0 * track, 0 * track, 2 / track**2], -1)
        self._bank = Bank(
            self._odometry.poses[None].copy(),
            np.zeros((1, f, 2)),
            np.zeros((1, n, 2)),
            covariance[None],
            np.zeros((1, LAG, n), dtype=np.intp),
            np.zeros(1),
        )
        self._times, self._od = np.zeros(0), np.zeros((0, n, 3))
        self._begun, self._od_begun = np.nan, self._odometry.poses.copy()
        self._longest, self._rate = 0.0, np.zeros(n)  # of the block's samples, s; at which axles turned before, rad/s
        self._taken, self._last = np.full(f, -np.inf), np.full((f, 3), np.nan)
        self._frozen, self._bent = np.zeros(f, dtype=bool), np.zeros((f, 3))
        self._begins_checked = False
        self._readings: list[tuple[Array, Array, Array]] = []
        self._summarise()

    @property
    def status(self) -> str | None:
        """Which frame's relative pose cannot be used now, and why; None while all can."""
        frozen = [name for name, repeats in zip(self._train.frame_names, self._frozen, strict=True) if repeats]
        says = f"frame {frozen[0]} repeats its last reading; odometry alone until it moves" if frozen else None
        return self._odometry.status or says

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (N, 3)."""
        self._odometry.advance(observation)
        time, od = float(observation["time"][0]), self._odometry.poses
        self._remember(time, od)
        self._read(observation, time)
        if time - self._begun >= BLOCK - SLACK:
            self._end_block(time - self._begun, od)
            self._begun, self._od_begun, self._readings, self._longest = time, od.copy(), [], 0.0
        return se2.compose(self._mean, se2.relative_pose(self._od_begun, od))

    def _remember(self, time: float, od: Array) -> None:
        """Keep OD poses as long as readings may refer to them."""
        if np.isnan(self._begun):
            self._begun = time
        if len(self._times):
            self._longest = max(self._longest, time - float(self._times[-1]))
        kept = self._times >= time - MAX_AGE - BLOCK
        self._times, self._od = np.append(self._times[kept], time), np.concatenate([self._od[kept], od[None]])

    def _read(self, observation: Observation, time: float) -> None:
        """Keep every frame's new reading, NaN where there is none, with the OD poses of its front and rear axle then.

        A reading that repeats the last one tells nothing new: by its age, as a sensor that has stopped gives it, or bit
        for bit, as a frozen one does.
        """
        f = len(self._taken)
        taken = time - np.asarray(observation["rps_age"], dtype=float)
        read = np.asarray(observation["rps"], dtype=float).reshape(f, 3)
        again = taken > self._taken + SLACK
        bent = se2.relative_pose(self._odometry.poses[1:], self._odometry.poses[:-1])
        bends = self._frozen | (np.abs(bent - self._bent).max(axis=1) > BENDS)
        self._frozen = (read == self._last).all(axis=1) & again & bends
        self._bent = np.where(self._frozen[:, None], self._bent, bent)
        new = self._odometry.usable & again & ~self._frozen
        self._taken, self._last = np.where(new, taken, self._taken), read.copy()
        reading = np.where(new[:, None], read, np.nan)
        then = np.array([[np.interp(taken, self._times, line) for line in axle.T] for axle in self._od.swapaxes(0, 1)])
        frames = np.arange(f)
        self._readings.append((reading, then[frames, :, frames], then[frames + 1, :, frames]))

    def _end_block(self, seconds: float, od: Array) -> None:
        """Predict, measure and branch: one step of the bank."""
        step = se2.relative_pose(self._od_begun, od)
        way = np.abs(step[:, 0])
        before, bank = self._bank, self._predicted(step)
        seen = self._measured(bank.poses, bank.offsets, od)
        if not self._begins_checked:
            self._begins_checked = True
            if self._start_is_wrong(bank, seen):
                self._restart()
                before, bank = self._bank, self._predicted(step)
                seen = self._measured(bank.poses, bank.offsets, od)
        slip = self._slip(before.poses, step, self._off_path(step, seconds))
        parents, modes, prior = branches(bank.history, seconds, moving=bool(way.max() > LEAST_WAY))
        axles, n = np.arange(len(od)), len(od)
        by_pose = seen.derivative[:, :, : 3 * n].reshape(len(bank.poses), -1, n, 3).transpose(0, 2, 1, 3)[:, :, None]
        mean = (by_pose @ slip.mean[..., None])[..., 0]
        spread = by_pose @ slip.covariance @ by_pose.swapaxes(-1, -2)
        gain = bank.covariance @ seen.derivative.swapaxes(-1, -2)
        left = seen.innovation[parents] - mean[parents[:, None], axles, modes].sum(axis=1)
        expected = (seen.derivative @ gain + seen.noise)[parents] + spread[parents[:, None], axles, modes].sum(axis=1)
        weight = bank.weight[parents] + prior + log_normal(left, expected)
        history = np.concatenate([bank.history[parents, 1:], modes[:, None]], axis=1)
        kept = heaviest(weight)

        parents, modes = parents[kept], modes[kept]
        rows = parents[:, None]
        slipped = np.zeros((len(kept), *bank.covariance.shape[1:]))
        for i in axles:
            at = slice(3 * i, 3 * i + 3)
            slipped[:, at, at] = slip.covariance[parents, i, modes[:, i]]
        covariance = bank.covariance[parents] + slipped
        moved = bank.poses[parents] + slip.mean[rows, axles, modes]
        change, gain, seen_by = _updated(left[kept], covariance, seen.derivative[parents], seen.noise[parents])
        far = np.abs(change[:, 2 : 3 * n : 3]).max(axis=1) > FAR
        for _ in range(AGAIN * bool(far.any())):
            at = moved[far] + change[far, : 3 * n].reshape(-1, n, 3)
            offsets = bank.offsets[parents][far] + change[far, 3 * n : 5 * n - 2].reshape(-1, n - 1, 2)
            again = self._measured(at, offsets, od)
            off = again.innovation + (again.derivative @ change[far][..., None])[..., 0]
            change[far], gain[far], seen_by[far] = _updated(off, covariance[far], again.derivative, again.noise)
        covariance = covariance - gain @ seen_by.swapaxes(-1, -2)
        updated = Bank(
            moved + change[:, : 3 * n].reshape(-1, n, 3),
            bank.offsets[parents] + change[:, 3 * n : 5 * n - 2].reshape(-1, n - 1, 2),
            bank.radii[parents] + change[:, 5 * n - 2 :].reshape(-1, n, 2),
            0.5 * (covariance + covariance.swapaxes(-1, -2)),
            history[kept],
            weight[kept],
        )
        self._bank = merged(updated)
        self._summarise()

    def _start_is_wrong(self, bank: Bank, seen: Measured) -> bool:
        """Whether the first block contradicts the start, where all frames have readings: a chi-square test.

        Of true starts one in a million fails (`WRONG_START`; the limit is Wilson and Hilferty's approximation).
        """
        spread = seen.derivative[0] @ bank.covariance[0] @ seen.derivative[0].T + seen.noise[0]
        found = seen.innovation[0] @ np.linalg.solve(spread, seen.innovation[0])
        share = 2 / (9 * len(spread))
        read = np.isfinite([reading for reading, *_ in self._readings]).any(axis=0).all()
        return bool(read and found > len(spread) * (1 - share + WRONG_START * share**0.5) ** 3)

    def _restart(self) -> None:
        """Start from the best fit of start and readings instead, as `inliers.best_fit` finds it, known as OD poses are.

        The readings are those of the first block, in which a train that starts hardly bends.
        """
        n = len(self._od_begun)
        fit, _ = best_fit(self._bank.poses[0], np.nanmean([reading for reading, *_ in self._readings], axis=0))
        covariance = self._bank.covariance.copy()
        covariance[0, : 3 * n, : 3 * n] = np.diag(np.tile(ODOMETRY_SIGMA**2, n))
        self._bank = self._bank._replace(poses=fit.poses[None], covariance=covariance)

    def _predicted(self, step: Array) -> Bank:
        """Return the bank moved by odometry's steps (N, 3) in the axles' frames, and by the radii's errors."""
        bank, n = self._bank, len(step)
        at, wheels = 3 * np.arange(n), 5 * n - 2 + 2 * np.arange(n)
        rolled = step[:, :1] - self._lateral * step[:, 2:]
        heading = se2.rotation(bank.poses[..., 2] + 0.5 * step[:, 2])
        by_radius = heading @ (rolled[..., None] * self._too_far).swapaxes(-1, -2)
        poses = se2.compose(bank.poses, step) + (by_radius @ bank.radii[..., None])[..., 0]
        moved = poses - bank.poses
        by_state = np.tile(np.eye(bank.covariance.shape[-1]), (len(poses), 1, 1))
        by_state[:, at, at + 2], by_state[:, at + 1, at + 2] = -moved[..., 1], moved[..., 0]
        for k in range(3):
            for w in range(2):
                by_state[:, at + k, wheels + w] = by_radius[..., k, w]
        covariance = by_state @ bank.covariance @ by_state.swapaxes(-1, -2)
        return bank._replace(poses=poses, covariance=covariance)

    def _off_path(self, step: Array, seconds: float) -> Array:
        """Return the variance (N, 3) of odometry's steps (N, 3) in a block of so many seconds, along, across and
        turning, by what is not known of the path in a gap."""
        expected, self._rate = self._rate * seconds, step[:, 2] / seconds
        if self._longest <= GAP * self._train.sample_period:
            return np.zeros_like(step)
        moved = zip(np.hypot(step[:, 0], step[:, 1]), step[:, 2], expected, strict=True)
        beside, short = np.array([off_path(*axle) for axle in moved]).T
        return np.stack([short**2, beside**2, 0.0 * beside], axis=-1)

    def _slip(self, poses: Array, step: Array, unknown: Array) -> Slip:
        """Return the slip of axles at poses (H, N, 3) that move by odometry's steps (N, 3), of which the variance
        (N, 3) is unknown."""
        way, turn = np.abs(step[:, 0]), step[:, 2]
        size = (*poses.shape[:2], len(MODES), 3)
        mean, covariance = np.zeros(size), np.zeros((*size, 3))
        along, across = bending.compliance(self._train)
        relative = se2.relative_pose(poses[:, 1:], poses[:, :-1])
        ends = self._ends(relative)
        load = bending.loads(self._train, relative, ends, np.zeros(relative.shape[:2]))
        # Two wheels at the same load, at `lateral` to each side: what turns the axle loads them against each other.
        gives_way = np.stack([along, across, -along / (self._left * self._right)], axis=-1)
        creep = load * gives_way * way[:, None]
        mean += creep[:, :, None]
        covariance += (
            np.diag(GRIP**2) * way[:, None, None] + np.eye(3) * self._rounding[:, None] * (way > 0)[:, None, None]
        )[:, None]
        covariance += (np.eye(3) * unknown[:, None])[:, None]
        slid = SLIDING * creep
        mean[:, :, SLIDES] += slid
        covariance[:, :, SLIDES] += slid[..., None] * slid[..., None, :]
        covariance[:, :, SLIDES] += np.diag(SLIDING_SPREAD**2) * (way**2)[:, None, None]
        for mode, wheel in ((LEFT_AHEAD, 0), (RIGHT_AHEAD, 1)):
            ahead = self._too_far[:, wheel] * way[:, None]
            mean[:, :, mode] += AHEAD * ahead
            covariance[:, :, mode] += AHEAD_SPREAD**2 * ahead[..., None] * ahead[..., None, :]
        heading = se2.rotation(poses[..., 2] + 0.5 * turn)[:, :, None]
        mean, covariance = (heading @ mean[..., None])[..., 0], heading @ covariance @ heading.swapaxes(-1, -2)
        mean[:, :, LOST] = poses - se2.compose(poses, step)
        covariance[:, :, LOST] = np.diag(LOST_SPREAD**2)
        return Slip(mean, covariance)

    def _ends(self, relative: Array) -> Array:
        """Return the curvature of all frames' ends (H, F, 2), 1/m, in relative poses (H, F, 3)."""
        frames = enumerate(self._train.frames)
        return np.stack([bending.ends(frame, relative[:, f]) for f, frame in frames], axis=1)

    def _measured(self, poses: Array, offsets: Array, od: Array) -> Measured:
        """Return what the block's readings say about poses (H, N, 3) and offsets (H, F, 2) at its end."""
        h, n, _ = poses.shape
        relative = se2.relative_pose(poses[:, 1:], poses[:, :-1])
        readings, front, rear = (np.array(parts) for parts in zip(*self._readings, strict=True))
        used = np.asarray(np.isfinite(readings).all(axis=-1))
        found = np.asarray(used.any(axis=0))
        number = np.maximum(used.sum(axis=0), 1)
        then_front = se2.compose(poses[:, None, :-1], se2.relative_pose(od[:-1], front))
        then_rear = se2.compose(poses[:, None, 1:], se2.relative_pose(od[1:], rear))
        difference = np.where(used[..., None], readings - se2.relative_pose(then_rear, then_front), 0.0)
        difference[..., 2] = wrap(difference[..., 2])
        difference = difference.sum(axis=1) / number[:, None]
        innovation = np.zeros((h, n - 1, 3))
        innovation[..., :2] = np.where(found[:, None], difference[..., 1:] - offsets, 0.0)
        ends = self._ends(relative)
        frames = self._train.frames
        bent = np.stack([bending.posture_of(frame, ends[:, f])[:, 0] for f, frame in enumerate(frames)], axis=1)
        innovation[..., 2] = bent - relative[..., 0]
        derivative, noise = np.zeros((h, n - 1, 3, 7 * n - 2)), np.zeros((h, 3 * n - 3, 3 * n - 3))
        by_poses = by_both_poses(poses)
        for f, frame in enumerate(frames):
            # A frame bent to y and phi is shortened by (3/5 y^2 - y phi L / 10 + phi^2 L^2 / 15) / L, for small bends.
            length, y, phi = frame.length, relative[:, f, 1], relative[:, f, 2]
            by_y, by_phi = 1.2 * y / length - phi / 10, 2 * length * phi / 15 - y / 10
            rows, at = derivative[:, f], slice(3 * f, 3 * f + 6)
            rows[:, 0, at], rows[:, 1, at] = by_poses[:, f, 1], by_poses[:, f, 2]
            rows[:, 2, at] = by_poses[:, f, 0] + by_y[:, None] * rows[:, 0, at] + by_phi[:, None] * rows[:, 1, at]
            rows[:, [0, 1], 3 * n + 2 * f + np.arange(2)] = 1.0
            if not found[f]:
                rows[:, :2] = 0.0
            at = slice(3 * f, 3 * f + 2)
            noise[:, at, at] = self._noise[f] / number[f] + np.diag(ROUGH**2)
            noise[:, 3 * f + 2, 3 * f + 2] = SHAPE**2 + (UNSURE * (length - bent[:, f])) ** 2
        return Measured(innovation.reshape(h, -1), derivative.reshape(h, 3 * n - 3, -1), noise)

    def _summarise(self) -> None:
        """Take the mean of the bank."""
        bank, n = self._bank, self._bank.poses.shape[1]
        weight = np.exp(bank.weight) / np.exp(bank.weight).sum()
        self._mean = np.einsum("h,hik->ik", weight, bank.poses)
        self.offsets = np.einsum("h,hfk->fk", weight, bank.offsets)
        self.slipping = weight @ (bank.history[:, -1] != GRIPS)
        away = bank.poses - self._mean
        own = bank.covariance[:, : 3 * n, : 3 * n].reshape(-1, n, 3, n, 3)[:, np.arange(n), :, np.arange(n)]
        spread = np.einsum("h,hij,hik->ijk", weight, away, away)
        self.covariance = np.einsum("h,nhjk->njk", weight, own) + spread


def branches(
    history: NDArray[np.intp], seconds: float, moving: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return all that may follow histories (H, LAG, N) after some seconds: parents (C,), modes (C, N), log probability
    (C,).

    Nothing changes, or, in a train that moves, one axle begins to slip, in one of three modes, or grips again; or, also
    in one that stands, one axle is lost, or two at once, or grips again.
    """
    modes = history[:, -1]
    h, slips = len(modes), modes != GRIPS
    troubled = (history != GRIPS).any(axis=(1, 2))[:, None]
    begins = np.minimum(np.where(troubled, TOGETHER, SLIPS) * seconds, 0.25) * moving
    loses = min(LOSES * seconds, 0.25)
    # From what to what, of every filter and axle: (H, N, 5).
    rates = np.where(np.arange(5) == GRIPS, 0.0, np.array([0.0, 1.0, 0.5, 0.5, 0.0]) * begins[..., None])
    rates = np.broadcast_to(rates, (*modes.shape, 5)).copy()
    rates[..., LOST] = loses
    rates[slips] = 0.0
    rates[slips, GRIPS] = min(seconds / LASTS, 0.5) * moving
    rates[modes == LOST, GRIPS] = min(seconds / LOST_LASTS, 0.5)
    keeps = np.log(1.0 - rates.sum(axis=-1))
    stays = keeps.sum(axis=1)
    # Which filter, which axle, and its new mode.
    filters, axles, new = np.nonzero(rates)
    changed = modes[filters]
    changed[np.arange(len(axles)), axles] = new
    parents = np.concatenate([np.arange(h), filters])
    changes = stays[filters] - keeps[filters, axles] + np.log(rates[filters, axles, new])
    # Two axles are lost in the same moment, where none slipped just now: else it is too rare.
    front, rear = np.triu_indices(modes.shape[1], 1)
    pairs, pair = np.nonzero(np.broadcast_to(~troubled & (loses > 0.0), (h, len(front))))
    lost, rows = modes[pairs], np.arange(len(pairs))
    lost[rows, front[pair]] = lost[rows, rear[pair]] = LOST
    others = stays[pairs] - keeps[pairs, front[pair]] - keeps[pairs, rear[pair]]
    together = others + np.log(np.full(len(pairs), loses * BOTH))
    parents = np.concatenate([parents, pairs])
    return parents, np.concatenate([modes, changed, lost]), np.concatenate([stays, changes, together])


def heaviest(weight: Array) -> NDArray[np.intp]:
    """Return the `MOST` heaviest branches of weight (C,), heaviest first, that are not `NEGLIGIBLE`."""
    order = np.argsort(-weight, kind="stable")[:MOST]
    return order[weight[order] >= weight[order[0]] - NEGLIGIBLE]


def merged(bank: Bank) -> Bank:
    """Return a bank in which filters of one history are one, with the mean and the covariance of their mixture."""
    h, n, _ = bank.poses.shape
    _, first, group = np.unique(bank.history.reshape(h, -1), axis=0, return_index=True, return_inverse=True)
    share = np.exp(bank.weight - bank.weight.max()) * (group.ravel() == np.arange(len(first))[:, None])
    total = share.sum(axis=1)
    share = share / total[:, None]
    state = np.concatenate([part.reshape(h, -1) for part in (bank.poses, bank.offsets, bank.radii)], axis=1)
    mean = share @ state
    away = state - mean[group.ravel()]
    spread = bank.covariance + away[:, :, None] * away[:, None, :]
    poses, offsets, radii = np.split(mean, [3 * n, 5 * n - 2], axis=1)
    weight = np.log(total)
    return Bank(
        poses.reshape(-1, n, 3),
        offsets.reshape(-1, n - 1, 2),
        radii.reshape(-1, n, 2),
        np.tensordot(share, spread, axes=1),
        bank.history[first],
        weight - weight.max(),
    )


def _updated(left: Array, covariance: Array, derivative: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Return the change (H, n) of states by innovations (H, 3F), the gain (H, n, 3F), and the covariance of both."""
    seen_by = covariance @ derivative.swapaxes(-1, -2)
    gain = np.linalg.solve(derivative @ seen_by + noise, seen_by.swapaxes(-1, -2)).swapaxes(-1, -2)
    return (gain @ left[..., None])[..., 0], gain.astype(float, copy=False), seen_by


def log_normal(value: Array, covariance: Array) -> Array:
    """Return the logarithm of the normal density of values (..., n) about 0, up to a constant of n."""
    solved = np.linalg.solve(covariance, value[..., None])[..., 0]
    return -0.5 * (np.linalg.slogdet(covariance)[1] + np.sum(value * solved, axis=-1))


def by_both_poses(poses: Array) -> Array:
    """Return the derivatives (H, F, 3, 6) of relative poses by those of front and rear axle, at poses (H, N, 3)."""
    seen = se2.relative_pose(poses[:, 1:], poses[:, :-1])
    front = se2.rotation(poses[:, 1:, 2]).swapaxes(-1, -2)
    rear = -front
    rear[..., 0, 2], rear[..., 1, 2] = seen[..., 1], -seen[..., 0]
    return np.concatenate([front, rear], axis=-1)


def _by_gauge(frame: Frame) -> Array:
    """Return the derivatives (2, gauges) of y, m, and phi, rad, that a straight frame reads, by its gauges, 1/m."""
    small = bending.SMALL * np.eye(len(frame.gauge_positions))
    return ((posture(frame, small) - posture(frame, -small)) / (2 * bending.SMALL))[:, 1:].T


ESTIMATORS = {"train-filter": TrainFilter}
