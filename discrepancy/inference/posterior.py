"""The finder on one page: fit states, linearise, posterior of single effects, name, and again until names stay.

What robots in good order show of each effect, differently in each log, comes from the effects' tolerances, and from
clean logs where there are some (`random_effects`); an effect has to stand out of that. What comes out is a probability
of every name (`single_effects`).
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.inference.calibrated import CREDIBLE, FAULT
from discrepancy.inference.creep_prediction import CREEPS
from discrepancy.inference.linearise import Linearised, linearise
from discrepancy.inference.random_effects import GoodOrder, Statistics, good_order
from discrepancy.inference.single_effects import Component, Hypothesis, Posterior, SingleEffects

ROUNDS = 5

PARTS = np.arange(7) / 4
"""Of an effect that wheels may hide by coming to terms: each is as likely before logs are seen."""

PATTERN = np.array([[1.0, PARTS.mean()], [PARTS.mean(), np.mean(PARTS**2)]])
"""Covariance of an amplitude and what wheels hide of it, where that of the amplitude is 1."""


@dataclass(frozen=True, eq=False)
class Answer:
    """One single effect: probability of every name, the largest first, without those that hardly have any; the credible
    set; and the most likely candidate with its amplitudes and their covariance."""

    probabilities: dict[str, float]
    credible: tuple[str, ...]
    candidate: Candidate
    amplitudes: Array
    covariance: Array
    hidden: float

    @property
    def effect(self) -> Effect | None:
        """The effect, if it has a name and can be as large."""
        if not self.candidate.kinds:
            return None
        try:
            return self.candidate.effect(self.amplitudes)
        except ValueError:
            return None


@dataclass(frozen=True, eq=False)
class Found:
    """Answers, the most certain first, and what they come from."""

    answers: tuple[Answer, ...]
    linearised: Linearised
    posterior: Posterior
    rounds: int


def find(robot: RobotDescription, logs: Sequence[Log], clean: Sequence[Log] = (), verbose: bool = False) -> Found:
    """Return what logs say is missing in a robot's description, and how sure that is."""
    before = linearise(robot, clean) if clean else None
    creep = None if before is None else before.parts
    named: tuple[Answer, ...] = ()
    seen, known = None, {}
    for turn in range(ROUNDS):
        effects = [answer.effect for answer in named if answer.effect is not None]
        seen = linearise(
            robot.with_effects(*effects), logs, start=seen, creep=creep, places=() if before is None else places_of(before)
        )
        posterior, answers = answered(robot, seen, before, named)
        if verbose:
            print(turn, [(a.credible, a.amplitudes, np.sqrt(np.diag(a.covariance))) for a in answers])
        new = tuple(answer for answer in answers if answer.effect is not None)
        if settled(new, named):
            break
        named = new
    return Found(answers, seen, posterior, turn + 1)


def places_of(seen: Linearised) -> tuple[Candidate, ...]:
    return tuple(candidate for candidate in seen.candidates if candidate.at_a_place)


def settled(new: Sequence[Answer], old: Sequence[Answer]) -> bool:
    if [answer.candidate for answer in new] != [answer.candidate for answer in old]:
        return False
    return all(
        np.all(np.abs(a.amplitudes - b.amplitudes) < 0.2 * np.sqrt(np.diag(a.covariance)) + 0.002 * np.abs(a.amplitudes))
        for a, b in zip(new, old, strict=True)
    )


def answered(
    robot: RobotDescription, seen: Linearised, before: Linearised | None, named: Sequence[Answer]
) -> tuple[Posterior, list[Answer]]:
    count = len(seen.usual)
    there = np.zeros(2 * count)
    for k, answer in enumerate(named):
        if answer.candidate in seen.candidates:
            columns = seen.columns[seen.candidates.index(answer.candidate)]
            there[columns] += answer.amplitudes
            part = seen.parts[CREEPS + k] if CREEPS + k < len(seen.parts) else 0.0
            there[columns + count] += part * answer.amplitudes
    logs = [log.at(-there) for log in seen.logs]
    order = of_good_order(seen, before)
    hypotheses, places = hypotheses_of(seen)
    believed = there
    for _ in range(2):
        doubted = [log.doubted(float(believed @ log.information @ believed)) for log in logs]
        beyond = order.beyond(doubted)
        single = SingleEffects(hypotheses, beyond.information)
        posterior = single.posterior(beyond.score)
        believed = np.sum([component.mean for component in posterior.components], axis=0)
    answers = []
    for j, component in enumerate(posterior.components):
        credible = posterior.credible_set(component)
        if not credible:
            continue
        answers.append(answer_of(seen, single, posterior, beyond, places, j, credible))
    return posterior, answers


def answer_of(
    seen: Linearised,
    single: SingleEffects,
    posterior: Posterior,
    beyond: Statistics,
    places: Sequence[tuple[int, float]],
    j: int,
    credible: tuple[str, ...],
) -> Answer:
    component = posterior.components[j]
    probabilities = posterior.probabilities(component)
    best = credible[0]
    inside = [k for k, one in enumerate(single.hypotheses) if one.name == best]
    weight = component.probability[inside]
    likeliest = max(inside, key=lambda k: component.probability[k])
    at, part = places[likeliest]
    same = [k for k in inside if places[k][0] == at]
    weights = component.probability[same] / component.probability[same].sum()
    sizes = [single.sizes(posterior, beyond.score, j, k) for k in same]
    mean = np.sum([w * m for w, (m, _) in zip(weights, sizes, strict=True)], axis=0)
    covariance = np.sum(
        [w * (c + np.outer(m - mean, m - mean)) for w, (m, c) in zip(weights, sizes, strict=True)], axis=0
    )
    hidden = float(weights @ [places[k][1] for k in same])
    shown = {name: p for name, p in probabilities.items() if p > 1e-3}
    if component.nothing > 1e-3:
        shown["nothing"] = component.nothing
    return Answer(shown, credible, seen.candidates[at], mean, covariance, hidden)


def tolerance_of(seen: Linearised) -> Array:
    tolerance = seen.usual.copy()
    for candidate, columns in zip(seen.candidates, seen.columns, strict=True):
        if candidate.kinds:
            tolerance[columns] = candidate.kinds[0].tolerance
    return tolerance


def of_good_order(seen: Linearised, before: Linearised | None) -> GoodOrder:
    """Return what robots in good order show of the candidates of logs, given clean logs if there are any."""
    tolerance = tolerance_of(seen)
    if before is None:
        return good_order(tolerance, PATTERN)
    clean = good_order(tolerance_of(before), PATTERN, before.logs)
    # effects that both have
    count, other = len(tolerance), len(before.usual)
    mine, theirs = [], []
    for candidate, columns in zip(seen.candidates, seen.columns, strict=True):
        if candidate in before.candidates:
            mine += columns.tolist()
            theirs += before.columns[before.candidates.index(candidate)].tolist()
    mine, theirs = np.array(mine + [k + count for k in mine]), np.array(theirs + [k + other for k in theirs])
    plain = good_order(tolerance, PATTERN)
    background, doubt, scatter = plain.background.copy(), plain.doubt.copy(), plain.scatter.copy()
    background[mine] = clean.background[theirs]
    doubt[np.ix_(mine, mine)] = clean.doubt[np.ix_(theirs, theirs)]
    scatter[np.ix_(mine, mine)] = clean.scatter[np.ix_(theirs, theirs)]
    return GoodOrder(background, doubt, scatter)


def hypotheses_of(seen: Linearised) -> tuple[list[Hypothesis], list[tuple[int, float]]]:
    """Return hypotheses, and of each the candidate (its number) and the part that wheels hide."""
    count, tolerance = len(seen.usual), tolerance_of(seen)
    families: dict[str, int] = {}
    for candidate in seen.candidates:
        families[candidate.family] = families.get(candidate.family, 0) + 1
    found, places = [], []
    total = np.sum([log.information for log in seen.logs], axis=0)
    steps = sum(len(state) - 1 for state in seen.state.states)
    for k, (candidate, columns) in enumerate(zip(seen.candidates, seen.columns, strict=True)):
        hides = np.any(np.diag(total)[columns + count] > 1e-9 * np.diag(total)[columns])
        parts = PARTS if hides else PARTS[:1]
        least, most = -np.inf, np.inf
        if candidate.kinds and candidate.columns == 1:
            least, most = bounds_of(candidate.kinds[0])
        share = 1 / families[candidate.family] / len(parts)
        if candidate.at_a_place or " jumps at " in candidate.what:
            share /= steps
        scale = FAULT * float(np.mean(tolerance[columns]))
        for part in parts.tolist():
            direction = np.zeros((2 * count, len(columns)))
            direction[columns, np.arange(len(columns))] = 1.0
            direction[columns + count, np.arange(len(columns))] = part
            found.append(Hypothesis(candidate.family, direction, scale, share, least, most))
            places.append((k, part))
    return found, places


def bounds_of(kind: Effect) -> tuple[float, float]:
    from pydantic import TypeAdapter

    value = TypeAdapter(type(kind)).json_schema()["properties"]["value"]
    if kind.binary:
        return 0.7, 1.3
    return max(value.get("minimum", -np.inf), kind.least), value.get("maximum", np.inf)
