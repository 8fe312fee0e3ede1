"""Stored files: NPZ and JSON with metadata of a known format, written whole or not at all, checked when read."""

import io
import json
import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from castor_envs.description import explain
from castor_envs.files import write_atomically

M = TypeVar("M")

LONGEST_REASON = 200
"""Characters: what is wrong with a file fits into two lines of a terminal, however long the names in it are."""


class CorruptFileError(Exception):
    """A stored file cannot be used; `path` is the file, `reason` what is wrong with it, in one line."""

    def __init__(self, path: Path, reason: str):
        self.path, self.reason = path, textwrap.shorten(reason, LONGEST_REASON, placeholder=" ...")
        super().__init__(f"{path}: {self.reason}")


class OlderFormatError(CorruptFileError):
    """A stored file is of an older version of its format, `form`."""

    def __init__(self, path: Path, form: str):
        super().__init__(path, f"is of the older format {form}")
        self.form = form


def write_archive(path: Path, adapter: TypeAdapter[M], metadata: M, arrays: Mapping[str, NDArray]) -> None:
    """Write arrays and metadata as one NPZ file; the metadata is the array ``metadata``, JSON in a string."""
    buffer = io.BytesIO()
    text = json.dumps(adapter.dump_python(metadata, mode="json"), allow_nan=False)
    members: dict[str, Any] = {"metadata": np.array(text), **arrays}
    np.savez_compressed(buffer, **members)
    write_atomically(path, buffer.getvalue())


def read_archive(path: Path, form: str, adapter: TypeAdapter[M]) -> tuple[M, dict[str, NDArray]]:
    """Return metadata and arrays of a file of a format.

    Raises CorruptFileError if it is incomplete, damaged, of another format (OlderFormatError: of an older version of
    this one) or holds metadata that `adapter` refuses; FileNotFoundError if it is not there.
    """
    return _read(path, form, adapter, with_arrays=True)


def read_metadata(path: Path, form: str, adapter: TypeAdapter[M]) -> M:
    """Return the metadata alone; raises as `read_archive`, for damage that shows in them."""
    return _read(path, form, adapter, with_arrays=False)[0]


def checked(path: Path, text: str, form: str, adapter: TypeAdapter[M]) -> M:
    """Return metadata in JSON, of a format, as what `adapter` describes; strict: no text is taken for a number.

    Raises CorruptFileError for any other text.
    """
    try:
        found = json.loads(text)["format"]
    except (ValueError, TypeError, LookupError, RecursionError):
        raise CorruptFileError(path, "is damaged or incomplete") from None
    if found != form:
        if isinstance(found, str) and _older(found, form):
            raise OlderFormatError(path, found)
        raise CorruptFileError(path, f"is not of the format {form!r}")
    try:
        return adapter.validate_json(text, strict=True)
    except ValidationError as error:
        raise CorruptFileError(path, explain(error)) from None


def _older(found: str, form: str) -> bool:
    name, _, version = form.rpartition("/")
    match = re.fullmatch(re.escape(name) + r"/([1-9][0-9]{0,3})", found, re.ASCII)
    return match is not None and int(match[1]) < int(version)


def _read(path: Path, form: str, adapter: TypeAdapter[M], with_arrays: bool) -> tuple[M, dict[str, NDArray]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            text = str(archive["metadata"])
            names = [name for name in archive.files if with_arrays and name != "metadata"]
            arrays = {name: archive[name] for name in names}
    except FileNotFoundError:
        raise
    except Exception:  # on damaged bytes zipfile, zlib and NumPy raise many kinds of error, MemoryError too
        raise CorruptFileError(path, "is damaged or incomplete") from None
    return checked(path, text, form, adapter), arrays
