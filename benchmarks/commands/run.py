"""``castor-bench run``."""

import contextlib
import os
import shlex
import sys
from typing import Annotated

import typer

from benchmarks.leaderboard import board as boards
from benchmarks.leaderboard.overview_views import print_overviews
from benchmarks.leaderboard.views import print_leaderboard
from benchmarks.options import (
    DEFAULT_RESULTS,
    DETAILS,
    GroupNames,
    MeasuredData,
    OtherRobotName,
    Results,
    TaskNames,
    above_zero,
    at_least,
    console,
)
from benchmarks.progress import TerminalProgress
from benchmarks.results.robots import save_robot
from benchmarks.results.rows import check_results_folder
from benchmarks.run.choose import choose, declining_everything, failed_rows, without_data
from benchmarks.run.clusters import connect
from benchmarks.run.plan import run as run_plan
from benchmarks.run.task_plugins import given_as
from benchmarks.tasks.other_robots import OtherRobot
from castor_envs.cli import command_line
from castor_envs.errors import InputError

MOST_NAMED = 5
"""Most failures that are named in the last line of a run, so that it fits in one or two lines."""
MOST_DETAILED = 3
"""Most tasks whose whole boards are shown after a run; of more the overview is shown."""


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
    backend: Annotated[
        str | None,
        typer.Option(
            help="Where jobs run: loky, dask or ray, --jobs at a time; default: worker processes of this machine."
        ),
    ] = None,
    address: Annotated[
        str | None, typer.Option(help="Of the cluster, such as tcp://host:8786 (dask) or ray://host:10001 (ray).")
    ] = None,
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
    if address is not None and backend is None:
        raise InputError("--address: is the address of a cluster; name its kind too (--backend dask or ray)")
    choice = choose(task or [], estimator or [], method or [], cases, timeout, measured, user_robot, group or [])
    with (
        command_line.keeping(f"what is done is kept in {results}: the same command continues"),
        TerminalProgress() as progress,
        contextlib.ExitStack() as stack,
    ):
        if user_robot is not None:
            save_robot(results, user_robot)
        cluster = None if backend is None else connect(backend, address, jobs)
        if cluster is not None:
            stack.callback(cluster.close)
        processes = jobs or os.cpu_count() or 1
        missing = run_plan(choice.plan, results, processes, timeout, progress, cluster) if choice.plan else {}
    board = boards.build(choice.tasks, results, cases, missing, choice.left_out)
    detailed = len(choice.tasks) <= MOST_DETAILED
    shown = [given_as(task) for task in choice.tasks] if detailed else []
    if detailed:
        print_leaderboard(board, console())
    else:
        print_overviews(board, console())
        print(DETAILS)
    if any(task.entries for task in board.boards):
        first = [] if cases is None else ["--cases", str(cases)]
        again = shlex.join(["castor-bench", "leaderboard", *shown, *first, "--results", str(results)])
        print(f"\nresults in {results}; show them again: {again}")
    unrecorded = [f"cases of {given_as(task)} were not recorded" for task in choice.tasks if task.name in missing]
    not_run = [f"{given_as(task)} was not run" for task in without_data(choice.tasks, task or [], group or [])]
    failures = [*not_run, *unrecorded, *failed_rows(choice.plan, board), *declining_everything(choice, board)]
    if failures:
        unnamed = f", and {len(failures) - MOST_NAMED} more" if len(failures) > MOST_NAMED else ""
        where = (
            "the reasons are above" if detailed else "the reasons are above, or shown by castor-bench leaderboard TASK"
        )
        print(f"not all succeeded: {', '.join(failures[:MOST_NAMED])}{unnamed}; {where}", file=sys.stderr)
        raise typer.Exit(1)
