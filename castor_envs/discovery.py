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

    Of ``from a import b`` both ``a`` and ``a.b``: `b` may be a module. Of ``import_module("a")`` and
    ``__import__("a")`` names that stand there as a text. Empty for what is not Python source.
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
        elif isinstance(node, ast.Call):
            names |= _names_called(node, package)
    return frozenset(names)


def _names_called(node: ast.Call, package: str) -> set[str]:
    """Return what a call imports by its name; nothing of a call of anything else, and of a name that is computed."""
    function = getattr(node.func, "attr", getattr(node.func, "id", None))
    name = node.args[0] if node.args and function in ("import_module", "__import__") else None
    if not (isinstance(name, ast.Constant) and isinstance(name.value, str)):
        return set()
    try:
        full = importlib.util.resolve_name(name.value, package)
    except ImportError:  # relative to no package
        return set()
    return {full} if all(part.isidentifier() for part in full.split(".")) else set()
