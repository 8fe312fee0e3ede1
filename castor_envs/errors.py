"""The one exception for mistakes a user can mend: shown as one line, never as a traceback."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """Something given to the program is wrong; the message says what, where and what to do."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known word nearest to `word`, or all known words."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known)}"
