"""``castor-diagnose inspect``."""

from collections.abc import Iterator
from typing import Annotated, Any

import typer
from rich.table import Table

from castor_envs.errors import InputError
from castor_envs.logs.columns import listed
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.train import TrainDescription
from discrepancy.commands.given import TRAIN_FILE, Logs, Robot, logs_of, tell, vehicle_of
from discrepancy.inspect import POSE, inspect_logs


def inspect(
    logs: Logs,
    robot: Robot = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON (castor-inspect/1).")] = False,
) -> None:
    """Read and check logs, and show their sampling, their channels and whether their encoders agree.

    Agreement is measured by the parity residual: on a robot with more wheels than a motion needs, the rest of each
    wheel's rolling and each castor's side slip after the rigid motion that fits them best. It is given as rms in mm a
    sample, next to the rms that rounding of the counts alone would leave. Sums over about a second show much smaller
    errors, because rounding does not add up; the verdict uses these sums. "still" is the longest time in which an
    encoder's counts stay as they are while another's change: that of a wheel tells of an encoder that stops at times.
    """
    paths = logs_of(logs)
    description = vehicle_of(robot, paths)
    if isinstance(description, TrainDescription):
        given = paths[0].parent / TRAIN_FILE if robot is None else f"--robot {robot}"
        raise InputError(f"{given}: is a train; castor-diagnose inspect serves single robots")
    found = inspect_logs(description, {str(path): read_log(path, description) for path in paths})
    told = [f"robot {found['robot']['name']} ({found['robot']['hash']})"]
    tell(found, [*told, *(part for entry in found["logs"] for part in _tables(entry))], as_json)


def _tables(entry: dict[str, Any]) -> Iterator[str | Table]:
    """Yield lines and tables of what a log shows (`inspect_log`)."""
    period, parity, channels = entry["sample_period"], entry["parity"], entry["channels"]
    yield f"\n{entry['path']}: {entry['rows']} rows, {entry['duration']:.6g} s"
    yield (
        f"sample period {period['median']:.6g} s ({period['smallest']:.6g} to {period['largest']:.6g}), "
        f"declared {period['declared']:.6g} s"
    )
    headless = entry["reference"] and len(entry["reference"]) < len(POSE)
    poses = f"{entry['reference_rows'] or 'none'}{', positions without headings' if headless else ''}"
    yield f"reference poses: {poses}; commands: {'yes' if entry['commands'] else 'none'}"
    if entry["unknown_columns"]:
        yield f"columns that the robot does not explain: {listed(entry['unknown_columns'])}"
    if entry["constant"]:
        yield f"channels that never change: {', '.join(entry['constant'])}"
    broken = [channel["name"] for channel in channels if channel["unit"] == "counts" and not channel["whole"]]
    if broken:
        yield (
            f"counts that are not whole numbers: {', '.join(broken)}; as expected of recorded angles or speeds, of "
            "pivots whose counts a turn are not whole, and of rows at the times of slow poses; else look whether the "
            "column holds counts"
        )
    table = Table("channel", "smallest", "largest", "largest step", "at the robot's limit", "still, s", box=None)
    for channel in [*channels, *(entry["reference"] or [])]:
        known = ("-" if channel[key] is None else f"{channel[key]:.6g}" for key in ("at_most", "still"))
        table.add_row(
            channel["name"], *(f"{channel[key]:.10g}" for key in ("smallest", "largest", "largest_step")), *known
        )
    yield table
    if entry["gyro"] is not None:
        gyro = entry["gyro"]
        yield f"gyro_z {gyro['verdict']} (scale {gyro['scale']:.4g}, bias {gyro['bias']:.3g} rad/s)"
    if parity["note"]:
        yield f"parity: {parity['note']}"
        if entry["reference_rows"]:
            yield "next: castor-diagnose with this log compares its encoders with the reference poses"
        return
    yield f"parity residual, {parity['redundancy']} redundant rows, {parity['moving_samples']} moving samples"
    table = Table("row", "rms mm a sample", "from rounding", "ratio", f"ratio over {parity['window']:.3g} s", box=None)
    for kind in ("rolling", "side_slip"):
        for row in parity[kind]:
            ratios = ("-" if row[key] is None else f"{row[key]:.2f}" for key in ("ratio", "drift"))
            sizes = (f"{row[key]:.4f}" for key in ("rms_mm", "rounding_mm"))
            table.add_row(f"{row['name']} {kind.replace('_', ' ')}", *sizes, *ratios)
    yield table
    yield f"verdict: {parity['verdict']}"
