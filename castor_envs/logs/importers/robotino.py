"""Robotino: wheel encoders of a robot on three omni wheels that slips on several floors, under a camera.

Source: the repository BrOleg5/research-wheel-slippage (commit b4303b4, Apache-2.0), the data of experiments in which a
Festo Robotino drives straight in 72 directions, or 12, without turning, over one floor or from one onto another.

A session is a folder of runs exp00.csv, exp01.csv, ...: three lines of heading (titles, units, names), then rows
of which these columns, separated by semicolons, are read:

    t                     ms
    m1pos, m2pos, m3pos   ticks of the motors' encoders, cumulative
    xpos, ypos            pixels of the camera's image, x to the right and y down
    ang                   deg, counter-clockwise as seen in the image, wrapped

- `config/camera_params.json` of the repository: a pixel is 1.840 by 1.837 mm. The body's x axis points to
  (-sin ang, -cos ang) in the image (`process_one_surface_type_dataset.m`), so its heading is ang + 90 deg once y points
  up.
- `get_robot_parameters.m`: wheels of radius 40 mm at 125 mm from the centre, gears of 16. Bearings 60, 180 and 300 deg,
  each wheel rolling counter-clockwise around the centre (`OmniThreeWheeledRobotKinematics.m`).
- 2000 ticks a motor turn is not written there: the columns of speed and position agree on it within 1 %.
- The camera sees the robot some 30 to 60 ms after its wheels; times are kept as they are.
- Masses, motors and contact were not published: the preset's numbers stand in for them.
"""

import dataclasses
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from castor_envs.errors import InputError
from castor_envs.logs.importers import Importer
from castor_envs.logs.log import Log
from castor_envs.logs.reference import ReferenceNoise, TimedPoses
from castor_envs.logs.table import Line, complaint, number, read_lines
from castor_envs.vehicles.presets import omni3
from castor_envs.vehicles.robot import RobotDescription

FOLDER = "robotino"
"""Name of the data's folder inside the folder that is given."""

PIXEL = (1.8404619693756104e-3, 1.8371639251708984e-3)
"""m: width and height of a pixel on the floor."""

RADIUS, DISTANCE, COUNTS = 0.040, 0.125, 16.0 * 2000
"""m, m: of the wheels, and from the centre to them; counts a wheel turn."""

BEARINGS = (math.pi / 3, math.pi, 5 * math.pi / 3)
"""rad: where the wheels are, as seen from the centre."""

REFERENCE_NOISE = ReferenceNoise(4e-4, 4.5e-3)
"""m and rad: the repository states none. So far third differences of the poses scatter (see `optiodom`): positions and
angles come in steps of an eighth of a pixel or more and of 0.2 deg."""

_COLUMNS = ("t", "m1pos", "m2pos", "m3pos", "xpos", "ypos", "ang")
_HEADING = 3


@dataclass(frozen=True, eq=False)
class Session:
    """Runs on one floor, or across two, by the name of their folder."""

    name: str
    vehicle: RobotDescription
    runs: tuple[Log, ...]
    tracked: tuple[TimedPoses, ...] = ()


def robotino(sample_period: float) -> RobotDescription:
    """Return the robot as its users describe it."""
    robot = omni3(DISTANCE, (RADIUS, RADIUS, RADIUS), COUNTS)
    castors = tuple(
        dataclasses.replace(
            castor,
            pivot=(DISTANCE * math.cos(bearing), DISTANCE * math.sin(bearing)),
            angle=bearing + math.pi / 2,
        )
        for castor, bearing in zip(robot.castors, BEARINGS, strict=True)
    )
    return dataclasses.replace(robot, name="Festo Robotino", sample_period=sample_period, castors=castors)


def find_sessions(root: str | os.PathLike[str]) -> dict[str, Path]:
    """Return the folders of runs below `root`/robotino by name, sorted; of two alike the one deeper in other folders
    has theirs in its name.

    Raises InputError where there is no such folder, or no run in it.
    """
    place = Path(root) / FOLDER
    if not place.is_dir():
        raise InputError(f"{place}: no such folder; give the folder that holds the Robotino data as '{FOLDER}'")
    folders = sorted({path.parent for path in place.rglob("exp*.csv")}, key=lambda path: path.as_posix())
    if not folders:
        raise InputError(f"{place}: holds no session; a session is a folder with runs exp00.csv, exp01.csv, ...")
    sessions: dict[str, Path] = {}
    for folder in folders:
        short = folder.name.removesuffix("_surface")
        sessions[f"{folder.parent.name}-{short}" if short in sessions else short] = folder
    return dict(sorted(sessions.items()))


def read_session(folder: str | os.PathLike[str]) -> Session:
    """Read the runs of a folder; raises InputError, with file, line and column, for anything missing or garbled."""
    folder = Path(os.path.abspath(folder))
    paths = sorted(folder.glob("exp*.csv"), key=lambda path: (len(path.name), path.name))
    if not paths:
        raise InputError(f"{folder}: holds no run; give a folder with exp00.csv, exp01.csv, ...")
    runs = tuple(_read_run(path) for path in paths)
    period = float(np.median(np.concatenate([np.diff(run.t) for run in runs])))
    return Session(folder.name, robotino(round(period, 6)), runs)


def _read_run(path: Path) -> Log:
    lines = read_lines(path, ";")
    if len(lines) < _HEADING + 2:
        raise complaint(path, None, None, f"a run needs {_HEADING} lines of heading and 2 rows, not {len(lines)} lines")
    places = _places(path, lines[_HEADING - 1])
    rows = []
    for line in lines[_HEADING:]:
        if len(line.cells) <= max(places):
            raise complaint(path, line.number, None, f"has {len(line.cells)} cells; give all columns of the heading")
        row = [number(path, line.number, name, line.cells[k]) for name, k in zip(_COLUMNS, places, strict=True)]
        if rows and row[0] <= rows[-1][0]:
            raise complaint(path, line.number, "t", f"{row[0]!r} does not come after {rows[-1][0]!r}; times increase")
        rows.append(row)
    t, *counts, x, y, angle = np.array(rows).T
    poses = np.column_stack([x * PIXEL[0], -y * PIXEL[1], np.unwrap(np.radians(angle)) + math.pi / 2])
    return Log(t=t / 1e3, wheel=np.column_stack(counts), pivot=np.empty((len(rows), 0)), reference=poses)


def _places(path: Path, names: Line) -> list[int]:
    found = [cell.strip() for cell in names.cells]
    absent = [name for name in _COLUMNS if name not in found]
    if absent:
        raise complaint(path, names.number, absent[0], "is missing from the names of columns, the third line")
    return [found.index(name) for name in _COLUMNS]


IMPORTER = Importer(
    name="robotino",
    recognises=lambda folder: (folder / FOLDER).is_dir(),
    find=find_sessions,
    read=read_session,
    reference_noise=REFERENCE_NOISE,
)
