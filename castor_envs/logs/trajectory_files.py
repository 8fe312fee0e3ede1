"""Trajectories as text files that other programs, such as `evo`, read: TUM and KITTI."""

import os
from pathlib import Path
from typing import Literal

import numpy as np

from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Numbers


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


def _write_rows(path: Path, rows: Numbers) -> None:
    write_atomically(path, "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()))
