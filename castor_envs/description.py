"""Descriptions (robots, floors) as JSON: validated, with a format name, and with errors that name the offending key."""

import hashlib
import inspect
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from castor_envs.errors import InputError, did_you_mean, shortened
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
    "unexpected_keyword_argument": "is not known",
    **dict.fromkeys(("union_tag_not_found", "union_tag_invalid"), "needs a 'name', which says what it is"),
}
"""Messages about keys, where Pydantic's own speak of arguments and fields."""

_ONE_OF: dict[str | int, str] = {
    "castors": "castor",
    "wheels": "wheel",
    "effects": "effect",
    "modules": "module",
    "frames": "frame",
    "gauges": "gauge",
    "patches": "patch",
    "cables": "cable",
}
"""What one of a list is called, in words of all other messages, which say castor 2."""

MOST_NAMED = 3
"""Most problems of a file that an error names."""

T = TypeVar("T")


class InvalidDescription(InputError):  # noqa: N818 - what was given
    """Data that are no description of their format. problems: a line for each, without the name of the file."""

    def __init__(self, source: str, problems: Sequence[str]) -> None:
        super().__init__(source, problems)
        self.problems = problems

    def __str__(self) -> str:
        return f"{self.args[0]}: {_first(self.problems)}"


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
    body = {key: value for key, value in data.items() if key not in ("format", "$schema")}
    try:
        return adapter.validate_json(json.dumps(body), strict=True)
    except ValidationError as error:
        raise InvalidDescription(source, problems_of(error, adapter)) from error


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
    return _first(problems_of(error))


def _first(problems: Sequence[str]) -> str:
    unnamed = len(problems) - MOST_NAMED
    return "; ".join(problems[:MOST_NAMED]) + (f"; and {unnamed} more" if unnamed > 0 else "")


def problems_of(error: ValidationError, adapter: TypeAdapter[Any] | None = None) -> list[str]:
    """Return a line for every problem: where it is and what it is; of a key that is not known, which may be meant.

    adapter: that refused the data; without it, no key is known.
    """
    problems, found = [], error.errors()
    unknown = [item["loc"] for item in found if item["type"] == "unexpected_keyword_argument"]
    schema = adapter.json_schema() if adapter is not None and unknown else {}
    for item in found:
        inside = any(other["loc"][: len(item["loc"])] == item["loc"] for other in found if other is not item)
        if item["type"] == "too_short" and inside:
            continue  # wrong items are not counted, and are named themselves
        place = place_of(item["loc"])
        message = _IN_OUR_WORDS.get(item["type"], item["msg"].removeprefix("Value error, "))
        limits = item.get("ctx", {})
        if item["type"] == "too_short":
            message = f"needs at least {limits['min_length']} of them, has {limits['actual_length']}"
        elif item["type"] == "too_long":
            message = f"needs at most {limits['max_length']} of them, has {limits['actual_length']}"
        elif item["loc"] in unknown:
            known = _keys_of(schema, item["loc"][:-1])
            message += did_you_mean(str(item["loc"][-1]), known) if known else "; remove it or mend its name"
        given = item["input"]
        hidden = not isinstance(given, str | int | float | None) or item["type"] in _IN_OUR_WORDS
        shown = "" if hidden else f", got {shortened(repr(given), 80)}"
        problems.append(f"{place}: {message}{shown}" if place else f"{message}{shown}")
    return problems


def place_of(parts: Sequence[str | int]) -> str:
    """Return where in a file something is, its lists counted from 1: ``castor 2, wheel 1, radius``."""
    place = ""
    for k, part in enumerate(parts):
        before = parts[k - 1] if k else ""
        if isinstance(part, int):
            one = _ONE_OF.get(before)
            place = (
                f"{place}, number {part + 1}" if one is None else f"{place.removesuffix(str(before))}{one} {part + 1}"
            )
        elif isinstance(before, int) and parts[k - 2] == "effects":
            place += f" ({part})"  # an effect's name, which Pydantic adds
        else:
            place += (", " if isinstance(before, int) or place.endswith(")") else "." if place else "") + part
    return place


def _keys_of(schema: JsonSchemaValue, place: Iterable[str | int]) -> set[str]:
    """Return the keys that the object at a place of a file may have, by the schema of the file."""
    kinds = [schema]
    for part in place:
        kinds = [inner for kind in kinds for inner in _within(schema, kind, part)]
    return {key for kind in kinds for key in kind.get("properties", ())}


def _within(schema: JsonSchemaValue, kind: JsonSchemaValue, part: str | int) -> Iterator[JsonSchemaValue]:
    """Yield what may be at a key or a number of a list (or with the name that Pydantic adds) in a kind of value."""
    properties = kind.get("properties", {})
    if properties.get("name", {}).get("const") == part:
        yield kind
    elif isinstance(part, int):
        yield from _kinds(schema, kind.get("items", {}))
    else:
        yield from _kinds(schema, properties.get(part) or kind.get("additionalProperties") or {})


def _kinds(schema: JsonSchemaValue, kind: JsonSchemaValue) -> Iterator[JsonSchemaValue]:
    """Yield the kinds of value that a part of a schema allows, each as it is defined."""
    if "$ref" in kind:
        kind = schema["$defs"][kind["$ref"].rpartition("/")[2]]
    options = kind.get("anyOf") or kind.get("oneOf")
    if options is None:
        yield kind
    for option in options or ():
        yield from _kinds(schema, option)


def schema_of(adapter: TypeAdapter[Any], name: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of files of the format `name`: what each key is, its bounds and default.

    It judges each number by itself; what several of them must be together, only reading the file tells.
    """
    schema = adapter.json_schema(schema_generator=_Described)
    known = {"$schema": {"type": "string", "description": "where this schema is, for editors; not used"}}
    properties = {"format": {"const": name, "description": "of this file"}, **known, **schema.pop("properties")}
    required = ["format", *schema.pop("required", ())]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
        "description": schema.pop("description"),
        "type": schema.pop("type"),
        "properties": properties,
        "required": required,
        **{key: value for key, value in schema.items() if key != "title"},
    }


class _Described(GenerateJsonSchema):
    """Adds to each key what the docstring of its class says of it."""

    def dataclass_schema(self, schema: core_schema.DataclassSchema) -> JsonSchemaValue:
        found = super().dataclass_schema(schema)
        summary, meanings = documented(schema["cls"], found["properties"])
        found["description"] = summary
        for name, part in found["properties"].items():
            if name in meanings:
                part["description"] = meanings[name]
        return found


def documented(kind: type, names: Iterable[str]) -> tuple[str, dict[str, str]]:
    """Return the first paragraph of a class's docstring, and what it says of some names, as in ``a, b: lengths, m.``"""
    summary, _, rest = (inspect.getdoc(kind) or "").partition("\n\n")
    name = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    entries = re.split(rf"(?:^|(?<=[.:;)]\s))((?:{name})(?:,\s+(?:{name}))*):\s+", rest, flags=re.M)
    meanings = {
        named: " ".join(text.partition("\n\n")[0].split()).removesuffix(".")
        for given, text in zip(entries[1::2], entries[2::2], strict=True)
        for named in re.split(r",\s+", given)
    }
    return " ".join(summary.split()), meanings
