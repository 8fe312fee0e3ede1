"""Trajectories as text files: TUM and KITTI, which other programs, such as `evo`, read; and drives to follow.

A drive is a CSV file; its header comes first, columns stand in any order:

    t_s                      s, strictly increasing
    x_m, y_m, psi_rad        pose of the body
    v_x_m_per_s, v_y_m_per_s, omega_rad_per_s
                             the body's mean velocity in its own frame from this row to the next; of the last row 0

A robot that moves with the velocity of each row until the time of the next row is then at the next row's pose.
"""

import os
from pathlib import Path
from typing import Literal

import numpy as np

from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Array, Numbers
from castor_envs.logs.table import check_width, complaint, number, read_lines
from castor_envs.motion.trajectories import Leg, Run, Trajectory

POSE = ("x_m", "y_m", "psi_rad")
DRIVE = ("t_s", *POSE, "v_x_m_per_s", "v_y_m_per_s", "omega_rad_per_s")
APART = 0.05
"""How far, m and rad, poses of a drive may be from where its velocities lead: rows that span a corner cut it."""

SUDDEN = 1e12
"""Acceleration with which time begins, 1/s: within a picosecond, so that velocities are held from row to row."""


def export_trajectory(
    path: str | os.PathLike[str], t: Numbers, pose: Numbers, format: Literal["tum", "kitti"] = "tum"
) -> None:
    """Write poses (K, 3) = x, y, psi at times (K,), s, as "tum" or "kitti" text; see `export_tum` and `export_kitti`.

    Rows without a pose (NaN) are left out of TUM text. Raises InputError where KITTI text would have to leave rows out,
    where no row has a pose, and for other formats.
    """
    if np.shape(pose) != (len(t), 3):
        raise ValueError(f"pose must have shape ({len(t)}, 3), got {np.shape(pose)}")
    if format not in ("tum", "kitti"):
        raise InputError(f"unknown trajectory format {format!r}; give 'tum' or 'kitti'")
    if not np.isfinite(pose).all(axis=1).any():
        raise InputError(f"{path}: there is no pose to write; give a log that has some")
    if format == "tum":
        export_tum(path, t, pose)
    else:
        export_kitti(path, pose)


def export_tum(path: str | os.PathLike[str], t: Numbers, pose: Numbers) -> None:
    """Write poses (N, 3) = x, y, psi at times (N,) as TUM text: t x y z qx qy qz qw.

    Rows without a pose (NaN) are left out.
    """
    half = pose[:, 2] / 2
    zero = np.zeros(len(t))
    rows = np.column_stack([t, pose[:, 0], pose[:, 1], zero, zero, zero, np.sin(half), np.cos(half)])
    _write_rows(Path(path), rows[np.isfinite(pose).all(axis=1)])


def export_kitti(path: str | os.PathLike[str], pose: Numbers) -> None:
    """Write poses (N, 3) = x, y, psi as KITTI text: the 3x4 matrix [R | p] row by row.

    Raises InputError for a pose that is not finite: KITTI text has no times, so no row can be left out.
    """
    if not np.isfinite(pose).all():
        raise InputError("KITTI text has no place for rows without a pose; select rows, or export TUM text")
    x, y, psi = pose.T
    c, s, zero, unit = np.cos(psi), np.sin(psi), np.zeros(len(pose)), np.ones(len(pose))
    _write_rows(Path(path), np.column_stack([c, -s, zero, x, s, c, zero, y, zero, zero, unit, zero]))


def write_drive(path: str | os.PathLike[str], trajectory: Trajectory, period: float) -> None:
    """Write a trajectory as a drive with a row every `period`, s; the last one at or after its end."""
    t = period * np.arange(int(np.ceil(trajectory.duration / period - 1e-9)) + 1)
    smooth = np.unique(np.concatenate([t, trajectory.breakpoints()]))  # in between, velocity is linear in time
    middle, velocity = (smooth[:-1] + smooth[1:]) / 2, np.zeros((len(t), 3))
    row = np.searchsorted(t, middle, side="right") - 1
    np.add.at(velocity, row, trajectory.at(middle)[1] * np.diff(smooth)[:, None] / period)
    rows = np.column_stack([t, trajectory.at(t)[0], velocity]).tolist()
    lines = [",".join(DRIVE), *(",".join(map(repr, row)) for row in rows)]
    write_atomically(Path(path), "\n".join(lines) + "\n")


def read_drive(path: str | os.PathLike[str]) -> Trajectory:
    """Return the trajectory that a drive describes: its rows' velocities, each held until the next row.

    Raises InputError ``file:line: column 'x': what is wrong; what to do``; also where poses do not follow.
    """
    path = Path(path)
    header, *lines = read_lines(path)
    names = [name.strip() for name in header.cells]
    for name in DRIVE:
        if names.count(name) != 1:
            raise complaint(path, header.number, name, "must be there once; a drive has " + ", ".join(DRIVE))
    if len(lines) < 2:
        raise complaint(path, None, None, "has fewer than two rows; a drive needs where it begins and where it ends")
    for line in lines:
        check_width(path, line, len(names))
    place = [names.index(name) for name in DRIVE]
    cells = [[(line.number, name, line.cells[k]) for name, k in zip(DRIVE, place, strict=True)] for line in lines]
    rows = np.array([[number(path, *cell) for cell in row] for row in cells])
    t, pose, velocity = rows[:, 0], rows[:, 1:4], rows[:-1, 4:]
    for k in np.flatnonzero(np.diff(t) <= 0)[:1]:
        raise complaint(path, lines[k + 1].number, "t_s", "does not increase; remove the line")
    held = zip(velocity.tolist(), np.diff(t).tolist(), strict=True)
    legs = [Leg((v_x, v_y, omega), lasts) for (v_x, v_y, omega), lasts in held]
    x, y, psi = pose[0].tolist()
    found = Trajectory(path.stem, (Run(tuple(legs), 1.0, SUDDEN),), (x, y, psi))
    _check_poses(path, [line.number for line in lines], found.at(t - t[0])[0], pose)
    return found


def _check_poses(path: Path, lines: list[int], led: Array, pose: Array) -> None:
    for k, (name, off) in ((k, pair) for k, row in enumerate(pose - led) for pair in zip(POSE, row, strict=True)):
        if abs(off) > APART:
            message = f"is {abs(off):.2g} off where the velocities lead, which are in the body's own frame; mend them"
            raise complaint(path, lines[k], name, message)


def _write_rows(path: Path, rows: Numbers) -> None:
    write_atomically(path, "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()))
