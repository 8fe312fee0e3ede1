"""The console script castor-diagnose: thin, it reads, calls and prints."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from castor_envs.command_line import run
from castor_envs.logs import read_log
from castor_envs.presets import load_robot
from discrepancy.inspection import inspect_logs

app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.callback(invoke_without_command=True)
def diagnose(context: typer.Context) -> None:
    """Find where a robot's description and its measurements disagree."""
    if context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def inspect(
    logs: Annotated[list[Path], typer.Argument(help="Logs of the robot: CSV files, one a run.")],
    robot: Annotated[str, typer.Option(help="The robot that made them: a preset's name, or a robot file (.json).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON (castor-inspect/1) instead of tables.")] = False,
) -> None:
    """Read and check logs, and show their sampling, their channels and whether their encoders agree.

    Agreement is the parity residual: on a robot with more wheels than a motion needs, what is left of each wheel's
    rolling and each castor's side slip after the rigid motion that fits them best, rms in mm a sample, beside what
    the rounding of counts alone would leave.
    """
    description = load_robot(robot)
    found = inspect_logs(description, {str(path): read_log(path, description) for path in logs})
    if as_json:
        print(json.dumps(found, indent=2, allow_nan=False))
        return
    console = Console(highlight=False, markup=False, soft_wrap=True)
    console.print(f"robot {found['robot']['name']} ({found['robot']['hash']})")
    for entry in found["logs"]:
        _show(console, entry)


def _show(console: Console, entry: dict[str, Any]) -> None:
    period = entry["sample_period"]
    console.print(f"\n{entry['path']}: {entry['rows']} rows, {entry['duration']:.6g} s")
    console.print(
        f"sample period {period['median']:.6g} s ({period['smallest']:.6g} to {period['largest']:.6g}), "
        f"declared {period['declared']:.6g} s"
    )
    console.print(f"reference poses: {entry['reference_rows'] or 'none'}; commands: {_yes(entry['commands'])}")
    if entry["unknown_columns"]:
        console.print(f"columns that the robot does not explain: {', '.join(entry['unknown_columns'])}")
    if entry["constant"]:
        console.print(f"channels that never change: {', '.join(entry['constant'])}")
    broken = [channel["name"] for channel in entry["channels"] if channel["unit"] == "counts" and not channel["whole"]]
    if broken:
        console.print(f"counts that are not whole numbers (radians?): {', '.join(broken)}")
    table = Table("channel", "smallest", "largest", "largest step", "the robot's limit", box=None)
    for channel in entry["channels"]:
        limit = "" if channel["at_most"] is None else f"{channel['at_most']:.6g}"
        numbers = (f"{channel[key]:.10g}" for key in ("smallest", "largest", "largest_step"))
        table.add_row(channel["name"], *numbers, limit)
    console.print(table)
    parity = entry["parity"]
    if parity["note"]:
        console.print(f"parity: {parity['note']}")
        return
    console.print(f"parity residual, {parity['redundancy']} redundant rows, {parity['moving_samples']} moving samples")
    table = Table("row", "rms mm a sample", "from rounding alone", box=None)
    for kind in ("rolling", "side_slip"):
        for row in parity[kind]:
            name = f"{row['name']} {kind.replace('_', ' ')}"
            table.add_row(name, f"{row['rms_mm']:.4f}", f"{row['rounding_mm']:.4f}")
    console.print(table)


def _yes(value: bool) -> str:
    return "yes" if value else "none"


def main() -> None:
    """Run castor-diagnose; a user's mistake is one line on stderr and exit code 2."""
    run(app)
