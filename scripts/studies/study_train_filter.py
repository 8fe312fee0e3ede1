"""What each ingredient of train-filter gives, and how it does on other trains: two tables of docs/trains.md.

    python scripts/studies/study_train_filter.py [--cases 20] [--others 8]     (10 min of CPU)

Writes docs/train_filter.json and the tables. Seeds are those of neither boards nor tuning; runs and scores are the
benchmark's own.
"""

import argparse
import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks import snapshots, trains
from benchmarks.tasks.history import StaticTestsWithHistory
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.files import write_atomically
from castor_envs.vehicles.presets import HALF_TRACK, axle_module, cfmmr
from castor_envs.vehicles.robot import Contact, RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators import load_estimator
from estimators.trains import train_filter

DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "trains.md", DOCS / "train_filter.json"
START, END = "<!-- table {}: made by scripts/studies/study_train_filter.py -->\n", "<!-- end of table -->\n"
FORMAT, FIRST_SEED = "castor-train-filter-figures/1", 900_000
METRIC = "mean_axle_position"
ESTIMATORS = ("train-filter", "train-odometry", "grpec-xy", "inlier-least-squares")

Described = Callable[[TrainDescription], TrainDescription]


@dataclass(frozen=True)
class Variant:
    """The filter without one of its ingredients: constants that change, or what it is told of the train."""

    constants: Mapping[str, Any]
    told: Described = lambda train: train


def without_offsets(train: TrainDescription) -> TrainDescription:
    """Return the train as if its gauges had no offsets."""
    return replace(train, frames=tuple(replace(frame, gauge_offset=0.0) for frame in train.frames))


def without_creep(train: TrainDescription) -> TrainDescription:
    """Return the train as if its tyres gave way to no load."""
    stiff = Contact(slip_stiffness_long=1e6, slip_stiffness_lat=1e6)
    return replace(train, modules=tuple(replace(module, contact=stiff) for module in train.modules))


VARIANTS = {
    "train-filter": Variant({}),
    "offsets of gauges not estimated": Variant({}, without_offsets),
    "no axle slips": Variant({"SLIPS": 0.0, "TOGETHER": 0.0, "LOSES": 0.0}),
    "no axle is lost": Variant({"LOSES": 0.0}),
    "axles slip independently": Variant({"TOGETHER": train_filter.SLIPS}),
    "one filter instead of a bank": Variant({"MOST": 1}),
    "creep not predicted": Variant({}, without_creep),
    "lengths of frames not used": Variant({"SHAPE": 1.0}),
    "radii not estimated": Variant({"RADII": 1e-9}),
    "start not checked": Variant({"WRONG_START": np.inf}),
}


def official(name: str) -> Task:
    """Return an official task of trains."""
    (task,) = (task for task in (*trains.tasks(None), *snapshots.tasks(None)) if task.name == name)
    return task


COLUMNS: dict[str, tuple[str, Task]] = {
    "2 axles, slippery": (METRIC, official("train-2-patch")),
    "2, cables": (METRIC, official("train-2-cables")),
    "3, slippery": (METRIC, official("train-3-patch")),
    "3, cables": (METRIC, official("train-3-cables")),
    "5, slippery": (METRIC, official("train-5-patch")),
    "static tests after a drive": ("final_axle_position", StaticTestsWithHistory()),
    "snapshot, one of three": (METRIC, official("configuration-one-of-three")),
}
"""Headings, the score of each, and what is driven."""


@dataclass(frozen=True)
class Other:
    """A train on random paths that no board has; every second case is on slippery strips, the others over cables.

    frames, tracks, noise: factors of the frames' lengths, of half tracks, and of the gauges' noise. period: s. silent:
    from when to when no frame has a reading, s.
    """

    axles: int = 3
    disturbed: int = 1
    frames: float = 1.0
    tracks: float = 1.0
    noise: float = 1.0
    period: float = 0.05
    silent: tuple[float, float] = (np.inf, np.inf)

    def _module(self, half_track: float = HALF_TRACK) -> RobotDescription:
        return replace(axle_module(self.tracks * half_track), sample_period=self.period)

    def _train(self, axles: int) -> TrainDescription:
        train = cfmmr(axles)
        built = [
            replace(frame, length=self.frames * frame.length, gauge_noise=self.noise * frame.gauge_noise)
            for frame in train.frames
        ]
        return replace(train, modules=(self._module(),) * axles, frames=tuple(built))

    def record(self, case: Case) -> Episode:
        """Return the run of a case."""
        floor = (trains.slippery, trains.cables)[int(case) % 2]
        task = trains.DrivenTrain("other", "other", "other", self.axles, self.disturbed, floor)
        changes = {"axle_module": self._module, "cfmmr": self._train, "LANE": self.tracks * trains.LANE}
        with ExitStack() as changed:
            for name, value in changes.items():
                changed.enter_context(patch.object(trains, name, value))
            episode = task.record(case)
        (run,) = episode.runs
        assert run.log.rps is not None
        dark = (run.log.t >= self.silent[0]) & (run.log.t < self.silent[1])
        log = replace(run.log, rps=np.where(dark[:, None], np.nan, run.log.rps))
        return Episode(episode.robot, (Run(log),))


OTHERS = {
    "4 axles": Other(axles=4),
    "7 axles, 2 disturbed": Other(axles=7, disturbed=2),
    "10 axles, 3 disturbed": Other(axles=10, disturbed=3),
    "3 axles, 2 of them disturbed, one after the other": Other(disturbed=2),
    "frames 0.7 times as long": Other(frames=0.7),
    "frames 1.5 times as long": Other(frames=1.5),
    "half tracks 0.7 times": Other(tracks=0.7),
    "half tracks 1.5 times": Other(tracks=1.5),
    "50 Hz": Other(period=0.02),
    "noise of gauges 3 times": Other(noise=3.0),
    "no readings from 4 to 7 s": Other(silent=(4.0, 7.0)),
}
"""Headings of the second table: three axles with one disturbed, where they say nothing else."""


def scores(estimator: str, episodes: list[Episode], metric: str) -> list[float]:
    """Return the score of an estimator in each episode."""
    source, found = load_estimator(estimator).source_hash, []
    for episode in episodes:
        estimates = estimate_singly(estimator, source, observed_runs(episode))
        if isinstance(estimates, Failure):
            raise RuntimeError(f"{estimator}: {estimates.reason}")
        found.append(score(episode, [run.poses for run in estimates])[metric])
    return found


def mean(estimator: str, episodes: list[Episode], metric: str) -> float:
    """Return the mean score in SI, to six digits."""
    return float(f"{np.mean(scores(estimator, episodes, metric)):.6g}")


def figures(cases: int, others: int) -> dict[str, Any]:
    """Return the mean scores of all variants on all columns, and of all estimators on other trains, in SI."""
    ingredients: dict[str, dict[str, float]] = {name: {} for name in VARIANTS}
    for heading, (metric, task) in COLUMNS.items():
        episodes = [task.record(FIRST_SEED + k) for k in range(cases)]
        for name, variant in VARIANTS.items():
            told = [replace(episode, robot=variant.told(episode.robot)) for episode in episodes]  # type: ignore[arg-type]
            with ExitStack() as changed:
                for constant, value in variant.constants.items():
                    changed.enter_context(patch.object(train_filter, constant, value))
                ingredients[name][heading] = mean("train-filter", told, metric)
        print(heading, {name: row[heading] for name, row in ingredients.items()}, flush=True)
    elsewhere: dict[str, dict[str, float]] = {}
    for heading, other in OTHERS.items():
        episodes = [other.record(FIRST_SEED + k) for k in range(others)]
        elsewhere[heading] = {name: mean(name, episodes, METRIC) for name in ESTIMATORS}
        print(heading, elsewhere[heading], flush=True)
    return {
        "format": FORMAT,
        "cases": cases,
        "others": others,
        "first_seed": FIRST_SEED,
        "ingredients": ingredients,
        "elsewhere": elsewhere,
    }


def with_tables(page: str, found: dict[str, Any]) -> str:
    """Return the page with the tables of these figures."""
    columns = {heading: BOARD_METRICS[metric] for heading, (metric, _) in COLUMNS.items()}
    first = [["", *(f"{heading}, {metric.shown_unit}" for heading, metric in columns.items())]]
    for name, row in found["ingredients"].items():
        first.append([name, *(f"{metric.factor * row[heading]:.3g}" for heading, metric in columns.items())])
    shown = BOARD_METRICS[METRIC]
    second = [["", *(f"{name}, {shown.shown_unit}" for name in ESTIMATORS)]]
    for heading, row in found["elsewhere"].items():
        second.append([heading, *(f"{shown.factor * row[name]:.3g}" for name in ESTIMATORS)])
    for name, lines in (("ingredients", first), ("other trains", second)):
        lines.insert(1, ["---", *["--:"] * (len(lines[0]) - 1)])
        start = START.format(name)
        before, rest = page.split(start)
        table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
        page = before + start + "\n" + table + "\n" + END + rest.split(END, 1)[1]
    return page


def main() -> None:
    """Compute the figures, store them and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--others", type=int, default=8)
    options = parser.parse_args()
    found = figures(options.cases, options.others)
    write_atomically(FIGURES, json.dumps(found, indent=1) + "\n")
    write_atomically(PAGE, with_tables(PAGE.read_text(encoding="utf-8"), found))


if __name__ == "__main__":
    main()
