"""A map: which channel of a recording is which column of a log, in which unit, and by which clock; a JSON file."""

import os
from dataclasses import field
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from castor_envs import description
from castor_envs.description import CONFIG
from castor_envs.errors import InputError, did_you_mean
from castor_envs.logs.columns import HEADINGS, LogColumns
from castor_envs.logs.mapping.units import units_of
from castor_envs.logs.recordings.recording import Clock, TimeUnit
from castor_envs.vehicles.robot import RobotDescription

FORMAT = "castor-map/1"
UNDECIDED = "?"
"""The channel of a column for which no channel was guessed, and the period of rows without times."""

LONGEST_PERIOD = 1e6
"""s, between rows: some twelve days."""

_Text = Annotated[str, Field(min_length=1)]
_Period = Annotated[float, Field(gt=0, le=LONGEST_PERIOD)]


def _unless(default: Any) -> Any:
    """Return the field that a map's file leaves out where it is the default."""
    return Field(default=default, exclude_if=lambda value: value == default)


def _one_or_four(given: Any) -> Any:
    """Return what is given as a channel; raises ValueError, in words of the file, for what is neither one nor four."""
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) and name for name in names):
        raise ValueError("Input should be a channel's name, or four of them")
    if len(names) not in (1, 4) or (len(names) == 1 and names is given):
        raise ValueError(f"Input should be one name as text, or four (x, y, z, w) in a list, and has {len(names)}")
    return given if isinstance(given, str) else tuple(given)


def _period(given: Any) -> Any:
    """Return what is given as a period; raises ValueError, in words of the file, for what is none and not
    `UNDECIDED`."""
    if given in (None, UNDECIDED) or (type(given) in (int, float) and 0 < given <= LONGEST_PERIOD):
        return given
    raise ValueError(f"Input should be more than 0 and at most {LONGEST_PERIOD:g} s, or {UNDECIDED!r} in a first map")


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Source:
    """Where readings come from.

    file: a recording, as seen from the folder of the one that is imported, None for that one itself. time: by which
    clock: "header" or "receive" of ROS messages, a CSV file's column of times (or two, as in "sec + nanosec" and in
    "date + time"), a file of times for KITTI text. unit: of such a column or file;
    left out it is s, or what the recording says where `time` is left out too. period: s, between rows without
    times, "?" in a first map. offset: s, added to all times, so that clocks of two computers agree.
    """

    file: _Text | None = _unless(None)
    time: _Text | None = _unless(None)
    unit: TimeUnit | None = _unless(None)
    period: Annotated[_Period | Literal["?"] | None, BeforeValidator(_period)] = _unless(None)
    offset: Annotated[float, Field(ge=-1e10, le=1e10)] = 0.0

    @property
    def clock(self) -> Clock:
        """The clock of the readings, before the offset."""
        return Clock(self.time, self.unit or "s", None if self.period == UNDECIDED else self.period)

    @classmethod
    def of(cls, clock: Clock, file: str | None = None) -> "Source":
        """Return the source with a clock; a period is for people to give."""
        unit, period = None if clock.unit == "s" else clock.unit, None if clock.period is None else UNDECIDED
        return cls(file=file, time=clock.time, unit=unit, period=period)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Column:
    """What a column of the log is made from.

    channel: by the name that the survey of the recording shows; of the unit "quaternion" four: x, y, z, w. unit: of the
    channel's numbers, see `castor_envs.logs.mapping.units`. sign: -1 where the channel counts the other way. scale:
    what numbers are multiplied by. wraps_at: where a counter begins at 0 again, in its unit. source: by name.
    """

    channel: Annotated[_Text | tuple[_Text, _Text, _Text, _Text], BeforeValidator(_one_or_four)]
    unit: _Text
    sign: Literal[1, -1] = 1
    scale: Annotated[float, Field(gt=0, le=1e12)] = _unless(1.0)
    wraps_at: Annotated[float, Field(gt=0, le=2.0**64)] | None = _unless(None)
    source: _Text = _unless("main")

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels, one or four."""
        return (self.channel,) if isinstance(self.channel, str) else self.channel


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ChannelMap:
    """A map as its file holds it: which channel of a recording is which column of a log.

    sources: by name, where readings come from; "main" is the recording that is imported, and need not be there.
    columns: by the log's column, such as `wheel_1l`, `pivot_1`, `cmd_1l`, `gyro_z` and `ref_x`, what it is made from;
    of positions without headings `ref_psi` and `fix_psi` are left out.
    """

    sources: dict[str, Source] = field(default_factory=lambda: {"main": Source()})
    columns: dict[str, Column]

    @property
    def places(self) -> dict[str, Source]:
        """The sources by name, "main" among them."""
        return {"main": Source()} | self.sources

    def to_dict(self) -> dict[str, Any]:
        """Return the map as plain data, ``format`` first."""
        return description.to_data(ADAPTER, self, FORMAT)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map as JSON; the file is complete or not there."""
        description.save(path, self.to_dict())

    @classmethod
    def from_dict(cls, data: Any, source: str = "map") -> "ChannelMap":
        """Read a map from plain data; raises InputError that names `source` and the offending keys."""
        return description.from_data(ADAPTER, data, FORMAT, source)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "ChannelMap":
        """Read a map from a JSON file; raises InputError that names file and key."""
        return description.load(ADAPTER, path, FORMAT)

    def check(self, robot: RobotDescription, name: str = "map") -> None:
        """Raise InputError, which calls the map `name`, unless it says what the robot's log needs, in fitting units."""
        columns = LogColumns.of(robot)
        for key, source in self.sources.items():
            if source.period == UNDECIDED:
                still = f"is still {UNDECIDED!r}; give the time between rows, s, or in its place a column as 'time'"
                raise InputError(f"{name}: sources.{key}.period: {still}")
        for key, column in self.columns.items():
            place = f"{name}: columns.{key}"
            made = {*columns.t, *columns.fix_age}  # from the times of readings
            if key in made or key not in columns.known:
                known = did_you_mean(key, columns.known - made)
                problem = f"is no column of {robot.name!r}; give the robot that was recorded, or another column{known}"
                raise InputError(f"{place}: {problem}")
            if column.source not in self.places:
                problem = f"unknown source {column.source!r}{did_you_mean(column.source, self.places)}"
                raise InputError(f"{place}.source: {problem}")
            if UNDECIDED in column.channels:
                raise InputError(f"{place}.channel: is still {UNDECIDED!r}; give a channel, or remove the column")
            part = next(part for part, names in columns._asdict().items() if key in names)
            known = units_of(part, key)
            if column.unit not in known:
                raise InputError(f"{place}.unit: {column.unit!r} does not fit {key}; give one of {', '.join(known)}")
            if (column.unit == "quaternion") != (len(column.channels) == 4):
                raise InputError(f"{place}.channel: give one, or four (x, y, z, w) with the unit 'quaternion'")
        self._check_own_channels(columns, name)
        for part, names in columns._asdict().items():
            needed = part in ("wheel", "pivot") or any(key in self.columns for key in names)
            for key in names if needed and part not in ("t", "fix_age") else ():
                if key not in (*HEADINGS, *self.columns):
                    raise InputError(f"{name}: columns.{key}: is missing; add it{self._why(part)}")

    def _check_own_channels(self, columns: LogColumns, name: str) -> None:
        """Raise InputError where two encoders, or two coordinates of a pose, are given one channel."""
        for names in ((*columns.wheel, *columns.pivot), columns.reference, columns.fix):
            of: dict[tuple[str, str], str] = {}
            for key in names:
                for channel in self.columns[key].channels if key in self.columns else ():
                    other = of.setdefault((self.columns[key].source, channel), key)
                    if other != key:
                        problem = f"{channel!r} is that of {other} too; each has a channel of its own"
                        raise InputError(f"{name}: columns.{key}.channel: {problem}")

    @staticmethod
    def _why(part: str) -> str:
        if part == "wheel":
            return ', or make the wheel idle in the robot file ("counts_per_rev": null)'
        if part == "pivot":
            return ', or leave the encoder out of the robot file ("pivot_counts_per_rev": null)'
        return ", or remove the others of its kind"


ADAPTER = TypeAdapter(ChannelMap)
