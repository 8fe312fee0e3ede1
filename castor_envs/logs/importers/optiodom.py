"""OptiOdom: wheel encoders of three kinds of robot against a motion capture system.

Source: R. B. Sousa, M. R. Petry, P. G. Costa, A. P. Moreira, "OptiOdom: a Generic Approach for Odometry
Calibration of Wheeled Mobile Robots", J Intell Robot Syst 105, 39 (2022); data and programs in the repository
sousarbarb/optiodom (commit 8e025fd7, MIT licence).

A session is a folder NAME with NAME_metadata.csv (a key and its values on each line) and the runs
NAME_run-01.csv, ... (no header). A run's columns are time s, true x m, y m, heading rad, then the encoder
increments of a cycle: right and left wheel of the differential robot; driven wheel, and the steering angle in rad,
of the tricycle; wheels 1 to 3 of the omni-wheel robot.

- Omni wheels stand at the distance Li from the centre: 1 right front (bearing -60 deg), 2 left front (60 deg), 3 at the
  rear. Each rolls around the centre, and increments above 0 turn the robot clockwise. This is what the authors' matrix
  says, and no other order or sense of rotation reproduces the measured path.
- The last steering angle of the tricycle's circles has two decimals (-0.24 for -0.23561945 rad).
- The first row is the start: its increments were rolled before it and are dropped, as the authors' programs do.
- In a session of squares the first half of the runs goes clockwise; `direction` reads that from the heading.
- The authors' error is truth minus odometry at the last row, both starting at the first true pose, in its frame.
- A nominal cycle of 50 ms really took about 51.2 ms, and the authors rescaled the times by hand. The log keeps the
  file's times; they carry an offset and a skew against the truth that are no property of the encoders: the
  truth of the omni-wheel run is some 0.9 s early at its start and hardly at all at its end.
- Masses, motors and contact were not published: the presets' numbers stand in for them.
"""

import dataclasses
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from castor_envs.errors import Declined, InputError, did_you_mean
from castor_envs.geometry.arrays import Array
from castor_envs.logs.importers import Importer
from castor_envs.logs.log import Log
from castor_envs.logs.reference import ReferenceNoise, TimedPoses
from castor_envs.logs.table import Line, check_width, complaint, number, numbers, read_lines
from castor_envs.vehicles.axle import AxleCorrection, with_axle
from castor_envs.vehicles.presets import differential, omni3, tricycle
from castor_envs.vehicles.robot import RobotDescription

STEERING_COUNTS = 800
"""Counts a turn of the tricycle's steering encoder: its angles are multiples of 2 pi / 800 = 0.00785 rad."""

FOLDER = "optiodom"
"""Name of the data's folder inside the folder that is given."""

REFERENCE_NOISE = ReferenceNoise(1.8e-4, 1.9e-3)
"""m and rad: the repository states none. So far third differences of the poses scatter, which of a steady motion are
noise alone (their standard deviation over the root of 20): medians of 20 runs, eight of ten of which lie within 0.16 to
0.24 mm and 1.4 to 2.5 mrad. At rest it is less than half."""

_TRUTH = ("time", "x", "y", "heading")


class _Columns(NamedTuple):
    """The columns of a run after those of the truth. wheels: those of the log's wheels, in the log's order."""

    names: tuple[str, ...]
    wheels: tuple[int, ...]
    steering: int | None = None


_COLUMNS = {
    "diff": _Columns(("right increment", "left increment"), wheels=(1, 0)),
    "tricyc": _Columns(("wheel increment", "steering angle"), wheels=(0,), steering=1),
    "omni3": _Columns(("increment 1", "increment 2", "increment 3"), wheels=(0, 1, 2)),
}


@dataclass(frozen=True, eq=False)
class Session:
    """Runs of one robot on one kind of path.

    type: "diff", "tricyc" or "omni3". robot: as the session's metadata say, before any calibration. side: of the
    square, m; None where the path is no square. directions: which way each run turned in all. tracked: the reference of
    each run at its own times, of raw data alone.
    """

    name: str
    type: str
    robot: RobotDescription
    runs: tuple[Log, ...]
    side: float | None
    directions: tuple[Literal["cw", "ccw"], ...]
    tracked: tuple[TimedPoses, ...] = ()

    @property
    def vehicle(self) -> RobotDescription:
        """The robot."""
        return self.robot


# The printed corrections are 0.20146, 0.08395, 0.08405 m and 0.20130, 0.08398, 0.08402 m (wheel base, right and left
# diameter). The last printed digit of a diameter moves the end points by 0.6 mm, so the factors are kept instead:
# those of the first session as printed; of the second the printed procedure's, to as many digits.
_PUBLISHED = {
    "230620202042": AxleCorrection(0.2, 0.084, wheel_base_factor=1.00729, diameter_ratio=0.99890),
    "230620202144": AxleCorrection(0.205, 0.084, wheel_base_factor=0.98197, diameter_ratio=0.99949),
}


def published_sessions() -> tuple[str, ...]:
    """Return the names of the sessions with a published correction."""
    return tuple(_PUBLISHED)


def published_correction(session: str) -> AxleCorrection:
    """Return the published correction of a session; raises InputError where none was published."""
    if session not in _PUBLISHED:
        raise InputError(f"no published correction of session {session!r}{did_you_mean(session, _PUBLISHED)}")
    return _PUBLISHED[session]


def find_sessions(root: str | os.PathLike[str]) -> dict[str, Path]:
    """Return the folders of all sessions below `root`/optiodom, by name, sorted.

    Raises InputError where there is no such folder, or no session in it.
    """
    place = Path(root) / FOLDER
    if not place.is_dir():
        raise InputError(f"{place}: no such folder; give the folder that holds the OptiOdom data as 'optiodom'")
    folders = sorted(path.parent for path in place.rglob("*_metadata.csv"))
    sessions = {folder.name: folder for folder in folders if _metadata_path(folder).is_file()}
    if not sessions:
        raise InputError(f"{place}: holds no session; a session NAME is a folder with a file NAME_metadata.csv")
    return dict(sorted(sessions.items()))


def read_session(folder: str | os.PathLike[str]) -> Session:
    """Read a session of the differential robot, the tricycle or the robot on three omni wheels.

    Raises InputError, with file, line and column, for anything missing or garbled; Declined for other kinds of robot.
    """
    return session_of(folder, lambda folder, kind, k, _: _read_run(folder / f"{folder.name}_run-{k:02d}.csv", kind))


def session_of(folder: str | os.PathLike[str], read_run: Callable[[Path, str, int, RobotDescription], Log]) -> Session:
    """Return a session whose runs are read by `read_run`: from a folder, of a kind of robot, by number from 1."""
    folder = Path(os.path.abspath(folder))
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of an OptiOdom session")
    metadata = _Metadata.read(_metadata_path(folder))
    kind = metadata.text("type")
    robot = _robot(kind, metadata)
    count = metadata.numbers("N", 1)[0]
    if count != int(count):
        raise metadata.complaint("N", f"{count} is not a whole number; give the number of runs")
    runs = tuple(read_run(folder, kind, k, robot) for k in range(1, int(count) + 1))
    period = float(np.median(np.concatenate([np.diff(run.t) for run in runs])))
    return Session(
        name=folder.name,
        type=kind,
        robot=dataclasses.replace(robot, sample_period=round(period, 9)),
        runs=runs,
        side=metadata.numbers("L", 1)[0] if metadata.given("L") else None,
        directions=tuple(direction(run) for run in runs),
    )


def direction(run: Log) -> Literal["cw", "ccw"]:
    """Return which way a run with a reference turned in all: "cw" where its true heading fell."""
    if run.reference is None:
        raise ValueError("the run has no reference")
    heading = run.reference[np.isfinite(run.reference[:, 2]), 2]
    return "cw" if len(heading) and heading[-1] < heading[0] else "ccw"


class _Metadata(NamedTuple):
    """The lines of a metadata file by key; values are the cells behind the key, without blank ones at the end."""

    path: Path
    lines: dict[str, Line]

    @classmethod
    def read(cls, path: Path) -> "_Metadata":
        lines = {}
        for line in read_lines(path):
            key, *values = (cell.strip() for cell in line.cells)
            while values and not values[-1]:
                values.pop()
            lines[key] = Line(line.number, values)
        return cls(path, lines)

    def complaint(self, key: str, message: str) -> InputError:
        return complaint(self.path, self.lines[key].number, key, message)

    def given(self, key: str) -> bool:
        return key in self.lines and bool(self.lines[key].cells)

    def text(self, key: str) -> str:
        if not self.given(key):
            raise complaint(self.path, None, key, "is missing or blank; give its value")
        return self.lines[key].cells[0]

    def numbers(self, key: str, count: int, positive: bool = True) -> list[float]:
        """Return the first `count` values of a key, all above 0 unless `positive` is False."""
        self.text(key)
        line = self.lines[key]
        if len(line.cells) < count:
            raise self.complaint(key, f"has {len(line.cells)} values; give {count}")
        values = [number(self.path, line.number, key, cell) for cell in line.cells[:count]]
        if positive and min(values) <= 0:
            raise self.complaint(key, f"{min(values)} is not above 0; give the true value")
        return values


def _metadata_path(folder: Path) -> Path:
    return folder / f"{folder.name}_metadata.csv"


def _robot(kind: str, metadata: _Metadata) -> RobotDescription:
    """Return the nominal robot that the metadata describe."""
    if kind not in _COLUMNS:
        *kinds, last = _COLUMNS
        known = f"{', '.join(kinds)} or {last}"
        raise Declined(str(metadata.complaint("type", f"{kind!r} cannot be read; choose a session of {known}")))
    (gear,), (resolution,) = metadata.numbers("ngear", 1), metadata.numbers("encRes", 1)
    counts = gear * resolution
    (base,) = metadata.numbers("Li", 1)
    if kind == "diff":
        robot = dataclasses.replace(differential(counts_per_rev=counts), name="OptiOdom differential drive")
        return with_axle(robot, base, *metadata.numbers("Di", 2))
    if kind == "omni3":
        first, second, third = (diameter / 2 for diameter in metadata.numbers("Di", 3))
        return dataclasses.replace(omni3(base, (first, second, third), counts), name="OptiOdom omni-wheel robot")
    offset = metadata.numbers("Thi", 1, positive=False)[0] if metadata.given("Thi") else 0.0
    (diameter,) = metadata.numbers("Di", 1)
    robot = tricycle()
    front, rear = robot.castors
    wheel = dataclasses.replace(front.wheels[0], radius=diameter / 2, counts_per_rev=counts)
    front = dataclasses.replace(
        front,
        pivot=(base, 0.0),
        wheels=(wheel,),
        pivot_counts_per_rev=STEERING_COUNTS,
        pivot_zero=-offset,
    )
    return dataclasses.replace(robot, name="OptiOdom tricycle", castors=(front, rear))


def _read_run(path: Path, kind: str) -> Log:
    """Read one run; the log's columns are those of the robot of its session."""
    truth, wheel, pivot = read_rows(path, kind, _TRUTH)
    return Log(
        t=truth[:, 0],
        wheel=wheel,
        pivot=pivot,
        reference=np.column_stack([truth[:, 1:3], np.unwrap(truth[:, 3])]),
    )


def read_rows(path: Path, kind: str, first: tuple[str, ...]) -> tuple[Array, Array, Array]:
    """Return the columns of a file (K, n) that have the names `first`, "time" before all, then cumulative counts of
    wheels (K, d) and of the steering (K, s) of this kind of robot."""
    columns = _COLUMNS[kind]
    names = (*first, *columns.names)
    lines = read_lines(path)
    if len(lines) < 2:
        raise complaint(path, None, None, f"a run needs at least 2 rows, not {len(lines)}")
    for line in lines:
        check_width(path, line, len(names), "columns of a run")
    rows = numbers(path, lines, {name: k for k, name in enumerate(names)})
    for k in np.flatnonzero(np.diff(rows[:, 0]) <= 0)[:1]:
        message = f"{float(rows[k + 1, 0])!r} does not come after {float(rows[k, 0])!r}; times must increase"
        raise complaint(path, lines[k + 1].number, "time", message)
    truth, odometry = np.split(rows, [len(first)], axis=1)
    rolled = odometry[:, columns.wheels]
    rolled[0] = 0.0
    pivot = np.empty((len(rows), 0))
    if columns.steering is not None:
        pivot = odometry[:, [columns.steering]] * (STEERING_COUNTS / (2 * math.pi))
        doubt = 0.01 + np.array([[_rounding(line.cells[names.index("steering angle")])] for line in lines])
        for k in np.flatnonzero(np.abs(pivot - np.round(pivot)) > doubt)[:1]:
            angle = odometry[k, columns.steering]
            message = f"{angle} rad is not a multiple of 2 pi / {STEERING_COUNTS}; give the angle in radians"
            raise complaint(path, lines[k].number, columns.names[columns.steering], message)
    return truth, np.cumsum(rolled, axis=0), np.round(pivot)


def _rounding(angle: str) -> float:
    """Return by how many counts an angle, as it is written, may have been rounded: half of its last decimal."""
    decimals = len(angle.partition(".")[2])
    return 10.0**-decimals / 2 * STEERING_COUNTS / (2 * math.pi) if decimals else 0.0


IMPORTER = Importer(
    name="optiodom",
    recognises=lambda folder: (folder / FOLDER).is_dir(),
    find=find_sessions,
    read=read_session,
    reference_noise=REFERENCE_NOISE,
)
