"""NPZ files with their metadata inside: written whole or not at all, read without pickles, checked when read."""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.files import write_atomically


class CorruptFileError(Exception):
    """A stored file cannot be read; `path` is the file."""

    def __init__(self, path: Path, what: str):
        super().__init__(f"{path}: {what}")
        self.path = path


def write_archive(path: Path, metadata: Mapping[str, Any], arrays: Mapping[str, NDArray]) -> None:
    """Write arrays and JSON metadata as one NPZ file; the metadata is the array ``metadata``, a string."""
    buffer = io.BytesIO()
    members: dict[str, Any] = {"metadata": np.array(json.dumps(metadata, allow_nan=False)), **arrays}
    np.savez_compressed(buffer, **members)
    write_atomically(path, buffer.getvalue())


def read_archive(path: Path, form: str) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Return metadata and arrays of a file of a format.

    Raises CorruptFileError if it is incomplete, damaged or of another format, FileNotFoundError if it is not there.
    """
    return _read(path, form, with_arrays=True)


def read_metadata(path: Path, form: str) -> dict[str, Any]:
    """Return the metadata alone; raises as `read_archive`, for damage that shows in them."""
    return _read(path, form, with_arrays=False)[0]


def _read(path: Path, form: str, with_arrays: bool) -> tuple[dict[str, Any], dict[str, NDArray]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            metadata = json.loads(str(archive["metadata"]))
            names = [name for name in archive.files if with_arrays and name != "metadata"]
            arrays = {name: archive[name] for name in names}
    except FileNotFoundError:
        raise
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error, NotImplementedError):
        raise CorruptFileError(path, "is damaged or incomplete") from None
    if not isinstance(metadata, dict) or metadata.get("format") != form:
        raise CorruptFileError(path, f"is not of the format {form!r}")
    return metadata, arrays
