"""Doebbler, Davis, Junkins and Valasek, "Odometry and Calibration Methods for Multi-Castor Vehicles", Table II."""

from collections.abc import Mapping

from benchmarks.papers.assumptions import GIVEN, OF_SQUARES, Condition
from benchmarks.papers.comparison import Comparison, Effort, PaperTable, TableSource
from benchmarks.papers.simulations import Conditions, MeanError, Step, WheelEncoders, mean_errors
from benchmarks.tasks.kinematic import CALIBRATED, UNCALIBRATED

#: Table II: mean E_max,syst, mm, and its share of the distance travelled, %, of IPEC-1, CAST-1 and CAST-0.
TABLE_2 = {
    "uncalibrated": {"IPEC-1": (394.6, 6.89), "CAST-1": (394.1, 6.88), "CAST-0": (311.0, 5.43)},
    "calibrated": {"IPEC-1": (71.7, 1.25), "CAST-1": (71.6, 1.25), "CAST-0": (39.0, 0.68)},
}
ERRORS = {"uncalibrated": UNCALIBRATED, "calibrated": CALIBRATED}

#: Our simulations, by their columns' headings: name, encoders and step.
COLUMNS: dict[str, tuple[str, WheelEncoders, Step]] = {
    "honest encoders, exact arcs, mm": ("honest-arc", "honest", "arc"),
    "lossy encoders, Euler steps, mm": ("lossy-euler", "lossy", "euler"),
    "the same, swing exact, mm": ("lossy-euler-axle", "lossy", "euler-axle"),
}

#: Further assumptions, which the paper does not state.
ASSUMES = (*OF_SQUARES, "corner_radius", "runs")

Errors = Mapping[tuple[str, str], Mapping[str, MeanError]]
"""Mean errors (m) by estimator, of every (simulation, robot file)."""


def tables() -> tuple[TableSource, ...]:
    """Return Doebbler's tables."""
    return (TableSource("doebbler-2", _simulation, ASSUMES),)


def _simulation(effort: Effort) -> PaperTable:
    assumed = effort.assumptions
    length = assumed.square("ccw").path_length
    effort.progress.start("Doebbler, Table II", effort.sets * len(COLUMNS) * len(ERRORS))
    ours = {
        (name, file): mean_errors(Conditions(assumed, effort.sets, encoders, step), errors, effort.progress)
        for name, encoders, step in COLUMNS.values()
        for file, errors in ERRORS.items()
    }
    values = tuple(
        _compared(column, name, file, estimator, ours[name, file][estimator], length)
        for column, (name, *_) in COLUMNS.items()
        for file, row in TABLE_2.items()
        for estimator in row
    )
    title = f"Doebbler, Table II: simulated UMBmark, mean E_max,syst, {effort.sets} parameter sets"
    conditions = (*effort.conditions(ASSUMES), *GIVEN, Condition("path_length", length, length, "m"))
    return PaperTable("doebbler-2", title, values, _notes(ours, length), "robot file: estimator", conditions)


def _compared(column: str, name: str, file: str, estimator: str, ours: MeanError, length: float) -> Comparison:
    """Return a printed mean beside ours, each also as a share of the path driven; length: of our path, m."""
    printed, share = TABLE_2[file][estimator]
    place = (("simulation", name), ("robot_file", file), ("estimator", estimator))
    row, error = f"{file}: {estimator}", 1e3 * ours.standard_error
    shares = (("printed_percent_of_implied_path", share), ("ours_percent_of_path_length", 100 * ours.mean / length))
    return Comparison(place, row, column, "E_max_syst", "mm", printed, 1e3 * ours.mean, 1, error, shares)


def _notes(ours: Errors, length: float) -> tuple[str, ...]:
    implied = {0.1 * error / share for row in TABLE_2.values() for error, share in row.values()}
    printed = {file: {name: share for name, (_, share) in row.items()} for file, row in TABLE_2.items()}
    shares = f"Printed, of the {min(implied):.2f} to {max(implied):.2f} m that they imply: {_shares(printed)}"
    for name, *_ in COLUMNS.values():
        driven = {file: {k: 100 * error.mean / length for k, error in ours[name, file].items()} for file in ERRORS}
        shares += f". {name}, of the {length:.3f} m that were driven: {_shares(driven)}"
    tables = {"printed": {file: {k: error for k, (error, _) in row.items()} for file, row in TABLE_2.items()}}
    for name, *_ in COLUMNS.values():
        tables[name] = {file: {k: error.mean for k, error in ours[name, file].items()} for file in ERRORS}
    gains = "; ".join(f"{name} {_gains(errors)}" for name, errors in tables.items())
    return (
        "Honest: counters that carry their remainder. Lossy: every 20 Hz increment is rounded and its remainder lost. "
        "Euler: straight along the castor's heading at the end of the step; the pivot, which stands an offset ahead of "
        "the axle, swings across that heading too (offset times turn). Swing exact: the axle goes by Euler's step, the "
        "pivot swings about it from the heading before to the one after. The paper does not say which it took. By "
        "default all else is as in the kinematic tasks.",
        "The calibrated row does not follow from the errors that Table I says calibration leaves. By default lossy "
        "encoders with Euler steps bring errors of its order, hardly different from set to set: a floor of the "
        "simulation, not of calibration. That floor depends on details that the paper does not give: how the swing is "
        "taken decides whether three castors come out worse than two or far better, and neither has the printed ratio. "
        "A value near print there proves nothing, and nothing here is tuned to print.",
        f"E_max,syst in % of the path, IPEC-1 / CAST-1 / CAST-0. {shares}.",
        f"Gain by calibration, IPEC-1 / CAST-1 / CAST-0, then CAST-1 over CAST-0 before and after: {gains}.",
    )


def _shares(percent: Mapping[str, Mapping[str, float]]) -> str:
    return ", ".join(f"{file} {' / '.join(f'{share:.2f}' for share in row.values())}" for file, row in percent.items())


def _gains(errors: Mapping[str, Mapping[str, float]]) -> str:
    before, after = errors["uncalibrated"], errors["calibrated"]
    by_calibration = " / ".join(f"{before[name] / after[name]:.1f}" for name in before)
    by_castor = " / ".join(f"{row['CAST-1'] / row['CAST-0']:.2f}" for row in (before, after))
    return f"{by_calibration}, {by_castor}"
