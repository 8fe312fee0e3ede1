"""How the runs of a measured session divide into those that calibrate its robot and those that test estimators.

Always within the session: the same robot, floor and tracked body, minutes apart. Another session, even of the same day,
may have another robot file, markers glued on anew, or a wheel that was mounted again.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import OPTIONAL, REQUIRED, Log


def divided(runs: Sequence[Log], way: float) -> tuple[tuple[Log, ...], tuple[Log, ...]]:
    """Return the logs that calibrate and those that test: of the latter all whose true path is longer than `way`, m.

    Runs with a reference that turn left in all, and those that turn right, are taken alternately, the first for
    calibration. The only run of its kind is cut in the middle of its time: the first half calibrates, the second tests.
    So both ways of turning are on both sides, where they were driven. What is too short to test calibrates nothing
    either: it was held out.
    """
    ways: dict[bool, list[Log]] = {True: [], False: []}
    for run in runs:
        known = run_with_reference(run)
        if known is not None:
            ways[_turned(known) < 0].append(known)
    recordings, tests = [], []
    for turned in ways.values():
        parts = turned if len(turned) != 1 else _halves(turned[0])
        recordings += parts[0::2]
        tests += parts[1::2]
    return tuple(recordings), tuple(log for log in tests if path_length(log) >= way)


def grip(logs: Sequence[Log]) -> float:
    """Return how far a robot goes for what its wheels turn, in m per count: the median of some logs. Of one robot's
    sessions with like drives it is largest where wheels slip least; 0.0 without logs."""
    turned = [np.abs(np.diff(log.wheel, axis=0)).sum() for log in logs]
    return float(np.median([path_length(log) / max(way, 1.0) for log, way in zip(logs, turned, strict=True)] or [0.0]))


def run_with_reference(log: Log) -> Log | None:
    """Return the rows from the first reference pose to the last; None where there are fewer than two poses."""
    if log.reference is None:
        return None
    known = np.flatnonzero(np.isfinite(log.reference).all(axis=1))
    return rows(log, slice(known[0], known[-1] + 1)) if len(known) > 1 else None


def rows(log: Log, chosen: slice) -> Log:
    """Return some rows of a log."""
    parts = {name: getattr(log, name) for name in (*REQUIRED, *OPTIONAL)}
    return dataclasses.replace(log, **{name: part[chosen] for name, part in parts.items() if part is not None})


def path_length(log: Log, every: float = 0.5) -> float:
    """Return the length (m) of the reference's path between poses that are `every` s apart: what a tracker's noise adds
    to shorter steps is no path."""
    places = _known(log)
    t = log.t[np.isfinite(log.reference).all(axis=1)] if log.reference is not None else log.t[:0]
    picked = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], every))) if len(t) else []
    return float(np.sum(np.hypot(*np.diff(places[picked, :2], axis=0).T)))


def _known(log: Log) -> Array:
    assert log.reference is not None
    return log.reference[np.isfinite(log.reference).all(axis=1)]


def _turned(log: Log) -> float:
    known = _known(log)
    return float(known[-1, 2] - known[0, 2])


def _halves(log: Log) -> list[Log]:
    middle = int(np.searchsorted(log.t, (log.t[0] + log.t[-1]) / 2))
    halves = [run_with_reference(rows(log, part)) for part in (slice(None, middle), slice(middle, None))]
    return [half for half in halves if half is not None]
