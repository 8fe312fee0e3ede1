"""Descriptions (robots, floors) as JSON: validated, with a format name, and with errors that name the offending key."""

import hashlib
import json
import os
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from castor_envs.errors import InputError
from castor_envs.files import read_json, write_json

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector = tuple[float, float]
CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)

T = TypeVar("T")


def to_data(adapter: TypeAdapter[T], value: T, name: str) -> dict[str, Any]:
    """Return a description as plain data, its format's name first."""
    return {"format": name, **adapter.dump_python(value, mode="json")}


def from_data(adapter: TypeAdapter[T], data: Any, name: str, source: str) -> T:
    """Return the description in plain data of the format `name`; `source` names it in errors.

    Raises InputError that says which keys are wrong, and how.
    """
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected an object with 'format': {name!r}, got {type(data).__name__}")
    if data.get("format") != name:
        raise InputError(f"{source}: 'format' must be {name!r}, got {data.get('format')!r}")
    body = {key: value for key, value in data.items() if key != "format"}
    try:
        return adapter.validate_json(json.dumps(body), strict=True)
    except ValidationError as error:
        raise InputError(f"{source}: {explain(error)}") from None


def fingerprint(data: dict[str, Any]) -> str:
    """Return a hash of plain data but for its name, to know a description again."""
    body = {key: value for key, value in data.items() if key != "name"}
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()[:16]


def save(path: str | os.PathLike[str], data: dict[str, Any]) -> None:
    """Write plain data as JSON; the file is complete or not there."""
    write_json(Path(path), data)


def load(adapter: TypeAdapter[T], path: str | os.PathLike[str], name: str) -> T:
    """Read a description from a JSON file; raises InputError that names file and key."""
    return from_data(adapter, read_json(Path(path)), name, source=str(path))


class _Built(Protocol):
    def as_built(self) -> Any: ...


D = TypeVar("D", bound=_Built)


def with_possible_effects(described: D, source: str) -> D:
    """Return a robot or train read from `source`; raises InputError for an effect on what it does not have."""
    try:
        described.as_built()
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    except ValidationError as error:
        raise InputError(f"{source}: its effects together are too large: {explain(error)}") from None
    return described


def explain(error: ValidationError) -> str:
    """Say in one line what the first few problems are and where."""
    problems = []
    for item in error.errors()[:3]:
        where = ".".join(str(part) for part in item["loc"])
        message = item["msg"].removeprefix("Value error, ")
        given = item["input"]
        shown = "" if isinstance(given, dict | list | tuple) or item["type"] == "missing" else f", got {given!r:.80}"
        problems.append(f"{where}: {message}{shown}" if where else f"{message}{shown}")
    more = error.error_count() - len(problems)
    return "; ".join(problems) + (f"; and {more} more" if more > 0 else "")
