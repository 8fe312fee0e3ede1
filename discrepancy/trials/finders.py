"""The finder's answer on a case of a trial, as classes of effects with probabilities."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from castor_envs.effects.catalogue import EFFECTS, catalogue
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.diagnose import posterior_of
from discrepancy.hypotheses.candidates import family_of
from discrepancy.posterior.answers import Answer, Verdict
from discrepancy.posterior.verdicts import WEAKEST_FIRST
from discrepancy.preflight import Mistake
from discrepancy.trials.hidden import class_of

FINDER = "posterior"
"""Name of the finder, under which trials store its answers."""

NORMAL = 1.959964
"""Standard deviations to either side of a 95 % interval."""

QUIET = ("negligible", "no discrepancy")
"""Verdicts that are no alarm."""


@dataclass(frozen=True)
class Said:
    """A finder's answer, in classes (`hidden.class_of`).

    verdict: of the whole. named: the classes with verdict "named", each with its probability. credible: the 95 %
    credible sets, without unnamed alternatives. unnamed: whether a set contains an unnamed alternative. probabilities:
    of every possible class. sizes: class, effect and ends of the 95 % interval, of what is named.
    effects: those added to the robot.
    """

    verdict: str
    named: Mapping[str, float] = field(default_factory=dict)
    credible: tuple[tuple[str, ...], ...] = ()
    unnamed: bool = False
    probabilities: Mapping[str, float] = field(default_factory=dict)
    sizes: tuple[tuple[str, Effect, float, float], ...] = ()
    effects: tuple[Effect, ...] = ()
    reason: str = ""

    def as_data(self, costs: Sequence[float | None] = ()) -> dict[str, Any]:
        """Return the answer as plain data. costs: of ignoring each named effect, m per 10 m."""
        kept = ("verdict", "named", "credible", "unnamed", "probabilities", "reason")
        sizes = [
            {"class": name, "effect": dataclasses.asdict(effect), "low": low, "high": high, "cost": cost}
            for (name, effect, low, high), cost in zip(self.sizes, costs, strict=True)
        ]
        effects = [dataclasses.asdict(effect) for effect in self.effects]
        return {key: getattr(self, key) for key in kept} | {"sizes": sizes, "effects": effects}


@dataclass(frozen=True)
class Single:
    """A finder's answer on one effect. probabilities: of classes, and of unnamed alternatives (None)."""

    verdict: Verdict
    probabilities: Mapping[str | None, float]
    credible: tuple[str | None, ...]
    effect: Effect | None = None
    error: float = 0.0


Logs = Mapping[str, Log]


def said_of(singles: Sequence[Single], reason: str = "") -> Said:
    """Return a finder's answer on all effects together."""
    sure = [single for single in singles if single.verdict == "named"]
    absent: dict[str, float] = {}
    for single in singles:
        for name, probability in single.probabilities.items():
            if name is not None:
                absent[name] = absent.get(name, 1.0) * (1.0 - min(probability, 1.0))
    return Said(
        min(
            (single.verdict for single in singles),
            key=[*WEAKEST_FIRST, "no discrepancy"].index,
            default="no discrepancy",
        ),
        {name: single.probabilities[name] for single in sure for name in single.credible if name is not None},
        tuple(tuple(name for name in single.credible if name is not None) for single in singles),
        any(None in single.credible for single in singles),
        {name: 1.0 - part for name, part in absent.items()},
        tuple(_size(single.effect, single.error) for single in sure if single.effect is not None),
        tuple(single.effect for single in sure if single.effect is not None),
        reason,
    )


def _size(effect: Effect, error: float) -> tuple[str, Effect, float, float]:
    return class_of(effect), effect, effect.value - NORMAL * error, effect.value + NORMAL * error


def say(robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs) -> Said:
    """Return the posterior's answer for a robot, its logs, held-out logs and clean logs, by their names."""
    mistakes, found = posterior_of(robot, logs, held_out, clean)
    singles = [*_of_mistakes(mistakes), *(_single(robot, answer) for answer in found.answers)]
    reasons = [*(mistake.what for mistake in mistakes), *(answer.reason for answer in found.answers)]
    undone = [effect for mistake in mistakes if not mistake.alternatives for effect in mistake.effects]
    said = said_of(singles, "; ".join(reasons))
    return dataclasses.replace(said, effects=(*said.effects, *undone))


def _of_mistakes(mistakes: Sequence[Mistake]) -> list[Single]:
    """Return gross mistakes as answers on single effects."""
    singles = []
    for mistake in mistakes:
        sure = "ambiguous" if mistake.alternatives else "named"
        singles += [Single(sure, {class_of(effect): 1.0}, (class_of(effect),)) for effect in mistake.effects]
    return singles


def _single(robot: RobotDescription, answer: Answer) -> Single:
    classes = {family_of(effect): class_of(effect) for effect in catalogue(robot)}
    probabilities: dict[str | None, float] = {}
    for name, probability in answer.probabilities.items():
        if name != "nothing":
            known = _class_named(name, classes)
            probabilities[known] = probabilities.get(known, 0.0) + probability
    credible = tuple(dict.fromkeys(_class_named(name, classes) for name in answer.credible))
    way = answer.amplitudes / (np.linalg.norm(answer.amplitudes) or 1.0)
    error = math.sqrt(max(float(way @ answer.covariance @ way), 0.0))
    return Single(answer.verdict, probabilities, credible, answer.effect, error)


def _class_named(family: str, classes: Mapping[str, str]) -> str | None:
    """Return the class of a family, or of an effect at a place on the floor; None for an unnamed alternative."""
    name, *_ = family.split()
    return classes.get(family, name if name in EFFECTS else None)
