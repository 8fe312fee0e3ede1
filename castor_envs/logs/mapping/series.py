"""Readings of one channel as arrays, and their values at the times of a log's rows."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array, Numbers
from castor_envs.logs.reference import interpolated

LONGEST = 0.5
"""s: the longest time between speeds over which counts are still summed."""

BEHIND, FEW = 0.5, 0.1
"""s, and part of all readings: what a recorder's threads, and networks, bring out of order is less, and left out."""

WHOLE = 0.02
"""Counts by which whole ones may be off after a driver turned them into an angle, in single precision for instance."""


@dataclass(frozen=True, eq=False)
class Track:
    """Numbers of one column in time.

    where: names the channel in errors. t (M,), s, strictly increasing; value (M,). held: whether each value stays until
    the next. rate: where values are a sum over held rates, the last of them, which goes on; None elsewhere.
    """

    where: str
    t: Array
    value: Array
    held: bool
    rate: float | None = None

    @classmethod
    def of(cls, where: str, times: Numbers, values: Numbers, held: bool) -> tuple[Self, dict[str, int]]:
        """Return the track of readings at times, ns since the log's first row, and by reasons how many are left out.

        Those are left out whose time is not after the latest before them. Raises InputError for a clock that goes back,
        or stands still in most readings.
        """
        latest = np.maximum.accumulate(times)
        new, late = np.append(True, np.diff(latest) > 0), times < latest
        if (back := _goes_back(times, new, late)) is not None:
            raise InputError(
                f"{where}: the clock goes back by {(latest[back] - times[back]) / 1e9:.6g} s at reading {back + 1}; "
                "give another clock, or cut the recording there"
            )
        repeated = int(np.sum(~new & ~late))
        if 2 * repeated > len(new):
            raise InputError(
                f"{where}: {repeated} of {len(new)} readings repeat a time: the clock is too coarse, or not theirs; "
                "give the source another 'time'"
            )
        left_out = {"repeat a time": repeated, "come after later ones": int(np.sum(late))}
        return cls(where, times[new] / 1e9, values[new], held), left_out

    def scaled(self, factor: float) -> Self:
        """Return the track with all numbers multiplied."""
        return replace(self, value=self.value * factor, rate=None if self.rate is None else self.rate * factor)

    def unwrapped(self, period: float) -> Self:
        """Return the track with steps of over half a period taken the shorter way round."""
        return replace(self, value=np.unwrap(self.value, period=period))

    def whole(self) -> Self:
        """Return whole numbers where readings are apart by whole ones: counts that a driver turned into an angle."""
        first, apart = self.value[0], self.value - self.value[0]
        rounded = np.round(apart)
        return replace(self, value=np.round(first) + rounded) if np.all(np.abs(apart - rounded) <= WHOLE) else self

    def integrated(self) -> Self:
        """Return the integral of rates over time: by the trapezoid rule, or of held values.

        Raises InputError for gaps of over `LONGEST` between rates that are not held.
        """
        steps = np.diff(self.t)
        for k in np.flatnonzero(steps > LONGEST)[: 0 if self.held else 1]:
            raise InputError(
                f"{self.where}: no reading for {steps[k]:.3g} s from {self.t[k]:.3f} s on, over which speeds cannot be "
                "summed; cut the recording there"
            )
        mean = self.value[:-1] if self.held else (self.value[:-1] + self.value[1:]) / 2
        total = np.append(0.0, np.cumsum(mean * steps))
        return replace(self, value=total, held=False, rate=float(self.value[-1]) if self.held else None)

    def at(self, t: Array) -> Array:
        """Return the values (K,) at times t (K,), NaN where there is none near enough."""
        if self.rate is not None:
            beyond = np.maximum(t - self.t[-1], 0.0) * self.rate
            return np.where(t < self.t[0], np.nan, np.interp(t, self.t, self.value) + beyond)
        return self.before(t) if self.held else interpolated(self.t, self.value, t)

    def before(self, t: Array) -> Array:
        """Return the last values (K,) at or before times t (K,), NaN where there is none."""
        place = np.searchsorted(self.t, t, side="right") - 1
        return np.where(place < 0, np.nan, self.value[np.maximum(place, 0)])

    def mean_around(self, t: Array) -> Array:
        """Return at times t (K,) of rows the mean from half a row before to half a row after, NaN as `at` has it.

        A gyro that is read more often than counts loses noise by that and keeps its whole turn. Values of a track that
        has no more than two readings a row are those of `at`.
        """
        found = self.at(t)
        inside = (self.t >= t[0]) & (self.t <= t[-1])
        if not self.held and np.sum(inside) <= 2 * len(t):
            return found
        edges = np.concatenate([t[:1], (t[1:] + t[:-1]) / 2, t[-1:]])
        total = self.integrated() if self.held else replace(self, value=_integral(self.t, self.value), rate=0.0)
        return np.where(np.isfinite(found), np.diff(total.at(edges)) / np.diff(edges), np.nan)

    def rate_around(self, t: Array) -> Array:
        """Return the values' mean rate (K,), a second, from half a row before to half a row after times t (K,) of rows.

        A value half-way between two rows is the mean of theirs, so that the rates sum to the whole change.
        """
        value = self.at(t)
        at_edges, edges = (np.concatenate([v[:1], (v[1:] + v[:-1]) / 2, v[-1:]]) for v in (value, t))
        return np.diff(at_edges) / np.diff(edges)


def in_order(times: Numbers) -> tuple[NDArray[np.intp], int]:
    """Return the order of readings by times (M,), ns, and how many come after later ones; those that are behind by more
    than `BEHIND` stay where they are, as of a clock that goes back."""
    latest = np.maximum.accumulate(times)
    late = (times < latest) & (latest - times <= BEHIND * 1e9)
    behind = (times < latest) & ~late
    return np.argsort(np.where(behind, latest, times), kind="stable"), int(np.sum(late))


def _goes_back(times: Numbers, new: NDArray[np.bool_], late: NDArray[np.bool_]) -> int | None:
    """Return the first reading of a clock that goes back, as of a log that was restarted; None for a few late readings.

    times (M,), ns; new: those after all before them; late: those before one of these. A clock goes back that stays
    behind for over `BEHIND`, or of which more than `FEW` of the readings are late.
    """
    at = np.flatnonzero(late)
    if len(at) > FEW * len(times):
        return int(at[0])
    first = at[np.searchsorted(at, np.flatnonzero(new)[np.cumsum(new)[at] - 1])]  # of those late ones in a row
    return next(iter(first[times[at] - times[first] > BEHIND * 1e9].tolist()), None)


def _integral(t: Array, value: Array) -> Array:
    return np.append(0.0, np.cumsum(np.diff(t) * (value[1:] + value[:-1]) / 2))


def row_times(tracks: list[Track]) -> Array:
    """Return the times (K,) of rows for columns of counts.

    Of sampled columns those of the one with the fewest readings, so that it needs no interpolation. Of columns that are
    held, every change: those of one cycle of the robot's program, which come within half the usual time between changes
    of the busiest column, are one row, at the last of them.
    """
    if not any(track.held or track.rate is not None for track in tracks):
        return min(tracks, key=lambda track: len(track.t)).t
    times = np.unique(np.concatenate([track.t for track in tracks]))
    least = np.median(np.diff(max((track.t for track in tracks), key=len), prepend=-np.inf)) / 2
    rows, first = [], -np.inf
    for time in times.tolist():
        if time - first > least:
            rows.append(time)
            first = time
        else:
            rows[-1] = time
    return np.array(rows)
