"""Trajectories as TUM text: ``t x y z qx qy qz qw`` a line. Channels: x, y, z (m), heading about z (rad)."""

from collections.abc import Generator, Iterator
from pathlib import Path

from castor_envs.logs.recordings.csv_cells import is_number
from castor_envs.logs.recordings.recording import (
    UNITS,
    Clock,
    Reading,
    RecordingFormat,
    TimeUnit,
    heading_of,
    nanoseconds,
)
from castor_envs.logs.recordings.text_lines import first_row, is_comment, numbered_lines
from castor_envs.logs.table import complaint, number

COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")

LATEST = 1e20
"""ns since 1970, in the year 5138: a larger number is a time in a smaller unit."""


def rows_of(path: Path, names: tuple[str, ...]) -> Iterator[tuple[int, list[float]]]:
    """Yield line numbers and the numbers of each line, separated by blanks; lines that begin with # are left out."""
    for k, line in numbered_lines(path, []):
        cells = line.split()
        if not cells or is_comment(line):
            continue
        if len(cells) != len(names):
            raise complaint(path, k, None, f"has {len(cells)} numbers; give {' '.join(names)}")
        yield k, [number(path, k, name, cell) for name, cell in zip(names, cells, strict=True)]


def has_rows_of(path: Path, count: int) -> bool:
    """Return whether a text file's first line that is no comment has so many numbers, separated by blanks."""
    cells = first_row(path) if path.is_file() and path.suffix.lower() in (".tum", ".kitti", ".txt", "") else None
    return cells is not None and len(cells) == count and all(map(is_number, cells))


class TumText:
    """A trajectory with times, s, or in the unit that a map gives."""

    kind, held, inside = "trajectory (TUM text)", False, ""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self.left_out: dict[str, str] = {}

    def clock(self) -> Clock:
        """Return the clock of the file: in s, or in the smaller unit in which its first time is no later than `LATEST`
        since 1970."""
        times = (t for _, (t, *_) in rows_of(self._path, COLUMNS))
        first = abs(next(times, 0.0))
        units: list[TimeUnit] = [unit for unit, ns in UNITS.items() if first * ns <= LATEST]
        return Clock(unit=units[0]) if units else Clock()

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield readings, see `Recording`."""
        clock.takes_that_of(self._path, "the times are in the file")
        for line, (t, x, y, z, *quaternion) in rows_of(self._path, COLUMNS):
            time = nanoseconds(t, clock.unit, f"{self._path}:{line}")
            for name, value in (("x", x), ("y", y), ("z", z), ("heading", heading_of(*quaternion))):
                if channels is None or name in channels:
                    yield Reading(name, time, value)


FORMAT = RecordingFormat("trajectory as TUM text (.tum, .txt)", lambda path: has_rows_of(path, 8), TumText)
