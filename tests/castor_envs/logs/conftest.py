"""Recordings of a known motion, as their formats' own libraries, or published descriptions, write them."""

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TF = "geometry_msgs/TransformStamped[] transforms"


class BagWriter:
    """Writes messages into a bag: "mcap", "sqlite3" or "ros1"."""

    def __init__(self, path: Path, kind: str) -> None:
        self.ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.store.register(get_types_from_msg(TF, "tf2_msgs/msg/TFMessage"))
        self.bag: Any = (
            Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
        )
        self.connections: dict[str, Any] = {}

    def __enter__(self) -> "BagWriter":
        self.bag.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.bag.close()

    def make(self, kind: str, *parts: Any) -> Any:
        return self.store.types[kind.replace("/", "/msg/")](*parts)

    def header(self, t: float, frame: str = "") -> Any:
        ns = round(t * 1e9)
        stamp = self.make("builtin_interfaces/Time", ns // 10**9, ns % 10**9)
        return self.make("std_msgs/Header", *((0,) if self.ros1 else ()), stamp, frame)

    def put(self, topic: str, kind: str, received: float, *parts: Any) -> None:
        kind = kind.replace("/", "/msg/")
        if topic not in self.connections:
            self.connections[topic] = self.bag.add_connection(topic, kind, typestore=self.store)
        write = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.bag.write(self.connections[topic], round(received * 1e9), write(self.store.types[kind](*parts), kind))

    def quaternion(self, psi: float) -> Any:
        return self.make("geometry_msgs/Quaternion", 0.0, 0.0, np.sin(psi / 2), np.cos(psi / 2))

    def pose(self, x: float, y: float, psi: float) -> Any:
        return self.make("geometry_msgs/Pose", self.make("geometry_msgs/Point", x, y, 0.0), self.quaternion(psi))

    def joints(self, topic: str, received: float, stamp: float, **angles: float) -> None:
        values = np.array(list(angles.values()))
        self.put(
            topic,
            "sensor_msgs/JointState",
            received,
            self.header(stamp),
            list(angles),
            values,
            values * 0,
            np.array([]),
        )


def wpilog(entries: Sequence[tuple[str, str]], records: Iterable[tuple[int, int, bytes]]) -> bytes:
    """Return a data log with entries (name, type), and records: the entry's place from 0, us, payload.

    As https://github.com/wpilibsuite/allwpilib/blob/main/wpiutil/doc/datalog.adoc describes version 1.0.
    """

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value.encode())) + value.encode()

    def record(entry: int, time: int, payload: bytes) -> bytes:
        # A byte of lengths: of the entry in 1, of the payload's size in 4, of the time in 8 bytes.
        return struct.pack("<BBIQ", 0 | 3 << 2 | 7 << 4, entry, len(payload), time) + payload

    content = b"WPILOG" + struct.pack("<HI", 0x0100, 0)
    for k, (name, kind) in enumerate(entries, start=1):
        content += record(0, 0, struct.pack("<BI", 0, k) + text(name) + text(kind) + text(""))
    return content + b"".join(record(place + 1, time, payload) for place, time, payload in records)


@pytest.fixture
def bag_writer():
    return BagWriter


@pytest.fixture
def write_wpilog():
    return wpilog
