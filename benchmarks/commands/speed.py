"""``castor-bench speed``."""

import json
from typing import Annotated, Any

import typer
from rich.table import Table

from benchmarks.options import at_least, console
from benchmarks.results.provenance import provenance
from benchmarks.speed.figures import Effort
from castor_envs.discovery import offers

FORMAT, GROWTH_FORMAT = "castor-speed/1", "castor-growth/1"


def speed(
    rounds: Annotated[int, typer.Option(help="Rounds in which variants take turns.")] = Effort.rounds,
    processes: Annotated[
        int, typer.Option(help="Processes that are started for each figure of one.")
    ] = Effort.processes,
    sent: Annotated[int, typer.Option(help="Jobs that are sent to worker processes and clusters.")] = Effort.jobs,
    quick: Annotated[bool, typer.Option("--quick", help="Diagnose no logs, which takes minutes.")] = False,
    growth: Annotated[
        bool, typer.Option("--growth", help="Measure how costs grow with sizes instead (castor-growth/1): an hour.")
    ] = False,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-speed/1).")] = False,
) -> None:
    """Measure how fast everything is on this machine, beside the peers that are installed: CPU times, medians."""
    at_least("--rounds", rounds, 1)
    at_least("--processes", processes, 1)
    at_least("--sent", sent, 1)
    effort = Effort(rounds, processes, () if quick else Effort.sides, sent)
    if growth:
        _show_growth(effort, as_json_text)
        return
    shown, groups = console(), []
    for group in offers("benchmarks.speed", "GROUP"):
        figures = list(group.figures(effort))
        groups.append({"title": group.title, "figures": [figure._asdict() for figure in figures]})
        if figures and not as_json_text:
            table = Table(group.title, "CPU time, rate or ratio", box=None)
            for figure in figures:
                table.add_row(figure.name, figure.text)
            shown.print(table)
    if as_json_text:
        print(json.dumps({"format": FORMAT, **_measured_on(), "groups": groups}, indent=2))


def _show_growth(effort: Effort, as_json_text: bool) -> None:
    """Print the curves of growth."""
    shown, found = console(), []
    for curves in offers("benchmarks.speed.growth", "curves"):
        for curve in curves(effort):
            found.append(curve._asdict())
            if not as_json_text:
                table = Table(curve.over, f"{curve.title}, {curve.unit}", box=None)
                for size, cost in zip(curve.sizes, curve.costs, strict=True):
                    table.add_row(f"{size:g}", f"{cost:.3g}")
                shown.print(table)
    if as_json_text:
        print(json.dumps({"format": GROWTH_FORMAT, **_measured_on(), "curves": found}, indent=2))


def _measured_on() -> dict[str, Any]:
    """Return what figures say of this machine."""
    origin = provenance()
    machine = {"platform": origin.machine.platform, "cpu_count": origin.machine.cpu_count}
    return {"machine": machine, "versions": origin.versions}
