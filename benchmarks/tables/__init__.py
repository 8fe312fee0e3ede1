"""Tables of papers beside ours. Each module here offers ``tables()``; a new paper is a new module, found by itself."""

import importlib
import pkgutil

from benchmarks.comparison import PaperTable


def paper_tables() -> tuple[PaperTable, ...]:
    """Return all tables, module by module in alphabetical order."""
    modules = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return tuple(table for name in modules for table in importlib.import_module(f"{__name__}.{name}").tables())
