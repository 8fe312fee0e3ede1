"""``castor-diagnose trial``."""

import json
import shutil
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from castor_envs.cli import command_line
from castor_envs.vehicles.presets import any_preset
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trials import folder as trials
from discrepancy.trials.results import scores
from discrepancy.trials.results.missed import as_line, missed
from discrepancy.trials.run import DURATION, Plan
from discrepancy.trials.trains.run import TrainPlan


def trial(
    cases: Annotated[
        int, typer.Option(help="How many cases; of every twenty, four have no effect.", min=1, max=9999)
    ] = 20,
    generator: Annotated[
        str, typer.Option(help="The simulator that makes the logs: pymunk (the project's own), mujoco or bullet.")
    ] = "pymunk",
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    robot: Annotated[
        str | None, typer.Option(help="A preset's name, of a robot or a train. Default: all robots that can be judged.")
    ] = None,
    duration: Annotated[float, typer.Option(help="Duration of each log, s.", min=10.0, max=600.0)] = DURATION,
    out: Annotated[
        Path | None,
        typer.Option(help="Keep logs, labels and outcomes in this folder; a trial that is there continues."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(help="Worker processes; default: one for each core.", min=1)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON (castor-trial/3).")] = False,
) -> None:
    """Hide effects in simulated logs, diagnose the logs in separate processes, and score the diagnoses."""

    def run_in(folder: Path) -> None:
        if robot is not None and isinstance(any_preset(robot), TrainDescription):
            plan = TrainPlan(cases, seed, generator, [robot], duration)
        else:
            plan = Plan.of(cases, seed, generator, robot, duration)
        trials.make(plan, folder, jobs=jobs)
        trials.judge(plan, folder, jobs=jobs)
        scored, misses = scores.report(folder), missed(scores.trials_of(folder))
        text = [*scores.lines(scored), "", "Cases that count against the finder:", *map(as_line, misses)]
        print(json.dumps(scored | {"missed": misses}, indent=2, allow_nan=False) if as_json else "\n".join(text))

    if out is not None:
        with command_line.keeping(f"what is done is kept in {out}: the same command continues"):
            run_in(out)
        return
    scratch = Path(tempfile.mkdtemp())
    with command_line.ending_with(lambda: shutil.rmtree(scratch, ignore_errors=True)):
        run_in(scratch / "trial")
