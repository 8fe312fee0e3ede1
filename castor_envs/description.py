"""Descriptions (robots, floors) as JSON: validated, with a format name, and with errors that name the offending key."""

import hashlib
import json
import os
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError

from castor_envs.errors import InputError, shortened
from castor_envs.files import read_json, write_json

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, defer_build=True)

#: The smallest length of a part, m: a micrometre, finer than anything on wheels is made.
FINEST = 1e-6


def _nothing_or_made(length: float) -> float:
    if 0 < length < FINEST:
        raise ValueError(f"Input should be 0, or greater than or equal to {FINEST:g}")
    return length


# Bounds of the numbers in files. Each is far beyond anything that rolls, yet products and squares of numbers within
# bounds neither overflow nor underflow: a wrong unit or a typing error is refused when the file is read, not later by
# the physics. SI units and radians.
#
#: A length of a robot's part, up to a kilometre; 0 only where a part may be without it (`LengthOrNone`).
Length = Annotated[float, Field(ge=FINEST, le=1e3)]
LengthOrNone = Annotated[float, Field(ge=0, le=1e3), AfterValidator(_nothing_or_made)]
#: A coordinate in a robot's own frame, up to a kilometre either way.
Coordinate = Annotated[float, Field(ge=-1e3, le=1e3)]
Vector = tuple[Coordinate, Coordinate]
#: A coordinate on the floor: 10 000 km either way, the range of UTM northings. A size on the floor: up to the same.
Place = Annotated[float, Field(ge=-1e7, le=1e7)]
Extent = Annotated[float, Field(ge=FINEST, le=1e7)]
#: An angle: 1591 turns either way, where rounding is still 1e-12 rad; angles in degrees are within it as well.
Angle = Annotated[float, Field(ge=-1e4, le=1e4)]
#: A mass, kg: a milligram to ten thousand tonnes, what the largest wheeled transporters carry. A rotational inertia,
#: kg m2: of a milligram at a millimetre to ten thousand tonnes at a kilometre.
Mass = Annotated[float, Field(ge=1e-6, le=1e7)]
Inertia = Annotated[float, Field(ge=1e-12, le=1e13)]
#: A time, s: a microsecond to 30 years; 0 where there may be none.
Duration = Annotated[float, Field(ge=1e-6, le=1e9)]
DurationOrNone = Annotated[float, Field(ge=0, le=1e9)]
#: A rate of turning, rad/s: to a million, some fifty times a turbocharger's; the limit of a motor: from a turn in ten
#: minutes.
RateLimit = Annotated[float, Field(ge=0.01, le=1e6)]
RateOrNone = Annotated[float, Field(ge=0, le=1e6)]
#: A torque limit of a motor, N m: nanonewtons at a metre to a hundred times a ship's engine.
Torque = Annotated[float, Field(ge=1e-9, le=1e9)]
#: A friction coefficient; rubber on anything stays below 5. 0 where something may be without friction.
Friction = Annotated[float, Field(ge=1e-12, le=1e3)]
FrictionOrNone = Annotated[float, Field(ge=0, le=1e3)]
#: A slip stiffness: force for a unit of slip, divided by load; tyres have 5 to 100, steel on steel some 1000.
Stiffness = Annotated[float, Field(ge=1e-3, le=1e6)]
#: Encoder counts a turn of a wheel: less than one behind a gear, to finer than 32-bit encoders.
Counts = Annotated[float, Field(ge=1e-3, le=1e10)]
#: A seed of random numbers, 64 bits.
Seed = Annotated[int, Field(ge=0, lt=2**64)]

_IN_OUR_WORDS = {
    "missing": "is required; add it",
    "unexpected_keyword_argument": "is not known; remove it or mend its name",
}
"""Messages about keys, where Pydantic's own speak of arguments and fields."""

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
    """Return a hash of plain data without its name, by which a description is recognised."""
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
    """Return a robot or train read from `source`; raises InputError for an effect on a part that it lacks."""
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
        place = ".".join(str(part) for part in item["loc"])
        message = _IN_OUR_WORDS.get(item["type"], item["msg"].removeprefix("Value error, "))
        limits = item.get("ctx", {})
        if item["type"] == "too_short":
            message = f"needs at least {limits['min_length']} of them, has {limits['actual_length']}"
        elif item["type"] == "too_long":
            message = f"needs at most {limits['max_length']} of them, has {limits['actual_length']}"
        given = item["input"]
        hidden = isinstance(given, dict | list | tuple) or item["type"] in _IN_OUR_WORDS
        shown = "" if hidden else f", got {shortened(repr(given), 80)}"
        problems.append(f"{place}: {message}{shown}" if place else f"{message}{shown}")
    unnamed = error.error_count() - len(problems)
    return "; ".join(problems) + (f"; and {unnamed} more" if unnamed > 0 else "")
