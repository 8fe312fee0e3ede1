"""Logs as CSV files: what one run of a robot or a train recorded. Errors name file, line and column.

The header comes first, columns stand in any order, columns that the vehicle does not have are kept as text. A robot:

    t                        s, strictly increasing
    wheel_1l ...             cumulative encoder counts of every driven wheel
    pivot_1 ...              counts of every pivot encoder; they may wrap at `pivot_counts_per_rev`
    cmd_1l ...               rad/s, optional: the command to every driven wheel at row k from t_k to t_k+1
    cmd_pivot_1 ...          rad/s, optional: the same for the steering motors
    ref_x, ref_y, ref_psi    m, m, rad (unwrapped), optional: the body's pose by a tracker (in simulation the truth),
                             blank where none was taken; ref_psi alone is blank, or left out, where a tracker has
                             positions alone
    gyro_z                   rad/s, optional
    fix_x, fix_y, fix_psi    m, m, rad (wrapped or not), optional: the body's pose as an external sensor has it, blank
                             where none came; fix_psi alone is blank, or left out, where a fix has no heading, and
                             x, y of a compass
    fix_age                  s, optional (0): how long ago that was true; blank where no fix came

A tracker with times and a rate of its own has rows of its own, in the order of time: t and the reference, all else
blank. `read_log` then gives the reference at the rows with counts, as `castor_envs.logs.reference` finds it there, or
in rows that it adds for poses that are near none (`castor_envs.logs.pose_rows`).

A train has no pivots, no gyro and no fixes; its axles are numbered and its frames lettered from the front:

    t                        s, strictly increasing
    wheel_1l ... wheel_Nr    cumulative encoder counts, axle by axle
    cmd_1l ...               rad/s, optional, as above
    rps_A_x, rps_A_y, rps_A_phi, rps_B_x ...
                             m, m, rad, optional: the front axle's pose in the rear axle's frame as the frame's relative
                             posture sensor reports it; a frame's three are blank where there is no reading
    rps_age_A ...            s, optional (0): how old that reading is
    ref_1_x, ref_1_y, ref_1_psi, ref_2_x ...
                             m, m, rad (unwrapped), optional: the axles' poses, likewise

Commands too may be blank in rows without any, and poses of axles have rows of their own as above. Whatever `read_log`
refuses, `write_log` refuses to write.
"""

import dataclasses
import heapq
import itertools
import os
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Array, Numbers
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import OPTIONAL, REQUIRED, TEXT, Log, pivot_jumps
from castor_envs.logs.pose_rows import with_reference
from castor_envs.logs.recordings import refuse_recording
from castor_envs.logs.reference import TimedPoses
from castor_envs.logs.table import Line, check_width, complaint, each_line, numbers
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.train import TrainDescription

_MAY_BE_BLANK = ("command", "steering_command", "reference", "fix", "fix_age", "rps")
_FLAT = ("t", "gyro", "fix_age")
CHUNK = 4096
"""Rows that are text at once while a log is read or written: some MB."""

#: The largest absolute value of a log's numbers, by part. t: 64 bits of nanoseconds since 1970, so that a clock in
#: another unit is still read, and reported by the diagnosis. Counts: below 2^53 all whole numbers, and so all
#: increments, are exact. Rates: some fifty times a turbocharger's. Ages: 30 years.
MOST = {
    "t": 2.0**63,
    "wheel": 2.0**53,
    "pivot": 2.0**53,
    "command": 1e6,
    "steering_command": 1e6,
    "gyro": 1e6,
    "fix_age": 1e9,
    "rps_age": 1e9,
}
#: The same for positions, m: UTM northings in millimetres; and of headings, rad: 2778 turns in degrees.
MOST_POSITION, MOST_HEADING = 1e10, 1e6


def read_log(path: str | os.PathLike[str], vehicle: Vehicle) -> Log:
    """Read and check a log of a robot or a train; a train's log without rps columns has rps of NaN.

    Raises InputError ``file:line: column 'x': what is wrong; what to do`` for missing or duplicate columns, encoders of
    castors that the robot does not have, lines of the wrong width, cells that are not finite numbers or beyond `MOST`,
    half-blank poses, fewer than two rows, times that do not increase, pivot counts that jump by over half a turn (see
    `pivot_jumps`), wrapped headings; and for recordings, of which no log was made yet.
    """
    path, columns = Path(path), LogColumns.of(vehicle)
    refuse_recording(path)
    lines = each_line(path)
    header = next(lines)
    names = [name.strip() for name in header.cells]
    columns.check_header(path, header.number, names)
    columns.check_castors(path, header.number, names, vehicle)
    place = {name: k for k, name in enumerate(names)}
    known = columns.known
    optional = [part for part in OPTIONAL if any(name in place for name in getattr(columns, part))]
    counted = _Rows(path, columns, place, (*REQUIRED, *optional), [name for name in names if name not in known])
    posed = _Rows(path, columns, place, ("t", "reference"))
    for piece in iter(lambda: list(itertools.islice(lines, CHUNK)), []):
        for row in piece:
            check_width(path, row, len(names))
        for kind, rows in zip((counted, posed), _split(columns, place, piece), strict=True):
            kind.add(rows)
    parts = counted.parts()
    if columns.rps and "rps" not in parts:
        parts["rps"] = np.full((len(counted.line), len(columns.rps)), np.nan)
    log = Log(**parts, extra=counted.extra(), undone=())
    _check_values(path, counted.line, log, vehicle)
    if not posed.line:
        return log
    return with_reference(log, _tracked(path, columns, posed, log, counted.line), vehicle)


class _Rows:
    """Rows of a file, taken piece by piece: what stays of a piece are numbers of its lines, numbers, and extra text."""

    def __init__(
        self, path: Path, columns: LogColumns, place: dict[str, int], parts: Iterable[str], extra: Iterable[str] = ()
    ) -> None:
        self.line = array("q")
        self._path, self._columns, self._place = path, columns, place
        self._parts: dict[str, list[Array]] = {part: [] for part in parts}
        self._extra: dict[str, list[Numbers]] = {name: [] for name in extra}
        self.add([])  # so that of a file without rows, too, each part has its width

    def add(self, rows: list[Line]) -> None:
        """Take a piece; raises InputError for cells that are not what they should be."""
        self.line.extend(row.number for row in rows)
        for part, pieces in self._parts.items():
            pieces.append(_values(self._path, self._columns, part, self._place, rows))
        for name, pieces in self._extra.items():
            pieces.append(np.array([row.cells[self._place[name]] for row in rows], dtype=TEXT))

    def parts(self) -> dict[str, Array]:
        """Return the numbers of all rows by part, and forget them."""
        return _joined(self._parts)

    def extra(self) -> dict[str, Numbers]:
        """Return the text of all rows by column, and forget it."""
        return _joined(self._extra)


def _joined(pieces: dict[str, list[Any]]) -> dict[str, Any]:
    return {name: np.concatenate(pieces.pop(name)) for name in list(pieces)}


def _split(columns: LogColumns, place: dict[str, int], rows: list[Line]) -> tuple[list[Line], list[Line]]:
    """Return the rows with counts, and those with nothing but a time and a reference."""
    reference = {place[name] for name in columns.reference if name in place}
    others = [k for k in range(len(place)) if k not in reference and k != place["t"]]
    counted: list[Line] = []
    posed: list[Line] = []
    for row in rows:
        blank = others and not any(row.cells[k].strip() for k in others)
        alone = blank and any(row.cells[k].strip() for k in reference)
        (posed if alone else counted).append(row)
    return counted, posed


def _values(path: Path, columns: LogColumns, part: str, place: dict[str, int], rows: list[Line]) -> Array:
    """Return the numbers of a part's columns (K, n), or (K,), NaN where cells may be blank and are."""
    names = getattr(columns, part)
    if part not in _MAY_BE_BLANK:
        values = numbers(path, rows, {name: place[name] for name in names})
        return values[:, 0] if part in _FLAT else values
    values = np.full((len(rows), len(names)), np.nan)
    for group in _groups(part, len(names)):
        present = {name: place[name] for name in names[group] if name in place}
        given = [k for k, row in enumerate(rows) if not _blank(path, row, present)]
        if present:
            values[given, group] = numbers(path, [rows[k] for k in given], present)
    return values[:, 0] if part in _FLAT else values


def _tracked(path: Path, columns: LogColumns, posed: _Rows, log: Log, lines: Sequence[int]) -> TimedPoses:
    """Return all poses of a file, also those in rows with counts; raises InputError for mistakes in them."""
    parts = posed.parts()
    assert log.reference is not None
    _check_size(path, posed.line, columns.reference, parts["reference"], "reference")
    line, t = np.append(posed.line, lines), np.append(parts["t"], log.t)
    order = np.argsort(line)
    line, t, pose = line[order], t[order], np.concatenate([parts["reference"], log.reference])[order]
    _check_times(path, line, t)
    known = np.isfinite(pose[:, 0])
    line, t, pose = line[known], t[known], pose[known]
    _check_headings(path, line, columns, pose)
    return TimedPoses(t, pose)


def write_log(path: str | os.PathLike[str], log: Log, vehicle: Vehicle, tracked: TimedPoses | None = None) -> None:
    """Write a log of a robot or a train, whole or not at all; `read_log` gives back the same numbers, bit for bit.

    tracked: the reference at its own times, which is written instead of the log's, in rows of its own where there are
    no counts at its times.

    Raises InputError for what `read_log` would refuse, ValueError for shapes that do not fit the vehicle.
    """
    path, columns = Path(path), LogColumns.of(vehicle)
    if tracked is not None:
        log = dataclasses.replace(log, reference=_at_same_times(tracked, log.t))
    names: list[str] = []
    printed: list[_Printed] = []
    for part in (*REQUIRED, *OPTIONAL):
        values = getattr(log, part)
        if values is None:
            continue
        expected = getattr(columns, part)
        if values.shape != ((len(log),) if part in _FLAT else (len(log), len(expected))):
            raise ValueError(f"{part} has shape {values.shape}, {vehicle.name!r} has columns {expected}")
        text = _count if part in ("wheel", "pivot") else _blank_or_number
        names += expected
        printed += [_Printed(column, text) for column in values.reshape(len(log), len(expected)).T]
    for name, cells in log.extra.items():
        if len(cells) != len(log) or name in columns.known or name != name.strip():
            raise ValueError(f"extra column {name!r}: {len(cells)} cells for {len(log)} rows, or a bad name")
        names.append(name)
        printed.append(_Printed(cells, _quoted))
    columns.check_header(path, 1, names)
    columns.check_castors(path, 1, names, vehicle)
    _check_values(path, range(2, len(log) + 2), log, vehicle)
    rows = _rows(printed, len(log))
    if tracked is not None:
        rows = _with_poses(columns, names, rows, log.t, tracked)
    write_atomically(path, (",".join(row) + "\n" for row in itertools.chain([map(_quoted, names)], rows)))


class _Printed(NamedTuple):
    """A column of a log, and what makes a cell's text of a value."""

    values: Array | Sequence[str]
    text: Callable[[Any], str]


def _rows(columns: Sequence[_Printed], count: int) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each of so many rows; never more than `CHUNK` rows are text at once."""
    for first in range(0, count, CHUNK):
        chunk = slice(first, first + CHUNK)
        cells = [map(text, np.asarray(values[chunk]).tolist()) for values, text in columns]
        yield from zip(*cells, strict=True)


def _at_same_times(tracked: TimedPoses, t: Array) -> Array:
    """Return the poses taken at exactly the times of counts, NaN where none was."""
    place = np.minimum(np.searchsorted(tracked.t, t), len(tracked.t) - 1)
    return np.where((tracked.t[place] == t)[:, None], tracked.pose[place], np.nan)


def _with_poses(
    columns: LogColumns, names: list[str], rows: Iterator[tuple[str, ...]], t: Array, tracked: TimedPoses
) -> Iterator[tuple[str, ...]]:
    """Return rows of a file in the order of time, those added that hold a pose alone."""
    _check_headings(Path("tracked"), range(len(tracked.t)), columns, tracked.pose)
    alone = ~np.isin(tracked.t, t)
    place = {name: k for k, name in enumerate((*columns.t, *columns.reference))}
    shown = np.column_stack([tracked.t, tracked.pose])[alone]
    added = _rows(
        [
            _Printed(shown[:, place[name]], _blank_or_number) if name in place else _Printed([""] * len(shown), str)
            for name in names
        ],
        len(shown),
    )
    both = heapq.merge(zip(t, rows, strict=True), zip(shown[:, 0], added, strict=True), key=itemgetter(0))
    return (row for _, row in both)


def _quoted(cell: str) -> str:
    return '"' + cell.replace('"', '""') + '"' if any(mark in cell for mark in ',"\r\n') else cell


def _count(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 2**53 else repr(value)


def _blank_or_number(value: float) -> str:
    return "" if np.isnan(value) else repr(value)


def _groups(part: str, width: int) -> list[slice]:
    """Return which columns of a part may be blank together: of rps the three of a frame, of a fix and of a robot's
    reference the position and the heading, of other parts all."""
    if part in ("fix", "reference") and width == 3:  # a train has more than one axle
        return [slice(0, 2), slice(2, 3)]
    size = 3 if part == "rps" else max(width, 1)
    return [slice(k, k + size) for k in range(0, width, size)]


def _blank(path: Path, row: Line, columns: dict[str, int]) -> bool:
    """Return whether all of a row's cells in some columns are blank; some but not all is an error."""
    blank = [name for name, at in columns.items() if not row.cells[at].strip()]
    if blank and len(blank) < len(columns):
        names = ", ".join(columns)
        raise complaint(path, row.number, blank[0], f"is blank, but not all of {names}; give all or none")
    return bool(blank)


def _check_values(path: Path, lines: Sequence[int], log: Log, vehicle: Vehicle) -> None:
    """Raise InputError for mistakes that no single cell shows: too few rows, unsorted times, jumps."""
    columns = LogColumns.of(vehicle)
    if len(log) < 2:
        raise complaint(path, None, None, f"a log needs at least 2 rows of numbers, not {len(log)}")
    for part in (*REQUIRED, *OPTIONAL):
        values = getattr(log, part)
        if values is not None:
            rows = np.asarray(values).reshape(len(log), -1)
            _check_finite(path, lines, getattr(columns, part), rows, part)
            _check_size(path, lines, getattr(columns, part), rows, part)
    _check_times(path, lines, log.t)
    pivots = [] if isinstance(vehicle, TrainDescription) else [vehicle.castors[i] for i in vehicle.pivot_encoders]
    for j, castor in enumerate(pivots):
        turn = castor.pivot_counts_per_rev or np.nan
        for k in pivot_jumps(log.pivot[:, j], turn)[:1]:
            before, current = _count(float(log.pivot[k - 1, j])), _count(float(log.pivot[k, j]))
            ends = (int(np.argmin(log.pivot[:, j])), int(np.argmax(log.pivot[:, j])))
            low, high = (f"{_count(float(log.pivot[end, j]))} in line {lines[end]}" for end in ends)
            raise complaint(
                path,
                lines[k],
                columns.pivot[j],
                f"jumps from {before} to {current}, over half a turn of {_count(turn)} counts, in a column that spans "
                f"over one turn ({low} to {high}) and so does not wrap; mend the count, or sample faster",
            )
    if log.rps_age is not None:
        for k, f in np.argwhere(log.rps_age < 0)[:1]:
            raise complaint(path, lines[k], columns.rps_age[f], f"is {log.rps_age[k, f]} s; an age is never below 0")
    if log.fix is not None and log.fix_age is not None:
        seen = ~np.isnan(log.fix).all(axis=1)
        for k in np.flatnonzero(seen & ~(log.fix_age >= 0))[:1]:
            what = "is blank beside a fix" if np.isnan(log.fix_age[k]) else f"is {log.fix_age[k]} s"
            raise complaint(path, lines[k], columns.fix_age[0], f"{what}; give its age, 0 or more")
    if log.reference is not None:
        for k in np.flatnonzero(np.isfinite(log.reference[:, -1]) & np.isnan(log.reference[:, 0]))[:1]:
            raise complaint(path, lines[k], columns.reference[0], "is blank beside a heading; give all or none")
        _check_headings(path, lines, columns, log.reference)


def _check_times(path: Path, lines: Sequence[int] | Numbers, t: Array) -> None:
    for k in np.flatnonzero(np.diff(t) <= 0)[:1] + 1:
        before, current = float(t[k - 1]), float(t[k])
        problem = f"repeats {current!r}" if current == before else f"goes back from {before!r} to {current!r}"
        raise complaint(path, int(lines[k]), "t", f"{problem}; sort the rows and keep one for each time")


def _check_headings(path: Path, lines: Sequence[int] | Numbers, columns: LogColumns, poses: Array) -> None:
    for k, axle in np.argwhere(np.abs(np.diff(poses[:, 2::3], axis=0)) > np.pi)[:1]:
        name = columns.reference[3 * axle + 2]
        step = float(np.diff(poses[k : k + 2, 3 * axle + 2])[0])
        degrees = (
            "" if abs(abs(step) - 2 * np.pi) < np.pi / 2 else f" by {step:.4g} rad, or are these degrees? give rad"
        )
        raise complaint(path, int(lines[k + 1]), name, f"steps by over half a turn; unwrap the heading (rad){degrees}")


def _check_finite(path: Path, lines: Sequence[int], names: tuple[str, ...], values: Array, part: str) -> None:
    bad = ~np.isfinite(values)
    for group in _groups(part, len(names)) if part in _MAY_BE_BLANK else ():
        bad[:, group] &= ~np.isnan(values[:, group]).all(axis=1, keepdims=True)
    for k, j in np.argwhere(bad)[:1]:
        raise complaint(path, lines[k], names[j], f"{values[k, j]} is not finite; give a finite number")


def _check_size(path: Path, lines: Sequence[int], names: tuple[str, ...], values: Array, part: str) -> None:
    limits = np.array(
        [MOST.get(part, MOST_HEADING if name.endswith(("_psi", "_phi")) else MOST_POSITION) for name in names]
    )
    for k, j in np.argwhere(np.abs(values) > limits)[:1]:
        raise complaint(
            path, lines[k], names[j], f"{values[k, j]:g} is beyond +-{limits[j]:g}; mend the number or its unit"
        )
