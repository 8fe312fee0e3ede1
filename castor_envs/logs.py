"""Logs: what one run of a robot recorded, as one CSV file.

The header comes first, columns stand in any order, columns that the robot does not explain are kept aside:

    t                        s, strictly increasing
    wheel_1l ...             cumulative encoder counts of every driven wheel
    pivot_1 ...              counts of every pivot encoder; they may wrap at `pivot_counts_per_rev`
    cmd_1l ...               rad/s, optional: the command to every driven wheel at row k from t_k to t_k+1
    cmd_pivot_1 ...          rad/s, optional: the same for the steering motors
    ref_x, ref_y, ref_psi    m, m, rad (unwrapped), optional: the body's true pose, blank where none was taken
    gyro_z                   rad/s, optional

Commands too may be blank in rows without any. Whatever `read_log` refuses, `write_log` refuses to write.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.files import write_atomically
from castor_envs.log_columns import LogColumns
from castor_envs.robot import RobotDescription
from castor_envs.tables import Line, check_width, complaint, number, read_lines

Array = NDArray[Any]
_REQUIRED = ("t", "wheel", "pivot")
_OPTIONAL = ("command", "steering_command", "reference", "gyro")
_MAY_BE_BLANK = ("command", "steering_command", "reference")
_FLAT = ("t", "gyro")


@dataclass(frozen=True, eq=False)
class Log:
    """One run of N samples.

    t (N,), s. wheel (N, driven wheels), cumulative counts. pivot (N, pivot encoders), counts as read, maybe
    wrapped. command (N, driven wheels) and steering_command (N, driven castors), rad/s, or None. reference
    (N, 3): true x, y, psi of the body, rows of NaN where none was taken, or None. gyro (N,), rad/s, or None.
    extra: the columns that the robot does not explain, as text. Arrays of any real numbers are held as float64.
    """

    t: Array
    wheel: Array
    pivot: Array
    command: Array | None = None
    steering_command: Array | None = None
    reference: Array | None = None
    gyro: Array | None = None
    extra: dict[str, list[str]] = field(default_factory=dict)

    def __post_init__(self):
        for part in (*_REQUIRED, *_OPTIONAL):
            if getattr(self, part) is not None:
                values = np.asarray(getattr(self, part), dtype=float)
                if len(values) != len(self.t):
                    raise ValueError(f"{part} has {len(values)} rows, t has {len(self.t)}")
                object.__setattr__(self, part, values)

    def __len__(self) -> int:
        return len(self.t)

    def observations(self) -> Iterator[dict[str, Array]]:
        """Yield what an estimator sees, sample by sample: increments, never the reference.

        Keys: "wheel" (driven wheels,), counts since the sample before (0 in the first); "pivot" (pivot
        encoders,), counts; "time" (1,), s; and "gyro" (1,), rad/s, where there is one.
        """
        increments = np.diff(self.wheel, axis=0, prepend=self.wheel[:1])
        for k in range(len(self)):
            observation = {
                "wheel": increments[k].copy(),
                "pivot": self.pivot[k].copy(),
                "time": self.t[k : k + 1].copy(),
            }
            if self.gyro is not None:
                observation["gyro"] = self.gyro[k : k + 1].copy()
            yield observation


def read_log(path: str | os.PathLike[str], robot: RobotDescription) -> Log:
    """Read and check a log of a robot.

    Raises InputError ``file:line: column 'x': what is wrong; what to do`` for missing or doubled columns,
    lines of the wrong width, cells that are not finite numbers, half-blank poses, fewer than two rows, times
    that do not increase, pivot counts that jump by over half a turn (see `pivot_jumps`), wrapped headings.
    """
    path = Path(path)
    header, *rows = read_lines(path)
    names = [name.strip() for name in header.cells]
    columns = LogColumns.of(robot)
    columns.check_header(path, header.number, names)
    for row in rows:
        check_width(path, row, len(names))
    place = {name: k for k, name in enumerate(names)}
    parts: dict[str, Array] = {}
    for part in (*_REQUIRED, *_OPTIONAL):
        own = [(name, place[name]) for name in getattr(columns, part) if name in place]
        if part in _REQUIRED or own:
            values = np.full((len(rows), len(own)), np.nan)
            for k, row in enumerate(rows):
                if part in _MAY_BE_BLANK and _blank(path, row, own):
                    continue
                for j, (name, at) in enumerate(own):
                    values[k, j] = number(path, row.number, name, row.cells[at])
            parts[part] = values[:, 0] if part in _FLAT else values
    extra = {name: [row.cells[k] for row in rows] for name, k in place.items() if name not in columns.known}
    log = Log(**parts, extra=extra)
    _check_values(path, [row.number for row in rows], log, robot)
    return log


def write_log(path: str | os.PathLike[str], log: Log, robot: RobotDescription) -> None:
    """Write a log of a robot, whole or not at all; `read_log` gives back the same numbers, bit for bit.

    Raises InputError for what `read_log` would refuse, ValueError for shapes that do not fit the robot.
    """
    path, columns = Path(path), LogColumns.of(robot)
    names: list[str] = []
    cells: list[list[str]] = []
    for part in (*_REQUIRED, *_OPTIONAL):
        values = getattr(log, part)
        if values is None:
            continue
        own = getattr(columns, part)
        if values.shape != ((len(log),) if part in _FLAT else (len(log), len(own))):
            raise ValueError(f"{part} has shape {values.shape}, robot {robot.name!r} has columns {own}")
        text = _count if part in ("wheel", "pivot") else _blank_or_number
        for name, column in zip(own, values.reshape(len(log), len(own)).T, strict=True):
            names.append(name)
            cells.append([text(value) for value in column.tolist()])
    for name, column in log.extra.items():
        if len(column) != len(log) or name in columns.known or name != name.strip():
            raise ValueError(f"extra column {name!r}: {len(column)} cells for {len(log)} rows, or a bad name")
        names.append(name)
        cells.append(column)
    columns.check_header(path, 1, names)
    _check_values(path, range(2, len(log) + 2), log, robot)
    rows = [names, *zip(*cells, strict=True)]
    write_atomically(path, "".join(",".join(map(_quoted, row)) + "\n" for row in rows))


def pivot_jumps(count: Array, counts_per_rev: float) -> NDArray[np.intp]:
    """Return the indices k at which pivot counts (N,) jump, from k - 1 to k, by over half a turn.

    A stream that stays within one revolution (max - min <= counts_per_rev) may come from an encoder that
    wraps: a jump of over half a turn is then a wrap, the shorter way round was meant, and no error can show. A
    stream that ranges over more does not wrap: there such a jump is what it says, and every reader that takes
    the shorter way round would get it wrong.
    """
    if np.ptp(count) <= counts_per_rev:
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(np.abs(np.diff(count)) > counts_per_rev / 2) + 1


def export_tum(path: str | os.PathLike[str], t: Array, pose: Array) -> None:
    """Write poses (N, 3) = x, y, psi at times (N,) as TUM text: t x y z qx qy qz qw.

    Rows without a pose (NaN) are left out.
    """
    half = pose[:, 2] / 2
    zero = np.zeros(len(t))
    rows = np.column_stack([t, pose[:, 0], pose[:, 1], zero, zero, zero, np.sin(half), np.cos(half)])
    _write_rows(Path(path), rows[np.isfinite(pose).all(axis=1)])


def export_kitti(path: str | os.PathLike[str], pose: Array) -> None:
    """Write poses (N, 3) = x, y, psi as KITTI text: the 3x4 matrix [R | p] row by row.

    Raises ValueError for a pose that is not finite: KITTI text has no times, so no row can be left out.
    """
    if not np.isfinite(pose).all():
        raise ValueError("KITTI text has no place for rows without a pose; select rows, or export TUM text")
    x, y, psi = pose.T
    c, s, zero, one = np.cos(psi), np.sin(psi), np.zeros(len(pose)), np.ones(len(pose))
    _write_rows(Path(path), np.column_stack([c, -s, zero, x, s, c, zero, y, zero, zero, one, zero]))


def _write_rows(path: Path, rows: Array) -> None:
    write_atomically(path, "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()))


def _quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if any(mark in cell for mark in ',"\r\n') else cell


def _count(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 2**53 else repr(value)


def _blank_or_number(value: float) -> str:
    return "" if np.isnan(value) else repr(value)


def _blank(path: Path, row: Line, columns: list[tuple[str, int]]) -> bool:
    """Return whether all of a row's cells in some columns are blank; some but not all is an error."""
    blank = [name for name, at in columns if not row.cells[at].strip()]
    if blank and len(blank) < len(columns):
        names = ", ".join(name for name, _ in columns)
        raise complaint(path, row.number, blank[0], f"is blank, but not all of {names}; give all or none")
    return bool(blank)


def _check_values(path: Path, lines: Sequence[int], log: Log, robot: RobotDescription) -> None:
    """Raise InputError for what single cells do not show: too few rows, unsorted times, jumps."""
    columns = LogColumns.of(robot)
    if len(log) < 2:
        raise complaint(path, None, None, f"has {len(log)} rows of numbers; a log needs at least 2")
    for part in (*_REQUIRED, *_OPTIONAL):
        values = getattr(log, part)
        if values is not None:
            _check_finite(path, lines, getattr(columns, part), np.asarray(values).reshape(len(log), -1), part)
    late = np.flatnonzero(np.diff(log.t) <= 0)
    if late.size:
        k = late[0] + 1
        before, now = float(log.t[k - 1]), float(log.t[k])
        what = f"repeats {now!r}" if now == before else f"goes back from {before!r} to {now!r}"
        raise complaint(path, lines[k], "t", f"{what}; sort the rows and keep one for each time")
    for j, i in enumerate(robot.pivot_encoders):
        turn = robot.castors[i].pivot_counts_per_rev or np.nan
        for k in pivot_jumps(log.pivot[:, j], turn)[:1]:
            before, now = _count(float(log.pivot[k - 1, j])), _count(float(log.pivot[k, j]))
            raise complaint(
                path,
                lines[k],
                columns.pivot[j],
                f"jumps from {before} to {now}, over half a turn of {turn} counts, in a column that spans "
                "over one turn and so does not wrap; mend the count, or sample faster",
            )
    if log.reference is not None:
        for k in np.flatnonzero(np.abs(np.diff(log.reference[:, 2])) > np.pi)[:1] + 1:
            raise complaint(path, lines[k], "ref_psi", "steps by over half a turn; unwrap the heading (rad)")


def _check_finite(path: Path, lines: Sequence[int], names: tuple[str, ...], values: Array, part: str) -> None:
    bad = ~np.isfinite(values)
    if part in _MAY_BE_BLANK:
        bad &= ~np.isnan(values).all(axis=1, keepdims=True)
    for k, j in np.argwhere(bad)[:1]:
        raise complaint(path, lines[k], names[j], f"{values[k, j]} is not finite; give a finite number")
