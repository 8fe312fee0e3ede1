"""A comparison for people, in a terminal and as pages with the cases that differ most, and as data for programs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from benchmarks.leaderboard.notes import say
from benchmarks.leaderboard.ranking import FEWEST_CASES, LEVEL
from benchmarks.results.asked import asked_as
from benchmarks.show.drives import Shown
from benchmarks.show.page import page_of
from benchmarks.show.repeat import place_note, run_command, show_command
from benchmarks.site.cases import StoredCases
from benchmarks.site.compare import TaskDifference, Verdict
from benchmarks.site.pages import made
from benchmarks.tasks.task import Case, odometry_of
from castor_envs.files import new_folder, write_atomically
from castor_envs.rendering.pages.page import render, safe_name, write_assets

FOLDER = Path(__file__).parent
FORMAT = "castor-compare/1"


def print_comparison(found: Sequence[TaskDifference], console: Console, left_out: Sequence[str] = ()) -> None:
    """Print a table of all tasks, what it means, and what it leaves out. left_out: notes beside those of `notes`."""
    first, second = found[0].labels
    console.print(f"\n{first} against {second}", style="bold", markup=False, highlight=False)
    grid = Grid()
    for heading, right in (
        ("task", False),
        ("", False),
        (first, True),
        (second, True),
        ("difference", True),
        ("most in cases", False),
    ):
        grid.add_column(heading, justify="right" if right else "left", overflow="fold")
    for of in found:
        a, b = (of.metric.shown(mean) for mean in of.means)
        grid.add_row(
            f"{of.task.name}: {of.metric.short}, {of.metric.shown_unit}",
            of.verdict.value,
            a,
            b,
            difference(of),
            cases_said(of),
        )
    console.print(grid, highlight=False, markup=False)
    for note in (*notes(found), *left_out):
        say(console, note)


def as_json(found: Sequence[TaskDifference], left_out: Sequence[str] = ()) -> dict[str, Any]:
    """Return the comparison as plain data; scores and differences, of the first less the second, in SI."""
    return {
        "format": FORMAT,
        "interval_level": LEVEL,
        "tasks": [
            {
                "task": of.task.name,
                "version": of.task.version,
                "compared": list(of.labels),
                "metric": of.metric.key,
                "unit": of.metric.unit,
                "verdict": of.verdict.value,
                "means": list(of.means),
                "difference": {"mean": of.difference.mean, "low": of.difference.low, "high": of.difference.high},
                "by_case": {str(case): off for case, off in of.by_case.items()},
                "failed": list(of.failed),
            }
            for of in found
        ],
        "left_out": list(left_out),
    }


def write_comparison(found: Sequence[TaskDifference], results: Path, out: Path, left_out: Sequence[str] = ()) -> None:
    """Write index.html and a page for each of the cases that differ most to a new folder, whole or not at all."""
    with new_folder(out) as partial:
        write_assets(partial / "assets")
        linked = []
        for of in found:
            stored = StoredCases.of(results, of.task.name, of.task.version)
            links = []
            for case in of.most:
                page = _case_page(of, case, stored)
                name = f"{safe_name(of.task.name)}-{safe_name(str(case))}.html"
                if page is not None:
                    write_atomically(partial / "cases" / name, page)
                links.append((case, signed(of, of.by_case[case]), f"cases/{name}" if page is not None else None))
            linked.append({"of": of, "difference": difference(of), "cases": links, "css": _class(of.verdict)})
        competitors = [
            (asked_as(of.task), label, odometry_of(of.task) is not None, spec)
            for of in found
            for label, spec in zip(of.labels, of.specs, strict=True)
            if "@" not in label
        ]
        places = dict.fromkeys(place_note(label, of_methods, spec) for _, label, of_methods, spec in competitors)
        text = render(
            FOLDER,
            "compare.html",
            "assets",
            found=linked,
            labels=found[0].labels,
            notes_of=[*notes(found), *left_out],
            commands=[run_command(*competitor) for competitor in competitors],
            places=[place for place in places if place is not None],
            made=made(),
        )
        write_atomically(partial / "index.html", text)


def _case_page(of: TaskDifference, case: Case, stored: StoredCases) -> str | None:
    """Return the page of a case with both estimates; None where its episode is not stored."""
    rows = {label: side[case] for label, side in zip(of.labels, of.rows, strict=True)}
    drives = stored.drives(case, rows)
    if not drives:
        return None
    of_methods = odometry_of(of.task) is not None
    specs = {row.estimator: spec for row, spec in zip(rows.values(), of.specs, strict=True)}
    return page_of(
        Shown(
            title=f"{of.task.title}, case {case}",
            subtitle=f"{of.labels[0]} against {of.labels[1]}: {signed(of, of.by_case[case])} in {of.metric.title}",
            drives=drives,
            scores={label: row.scores for label, row in rows.items()},
            commands=[show_command(asked_as(of.task), case, specs, of_methods)],
            origin={f"{label}, source": row.source_hash for label, row in rows.items()}
            | {"episode": next(iter(rows.values())).episode},
        ),
        "../assets",
        home="../index.html",
    )


def difference(of: TaskDifference) -> str:
    """Return the mean paired difference with its interval, in the unit for people."""
    low, high = of.difference.low, of.difference.high
    limits = "" if low is None or high is None else f" [{signed(of, low)}, {signed(of, high)}]"
    return signed(of, of.difference.mean) + limits


def signed(of: TaskDifference, value: float) -> str:
    """Return a difference with its sign, in the metric's unit for people."""
    sign = "+" if value > of.metric.rounding else "\N{MINUS SIGN}" if value < -of.metric.rounding else ""
    return sign + of.metric.shown(abs(value))


def cases_said(of: TaskDifference) -> str:
    """Return the cases that differ most, with their differences."""
    return ", ".join(f"{case} ({signed(of, of.by_case[case])})" for case in of.most)


def notes(found: Sequence[TaskDifference]) -> list[str]:
    """Return what a comparison means and what it leaves out."""
    first, second = found[0].labels
    lines = [
        f"difference: {first} less {second} in the score that ranks, mean over the same cases with its "
        f"{100 * LEVEL:.0f} % interval; below zero {first} is better",
        "verdicts are those of a board of these two (paired, 5 % in each task), so of twenty tasks in which they are "
        "equally good one may tell them apart by chance",
    ]
    if any(of.verdict is Verdict.FEW for of in found):
        lines.append(f"fewer than {FEWEST_CASES} cases cannot show a difference; run more with --cases")
    for of in found:
        for label, failed, side in zip(of.labels, of.failed, of.rows, strict=True):
            if failed:
                lines.append(
                    f"{of.task.name}: {label} failed {failed} of {len(side)} cases, which are left out for both"
                )
        unshared = len(of.rows[0].keys() ^ of.rows[1].keys())
        if unshared:
            lines.append(f"{of.task.name}: {unshared} cases have been run for one of both alone and are left out")
    return lines


def _class(verdict: Verdict) -> str:
    return verdict.value if verdict in (Verdict.BETTER, Verdict.WORSE) else "quiet"
