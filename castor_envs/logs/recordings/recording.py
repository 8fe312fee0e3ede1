"""What a recording of a real robot is to the importer: channels of numbers, each reading with its own time."""

import math
from array import array
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from castor_envs.errors import InputError

TimeUnit = Literal["s", "ms", "us", "ns", "min", "h", "d"]
UNITS: dict[TimeUnit, float] = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "min": 60e9, "h": 3600e9, "d": 86_400e9}
"""ns in units of time."""


class Reading(NamedTuple):
    """One number: the channel it belongs to, when it was taken (ns), and its value, NaN where there was none.

    stamped: False where a survey shows a time of another clock than asked for, since the reading has none by that.
    """

    channel: str
    time: int
    value: float
    stamped: bool = True


@dataclass(frozen=True)
class Clock:
    """By which clock readings have their times.

    time: "header" or "receive" of ROS messages, a CSV file's column, the file of times of KITTI text; None takes what
    the format has. unit: of numbers of time. period: s, of rows without times.
    """

    time: str | None = None
    unit: TimeUnit = "s"
    period: float | None = None

    @property
    def unnamed(self) -> bool:
        """Whether it is left to the recording."""
        return self.time is None and self.period is None

    def takes_that_of(self, path: Path, why: str) -> None:
        """Raise InputError if the map names another clock than the only one of a recording; why: what that is."""
        if not self.unnamed:
            raise InputError(f"{path}: {why}; remove 'time' and 'period' of it from the map")


class Recording(Protocol):
    """An opened recording.

    kind: what it is, for people. held: whether a value is written only where it changes, and stays until the next.
    inside: the characters of which one stands between what is left out and its numbers, as between topic and field.
    notes: what is to be said of what was read so far. left_out: once all channels were read, what is none of them, or
    not wholly, and why.
    """

    kind: str
    held: bool
    inside: str
    notes: list[str]
    left_out: dict[str, str]

    def clock(self) -> Clock:
        """Return the clock that a map takes at first; of rows without times a period, to be edited."""
        ...

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield the readings of some channels, or of all, in the file's order; one is held in memory at a time.

        Raises InputError for what cannot be read, and for a clock that the recording does not have.
        """
        ...


@dataclass(frozen=True)
class RecordingFormat:
    """A kind of file or folder. recognises: whether a path is one, judged by names and first bytes. open: opens it."""

    name: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path], Recording]


@dataclass
class Series:
    """The readings of a channel: times, ns, and values; and how many of them were no finite numbers, left out.

    held: whether a value stays until the next. stamped: whether times are those of stamps in messages, which may come
    out of order.
    """

    held: bool
    stamped: bool = False
    time: array = field(default_factory=lambda: array("q"))
    value: array = field(default_factory=lambda: array("d"))
    missing: int = 0

    def add(self, reading: Reading) -> None:
        """Take a reading."""
        if math.isfinite(reading.value):
            self.time.append(reading.time)
            self.value.append(reading.value)
        else:
            self.missing += 1

    def shifted(self, by: int) -> "Series":
        """Return the readings with a time, ns, added to theirs."""
        return replace(self, time=array("q", (time + by for time in self.time))) if by else self


@dataclass
class Found:
    """What a channel holds: how many readings, from when to when (ns), of which values, only whole ones or not.

    stamped: whether all readings have a time by the clock that was asked for.
    """

    count: int = 0
    start: int = 0
    end: int = 0
    low: float = math.inf
    high: float = -math.inf
    whole: bool = True
    stamped: bool = True

    def add(self, reading: Reading) -> None:
        """Take a reading."""
        _, time, value, stamped = reading
        if not math.isfinite(value):
            return
        if time < self.start or not self.count:
            self.start = time
        if time > self.end or not self.count:
            self.end = time
        self.count += 1
        if value < self.low:
            self.low = value
        if value > self.high:
            self.high = value
        self.whole = self.whole and value.is_integer()
        self.stamped = self.stamped and stamped

    @property
    def rate(self) -> float:
        """Readings a second, 0 where there are too few to say."""
        return (self.count - 1) / (self.end - self.start) * 1e9 if self.end > self.start else 0.0


def survey(recording: Recording, clock: Clock) -> dict[str, Found]:
    """Read a recording once; return what each channel holds. Memory is bounded by the number of channels.

    Channels without a finite number are added to what the recording leaves out.
    """
    found: dict[str, Found] = {}
    for reading in recording.readings(None, clock):
        if reading.channel not in found:
            found[reading.channel] = Found()
        found[reading.channel].add(reading)
    recording.left_out |= {name: "no finite number" for name, channel in found.items() if not channel.count}
    return {name: channel for name, channel in found.items() if channel.count}


def nanoseconds(value: float, unit: TimeUnit, where: str) -> int:
    """Return a time as ns; raises InputError for one that is not finite or beyond 64 bits."""
    time = value * UNITS[unit]
    if not abs(time) < 2**63:
        raise InputError(f"{where}: {value:g} {unit} is no time; mend it, or the unit in the map")
    return round(time)


def heading_of(x: float, y: float, z: float, w: float) -> float:
    """Return the rotation about z of a quaternion, rad: the direction of its x axis; NaN for one of all zeros."""
    if not x * x + y * y + z * z + w * w > 0:
        return math.nan
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
