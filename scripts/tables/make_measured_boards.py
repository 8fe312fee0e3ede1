"""Write docs/measured_boards.json from a results folder, and the table of docs/benchmark.md from that.

    castor-bench run --group measured-drives --measured DIR --results RESULTS
    python scripts/tables/make_measured_boards.py [RESULTS]

Its cases are those of the folder DIR, so they are stored with the scores. Without RESULTS the table alone is written.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.leaderboard.board import TaskBoard, build
from benchmarks.results.rows import ResultsStore
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks.measured_runs import tasks
from castor_envs.files import write_atomically

FORMAT = "castor-measured-boards/1"
DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "benchmark.md", DOCS / "measured_boards.json"
START, END = "<!-- table: made by scripts/tables/make_measured_boards.py -->\n", "<!-- end of measured boards -->\n"
DIGITS = 10


def figures_of(results: Path) -> dict[str, Any]:
    """Return the boards of a results folder as plain data, in SI."""
    store, boards = ResultsStore(results), build(tasks(None), results).boards
    return {"format": FORMAT, "tasks": [_board(board, store) for board in boards if board.entries]}


def _board(board: TaskBoard, store: ResultsStore) -> dict[str, Any]:
    metric = board.metric.name
    scores: dict[str, dict[Any, float]] = {}
    for row in store.rows(board.task, board.version):
        if row.failure is None:
            scores.setdefault(row.estimator, {})[row.case] = row.scores[metric]
    return {
        "task": board.task,
        "version": board.version,
        "metric": metric,
        "cases": list(board.cases),
        "estimators": [
            {
                "estimator": entry.estimator,
                "rank": entry.rank,
                "by_case": [_rounded(scores.get(entry.estimator, {}).get(case)) for case in board.cases],
            }
            for entry in board.entries
        ],
    }


def _rounded(number: float | None) -> float | None:
    return None if number is None else float(f"{number:.{DIGITS}g}")


def mean(entry: Mapping[str, Any]) -> float | None:
    """Return the mean score of an estimator; None where it failed in a case."""
    values = entry["by_case"]
    return None if None in values else sum(values) / len(values)


def table(figures: Mapping[str, Any]) -> str:
    """Return the table of all boards: means and ranks of all estimators."""
    names = dict.fromkeys(entry["estimator"] for task in figures["tasks"] for entry in task["estimators"])
    rows = [["task", "cases", "score", *names]]
    for task in figures["tasks"]:
        metric, entries = BOARD_METRICS[task["metric"]], {entry["estimator"]: entry for entry in task["estimators"]}
        cells = [
            f"{metric.shown(mean(entries[name]))} ({entries[name]['rank'] or '–'})" if name in entries else "–"
            for name in names
        ]
        rows.append([f"`{task['task']}`", str(len(task["cases"])), f"{metric.title}, {metric.shown_unit}", *cells])
    rows.insert(1, ["---", "--:", "---", *["--:"] * len(names)])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def with_table(page: str, figures: Mapping[str, Any]) -> str:
    """Return the page with a new table between its marks."""
    before, rest = page.split(START)
    return before + START + "\n" + table(figures) + "\n" + END + rest.split(END, 1)[1]


def main(results: Path | None) -> None:
    """Write the figures, if there are new ones, and the page."""
    if results is not None:
        write_atomically(FIGURES, json.dumps(figures_of(results), indent=1, allow_nan=False) + "\n")
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    write_atomically(PAGE, with_table(PAGE.read_text(encoding="utf-8"), figures))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
