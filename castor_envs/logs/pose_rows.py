"""Rows at the times of reference poses that no row with counts is near to, with counts as they were then.

A tracker that takes fewer poses a second than a log has rows tells at few of these where the robot was. At a pose's own
time counts can be interpolated instead, as they are read often enough (`interpolated`).
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array, Numbers
from castor_envs.logs.log import OPTIONAL, Log, unwrapped
from castor_envs.logs.reference import TimedPoses, interpolated
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.train import TrainDescription

HELD = ("command", "steering_command", "rps_age")
"""Parts of a log that hold until the next row; all others that are not interpolated are blank in an added row."""


def with_reference(log: Log, tracked: TimedPoses, vehicle: Vehicle) -> Log:
    """Return a log with the reference by poses at times of their own: at its rows where they are near enough, and else
    in rows that are added at the times of poses.

    Counts of an added row are interpolated, those of a pivot encoder that wraps the shorter way round, and need not be
    whole; commands are those of the row before, a gyro's rate is interpolated, and all else is blank. Poses of which
    counts are too far to be interpolated are left out.
    """
    at_rows = tracked.at(log.t)
    log = dataclasses.replace(log, reference=at_rows)
    shown = np.asarray(np.isfinite(at_rows[:, 0]))
    after = np.searchsorted(log.t, tracked.t)
    within = (after > 0) & (after < len(log)) & np.isfinite(interpolated(log.t, log.t, tracked.t))
    after = np.clip(after, 1, len(log) - 1)
    lost = within & ~(shown[after] | shown[after - 1]) & np.isfinite(tracked.pose[:, 0])
    return _with_rows(log, TimedPoses(tracked.t[lost], tracked.pose[lost]), after[lost], vehicle)


def _with_rows(log: Log, added: TimedPoses, after: NDArray[np.intp], vehicle: Vehicle) -> Log:
    """Return a log with a row for each of these poses, before the rows `after` (n,)."""
    if not len(after):
        return log
    parts: dict[str, Numbers] = {
        "t": added.t,
        "wheel": interpolated(log.t, log.wheel, added.t),
        "pivot": _turned(log, added.t, vehicle),
        "reference": added.pose,
    }
    for part in OPTIONAL:
        values = getattr(log, part)
        if values is None or part in parts:
            continue
        if part == "gyro":
            parts[part] = interpolated(log.t, values, added.t)
        else:
            parts[part] = values[after - 1] if part in HELD else np.full((len(after), *values.shape[1:]), np.nan)
    joined = {name: np.insert(getattr(log, name), after, values, axis=0) for name, values in parts.items()}
    extra = {name: np.insert(np.asarray(cells), after, "") for name, cells in log.extra.items()}
    return dataclasses.replace(log, **joined, extra=extra)


def _turned(log: Log, t: Array, vehicle: Vehicle) -> Array:
    """Return the counts of pivot encoders (n, pivot encoders) at times t (n,), wrapped as those of the log."""
    pivot = np.array(log.pivot)
    turns = [] if isinstance(vehicle, TrainDescription) else [vehicle.castors[i] for i in vehicle.pivot_encoders]
    found = np.zeros((len(t), pivot.shape[1]))
    for column, castor in enumerate(turns):
        count, turn = pivot[:, column], castor.pivot_counts_per_rev or np.inf
        wraps = np.isfinite(turn) and np.ptp(count) <= turn
        found[:, column] = interpolated(log.t, unwrapped(count, turn) if wraps else count, t)
        if wraps:
            found[:, column] = count.min() + np.mod(found[:, column] - count.min(), turn)
    return found
