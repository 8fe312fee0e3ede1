"""The page of one estimator on one task: trajectories, error over distance, where runs end, provenance, commands."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.leaderboard.board import Entry, TaskBoard
from benchmarks.leaderboard.ranking import LEVEL
from benchmarks.results.rows import DECLINED, Row
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.show.drives import Drive
from benchmarks.show.figures import path_map
from benchmarks.show.repeat import place_note, run_command, show_command
from benchmarks.site.cases import StoredCases, end_errors, typical_cases
from benchmarks.site.tables import Cell, Heading, Table
from benchmarks.tasks.task import Case
from castor_envs.rendering.pages.curves import ZOOM, Chart, Curve
from castor_envs.rendering.pages.maps import FloorMap, Line, Spot, floor_map
from castor_envs.rendering.pages.page import render

MOST_METRICS = 6
"""Columns of the table of cases, beside the ranking metric."""
COLORS = {"best": 2, "median": 5, "worst": 1}


def row_page(board: TaskBoard, entry: Entry, stored: StoredCases, up: str, made: str) -> str:
    """Return the page. up: where the board is."""
    rows = {case: row for case, row in stored.of_entry(entry).items() if case in board.cases}
    typical = typical_cases(board, rows)
    seen = {word: stored.drives(case, {entry.estimator: rows[case]}) for word, case in typical.items()}
    of_methods = board.odometry is not None
    shown = typical.get("median", next(iter(rows), None))
    commands = [run_command(board.given, entry.estimator, of_methods, entry.spec)]
    if shown is not None:
        commands.append(show_command(board.given, shown, {entry.estimator: entry.spec}, of_methods))
    scatter, scatter_caption = _scatter(entry, rows, stored)
    return render(
        Path(__file__).parent,
        "row.html",
        "../../assets",
        board=board,
        entry=entry,
        up=up,
        made=made,
        standing=_standing(board, entry),
        scores=[(f"{metric.title} ({metric.description})", _said(metric, entry)) for metric in _metrics(board, entry)],
        cases=[_case(word, typical[word], drives[0], entry, board) for word, drives in seen.items() if drives],
        charts=_errors(typical, seen, entry),
        scatter=scatter,
        scatter_caption=scatter_caption,
        by_case=_by_case(board, entry, rows),
        commands=commands,
        place=place_note(entry.estimator, of_methods, entry.spec),
        origin=_origin(entry, rows),
    )


def _standing(board: TaskBoard, entry: Entry) -> str:
    """Say where an estimator stands."""
    if entry.rank is None:
        return f"not ranked among {len(board.entries)}"
    sharing = sum(other.rank == entry.rank for other in board.entries) - 1
    shared = f", shared with {sharing} more" if sharing else ""
    return f"rank {entry.rank} of {len(board.entries)}{shared}, by {board.metric.title} over {entry.done} cases"


def _metrics(board: TaskBoard, entry: Entry) -> list[Metric]:
    """Return the metrics that an entry has, the one that ranks first."""
    return sorted((BOARD_METRICS[name] for name in entry.scores), key=lambda metric: metric != board.metric)


def _said(metric: Metric, entry: Entry) -> str:
    score = entry.scores[metric.name]
    limits = (
        ""
        if score.low is None
        else f" ({100 * LEVEL:.0f} % interval {metric.shown(score.low)} to {metric.shown(score.high)})"
    )
    return f"{metric.shown(score.mean)} {metric.shown_unit}{limits}"


def _case(word: str, case: Case, drive: Drive, entry: Entry, board: TaskBoard) -> dict[str, Any]:
    command = show_command(board.given, case, {entry.estimator: entry.spec}, board.odometry is not None)
    return {
        "title": f"{word.capitalize()} case: {case}",
        "map": path_map(drive, [entry.estimator]),
        "caption": f"{drive.name.capitalize()}.",
        "command": command,
    }


def _errors(typical: dict[str, Case], seen: dict[str, list[Drive]], entry: Entry) -> list[Chart]:
    """Return the position error against the distance driven, of all runs of the typical cases."""
    curves = []
    for word, drives in seen.items():
        for k, drive in enumerate(drives):
            if len(drive.samples) > 1:
                position, _ = drive.errors(entry.estimator)
                label = f"{word} ({typical[word]}), {drive.name}"
                curves.append(Curve(label, *drive.against_way(1e3 * position), COLORS[word], dash=k > 0))
    if not curves:
        return []
    ends = "; ".join(f"{curve.label} ends {curve.y[-1]:.3g} mm off" for curve in curves)
    caption = f"Position error against the distance driven. {ZOOM}"
    return [Chart("driven, m", "position error, mm", tuple(curves), f"{caption} {ends}.", caption)]


def _scatter(entry: Entry, rows: dict[Case, Row], stored: StoredCases) -> tuple[FloorMap | None, str]:
    """Return a map of by how much estimates were off at the end of every run, mm, about zero."""
    spots = []
    for case, row in rows.items():
        for drive in stored.drives(case, {entry.estimator: row}):
            x, y = (1e3 * end_errors(drive, entry.estimator)).tolist()
            if math.isfinite(x) and math.isfinite(y):
                kind = "point s5" if "ccw" in drive.name else "point s1"
                spots.append(Spot(x, y, 4.0, kind, f"case {case}, {drive.name}: {x:.3g}, {y:.3g} mm"))
    if not spots:
        return None, ""
    both = len({spot.kind for spot in spots}) > 1
    alt = f"Scatter of {len(spots)} end errors about the true end"
    zero = [Spot(0.0, 0.0, 5.0, "start", "the true end")]
    colors = " Orange: clockwise, blue: counter-clockwise." if both else ""
    return (
        floor_map([Line(np.zeros((1, 2)), "true", "")], alt, [*zero, *spots], unit="mm", least=1e-3),
        f"By how much the last pose of every run is off in x and y. Ring: the true end.{colors}",
    )


def _by_case(board: TaskBoard, entry: Entry, rows: dict[Case, Row]) -> Table:
    metrics = _metrics(board, entry)[: 1 + MOST_METRICS]
    headings = [Heading("case", number=False)]
    headings += [Heading(f"{metric.title}, {metric.shown_unit}", title=metric.description) for metric in metrics]
    failing = any(row.failure is not None for row in rows.values())
    cells = []
    for case in sorted(rows, key=lambda case: (isinstance(case, str), case)):
        row = rows[case]
        scores = [row.scores.get(metric.name) for metric in metrics]
        line = [Cell(str(case), case)]
        line += [Cell(m.shown(s), "" if s is None else s) for m, s in zip(metrics, scores, strict=True)]
        if failing:
            line.append(Cell((row.failure or "").removeprefix(DECLINED), row.failure or ""))
        cells.append(tuple(line))
    if failing:
        headings.append(Heading("failure", number=False))
    return Table(tuple(headings), tuple(cells), names=0)


def _origin(entry: Entry, rows: dict[Case, Row]) -> dict[str, str]:
    """Return where an estimator's rows come from."""
    origins = [row.origin for row in rows.values()]
    if not origins:
        return {"source": entry.source_hash}
    made = sorted(origin.created for origin in origins)
    newest = max(origins, key=lambda origin: origin.created)
    timed_on = None if entry.cost is None else entry.cost.machine
    return {
        "estimator's source": entry.source_hash,
        "robot files": ", ".join(sorted({row.robot_hash for row in rows.values()})[:3])
        + (" and more" if len({row.robot_hash for row in rows.values()}) > 3 else ""),
        "computed": " to ".join(dict.fromkeys(time.strftime("%Y-%m-%d %H:%M UTC") for time in (made[0], made[-1]))),
        "world": ", ".join(sorted({origin.world for origin in origins})),
        "versions": ", ".join(f"{name} {version}" for name, version in newest.versions.items()),
        "machine": str(newest.machine),
        **({} if timed_on is None else {"updates timed on": str(timed_on)}),
    }
