"""Doebbler, Davis, Junkins and Valasek, Table I: parameter errors before and after calibration by pivoting."""

import math

from benchmarks.papers.assumptions import Assumptions
from benchmarks.papers.comparison import Comparison, Effort, PaperTable, TableSource
from benchmarks.papers.simulations import ErrorsLeft, errors_left

#: Table I, mean errors: %, of beta deg; before and after calibration.
TABLE_1 = {"offset": (0.21, 0.09), "radius": (2.07, 0.04), "half_track": (0.89, 0.04), "pivot_zero": (7.98, 0.01)}
ROWS = {"offset": "r_c, %", "radius": "r_w, %", "half_track": "d, %", "pivot_zero": "beta, deg"}

#: Assumptions of this table, which the paper does not state.
ASSUMES = ("robot", "distribution", "turns", "distance_error", "seed")


def tables() -> tuple[TableSource, ...]:
    """Return Doebbler's Table I."""
    return (TableSource("doebbler-1", _simulation, ASSUMES),)


def _simulation(effort: Effort) -> PaperTable:
    assumed = effort.assumptions
    columns = {"after, D exact": True, f"after, D known to {assumed.distance_error:g} %": False}
    ours = {column: errors_left(effort.sets, assumed, exact) for column, exact in columns.items()}
    before, _ = next(iter(ours.values()))
    values = [_compared("before", 0, part, before) for part in TABLE_1]
    values += [_compared(column, 1, part, after) for column, (_, after) in ours.items() for part in TABLE_1]
    title = f"Doebbler, Table I: mean parameter errors, {effort.sets} robots"
    conditions = effort.conditions(ASSUMES)
    return PaperTable("doebbler-1", title, tuple(values), _notes(assumed), "parameter", conditions)


def _compared(column: str, stage: int, part: str, left: ErrorsLeft) -> Comparison:
    factor = math.degrees(1.0) if part == "pivot_zero" else 100.0
    mean, error = (factor * value for value in getattr(left, part))
    place = (("column", column), ("parameter", part))
    return Comparison(place, ROWS[part], column, "parameter error", None, TABLE_1[part][stage], mean, 2, error)


def _notes(assumed: Assumptions) -> tuple[str, ...]:
    turned = "One turn" if assumed.turns == 1 else f"{assumed.turns} turns"
    return (
        f"Before: {assumed.distribution} errors of the printed mean sizes. {turned} about each pivot both ways, in "
        "steady rolling, counts rounded; each castor's estimates averaged (eqs. 1-9).",
        "With D exact, rounding leaves far less of r_w and d than is printed. A mean error of 0.06 % of each measured "
        "distance between two pivots, which the paper does not mention, brings all four near print by default.",
    )
