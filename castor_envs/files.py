"""Writing files so that they are whole or not there, and reading them with clear errors."""

import contextlib
import errno
import glob
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from castor_envs.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LEFT_OVER = 3600.0
"""s: age from which a temporary file that cannot be locked counts as left over. No file takes so long to write."""

_TEMPORARY = re.compile(r"\..+\.[a-z0-9_]{8}\.tmp")
"""Names of temporary files: a dot, the name of the final file, and what `tempfile` adds."""


def write_atomically(path: Path, content: str | bytes | Iterator[str]) -> None:
    """Write a file by way of a temporary one beside it, so that it is never half there.

    content: an iterator's pieces are written one after another, so that they are never all in memory.

    The temporary file is locked as long as its writer lives, so that `remove_leftovers` recognises the files of writers
    that were killed. Raises OSError that names `path`.
    """
    pieces = iter((content,)) if isinstance(content, str | bytes) else content
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = _locked_temporary(path)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.writelines(piece.encode() if isinstance(piece, str) else piece for piece in pieces)
                file.flush()
                os.fsync(file.fileno())
                os.chmod(temporary, 0o644)
                if fcntl is not None:
                    os.replace(temporary, path)
            if fcntl is None:  # Windows renames no open file
                os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextlib.contextmanager
def writing(named: str) -> Iterator[None]:
    """Turn what the system says of a file that cannot be written into an InputError; named: an option and its path."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{named}: cannot be written to ({error.strerror or error})") from None


def check_new_folder(out: Path) -> None:
    """Raise InputError where a folder that the option --out leads to is there already."""
    if out.exists() or out.is_symlink():
        raise InputError(f"--out {out}: is there already; name a new folder")


def check_writable(path: Path) -> None:
    """Raise OSError for a file that could not be written, before the work of which it is to hold the result.

    Leaves nothing: a folder that is not there is made only to see whether it can be.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    made = [folder for folder in path.parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
        os.close(descriptor)
        os.unlink(temporary)
    finally:
        for folder in made:
            with contextlib.suppress(OSError):  # of what was not made, or is filled meanwhile
                folder.rmdir()


@contextlib.contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Give a folder to fill that becomes `out` at the end; after an error or Ctrl-C nothing is left of it.

    What a killed process left of the same folder is removed first. Raises InputError where `out`, named by the option
    --out, exists already or cannot be written.
    """
    check_new_folder(out)
    for left in out.parent.glob(f".{glob.escape(out.name)}.*.partial"):
        with contextlib.suppress(OSError):
            _remove_if_left_over(left)
    partial = out.with_name(f".{out.name}.{os.getpid()}.partial")
    lock = None
    _partial.add(partial)
    try:
        with writing(f"--out {out}"):
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir(parents=True)
            lock = _locked_folder(partial)
            yield partial
            partial.rename(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        _partial.discard(partial)
        if lock is not None:
            os.close(lock)


_partial: set[Path] = set()
"""Folders of `new_folder` that are being filled."""


def remove_partial_folders() -> None:
    """Remove the folders that this process is filling: for a script that ends at once, without cleaning up."""
    for folder in list(_partial):
        shutil.rmtree(folder, ignore_errors=True)


def _locked_folder(folder: Path) -> int | None:
    """Lock a folder as long as this process lives; return the descriptor, None where folders have no locks."""
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    with contextlib.suppress(OSError):  # of a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


def _locked_temporary(path: Path) -> tuple[int, str]:
    """Make a temporary file beside `path` and lock it; return its descriptor and its name."""
    while True:
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
        if fcntl is None:
            return descriptor, temporary
        with contextlib.suppress(OSError):  # of a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            return descriptor, temporary
        os.close(descriptor)  # taken for left over before it was locked


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files in a folder whose writers were killed; those being written stay."""
    for path in folder.glob(".*.tmp"):
        if _TEMPORARY.fullmatch(path.name):
            with contextlib.suppress(OSError):
                _remove_if_left_over(path)


def _remove_if_left_over(path: Path) -> None:
    """Remove a temporary file or folder that nobody is writing; raises OSError if it cannot be checked or removed."""
    remove = shutil.rmtree if path.is_dir() and not path.is_symlink() else Path.unlink
    if fcntl is not None:
        access = os.O_RDWR if remove is Path.unlink else os.O_RDONLY
        descriptor = os.open(path, access | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            remove(path)
            return
        except BlockingIOError:
            return
        except OSError:  # a file system without locks
            pass
        finally:
            os.close(descriptor)
    if time.time() - path.lstat().st_mtime > LEFT_OVER:
        remove(path)


def digest_of(folder: Path) -> str:
    """Return a hash of the names and contents of all files in a folder and in those in it; raises OSError."""
    seen = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        for part in (path.relative_to(folder).as_posix().encode(), path.read_bytes()):
            seen.update(len(part).to_bytes(8, "little") + part)
    return seen.hexdigest()[:16]


def write_json(path: Path, data: Any) -> None:
    """Write data as JSON that people can read; raises ValueError for numbers that JSON does not have."""
    write_atomically(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Return a JSON file's content; raises InputError that says why it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_object)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text in UTF-8; save it as UTF-8") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON ({error}); mend it there") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object; raises ValueError for a key that stands twice, where JSON would silently take the last."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)!r} stands twice in one object")
    return found
