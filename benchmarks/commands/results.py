"""Commands that show stored results as text, and compute or write them again."""

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.export.cases import export_cases, export_form
from benchmarks.export.logs import export_log
from benchmarks.leaderboard.overview import overviews
from benchmarks.leaderboard.overview_views import overviews_markdown, print_overviews
from benchmarks.leaderboard.stored import stored_boards
from benchmarks.leaderboard.views import as_csv, as_json, as_markdown, print_leaderboard
from benchmarks.options import (
    DEFAULT_RESULTS,
    DETAILS,
    LOADING,
    GroupNames,
    MeasuredData,
    Results,
    TaskNames,
    at_least,
    console,
    end_for,
    with_rows,
)
from benchmarks.results.forget import forget
from benchmarks.results.rescore import rescore_task
from benchmarks.results.robots import with_stored_robots
from benchmarks.results.rows import check_results_folder
from benchmarks.run.choose import tasks_with
from benchmarks.run.task_plugins import with_plugged
from benchmarks.show.command import Following, told_failing
from benchmarks.site.pages import single_page
from benchmarks.tasks import official_tasks, select_tasks, tasks_on
from benchmarks.tasks.other_robots import OtherRobot
from castor_envs.cli import command_line
from castor_envs.errors import InputError, shortened
from castor_envs.logs.recordings import refuse_recording


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
    board, detailed = stored_boards(chosen, results, cases), bool(names or group)
    if as_json_text:
        print(json.dumps(as_json(board), indent=2, allow_nan=False))
    elif as_csv_text:
        print(as_csv(board), end="")
    elif as_html_text:
        command_line.print_in_utf8(single_page(board))
    elif as_markdown_text:
        print(
            as_markdown(board) if detailed else f"{overviews_markdown(overviews(board.boards))}\n{as_markdown(board)}"
        )
    elif detailed:
        print_leaderboard(board, console())
    else:
        print_overviews(board, console())
        print(DETAILS)


def rescore(
    task: TaskNames = None,
    results: Results = DEFAULT_RESULTS,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would change, and store nothing.")] = False,
) -> None:
    """Compute scores again from stored episodes and trajectories, for example for a new metric; no estimator runs."""
    check_results_folder(results, write=not dry_run)
    with_rows(results)
    chosen_tasks = select_tasks(*with_plugged(with_stored_robots(official_tasks(), results), task or [], LOADING))
    rows = 0
    for chosen in chosen_tasks:
        rescored = rescore_task(results, chosen, write=not dry_run)
        rows += rescored.rows
        if rescored.rows:
            print(f"{rescored.task}: {rescored.changed} of {rescored.rows} rows changed")
        for (estimator, metric), rows in rescored.metrics.items():
            print(f"  {estimator}, {metric}: {rows} rows")
        for problem in rescored.problems:
            print(f"  kept as it was: {problem}")
        if task and not rescored.rows:
            print(f"{rescored.task}: no rows")
    if not rows:
        names = shortened(", ".join(chosen.name for chosen in chosen_tasks))
        raise InputError(f"no results of {names} in {results}; castor-bench run --task NAME makes them")


def forget_rows(
    estimator: Annotated[str, typer.Argument(help="Its name on the boards, or NAME@HASH for one version of it.")],
    task: TaskNames = None,
    results: Results = DEFAULT_RESULTS,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would go, and remove nothing.")] = False,
) -> None:
    """Remove the rows of an estimator or a calibration method from the stored results; recorded episodes stay."""
    check_results_folder(results, write=not dry_run)
    with_rows(results)
    chosen = select_tasks(*with_plugged(with_stored_robots(official_tasks(), results), task or [], LOADING))
    for name, rows in forget(results, chosen, estimator, write=not dry_run).items():
        print(f"{name}: {rows} {'row' if rows == 1 else 'rows'} {'would be ' * dry_run}removed")


def export(
    task: Annotated[str, typer.Argument(help="A task's name, or file.py[:Class]; or a log, with its --robot.")],
    cases: Annotated[int, typer.Option(help="The first so many cases.")] = 1,
    out: Annotated[Path, typer.Option(help="The folder to write to; it must not exist yet.")] = Path("castor-episodes"),
    form: Annotated[
        str, typer.Option("--format", help="csv: what estimators are given; tum or kitti: the scored poses.")
    ] = "csv",
    results: Annotated[
        Path | None, typer.Option("--results", help="With tum or kitti: the estimates stored in this folder too.")
    ] = None,
    estimator: Annotated[
        list[str] | None, typer.Option(help="With a log: who follows it, as in show (may be given several times).")
    ] = None,
    measured: MeasuredData = None,
    robot: Annotated[
        str | None,
        typer.Option(help="Another robot for the tasks of squares, or the one that made the log: a preset or a file."),
    ] = None,
) -> None:
    """Write episodes as files: what estimators are given with the true poses, or poses as TUM or KITTI text.

    Of a log its reference and the poses of estimators are written.

    The floor that was driven on, where it is known and not even, is beside each run as a floor file; with TUM or KITTI
    text also as a map (YAML and PNG) that evo_traj -p --plot_mode xy --ros_map_yaml draws.
    """
    refuse_recording(Path(task))
    if task.endswith(".csv") or (Path(task).is_file() and not task.endswith(".py")):
        if robot is None:
            raise InputError(f"{task}: name the robot that made it with --robot, a file or a preset")
        if results is not None:
            raise InputError("--results: has rows of tasks; with a log name estimators by --estimator")
        following = Following(estimator or (), processes=os.cpu_count() or 1)
        failing = told_failing(export_log(Path(task), robot, out, export_form(form), following), following)
        print(f"{out}: poses of {task}")
        end_for(failing)
        return
    if estimator:
        raise InputError("--estimator: is for a log; of a task --results adds what run has stored")
    known = tasks_with(measured) if robot is None else tasks_on(OtherRobot.load(robot))
    (chosen,) = select_tasks(*with_plugged(known, [task], LOADING))
    at_least("--cases", cases, 1)
    if results is not None:
        check_results_folder(results, write=False)
        with_rows(results)
    export_cases(chosen, chosen.cases(cases), out, export_form(form), results)
    print(f"{out}: {len(chosen.cases(cases))} case(s) of {chosen.name}")
