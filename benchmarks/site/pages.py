"""``castor-bench page``: the static site of a results folder."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.leaderboard.board import Entry, Leaderboard, TaskBoard
from benchmarks.leaderboard.notes import board_notes, general_notes
from benchmarks.leaderboard.overview import overviews
from benchmarks.leaderboard.overview_views import MEANING, not_run, overview_notes, overview_title
from benchmarks.leaderboard.ranking import LEVEL
from benchmarks.results.provenance import provenance
from benchmarks.show.repeat import run_command
from benchmarks.site.cases import StoredCases
from benchmarks.site.row import row_page
from benchmarks.site.tables import Cell, Heading, Table, board_table, overview_table
from castor_envs.files import new_folder, write_atomically
from castor_envs.rendering.pages.page import render, safe_name, write_assets

FOLDER = Path(__file__).parent


def single_page(leaderboard: Leaderboard) -> str:
    """Return overviews and all boards as one page that holds all that it needs; without pages of rows."""
    parts = [_part(board) for board in leaderboard.boards if _told(board)]
    return render(FOLDER, "index.html", tasks=None, boards=parts, **_overview(leaderboard))


def write_site(leaderboard: Leaderboard, results: Path, out: Path) -> int:
    """Write the site to a new folder, whole or not at all; return how many pages it has.

    index.html leads to ``tasks/TASK.html``, and these to ``tasks/TASK/ESTIMATOR.html``. Raises InputError where `out`
    exists already or cannot be written.
    """
    pages = 0
    with new_folder(out) as partial:
        write_assets(partial / "assets")
        told = [board for board in leaderboard.boards if _told(board)]
        for board in told:
            stored = StoredCases.of(results, board.task, board.version)
            name = safe_name(board.task)
            for entry in board.entries:
                write_atomically(
                    partial / "tasks" / name / f"{row_name(entry)}.html",
                    row_page(board, entry, stored, f"../{name}.html", made()),
                )
                pages += 1
            part = _part(board, lambda entry, name=name: f"{name}/{row_name(entry)}.html")
            command = run_command(board.given, of_methods=board.odometry is not None)
            text = render(FOLDER, "task.html", "../assets", part=part, command=command, made=made())
            write_atomically(partial / "tasks" / f"{name}.html", text)
            pages += 1
        index = render(FOLDER, "index.html", "assets", tasks=_tasks(told), boards=[], **_overview(leaderboard))
        write_atomically(partial / "index.html", index)
    return pages + 1


def row_name(entry: Entry) -> str:
    """Return the name of an estimator's page, without its ending."""
    return safe_name(entry.estimator)


def _told(board: TaskBoard) -> bool:
    """Return whether a board has anything to show; why others have not stands below all of them."""
    return bool(board.entries or board.declined)


def _part(board: TaskBoard, link: Callable[[Entry], str | None] = lambda entry: None) -> dict[str, Any]:
    """Return what a page shows of a board. link: to the page of a row."""
    return {
        "id": safe_name(board.task),
        "board": board,
        "table": board_table(board, link) if board.entries else None,
        "notes": board_notes(board, intervals="in brackets and drawn"),
    }


def _overview(leaderboard: Leaderboard) -> dict[str, Any]:
    """Return what a page shows above the boards, and below."""
    return {
        "overviews": [
            {"title": overview_title(overview), "table": overview_table(overview), "notes": overview_notes(overview)}
            for overview in overviews(leaderboard.boards)
        ],
        "meaning": MEANING,
        "general": [*not_run(leaderboard), *general_notes(leaderboard)],
        "made": made(),
    }


def _tasks(boards: Sequence[TaskBoard]) -> Table:
    """Return the table of all tasks, each with those who are first in it."""
    headings = (
        Heading("task", number=False),
        Heading("group", number=False),
        Heading("cases"),
        Heading("ranked by", number=False),
        Heading("first", number=False),
        Heading("its score"),
    )
    return Table(headings, tuple(map(_task, boards)), names=0)


def _task(board: TaskBoard) -> tuple[Cell, ...]:
    first = [entry for entry in board.entries if entry.rank == 1]
    score = first[0].scores[board.metric.name] if first else None
    others = f"and {len(first) - 1} more" if len(first) > 1 else ""
    shown = (
        Cell("–") if score is None else Cell(f"{board.metric.shown(score.mean)} {board.metric.shown_unit}", score.mean)
    )
    return (
        Cell(board.title, board.title, link=f"tasks/{safe_name(board.task)}.html"),
        Cell(board.group, board.group),
        Cell(str(len(board.cases)), len(board.cases)),
        Cell(board.metric.title, board.metric.title),
        Cell(first[0].estimator if first else "–", first[0].estimator if first else "", note=others),
        shown,
    )


def made() -> str:
    """Say when and by what a page was made."""
    origin = provenance()
    return (
        f"Made on {origin.created:%Y-%m-%d} by castor-envs {origin.versions['castor-envs']}, world {origin.world}. "
        f"Intervals are of {100 * LEVEL:.0f} %. Curves are drawn by uPlot (MIT licence)."
    )
