"""``castor-bench``: run the benchmark, show the leaderboard, check an estimator."""

import importlib.metadata
import json
import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks import leaderboard as boards
from benchmarks.board_views import as_json, as_markdown, print_leaderboard
from benchmarks.episodes import write_episode
from benchmarks.progress import TerminalProgress
from benchmarks.results import check_results_folder, names_of
from benchmarks.runner import Assignment
from benchmarks.runner import run as run_plan
from benchmarks.task import Task
from benchmarks.tasks import official_tasks, select_tasks
from castor_envs import command_line
from castor_envs.errors import InputError
from castor_envs.presets import load_robot, preset_names
from estimators import conformance
from estimators.registry import EstimatorEntry, builtin_names, load_estimator

app = typer.Typer(
    help="Benchmark of odometry for robots on castors.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

TaskNames = Annotated[list[str] | None, typer.Option("--task", help="Only this task (may be given several times).")]
Results = Annotated[Path, typer.Option("--results", help="The folder that results are kept in.")]
MeasuredData = Annotated[
    Path | None,
    typer.Option("--measured", envvar="CASTOR_DATA", help="The folder with measured data."),
]
DEFAULT_RESULTS = Path("castor-results")


def main() -> None:
    """Run the console script."""
    command_line.run(app)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"castor-bench {importlib.metadata.version('castor-envs')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Benchmark of odometry for robots on castors."""


@app.command()
def run(
    task: TaskNames = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option("--estimator", help="A name, module:Class or file.py[:Class]; default: all built-in ones."),
    ] = None,
    cases: Annotated[int | None, typer.Option(help="Cases of each task; default: the official number.")] = None,
    jobs: Annotated[int | None, typer.Option(help="Worker processes; default: one for each core.")] = None,
    timeout: Annotated[float, typer.Option(help="Seconds that an estimator may take for an episode.")] = 60.0,
    results: Results = DEFAULT_RESULTS,
    measured: MeasuredData = None,
) -> None:
    """Run what is missing, then show the leaderboard."""
    tasks = select_tasks(_tasks(measured), task or [])
    _at_least("--cases", cases, 1)
    _at_least("--jobs", jobs, 1)
    if not timeout > 0:
        raise InputError(f"--timeout must be above 0, got {timeout:g}")
    check_results_folder(results)
    named = _estimators(estimator or [])
    plan = [Assignment(t, tuple(t.cases(cases)), named or _builtin(t)) for t in tasks if t.missing is None]
    with TerminalProgress() as progress:
        missing = run_plan(plan, results, jobs or os.cpu_count() or 1, timeout, progress)
    sources = {entry.name: entry.source_hash for assignment in plan for entry in assignment.estimators}
    board = boards.build(tasks, results, cases, missing, sources)
    print_leaderboard(board, _console())
    print(f"\nresults in {results}; show them again: castor-bench leaderboard --results {results}")


@app.command()
def leaderboard(
    task: TaskNames = None,
    cases: Annotated[int | None, typer.Option(help="Only the first so many cases of each task.")] = None,
    results: Results = DEFAULT_RESULTS,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    as_markdown_text: Annotated[bool, typer.Option("--markdown", help="Print Markdown.")] = False,
) -> None:
    """Show the leaderboard of the stored results."""
    tasks = select_tasks(official_tasks(), task or [])
    _at_least("--cases", cases, 1)
    if as_json_text and as_markdown_text:
        raise InputError("choose one of --json and --markdown")
    check_results_folder(results)
    if not (results / "rows").is_dir():
        raise InputError(f"no results in {results}; run castor-bench run first, or name the folder with --results")
    board = boards.build(tasks, results, cases)
    if board.corrupt:
        raise InputError(
            f"damaged results: {names_of(board.corrupt)}; castor-bench run computes them again, or delete them"
        )
    if as_json_text:
        print(json.dumps(as_json(board), indent=2, allow_nan=False))
    elif as_markdown_text:
        print(as_markdown(board))
    else:
        print_leaderboard(board, _console())


@app.command()
def check(
    estimator: Annotated[str, typer.Argument(help="A name, module:Class or file.py[:Class].")],
    robot: Annotated[str | None, typer.Option(help="A preset or a robot file; default: one that it serves.")] = None,
) -> None:
    """Check an estimator before a benchmark does; exit code 1 if anything is wrong with it."""
    findings = conformance.check(load_estimator(estimator), None if robot is None else load_robot(robot))
    for finding in findings:
        print(f"ok     {finding.name}" if finding.passed else f"WRONG  {finding.name}: {finding.message}")
    if not all(finding.passed for finding in findings):
        raise typer.Exit(1)


@app.command()
def export(
    task: Annotated[str, typer.Argument(help="A task's name.")],
    cases: Annotated[int, typer.Option(help="The first so many cases.")] = 1,
    out: Annotated[Path, typer.Option(help="The folder to write to; it must not exist yet.")] = Path("castor-episodes"),
    measured: MeasuredData = None,
) -> None:
    """Write episodes as files: what estimators are given (robot.json, logs), with the truth as the logs' reference."""
    (chosen,) = select_tasks(_tasks(measured), [task])
    _at_least("--cases", cases, 1)
    if chosen.missing is not None:
        raise InputError(f"task {task}: {chosen.missing}")
    if out.exists():
        raise InputError(f"--out {out}: is there already; name a new folder")
    for case in chosen.cases(cases):
        write_episode(out / f"case-{case}", chosen.record(case))
    print(f"{out}: {len(chosen.cases(cases))} case(s) of {task}")


@app.command("list")
def list_known() -> None:
    """List tasks, estimators and robots."""
    print("tasks:")
    for task in official_tasks():
        print(f"  {task.name}  (version {task.version})  {task.title}")
    print("estimators:")
    points = importlib.metadata.entry_points(group="castor.estimators")
    for name in sorted(points.names):
        print(f"  {name}")
    print("robots:")
    for name in preset_names():
        print(f"  {name}: {', '.join(builtin_names(load_robot(name))) or 'no built-in estimator applies'}")


def _tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the official tasks; raises InputError if a folder with measured data is named that has none."""
    if measured is None:
        return official_tasks()
    if not measured.is_dir():
        raise InputError(f"folder with measured data {measured} (--measured or CASTOR_DATA): there is no such folder")
    without = {task.name: task for task in official_tasks() if task.missing is not None}
    tasks = official_tasks(measured)
    problems = [task.missing for task in tasks if task.name in without]
    if problems and all(problem is not None for problem in problems):
        raise InputError(f"folder with measured data {measured} (--measured or CASTOR_DATA): {problems[0]}")
    return tasks


def _estimators(specs: list[str]) -> tuple[EstimatorEntry, ...]:
    """Return the estimators of some specs, each once; raises InputError for two that share a name."""
    entries: dict[str, EstimatorEntry] = {}
    for entry in map(load_estimator, specs):
        other = entries.setdefault(entry.name, entry)
        if other.source_hash != entry.source_hash:
            raise InputError(
                f"two estimators are named {entry.name!r}: {other.spec} and {entry.spec}; rename one class"
            )
    return tuple(entries.values())


def _builtin(task: Task) -> tuple[EstimatorEntry, ...]:
    return tuple(load_estimator(name) for name in builtin_names(task.robot))


def _at_least(option: str, value: int | None, least: int) -> None:
    if value is not None and value < least:
        raise InputError(f"{option} must be at least {least}, got {value}")


def _console() -> Console:
    """Return a console; text that goes to a file or a pipe is not cut to 80 columns."""
    console = Console()
    return console if console.is_terminal else Console(width=160)
