"""The command that makes logs of measurements: of published data, or of a recording of one's own robot."""

import json
import math
import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from castor_envs.errors import InputError, shortened
from castor_envs.files import writing
from castor_envs.logs import ChannelMap, guess_map, import_log, open_recording, survey, write_log
from castor_envs.logs.importers import import_sessions, importers
from castor_envs.logs.mapping.channel_map import UNDECIDED, Column, Source
from castor_envs.logs.mapping.guess import lacks_heading, possible_wheels
from castor_envs.logs.mapping.places import Places
from castor_envs.logs.mapping.said_units import says_unit
from castor_envs.logs.recordings import formats, recognised
from castor_envs.logs.recordings.recording import Clock, Found, Recording
from castor_envs.vehicles.load import load_robot, load_vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

PUBLISHED, LOG, MAP = Path("measured"), Path("log.csv"), Path("map.json")
"""Where things go unless told: the folder of published data, a log, a map to edit."""

DIGITS = 5
"""Of the lowest and the highest value of a channel."""

LONGEST = 400
"""Characters of a line that lists what is left out."""


def import_source(source: Path, robot: str | None, channel_map: Path | None, out: Path | None) -> None:
    """Import whatever a source is, and print what was done; raises InputError for what cannot be."""
    if recognised(source) is None and source.is_dir():
        if not any(importer.recognises(source) for importer in importers().values()):
            inside = next((path for path in sorted(source.iterdir()) if recognised(path) is not None), None)
            if inside is not None:
                raise InputError(f"{source}: is a folder; name a recording in it, such as {inside}")
            known = f"recordings ({', '.join(formats())}) and published data ({', '.join(importers())})"
            raise InputError(f"{source}: no importer recognises what is in it; known are {known}")
        if robot is not None or channel_map is not None:
            raise InputError(f"{source}: holds published data, which need no --robot and no --map; leave them out")
        _import_published(source, out or PUBLISHED)
    elif channel_map is not None:
        if robot is None:
            raise InputError("--map needs --robot: the robot that made the recording, a file or a preset's name")
        _import_mapped(source, robot, channel_map, out or LOG)
    else:
        _show(source, robot, out)


def _robot(spec: str) -> RobotDescription:
    if isinstance(load_vehicle(spec), TrainDescription):
        raise InputError(
            f"--robot {spec}: is a train, and recordings are imported for robots alone; the log of a train is a CSV "
            "file that your own program writes, with the columns that docs/formats.md has"
        )
    return load_robot(spec)


def _import_published(source: Path, out: Path) -> None:
    with writing(f"--out {out}"):
        for folder, session in import_sessions(source, out):
            print(f"{folder}: {session.vehicle.name}, {len(session.runs)} runs")


def _import_mapped(source: Path, robot: str, channel_map: Path, out: Path) -> None:
    described = _robot(robot)
    if not channel_map.exists():
        raise InputError(f"--map {channel_map}: no such file; without --map one is made to edit")
    by = ChannelMap.load(channel_map)
    others = [source.parent / place.file for place in by.sources.values() if place.file is not None]
    read = (source, channel_map, Path(robot), *others)
    if out.exists() and any(path.exists() and out.samefile(path) for path in read):
        raise InputError(f"--out {out}: is what is read, which would be lost; name another file")
    if out.exists():
        raise InputError(f"--out {out}: is there already; remove it or name another file")
    imported = import_log(source, described, by, str(channel_map))
    with writing(f"--out {out}"):
        try:
            write_log(out, imported.log, described, imported.tracked)
        except InputError as error:
            raise InputError(f"no log is written, for it would be refused: {error}") from None
    log, tracked = imported.log, imported.tracked
    poses = f"{0 if tracked is None else len(tracked.t)} reference poses"
    headless = tracked is not None and bool(np.isnan(tracked.pose[:, 2]).all())
    print(f"{out}: {len(log)} rows in {log.t[-1]:.1f} s, {poses}{', positions without headings' if headless else ''}")
    if begin := Decimal(round(imported.begin, -3)).scaleb(-9):  # to us, as doubles have times since 1970
        print(f"its t 0 is {begin.normalize():f} s of the recording")
    for note in imported.notes:
        print(f"note: {note}")
    print(f"next: {shlex.join(['castor-diagnose', 'inspect', str(out), '--robot', robot])}")


def _show(source: Path, robot: str | None, out: Path | None) -> None:
    """Print what a recording holds; write a map to edit where the robot is known and there is none yet."""
    described = None if robot is None else _robot(robot)
    recording = open_recording(source)
    clock = recording.clock()
    found = survey(recording, clock)
    _print_channels(source, recording, clock, found)
    if out is not None:
        print(f"note: without --map no log is made, and --out {out} is not used")
    if robot is None or described is None:
        print("next: give --robot, and a map is made that says which channel is which column of the log")
        return
    options = ("--robot", robot, "--map", str(MAP), "--out", str(out or LOG))
    following = f"next: {shlex.join(('castor-bench', 'import', str(source), *options))}"
    guessed = guess_map(found, clock, described)
    undecided = [key for key, column in guessed.columns.items() if UNDECIDED in column.channels]
    pose = {key: column for key, column in guessed.columns.items() if key.startswith("ref_")}
    if not possible_wheels(found):
        print("\nno channel can be a wheel's: poses and speeds of a body, as of odometry or TF, are no encoders")
        if pose:
            _show_reference(source, clock, pose)
        else:
            _show_remedies(source, bool(recording.left_out))
        return
    there = MAP.exists()
    if not there:
        guessed.save(MAP)
    state = "is there already, and is left alone; move it to have this one written" if there else "a map"
    print(f"\n{MAP}: {state}, guessed from names; check each line of it")
    _print_guess(guessed)
    if pose and all(key in pose or key in undecided for key in guessed.columns):
        print("note: no name says which channel is a wheel's; if none is, this is the reference of another recording")
    if lacks_heading(pose):
        print("note: no name says which channel is the heading of the reference; if one is, map it to ref_psi")
    if remark := Places(described).remark(guessed):
        print(f"note: {remark}")
    if there:
        misfit = _misfit(described, found)
        print(following if misfit is None else f"note: {misfit}")
        return
    todo = [f"replace each {UNDECIDED!r} by a channel or its unit"] if undecided else []
    if clock.period is not None:
        todo.append("give the time between rows, 's', as 'period', or a column as 'time'")
    if todo:
        print(f"next: edit {MAP}: {'; '.join(todo)}; then give --map {MAP}")
    else:
        print(following)


def _print_guess(guessed: ChannelMap) -> None:
    """Print a first map, a line for each column."""
    for key, column in guessed.columns.items():
        given = shortened(", ".join(column.channels))
        known = key in column.channels or all(says_unit(name, column.unit) for name in column.channels)
        source_of = "" if column.source == "main" else f", source {column.source!r}"
        unit = f"{column.unit}{'' if known else ', unit guessed'}{source_of}"
        if given == UNDECIDED:
            given = f"undecided, choose a channel{' and its unit' if column.unit == UNDECIDED else ''}"
        print(f"  {key}: {given}{'' if column.unit == UNDECIDED else f' ({unit})'}")


def _misfit(robot: RobotDescription, found: Mapping[str, Found]) -> str | None:
    """Return why the map that is there cannot be the one of a robot's recording, None where it can."""
    try:
        by = ChannelMap.load(MAP)
        here = {key for key, place in by.places.items() if place.file is None}
        channels = {name for column in by.columns.values() if column.source in here for name in column.channels}
        if absent := sorted(channels - {UNDECIDED, *found}):
            problem = f"does not fit this recording, which has no channel {', '.join(map(repr, absent))}"
            return shortened(f"{MAP}: {problem}", LONGEST)
        by.check(robot, str(MAP))
    except InputError as error:
        return str(error)
    return None


def _show_reference(source: Path, clock: Clock, pose: Mapping[str, Column]) -> None:
    """Print what to add to the map of another recording, of which this one is the reference."""
    place = Source.of(clock, source.name)
    added = ChannelMap(
        sources={"tracker": place}, columns={key: replace(column, source="tracker") for key, column in pose.items()}
    ).to_dict()
    print("this is the reference of another recording; add to the map of that one, with the path of this file as seen")
    print("from the folder of that one, and the 'offset' between their clocks, s:")
    if clock.period is not None:
        print(f"(for {UNDECIDED!r} the time between poses, s, or in its place a file of times as 'time')")
    for part in ("sources", "columns"):
        for key, value in added[part].items():
            print(f'  {part}: "{key}": {json.dumps(value)}')


def _show_remedies(source: Path, left_out: bool) -> None:
    """Print what can be done with a recording that has neither wheels nor a tracker's pose."""
    print(
        f"next: record the wheels too, as joint states or ticks{', or mend what is left out' if left_out else ''}; or,"
    )
    print("where a pose here was measured from outside, add it to the map of a recording of the wheels, as ref_... or")
    print(f"fix_..., of a source whose 'file' is {source.name}")


def _print_channels(source: Path, recording: Recording, clock: Clock, found: Mapping[str, Found]) -> None:
    """Print what each channel holds, what is none, and why; raises InputError where there is no channel at all."""
    left_out = _left_out(recording)
    if not found:
        without = "; ".join([f"{source}: {recording.kind} without numbers that can be read", *left_out])
        raise InputError(shortened(without, LONGEST))
    start, end = min(channel.start for channel in found.values()), max(channel.end for channel in found.values())
    by = f", by the clock {clock.time!r}" if clock.time is not None else ""
    if clock.period is not None:
        by = f" if there is one row every {clock.period:g} s, as nothing says; give the 'period', or 'time', in the map"
    print(f"{source}: {recording.kind}, {(end - start) / 1e9:.1f} s{by}")
    shown = {name: shortened(name) for name in sorted(found)}
    width = max(len(name) for name in (*shown.values(), "channel"))
    print(f"{'channel':{width}}  readings  a second      lowest     highest")
    for name, text in shown.items():
        channel = found[name]
        low, high = (f"{value:10.{_digits(channel)}g}" for value in (channel.low, channel.high))
        print(f"{text:{width}}  {channel.count:8}  {channel.rate:8.4g}  {low}  {high}")
    for line in (*left_out, *(f"note: {note}" for note in recording.notes)):
        print(shortened(line, LONGEST))


def _digits(channel: Found) -> int:
    """Return how many digits show the range of a channel's values: `DIGITS`, and those that both ends share."""
    apart, size = channel.high - channel.low, max(abs(channel.low), abs(channel.high))
    agree = math.floor(math.log10(size / apart)) if 0 < apart < size else 0
    return min(DIGITS + agree, sys.float_info.dig)


def _left_out(recording: Recording) -> list[str]:
    """Return what a recording holds beside its channels, a line for each reason."""
    of: dict[str, list[str]] = {}
    for name, why in sorted(recording.left_out.items()):
        of.setdefault(why, []).append(name)
    return [f"left out ({why}): {', '.join(names)}" for why, names in of.items()]
