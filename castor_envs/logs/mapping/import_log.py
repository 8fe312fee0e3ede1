"""A recording and a map become a log: readings are collected channel by channel, and brought to common rows."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np

from castor_envs.errors import InputError, did_you_mean, shortened
from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log
from castor_envs.logs.mapping.agreement import agreement_notes
from castor_envs.logs.mapping.channel_map import ChannelMap, Column, Source
from castor_envs.logs.mapping.limits import limit_notes
from castor_envs.logs.mapping.series import Track, in_order, row_times
from castor_envs.logs.mapping.units import GYRO_ANGLES, LENGTHS, counts_in, kind_of, radians_in
from castor_envs.logs.pose_rows import with_reference
from castor_envs.logs.recordings import open_recording
from castor_envs.logs.recordings.recording import UNITS, Clock, Recording, Series, heading_of, survey
from castor_envs.logs.reference import FARTHEST, GAP, TimedPoses
from castor_envs.vehicles.robot import RobotDescription

GAP_STEPS = 10
"""Usual steps between rows: a longer one is a gap, where it is too long to be bridged as well (`GAP`)."""

ROUNDED = 1e-3
"""Part by which a counter may reach beyond where it wraps: 6.28 is given for a turn."""

FASTEST_HEADING = 30.0
"""rad/s: no wheeled robot turns faster."""


class Imported(NamedTuple):
    """What an import gives: the log, the reference at its own times (None without one), what to look at, and the time
    of the recording at which the log begins, ns."""

    log: Log
    tracked: TimedPoses | None
    notes: tuple[str, ...]
    begin: int


def import_log(source: str | os.PathLike[str], robot: RobotDescription, by: ChannelMap, name: str = "map") -> Imported:
    """Return the log that a recording holds for a robot, by a map, which errors call `name`.

    A recording is read once for each of the map's sources, a reading at a time; what is kept of it are the readings of
    the map's channels. Raises InputError for mistakes in the map and for what cannot be read.
    """
    by.check(robot, name)
    columns, notes = LogColumns.of(robot), list[str]()
    begin, tracks = _tracks(Path(source), columns, by, name, notes)
    first, log, tracked = _log_of(robot, columns, by, tracks, notes)
    if tracked is not None:
        read = with_reference(log, tracked, robot)
        notes += [*_reference_notes(log, tracked, len(read) - len(log)), *agreement_notes(robot, read)]
    return Imported(log, tracked, (*notes, *limit_notes(robot, by, log)), begin + round(first * UNITS["s"]))


def _log_of(
    robot: RobotDescription, columns: LogColumns, by: ChannelMap, tracks: Mapping[str, Track], notes: list[str]
) -> tuple[float, Log, TimedPoses | None]:
    """Return the time of the first row, the log of all columns' tracks, its times from 0 on, and the reference; what is
    left out is noted."""
    counts = _counts(robot, columns, by, tracks)
    t = _rows(counts, tracks.get("gyro_z"), notes)
    part = {key: track.at(t) for key, track in counts.items()}
    gyro = _gyro(by.columns["gyro_z"], tracks["gyro_z"], t) if "gyro_z" in tracks else None
    tracked = _tracked(columns, by, tracks, t)
    fix, age = _fixes(columns, by, tracks, t)
    tracked, fix = _near_origin(tracked, fix, notes)
    log = Log(
        t=t - t[0],
        wheel=_stacked([part[key] for key in columns.wheel], t),
        pivot=_stacked([part[key] for key in columns.pivot], t),
        command=_commands(robot, columns.command, by, tracks, t),
        steering_command=_commands(robot, columns.steering_command, by, tracks, t),
        gyro=gyro,
        fix=fix,
        fix_age=age,
    )
    if tracked is None:
        return float(t[0]), log, None
    tracked = TimedPoses(tracked.t - t[0], tracked.pose)
    return float(t[0]), replace(log, reference=tracked.at(log.t)), tracked


def _stacked(columns: list[Array], t: Array) -> Array:
    return np.column_stack(columns) if columns else np.empty((len(t), 0))


def _tracks(
    source: Path, columns: LogColumns, by: ChannelMap, name: str, notes: list[str]
) -> tuple[int, dict[str, Track]]:
    """Return the time of the first count, ns, and the readings of each column, s since then; which are left out or put
    in order is noted."""
    readings = _readings(source, by, name, notes)
    begin = min(readings[key][0].time[0] for key in (*columns.wheel, *columns.pivot))
    said: dict[tuple[str, str], list[str]] = {}
    tracks = {key: _track(f"{name}: columns.{key}", by, key, readings.pop(key), begin, said) for key in by.columns}
    notes += [f"{_together(keys)}: {what}" for (_, what), keys in said.items()]
    return begin, tracks


def _together(keys: list[str]) -> str:
    return keys[0] if len(keys) == 1 else f"{len(keys)} columns ({shortened(', '.join(keys), 60)})"


def _readings(source: Path, by: ChannelMap, name: str, notes: list[str]) -> dict[str, list[Series]]:
    """Return the readings of each column, one series for each of its channels; offsets are added.

    notes: get what is to be said of the recordings.
    """
    found: dict[tuple[str, str], Series] = {}
    for key, place in by.places.items():
        needed = frozenset(c for column in by.columns.values() if column.source == key for c in column.channels)
        if not needed:
            continue
        recording = open_recording(source if place.file is None else source.parent / place.file)
        clock = _clock(place, recording)
        series = {channel: Series(recording.held, clock.time == "header") for channel in needed}
        for reading in recording.readings(needed, clock):
            series[reading.channel].add(reading)
        notes += recording.notes
        absent = [channel for channel in needed if not series[channel].time]
        if absent:
            known = survey(recording, clock)
            column = next(k for k, c in by.columns.items() if c.source == key and absent[0] in c.channels)
            why = _why_left_out(absent[0], recording)
            reason = did_you_mean(absent[0], known) if why is None else f": it is left out ({why})"
            problem = f"source {key!r} has no readings of {absent[0]!r}{reason}"
            raise InputError(f"{name}: columns.{column}: {shortened(problem, 600)}")
        shift = round(place.offset * 1e9)
        found |= {(key, channel): one.shifted(shift) for channel, one in series.items()}
    return {key: [found[column.source, channel] for channel in column.channels] for key, column in by.columns.items()}


def _why_left_out(channel: str, recording: Recording) -> str | None:
    """Return why a recording has no such channel: what the channel is of is left out; None where it is not."""
    for name, why in recording.left_out.items():
        if channel == name or any(channel.startswith(name + mark) for mark in recording.inside):
            return why
    return None


def _clock(place: Source, recording: Recording) -> Clock:
    """Return the clock that a map names for a source, or else that of a first map, in the map's unit if it has one; a
    period is left to people."""
    if place.clock.unnamed:
        usual = recording.clock()
        if usual.period is None:
            return usual if place.unit is None else replace(usual, unit=place.unit)
    return place.clock


def _track(
    where: str, by: ChannelMap, key: str, series: list[Series], begin: int, said: dict[tuple[str, str], list[str]]
) -> Track:
    """Return a column's readings in the channel's unit, sign and scale applied; headings of quaternions in rad, and the
    sums of increments.

    said: gets the column's key by its source and what is left out or put in order, the same for all columns of a topic.
    """
    column, first = by.columns[key], series[0]
    times, values = np.asarray(first.time, dtype=np.int64), np.asarray(first.value, dtype=float)
    zeros = 0
    if len(series) == 4:
        if any(not np.array_equal(times, other.time) for other in series):
            raise InputError(f"{where}: the four channels are not read at the same times; take them from one message")
        values = np.array([heading_of(*q) for q in zip(*(other.value for other in series), strict=True)])
        turned = np.isfinite(values)
        if not turned.any():
            raise InputError(f"{where}: all quaternions are 0, which is no heading; give other channels")
        times, values, zeros = times[turned], values[turned], int(np.sum(~turned))
    order, late = in_order(times) if first.stamped else (slice(None), 0)
    times, values = times[order], values[order]
    if kind_of(column.unit) == "increment":  # summed with those that are left out; that of the first came before it
        values = np.append(0.0, np.cumsum(values[1:]))
    track, left_out = Track.of(where, times - begin, values, first.held)
    missing = max(other.missing for other in series)
    left_out |= {"are no finite numbers": missing, "are quaternions of 0, which are no headings": zeros}
    for what, count in left_out.items():
        if count:
            of = f"{count} of {len(first.time) + missing} readings {what} and are left out"
            said.setdefault((column.source, of), []).append(key)
    if late:
        of = f"{late} of {len(times)} readings come after later ones and are put in the order of their stamps"
        said.setdefault((column.source, of), []).append(key)
    if column.wraps_at is not None:
        if (reach := np.ptp(track.value)) > column.wraps_at * (1 + ROUNDED):
            raise InputError(
                f"{where}.wraps_at: {column.wraps_at:g}, but the channel's values range over {reach:g}; a counter that "
                "wraps stays within that: mend or remove it"
            )
        track = track.unwrapped(column.wraps_at)
    return track.scaled(column.sign * column.scale)


def _counts(
    robot: RobotDescription, columns: LogColumns, by: ChannelMap, tracks: Mapping[str, Track]
) -> dict[str, Track]:
    """Return the tracks of wheels and pivots in counts, cumulative; pivots unwrapped where they stay within a turn."""
    found: dict[str, Track] = {}
    for key, k in zip(columns.wheel, robot.driven_wheels, strict=True):
        wheel, column, track = robot.wheels[k], by.columns[key], tracks[key]
        kind = kind_of(column.unit)
        track = track.integrated() if kind == "speed" else track
        track = track.scaled(counts_in(column.unit, wheel.counts_per_rev or 1.0, wheel.radius))
        found[key] = track.whole() if kind == "position" else track
    for key, i in zip(columns.pivot, robot.pivot_encoders, strict=True):
        turn = robot.castors[i].pivot_counts_per_rev or 1.0
        track = tracks[key].scaled(counts_in(by.columns[key].unit, turn))
        found[key] = track.unwrapped(turn) if np.ptp(track.value) <= turn else track
    return found


def _gyro(column: Column, track: Track, t: Array) -> Array:
    """Return yaw rates (K,), rad/s, at the rows' times t (K,), s: read as such, or from the angle that a gyro sums."""
    read = track.scaled(radians_in(column.unit))
    if column.unit not in GYRO_ANGLES:
        return read.mean_around(t)
    return read.unwrapped(2 * np.pi * column.scale).rate_around(t)


def _rows(counts: Mapping[str, Track], gyro: Track | None, notes: list[str]) -> Array:
    """Return the times (K,), s, of the log's rows: those of counts at which all counts, and the gyro, are known."""
    needed = dict(counts) | ({} if gyro is None else {"gyro_z": gyro})
    t = row_times(list(counts.values()))
    there = {key: np.isfinite(track.at(t)) for key, track in needed.items()}
    rows = np.all(list(there.values()), axis=0)
    if rows.sum() < 2:
        spans = ", ".join(f"{key} from {track.t[0]:.3f} to {track.t[-1]:.3f} s" for key, track in needed.items())
        raise InputError(
            f"no two rows have readings of all of: {spans}; times are since the first count: mend clocks or offsets"
        )
    for key, known in there.items():
        inner = ~known & (t > t[rows][0]) & (t < t[rows][-1])
        if inner.any():
            notes.append(f"{key}: no reading near {inner.sum()} of {len(t)} rows, which are left out")
    if not any(track.held for track in counts.values()):
        notes += _gap_notes(t[rows])
    return t[rows]


def _gap_notes(t: Array) -> Iterator[str]:
    """Yield a note on the longest gap between rows at times t (K,), s, and how many there are; nothing without any."""
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > max(GAP_STEPS * float(np.median(steps)), GAP))
    if len(gaps):
        k, more = int(np.argmax(steps)), f", the longest of {len(gaps)} gaps" if len(gaps) > 1 else ""
        said = f"none for {steps[k]:.3g} s after {t[k] - t[0]:.3f} s of the log{more}"
        yield f"rows: {said}: was the recording interrupted, or is it damaged?"


def _tracked(columns: LogColumns, by: ChannelMap, tracks: Mapping[str, Track], t: Array) -> TimedPoses | None:
    """Return the poses around the rows' times t (K,), s; None where the map has no reference. Of a map without ref_psi
    headings are NaN."""
    if columns.reference[0] not in tracks:
        return None
    parts = [tracks[key].scaled(LENGTHS[by.columns[key].unit]) for key in columns.reference[:2]]
    if (heading := columns.reference[2]) in tracks:
        parts.append(_heading(tracks[heading], by.columns[heading]))
    x, times = parts[0], reduce(np.intersect1d, [track.t for track in parts])
    if len(times) < 2:
        problem = "x, y and heading" if len(parts) == 3 else "x and y"
        raise InputError(f"{x.where}: {problem} are not taken at the same times; take them from one channel")
    pose = np.full((len(times), 3), np.nan)
    for k, track in enumerate(parts):
        pose[:, k] = track.value[np.searchsorted(track.t, times)]
    first, last = (np.searchsorted(times, t[0], "right") - 1, np.searchsorted(times, t[-1], "left") + 1)
    kept = slice(max(first, 0), last)
    if not ((times >= t[0]) & (times <= t[-1])).any():
        source = by.columns[columns.reference[0]].source
        file = by.places[source].file or "the recording"
        raise InputError(
            f"{x.where}: the reference in {file} is from {times[0]:.3f} to {times[-1]:.3f} s, counts are from "
            f"{t[0]:.3f} to {t[-1]:.3f} s; they share no time, so that their clocks are apart: give the source "
            f"{source!r} an 'offset', or another 'time'"
        )
    return TimedPoses(times[kept], pose[kept])


def _near_origin(
    tracked: TimedPoses | None, fix: Array | None, notes: list[str]
) -> tuple[TimedPoses | None, Array | None]:
    """Return poses and fixes without the whole metres of the first pose where all are far from the origin, as in UTM:
    further than from each other, or it is their unit that makes them far."""
    if tracked is None or not np.any(np.abs(tracked.pose[:, :2]) > FARTHEST):
        return tracked, fix
    x, y = origin = np.floor(tracked.pose[0, :2])
    if np.max(np.abs(origin)) <= np.max(np.ptp(tracked.pose[:, :2], axis=0)):
        return tracked, fix
    notes.append(
        f"reference: its positions are far from their origin, and {x:.0f} m is subtracted from ref_x, {y:.0f} m from "
        f"ref_y{', and from fixes too' if fix is not None else ''}; add that to have them back"
    )
    shift = np.append(origin, 0.0)
    return tracked._replace(pose=tracked.pose - shift), None if fix is None else fix - shift


def _fixes(
    columns: LogColumns, by: ChannelMap, tracks: Mapping[str, Track], t: Array
) -> tuple[Array | None, Array | None]:
    """Return fixes (K, 3) at the first row after each, NaN where none came, and their ages (K,), s; None without any.

    Of several between two rows the last one counts.
    """
    if columns.fix[0] not in tracks:
        return None, None
    of = {key: tracks[key] for key in columns.fix if key in tracks}
    times = t[:0] if not of else next(iter(of.values())).t
    for track in of.values():
        times = np.intersect1d(times, track.t)
    times = times[(times >= t[0]) & (times <= t[-1])]
    if not len(times):
        raise InputError(
            f"{tracks[columns.fix[0]].where}: no fix between the first and the last row has readings of all of "
            f"{', '.join(of)}; give the source an 'offset', or take them from one message"
        )
    rows, fix, age = np.searchsorted(t, times), np.full((len(t), 3), np.nan), np.full(len(t), np.nan)
    for k, key in enumerate(columns.fix):
        if key in of:
            unit = by.columns[key].unit
            factor = LENGTHS[unit] if unit in LENGTHS else 1.0 if unit == "quaternion" else radians_in(unit)
            fix[rows, k] = factor * of[key].value[np.searchsorted(of[key].t, times)]
    age[rows] = t[rows] - times
    return fix, age


def _heading(track: Track, column: Column) -> Track:
    """Return headings in rad, unwrapped; raises InputError where they are no robot's, as of degrees taken for rad."""
    read = track.scaled(1.0 if column.unit == "quaternion" else radians_in(column.unit))
    steps = np.abs(np.diff(read.value))
    psi = read.unwrapped(2 * np.pi)
    rate = float(np.percentile(np.abs(np.diff(psi.value)) / np.diff(psi.t), 95)) if len(steps) else 0.0
    doubt = f"is the unit {column.unit!r} right?"
    for k in np.flatnonzero(steps > 3 * np.pi)[:1]:  # a wrapped heading steps by a turn at most, and half of one
        raise InputError(f"{track.where}: the heading steps by {steps[k]:.3g} rad after {psi.t[k]:.3f} s; {doubt}")
    if rate > FASTEST_HEADING:
        raise InputError(f"{track.where}: the heading turns at {rate:.3g} rad/s; {doubt}")
    return psi


def _reference_notes(log: Log, tracked: TimedPoses, added: int) -> Iterator[str]:
    assert log.reference is not None
    known = int(np.isfinite(log.reference[:, 0]).sum())
    if known < len(log):
        rate = (len(tracked.t) - 1) / (tracked.t[-1] - tracked.t[0]) if len(tracked.t) > 1 else 0.0
        what = "positions" if np.isnan(tracked.pose[:, 2]).all() else "poses"
        yield f"reference: {len(tracked.t)} {what}, {rate:.3g} a second, near enough to {known} of {len(log)} rows"
    if added:
        yield f"reference: {added} poses are near no row; the log is read with rows at their times"


def _commands(
    robot: RobotDescription, names: tuple[str, ...], by: ChannelMap, tracks: Mapping[str, Track], t: Array
) -> Array | None:
    """Return commands (K, n), rad/s, as last given before each row; rows before the first are blank."""
    if not names or names[0] not in tracks:
        return None
    found = []
    for k, key in enumerate(names):
        if key.startswith("cmd_pivot"):
            factor = radians_in(
                by.columns[key].unit, robot.castors[robot.driven_castors[k]].pivot_counts_per_rev or np.nan
            )
        else:
            wheel = robot.wheels[robot.driven_wheels[k]]
            factor = radians_in(by.columns[key].unit, wheel.counts_per_rev or np.nan, wheel.radius)
        found.append(tracks[key].before(t) * factor)
    given = np.column_stack(found)
    return np.where(np.isfinite(given).all(axis=1, keepdims=True), given, np.nan)
