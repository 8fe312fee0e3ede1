"""``castor-bench``: run the benchmark, show the leaderboard, check an estimator."""

import json
import os
import shlex
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.calibrate import calibrate_logs
from benchmarks.cli_show import compare, page, show
from benchmarks.drive.command import drive
from benchmarks.import_recording import import_source
from benchmarks.leaderboard import board as boards
from benchmarks.leaderboard.overview import overviews
from benchmarks.leaderboard.overview_views import overviews_markdown, print_overviews
from benchmarks.leaderboard.views import as_csv, as_json, as_markdown, print_leaderboard
from benchmarks.options import (
    DEFAULT_RESULTS,
    LOADING,
    GroupNames,
    MeasuredData,
    OtherRobotName,
    Results,
    TaskNames,
    above_zero,
    at_least,
    console,
    with_rows,
)
from benchmarks.papers import select_tables
from benchmarks.papers.assumptions import Assumptions, with_assumptions
from benchmarks.papers.comparison import Effort, compute_tables
from benchmarks.papers.views import draw, show_tables
from benchmarks.progress import SilentProgress, TerminalProgress
from benchmarks.results.export import export_cases, export_form
from benchmarks.results.rescore import rescore_task
from benchmarks.results.robots import save_robot, with_stored_robots
from benchmarks.results.rows import check_results_folder
from benchmarks.robots.command import check_robot, new_robot
from benchmarks.run.check import check_apart
from benchmarks.run.choose import choose, declining_everything, failed_rows, tasks_with
from benchmarks.run.plan import run as run_plan
from benchmarks.run.task_plugins import with_plugged
from benchmarks.site.pages import single_page
from benchmarks.tasks import official_tasks, select_tasks, tasks_by_group, tasks_on
from benchmarks.tasks.other_robots import OtherRobot
from castor_envs import command_line
from castor_envs.errors import InputError
from castor_envs.vehicles.load import load_robot, load_train, load_vehicle
from castor_envs.vehicles.presets import preset_names, train_names
from estimators.plugins.registry import CALIBRATION, ESTIMATOR, builtin_names

app = command_line.new_app()

MOST_NAMED = 5
"""Most failures that are named in the last line of a run, so that it fits in one or two lines."""
MOST_DETAILED = 3
"""Most tasks whose whole boards are shown after a run; of more the overview is shown."""
DETAILS = "details: castor-bench leaderboard TASK..., or --group NAME"


def main() -> None:
    """Run the console script."""
    command_line.main(app)


@app.callback()
def options(version: command_line.Version = False, traceback: command_line.Traceback = False) -> None:
    """Benchmark of odometry and localisation for robots on castors and trains."""


@app.command()
def run(
    task: TaskNames = None,
    group: GroupNames = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator", help="A name, module:Class or file.py[:Class], with ?parameter=value; default: all built-in."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="A calibration method, named like an estimator, for the calibration tasks."),
    ] = None,
    cases: Annotated[int | None, typer.Option(help="Cases of each task; default: the official number.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Worker processes; default: one for each core.")] = None,
    timeout: Annotated[
        float, typer.Option(help="Seconds that an estimator or a method may take for an episode.")
    ] = 60.0,
    results: Results = DEFAULT_RESULTS,
    measured: MeasuredData = None,
    robot: OtherRobotName = None,
) -> None:
    """Run what is missing, then show the leaderboard; exit code 1 if a requested row failed.

    Without --task and --group all tasks are run but the slow ones, which `castor-bench list` marks. If estimators are
    named, only the tasks that judge estimators are run; if calibration methods are named, only theirs. With --robot the
    tasks of squares are run on that robot instead; their boards are not official and are kept apart.
    """
    at_least("--cases", cases, 1)
    at_least("--jobs", jobs, 1, 256)
    above_zero("--timeout", timeout)
    check_results_folder(results)
    user_robot = None if robot is None else OtherRobot.load(robot)
    choice = choose(task or [], estimator or [], method or [], cases, timeout, measured, user_robot, group or [])
    with (
        command_line.keeping(f"what is done is kept in {results}: the same command continues"),
        TerminalProgress() as progress,
    ):
        if user_robot is not None:
            save_robot(results, user_robot)
        missing = run_plan(choice.plan, results, jobs or os.cpu_count() or 1, timeout, progress)
    board = boards.build(choice.tasks, results, cases, missing, choice.sources, choice.left_out)
    detailed = len(choice.tasks) <= MOST_DETAILED
    shown = [task.name for task in choice.tasks] if detailed else []
    again = shlex.join(["castor-bench", "leaderboard", *shown, "--results", str(results)])
    if detailed:
        print_leaderboard(board, console())
    else:
        print_overviews(board, console())
        print(DETAILS)
    print(f"\nresults in {results}; show them again: {again}")
    failures = [*failed_rows(choice.plan, board), *declining_everything(choice.named, board)]
    if failures:
        unnamed = f", and {len(failures) - MOST_NAMED} more" if len(failures) > MOST_NAMED else ""
        where = "the reasons are above" if detailed else "castor-bench leaderboard TASK shows the reasons"
        print(f"not all succeeded: {', '.join(failures[:MOST_NAMED])}{unnamed}; {where}", file=sys.stderr)
        raise typer.Exit(1)


@app.command()
def leaderboard(
    tasks: Annotated[
        list[str] | None, typer.Argument(metavar="TASK", help="Tasks to show in detail; none: an overview of all.")
    ] = None,
    task: TaskNames = None,
    group: GroupNames = None,
    cases: Annotated[int | None, typer.Option(help="Only the first so many cases of each task.")] = None,
    results: Results = DEFAULT_RESULTS,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-leaderboard/2).")] = False,
    as_markdown_text: Annotated[bool, typer.Option("--markdown", help="Print Markdown.")] = False,
    as_csv_text: Annotated[bool, typer.Option("--csv", help="Print CSV: a row for each task and estimator.")] = False,
    as_html_text: Annotated[bool, typer.Option("--html", help="Print a static HTML page.")] = False,
) -> None:
    """Show the leaderboard of the stored results: an overview of groups of tasks, or the tasks that are named."""
    names = [*(tasks or []), *(task or [])]
    known, names = with_plugged(with_stored_robots(official_tasks(), results), names, LOADING)
    chosen = select_tasks(known, names, group or [])
    at_least("--cases", cases, 1)
    if as_json_text + as_markdown_text + as_csv_text + as_html_text > 1:
        raise InputError("choose one of --json, --markdown, --csv and --html")
    check_results_folder(results, write=False)
    with_rows(results)
    board, detailed = boards.build(chosen, results, cases), bool(names or group)
    if as_json_text:
        print(json.dumps(as_json(board), indent=2, allow_nan=False))
    elif as_csv_text:
        print(as_csv(board), end="")
    elif as_html_text:
        print(single_page(board), end="")
    elif as_markdown_text:
        print(
            as_markdown(board) if detailed else f"{overviews_markdown(overviews(board.boards))}\n{as_markdown(board)}"
        )
    elif detailed:
        print_leaderboard(board, console())
    else:
        print_overviews(board, console())
        print(DETAILS)


@app.command()
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


@app.command()
def rescore(
    task: TaskNames = None,
    results: Results = DEFAULT_RESULTS,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would change, and store nothing.")] = False,
) -> None:
    """Compute scores again from stored episodes and trajectories, for example for a new metric; no estimator runs."""
    check_results_folder(results, write=not dry_run)
    with_rows(results)
    for chosen in select_tasks(*with_plugged(with_stored_robots(official_tasks(), results), task or [], LOADING)):
        rescored = rescore_task(results, chosen, write=not dry_run)
        if rescored.rows:
            print(f"{rescored.task}: {rescored.changed} of {rescored.rows} rows changed")
        for (estimator, metric), rows in rescored.metrics.items():
            print(f"  {estimator}, {metric}: {rows} rows")
        for problem in rescored.problems:
            print(f"  kept as it was: {problem}")


@app.command()
def export(
    task: Annotated[str, typer.Argument(help="A task's name, or file.py[:Class].")],
    cases: Annotated[int, typer.Option(help="The first so many cases.")] = 1,
    out: Annotated[Path, typer.Option(help="The folder to write to; it must not exist yet.")] = Path("castor-episodes"),
    form: Annotated[
        str, typer.Option("--format", help="csv: what estimators are given; tum or kitti: the scored poses.")
    ] = "csv",
    results: Annotated[
        Path | None, typer.Option("--results", help="With tum or kitti: the estimates stored in this folder too.")
    ] = None,
    measured: MeasuredData = None,
    robot: OtherRobotName = None,
) -> None:
    """Write episodes as files: what estimators are given with the true poses, or poses as TUM or KITTI text.

    The floor that was driven on, where it is known and not even, is beside each run as a floor file; with TUM or KITTI
    text also as a map (YAML and PNG) that evo_traj --ros_map_yaml draws.
    """
    known = tasks_with(measured) if robot is None else tasks_on(OtherRobot.load(robot))
    (chosen,) = select_tasks(*with_plugged(known, [task], LOADING))
    at_least("--cases", cases, 1)
    if results is not None:
        check_results_folder(results, write=False)
        with_rows(results)
    export_cases(chosen, chosen.cases(cases), out, export_form(form), results)
    print(f"{out}: {len(chosen.cases(cases))} case(s) of {chosen.name}")


@app.command()
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


@app.command()
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


@app.command("import")
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


@app.command("drive")
def drive_by_hand(
    robot: Annotated[str, typer.Option(help="The robot: a preset's name or a robot file.")] = "asoc-prototype",
    floor: Annotated[str | None, typer.Option(help="A floor file; default: an even floor.")] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator", help="A name, module:Class or file.py[:Class] (several times); default: wheel-odometry."
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write the drive to this new log (.csv), with the robot's file beside it.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.", min=0)] = None,
    duration: Annotated[float, typer.Option(help="End by itself after so many seconds.")] = 3600.0,
) -> None:
    """Drive a robot by keyboard in a window, and watch where it is and where estimators believe it is."""
    above_zero("--duration", duration)
    drive(robot, floor, estimator or [], record, seed, duration)


@app.command("robot")
def robot_file(
    file: Annotated[str, typer.Argument(help="A robot's or train's file (.json), or a preset's name.")],
    new: Annotated[bool, typer.Option("--new", help="Ask for a robot and write it to the file.")] = False,
    force: Annotated[bool, typer.Option("--force", help="With --new: replace a file that is there.")] = False,
    png: Annotated[Path | None, typer.Option(help="Draw the layout to this file (PNG).")] = None,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-robot-check/1).")] = False,
) -> None:
    """Check a robot's file: layout, what it can do, what is odd; or ask for a new one. Exit code 1 if it is invalid.

    Lines that begin with CHECK name what is allowed and hardly meant, such as millimetres given as metres.
    """
    if force and not new:
        raise InputError("--force is for --new")
    if new and as_json_text:
        raise InputError("--new asks questions; check the file with --json afterwards")
    if new:
        new_robot(file, png, force)
    elif not check_robot(file, png, as_json_text):
        raise typer.Exit(1)


@app.command("list")
def list_known() -> None:
    """List tasks, estimators, calibration methods, robots and trains."""
    print("tasks by group (castor-bench run --group), * where run needs the task's name or group:")
    for group, tasks in tasks_by_group(official_tasks()).items():
        print(f"  {group}")
        for task in tasks:
            print(f"  {' ' if task.standard else '*'} {task.name}  (version {task.version})  {task.title}")
    for heading, kind in (("estimators", ESTIMATOR), ("calibration methods", CALIBRATION)):
        print(f"{heading}:")
        for name in kind.names():
            print(f"  {name}")
    print("robots:")
    for name in preset_names():
        print(f"  {name}: {', '.join(builtin_names(load_robot(name))) or 'no built-in estimator applies'}")
    print("trains:")
    for name in train_names():
        print(f"  {name}: {', '.join(builtin_names(load_train(name))) or 'no built-in estimator applies'}")


def _print_now(line: str) -> None:
    print(line, flush=True)


for command in (show, compare, page):
    app.command()(command)
