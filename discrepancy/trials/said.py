"""The finder's answer on a case of a trial, as classes of effects with probabilities."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from castor_envs.effects.catalogue import EFFECTS, catalogue
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.diagnose import diagnosed, examined
from discrepancy.hypotheses.candidates import family_of
from discrepancy.posterior.answers import Answer, Verdict
from discrepancy.posterior.verdicts import weakest
from discrepancy.preflight import Mistake
from discrepancy.preflight.undo import Logs, Undone
from discrepancy.report.examined import Examined
from discrepancy.report.sentences import as_lines
from discrepancy.trials.hidden import class_of
from discrepancy.validation.cost import cost_of
from estimators.calibration.identifiability import COVERAGE

QUIET = ("negligible", "no discrepancy")
"""Verdicts that are no alarm."""


Size = dict[str, Any]
"""An effect, its `class`, the ends `low` and `high` of the 95 % interval of its value (None: it has no size), and its
`cost` in use, m per 10 m."""


@dataclass(frozen=True)
class Single:
    """The answer on one effect. probabilities: of classes, and of unnamed alternatives (None). size: None where it is
    not known. same: classes that are said to be the same on this vehicle, whatever it does."""

    verdict: Verdict
    probabilities: Mapping[str | None, float]
    credible: tuple[str | None, ...]
    size: Size | None = None
    same: tuple[str, ...] = ()

    @classmethod
    def of(cls, answer: Answer, class_named: Callable[[str], str | None], size: Size | None) -> "Single":
        """Return an answer of the posterior. class_named: the class of a name; None for an unnamed alternative."""
        probabilities: dict[str | None, float] = {}
        for name, probability in answer.probabilities.items():
            if name != "nothing":
                known = class_named(name)
                probabilities[known] = probabilities.get(known, 0.0) + probability
        credible = tuple(dict.fromkeys(map(class_named, answer.credible)))
        same = tuple(name for name in map(class_named, answer.alike) if name is not None)
        return cls(answer.verdict, probabilities, credible, size, same)


def size_of(name: str, effect: Effect, answer: Answer, cost: float | None) -> Size:
    """Return the size of an answer's effect; the error is that along the phase found."""
    way = answer.amplitudes / (np.linalg.norm(answer.amplitudes) or 1.0)
    error = COVERAGE * math.sqrt(max(float(way @ answer.covariance @ way), 0.0))
    low, high = (None, None) if effect.binary else (effect.value - error, effect.value + error)
    return {"class": name, "effect": effect, "low": low, "high": high, "cost": cost}


@dataclass(frozen=True)
class Said:
    """The answer on all effects, in classes.

    verdict: of the whole. named: the classes with verdict "named", each with its probability. credible: the 95 %
    credible sets, without unnamed alternatives. unnamed: whether a set contains an unnamed alternative. probabilities:
    of every possible class. same_as: of classes in credible sets those that are told to be the same on this vehicle.
    sizes: of what is named. effects: those added to the vehicle. gap: see `run`.
    """

    verdict: str
    named: Mapping[str, float] = field(default_factory=dict)
    credible: tuple[tuple[str, ...], ...] = ()
    unnamed: bool = False
    probabilities: Mapping[str, float] = field(default_factory=dict)
    same_as: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sizes: tuple[Size, ...] = ()
    effects: tuple[Effect, ...] = ()
    reason: str = ""
    gap: Mapping[str, float] | None = None

    @classmethod
    def of(cls, singles: Sequence[Single], reason: str = "") -> "Said":
        """Return the answer of the answers on single effects."""
        sure = [single for single in singles if single.verdict == "named"]
        sizes = tuple(single.size for single in sure if single.size is not None)
        absent: dict[str, float] = {}
        for single in singles:
            for name, probability in single.probabilities.items():
                if name is not None:
                    absent[name] = absent.get(name, 1.0) * (1.0 - min(probability, 1.0))
        return cls(
            weakest(single.verdict for single in singles),
            {name: single.probabilities[name] for single in sure for name in single.credible if name is not None},
            tuple(tuple(name for name in single.credible if name is not None) for single in singles),
            any(None in single.credible for single in singles),
            {name: 1.0 - part for name, part in absent.items()},
            {
                name: single.same
                for single in singles
                if single.same
                for name in single.credible[:1]
                if name is not None
            },
            sizes,
            tuple(size["effect"] for size in sizes),
            reason,
        )


def say(robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs) -> Said:
    """Return the finder's answer for a robot, its logs, held-out logs and clean logs, by their names."""
    undone = Undone(robot, logs, held_out, clean)
    diagnosis = diagnosed(undone)
    report(examined(undone, diagnosis))
    return in_classes(robot, logs, undone.checked.mistakes, diagnosis.answers)


def report(found: Examined) -> None:
    """Make what people read of a diagnosis, so that a report that breaks down counts as the finder."""
    as_lines(found.data)
    found.page()


def in_classes(robot: RobotDescription, logs: Logs, mistakes: Sequence[Mistake], answers: Sequence[Answer]) -> Said:
    """Return gross mistakes and answers of the posterior as classes of effects."""
    told = [answer.effect for answer in answers if answer.effect is not None]
    classes = {family_of(effect): class_of(effect) for effect in (*catalogue(robot), *told)}

    def class_named(family: str) -> str | None:
        """Return the class of a family, or of an effect at a place on the floor."""
        name, *_ = family.split()
        return classes.get(family, name if name in EFFECTS else None)

    singles = _of_mistakes(mistakes)
    for answer in answers:
        effect, size = answer.effect, None
        if effect is not None:
            cost = cost_of(robot, effect, list(logs.values())) if answer.verdict == "named" else None
            size = size_of(class_of(effect), effect, answer, cost)
        singles.append(Single.of(answer, class_named, size))
    reasons = [*(mistake.what for mistake in mistakes), *(answer.reason for answer in answers)]
    undone = [effect for mistake in mistakes if not mistake.alternatives for effect in mistake.effects]
    said = Said.of(singles, "; ".join(reasons))
    return dataclasses.replace(said, effects=(*said.effects, *undone))


def _of_mistakes(mistakes: Sequence[Mistake]) -> list[Single]:
    """Return gross mistakes as answers on single effects."""
    singles = []
    for mistake in mistakes:
        sure = "ambiguous" if mistake.alternatives else "named"
        singles += [Single(sure, {class_of(effect): 1.0}, (class_of(effect),)) for effect in mistake.effects]
    return singles
