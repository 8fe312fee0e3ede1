"""Doebbler, Davis, Junkins and Valasek, "Odometry and Calibration Methods for Multi-Castor Vehicles", Table II."""

from collections.abc import Mapping
from dataclasses import replace

from benchmarks.comparison import Comparison, Effort, PaperTable, TableSource
from benchmarks.tasks.kinematic import CALIBRATED, UNCALIBRATED
from benchmarks.umbmark_simulation import Conditions, MeanError, mean_errors

#: Table II: mean E_max,syst, mm, and its share of the distance travelled, %, of IPEC-1, CAST-1 and CAST-0.
TABLE_2 = {
    "uncalibrated": {"IPEC-1": (394.6, 6.89), "CAST-1": (394.1, 6.88), "CAST-0": (311.0, 5.43)},
    "calibrated": {"IPEC-1": (71.7, 1.25), "CAST-1": (71.6, 1.25), "CAST-0": (39.0, 0.68)},
}
ERRORS = {"uncalibrated": UNCALIBRATED, "calibrated": CALIBRATED}

#: Our two simulations, by their columns' headings.
COLUMNS: dict[str, tuple[str, Conditions]] = {
    "honest encoders, exact arcs, mm": ("honest-arc", Conditions()),
    "lossy encoders, Euler steps, mm": ("lossy-euler", Conditions(encoders="lossy", step="euler")),
}

Errors = Mapping[tuple[str, str], Mapping[str, MeanError]]
"""Mean errors (m) by estimator, of every (simulation, robot file)."""


def tables() -> tuple[TableSource, ...]:
    """Return Doebbler's tables."""
    return (TableSource("doebbler-2", _simulation),)


def _simulation(effort: Effort) -> PaperTable:
    effort.progress.start("Doebbler, Table II", effort.sets * len(COLUMNS) * len(ERRORS))
    ours = {
        (name, file): mean_errors(replace(conditions, sets=effort.sets), errors, effort.progress)
        for name, conditions in COLUMNS.values()
        for file, errors in ERRORS.items()
    }
    values = tuple(
        _compared(column, name, file, estimator, printed, ours[name, file][estimator])
        for column, (name, _) in COLUMNS.items()
        for file, row in TABLE_2.items()
        for estimator, (printed, _) in row.items()
    )
    title = f"Doebbler, Table II: simulated UMBmark, mean E_max,syst, {effort.sets} parameter sets"
    return PaperTable("doebbler-2", title, values, _notes(ours), "robot file: estimator")


def _compared(column: str, name: str, file: str, estimator: str, printed: float, ours: MeanError) -> Comparison:
    place = (("simulation", name), ("robot_file", file), ("estimator", estimator))
    row, error = f"{file}: {estimator}", 1e3 * ours.standard_error
    return Comparison(place, row, column, "E_max_syst", "mm", printed, 1e3 * ours.mean, 1, error)


def _notes(ours: Errors) -> tuple[str, ...]:
    length = {round(0.1 * error / share, 2) for row in TABLE_2.values() for error, share in row.values()}
    tables = {"printed": {file: {k: error for k, (error, _) in row.items()} for file, row in TABLE_2.items()}}
    for name, _ in COLUMNS.values():
        tables[name] = {file: {k: error.mean for k, error in ours[name, file].items()} for file in ERRORS}
    gains = "; ".join(f"{name} {_gains(errors)}" for name, errors in tables.items())
    return (
        "Honest: counters that carry their remainder. Lossy: every 20 Hz increment is rounded and its remainder lost. "
        "Euler: straight along the castor's heading at the end of the step. All else is as in the kinematic tasks; the "
        "paper does not say which of these it took.",
        "The calibrated row does not follow from the errors that Table I says calibration leaves. Lossy encoders with "
        "Euler steps bring errors of its order, hardly different from set to set: a floor of the simulation, not of "
        "calibration. That floor depends on details that the paper does not give, and has not the printed ratio of two "
        "castors to three: a value near print there proves nothing, and nothing here is tuned to print.",
        f"The printed percentages imply a path of {min(length):.2f} to {max(length):.2f} m; ours is 6 m.",
        f"Gain by calibration, IPEC-1 / CAST-1 / CAST-0, then CAST-1 over CAST-0 before and after: {gains}.",
    )


def _gains(errors: Mapping[str, Mapping[str, float]]) -> str:
    before, after = errors["uncalibrated"], errors["calibrated"]
    by_calibration = " / ".join(f"{before[name] / after[name]:.1f}" for name in before)
    by_castor = " / ".join(f"{row['CAST-1'] / row['CAST-0']:.2f}" for row in (before, after))
    return f"{by_calibration}, {by_castor}"
