"""What all console scripts share: errors are reported in one line on stderr, Ctrl-C ends at once with code 130.

Exit codes: 0 for success; 1 for an unexpected error, a full disk, or a failure that the command itself reports; 2 for a
user's mistake; 130 after Ctrl-C. ``--traceback``, anywhere on the command line, shows an error's traceback too.
What stdout cannot write, as where Windows sends it to a file, is ``-`` for dashes and minus signs, else ``?``.
"""

import codecs
import contextlib
import errno
import io
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer

from castor_envs import __version__
from castor_envs.cli.commands import Commands
from castor_envs.cli.contained import leave
from castor_envs.errors import InputError, message_of, printable
from castor_envs.files import remove_partial_folders
from castor_envs.shadowed import is_explained

TRACEBACK = "--traceback"
INTERRUPTED = 130
"""The exit code after Ctrl-C, as shells have it: 128 and the signal's number."""
FULL = {errno.ENOSPC, errno.EFBIG, errno.EDQUOT}
"""Error numbers of the system for no space left: disk full, file too large, user's quota used up."""
HYPHENS = "\N{MINUS SIGN}\N{EN DASH}"
"""Characters for which a hyphen stands where stdout cannot write them: a number keeps its sign."""

_kept: list[str] = []
_endings: list[Callable[[], None]] = []


def _show_version(value: bool) -> None:
    if value:
        print(f"castor-envs {__version__}")
        raise typer.Exit


#: The option --version of every script.
Version = Annotated[
    bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
]
#: The option --traceback of every script; `run` takes it from anywhere on the command line.
Traceback = Annotated[bool, typer.Option(TRACEBACK, help="Show the whole traceback of an error; goes anywhere.")]


def new_app(commands: type[Commands]) -> typer.Typer:
    """Return the app of a console script: all of them show help in one style."""
    return typer.Typer(
        cls=commands,
        context_settings={"help_option_names": ["-h", "--help"]},
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )


@contextmanager
def keeping(notice: str) -> Iterator[None]:
    """Print `notice` (what is kept, how to continue) if the command is stopped or fails inside this context."""
    _kept.append(notice)
    yield
    _kept.pop()  # not after an exception: `run` prints the notice then


def print_in_utf8(text: str) -> None:
    """Print a text that says itself that it is in UTF-8, whatever the locale."""
    _reconfigure("utf-8")
    print(text, end="")


@contextmanager
def ending_with(ending: Callable[[], None]) -> Iterator[None]:
    """Call a function when this context ends, also where Ctrl-C ends the script at once."""
    _endings.append(ending)
    try:
        yield
    finally:
        _endings.pop()
        ending()


def main(app: typer.Typer) -> NoReturn:
    """Run an app as a console script, and end its process; a program of others calls `run`.

    Ctrl-C ends the process at once, wherever it is, instead of raising KeyboardInterrupt, which clean-up code may
    swallow or block. Worker processes end by themselves when their parent is gone (`castor_envs.processes`), and files
    are written whole or not at all (`castor_envs.files`).
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as in a script's background job
        signal.signal(signal.SIGINT, _stop)
    try:
        run(app)
    except SystemExit as leaving:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        leave(leaving.code if isinstance(leaving.code, int) else 0)
    finally:
        # Only the interpreter's shutdown is left, which Ctrl-C would disturb.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def run(app: typer.Typer, arguments: list[str] | None = None) -> NoReturn:
    """Run an app with the given arguments, or those of the process, and exit with its code."""
    _kept.clear()
    _reconfigure(None)
    given = sys.argv[1:] if arguments is None else arguments
    options = given[: given.index("--")] if "--" in given else given
    with_traceback = TRACEBACK in options
    given = [argument for argument in options if argument != TRACEBACK] + given[len(options) :]
    try:
        code = app(given, standalone_mode=False)
        if code == INTERRUPTED:  # Typer has caught Ctrl-C
            raise KeyboardInterrupt
        sys.stdout.flush()
    except (typer.Abort, KeyboardInterrupt):
        print(_stopped(), file=sys.stderr)
        code = INTERRUPTED
    except BaseException as error:
        if with_traceback and isinstance(error, Exception):
            traceback.print_exc()
        code = _explained(error, with_traceback)
    sys.exit(code if isinstance(code, int) else 0)


def _reconfigure(encoding: str | None) -> None:
    """Let stdout write any text, in an encoding or its own, unless something that is no file stands for it."""
    codecs.register_error("plainer", _plainer)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(encoding=encoding, errors="plainer")


def _plainer(error: UnicodeError) -> tuple[str, int]:
    """Return what is written for characters that an encoding lacks, and where to go on: a handler of `codecs`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join("-" if character in HYPHENS else "?" for character in lacking), error.end


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    """End this process for Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(Exception):
        show_cursor = "\x1b[?25h\n" if os.isatty(2) else ""  # a progress bar hides it
        os.write(2, f"{show_cursor}{_stopped()}\n".encode())
    for ending in (*reversed(_endings), remove_partial_folders):
        with contextlib.suppress(Exception):
            ending()
    os._exit(INTERRUPTED)


def _stopped() -> str:
    return "; ".join(["stopped", *_kept])


def _explained(error: BaseException, traceback_shown: bool) -> int:
    """Print an error in one line; return the exit code. traceback_shown: whether it is printed already."""
    if is_explained(error):
        return 2
    if isinstance(error, InputError):
        return _complain(str(error), 2)
    if isinstance(error, BrokenPipeError):
        # The reader of the output went away.
        _drop_output()
        return 1
    # Typer's usage errors are click's, whose import path differs between versions of Typer.
    message = getattr(error, "format_message", None)
    if message is not None:
        kind = type(error).__name__
        if kind == "NoArgsIsHelpError":
            return _show_help(message(), traceback_shown)
        context: Any = getattr(error, "ctx", None)
        hint = f" See {context.command_path} --help." if kind == "MissingParameter" and context is not None else ""
        return _complain(f"{message()}{hint}", 2)
    if not isinstance(error, Exception):
        raise error
    kept = "".join(f"; {notice}" for notice in _kept)
    hint = "" if traceback_shown else f"; run again with {TRACEBACK} to see where it comes from"
    if isinstance(error, OSError):
        _drop_output()
        place = f"{error.filename}: " if error.filename else ""
        problem = place + (error.strerror or message_of(error))
        return _complain(f"{problem}; make room{kept}" if error.errno in FULL else f"{problem}{kept}{hint}", 1)
    return _complain(f"unforeseen {type(error).__name__}: {message_of(error) or 'without a message'}{kept}{hint}", 1)


def _drop_output() -> None:
    """Flush stdout, or send its buffer to the null device, so that flushing at exit cannot fail."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_help(text: str, traceback_shown: bool) -> int:
    """Print the help of a script called without arguments, unless Typer, where it formats with rich, has done so."""
    try:
        print(text.strip() and f"{text}\n", end="", flush=True)
    except OSError as error:  # the reader has gone, or the disk is full
        return _explained(error, traceback_shown)
    return 2


def _complain(message: str, code: int) -> int:
    print("error:", printable(" ".join(message.splitlines())), file=sys.stderr)
    return code
