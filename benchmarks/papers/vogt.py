"""Vogt and Minor, "Localization for Multi-Axle Train Configured CFMMRs", Tables 1 and 2, recomputed by GRPEC."""

from collections.abc import Iterator

import numpy as np

from benchmarks.papers.comparison import Comparison, Effort, PaperTable, TableSource
from benchmarks.papers.failure_modes import failure_modes
from benchmarks.tasks.static_tests import STATIC_TESTS, StaticTest
from castor_envs.geometry.arrays import Array
from estimators.trains import grpec

#: Unit of print of each metric, the factor from SI to it, and its printed decimals.
METRICS = {"theta_xy": ("m", 1.0, 3), "theta_phi": ("deg", 180 / np.pi, 1), "theta_dev": ("deg", 180 / np.pi, 1)}

#: Table 1: for every test and metric the errors of attaching to axles 1, 2 and 3, CON1 and CON2.
TABLE_1 = {
    (1, "theta_xy"): (0.357, 0.138, 0.135, 0.622, 0.022),
    (1, "theta_phi"): (68.4, 34.6, 34.3, 0.498, 0.008),
    (1, "theta_dev"): (23.0, 11.3, 11.1, 0.519, 0.024),
    (2, "theta_xy"): (0.758, 0.277, 0.544, 0.635, 0.491),
    (2, "theta_phi"): (151.9, 91.2, 121.5, 0.400, 0.250),
    (2, "theta_dev"): (52.3, 8.5, 38.8, 0.838, 0.782),
    (3, "theta_xy"): (0.305, 0.300, 0.613, 0.511, 0.016),
    (3, "theta_phi"): (60.8, 101.5, 80.8, 0.401, 0.248),
    (3, "theta_dev"): (15.7, 25.0, 35.7, 0.561, 0.374),
    (4, "theta_xy"): (0.608, 0.225, 0.228, 0.630, 0.013),
    (4, "theta_phi"): (120.8, 60.6, 60.8, 0.499, 0.005),
    (4, "theta_dev"): (41.8, 18.4, 18.7, 0.559, 0.015),
}

#: Table 2: error of the corrected configuration, m, and whether it passed.
TABLE_2 = {(test.number, metric): (0.0, "P") for test in STATIC_TESTS for metric in METRICS} | {
    (3, "theta_phi"): (0.065, "F"),
    (3, "theta_dev"): (0.065, "F"),
}

#: A configuration that is off by no more than this counts as the true one, m.
PASSES = 1e-9


def tables() -> tuple[TableSource, ...]:
    """Return Vogt's tables."""
    return TableSource("vogt-1", _errors), TableSource("vogt-2", _corrections)


def _errors(_: Effort) -> PaperTable:
    return PaperTable(
        "vogt-1",
        "Vogt and Minor, Table 1: errors of attaching the relative poses to each axle",
        tuple(value for test in STATIC_TESTS for metric in METRICS for value in _table_1(test, metric)),
        (
            "The relative poses are fits to this table (the strain data were never published). Confidence values "
            "are computed from unrounded errors.",
            "The captions of Figs. 8 and 9 are swapped; the table's Figs. 5 to 8 are Figs. 7 to 10.",
        ),
        appendix=failure_modes(),
    )


def _corrections(_: Effort) -> PaperTable:
    values = tuple(value for test in STATIC_TESTS for metric in METRICS for value in _table_2(test, metric))
    return PaperTable(
        "vogt-2",
        "Vogt and Minor, Table 2: position error after correction by the axle that each metric selects",
        values,
        tuple(_unexplained(values)),
        appendix=failure_modes(),
    )


def selected_axle(test: StaticTest, metric: str) -> int:
    """Return the axle, from 1, that a metric selects in a test."""
    errors = grpec.errors(test.odometry, test.relative)
    return int(grpec.select(_error(errors, metric), errors.theta_xy)) + 1


def position_errors(test: StaticTest, metric: str) -> Array:
    """Return how far each axle is from the truth, (3,) m, after correction by the axle that a metric selects."""
    corrected = grpec.corrected(test.odometry, test.relative, selected_axle(test, metric) - 1)
    return np.linalg.norm(corrected[:, :2] - test.truth[:, :2], axis=-1)


def _error(errors: grpec.Errors, metric: str) -> Array:
    return getattr(errors, metric)


def _table_1(test: StaticTest, metric: str) -> Iterator[Comparison]:
    unit, scale, digits = METRICS[metric]
    errors = _error(grpec.errors(test.odometry, test.relative), metric)
    *printed, con1, con2 = TABLE_1[test.number, metric]
    place = (("test", test.number), ("metric", metric))
    column = f"{metric}, {unit}"
    for axle in (1, 2, 3):
        ours = float(scale * errors[axle - 1])
        value_place = (*place, ("axle", axle))
        yield Comparison(
            value_place, f"{test.number}: axle {axle}", column, "error", unit, printed[axle - 1], ours, digits
        )
    # The paper shades the selected axle, that of the lowest printed error.
    lowest, selected = 1 + int(np.argmin(printed)), selected_axle(test, metric)
    yield Comparison(place, f"{test.number}: selected axle", column, "selection", None, lowest, selected)
    for name, value, ours in zip(("CON1", "CON2"), (con1, con2), grpec.confidence(errors), strict=True):
        value_place = (*place, ("measure", name))
        yield Comparison(value_place, f"{test.number}: {name}", column, "confidence value", None, value, float(ours), 3)


def _table_2(test: StaticTest, metric: str) -> Iterator[Comparison]:
    printed, verdict = TABLE_2[test.number, metric]
    ours = float(np.mean(position_errors(test, metric)))
    place = (("test", test.number), ("metric", metric))
    yield Comparison(place, f"{test.number}: error, m", metric, "position error", "m", printed, ours, 3)
    passed = "P" if ours <= PASSES else "F"
    yield Comparison(place, f"{test.number}: P/F", metric, "verdict", None, verdict, passed)


def _unexplained(values: tuple[Comparison, ...]) -> Iterator[str]:
    """Say what our error means and, for each value that disagrees with print, what other definitions would give."""
    yield "Ours: the mean over the axles of their distance from the truth; P where it is 0."
    apart = [dict(value.place) for value in values if value.quantity == "position error" and not value.agrees]
    for number in sorted({int(place["test"]) for place in apart}):
        metrics = [str(place["metric"]) for place in apart if place["test"] == number]
        (test,) = (test for test in STATIC_TESTS if test.number == number)
        for metric in metrics:
            off = position_errors(test, metric)
            mean, rms = np.mean(off), np.sqrt(np.mean(off**2))
            yield (
                f"Test {number}, {metric}: selects axle {selected_axle(test, metric)}, true is {test.true_axle}. The "
                f"printed {TABLE_2[number, metric][0]:.3f} m is not explained: mean {mean:.4f}, largest "
                f"{np.max(off):.4f}, rms {rms:.4f} m; the mean divided by 3 again, {mean / 3:.4f} m, is a "
                f"coincidence or a slip."
            )
