"""ROS 2 bags (MCAP and sqlite) and ROS 1 bags, by the library rosbags.

A channel is a topic and a number in its messages, such as ``/imu angular_velocity.z``:

- of a message with a list of names, such as JointState: ``/joint_states position[left_wheel]``, in whatever order each
  message has them; where names repeat or are blank, by the place: ``position[0]``
- of a pose or a transform: ``.x``, ``.y`` and ``.heading``, its angle about z (rad), as in ``/odom pose.pose.heading``
- of transforms: ``/tf odom>base_link.x``, each between the two frames that a message names; chains are not composed
- of short arrays: ``/ticks data[0]``; covariances and arrays of more than `MOST` numbers are left out

Times are by the message's header ("header"; of a transform its own), or when the bag received the message ("receive").
"""

import dataclasses
import itertools
import re
from collections.abc import Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.errors import InputError, message_of, with_extra
from castor_envs.logs.recordings.recording import Clock, Reading, RecordingFormat, heading_of

CLOCKS = ("header", "receive")
"""Names of the clocks of a bag."""

MOST = 32
"""Numbers of an array: drives with more wheels are not known, images and scans have more."""

NAMES = ("name", "joint_names", "interface_names")
"""Fields of messages with the names of the entries of their arrays."""

OVERLAP = 10**9
"""ns by which parts of one bag may overlap: a recorder's threads write messages a little out of order."""

_SUFFIXES = (".bag", ".mcap", ".db3")
_MENDED_BY = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "ros2 bag reindex"}
"""What mends a file that a recorder did not close."""

METADATA = "metadata.yaml"
_OF_METADATA = re.compile("metadata|files are missing", re.IGNORECASE)
"""What says in an error of rosbags that a bag's metadata are at fault, and not its files."""


def _is_bag(path: Path) -> bool:
    return path.suffix in _SUFFIXES if path.is_file() else bool(_bags(path))


def _bags(path: Path) -> list[Path]:
    """Return what rosbags opens: the folder of a ROS 2 bag, one file, or the files of a ROS 1 bag in pieces."""
    if path.is_file() or (path / METADATA).is_file():
        return [path]
    for suffix in _SUFFIXES:
        found = sorted(path.glob(f"*{suffix}"))
        if found:
            return found
    return []


class Bag:
    """A bag of either ROS; each pass over it opens it anew."""

    kind, held, inside = "ROS bag", False, " "

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self.left_out: dict[str, str] = {}

    def clock(self) -> Clock:
        """Return the header's clock, or where no message and no transform has one when they were received."""
        first = itertools.islice(self._messages(None), 1000)
        stamped = any(time for _, _, message in first for time, _, _ in _stamped_numbers(message))
        return Clock("header" if stamped else "receive")

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield readings, see `Recording`."""
        if clock.time not in CLOCKS:
            raise InputError(f'{self._path}: has no clock {clock.time!r}; give "time": "header" or "receive"')
        topics = None if channels is None else {name.split(" ", 1)[0] for name in channels}
        silent: dict[str, str] = {}
        for topic, received, message in self._messages(topics, silent):
            for time, path, value in _stamped_numbers(message):
                name = f"{topic} {path}"
                silent.pop(topic, None)
                if channels is not None and name not in channels:
                    continue
                stamped = clock.time == "receive" or time != 0
                if not stamped and channels is not None:
                    raise InputError(
                        f"{self._path}: {topic} has messages without a time in their header; give these channels a "
                        'source of their own with "time": "receive"'
                    )
                yield Reading(name, time if stamped and clock.time == "header" else received, value, stamped)
        if channels is None:
            self.left_out = silent

    def _messages(
        self, topics: set[str] | None, silent: dict[str, str] | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, time of receipt (ns) and message; of types that the bag does not describe, none.

        silent: gets for each topic why it may give no number.
        """
        try:
            from rosbags.highlevel import AnyReader, AnyReaderError
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise InputError(f"{self._path}: needs rosbags; {with_extra('ros')}") from None
        try:
            with AnyReader(_bags(self._path), default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
                _check_parts(self._path, reader.readers)
                known = [
                    connection
                    for connection in reader.connections
                    if connection.msgtype in reader.typestore.types and (topics is None or connection.topic in topics)
                ]
                if silent is not None:
                    silent |= {c.topic: _why_silent(c, c in known) for c in reader.connections}
                for connection, received, raw in reader.messages(known) if known else ():
                    yield connection.topic, received, reader.deserialize(raw, connection.msgtype)
        except (AnyReaderError, OSError, ValueError, AssertionError) as error:
            if isinstance(error, InputError):
                raise
            kinds = {
                path.suffix: path for path in (*_bags(self._path), *self._path.glob("*")) if path.suffix in _MENDED_BY
            }
            mended = " or ".join(f"{_MENDED_BY[kind]!r}" for kind in sorted(kinds))
            remedy = f"one that was cut off may be mended by {mended}"
            if _OF_METADATA.search(message_of(error)):
                remedy = f"{METADATA} does not fit: remove it, and the files in the folder are read without it"
            raise InputError(f"{self._path}: cannot be read as a ROS bag ({message_of(error)}); {remedy}") from None


def _why_silent(connection: Any, known: bool) -> str:
    """Return why a topic gives no number; known: whether its type is."""
    if not known:
        return (
            f"messages of type {connection.msgtype}, which the bag does not define; convert it to MCAP where the type "
            "is installed"
        )
    return f"no message with numbers, or arrays of more than {MOST}"


def _check_parts(path: Path, parts: Sequence[Any]) -> None:
    """Raise InputError where files in a folder are not one bag in pieces: one topic is in two at the same time."""
    for k, part in enumerate(parts):
        for other in parts[:k]:
            common = min(part.end_time, other.end_time) - max(part.start_time, other.start_time)
            topics = {c.topic for c in part.connections} & {c.topic for c in other.connections}
            if common > OVERLAP and topics:
                raise InputError(
                    f"{path}: {other.path.name} and {part.path.name} overlap by {common / 1e9:.3g} s, in both of which "
                    f"is {min(topics)}: they are no pieces of one bag; name one of them"
                )


def _stamp(message: Any) -> int:
    """Return the time of a message's header, ns; 0 where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec


def _stamped_numbers(message: Any) -> Iterator[tuple[int, str, float]]:
    """Yield the time (ns, 0 where there is none), the path and the value of each number in a message."""
    transforms = [message, *getattr(message, "transforms", ())]
    if stamped := [each for each in transforms if hasattr(each, "child_frame_id") and hasattr(each, "transform")]:
        for transform in stamped:
            frames = f"{transform.header.frame_id.lstrip('/')}>{transform.child_frame_id.lstrip('/')}"
            for path, value in _numbers(frames, transform.transform):
                yield _stamp(transform), path, value
        return
    time, names = _stamp(message), _names_in(message)
    for field in _fields(message):
        for path, value in _numbers(field, getattr(message, field), names):
            yield time, path, value


def _fields(message: Any) -> Iterable[str]:
    """Return the fields of a message that may hold numbers of a channel."""
    names = (field.name for field in dataclasses.fields(message))
    return (name for name in names if name not in ("header", *NAMES) and not name.startswith("__"))


def _names_in(message: Any) -> Sequence[str]:
    """Return the names that a message has for the entries of its arrays, none if they are no distinct words."""
    lists = (getattr(message, field, None) for field in NAMES)
    return next((names for names in lists if isinstance(names, list) and _are_distinct(names)), ())


def _are_distinct(names: list[Any]) -> bool:
    words = {name for name in names if isinstance(name, str) and name}
    return bool(names) and len(words) == len(names)


def _numbers(path: str, value: Any, names: Sequence[str] = ()) -> Iterator[tuple[str, float]]:
    """Yield the numbers below a field; names: of the entries of its arrays, where the message has some."""
    if isinstance(value, bool | int | float | np.number):
        yield path, float(value)
    elif isinstance(value, np.ndarray | list | tuple):
        if len(value) > MOST or path.endswith("covariance"):
            return
        labels = names if len(names) == len(value) else range(len(value))
        for label, entry in zip(labels, value, strict=True):
            yield from _numbers(f"{path}[{label}]", entry, names)
    elif dataclasses.is_dataclass(value):
        for place, angle in (("position", "orientation"), ("translation", "rotation")):
            if hasattr(value, place) and hasattr(value, angle):
                yield f"{path}.x", float(getattr(value, place).x)
                yield f"{path}.y", float(getattr(value, place).y)
                yield f"{path}.heading", _heading(getattr(value, angle))
                return
        if all(hasattr(value, part) for part in "xyzw"):
            yield f"{path}.heading", _heading(value)
            return
        inner = _names_in(value) or names
        for field in _fields(value):
            yield from _numbers(f"{path}.{field}", getattr(value, field), inner)


def _heading(q: Any) -> float:
    return heading_of(float(q.x), float(q.y), float(q.z), float(q.w))


FORMAT = RecordingFormat("ROS bag (.mcap, .db3, .bag, or a folder of them)", _is_bag, Bag)
