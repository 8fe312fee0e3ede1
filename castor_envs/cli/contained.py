"""Code of others in a command's own process: what it does on import leaves the command as it was.

Estimators, methods and tasks run in processes of their own (`castor_envs.processes`); a command loads them too, to know
their names and sources.
"""

import atexit
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import NoReturn, TextIO

_loaded: list[bool] = []
"""Holds something once code of others has run in this process."""


@contextmanager
def contained() -> Iterator[None]:
    """Drop what code within prints to stdout, and put back afterwards what belongs to the command.

    That is stdout and stderr, the current folder, and what Ctrl-C does.
    """
    _loaded.append(True)
    streams, folder, handler = (sys.stdout, sys.stderr), _folder(), signal.getsignal(signal.SIGINT)
    try:
        with _descriptor_dropped():
            sys.stdout = _nowhere()
            try:
                yield
            finally:
                sys.stdout, sys.stderr = streams
    finally:
        if folder is not None:
            with contextlib.suppress(OSError):
                os.chdir(folder)
        if threading.current_thread() is threading.main_thread() and handler is not None:
            signal.signal(signal.SIGINT, handler)


def leave(code: int) -> NoReturn:
    """End this process: at once where code of others was loaded, whose threads and processes may never end."""
    if not _loaded:
        sys.exit(code)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(code)


@contextmanager
def _descriptor_dropped() -> Iterator[None]:
    """Let nothing written to file descriptor 1 come through, not even by libraries in C."""
    _flush()
    try:
        kept = os.dup(1)
    except OSError:  # it is closed
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        _flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _flush() -> None:
    """Write what is buffered for stdout, by whatever name."""
    for stream in (sys.stdout, sys.__stdout__):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            if stream is not None:
                stream.flush()


@cache
def _nowhere() -> TextIO:
    """Return a stream that drops everything; it stays open to the end, as code of others may keep it."""
    stream = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - a context would close it
    atexit.register(stream.close)
    return stream


def _folder() -> str | None:
    """Return the current folder, None where it has been removed."""
    try:
        return os.getcwd()
    except OSError:
        return None
