"""Says in one line that a file of the user's hides a package that is installed with this one.

A script's own folder comes first where Python looks for modules: an `estimators.py` beside it is imported instead of
the package `estimators`, and what follows is an error that names neither. Nothing is said to those who import neither.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

PACKAGES = ("estimators", "benchmarks", "discrepancy")
_ROOT = Path(__file__).parents[1]


class _Watch(MetaPathFinder):
    """Finds nothing, and looks on: the first import of a package asks every finder."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname in PACKAGES and (hiding := hidden_by(fullname)) is not None:
            message = f"{hiding} hides the package {fullname!r} of castor-envs; rename it, or run from another folder"
            print(f"castor-envs: {message}", file=sys.stderr)
        return None


def hidden_by(package: str) -> str | None:
    """Return the file that Python would import instead of a package of this project, None where it would not."""
    found = PathFinder.find_spec(package)
    if found is None or found.origin is None or Path(found.origin).resolve().parent == (_ROOT / package).resolve():
        return None
    return found.origin


def watch() -> None:
    """Look on from now on; once is enough."""
    if not any(isinstance(finder, _Watch) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Watch())
