"""Write docs/drives.json from a results folder, and the table of drives in docs/benchmark.md from that.

    castor-bench run --group manoeuvres ... --cases 8 --results drives
    python scripts/tables/make_drive_tables.py drives

Drives take hours in full, so that a table may be of fewer cases than the official ones; it says how many. Of an
estimator the version counts that boards show, the one that a run asked for last. Tasks of which the folder holds
nothing keep the figures stored before.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.leaderboard.board import Entry, TaskBoard, build
from benchmarks.results.references import CEILING, reference_store
from benchmarks.results.rows import ResultsStore
from benchmarks.tasks.driving.task import KINDS, ROBOTS, DrivenRobot
from benchmarks.tasks.task import Case
from castor_envs.files import write_atomically

FORMAT = "castor-drives/1"
DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "benchmark.md", DOCS / "drives.json"
START, END = "<!-- table drives: made by scripts/tables/make_drive_tables.py -->\n", "<!-- end of table -->\n"
SHOWN = ("wheel-odometry", "filter", CEILING)
NAMES = {CEILING: "oracle"}

Figures = dict[str, Any]


def figures_of(results: Path) -> Figures:
    """Return scores by task, estimator and case, in SI; raises ValueError where estimators have different cases."""
    tasks = []
    for task in (DrivenRobot(kind, label) for kind in KINDS for label in ROBOTS):
        (board,) = build([task], results).boards
        scores = {entry.estimator: _scores(board, entry, results) for entry in board.rows if entry.estimator in SHOWN}
        if not scores:
            continue
        cases = sorted(set.union(*map(set, scores.values())))
        if set(scores) != set(SHOWN) or any(set(of) != set(cases) for of in scores.values()):
            raise ValueError(f"{results}: {task.name} lacks cases of {' or '.join(SHOWN)}; run castor-bench run")
        by_case = {NAMES.get(name, name): [scores[name][case] for case in cases] for name in SHOWN}
        rounded = {name: [float(f"{value:.6g}") for value in values] for name, values in by_case.items()}
        tasks.append({"task": task.name, "metric": task.metric, "scores": rounded})
    return {"format": FORMAT, "tasks": tasks}


def added(stored: Figures, found: Figures) -> Figures:
    """Return the figures stored, with those found in place of those of the same tasks."""
    new = {task["task"]: task for task in found["tasks"]}
    kept = {task["task"]: new.pop(task["task"], task) for task in stored["tasks"]} | new
    return found | {"tasks": list(kept.values())}


def _scores(board: TaskBoard, entry: Entry, results: Path) -> dict[Case, float]:
    """Return the scores that an entry of a board has by case, in the metric that ranks."""
    without = {*entry.lacking, *(case for failed in entry.failed for case in failed.cases)}
    store = reference_store(results) if entry.estimator == CEILING else ResultsStore(results)
    return {
        row.case: row.scores[board.metric.name]
        for row in store.summaries(board.task, board.version)
        if (row.estimator, row.source_hash) == (entry.estimator, entry.source_hash)
        and row.case in set(board.cases) - without
    }


def table(figures: Figures) -> str:
    """Return a table with a row for each kind of drive: medians over the cases, mm, and of long runs mm/m."""
    by_name = {task["task"]: task["scores"] for task in figures["tasks"]}
    rows = []
    for kind in KINDS:
        cells = [_cell(by_name.get(f"{kind.name}-{label}")) for label in ROBOTS]
        if any(cells):
            unit = "mm/m" if kind.metric == "drift" else "mm"
            rows.append([f"{kind.name}, {unit}", *cells])
    heading = ["", *ROBOTS]
    rule = ["---", *["--:"] * len(ROBOTS)]
    return "".join(f"| {' | '.join(row)} |\n" for row in (heading, rule, *rows))


def _cell(scores: dict[str, list[float]] | None) -> str:
    if scores is None:
        return ""
    return " / ".join(f"{1e3 * float(np.median(values)):.3g}" for values in scores.values())


def with_table(page: str, figures: Figures) -> str:
    """Return the page with the table between its marks."""
    before, rest = page.split(START)
    return before + START + "\n" + table(figures) + "\n" + END + rest.split(END, 1)[1]


if __name__ == "__main__":
    found = added(
        json.loads(FIGURES.read_text()), figures_of(Path(sys.argv[1] if len(sys.argv) > 1 else "castor-results"))
    )
    write_atomically(
        FIGURES, json.dumps(found, indent=None, separators=(",", ":")).replace('{"task"', '\n{"task"') + "\n"
    )
    write_atomically(PAGE, with_table(PAGE.read_text(), found))
