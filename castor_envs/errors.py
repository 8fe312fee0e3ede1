"""The one exception for mistakes a user can mend: shown as one line, never as a traceback."""

import difflib
from collections.abc import Iterable

from pydantic import ValidationError


class InputError(ValueError):
    """Something given to the program is wrong; the message says what, where and what to do."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known word nearest to `word`, or all known words."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known)}"


def explain(error: ValidationError, whole: str) -> str:
    """Say in one line what the first few problems are and where; `whole` names the thing that was validated."""
    problems = []
    for item in error.errors()[:3]:
        where = ".".join(str(part) for part in item["loc"]) or whole
        message = item["msg"].removeprefix("Value error, ")
        given = item["input"]
        shown = (
            "" if isinstance(given, dict | list | tuple) or item["type"] == "missing" else f", got {given!r}"
        )
        problems.append(f"{where}: {message}{shown}")
    more = error.error_count() - len(problems)
    return "; ".join(problems) + (f"; and {more} more" if more > 0 else "")
