"""What a run does: which tasks, on which robot, and which estimators or calibration methods on each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import overload

from benchmarks.leaderboard import board as boards
from benchmarks.run.check import Load, load_apart, refusals_apart
from benchmarks.run.evaluate import Competitor
from benchmarks.run.plan import Assignment
from benchmarks.run.task_plugins import given_as, is_plugged, with_plugged
from benchmarks.tasks import official_tasks, select_tasks, tasks_on
from benchmarks.tasks.other_robots import OtherRobot, TaskName
from benchmarks.tasks.task import Task, odometry_of
from castor_envs.cli.contained import contained
from castor_envs.errors import InputError
from estimators.plugins.find import runs_others_code
from estimators.plugins.registry import (
    CALIBRATION,
    ESTIMATOR,
    CalibrationEntry,
    EstimatorEntry,
    builtin_names,
    load_calibration,
    load_estimator,
)


@dataclass(frozen=True)
class Choice:
    """What a run does.

    named: the estimators and methods that the user named. left_out: those who decline tasks' robots, by task.
    declining_all: of those who decline all of them the reason, by name.
    """

    tasks: tuple[Task, ...]
    plan: tuple[Assignment, ...]
    named: tuple[Competitor, ...]
    left_out: dict[str, list[boards.DeclinedEstimator]]
    declining_all: dict[str, str]


def choose(
    names: Sequence[str],
    estimators: Sequence[str],
    methods: Sequence[str],
    cases: int | None,
    timeout: float,
    measured: Path | None,
    user_robot: OtherRobot | None,
    groups: Sequence[str] = (),
) -> Choice:
    """Return what a run does, from names of tasks and groups, specs of tasks, estimators and calibration methods.

    Without names and groups, all standard tasks are run. If only estimators are given, those of them that judge
    estimators; if only methods, theirs; if neither, all with all built-in estimators and methods. user_robot: the robot
    of the tasks instead of the official one. Raises InputError where that is impossible.
    """
    known = tasks_with(measured) if user_robot is None else tasks_on(user_robot)
    if user_robot is not None and any(map(is_plugged, names)):
        raise InputError("--robot: a task of a file has a robot of its own; leave one of both out")
    known, names = with_plugged(known, names, timeout)
    named = bool(names or groups)
    selected = select_tasks(known, names, groups) if named else [task for task in known if task.standard]
    tasks = judging(selected, bool(estimators), bool(methods), named)
    runnable = [task for task in tasks if task.missing is None]
    if user_robot is not None and not runnable:
        raise InputError("; ".join(dict.fromkeys(f"{task.missing}" for task in tasks)))
    entries = entries_named(estimators, timeout, load_estimator)
    method_entries = entries_named(methods, timeout, load_calibration)
    others = (
        () if named else [task for task in judging(known, bool(estimators), bool(methods), named) if not task.standard]
    )
    left_out, declining_all = not_serving(entries, _of_estimators(runnable), timeout, _of_estimators(others))
    plan = []
    for task in runnable:
        if not (entries or method_entries):
            chosen = builtin_entries(task)
        elif odometry_of(task) is None:
            declining = {left.estimator for left in left_out.get(task.name, [])}
            chosen = tuple(entry for entry in entries if entry.name not in declining)
        else:
            chosen = method_entries
        plan.append(Assignment(task, tuple(task.cases(cases)), chosen))
    plan = [assignment for assignment in plan if assignment.estimators]
    if user_robot is not None and not (plan or declining_all):
        raise InputError(f"no built-in estimator serves robot {user_robot.robot.name!r}; name one with --estimator")
    return Choice(tasks, tuple(plan), (*entries, *method_entries), left_out, declining_all)


def tasks_with(measured: Path | None) -> tuple[Task, ...]:
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


def judging(tasks: Sequence[Task], estimators: bool, methods: bool, named: bool) -> tuple[Task, ...]:
    """Return the tasks that judge what the user names: estimators, calibration methods, or all tasks if neither.

    named: whether the user names the tasks; then raises InputError for a task that judges nothing that is named.
    """
    if not estimators and not methods:
        return tuple(tasks)
    kept = []
    for task in tasks:
        of_methods = odometry_of(task) is not None
        if methods if of_methods else estimators:
            kept.append(task)
        elif named:
            judged, option = ("calibration methods", "--method") if of_methods else ("estimators", "--estimator")
            raise InputError(f"task {task.name!r} judges {judged}; name them with {option}, or leave the task out")
    return tuple(kept)


@overload
def entries_named(
    specs: Sequence[str], timeout: float, load: Callable[[str], EstimatorEntry]
) -> tuple[EstimatorEntry, ...]: ...
@overload
def entries_named(
    specs: Sequence[str], timeout: float, load: Callable[[str], CalibrationEntry]
) -> tuple[CalibrationEntry, ...]: ...
def entries_named(specs: Sequence[str], timeout: float, load: Load) -> tuple[Competitor, ...]:
    """Return the estimators or methods that specs name, each once; raises InputError for two that share a name.

    Each plug-in is first loaded in a separate process: a plug-in that hangs or ends its process on import is refused.
    What it prints on import is dropped.
    """
    role = ESTIMATOR if load is load_estimator else CALIBRATION
    entries: dict[str, Competitor] = {}
    for spec in specs:
        if runs_others_code(spec, role):
            load_apart(spec, timeout, load)
            with contained():
                entry = load(spec)
        else:
            entry = load(spec)
        known = entries.setdefault(entry.name, entry)
        if known.source_hash != entry.source_hash:
            kind = "estimators" if isinstance(entry, EstimatorEntry) else "calibration methods"
            raise InputError(f"two {kind} are named {entry.name!r}: {known.spec} and {entry.spec}; rename one class")
    return tuple(entries.values())


def builtin_entries(task: Task) -> tuple[Competitor, ...]:
    """Return the built-in estimators, or calibration methods, that a task judges."""
    if odometry_of(task) is not None:
        return tuple(_method(name) for name in CALIBRATION.built_in)
    return tuple(_estimator(name) for name in builtin_names(task.robot))


_estimator, _method = cache(load_estimator), cache(load_calibration)
"""Load a built-in one once for all tasks."""


def not_serving(
    entries: Sequence[EstimatorEntry], tasks: Sequence[Task], timeout: float, others: Sequence[Task] = ()
) -> tuple[dict[str, list[boards.DeclinedEstimator]], dict[str, str]]:
    """Return the estimators among `entries` that decline a task's robot, by task, and why some decline all, by name.

    timeout: s, for a plug-in to answer for a robot. others: tasks that were not chosen, but could be: those that an
    estimator serves who declines all that were chosen stand with its reason.
    """
    left_out: dict[str, list[boards.DeclinedEstimator]] = {}
    declining_all: dict[str, str] = {}
    for entry in entries:
        reasons = _refusals(entry, tasks, timeout)
        if tasks and len(reasons) == len(tasks):
            why = "; ".join(dict.fromkeys(reasons.values()))
            declining = _refusals(entry, others, timeout)
            served = [task.name for task in others if task.name not in declining]
            hint = f"; --task takes those that it serves: {', '.join(served)}" if served else ""
            declining_all[entry.name] = why + hint
        for task, reason in reasons.items():
            left_out.setdefault(task, []).append(boards.DeclinedEstimator(entry.name, reason))
    return left_out, declining_all


def _refusals(entry: EstimatorEntry, tasks: Sequence[Task], timeout: float) -> dict[str, str]:
    """Return why an estimator declines tasks' robots, by task; each robot is asked for once."""
    robots = {task.robot.hash(): task.robot for task in tasks}
    if entry.builtin:
        reasons = [entry.applicable(robot) for robot in robots.values()]
    else:
        reasons = refusals_apart(entry.spec, list(robots.values()), timeout)
    by_robot = dict(zip(robots, reasons, strict=True))
    return {task.name: reason for task in tasks if (reason := by_robot[task.robot.hash()]) is not None}


def _of_estimators(tasks: Sequence[Task]) -> list[Task]:
    """Return the tasks that judge estimators."""
    return [task for task in tasks if odometry_of(task) is None]


def without_data(tasks: Sequence[Task], names: Sequence[str], groups: Sequence[str]) -> list[Task]:
    """Return which tasks that a user asked for cannot be run for lack of their data.

    Of tasks that only their group names, all or none: a group's other tasks may be what was meant.
    """
    lacking = [task for task in tasks if task.missing is not None]
    if groups and len(lacking) == len(tasks):
        return lacking
    return [
        task for task in lacking if not {given_as(task), task.name, TaskName.of(task.name).official}.isdisjoint(names)
    ]


def failed_rows(plan: Sequence[Assignment], board: boards.Leaderboard) -> list[str]:
    """Return which estimators failed how many of the cases of a plan, by task; declining is not a failure."""
    shown = {(task.task, entry.estimator): entry for task in board.boards for entry in task.entries}
    failures = []
    for assignment in plan:
        for competitor in assignment.estimators:
            entry = shown.get((assignment.task.name, competitor.name))
            if entry is None or entry.source_hash != competitor.source_hash:
                continue
            lost = [
                case
                for failed in entry.failed
                if not failed.declined
                for case in failed.cases
                if case in assignment.cases
            ]
            if lost:
                cases = f"{len(lost)} of {len(assignment.cases)} cases"
                failures.append(f"{competitor.name} failed {cases} of {given_as(assignment.task)}")
    return failures


def declining_everything(choice: Choice, board: boards.Leaderboard) -> list[str]:
    """Return which named estimators or methods declined every task: when they were asked, and why, or in the run."""
    scored = {entry.estimator for task in board.boards for entry in task.entries}
    declining = {declined.estimator for task in board.boards for declined in task.declined}
    in_run = [entry.name for entry in choice.named if entry.name in declining - scored - set(choice.declining_all)]
    asked = (f"{name} declined every task: {why}" for name, why in choice.declining_all.items())
    return [*asked, *(f"{name} declined every task" for name in in_run)]
