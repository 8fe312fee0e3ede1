"""Identifies an estimator's code: a hash over the file of its class, the files that it imports, and files it is given.

So results of an edited estimator are never taken for those of the old one. Imports are followed, wherever in a source
they stand, into this package's files and into files of any folder that Python imports from, but not into the standard
library and installed packages: the versions of those that matter are recorded with the results. Not seen are imports
of names that are computed, and files that the code reads, unless a parameter of the class names them as a `Path`.
"""

import hashlib
import importlib.machinery
import importlib.util
import inspect
import site
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from castor_envs.discovery import imported_names

PACKAGE = Path(__file__).parents[1]
OTHER_PARTS = ("castor_envs", "benchmarks", "discrepancy")
PLUG_IN_FOLDERS: set[Path] = set()
"""The folders of plug-in files, which may import their neighbours; `find` adds them."""


def source_hash(kind: type, argument: int | None = None, parameters: Mapping[str, Any] | None = None) -> str:
    """Return 16 hex digits of the sha256 over a class's source files, its name, and what it is made with.

    Of parameters that are a `Path`, given or by default, the content counts where it is a file.
    """
    made_with = f" {dict(parameters)}" if parameters else ""
    total = hashlib.sha256(f"{kind.__qualname__} {argument}{made_with}".encode())
    for file in (*sorted(source_files(kind)), *_files_given(kind, parameters or {})):
        total.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()[:16]


def source_files(kind: type) -> dict[Path, str]:
    """Return the file that defines a class and those that it imports, directly or not.

    Each with the name of its module. Empty for a class without source file.
    """
    module = sys.modules.get(kind.__module__)
    origin = getattr(module, "__file__", None)
    if origin is None:
        return {}
    found: dict[Path, str] = {}
    root = Path(origin).resolve()
    of_others = {str(folder) for folder in PLUG_IN_FOLDERS - {root.parent}}
    path = tuple(place for place in sys.path if place not in of_others)
    waiting = [(root, kind.__module__)]
    while waiting:
        file, name = waiting.pop()
        if file not in found:
            found[file] = name
            waiting += _imports(file, name, path)
    return found


def _imports(file: Path, name: str, path: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """Yield files and names of those modules imported in `file`, itself named `name`, that are to be followed."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    folder = file.parents[len(package.split("."))] if package else file.parent
    for imported in {*imported_names(file.read_bytes(), package), name}:
        top = imported.partition(".")[0]
        if top == PACKAGE.name:
            places, names = (PACKAGE.parent,), [imported]
        elif top in OTHER_PARTS or top in sys.stdlib_module_names:
            continue
        else:
            places = (folder,) if top == name.partition(".")[0] else _places(top, tuple(path))
            parts = imported.split(".")
            names = [".".join(parts[: k + 1]) for k in range(len(parts))]  # a package is imported before what is in it
        for place in places:
            yield from ((found, one) for one in names if (found := _file_of(place, one)) is not None)


def _places(top: str, path: tuple[str, ...]) -> tuple[Path, ...]:
    """Return the folders that hold a module or package, none of one that is installed or not found."""
    spec = importlib.machinery.PathFinder.find_spec(top, path)
    if spec is None:  # where no path leads, as in a package that is installed for editing
        try:
            spec = importlib.util.find_spec(top)
        except (ImportError, ValueError):
            spec = None
    inside = () if spec is None else spec.submodule_search_locations or ()
    alone = () if spec is None or inside or not spec.origin else (spec.origin,)
    places = tuple(Path(place).resolve().parent for place in (*inside, *alone))
    return tuple(place for place in places if not _installed(place))


def _file_of(folder: Path, module: str) -> Path | None:
    """Return the file of a module in a folder, None for what is no module, or has no file."""
    stem = folder.joinpath(*module.split("."))
    endings = importlib.machinery.all_suffixes()
    files = (stem / "__init__.py", *(stem.with_name(stem.name + ending) for ending in endings))
    return next((file.resolve() for file in files if file.is_file()), None)


def _installed(folder: Path) -> bool:
    places = (*site.getsitepackages(), site.getusersitepackages())
    return any(folder.is_relative_to(Path(place).resolve()) for place in places)


def _files_given(kind: type, parameters: Mapping[str, Any]) -> list[Path]:
    """Return the files that the parameters of a class name as a `Path`, in the order of its signature."""
    try:
        defaults = {name: of.default for name, of in inspect.signature(kind).parameters.items()}
    except (TypeError, ValueError):
        defaults = {}
    return [value for value in (defaults | dict(parameters)).values() if isinstance(value, Path) and value.is_file()]
