"""Identifies an estimator's code: a hash over the file of its class and the files that it imports.

So results of an edited estimator are never taken for those of the old one. Imports are followed into this package's
files and into files that belong to the plug-in: those of its package, or next to its file. Other packages are not
followed; their versions are recorded with the results.
"""

import hashlib
import site
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from castor_envs.discovery import imported_names

PACKAGE = Path(__file__).parents[1]
OTHER_PARTS = ("castor_envs", "benchmarks", "discrepancy")


def source_hash(kind: type, argument: int | None = None, parameters: Mapping[str, Any] | None = None) -> str:
    """Return 16 hex digits of the sha256 over a class's source files, its name, and what it is made with."""
    made_with = f" {dict(parameters)}" if parameters else ""
    total = hashlib.sha256(f"{kind.__qualname__} {argument}{made_with}".encode())
    for file in sorted(source_files(kind)):
        total.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()[:16]


def source_files(kind: type) -> dict[Path, str]:
    """Return the file that defines a class and those it imports from the same plug-in or this package.

    Each with the name of its module. Empty for a class without source file.
    """
    module = sys.modules.get(kind.__module__)
    origin = getattr(module, "__file__", None)
    if origin is None:
        return {}
    found: dict[Path, str] = {}
    waiting = [(Path(origin).resolve(), kind.__module__)]
    while waiting:
        file, name = waiting.pop()
        if file not in found:
            found[file] = name
            waiting += _imports(file, name)
    return found


def _imports(file: Path, name: str) -> list[tuple[Path, str]]:
    """Return files and names of those modules imported in `file`, itself named `name`, that are to be followed."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    top = file.parents[len(package.split("."))] if package else file.parent
    located = ((_locate(imported, name, top), imported) for imported in imported_names(file.read_bytes(), package))
    return [(path, imported) for path, imported in located if path is not None]


def _locate(imported: str, importer: str, folder: Path) -> Path | None:
    """Return the file of a module to be followed, None for any other."""
    top = imported.partition(".")[0]
    if top == PACKAGE.name:
        folder = PACKAGE.parent
    elif top in OTHER_PARTS or (top != importer.partition(".")[0] and ("." in importer or _installed(folder))):
        return None
    stem = folder.joinpath(*imported.split("."))
    for file in (stem.with_name(stem.name + ".py"), stem / "__init__.py"):
        if file.is_file():
            return file.resolve()
    return None


def _installed(folder: Path) -> bool:
    return str(folder) in {
        str(Path(place).resolve()) for place in (*site.getsitepackages(), site.getusersitepackages())
    }
