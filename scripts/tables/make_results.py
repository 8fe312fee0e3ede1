"""Write docs/results.json from a results folder, and the tables of docs/benchmark.md and docs/trains.md from that.

    castor-bench run --measured DIR && python scripts/tables/make_results.py [RESULTS]

RESULTS is the folder that `castor-bench run` wrote, castor-results by default. It must hold all official cases; tasks
on measured data may be missing.
"""

import json
import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.leaderboard.board import Entry, TaskBoard, build
from benchmarks.results.rows import ResultsStore
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks import official_tasks
from castor_envs.files import write_atomically

FORMAT = "castor-figures/1"
DOCS = Path(__file__).parents[2] / "docs"
PAGES = (DOCS / "benchmark.md", DOCS / "trains.md")
FIGURES = DOCS / "results.json"
START, END = "<!-- table {}: made by scripts/tables/make_results.py -->\n", "<!-- end of table -->\n"
DIGITS = 10
"""Significant digits of what is stored: more than any page shows, fewer than differ between machines."""

Figures = dict[str, Any]


def figures_of(results: Path) -> Figures:
    """Return the figures of a results folder as plain data, in SI; raises ValueError if official cases are missing."""
    store = ResultsStore(results)
    tasks = []
    for task, board in zip(official_tasks(), build(official_tasks(), results).boards, strict=True):
        if not task.cases() or (not board.entries and (task.missing is not None or not task.standard)):
            continue  # of tasks whose cases are those of a folder, `make_measured_boards.py` writes figures
        if set(board.cases) != set(task.cases()) or any(entry.lacking for entry in board.entries):
            raise ValueError(f"{results}: has not all {len(task.cases())} cases of {task.name}; run castor-bench run")
        tasks.append(_task_figures(board, store))
    return {"format": FORMAT, "tasks": tasks}


def _task_figures(board: TaskBoard, store: ResultsStore) -> Figures:
    scores: dict[tuple[str, str], dict[Any, float]] = {}
    for row in store.rows(board.task, board.version):
        if row.failure is None:
            scores.setdefault((row.estimator, row.source_hash), {})[row.case] = row.scores[board.metric.name]
    return {
        "task": board.task,
        "version": board.version,
        "metric": board.metric.name,
        "cases": list(board.cases),
        "estimators": [
            _entry_figures(entry, board, scores.get((entry.estimator, entry.source_hash), {}))
            for entry in board.entries
        ],
        "references": [
            {"estimator": entry.estimator, "scores": _scores(entry, board)}
            for entry in board.rows[len(board.entries) :]
        ],
    }


def _entry_figures(entry: Entry, board: TaskBoard, by_case: dict[Any, float]) -> Figures:
    return {
        "estimator": entry.estimator,
        "rank": entry.rank,
        "failed": sum(len(failed.cases) for failed in entry.failed),
        "scores": _scores(entry, board),
        "by_case": [_rounded(by_case.get(case)) for case in board.cases],
    }


def _scores(entry: Entry, board: TaskBoard) -> Figures:
    """Return the means, with their intervals, of what the pages show."""
    shown = {board.metric.name, *MORE_METRICS.get(board.task, ())}
    return {
        name: [_rounded(number) for number in (score.mean, score.low, score.high)]
        for name, score in entry.scores.items()
        if name in shown
    }


def _rounded(number: float | None) -> float | None:
    return None if number is None else float(f"{number:.{DIGITS}g}")


def text_of(figures: Figures) -> str:
    """Return figures as JSON with a list of numbers in each line."""
    text = json.dumps(figures, indent=1, allow_nan=False)
    return re.sub(r"\[[^\[\]{}]*\]", lambda match: re.sub(r"\s+", " ", match[0]), text) + "\n"


def with_tables(page: str, figures: Figures) -> str:
    """Return a page with new tables between its marks."""
    for name, table in TABLES.items():
        start = START.format(name)
        if start in page:
            before, rest = page.split(start)
            page = before + start + "\n" + table(figures) + "\n" + END + rest.split(END, 1)[1]
    return page


def by_estimator(columns: dict[tuple[str, str], str], figures: Figures) -> str:
    """Return a table with a row for each estimator; columns: task and metric, with their heading.

    Estimators stand in the order of the first column that they have a score in; below them the oracle and standing
    still, which have no rank.
    """
    beside = {task["task"]: {entry["estimator"]: entry for entry in task["references"]} for task in figures["tasks"]}
    tasks = {task["task"]: {entry["estimator"]: entry for entry in task["estimators"]} for task in figures["tasks"]}
    columns = {column: heading for column, heading in columns.items() if column[0] in tasks}
    names = dict.fromkeys(name for task, _ in columns for name in tasks[task])
    rows = [[name, *(_cell(tasks[task].get(name), metric) for task, metric in columns)] for name in names]
    rows += [
        [f"*{name}*", *(_reference_cell(beside[task].get(name), metric) for task, metric in columns)]
        for name in dict.fromkeys(name for task, _ in columns for name in beside[task])
    ]
    units = [f"{heading}, {BOARD_METRICS[metric].shown_unit}" for (_, metric), heading in columns.items()]
    return _markdown(["estimator", *units], [row for row in rows if set(row[1:]) != {"–"}], text_columns=1)


def by_task(names: tuple[str, ...], metrics: tuple[str, ...], figures: Figures) -> str:
    """Return a table with a row for each calibration method of each task."""
    rows = [
        [f"`{task['task']}`" if k == 0 else "", entry["estimator"], *(_cell(entry, metric) for metric in metrics)]
        for name in names
        for task in figures["tasks"]
        if task["task"] == name
        for k, entry in enumerate(task["estimators"])
    ]
    units = [f"{BOARD_METRICS[name].title}, {BOARD_METRICS[name].shown_unit}" for name in metrics]
    return _markdown(["task", "method", *units], rows, text_columns=2)


def _cell(entry: Figures | None, metric: str) -> str:
    """Return a mean, by what ranks with its interval and rank; of what failed in some cases their number instead.

    The mean over the cases that did not fail would flatter it.
    """
    if entry is not None and entry["failed"] and metric in RANKING:
        return f"failed in {entry['failed']} of {len(entry['by_case'])}"
    if entry is None or entry["failed"] or metric not in entry["scores"]:
        return "–"
    mean, low, high = entry["scores"][metric]
    shown = BOARD_METRICS[metric].shown
    if metric not in RANKING:
        return shown(mean)
    interval = "" if low is None else f" [{shown(low)}, {shown(high)}]"
    return f"{shown(mean)}{interval} ({entry['rank'] or '–'})"


def _reference_cell(entry: Figures | None, metric: str) -> str:
    """Return the mean of what is no estimator."""
    if entry is None or metric not in entry["scores"]:
        return "–"
    return BOARD_METRICS[metric].shown(entry["scores"][metric][0])


def _markdown(heading: list[str], rows: list[list[str]], text_columns: int) -> str:
    rule = ["---"] * text_columns + ["--:"] * (len(heading) - text_columns)
    return "".join(f"| {' | '.join(row)} |\n" for row in (heading, rule, *rows))


RANKING = {task.metric for task in official_tasks()}
SNAPSHOTS = {
    "configuration-static": "static",
    "configuration-one-of-three": "one of three",
    "configuration-two-of-five": "two of five",
    "configuration-small": "small",
    "configuration-opposite-bends": "opposite bends",
}
DRIVES = {
    "train-2-patch": "2 axles, slippery",
    "train-2-cables": "2, cables",
    "train-3-patch": "3, slippery",
    "train-3-cables": "3, cables",
    "train-5-patch": "5, slippery",
    "train-5-cables": "5, cables",
}
CALIBRATIONS = ("calibration-pivoting", "calibration-physics", "calibration-umbmark", "calibration-measured")
PARAMETERS = ("offset_error", "radius_error", "half_track_error", "pivot_zero_error")
MORE_METRICS = {
    **dict.fromkeys(SNAPSHOTS, ("share_within_5cm", "sound_axle_chosen")),
    **dict.fromkeys(CALIBRATIONS, PARAMETERS),
}
"""What the pages show of a task beside the metric that ranks."""

TABLES: dict[str, Callable[[Figures], str]] = {
    "squares": partial(
        by_estimator,
        {
            ("umbmark-kinematic-uncalibrated", "E_max_syst"): "uncalibrated",
            ("umbmark-kinematic-calibrated", "E_max_syst"): "calibrated",
            ("umbmark-physics-clean", "E_max_syst"): "clean floor",
            ("umbmark-physics-cables", "nonsystematic_orientation_error"): "cables",
            ("umbmark-physics-slippery", "end_point_position"): "slippery",
        },
    ),
    "measured squares": partial(
        by_estimator,
        {
            ("umbmark-measured-nominal", "E_max_syst"): "nominal dimensions",
            ("umbmark-measured-corrected", "E_max_syst"): "corrected dimensions",
        },
    ),
    "calibration": partial(by_task, CALIBRATIONS, ("E_max_syst", *PARAMETERS)),
    "snapshots": partial(by_estimator, {(task, "mean_axle_position"): text for task, text in SNAPSHOTS.items()}),
    "snapshots within 5 cm": partial(
        by_estimator, {(task, "share_within_5cm"): text for task, text in SNAPSHOTS.items()}
    ),
    "snapshots right axle": partial(
        by_estimator, {(task, "sound_axle_chosen"): text for task, text in SNAPSHOTS.items()}
    ),
    "driven trains": partial(by_estimator, {(task, "mean_axle_position"): text for task, text in DRIVES.items()}),
    "static tests after a drive": partial(
        by_estimator, {("configuration-history", "final_axle_position"): "static tests after a drive"}
    ),
}
"""The tables by the name in their mark."""


def main(results: Path) -> None:
    """Write the figures and the pages."""
    figures = figures_of(results)
    write_atomically(FIGURES, text_of(figures))
    for page in PAGES:
        write_atomically(page, with_tables(page.read_text(encoding="utf-8"), figures))
    run = {task["task"] for task in figures["tasks"]}
    absent = {task.name for task in official_tasks() if task.standard and task.cases()} - run
    if absent:
        print(f"without {', '.join(sorted(absent))}: castor-bench run --measured DIR runs them")


if __name__ == "__main__":
    try:
        main(Path(*sys.argv[1:2] or ["castor-results"]))
    except ValueError as error:
        sys.exit(f"error: {error}")
