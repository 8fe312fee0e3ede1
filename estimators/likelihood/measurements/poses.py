"""Reference poses of one log: off by independent errors, where and when they were taken.

Their clock may be early or late, and fast or slow. Without any pose the first one of the state is 0, by convention.
Positions without a heading have no equation of it. Where no heading is known at all, that of the first position is
expected as the path by odometry has it once it follows the positions, and may be far off that (`NORTH`): it then stays
determined where a robot hardly moves.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.positions import headings_along
from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log, positions_taken
from estimators.likelihood.elimination import Prior, Rows

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

NORTH = 1.0
"""rad: prior standard deviation of the heading at the first of positions without any heading; wide enough not to
matter where the robot drives further than positions are off."""

APART, DENSE = 3.0, 0.5
"""s: of reference poses that follow each other faster than `DENSE`, as a tracker streams them, one in `APART` is used.
Errors of such poses within seconds (jitter of clocks, a filter) are correlated."""

FAR_APART = 12.0
"""s: poses so far apart tell slip from errors of a tracker that last for several seconds (`far_apart`)."""

CLOCK = np.array([1.0, 0.05])
"""s and 1: prior standard deviations of the reference's clock, at the start and in rate; wide enough not to matter."""

SWINGING = 0.1
"""s: the acceleration of the tracked point comes from the path so long, and half as long again, before and after a
pose, or two and three samples if that is longer: less is noise of counts, and in more a robot starts and stops."""

RATE_KNOWN = 1e-6
"""s/s: standard deviation of a known rate."""


class ReferencePoses:
    """The reference poses of a log, and those of them that are in use: dense poses are not independent.

    poses (K, 3): as in the log, NaN where none was taken. taken: the samples that have one, or a position. used: those
    in use. guessed (K, 3): the poses with headings to start from where they have none (`guess_headings`).
    """

    def __init__(self, log: Log, counts: Array) -> None:
        """counts (K, c): of all encoders, which tell where the robot rests at the log's ends."""
        self._t = log.t
        self.poses = np.full((len(log), 3), np.nan) if log.reference is None else log.reference
        self.taken, self.guessed = positions_taken(log), self.poses
        self.used = _apart(self.taken, log.t)
        self._headed = np.flatnonzero(np.isfinite(self.poses[self.used, 2]))
        self._north = len(self.taken) > 0 and bool(np.isnan(self.poses[self.taken, 2]).all())
        self._rests = tuple(bool(np.ptp(part, axis=0).max() <= 1) for part in (counts[:REST], counts[-REST:]))

    @property
    def headless(self) -> bool:
        """Whether there are positions without a heading."""
        return bool(np.isnan(self.poses[self.taken, 2]).any())

    def guess_headings(self, path: Array, way: Array, size: float) -> None:
        """Set headings to start from where there are none. path (K, 3): by odometry. way (K,): rolled until each
        sample, m, increasing. size: of the robot, m."""
        heading = headings_along(path[self.used], self.poses[self.used], way[self.used], size)
        turn = np.interp(way[self.taken], way[self.used], heading - path[self.used, 2])
        self.guessed = self.poses.copy()
        guesses = np.where(np.isnan(self.poses[self.taken, 2]), path[self.taken, 2] + turn, self.poses[self.taken, 2])
        self.guessed[self.taken, 2] = guesses

    def clock_prior(self, rate: float | None) -> Prior:
        """Return the prior of the clock: offset, s, and rate, s/s; `rate`: its rate, if it is known."""
        deviation, expected = CLOCK if len(self.used) >= TIMED else CLOCK * 1e-6, np.zeros(2)
        if rate is not None:
            deviation, expected = np.array([deviation[0], RATE_KNOWN]), np.array([0.0, rate])
        return Prior(expected, deviation)

    def weights(self, state: Array, position: float, heading: float, jitter: float) -> dict[str, Array]:
        """Return one over the standard deviation of every equation at a state (K, m), by the kinds of `off`.

        position, heading: of poses, m and rad. jitter: of the robot's clock, s.
        """
        if not len(self.taken):
            return {"pinned": np.full((1, 3), 1 / PINNED)}
        rate = jitter * np.gradient(state[:, :3], self._t, axis=0)[self.used]
        weights = {"position": 1 / np.hypot(position, rate[:, :2])}
        weights["heading"] = 1 / np.hypot(heading, rate[self._headed, 2:])
        return weights | ({"north": np.full((1, 1), 1 / NORTH)} if self._north else {})

    def off(self, state: Array, clock: Array, mount: Array) -> dict[str, Array]:
        """Return by how much a state is off the poses in use, m and rad: "position" (k, 2), "heading" (h, 1) of those
        that have one and, where none has, "north" (1, 1); or without poses "pinned" (1, 3). clock (2,): offset, s, and
        rate; mount (3,): the tracked point."""
        if not len(self.taken):
            return {"pinned": state[:1, :3]}
        at, part, known = self._shown(clock)
        off = compose((1 - part) * state[at, :3] + part * state[at + 1, :3], mount)
        off = known * (off - self.poses[self.used])
        of_poses = {"position": off[:, :2], "heading": off[self._headed, 2:]}
        first = self.taken[:1]
        return of_poses | ({"north": state[first, 2:3] - self.guessed[first, 2:3]} if self._north else {})

    def rows(
        self,
        state: Array,
        clock: Array,
        mount: Array,
        weights: dict[str, Array],
        values: dict[str, Array],
        rates: Array,
        sways: Array,
        more: int,
    ) -> dict[str, Rows]:
        """Return the equations linearised about a state, by the kinds of `off`; values: of these, times their weights.
        rates (P,): rate of the clock per unit of each parameter, s/s. sways (P,): by how much poses are off in
        proportion to the tracked point's acceleration, s2. more: numbers of the log after the clock's, which poses do
        not depend on."""
        eye = np.eye(state.shape[1])
        if not len(self.taken):
            pinned = (eye[None, :3] / PINNED).__getitem__
            return {"pinned": Rows(np.arange(1), values["pinned"], pinned)}
        at, part, known = self._shown(clock)
        since = self._t[self.used] - self._t[0]
        body = (1 - part) * state[at, :3] + part * state[at + 1, :3]
        seen = compose(body, mount)
        by_body = np.tile(eye[:3], (len(at), 1, 1))
        by_body[:, 0, 2], by_body[:, 1, 2] = body[:, 1] - seen[:, 1], seen[:, 0] - body[:, 0]
        c, s, zeros, ones = np.cos(body[:, 2]), np.sin(body[:, 2]), np.zeros(len(at)), np.ones(len(at))
        by_mount = np.array([[c, -s, zeros], [s, c, zeros], [zeros, zeros, ones]]).transpose(2, 0, 1)
        speed = (state[at + 1, :3] - state[at, :3]) / (self._t[at + 1] - self._t[at])[:, None]
        by_clock = (by_body[..., :3] @ speed[..., None]) * np.column_stack([ones, since])[:, None, :]
        independent = np.zeros((len(at), 3, more))
        by_effects = by_clock[..., 1:] * rates
        if np.any(sways):
            by_effects[:, :2] += self.accelerations(state, clock, mount)[..., None] * sways
        numbers = np.concatenate([by_effects, by_mount, by_clock, independent], axis=-1)
        parts = ((1 - part)[..., None] * by_body, part[..., None] * by_body, numbers)
        kinds = {}
        every = np.arange(len(at))
        for name, axes, of in (("position", slice(0, 2), every), ("heading", slice(2, 3), self._headed)):
            weight = (weights[name] * known[of])[..., None]
            start, end, by_numbers = ((weight * slope[of, axes]).__getitem__ for slope in parts)
            kinds[name] = Rows(at[of], values[name], start, end, by_numbers)
        if self._north:
            kinds["north"] = Rows(self.taken[:1], values["north"], (eye[None, 2:3] / NORTH).__getitem__)
        return kinds

    def accelerations(self, state: Array, clock: Array, mount: Array) -> Array:
        """Return the accelerations (k, 2) of the tracked point where poses in use were taken, m/s2.

        They come from samples around a pose and not from those next to it, with whose errors, of when they were read,
        the pose's own would be in proportion; at the log's ends those of the nearest pose that has such samples. 0 in
        logs that are too short.
        """
        at, part, _ = self._shown(clock)
        apart = max(SWINGING, 2 * float(np.median(np.diff(self._t))))
        taken = self._t[at] + part[:, 0] * (self._t[at + 1] - self._t[at])
        if self._t[-1] - self._t[0] <= 4 * apart:
            return np.zeros((len(taken), 2))
        taken = np.clip(taken, self._t[0] + 2 * apart, self._t[-1] - 2 * apart)
        tracked = compose(state[:, :3], mount)[:, :2]

        def around(by: float) -> Array:
            return np.column_stack(
                [np.interp(taken - by, self._t, x) + np.interp(taken + by, self._t, x) for x in tracked.T]
            )

        return (around(1.5 * apart) - around(apart)) / (1.25 * apart**2)

    def steps_of(self, samples: NDArray[np.intp], clock: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the sample after which each of these samples' pose was taken, and the part (k, 1) of the step up to
        it.

        The part is below 0 or above 1 for poses that were taken before or after the log.
        """
        t = self._t
        taken = t[samples] + clock[0] + clock[1] * (t[samples] - t[0])
        at = np.clip(np.searchsorted(t, taken, side="right") - 1, 0, len(t) - 2)
        return at, ((taken - t[at]) / (t[at + 1] - t[at]))[:, None]

    def _shown(self, clock: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the sample after which each pose in use was taken, the part (k, 1) of the step up to it, and its
        weight (k, 1), which fades out beyond the log's ends."""
        at, part = self.steps_of(self.used, clock)
        held = np.clip(part, 0.0 if self._rests[0] else -np.inf, 1.0 if self._rests[1] else np.inf)
        outside = np.abs(held - np.clip(held, 0.0, 1.0))
        return at, np.clip(held, -FADED, 1 + FADED), np.clip((FADED - outside) / (FADED - EXTENDED), 0.0, 1.0)


def far_apart(log: Log) -> Log:
    """Return a log with one reference pose in `FAR_APART` where it has dense ones, or else the log itself.

    Of poses that are nearer, errors that last for seconds count as slip, which would add up along the way. Where
    errors are independent, fewer poses tell less.
    """
    taken = positions_taken(log)
    kept = _apart(taken, log.t, FAR_APART)
    if log.reference is None or len(kept) == len(taken):
        return log
    reference = np.full_like(log.reference, np.nan)
    reference[kept] = log.reference[kept]
    return replace(log, reference=reference)


def _apart(samples: NDArray[np.intp], t: Array, apart: float = APART) -> NDArray[np.intp]:
    """Return these samples or, if they are dense, the first, the last, and between them one in `apart`, s."""
    if len(samples) < 2 or np.median(np.diff(t[samples])) >= DENSE:
        return samples
    kept: list[int] = []
    for k in samples.tolist():
        if not kept or t[k] - t[kept[-1]] >= apart * (1 - 1e-9) or k == samples[-1]:
            kept.append(k)
    return np.array(kept, dtype=np.intp)
