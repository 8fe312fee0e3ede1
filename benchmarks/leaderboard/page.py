"""A leaderboard as one static HTML page that fetches nothing; Jinja2 escapes all text."""

from pathlib import Path

from benchmarks.leaderboard.board import Leaderboard
from benchmarks.leaderboard.notes import board_notes, general_notes
from benchmarks.leaderboard.overview import overviews
from benchmarks.leaderboard.overview_views import MEANING, overview_columns, overview_notes, overview_title
from benchmarks.leaderboard.views import whole_table


def as_html(leaderboard: Leaderboard) -> str:
    """Return the page: the overviews, then every board with results or a reason why there are none."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # slow to import

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    tables = [
        {
            "title": overview_title(overview),
            "columns": overview_columns(overview),
            "rows": range(len(overview.entries)),
            "notes": [*MEANING, *overview_notes(overview)],
        }
        for overview in overviews(leaderboard.boards)
    ]
    boards = [
        {
            "board": board,
            "table": whole_table(board) if board.entries else [],
            "notes": board_notes(board, intervals="in brackets"),
        }
        for board in leaderboard.boards
        if board.entries or board.declined or board.missing
    ]
    template = environment.get_template("page.html")
    return template.render(overviews=tables, boards=boards, notes=general_notes(leaderboard))
