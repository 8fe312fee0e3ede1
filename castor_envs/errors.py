"""The exceptions for what a user can mend, and what messages have in common: one line, never a traceback."""

import difflib
from collections.abc import Iterable

MOST_SHOWN = 200
"""Characters of a value or a message of someone else's that are shown: two to three lines of a terminal."""


class InputError(ValueError):
    """Something given to the program is wrong; the message says what, where and what to do."""


class Declined(InputError):  # noqa: N818 - a statement, not a mistake
    """An estimator or a calibration method states that it does not serve a robot, a train or recordings.

    The message says what it needs, as in ``raise Declined("needs free castors with two wheels each")``. Any other
    exception, a ValueError too, is a fault of the estimator or of what it was given.
    """


def shortened(text: object, most: int = MOST_SHOWN) -> str:
    """Return a text as one printable line of at most `most` characters, cut between words, an ellipsis at its end.

    A word that alone is longer is cut where it must be. What cannot be printed is shown as ``?``.
    """
    # Splitting a text of megabytes is slow; a few times what is shown holds all that can be shown of most.
    whole = str(text)
    words = whole[: 20 * most].split()
    line = "".join(character if character.isprintable() else "?" for character in " ".join(words))
    if len(line) <= most and len(whole) <= 20 * most:
        return line
    kept, space, _ = line[: most - 1].rpartition(" ")
    return (kept if space else line[: most - 2]) + " …"


def message_of(error: BaseException) -> str:
    """Return the message of someone else's exception as `shortened`, whatever it may hold."""
    try:
        return shortened(error)
    except Exception:
        return "its message cannot be shown"


def one_line(error: BaseException) -> str:
    """Return type and message of someone else's exception as one printable line."""
    text = message_of(error)
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known word nearest to `word`, or all known words."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known)}"
