"""Recordings of real robots, of any program: each module of this folder that defines a `FORMAT` reads one kind."""

import os
from pathlib import Path

from castor_envs.discovery import offers
from castor_envs.errors import InputError
from castor_envs.logs.recordings import csv_table
from castor_envs.logs.recordings.recording import Recording, RecordingFormat


def formats() -> dict[str, RecordingFormat]:
    """Return all kinds of recording by name."""
    return {known.name: known for known in offers(__name__, "FORMAT")}


def recognised(source: str | os.PathLike[str]) -> RecordingFormat | None:
    """Return the kind of recording that a path is, None for no known one."""
    return next((known for known in formats().values() if known.recognises(Path(source))), None)


def refuse_recording(path: Path) -> None:
    """Raise InputError for a recording that is given in a log's place; CSV files may be logs."""
    found = recognised(path)
    if found is not None and found != csv_table.FORMAT:
        raise InputError(f"{path}: is a recording, {found.name}, not a log; castor-bench import makes a log of it")


def open_recording(source: str | os.PathLike[str]) -> Recording:
    """Open a recording; raises InputError where there is none, an empty one or of no known kind, or the library for it
    is absent."""
    if not Path(source).exists():
        raise InputError(f"{source}: no such file or folder; give a recording")
    if Path(source).is_file() and not Path(source).stat().st_size:
        raise InputError(f"{source}: is empty; copy it again, or record it again")
    found = recognised(source)
    if found is None:
        raise InputError(f"{source}: is no known kind of recording; known: {', '.join(formats())}")
    return found.open(Path(source))
