"""OptiOdom before synchronisation: odometry by its own clock, and the tracker's file as its program wrote it.

Source: as of `optiodom`, whose robots these are. Beside its synchronised runs the public repository has of each run

    NAME_run-01_odo.csv    time s by the robot's own clock, then the increments of a cycle as in `optiodom`, but left
                           wheel before right, and those of omni wheels with the other sign (so they are those of the
                           synchronised files, in all 253 runs); no header
    NAME_run-01_opti.csv   what OptiTrack's Motive exports, 100 poses a second: seven lines of header, then frame, time
                           s, rotation about Y, X and Z (deg), position X, Y and Z (m), blank where it lost the robot

- The floor is the tracker's Z-X plane: x = Z, y = X, and the heading is the rotation about Y
  (`processOptiTrackData.m`). The tracked body is the set of markers: it stands anywhere on the robot, turned by any
  angle. Headings are turned by one angle for a session, at which the tracked paths and those of nominal odometry agree
  best. Where the tracked body is, and by how much its axes are still turned, is for calibration to find.
- The authors read the times at which both begin and end off a plot. Here both clocks begin where the robot leaves its
  first place by `AWAY`, and end where it is as near to its last one: wheels by what they roll, the tracked point by
  its way and `ARM` times its turn. How much longer a cycle took than the odometry says is the robot's: the median of a
  session's runs. Times of a log are the tracker's, from where both begin: a cycle of 50 ms took 51 ms on the
  differential robot, and 63 ms on the tricycle. What is left, some 0.1 s, is for a fit of the clock.
- Logs that are written hold all poses at their own times. In memory the reference at a row is interpolated linearly
  between the poses around it, 10 ms apart, which misses 1 um at 0.1 m/s and 0.5 rad/s. In gaps of over `GAP` there is
  none, and beside the tracker's rows neither.
"""

import csv
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.importers import Importer
from castor_envs.logs.importers import optiodom as synchronised
from castor_envs.logs.log import Log
from castor_envs.logs.reference import GAP, TimedPoses, interpolated
from castor_envs.logs.table import complaint, number
from castor_envs.motion.kinematics import Geometry, forward
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription

AWAY, ARM = 5e-3, 0.1
"""m: by how much a robot has left a place; and per rad of turning."""

_HEADER = 7
_MOTIVE = ("frame", "time", "rotation Y", "rotation X", "rotation Z", "X", "Y", "Z")


def find_sessions(root: str | os.PathLike[str]) -> dict[str, Path]:
    """Return the folders of sessions below `root`/optiodom that hold both files of each run, by name, sorted.

    Raises InputError where there is no such folder, or no session in it.
    """
    return {name: folder for name, folder in synchronised.find_sessions(root).items() if _complete(folder)}


def read_session(folder: str | os.PathLike[str]) -> synchronised.Session:
    """Read a session; raises InputError, with file, line and column, for anything missing or garbled, and Declined for
    other kinds of robot."""
    pairs: list[_Pair] = []

    def read_run(folder: Path, kind: str, k: int, robot: RobotDescription) -> Log:
        pairs.append(_read_pair(folder, kind, k, robot))
        return pairs[-1].log_at(1.0)

    session = synchronised.session_of(folder, read_run)
    cycle = float(np.median([pair.cycle for pair in pairs]))
    runs = [pair.log_at(cycle) for pair in pairs]
    yaw = tracker_yaw(session.robot, runs)
    turned = np.array([0.0, 0.0, yaw])
    runs = [dataclasses.replace(run, reference=run.reference - turned) for run in runs]
    tracked = tuple(TimedPoses(t, pose - turned) for t, pose in (pair.tracked_at(cycle) for pair in pairs))
    robot = dataclasses.replace(session.robot, sample_period=round(session.robot.sample_period * cycle, 9))
    return dataclasses.replace(session, robot=robot, runs=tuple(runs), tracked=tracked)


class _Pair(NamedTuple):
    """Odometry at its own times, and what the tracker saw by its clock. moving: by either clock, when the robot begins
    to move and when it ends, (2, 2), odometry first."""

    own: Array
    wheel: Array
    pivot: Array
    seen: Array
    poses: Array
    moving: Array

    def tracked_at(self, cycle: float) -> TimedPoses:
        """Return the tracker's poses by the clock of `log_at`, from the last before counts to the first after them."""
        t = self._times(cycle)
        first = np.searchsorted(self.seen, t[0], "right") - 1
        during = slice(max(first, 0), np.searchsorted(self.seen, t[-1]) + 1)
        return TimedPoses(self.seen[during] - t[0], self.poses[during])

    def _times(self, cycle: float) -> Array:
        """Return when counts were read, by the tracker's clock."""
        return self.moving[1, 0] + (self.own - self.moving[0, 0]) * cycle

    @property
    def cycle(self) -> float:
        """True time of a second of odometry."""
        return float(np.diff(self.moving[1])[0] / np.diff(self.moving[0])[0])

    def log_at(self, cycle: float) -> Log:
        """Return the log at this true time of a second of odometry."""
        t = self._times(cycle)
        return Log(t=t - t[0], wheel=self.wheel, pivot=self.pivot, reference=resampled(self.seen, self.poses, t))


def _complete(folder: Path) -> bool:
    odometry = list(folder.glob(f"{folder.name}_run-*_odo.csv"))
    return bool(odometry) and all(path.with_name(path.name.replace("_odo", "_opti")).is_file() for path in odometry)


def _read_pair(folder: Path, kind: str, k: int, robot: RobotDescription) -> _Pair:
    stem = f"{folder.name}_run-{k:02d}"
    times, wheel, pivot = synchronised.read_rows(folder / f"{stem}_odo.csv", kind, ("time",))
    seen, poses = read_motive(folder / f"{stem}_opti.csv")
    wheel = {"diff": wheel[:, ::-1], "omni3": -wheel}.get(kind, wheel)
    own = times[:, 0]
    geometry = Geometry.of(robot)
    rolled = wheel * (2 * np.pi * geometry.radius / geometry.counts_per_rev)[~np.isnan(geometry.counts_per_rev)]
    known = np.isfinite(poses[:, 0])
    moving = np.array([_moving(own, rolled), _moving(seen[known], poses[known] * [1.0, 1.0, ARM])])
    if np.any(moving[:, 1] <= moving[:, 0]):
        raise complaint(folder / f"{stem}_odo.csv", None, None, "the robot never moves; give a run in which it does")
    return _Pair(own, wheel, pivot, seen[known], poses[known], moving)


def read_motive(path: Path) -> tuple[Array, Array]:
    """Return times (K,), s, and poses (K, 3) on the floor, NaN where the tracker lost the body."""
    rows = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line, cells in enumerate(csv.reader(file), start=1):
                if line <= _HEADER or not cells:
                    continue
                if len(cells) < len(_MOTIVE):
                    raise complaint(path, line, None, f"has {len(cells)} cells; give the pose of one rigid body")
                lost = not all(cell.strip() for cell in cells[2 : len(_MOTIVE)])
                taken = zip(_MOTIVE[1:2] if lost else _MOTIVE[1:], cells[1:], strict=False)
                rows.append([number(path, line, name, cell) for name, cell in taken] + [np.nan] * (6 * lost))
    except OSError as error:
        raise complaint(path, None, None, f"cannot be read ({error.strerror or error})") from None
    except (UnicodeDecodeError, csv.Error):
        raise complaint(path, None, None, "is no CSV text; give Motive's export of a take") from None
    table = np.array(rows).reshape(-1, 7)
    if np.isfinite(table).all(axis=1).sum() < 2:
        raise complaint(path, None, None, "holds fewer than 2 poses; give Motive's export of a take")
    known = np.isfinite(table[:, 1])
    heading = np.full(len(table), np.nan)
    heading[known] = np.unwrap(np.radians(table[known, 1]))
    return table[:, 0], np.column_stack([table[:, 6], table[:, 4], heading])


def resampled(seen: Array, poses: Array, t: Array) -> Array:
    """Return poses (K, 3) at times t (K,), of those (M, 3) seen at other times (M,); NaN beside them and in all of a
    gap, also near its ends, where this camera is about to lose the body."""
    after = np.clip(np.searchsorted(seen, t), 1, len(seen) - 1)
    return np.where((seen[after] - seen[after - 1] <= GAP)[:, None], interpolated(seen, poses, t), np.nan)


def tracker_yaw(robot: RobotDescription, runs: Sequence[Log]) -> float:
    """Return by which angle (rad) tracked headings are larger than those of the body.

    With z a place as complex number, tracked places are z_0 + e^(i phi) (z + e^(i psi) d) for odometry's path z, psi
    and a tracked point d: linear least squares in z_0, e^(i phi) and e^(i phi) d. Tracked headings are psi + phi + yaw.
    Runs count by the length of their path.
    """
    total = 0j
    for run in runs:
        assert run.reference is not None
        known = np.isfinite(run.reference[:, 0])
        odometry, tracked = _odometry(robot, run)[known], run.reference[known]
        place, seen = odometry[:, :2] @ [1, 1j], tracked[:, :2] @ [1, 1j]
        terms = np.column_stack([np.ones(len(place)), place, np.exp(1j * odometry[:, 2])])
        turn = np.linalg.lstsq(terms, seen, rcond=None)[0][1]
        yaw = np.mean(np.exp(1j * (tracked[:, 2] - odometry[:, 2]))) * np.conj(turn)
        total += float(np.sum(np.abs(np.diff(place)))) * yaw / max(abs(yaw), 1e-12)
    return float(np.angle(total))


def _odometry(robot: RobotDescription, run: Log) -> Array:
    """Return the path (K, 3) from 0 on by the robot as described, each step along its mean heading."""
    geometry = Geometry.of(robot)
    angle = castor_angles(geometry, run.pivot)
    angle = (angle[1:] + angle[:-1]) / 2
    counted = ~np.isnan(geometry.counts_per_rev)
    turned = np.zeros((len(run) - 1, len(counted)))
    turned[:, counted] = np.diff(run.wheel, axis=0) * 2 * np.pi / geometry.counts_per_rev[counted]
    step = forward(geometry, angle, np.zeros_like(angle), turned)
    psi = np.concatenate([[0.0], np.cumsum(step[:, 2])])
    way = np.cumsum((step[:, :2] @ [1, 1j]) * np.exp(1j * (psi[1:] + psi[:-1]) / 2))
    return np.column_stack([np.append(0.0, way.real), np.append(0.0, way.imag), psi])


def _moving(t: Array, places: Array) -> tuple[float, float]:
    """Return when something has left its first place (..., n) by `AWAY`, and when it has come as near to its last."""
    left = np.flatnonzero(np.linalg.norm(places - places[0], axis=1) > AWAY)
    away = np.flatnonzero(np.linalg.norm(places - places[-1], axis=1) > AWAY)
    if not left.size or not away.size:
        return float(t[0]), float(t[0])
    return float(t[left[0]]), float(t[away[-1]])


IMPORTER = Importer(
    name="optiodom-raw",
    recognises=lambda folder: (folder / synchronised.FOLDER).is_dir() and bool(find_sessions(folder)),
    find=find_sessions,
    read=read_session,
    reference_noise=synchronised.REFERENCE_NOISE,
)
