"""Tables of papers beside ours: those that a module here offers as ``tables()``. A new paper is a new module."""

from collections.abc import Sequence

from benchmarks.papers.comparison import TableSource
from castor_envs.discovery import offers
from castor_envs.errors import InputError, did_you_mean


def table_sources() -> tuple[TableSource, ...]:
    """Return what computes all tables, module by module in alphabetical order."""
    return tuple(source for tables in offers(__name__, "tables") for source in tables())


def select_tables(names: Sequence[str]) -> tuple[TableSource, ...]:
    """Return what computes the named tables, or all if there are no names; raises InputError for an unknown name."""
    known = {source.name: source for source in table_sources()}
    for name in names:
        if name not in known:
            raise InputError(f"unknown table {name!r}{did_you_mean(name, known)}")
    return tuple(known[name] for name in dict.fromkeys(names or known))
