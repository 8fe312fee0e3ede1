"""The console script castor-diagnose: thin, it reads, calls and prints."""

import dataclasses
import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from typer.core import TyperCommand, TyperGroup

from castor_envs import command_line
from castor_envs.errors import InputError
from castor_envs.logs.columns import listed
from castor_envs.logs.csv import read_log
from castor_envs.logs.trajectory_files import write_drive
from castor_envs.vehicles.load import Vehicle, file_name, load_vehicle
from castor_envs.vehicles.presets import any_preset
from castor_envs.vehicles.train import TrainDescription
from discrepancy.diagnose import Examined, examine
from discrepancy.inspect import inspect_logs
from discrepancy.posterior.verdicts import Material
from discrepancy.report import sentences
from discrepancy.report.files import write_diagnosis
from discrepancy.trains.examine import examine_train
from discrepancy.trials import folder as trials
from discrepancy.trials import scores
from discrepancy.trials.run import DURATION, Plan
from discrepancy.trials.trains import scores as train_scores
from discrepancy.trials.trains.run import plan_for

ROBOT_FILE, TRAIN_FILE = "robot.json", "train.json"


class _FindUnlessTold(TyperGroup):
    """Takes `castor-diagnose LOG...` as `castor-diagnose find LOG...`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in {*self.commands, *self.get_help_option_names(ctx), "--version"}:
            args = ["find", *args]
        return super().parse_args(ctx, args)


class _SeveralEach(TyperCommand):
    """Lets every option that may come several times take several values: --holdout a.csv b.csv."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        several = {name for option in self.params if getattr(option, "multiple", False) for name in option.opts}
        spelled: list[str] = []
        last, values = None, 0
        for arg in args:
            if arg.startswith("-") and arg != "-":
                last, values = (arg if arg in several else None), 0
            elif last is not None:
                values += 1
                spelled += [last] if values > 1 else []
            spelled.append(arg)
        return super().parse_args(ctx, spelled)


app = command_line.new_app(_FindUnlessTold)
Logs = Annotated[
    list[Path], typer.Argument(help="Logs of the robot: CSV files, one for each run, or folders: all *.csv in them.")
]
Robot = Annotated[
    str | None,
    typer.Option(help=f"A preset's name, or a robot file (.json). Default: {ROBOT_FILE} beside the logs."),
]


@app.callback()
def options(version: command_line.Version = False, traceback: command_line.Traceback = False) -> None:
    """Find where a robot's description and its measurements disagree."""


@app.command()
def inspect(
    logs: Logs,
    robot: Robot = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON (castor-inspect/1).")] = False,
) -> None:
    """Read and check logs, and show their sampling, their channels and whether their encoders agree.

    Agreement is measured by the parity residual: on a robot with more wheels than a motion needs, the rest of each
    wheel's rolling and each castor's side slip after the rigid motion that fits them best. It is given as rms in mm a
    sample, next to the rms that rounding of the counts alone would leave. Sums over about a second show much smaller
    errors, because rounding does not add up; the verdict uses these sums.
    """
    paths = _logs_of(logs)
    description = _vehicle(robot, paths)
    if isinstance(description, TrainDescription):
        given = paths[0].parent / TRAIN_FILE if robot is None else f"--robot {robot}"
        raise InputError(f"{given}: is a train; castor-diagnose inspect serves single robots")
    found = inspect_logs(description, {str(path): read_log(path, description) for path in paths})
    told = [f"robot {found['robot']['name']} ({found['robot']['hash']})"]
    _tell(found, [*told, *(part for entry in found["logs"] for part in _tables(entry))], as_json)


@app.command(cls=_SeveralEach)
def find(
    logs: Logs,
    robot: Robot = None,
    holdout: Annotated[
        list[Path] | None, typer.Option(help="Logs, or folders of logs, that must confirm each effect.")
    ] = None,
    clean: Annotated[
        list[Path] | None,
        typer.Option(help="Logs, or folders, of the robot without the fault: only what goes beyond them is named."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write report.html, diagnosis.json and robot.json, or train.json, with the effects named to this new "
            "folder."
        ),
    ] = None,
    separate: Annotated[
        Path | None,
        typer.Option(help="Write the drive that would distinguish the names of an ambiguous answer to this CSV file."),
    ] = None,
    material: Annotated[float, typer.Option(help="mm after 10 m, and mrad after a turn, that matter.", min=0)] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON (castor-diagnosis/2).")] = False,
) -> None:
    """Name the effects that the robot file lacks; the word `find` may be left out.

    Verdicts: named; ambiguous (these motions cannot distinguish several effects); unconfirmed (the held-out logs do not
    confirm it); unexplained (no effect of the catalogue explains the logs); negligible (it costs less than --material);
    no discrepancy.
    """
    for option, path, what in (("--out", out, "folder"), ("--separate", separate, "file")):
        if path is not None and path.exists():
            raise InputError(f"{option} {path}: is there already; name a new {what}")
    paths, kept_back, good = (_logs_of(given or []) for given in (logs, holdout, clean))
    description = _vehicle(robot, paths)
    if separate is not None and isinstance(description, TrainDescription):
        raise InputError(f"--separate {separate}: {description.name} is a train; drives are for single robots")
    read = {path: read_log(path, description) for path in (*paths, *kept_back, *good)}
    matters = Material(1e-3 * material, 1e-3 * material)
    named, held_out, before = ({str(path): read[path] for path in kind} for kind in (paths, kept_back, good))
    if isinstance(description, TrainDescription):
        examined = examine_train(description, named, held_out, before, matters)
    else:
        examined = examine(description, named, held_out, before, matters)
    drives = examined.drives if isinstance(examined, Examined) else ()
    best = max(drives, key=lambda drive: drive.expected, default=None)
    data = examined.data | {
        "robot_file": str(out / file_name(description)) if out and examined.found else None,
        "separating_drive_file": str(separate) if separate is not None and best is not None else None,
    }
    if out is not None:
        write_diagnosis(out, data, examined.found, dataclasses.replace(examined, data=data).page())
    lines = sentences.as_lines(data)
    if separate is not None and best is None:
        lines.append(f"not written: {separate}: {sentences.why_no_drive(data)}")
    elif separate is not None and best is not None:
        write_drive(separate, best.trajectory, description.sample_period)
        lines.append(f"written: {separate}: {best.what}")
    _tell(data, [*lines, *([] if out is None else [f"written: {out}"])], as_json)


@app.command()
def trial(
    cases: Annotated[
        int,
        typer.Option(help="How many cases; of every twenty, four have no effect.", min=1, max=9999),
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
            plan, scoring = plan_for(cases, generator, seed, robot, duration), train_scores
        else:
            plan, scoring = Plan.of(cases, seed, generator, robot, duration), scores
        trials.make(plan, folder, jobs=jobs)
        trials.judge(plan, folder, jobs=jobs)
        scored = scoring.report(folder)
        print(json.dumps(scored, indent=2, allow_nan=False) if as_json else "\n".join(scoring.lines(scored)))

    if out is not None:
        with command_line.keeping(f"what is done is kept in {out}: the same command continues"):
            run_in(out)
        return
    scratch = Path(tempfile.mkdtemp())
    with command_line.ending_with(lambda: shutil.rmtree(scratch, ignore_errors=True)):
        run_in(scratch / "trial")


def _tell(data: dict[str, Any], told: Sequence[str | Table], as_json: bool) -> None:
    """Print data as JSON, or lines and tables."""
    if as_json:
        print(json.dumps(data, indent=2, allow_nan=False))
        return
    console = Console(highlight=False, markup=False, soft_wrap=True)
    for part in told:
        console.print(part)


def _logs_of(given: list[Path]) -> list[Path]:
    """Return the logs given, those of a folder by name."""
    paths = []
    for path in given:
        if path.is_dir():
            found = sorted(path.glob("*.csv"))
            if not found:
                raise InputError(f"{path}: is a folder without logs (*.csv)")
            paths += found
        elif path.is_file() and path.suffix.lower() == ".json":
            raise InputError(f"{path}: is a robot file, not a log; give it as --robot {path}, and logs as CSV files")
        else:
            paths.append(path)
    return paths


def _vehicle(spec: str | None, logs: list[Path]) -> Vehicle:
    """Return the robot, or train, that a spec names; without one, that of the file beside the logs."""
    if spec is not None:
        return load_vehicle(spec)
    vehicles: dict[Path, Vehicle] = {}
    for log in logs:
        if not log.exists():
            raise InputError(f"{log}: cannot be read (No such file or directory)")
        file = next((candidate for name in (ROBOT_FILE, TRAIN_FILE) if (candidate := log.parent / name).exists()), None)
        if file is None:
            raise InputError(f"{log}: has no {ROBOT_FILE} beside it; name the robot with --robot")
        if file not in vehicles:
            vehicles[file] = load_vehicle(str(file))
    first, *rest = vehicles
    for path in rest:
        if vehicles[path].hash() != vehicles[first].hash():
            raise InputError(f"{first} and {path}: are different robots; inspect their logs one robot at a time")
    return vehicles[first]


def _tables(entry: dict[str, Any]) -> Iterator[str | Table]:
    """Yield lines and tables of what a log shows (`inspect_log`)."""
    period, parity, channels = entry["sample_period"], entry["parity"], entry["channels"]
    yield f"\n{entry['path']}: {entry['rows']} rows, {entry['duration']:.6g} s"
    yield (
        f"sample period {period['median']:.6g} s ({period['smallest']:.6g} to {period['largest']:.6g}), "
        f"declared {period['declared']:.6g} s"
    )
    yield f"reference poses: {entry['reference_rows'] or 'none'}; commands: {'yes' if entry['commands'] else 'none'}"
    if entry["unknown_columns"]:
        yield f"columns that the robot does not explain: {listed(entry['unknown_columns'])}"
    if entry["constant"]:
        yield f"channels that never change: {', '.join(entry['constant'])}"
    broken = [channel["name"] for channel in channels if channel["unit"] == "counts" and not channel["whole"]]
    if broken:
        yield f"counts that are not whole numbers (radians?): {', '.join(broken)}"
    table = Table("channel", "smallest", "largest", "largest step", "the robot's limit", box=None)
    for channel in [*channels, *(entry["reference"] or [])]:
        limit = "-" if channel["at_most"] is None else f"{channel['at_most']:.6g}"
        table.add_row(
            channel["name"], *(f"{channel[key]:.10g}" for key in ("smallest", "largest", "largest_step")), limit
        )
    yield table
    if entry["gyro"] is not None:
        gyro = entry["gyro"]
        yield f"gyro_z {gyro['verdict']} (scale {gyro['scale']:.4g}, bias {gyro['bias']:.3g} rad/s)"
    if parity["note"]:
        yield f"parity: {parity['note']}"
        return
    yield f"parity residual, {parity['redundancy']} redundant rows, {parity['moving_samples']} moving samples"
    table = Table("row", "rms mm a sample", "from rounding", "ratio", f"over {parity['window']:.3g} s", box=None)
    for kind in ("rolling", "side_slip"):
        for row in parity[kind]:
            ratios = ("-" if row[key] is None else f"{row[key]:.2f}" for key in ("ratio", "drift"))
            sizes = (f"{row[key]:.4f}" for key in ("rms_mm", "rounding_mm"))
            table.add_row(f"{row['name']} {kind.replace('_', ' ')}", *sizes, *ratios)
    yield table
    yield f"verdict: {parity['verdict']}"


def main() -> None:
    """Run the console script."""
    command_line.main(app)
