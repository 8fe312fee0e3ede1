"""What all console scripts share: a user's mistake is one line on stderr and exit code 2, never a traceback."""

import importlib.metadata
import os
import sys
from typing import Annotated, NoReturn

import typer

from castor_envs.errors import InputError


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"castor-envs {importlib.metadata.version('castor-envs')}")
        raise typer.Exit


#: The option --version of every script.
Version = Annotated[
    bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
]


def run(app: typer.Typer, arguments: list[str] | None = None) -> NoReturn:
    """Run an app with the given arguments, or those of the process, and exit with its code."""
    try:
        code = app(arguments, standalone_mode=False)
        sys.stdout.flush()
    except InputError as error:
        code = _explain(str(error))
    except BrokenPipeError:
        # The reader of the output went away; what is left in the buffer has nowhere to go at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except (typer.Abort, KeyboardInterrupt):
        code = 130
    except Exception as error:
        # Typer's usage errors are click's, whose home differs between versions of Typer.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        code = _show_help(message()) if type(error).__name__ == "NoArgsIsHelpError" else _explain(message())
    sys.exit(code if isinstance(code, int) else 0)


def _show_help(text: str) -> int:
    """Print the help of a script called without arguments, unless Typer, where it formats with rich, has done so."""
    if text.strip():
        print(text)
    return 2


def _explain(message: str) -> int:
    print("error:", " ".join(message.splitlines()), file=sys.stderr)
    return 2
