"""Lines of text files in the codings that programs write: UTF-8, UTF-16 with its mark, Windows-1252 as what is left."""

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

from castor_envs.errors import InputError
from castor_envs.logs.table import complaint

OTHER_CODING = "is not all UTF-8: other lines are read as Windows-1252; save it as UTF-8 if names look wrong"
TAIL = "bytes of 0 at its end are left out, as where power was lost"

_UNDECODED = re.compile("[\ud800-\udfff]")
"""What stands for bytes that are no UTF-8."""


def numbered_lines(path: Path, notes: list[str]) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file and their numbers, from 1, one in memory at a time.

    A line that is no UTF-8 is taken for Windows-1252, which `notes` then says once, and so it does of bytes of 0 at
    the end, which are left out. Raises InputError for what cannot be read or is no text.
    """
    try:
        with path.open("rb") as file:
            wide = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        coding, errors = ("utf-16", "strict") if wide else ("utf-8-sig", "surrogateescape")
        with path.open(encoding=coding, errors=errors, newline="") as text:
            for k, line in enumerate(text, start=1):
                if line.endswith("\0"):  # the last one
                    whole = line.rstrip("\0")
                    _say_once(notes, f"{path.name}: {len(line) - len(whole)} {TAIL}")
                    line = whole
                if "\0" in line:
                    raise complaint(
                        path, k, None, "is no text, by a byte of 0; give a file of text, or remove what is damaged"
                    )
                if not line.isascii() and _UNDECODED.search(line):
                    line = line.encode("utf-8", "surrogateescape").decode("cp1252", "replace")
                    _say_once(notes, f"{path.name}: {OTHER_CODING}")
                if line:
                    yield k, line
    except OSError as error:
        raise complaint(path, None, None, f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise complaint(path, None, None, "is damaged: no text in UTF-16, as its first bytes say") from None


def _say_once(notes: list[str], said: str) -> None:
    if said not in notes:
        notes.append(said)


def is_comment(line: str) -> bool:
    """Return whether a line is left out of the rows of a table."""
    return line.lstrip().startswith("#")


def first_row(path: Path) -> list[str] | None:
    """Return the cells of the first line that is no comment, split at blanks; None for what is no text."""
    try:
        lines = (line for _, line in numbered_lines(path, []))
        return next((line.split() for line in lines if line.strip() and not is_comment(line)), None)
    except InputError:
        return None
