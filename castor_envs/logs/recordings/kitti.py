"""Trajectories as KITTI text: the 3x4 matrix [R | p] row by row, a line for each pose, without times.

Channels: x, y, z (m); heading (rad), about z; camera heading (rad), of a camera that looks along its z axis, with x to
its right, as in the KITTI odometry data: there forward is z, and left is -x. Times come from a file with one time (s) a
line, as that data set has (the map's "time"), or from a "period" (s).
"""

import itertools
import math
from collections.abc import Generator, Iterator
from pathlib import Path

from castor_envs.errors import InputError
from castor_envs.logs.recordings.recording import Clock, Reading, RecordingFormat, nanoseconds
from castor_envs.logs.recordings.tum import has_rows_of, rows_of

COLUMNS = tuple(f"r{i}{j}" if j < 4 else f"p{i}" for i in (1, 2, 3) for j in (1, 2, 3, 4))


class KittiText:
    """A trajectory without times of its own."""

    kind, held, inside = "trajectory (KITTI text)", False, ""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self.left_out: dict[str, str] = {}

    def clock(self) -> Clock:
        """Return 10 Hz, the rate of the KITTI data, to be edited."""
        return Clock(period=0.1)

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield readings, see `Recording`."""
        for time, row in zip(self._times(clock), rows_of(self._path, COLUMNS), strict=False):
            line, (r11, _, r13, x, r21, _, _, y, _, _, r33, z) = row
            if time is None:
                raise InputError(f"{self._path}:{line}: {clock.time} holds no time for this pose; add it")
            angles = (("heading", math.atan2(r21, r11)), ("camera heading", math.atan2(-r13, r33)))
            for name, value in (("x", x), ("y", y), ("z", z), *angles):
                if channels is None or name in channels:
                    yield Reading(name, time, value)

    def _times(self, clock: Clock) -> Iterator[int | None]:
        if clock.time is not None:
            path = self._path.parent / clock.time
            times = (nanoseconds(t, clock.unit, f"{path}:{line}") for line, (t,) in rows_of(path, ("t",)))
            return itertools.chain(times, itertools.repeat(None))
        if clock.period is None:
            raise InputError(f'{self._path}: KITTI text has no times; give a file of them as "time", or a "period"')
        return (round(k * clock.period * 1e9) for k in itertools.count())


FORMAT = RecordingFormat("trajectory as KITTI text (.kitti, .txt)", lambda path: has_rows_of(path, 12), KittiText)
