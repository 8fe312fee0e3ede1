"""Parameters in the spec of an estimator, ``cast-0?step=euler``: keyword arguments of its class, by its annotations.

Several values in one, of a list, a tuple or a dictionary, are written as JSON: ``mine.py?gains=[1,2]``.
"""

import inspect
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic.errors import PydanticUserError
from pydantic_core import to_json

from castor_envs.description import explain
from castor_envs.errors import InputError, did_you_mean

LONGEST = 150
"""Characters of a name with its parameters, which goes into the names of files."""


def split(spec: str, what: str) -> tuple[str, dict[str, str]]:
    """Return a spec without its parameters, and these as text by name; raises InputError for what is no NAME=VALUE."""
    base, mark, text = spec.partition("?")
    given: dict[str, str] = {}
    for part in text.split("&") if mark else ():
        name, equals, value = part.partition("=")
        if not (equals and name.isidentifier()):
            raise InputError(f"{what} {spec!r}: {part!r} after the question mark is not as in 'name=value&other=value'")
        if "|" in value or not value.isprintable():
            unfit = "'|'" if "|" in value else "a character that cannot be printed"
            raise InputError(f"{what} {spec!r}: the value of {name!r} has {unfit} in it, which names may not have")
        if name in given:
            raise InputError(f"{what} {spec!r}: {name!r} is given twice")
        given[name] = value
    return base, given


def arguments(kind: type, given: dict[str, str], place: str, positional: int = 0) -> dict[str, Any]:
    """Return the keyword arguments of a class that texts by name stand for, in the order of its signature.

    positional: so many parameters are given already, as the number of ``NAME-N``. Raises InputError, which begins with
    `place` and lists parameters and defaults, for an unknown name and for text that does not fit the annotation.
    """
    if not given:
        return {}
    takes = _parameters(kind, positional)
    listed = f"{kind.__name__} takes {', '.join(map(str, takes.values())) or 'no parameters'}"
    for name in given:
        if name not in takes:
            meant = did_you_mean(name, takes) if takes else ""
            further = f"{meant} {listed}" if meant.endswith("?") else f"; {listed}"
            raise InputError(f"{place}: there is no parameter {name!r}{further}")
    hints = _hints(kind)
    converted = {}
    for name, parameter in takes.items():
        if name in given:
            annotation = hints.get(
                name, str if parameter.default in (None, parameter.empty) else type(parameter.default)
            )
            try:
                converted[name] = _value(TypeAdapter(annotation), given[name])
            except ValidationError as error:
                many = {"list_type", "tuple_type", "dict_type", "set_type"} & {of["type"] for of in error.errors()}
                written = ", several values as JSON ([1,2])" if many else ""
                raise InputError(f"{place}: parameter {name!r}: {explain(error)}{written}; {listed}") from None
            except PydanticUserError:
                raise InputError(f"{place}: parameter {name!r} cannot be given as text; {listed}") from None
    return converted


def named(name: str, converted: dict[str, Any], place: str) -> str:
    """Return a name with parameters in the one way in which they are written; raises InputError if it is too long."""
    if not converted:
        return name
    full = f"{name}?{'&'.join(f'{key}={_text(value)}' for key, value in converted.items())}"
    if len(full) > LONGEST:
        raise InputError(f"{place}: its name is too long for a file's ({len(full)} characters, at most {LONGEST})")
    return full


def _value(adapter: TypeAdapter[Any], text: str) -> Any:
    """Return what a text stands for; raises ValidationError for one that does not fit."""
    try:
        return adapter.validate_strings(text)
    except ValidationError:
        if text[:1] not in ("[", "{"):
            raise
        return adapter.validate_json(text)


def _text(value: Any) -> str:
    """Return a value as it is written in a spec."""
    several = isinstance(value, (list, tuple, dict, set, frozenset))
    return to_json(value).decode() if several else str(value)


def _parameters(kind: type, positional: int) -> dict[str, inspect.Parameter]:
    """Return the parameters that a class takes by keyword, after `positional` ones."""
    try:
        found = list(inspect.signature(kind).parameters.values())[positional:]
    except (TypeError, ValueError):
        return {}
    return {p.name: p for p in found if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}


def _hints(kind: type) -> dict[str, Any]:
    try:
        return get_type_hints(kind.__init__)
    except (NameError, TypeError, AttributeError):  # an annotation of what is imported for type checkers alone
        return {}
