"""What each ingredient of the filter gives, on seeds of neither boards nor tuning: the table of docs/estimators.md.

    python scripts/studies/study_filter.py [--cases 12]     (4 min of CPU)

Writes docs/filter.json and the table. Squares are those of the official tasks, also of other robots.
"""

import argparse
import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.run.worker_estimate import estimate_stacked, observed_runs
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks.kinematic import CALIBRATED, UNCALIBRATED, KinematicUMBmark
from benchmarks.tasks.physics import PhysicsUMBmark, clean_floor, slippery_patch, ten_cables
from benchmarks.tasks.task import Episode
from castor_envs.files import write_atomically
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.tolerances import Tolerances
from estimators import load_estimator
from estimators.robots import calibrating_filter

DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "estimators.md", DOCS / "filter.json"
START, END = "<!-- table: made by scripts/studies/study_filter.py -->\n", "<!-- end of table -->\n"
FORMAT, FIRST_SEED = "castor-filter-figures/1", 600_000

NOTHING = Tolerances(radius=1e-9, lateral=1e-9, offset=1e-9, pivot=1e-9, pivot_zero=1e-9)
VARIANTS: dict[str, Mapping[str, Any] | None] = {
    "wheel-odometry": None,
    "filter": {},
    "learning nothing": {"CALIBRATED": NOTHING, "UNCALIBRATED": NOTHING},
    "descriptions always calibrated": {"TRUST": 1e9},
    "descriptions never calibrated": {"TRUST": -1e9},
    "releasing nothing": {"GATE": np.inf},
    "castors turning evenly": {"UNEVEN": 0.0},
}
"""Names of estimators, and the constants of the filter that they change; None: another estimator."""


def kinematic(robot: str, errors: Any) -> Callable[[int], Episode]:
    """Return a function that records the square of perfect rolling with a description that is off."""
    return KinematicUMBmark("study", "study", "study", errors, robot=preset(robot)).record


def physics(floor: Any, metric: str = "E_max_syst", *, baseline: bool = False) -> Callable[[int], Episode]:
    """Return a function that records the prototype's square in physics."""
    return PhysicsUMBmark("study", "study", "study", floor, metric, baseline, robot=preset("asoc-prototype")).record


COLUMNS: dict[str, tuple[str, Callable[[int], Episode]]] = {
    "uncalibrated": ("E_max_syst", kinematic("asoc-prototype", UNCALIBRATED)),
    "calibrated": ("E_max_syst", kinematic("asoc-prototype", CALIBRATED)),
    "clean floor": ("E_max_syst", physics(clean_floor)),
    "cables": (
        "nonsystematic_orientation_error",
        physics(ten_cables, "nonsystematic_orientation_error", baseline=True),
    ),
    "slippery": ("end_point_position", physics(slippery_patch, "end_point_position", baseline=True)),
    "omnimate, uncalibrated": ("E_max_syst", kinematic("omnimate", UNCALIBRATED)),
    "swerve, calibrated": ("E_max_syst", kinematic("swerve", CALIBRATED)),
    "powered-caster, calibrated": ("E_max_syst", kinematic("powered-caster", CALIBRATED)),
}
"""Headings, the score of each, and what is driven."""


def figures(cases: int) -> dict[str, Any]:
    """Return the mean scores of all variants on all columns, in SI."""
    table: dict[str, dict[str, float]] = {name: {} for name in VARIANTS}
    for heading, (metric, record) in COLUMNS.items():
        episodes = [record(FIRST_SEED + k) for k in range(cases)]
        for name, changes in VARIANTS.items():
            with ExitStack() as changed:
                for constant, value in (changes or {}).items():
                    changed.enter_context(patch.object(calibrating_filter, constant, value))
                spec = "wheel-odometry" if changes is None else "filter"
                poses: Any = estimate_stacked(
                    spec, load_estimator(spec).source_hash, list(map(observed_runs, episodes))
                )
            scores = [
                score(episode, [run.poses for run in of])[metric] for episode, of in zip(episodes, poses, strict=True)
            ]
            table[name][heading] = float(f"{np.mean(scores):.6g}")
        print(heading, {name: row[heading] for name, row in table.items()}, flush=True)
    return {"format": FORMAT, "cases": cases, "first_seed": FIRST_SEED, "means": table}


def with_table(page: str, found: dict[str, Any]) -> str:
    """Return the page with the table of these figures."""
    lines = [["", *(f"{heading}, {BOARD_METRICS[metric].shown_unit}" for heading, (metric, _) in COLUMNS.items())]]
    lines.append(["---", *["--:"] * len(COLUMNS)])
    for name, row in found["means"].items():
        shown = [f"{BOARD_METRICS[metric].factor * row[heading]:.3g}" for heading, (metric, _) in COLUMNS.items()]
        lines.append([name, *shown])
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    before, rest = page.split(START)
    return before + START + "\n" + table + "\n" + END + rest.split(END, 1)[1]


def main() -> None:
    """Compute the figures, store them and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=12)
    found = figures(parser.parse_args().cases)
    write_atomically(FIGURES, json.dumps(found, indent=1) + "\n")
    write_atomically(PAGE, with_table(PAGE.read_text(encoding="utf-8"), found))


if __name__ == "__main__":
    main()
