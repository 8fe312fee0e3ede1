"""``castor-bench check``."""

from typing import Annotated

import typer

from benchmarks.options import above_zero
from benchmarks.run.check import check_apart
from castor_envs.vehicles.load import load_vehicle


def check(
    estimator: Annotated[str, typer.Argument(help="A name, module:Class or file.py[:Class].")],
    robot: Annotated[
        str | None, typer.Option(help="A preset, or a robot's or train's file; default: all presets that it serves.")
    ] = None,
    timeout: Annotated[float, typer.Option(help="Seconds that each step may take.")] = 60.0,
) -> None:
    """Check an estimator before a benchmark does; exit code 1 if anything is wrong with it."""
    above_zero("--timeout", timeout)
    findings = check_apart(estimator, None if robot is None else load_vehicle(robot), timeout, _print_now)
    for finding in findings:
        print(f"ok     {finding.name}" if finding.passed else f"WRONG  {finding.name}: {finding.message}")
    if not all(finding.passed for finding in findings):
        raise typer.Exit(1)


def _print_now(line: str) -> None:
    print(line, flush=True)
