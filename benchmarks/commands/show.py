"""The commands of ``castor-bench`` that show: one drive, two estimators side by side, the whole board as pages."""

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.leaderboard.stored import stored_boards
from benchmarks.options import (
    DEFAULT_RESULTS,
    LOADING,
    GroupNames,
    MeasuredData,
    Results,
    TaskNames,
    above_zero,
    at_least,
    console,
    end_for,
    with_rows,
)
from benchmarks.results.robots import with_stored_robots
from benchmarks.results.rows import check_results_folder
from benchmarks.run.choose import tasks_with
from benchmarks.run.task_plugins import with_plugged
from benchmarks.show.command import Following, case_of, show_case, show_log, told_failing
from benchmarks.show.page import check_page, page_of, write_page
from benchmarks.show.picture import check_picture, write_gif, write_png
from benchmarks.site.compare import compare as compared
from benchmarks.site.compare import of_other_sources, rows_by_task, side_of
from benchmarks.site.compare_views import as_json, print_comparison, write_comparison
from benchmarks.site.pages import write_site
from benchmarks.tasks import official_tasks, select_tasks, tasks_on
from benchmarks.tasks.other_robots import OtherRobot
from benchmarks.tasks.task import Task
from castor_envs.errors import InputError
from castor_envs.files import check_writable, writing


def show(
    log: Annotated[
        Path | None, typer.Argument(metavar="[LOG]", help="A CSV log, such as an episode recorded; or give --task.")
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(help="Of LOG the robot or train that made it, of --task another robot: file or preset."),
    ] = None,
    floor: Annotated[
        str | None, typer.Option(help="With LOG: the floor it was driven on, a floor file or the name slippery.")
    ] = None,
    task: Annotated[
        str | None, typer.Option(help="The task of the case to record and run: a name, or file.py[:Class].")
    ] = None,
    case: Annotated[str | None, typer.Option(help="The case of --task; default: its first.")] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="As in run (may be given several times); default: the usual ones that serve the robot."),
    ] = None,
    method: Annotated[list[str] | None, typer.Option(help="A calibration method, in calibration tasks.")] = None,
    out: Annotated[Path, typer.Option(help="The page; one made by this command is replaced.")] = Path(
        "castor-show.html"
    ),
    png: Annotated[
        Path | None,
        typer.Option(
            help="A picture of the end of the drive, with the first estimate; replaces those of this command."
        ),
    ] = None,
    gif: Annotated[Path | None, typer.Option(help="The whole drive as a picture that moves, in eight seconds.")] = None,
    number: Annotated[int, typer.Option("--run", help="Of a case with several runs: which one the pictures show.")] = 1,
    timeout: Annotated[float, typer.Option(help="Seconds that an estimator may take.")] = 60.0,
    measured: MeasuredData = None,
) -> None:
    """Show one case of a task or one log as a page: paths, errors, disagreement of wheels, slip, the floor.

    Exit code 1 if an estimator fails, or one that is named declines.
    Nothing is stored but the page (and pictures): results of run stay as they are.
    """
    above_zero("--timeout", timeout)
    at_least("--run", number, 1)
    for option, path, ending in (("--out", out, ".html"), ("--png", png, ".png"), ("--gif", gif, ".gif")):
        if path is not None and path.suffix.lower() != ending:
            raise InputError(f"{option} {path}: its name must end in {ending}")
        if path is not None and path != out:
            with writing(f"{option} {path}"):
                check_writable(path)
    check_page(out)
    by = Following(estimator or (), method or (), timeout, os.cpu_count() or 1)
    if (log is None) == (task is None):
        raise InputError("give a log and --robot, or --task and --case: castor-bench show --help")
    for option, path in (("--png", png), ("--gif", gif)):
        if path is not None:
            check_picture(option, path)
    if task is not None:
        if floor is not None:
            raise InputError("--floor: a task has a floor of its own; leave it out")
        known = tasks_with(measured) if robot is None else tasks_on(OtherRobot.load(robot))
        (chosen,) = select_tasks(*with_plugged(known, [task], LOADING))
        shown = show_case(chosen, case_of(chosen, case), by, robot)
    else:
        assert log is not None
        if robot is None:
            raise InputError(f"{log}: name the robot that made it with --robot, a file or a preset")
        if case is not None:
            raise InputError("--case: is of a task; name it with --task instead of a log")
        shown = show_log(log, robot, floor, by)
    if number > len(shown.drives):
        raise InputError(f"--run {number}: there are {len(shown.drives)} runs")
    drive = shown.drives[number - 1]
    first = next(iter(drive.estimates), None)
    write_page(out, page_of(shown))
    if png is not None:
        write_png(png, drive, first)
    if gif is not None:
        write_gif(gif, drive, first)
    failing = told_failing(shown.failed, by)
    pictures = [str(path) for path in (png, gif) if path is not None]
    whose = f" (of {first})" if pictures and first is not None else ""
    print(", ".join([str(out), *pictures]) + whose)
    end_for(failing)


def compare(
    first: Annotated[
        str,
        typer.Argument(
            metavar="A",
            help="An estimator or a method: NAME, NAME?parameter=value, a file, or NAME@HASH of its source.",
        ),
    ],
    second: Annotated[str, typer.Argument(metavar="B", help="The other one, or another version.")],
    task: TaskNames = None,
    group: GroupNames = None,
    results: Results = DEFAULT_RESULTS,
    out: Annotated[
        Path | None, typer.Option(help="A new folder for the comparison as pages, with the cases that differ most.")
    ] = None,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-compare/1).")] = False,
    measured: MeasuredData = None,
) -> None:
    """Say on which tasks A is better than B, worse, or not distinguishable from it, by stored results."""
    chosen = _chosen(task, group, results, measured)
    rows = rows_by_task(chosen, results)
    a, b = (side_of(text, rows, results, LOADING) for text in (first, second))
    found, left_out = compared(a, b, rows, chosen, results), of_other_sources((a, b), rows)
    if out is not None:
        write_comparison(found, results, out, left_out)
    if as_json_text:
        print(json.dumps(as_json(found, left_out), indent=2, allow_nan=False))
        return
    print_comparison(found, console(), left_out)
    if out is not None:
        print(f"{out / 'index.html'}: with the pages of the cases that differ most")


def page(
    out: Annotated[Path, typer.Option(help="The folder to write to; it must not exist yet.")],
    task: TaskNames = None,
    group: GroupNames = None,
    cases: Annotated[int | None, typer.Option(help="Only the first so many cases of each task.")] = None,
    results: Results = DEFAULT_RESULTS,
    measured: MeasuredData = None,
) -> None:
    """Write the boards of stored results as a static site: an overview, a page a task, a page for each of its rows.

    It needs no server and fetches nothing: open index.html, or put the folder on any web space.
    """
    at_least("--cases", cases, 1)
    chosen = _chosen(task, group, results, measured)
    pages = write_site(stored_boards(chosen, results, cases), results, out)
    print(f"{out / 'index.html'}: {pages} pages")


def _chosen(names: list[str] | None, groups: list[str] | None, results: Path, measured: Path | None) -> list[Task]:
    """Return the tasks of a results folder that are named, or all."""
    check_results_folder(results, write=False)
    with_rows(results)
    known = tasks_with(measured) if measured is not None else official_tasks()
    return list(select_tasks(*with_plugged(with_stored_robots(known, results), names or [], LOADING), groups or []))
