"""Commands that take logs of real robots: calibrate from them, and make them of recordings."""

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.calibrate import calibrate_logs
from benchmarks.import_recording import import_source
from benchmarks.options import console


def calibrate(
    logs: Annotated[list[Path], typer.Argument(help="CSV logs of any drives; reference poses show the most.")],
    robot: Annotated[str, typer.Option(help="The robot that made them: a file, or a preset's name.")],
    out: Annotated[Path, typer.Option(help="The calibrated robot's file; it must not exist yet.")],
    method: Annotated[
        str | None,
        typer.Option(help="maximum-likelihood (default), pivoting, or umbmark-correction (default with --side)."),
    ] = None,
    side: Annotated[float | None, typer.Option(help="Of the UMBmark squares that were driven, m.")] = None,
    pivots: Annotated[bool, typer.Option("--pivots", help="Find the places of free castors' pivots too.")] = False,
    scatter: Annotated[Path | None, typer.Option(help="Draw the squares' end points, before and after (PNG).")] = None,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-calibration/1).")] = False,
) -> None:
    """Calibrate a robot from its logs, and say which parameters they do not determine.

    Maximum likelihood takes any robot and any drives, with or without reference poses. Pivoting (Doebbler) takes turns
    of a base on split castors about one castor whose wheels are blocked, both ways, for two castors or more. The
    correction from squares (Borenstein and Feng) takes UMBmark squares of a differential robot, both ways, with its
    true pose at start and end.
    """
    calibrate_logs(logs, robot, out, method, side, pivots, scatter, as_json_text, console())


def import_data(
    source: Annotated[Path, typer.Argument(help="A recording, or a folder that holds published measurements.")],
    robot: Annotated[
        str | None, typer.Option(help="The robot that made the recording: a file, or a preset's name.")
    ] = None,
    channel_map: Annotated[Path | None, typer.Option("--map", help="Which channel is which column of the log.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="The log (log.csv), or the folder of published data (measured).")
    ] = None,
) -> None:
    """Make a log of a recording, or logs of published measurements.

    Recordings: bags of ROS 1 and 2, data logs of WPILib, CSV files; trajectories (TUM, KITTI) as their reference.
    Without --map, what the recording holds is shown, and with --robot a map is written to edit: map.json. Published
    measurements, such as OptiOdom's in a folder optiodom, become a folder of a robot file and logs for each session.
    """
    import_source(source, robot, channel_map, out)
