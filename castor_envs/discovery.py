"""Finds what a package's modules offer, so that adding to it is adding a module, and what a module imports."""

import ast
import importlib
import importlib.util
import pkgutil
from collections.abc import Iterator
from functools import cache, lru_cache
from types import ModuleType
from typing import Any


def offers(package: str, name: str) -> Iterator[Any]:
    """Yield the attribute `name` of every module of a package (given by its dotted name) that has it.

    Modules come in alphabetical order; those whose name begins with an underscore are left out, as are subpackages'.
    """
    for module in modules_of(package):
        offered = getattr(module, name, None)
        if offered is not None:
            yield offered


@cache
def modules_of(package: str) -> tuple[ModuleType, ...]:
    """Return the modules that `offers` looks at, imported; from within one of them also those half imported."""
    path = importlib.import_module(package).__path__
    names = sorted(found.name for found in pkgutil.iter_modules(path) if not found.name.startswith("_"))
    return tuple(importlib.import_module(f"{package}.{name}") for name in names)


@lru_cache(maxsize=256)  # several sources that are followed import much the same files
def imported_names(source: bytes, package: str) -> frozenset[str]:
    """Return the full names of everything that a module of a package may import, according to its source.

    Of ``from a import b`` both ``a`` and ``a.b``: `b` may be a module. Empty for what is not Python source.
    """
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):  # an extension module
        return frozenset()
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = importlib.util.resolve_name("." * node.level + base, package)
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return frozenset(names)
