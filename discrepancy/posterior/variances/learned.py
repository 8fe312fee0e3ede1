"""What has no name but depends on what a simulation knows: which curve, of what, and how sure.

The curve is a Gaussian process: smooth, 0 in mean, of a size that is not known. Its knots are columns of the linear
problem (`linearise`), so how likely logs are with it, and its mean and errors, have closed forms.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from castor_envs.effects.encoders import LearnedTerm, Of
from castor_envs.effects.parts import channel, pivot_encoders, wheel_encoders
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, Channels, candidates_of, described
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import FAULT, LOG_ODDS
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import PARTS
from discrepancy.posterior.random_effects import Statistics, together
from discrepancy.validation.cost import cost_of

KNOTS = 12
"""Of a curve."""

SMOOTH, SMOOTH_SPEED = 1.0, 1 / 3
"""How far a curve keeps its value: rad, and as a part of the fastest speed."""

SIZES = LearnedTerm.tolerance * FAULT * 2.0 ** np.arange(-4, 6)
"""Of curves, standard deviations: each is as likely before logs are seen."""

Look = Callable[[RobotDescription, Sequence[Candidate]], Linearised]
"""Returns what logs say of a robot, of some candidates."""


@dataclass(frozen=True, eq=False)
class Learned:
    """A curve in the robot file. errors: standard deviations of its values. log_odds: of that it is there, natural
    logarithm. nearest: what the catalogue has that is most like it, in words, and the cosine between what both do to
    logs; None where nothing is like it."""

    effect: LearnedTerm
    errors: tuple[float, ...]
    log_odds: float
    nearest: tuple[str, float] | None


def encoders_of(answers: Sequence[Answer]) -> list[str]:
    """Return the encoders, by name, of which something without a name is said."""
    unnamed = (answer.candidate.what for answer in answers if answer.unnamed and not answer.candidate.kinds)
    return [what.split()[0] for what in unnamed if what.startswith(("wheel_", "pivot_"))]


def helps(robot: RobotDescription, curve: "Learned", held_out: Sequence[Log], creep: Array | None) -> bool:
    """Whether held-out logs are likelier by 19 with a curve, and their gap smaller."""
    without, beside = (
        linearise(one, held_out, creep=creep, among=()) for one in (robot, robot.with_effects(curve.effect))
    )
    shrinks = without.gap is None or beside.gap is None or beside.gap[0] < without.gap[0]
    return shrinks and beside.log_evidence - without.log_evidence > LOG_ODDS


def answer_of(robot: RobotDescription, curve: "Learned", logs: Sequence[Log]) -> Answer:
    """Return what is said of a curve: it has no name."""
    candidate = Candidate(described(curve.effect), (curve.effect,))
    reason = f"no effect of the catalogue explains it; {candidate.what} was learned, and is in the robot file"
    if curve.nearest is not None:
        reason += f"; nearest in the catalogue, with a cosine of {curve.nearest[1]:.2f}, is {curve.nearest[0]}"
    probability = float(expit(curve.log_odds))
    return Answer(
        probabilities={candidate.what: probability, "nothing": 1 - probability},
        credible=(candidate.what,),
        unnamed=True,
        candidate=candidate,
        amplitudes=np.ones(1),
        covariance=np.array([[1 / (2 * curve.log_odds)]]),
        hidden=0.0,
        explained=2 * curve.log_odds,
        cost=np.array([cost_of(robot, curve.effect, logs) or 0.0, 0.0]),
        reason=reason,
    )


def learned(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, channels: Sequence[str], look: Look
) -> Learned | None:
    """Return the curve that logs ask for most, of some encoders; None if none is surely there.

    robot: with the effects named. seen: what logs say beside these. channels: encoders by name, as "wheel_1l".
    """
    terms = _terms(robot, logs, seen, channels)
    if not terms:
        return None
    every = [(term, Candidate(described(term), _one_by_one(term), KNOTS)) for term in terms]
    told = look(robot, [candidate for _, candidate in every])
    said = together(told.logs)
    curves = [
        (term, _curve(term, said, told.columns[told.candidates.index(candidate)], len(told.usual)))
        for term, candidate in every
        if candidate in told.candidates
    ]
    if not curves:
        return None
    term, (log_factor, values, errors) = max(curves, key=lambda curve: curve[1][0])
    log_odds = log_factor - float(np.log(len(terms)))
    if log_odds < LOG_ODDS:
        return None
    there = replace(term, values=tuple(values.tolist()))  # found anew around itself, as it may be large
    (candidate,) = (candidate for other, candidate in every if other == term)
    told = look(robot.with_effects(there), [candidate])
    columns, whole = told.columns[told.candidates.index(candidate)], np.zeros(2 * len(told.usual))
    whole[columns] = values
    _, values, errors = _curve(term, together(told.logs).at(-whole), columns, len(told.usual))
    effect = replace(term, values=tuple(values.round(7).tolist()))
    return Learned(effect, tuple(errors.tolist()), log_odds, _nearest(robot, effect, look))


def _terms(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, channels: Sequence[str]
) -> list[LearnedTerm]:
    """Return a term of some encoders and of all that each may depend on, with knots and no values yet."""
    every, names = Channels(robot), list(channels)
    turn, terms = tuple((np.arange(KNOTS) * 2 * np.pi / KNOTS).round(6).tolist()), []
    rates = [
        np.abs(np.diff(state[:, 3:], axis=0) / np.diff(log.t)[:, None]).max(axis=0)
        for log, state in zip(logs, seen.state.states, strict=True)
    ]
    fastest = dict(zip(every.names, (np.max(rates, axis=0) * 2 * np.pi / every.per_rev).tolist(), strict=True))
    for castor, wheel in [*wheel_encoders(robot), *((castor, None) for castor in pivot_encoders(robot))]:
        name = f"pivot_{castor}" if wheel is None else f"wheel_{robot.wheel_names[channel(robot, castor, wheel, '')]}"
        if name not in names or fastest[name] == 0:
            continue
        speeds = tuple(np.linspace(-fastest[name], fastest[name], KNOTS).round(6).tolist())
        knots: dict[Of, tuple[float, ...]] = {"own angle": turn, "speed": speeds}
        if wheel is not None and castor in pivot_encoders(robot):
            knots["castor angle"] = turn
        none = (0.0,) * KNOTS
        terms += [LearnedTerm(castor=castor, wheel=wheel, of=of, knots=at, values=none) for of, at in knots.items()]
    return terms


def _one_by_one(term: LearnedTerm) -> tuple[LearnedTerm, ...]:
    """Return the terms with a value at one knot each."""
    return tuple(replace(term, value=term.step, values=tuple(row)) for row in np.eye(KNOTS).tolist())


def _covariance(term: LearnedTerm) -> Array:
    """Return the covariance (k, k) of a curve's values, of size 1."""
    apart = np.subtract.outer(np.array(term.knots), np.array(term.knots))
    if term.of == "speed":
        return np.asarray(np.exp(-((apart / (SMOOTH_SPEED * max(term.knots))) ** 2) / 2))
    return np.asarray(np.exp(-2 * (np.sin(apart / 2) / SMOOTH) ** 2))


def _curve(term: LearnedTerm, said: Statistics, columns: NDArray[np.intp], count: int) -> tuple[float, Array, Array]:
    """Return the log Bayes factor of a curve against none, averaged over its size and what wheels hide of it; and mean
    and standard deviation of its values (k,) where it is likeliest."""
    covariance, found = _covariance(term), []
    for part in PARTS.tolist():
        way = np.zeros((len(said.score), len(columns)))
        way[columns, np.arange(len(columns))] = 1.0
        way[columns + count, np.arange(len(columns))] = part
        information, score = way.T @ said.information @ way, way.T @ said.score
        for size in SIZES.tolist():
            prior = size**2 * covariance
            blurred = np.eye(len(columns)) + prior @ information
            both = np.linalg.solve(blurred, np.column_stack([prior @ score, prior]))
            log_factor = float(score @ both[:, 0] - np.linalg.slogdet(blurred)[1]) / 2
            found.append((log_factor, both[:, 0], np.sqrt(np.maximum(np.diag(both[:, 1:]), 0.0))))
    log_factors = np.array([one[0] for one in found])
    _, mean, error = found[int(np.argmax(log_factors))]
    return float(np.logaddexp.reduce(log_factors) - np.log(len(found))), mean, error


def _nearest(robot: RobotDescription, effect: LearnedTerm, look: Look) -> tuple[str, float] | None:
    """Return what the catalogue has that is most like a curve, in words, and the cosine of what both do to logs."""
    unit = replace(effect, value=effect.step)
    mine = Candidate(described(unit), (unit,))
    told = look(robot, [mine, *(candidate for candidate in candidates_of(robot) if candidate.columns == 1)])
    information, k = together(told.logs).information, int(told.columns[told.candidates.index(mine)][0])
    best = None
    for candidate, columns in zip(told.candidates, told.columns, strict=True):
        j = int(columns[0])
        strength = float(information[k, k] * information[j, j])
        if candidate != mine and strength > 0:
            cosine = float(abs(information[k, j]) / np.sqrt(strength))
            best = (candidate.what, cosine) if best is None or cosine > best[1] else best
    return best
