"""Data logs of WPILib (.wpilog), by its own reader in robotpy-wpiutil.

A channel is an entry of numbers, such as ``NT:/drive/left``; one of an array, ``NT:/modules[0].angle``; or a number in
one of WPILib's own structs (`STRUCTS`), ``NT:/pose.x``. Entries of NetworkTables are written when they change, so a
value stays until the next one. Times are those of the records, us.

Format: https://github.com/wpilibsuite/allwpilib/blob/main/wpiutil/doc/datalog.adoc; structs: the same, struct.adoc.
"""

import itertools
import mmap
import struct
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

from castor_envs.errors import InputError, with_extra
from castor_envs.logs.recordings.recording import Clock, Reading, RecordingFormat, heading_of

STRUCTS = {
    "Pose2d": ("x", "y", "heading"),
    "Pose3d": ("x", "y", "z", "qw", "qx", "qy", "qz"),
    "Rotation2d": ("heading",),
    "Translation2d": ("x", "y"),
    "Twist2d": ("dx", "dy", "dtheta"),
    "ChassisSpeeds": ("vx", "vy", "omega"),
    "SwerveModulePosition": ("distance", "angle"),
    "SwerveModuleState": ("speed", "angle"),
    "DifferentialDriveWheelPositions": ("left", "right"),
    "DifferentialDriveWheelSpeeds": ("left", "right"),
}
"""The doubles of structs of WPILib's geometry and kinematics, in their order; m, rad, s."""

_MAGIC, _HEADER = b"WPILOG", 12
"""How a data log begins; bytes of it before a text as long as the last four say, and the records."""


def _is_wpilog(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False


class DataLog:
    """A data log; each pass over it maps the file anew."""

    kind, held, inside = "WPILib data log", True, ".["

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self.left_out: dict[str, str] = {}

    def clock(self) -> Clock:
        """Return the clock of the records."""
        return Clock()

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield readings, see `Recording`."""
        clock.takes_that_of(self._path, "a data log has one clock")
        decoders: dict[int, Callable[[Any], Iterator[tuple[str, float]]]] = {}
        for record in self._records():
            if record.isStart():
                start = record.getStartData()
                if channels is None or any(name.startswith(start.name) for name in channels):
                    decoder = _decoder(start.name, start.type)
                    if decoder is None:
                        self.left_out[start.name] = f"of type {start.type}, of which no numbers are read"
                    else:
                        decoders[start.entry] = decoder
            elif record.isFinish():
                decoders.pop(record.getFinishEntry(), None)
            elif not record.isControl() and record.getEntry() in decoders:
                time = record.getTimestamp() * 1000
                for name, value in decoders[record.getEntry()](record):
                    if channels is None or name in channels:
                        yield Reading(name, time, value)

    def _records(self) -> Iterator[Any]:
        try:
            from wpiutil.log import DataLogReader
        except ImportError:
            raise InputError(f"{self._path}: needs robotpy-wpiutil; {with_extra('wpilog')}") from None
        with self._path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            reader = DataLogReader(content, str(self._path))
            if not reader.isValid():
                raise InputError(f"{self._path}: is a damaged data log; copy it from the robot again")
            count, end = _whole_records(content)
            try:
                yield from itertools.islice(reader, count)
            finally:
                del reader  # which holds the mapped file open
            lost = f"the last {len(content) - end} of its {len(content)} bytes are no records, and left out"
            if end < len(content) and (said := f"{self._path.name}: is cut off or damaged: {lost}") not in self.notes:
                self.notes.append(said)


def _whole_records(content: mmap.mmap) -> tuple[int, int]:
    """Return how many records a data log holds before the first that its end cuts, or that is of no entry, since the
    file is damaged there; and where they end, bytes. (The reader gives the last record before a cut twice.)"""

    def number(first: int, width: int) -> int:
        return int.from_bytes(content[first : first + width], "little")

    count, at, started = 0, _HEADER + number(_HEADER - 4, 4), {0}  # 0: of what starts and ends entries
    while at < len(content):
        widths = 1 + (content[at] & 3), 1 + (content[at] >> 2 & 3), 1 + (content[at] >> 4 & 7)
        entry, data = number(at + 1, widths[0]), at + 1 + sum(widths)
        after = data + number(at + 1 + widths[0], widths[1])
        if after > len(content) or entry not in started:
            break
        if entry == 0 and number(data, 1) == 0:
            started.add(number(data + 1, 4))
        count, at = count + 1, after
    return count, at


def _decoder(name: str, kind: str) -> Callable[[Any], Iterator[tuple[str, float]]] | None:
    """Return what yields names and numbers of an entry's records; None for a type of which none are read."""
    single = {"double": "getDouble", "float": "getFloat", "int64": "getInteger", "boolean": "getBoolean"}
    if kind in single:
        return lambda record: iter([(name, float(getattr(record, single[kind])()))])
    element = kind.removesuffix("[]")
    if element in single:
        return lambda record: (
            (f"{name}[{k}]", float(value)) for k, value in enumerate(getattr(record, f"{single[element]}Array")())
        )
    parts = STRUCTS.get(element.removeprefix("struct:")) if element.startswith("struct:") else None
    if parts is None:
        return None
    size = struct.calcsize(f"<{len(parts)}d")

    def numbers(record: Any) -> Iterator[tuple[str, float]]:
        raw = bytes(record.getRaw())
        for k in range(len(raw) // size):
            place = f"{name}[{k}]" if element != kind else name
            values = struct.unpack_from(f"<{len(parts)}d", raw, k * size)
            yield from ((f"{place}.{part}", value) for part, value in zip(parts, values, strict=True))
            if element == "struct:Pose3d":
                w, x, y, z = values[3:]
                yield f"{place}.heading", heading_of(x, y, z, w)

    return numbers


FORMAT = RecordingFormat("WPILib data log (.wpilog)", _is_wpilog, DataLog)
