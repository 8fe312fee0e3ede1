"""Cases of a train's trial: hidden effects, their sizes, and the way in which wheels are driven.

A case follows from its number, the trial's seed and the train. Cases come in pairs, in which wheels yield to each other
(odd numbers) and are held at speed (even ones). Sizes are log-uniform between `BOUNDS`.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from castor_envs.vehicles.train import TrainDescription
from discrepancy.trains.candidates import Candidate, dead_gauges, named_candidates
from discrepancy.trials.trains.outside import Outside, draw_outside

Stratum = Literal["clean", "one", "two", "outside"]
Drive = Literal["yielding", "held"]

MIX: tuple[Stratum, ...] = ("one", "clean", "one", "two", "one", "outside") * 2
"""The pairs of every twelve, in order: 6 with one effect, 2 with two, 2 clean, 2 with an effect outside the
catalogue."""

BOUNDS = {
    "gauge_gain": (0.05, 0.4),
    "gauge_drift": (0.003, 0.05),
    "foreshortening_left_out": (0.1, 1.0),
    "frame_length": (0.001, 0.02),
    "track": (0.005, 0.05),
    "wheel_radius": (0.002, 0.02),
    "all_wheel_radius": (0.002, 0.02),
    "axle_slip": (2.0, 50.0),
}
"""The smallest and the largest size of each effect, in its own unit; a dead gauge has none."""

ONE_WAY = ("foreshortening_left_out", "axle_slip")
"""Effects whose sizes are positive; sizes of other effects have either sign."""


@dataclass(frozen=True)
class Case:
    """hidden: effects in their size. seeds: of the log and the held-out log."""

    number: int
    stratum: Stratum
    drive: Drive
    hidden: tuple[Candidate, ...]
    seeds: tuple[int, int]
    outside: Outside | None = None


def draw(number: int, seed: int, train: TrainDescription) -> Case:
    """Return a case (number from 1) of a trial. All kinds of effects are equally likely, then all places."""
    random = np.random.default_rng([seed, number])
    stratum = MIX[(number - 1) // 2 % len(MIX)]
    candidates = (*named_candidates(train), *dead_gauges(train))
    kinds = sorted({candidate.alike for candidate in candidates})
    chosen = random.choice(kinds, size={"one": 1, "two": 2}.get(stratum, 0), replace=False)
    hidden = []
    for kind in chosen.tolist():
        places = [candidate for candidate in candidates if candidate.alike == kind]
        candidate = places[int(random.integers(len(places)))]
        part, sign = float(random.uniform()), float(random.choice([-1.0, 1.0]))
        if kind in BOUNDS:
            low, high = (math.log(bound) for bound in BOUNDS[kind])
            size = math.exp(low + part * (high - low))
            effect = candidate.effect([size if kind in ONE_WAY else sign * size])
            candidate = dataclasses.replace(candidate, kind=effect)
        hidden.append(candidate)
    first, second = (int(seed_value) for seed_value in random.integers(10**9, size=2))
    drive: Drive = "yielding" if number % 2 else "held"
    outside = draw_outside(train, random) if stratum == "outside" else None
    return Case(number, stratum, drive, tuple(hidden), (first, second), outside)
