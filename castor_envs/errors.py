"""The exceptions for mistakes that a user can correct, and how all messages are formed: one line, never a traceback."""

import difflib
import numbers
from collections.abc import Iterable
from typing import Any

MOST_SHOWN = 200
"""Characters shown of a given value, or of a message from other code: two to three lines of a terminal."""


class InputError(ValueError):
    """Something given to the program is wrong; the message says what, where and what to do."""


class Declined(InputError):  # noqa: N818 - a statement, not a mistake
    """An estimator or a calibration method states that it does not serve a robot, a train or recordings.

    The message says what it needs, as in ``raise Declined("needs free castors with two wheels each")``. Any other
    exception, a ValueError too, is a fault of the estimator or of what it was given.
    """


def whole_number(value: Any, title: str, least: int = 1) -> int:
    """Return a given whole number of at least `least`; raises InputError for anything else, such as True or "1"."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise InputError(f"{title} must be a whole number of at least {least}, got {shortened(repr(value), 60)}")
    return int(value)


def with_extra(extra: str) -> str:
    """Return what to type for the packages of an extra."""
    return f"pip install '.[{extra}]' in the project's folder"


def printable(text: str) -> str:
    """Return a text with ``?`` for each character that cannot be printed: those that command terminals, too."""
    return "".join(character if character.isprintable() else "?" for character in text)


def shortened(text: object, limit: int = MOST_SHOWN) -> str:
    """Return a text as one printable line of at most `limit` characters, cut between words, an ellipsis at its end.

    A single word that is longer is cut anywhere. What cannot be printed is shown as ``?``.
    """
    # Splitting a text of megabytes is slow, and 20 times the limit contains all that can be shown of nearly any text.
    full = str(text)
    words = full[: 20 * limit].split()
    line = printable(" ".join(words))
    if len(line) <= limit and len(full) <= 20 * limit:
        return line
    kept, space, _ = line[: limit - 1].rpartition(" ")
    return (kept if space else line[: limit - 2]) + " …"


def message_of(error: BaseException) -> str:
    """Return the message of an exception from other code as `shortened`, whatever it may hold."""
    try:
        return shortened(error)
    except Exception:
        return "its message cannot be shown"


def one_line(error: BaseException) -> str:
    """Return type and message of an exception from other code as one printable line."""
    text = message_of(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known word nearest to `word`, or the known words, of many the first."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {shortened(', '.join(known), 3 * MOST_SHOWN)}"
