"""Tables of papers beside ours. Each module here offers ``tables()``; a new paper is a new module, found by itself."""

import importlib
import pkgutil
from collections.abc import Sequence

from benchmarks.comparison import TableSource
from castor_envs.errors import InputError, did_you_mean


def table_sources() -> tuple[TableSource, ...]:
    """Return what computes all tables, module by module in alphabetical order."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return tuple(source for name in modules for source in importlib.import_module(f"{__name__}.{name}").tables())


def select_tables(names: Sequence[str]) -> tuple[TableSource, ...]:
    """Return what computes the named tables, or all if there are no names; raises InputError for an unknown name."""
    known = {source.name: source for source in table_sources()}
    for name in names:
        if name not in known:
            raise InputError(f"unknown table {name!r}{did_you_mean(name, known)}")
    return tuple(known[name] for name in dict.fromkeys(names or known))
