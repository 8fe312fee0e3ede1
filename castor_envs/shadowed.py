"""Says in one line that a file of the user's hides a package that is installed with this one.

A script's own folder comes first where Python looks for modules: an `estimators.py` beside it is imported instead of
the package `estimators`, and what follows is an error that names neither: of that error, only the line remains. Nothing
is said to those who import neither.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType, TracebackType

PACKAGES = ("estimators", "benchmarks", "discrepancy")
_ROOT = Path(__file__).parents[1]
_said: set[str] = set()


class _Watch(MetaPathFinder):
    """Finds nothing, and looks on: the first import of a package asks every finder."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname in PACKAGES and (hiding := hidden_by(fullname)) is not None:
            message = f"{hiding} hides the package {fullname!r} of castor-envs; rename it, or run from another folder"
            print(f"castor-envs: {message}", file=sys.stderr)
            _said.add(fullname)
            _end_without_traceback()
        return None


def hidden_by(package: str) -> str | None:
    """Return the file that Python would import instead of a package of this project, None where it would not."""
    found = PathFinder.find_spec(package)
    if found is None or found.origin is None or Path(found.origin).resolve().parent == (_ROOT / package).resolve():
        return None
    return found.origin


def is_explained(error: BaseException | None) -> bool:
    """Return whether an error comes from an import of a package of which it was said that a file hides it."""
    while error is not None:
        if isinstance(error, ImportError) and (error.name or "").partition(".")[0] in _said:
            return True
        error = error.__cause__
    return False


def _end_without_traceback() -> None:
    """Let such an error end a script without a traceback."""
    usual = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if not is_explained(error):
            usual(kind, error, trace)

    sys.excepthook = hook


def watch() -> None:
    """Look on from now on; once is enough."""
    if not any(isinstance(finder, _Watch) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Watch())
