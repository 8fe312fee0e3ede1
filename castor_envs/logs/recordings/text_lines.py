"""Lines of text files in the codings that programs write: UTF-8, UTF-16 with its mark, Windows-1252 as what is left."""

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

from castor_envs.errors import InputError
from castor_envs.logs.table import complaint

OTHER_CODING = "is not all UTF-8: other lines are read as Windows-1252; save it as UTF-8 if names look wrong"

_UNDECODED = re.compile("[\ud800-\udfff]")
"""What stands for bytes that are no UTF-8."""


def numbered_lines(path: Path, notes: list[str]) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file and their numbers, from 1, one in memory at a time.

    A line that is no UTF-8 is taken for Windows-1252, which `notes` then says once. Raises InputError for what cannot
    be read or is no text.
    """
    said = f"{path.name}: {OTHER_CODING}"
    try:
        with path.open("rb") as file:
            wide = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        coding, errors = ("utf-16", "strict") if wide else ("utf-8-sig", "surrogateescape")
        with path.open(encoding=coding, errors=errors, newline="") as text:
            for k, line in enumerate(text, start=1):
                if "\0" in line:
                    raise complaint(path, k, None, "is no text; give a file of text")
                if not line.isascii() and _UNDECODED.search(line):
                    line = line.encode("utf-8", "surrogateescape").decode("cp1252", "replace")
                    if said not in notes:
                        notes.append(said)
                yield k, line
    except OSError as error:
        raise complaint(path, None, None, f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise complaint(path, None, None, "is damaged: no text in UTF-16, as its first bytes say") from None


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
