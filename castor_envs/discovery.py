"""Finds what a package's modules offer, so that adding to it is adding a module."""

import importlib
import pkgutil
from collections.abc import Iterator
from typing import Any


def offers(package: str, name: str) -> Iterator[Any]:
    """Yield the attribute `name` of every module of a package (given by its dotted name) that has it.

    Modules come in alphabetical order; those whose name begins with an underscore are left out, as are subpackages'.
    """
    path = importlib.import_module(package).__path__
    for module in sorted(found.name for found in pkgutil.iter_modules(path) if not found.name.startswith("_")):
        offered = getattr(importlib.import_module(f"{package}.{module}"), name, None)
        if offered is not None:
            yield offered
