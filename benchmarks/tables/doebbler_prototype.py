"""Doebbler, Davis, Junkins and Valasek, Table III: the uncalibrated prototype and seven estimators; ours in physics."""

import numpy as np

from benchmarks.comparison import Comparison, Effort, PaperTable, TableSource
from benchmarks.evaluation import score
from benchmarks.following import Failure, estimate_singly, observed_runs
from benchmarks.task import Episode, Run
from benchmarks.tasks.kinematic import UNCALIBRATED, true_robot
from benchmarks.tasks.physics import drive
from castor_envs.floor import Floor
from estimators.registry import load_estimator

#: Table III: E_max, mm, of one robot.
TABLE_3 = {"ipec-1": 540, "ipec-2": 511, "ipec-3": 458, "cast-1": 544, "cast-2": 459, "cast-3": 432, "cast-0": 191}
MOST_ROBOTS = 20
"""The paper has one robot; so many of ours are driven, one square each way."""


def tables() -> tuple[TableSource, ...]:
    """Return Doebbler's Table III."""
    return (TableSource("doebbler-3", _physics),)


def episode(seed: int) -> Episode:
    """Return a square each way, in physics, of a robot whose parameters are off; estimators get the nominal ones."""
    built = UNCALIBRATED.applied(true_robot(), np.random.default_rng([seed, 7]))
    ways = ("cw", "ccw")
    runs = (Run(drive(built, way, Floor(), seed=100 * seed + k), way) for k, way in enumerate(ways))
    return Episode(true_robot(), tuple(runs))


def _physics(effort: Effort) -> PaperTable:
    robots = min(MOST_ROBOTS, effort.sets)
    effort.progress.start("Doebbler, Table III", robots)
    errors: dict[str, list[float]] = {name: [] for name in TABLE_3}
    for seed in range(robots):
        driven = episode(seed)
        seen = observed_runs(driven)
        for name in TABLE_3:
            entry = load_estimator(name)
            estimates = estimate_singly(entry.spec, entry.source_hash, seen)
            if isinstance(estimates, Failure):
                raise RuntimeError(f"{name}: {estimates.reason}")
            errors[name].append(1e3 * score(driven, estimates)["E_max_syst"])
        effort.progress.advance()
    values = tuple(
        Comparison(
            (("estimator", name),),
            name.upper(),
            f"E_max in physics, mean of {robots} robots, mm",
            "E_max",
            "mm",
            float(printed),
            float(np.mean(errors[name])),
            0,
            float(np.std(errors[name], ddof=1) / np.sqrt(robots)),
        )
        for name, printed in TABLE_3.items()
    )
    best = sum(min(errors, key=lambda name, k=k: errors[name][k]) == "cast-0" for k in range(robots))
    spread = np.array([errors["cast-0"], errors["cast-1"]])
    means = {name: float(np.mean(own)) for name, own in errors.items()}
    ahead = [np.mean([row[f"cast-{i}"] for i in (1, 2, 3)]) / row["cast-0"] for row in (TABLE_3, means)]
    notes = (
        "The paper drove one uncalibrated prototype. Ours are robots with Table I's uncalibrated errors, driven in "
        "physics with slip; estimators get the nominal dimensions.",
        f"From robot to robot CAST-0 runs from {spread[0].min():.0f} to {spread[0].max():.0f} mm and CAST-1 from "
        f"{spread[1].min():.0f} to {spread[1].max():.0f}: one robot says little. CAST-0 is the best of the seven on "
        f"{best} of {robots}. CAST-1 to -3 over CAST-0: printed {ahead[0]:.2f}, ours {ahead[1]:.2f}.",
    )
    title = "Doebbler, Table III: the uncalibrated prototype"
    return PaperTable("doebbler-3", title, values, notes, "estimator")
