"""``castor-bench speed``."""

import json
from typing import Annotated

import typer
from rich.table import Table

from benchmarks.options import at_least, console
from benchmarks.results.provenance import provenance
from benchmarks.speed.figures import Effort
from castor_envs.discovery import offers

FORMAT = "castor-speed/1"


def speed(
    rounds: Annotated[int, typer.Option(help="Rounds in which variants take turns.")] = Effort.rounds,
    processes: Annotated[
        int, typer.Option(help="Processes that are started for each figure of one.")
    ] = Effort.processes,
    jobs: Annotated[int, typer.Option(help="Jobs that are sent to worker processes and clusters.")] = Effort.jobs,
    quick: Annotated[bool, typer.Option("--quick", help="Diagnose no logs, which takes minutes.")] = False,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-speed/1).")] = False,
) -> None:
    """Measure how fast everything is on this machine, beside the peers that are installed: CPU times, medians."""
    at_least("--rounds", rounds, 1)
    at_least("--processes", processes, 1)
    at_least("--jobs", jobs, 1)
    effort = Effort(rounds, processes, () if quick else Effort.sides, jobs)
    shown, groups = console(), []
    for group in offers("benchmarks.speed", "GROUP"):
        figures = list(group.figures(effort))
        groups.append({"title": group.title, "figures": [figure._asdict() for figure in figures]})
        if figures and not as_json_text:
            table = Table(group.title, "CPU time", box=None)
            for figure in figures:
                table.add_row(figure.name, f"{figure.value:.3g} {figure.unit}")
            shown.print(table)
    if as_json_text:
        origin = provenance()
        machine = {"platform": origin.machine.platform, "cpu_count": origin.machine.cpu_count}
        print(
            json.dumps({"format": FORMAT, "machine": machine, "versions": origin.versions, "groups": groups}, indent=2)
        )
