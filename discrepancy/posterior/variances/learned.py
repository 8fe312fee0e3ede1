"""Learned terms: unnamed alternatives that depend on a quantity known in simulation, as a curve with its probability.

The curve is a Gaussian process: smooth, of unknown size, about an unknown level. Its knots are columns of the linear
problem (`linearise`), so its marginal likelihood, mean and errors have closed forms.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from castor_envs.effects.encoders import LearnedTerm, Of
from castor_envs.effects.parts import pivot_encoders, wheel_encoders
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, candidates_of, described, encoder_name
from discrepancy.posterior.answers import Answer, Learned, Place
from discrepancy.posterior.calibrated import FAULT, LOG_ODDS
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.priors import PARTS, direction_of
from discrepancy.posterior.random_effects import Statistics, summed
from discrepancy.validation.cost import cost_of
from estimators.likelihood.channels import Channels
from estimators.likelihood.statistics import least_squares

KNOTS = 12
"""Number of knots of a curve."""

SMOOTH, SMOOTH_SPEED = 1.0, 1 / 3
"""Correlation lengths of a curve: of angles in rad, of speeds as a part of the fastest speed."""

SIZES = LearnedTerm.tolerance * FAULT * 2.0 ** np.arange(-4, 6)
"""Prior standard deviations of curves, all with the same prior probability."""

Look = Callable[[RobotDescription, Sequence[Candidate]], Linearised]
"""Returns the logs linearised with a robot and these candidates."""


def encoders_of(answers: Sequence[Answer]) -> list[str]:
    """Return the names of encoders on which the answers have an unnamed alternative."""
    unnamed = (answer.candidate.what for answer in answers if answer.unnamed and not answer.candidate.kinds)
    return [description.split()[0] for description in unnamed if description.startswith(("wheel_", "pivot_"))]


def helps(robot: RobotDescription, curve: Learned, held_out: Callable[[RobotDescription], Linearised]) -> bool:
    """Whether the likelihood ratio of held-out logs with a curve exceeds 19, and their gap shrinks. held_out: returns
    their statistics as made by a robot."""
    without = held_out(robot)
    try:
        beside = held_out(robot.with_effects(curve.effect))
    except (np.linalg.LinAlgError, InputError):  # these logs are not of a robot with such a curve
        return False
    shrinks = without.gap is None or beside.gap is None or beside.gap[0] < without.gap[0]
    return shrinks and beside.log_evidence - without.log_evidence > LOG_ODDS


def answer_of(robot: RobotDescription, curve: Learned, logs: Sequence[Log]) -> Answer:
    """Return the answer for a curve: an unnamed alternative."""
    candidate = Candidate(described(curve.effect), (curve.effect,))
    reason = "no effect of the catalogue explains it; a curve was learned from these logs and is in the robot file"
    if curve.nearest is not None:
        what, cosine = curve.nearest
        reason += f"; nearest in the catalogue, by what it does to these logs, is: {what} (cosine {cosine:.2f})"
    probability, error = float(expit(curve.log_odds)), (2 * curve.log_odds) ** -0.5
    cost = np.array([cost_of(robot, curve.effect, logs) or 0.0, 0.0])
    answer = Answer.judged_apart(Candidate(candidate.what), probability, 1.0, error, cost)
    return replace(answer, candidate=candidate, curve=curve, reason=reason)


def learned(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, channels: Sequence[str], look: Look
) -> Learned | None:
    """Return the likeliest curve on one of these encoders; None if its log odds are below `LOG_ODDS`.

    robot: with the effects named. seen: the logs linearised with these. channels: encoders by name, as "wheel_1l".
    """
    terms = {_candidate(term): term for term in _terms(robot, logs, seen, channels)}
    if not terms:
        return None
    linearised = look(robot, list(terms))
    statistics = summed(linearised.logs)
    curves = [(cause, _curve(terms[cause], linearised, cause, statistics)) for cause in linearised.candidates]
    if not curves:
        return None
    candidate, (log_factor, values, errors) = max(curves, key=lambda curve: curve[1][0])
    term, log_odds = terms[candidate], log_factor - float(np.log(len(terms)))
    if log_odds < LOG_ODDS:
        return None
    fitted = replace(term, values=tuple(values.tolist()))  # linearised again about the curve, as it may be large
    linearised = look(robot.with_effects(fitted), [candidate])  # which has no other columns
    statistics = summed(linearised.logs).at(-np.append(values, np.zeros(KNOTS)))
    _, values, errors = _curve(term, linearised, candidate, statistics)
    effect = replace(term, values=tuple(values.round(7).tolist()))
    return Learned(effect, tuple(errors.tolist()), log_odds, _nearest(robot, effect, look))


def _terms(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, channels: Sequence[str]
) -> list[LearnedTerm]:
    """Return a term for each of these encoders and each quantity that it may depend on, with knots and values of 0."""
    encoders, names = Channels(robot), list(channels)
    turn, terms = tuple((np.arange(KNOTS) * 2 * np.pi / KNOTS).round(6).tolist()), []
    rates = [
        np.abs(np.diff(state[:, 3:], axis=0) / np.diff(log.t)[:, None]).max(axis=0)
        for log, state in zip(logs, seen.state.states, strict=True)
    ]
    fastest = dict(zip(encoders.names, (np.max(rates, axis=0) * 2 * np.pi / encoders.per_rev).tolist(), strict=True))
    for castor, wheel in [*wheel_encoders(robot), *((castor, None) for castor in pivot_encoders(robot))]:
        name = encoder_name(robot, castor, wheel)
        if name not in names or fastest[name] == 0:
            continue
        speeds = tuple(np.linspace(-fastest[name], fastest[name], KNOTS).round(6).tolist())
        knots: dict[Of, tuple[float, ...]] = {"own angle": turn, "speed": speeds}
        if wheel is not None and castor in pivot_encoders(robot):
            knots["castor angle"] = turn
        zeros = (0.0,) * KNOTS
        terms += [LearnedTerm(castor=castor, wheel=wheel, of=of, knots=at, values=zeros) for of, at in knots.items()]
    return terms


def _candidate(term: LearnedTerm) -> Candidate:
    """Return the candidate of a term whose amplitudes are the values at the knots."""
    units = (replace(term, value=term.step, values=tuple(row)) for row in np.eye(KNOTS).tolist())
    return Candidate(described(term), tuple(units), KNOTS)


def _covariance(term: LearnedTerm) -> Array:
    """Return the covariance (k, k) of a curve's values, of size 1."""
    apart = np.subtract.outer(np.array(term.knots), np.array(term.knots))
    if term.of == "speed":
        return np.asarray(np.exp(-((apart / (SMOOTH_SPEED * max(term.knots))) ** 2) / 2))
    return np.asarray(np.exp(-2 * (np.sin(apart / 2) / SMOOTH) ** 2))


def _curve(
    term: LearnedTerm, seen: Linearised, candidate: Candidate, statistics: Statistics
) -> tuple[float, Array, Array]:
    """Return the log Bayes factor of a candidate that is a curve against none, averaged over its size and masked part;
    and mean and standard deviation of its values at the likeliest size and part.

    Both may be at another level: what is read too much by the same fraction throughout is a radius or a gain, which the
    catalogue has.
    """
    covariance, level, found = _covariance(term), np.full(2 * (len(term.knots),), LearnedTerm.tolerance**2), []
    for part in PARTS.tolist():
        information, score = statistics.of_combinations(direction_of(seen, Place(candidate, part)))
        without, *_ = _with_prior(level, information, score)
        for size in SIZES.tolist():
            log_evidence, mean, error = _with_prior(level + size**2 * covariance, information, score)
            found.append((log_evidence - without, mean, error))
    log_factors = np.array([entry[0] for entry in found])
    _, mean, error = found[int(np.argmax(log_factors))]
    return float(np.logaddexp.reduce(log_factors) - np.log(len(found))), mean, error


def _with_prior(prior: Array, information: Array, score: Array) -> tuple[float, Array, Array]:
    """Return the log evidence of normally distributed values (k,) with this covariance (k, k) about 0, against values
    of 0; and their posterior mean and standard deviation."""
    blurred = np.eye(len(score)) + prior @ information
    solved = np.asarray(np.linalg.solve(blurred, np.column_stack([prior @ score, prior])), dtype=np.float64)
    log_evidence = float(score @ solved[:, 0] - np.linalg.slogdet(blurred)[1]) / 2
    return log_evidence, solved[:, 0], np.maximum(np.diag(solved[:, 1:]), 0.0) ** 0.5


def _nearest(robot: RobotDescription, effect: LearnedTerm, look: Look) -> tuple[str, float] | None:
    """Return the effect of the catalogue with the most similar signature, in words, and the cosine between both
    signatures."""
    unit = replace(effect, value=effect.step)
    curve = Candidate(described(unit), (unit,))
    linearised = look(robot, [curve, *candidates_of(robot)])
    information, cosines = summed(linearised.logs).information, dict[str, float]()
    k = int(linearised.columns[curve][0])
    for candidate, columns in linearised.columns.items():
        within, across = information[np.ix_(columns, columns)], information[columns, k]
        if candidate != curve and np.all(np.diag(within) > 0):
            likest = least_squares(within, across)  # in size, and in phase where it has one
            cosines[candidate.what] = float(np.sqrt(across @ likest / information[k, k]))
    return max(cosines.items(), key=lambda entry: entry[1], default=None)
