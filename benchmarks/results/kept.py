"""What many files say, kept in one file beside them, so that each is opened once; that file may be deleted.

FOLDER/summary.json   what was read from the NPZ files below FOLDER, by their path in it, size and time of change
"""

import contextlib
import gc
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pydantic_core import from_json  # twice as fast as json

from castor_envs.files import write_atomically

SUMMARY = "summary.json"


def kept_beside(folder: Path, form: str, read: Callable[[Path], list[Any] | None]) -> dict[str, list[Any]]:
    """Return what `read` finds in each NPZ file of a folder and of the folders in it, by path there, in order.

    What it found holds as long as a file's time of change (ns) and size stay the same; they come first in each list.
    read: returns what JSON can hold, or None for a file that cannot be used, which is read again each time. form: of
    what is read; what is kept of another form does not count.
    """
    with _without_collection():
        kept, found = _kept(folder / SUMMARY, form), {}
        for file in _archives(str(folder)):
            status, key = file.stat(), file.path[len(str(folder)) + 1 :]
            entry = kept.get(key)
            if entry is not None and entry[0] == status.st_mtime_ns and entry[1] == status.st_size:
                found[key] = entry
            elif (content := read(Path(file.path))) is not None:
                found[key] = [status.st_mtime_ns, status.st_size, *content]
    if found != kept:
        with contextlib.suppress(OSError):  # of a folder that may only be read
            write_atomically(folder / SUMMARY, json.dumps({"format": form, "files": found}, separators=(",", ":")))
    return found


def _archives(folder: str) -> Iterator[os.DirEntry[str]]:
    """Yield the NPZ files of a folder and of the folders in it, in order; no temporary ones."""
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except FileNotFoundError:
        return
    for entry in entries:
        if entry.name.endswith(".npz"):
            if not entry.name.startswith("."):
                yield entry
        elif entry.is_dir():
            yield from _archives(entry.path)


@contextlib.contextmanager
def _without_collection() -> Iterator[None]:
    """Look for no cyclic garbage meanwhile: of 1e5 rows that takes as long as reading them, and they hold none."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _kept(path: Path, form: str) -> dict[str, list[Any]]:
    """Return what is kept of files, nothing if it is not there or cannot be used."""
    try:
        stored = from_json(path.read_bytes())
        files = stored["files"] if stored["format"] == form else {}
        # Time and size come first in each list, so that one without them belongs to no file.
        return files if all(isinstance(entry, list) and len(entry) > 2 for entry in files.values()) else {}
    except (OSError, ValueError, TypeError, LookupError, AttributeError):
        return {}
