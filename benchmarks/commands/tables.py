"""``castor-bench tables``."""

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.options import at_least, console
from benchmarks.papers import select_tables
from benchmarks.papers.assumptions import Assumptions, with_assumptions
from benchmarks.papers.comparison import Effort, compute_tables
from benchmarks.papers.views import draw, show_tables
from benchmarks.progress import SilentProgress, TerminalProgress


@with_assumptions
def tables(
    assumptions: Assumptions,
    table: Annotated[
        list[str] | None, typer.Option("--table", help="Only this table, such as vogt-1 (may be given several times).")
    ] = None,
    sets: Annotated[int, typer.Option(help="Parameter sets of simulated tables; fewer are quicker.")] = Effort.sets,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-tables/1).")] = False,
    figures: Annotated[Path | None, typer.Option(help="Write pictures (PNG) of Vogt's tests into this folder.")] = None,
) -> None:
    """Print the tables of papers beside ours, and where the papers' metrics fail."""
    at_least("--sets", sets, 2)
    sources = select_tables(table or [])
    pictures = [] if figures is None else draw(figures)
    with TerminalProgress() if sys.stderr.isatty() else nullcontext(SilentProgress()) as progress:
        computed = compute_tables(sources, Effort(sets, progress, assumptions))
    show_tables(computed, pictures, console(), as_json_text)
