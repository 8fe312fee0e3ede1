"""A robot's dimensions all together: where they are most likely, and how far off they are if no single one is certain.

A robot whose wheel base is wrong by 4 % was hardly built as described otherwise. As a single effect, each dimension is
as unlikely to be wrong as if all others were right, so that a radius beside that wheel base may stay uncertain; and of
two dimensions that logs hardly distinguish neither is certain. Here all are off at once, by about equally many
tolerances: their sizes are Cauchy distributed together, with the scale of a fault, and their posterior mean is the best
guess. It names nothing, and is written to the robot file where held-out logs confirm it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import expit

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import NUMBERS
from discrepancy.posterior.answers import Answer, Cause
from discrepancy.posterior.calibrated import FAULT
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.model.refit import Effects, Sized, moved_by, possible
from discrepancy.posterior.priors import directions_in_model, order_of, same_effects, tolerances
from discrepancy.posterior.random_effects import GoodOrder, Statistics, agreeing, summed
from discrepancy.posterior.single_effects import LOG_WEIGHTS, SCALES
from discrepancy.posterior.verdicts import Material
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.likelihood.statistics import least_squares, pseudo_inverse

ROUNDS = 2
"""Rounds in which the states are fitted with the guess in the model: a third changes held-out gaps of measured robots
by 0.1 mm."""


@dataclass(frozen=True, eq=False)
class Dimension:
    """A dimension as guessed together with all others, and the standard errors (columns,) of its amplitudes."""

    sized: Sized
    error: Array

    def matters(self, seen: Linearised, material: Material) -> bool:
        """Whether it costs what matters in use."""
        columns = seen.columns[self.sized.candidate]
        return bool(np.any(seen.cost[:, columns] @ np.abs(self.sized.amplitudes) > material))


def dimensions_of(robot: RobotDescription, seen: Linearised) -> list[Sized]:
    """Return the effects on dimensions among the candidates that logs can tell apart, of size 0."""
    stands, unseen = same_effects(robot.as_described())
    built = set(seen.lasting.tolist())
    return [
        Sized(candidate, np.zeros(len(columns)))
        for candidate, columns in seen.columns.items()
        if columns[0] in built and candidate.family not in stands and candidate.family not in unseen
    ]


def most_likely(robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> Effects:
    """Return dimensions of maximum-likelihood size; none where encoders contradict each other if one is wrong, where
    there is no reference, or where calibration finds nothing.

    Until it is in the model, what encoders cannot contradict counts as slip, beside which the formula about the robot
    as described hardly sees it: about these dimensions it does. seen: the logs linearised without any of them.
    """
    if seen.redundant or seen.gap is None or robot.effects:
        return ()
    try:
        found = calibrate(robot, logs).calibrated
    except InputError:
        return ()
    effects, described = dimensions_of(robot, seen), _numbers(robot)
    unit = np.array([effect.candidate.kinds[0].tolerance for effect in effects])
    kinds = [effect.candidate.kinds[0] for effect in effects]
    changes = [(_numbers(robot.with_effects(kind)) - described) / kind.value for kind in kinds]
    change = np.reshape(changes, (len(effects), len(described))).T * unit
    sizes = unit * least_squares(change, _numbers(found) - described)
    return tuple(effect.moved(np.array([size])) for effect, size in zip(effects, sizes.tolist(), strict=True) if size)


@dataclass(frozen=True, eq=False)
class Guess:
    """Dimensions guessed together, and named effects beside these. log_factor: log Bayes factor (natural logarithm) of
    dimensions that are off together against none that is, beside the named effects."""

    dimensions: list[Dimension]
    named: list[Dimension]
    log_factor: float


def either_of(dimensions: Sequence[Dimension], seen: Linearised, log_odds: float) -> Answer:
    """Return the answer that one of these dimensions is off, no more likely one than the other; the size is that of the
    costliest. log_odds: log odds (natural logarithm) that any is off."""
    costs = [seen.cost[:, seen.columns[one.sized.candidate]] for one in dimensions]
    prices = [np.sum(cost @ np.abs(one.sized.amplitudes)) for cost, one in zip(costs, dimensions, strict=True)]
    k = int(np.argmax(prices))
    names, costliest = [one.sized.candidate.family for one in dimensions], dimensions[k]
    off = float(expit(log_odds))
    return Answer(
        probabilities=dict.fromkeys(names, off / len(names)) | {"nothing": 1 - off},
        absent=1 - off,
        credible=(names[k], *names[:k], *names[k + 1 :]),
        unnamed=False,
        candidate=costliest.sized.candidate,
        amplitudes=costliest.sized.amplitudes,
        covariance=np.diag(costliest.error**2),
        cost=np.max(costs[k], axis=1),
        verdict="ambiguous",
        reason=f"these motions cannot distinguish: {'; '.join(names)}",
    )


def guessed(
    robot: RobotDescription,
    look: Callable[[Sequence[Sized], Linearised, Sequence[Cause]], Linearised],
    seen: Linearised,
    good: Linearised | None,
    dimensions: Sequence[Sized],
    named: Sequence[Sized],
) -> Guess | None:
    """Return the posterior mean of all dimensions together and, after them, of named effects, with the states fitted
    anew beside it; none where no robot can have it, or no motion fits it, as logs of hardly any motion may guess.

    seen: the logs beside the named effects, and beside `dimensions`, those that are not named, in sizes to begin with.
    good: clean logs, linearised. named: effects in the model, of dimensions and others, whose prior is flat.
    """
    among = [effect.candidate for effect in (*dimensions, *named)]
    current, errors, log_factor, beside = [*dimensions, *named], list[Array](), -np.inf, seen
    begun, without = any(np.any(effect.amplitudes) for effect in dimensions), seen.log_evidence
    for left in reversed(range(ROUNDS)):
        in_model = [effect for effect in current if np.any(effect.amplitudes)]
        try:
            beside = look(in_model, beside, among)
            if begun and not left:
                without = look(named, beside, among).log_evidence
        except np.linalg.LinAlgError:
            return None
        gained = beside.log_evidence - without
        current, errors, log_factor = _together(beside, order_of(beside, good), current, len(dimensions), gained)
        if not possible(robot, current):
            return None
    found = [Dimension(effect, error) for effect, error in zip(current, errors, strict=True)]
    return Guess(found[: len(dimensions)], found[len(dimensions) :], log_factor)


def _together(
    seen: Linearised, order: GoodOrder, effects: Sequence[Sized], count: int, gained: float
) -> tuple[list[Sized], list[Array], float]:
    """Return effects with the posterior mean of their sizes, and their standard errors, and the log Bayes factor of
    dimensions: the first `count` effects, which are Cauchy distributed together.

    gained: of log evidence by the fit with the effects in the model. It takes the place of what the linear formula says
    of that, as noise is less beside what is right; what robots in good order show makes up the same part of both.
    """
    directions = directions_in_model(seen, [effect.candidate for effect in effects])
    sizes = np.concatenate([effect.amplitudes for effect in effects])
    logs = agreeing([log.at(-directions @ sizes) for log in seen.logs], seen.lasting)
    columns = [seen.columns[effect.candidate] for effect in effects[:count]]
    scale = FAULT * tolerances(seen)[np.concatenate([np.zeros(0, dtype=np.intp), *columns])]
    k = len(scale)
    beyond = _Profiled.of(order.beyond(logs).of_combinations(directions), k)
    mean, covariance, log_factor = shared_cauchy(*beyond.first, scale)
    raw = _Profiled.of(summed(logs).of_combinations(directions), k)
    explained, told = (of.first.gain(sizes[:k]) for of in (raw, beyond))
    part = float(np.clip(told / explained, 0.0, 1.0)) if explained > 0 else 1.0
    others = beyond.of_others @ beyond.score_of_others - beyond.follows @ mean
    spread = beyond.of_others + beyond.follows @ covariance @ beyond.follows.T
    errors = np.sqrt(np.concatenate([np.diag(covariance), np.diag(spread)]))
    ends = np.cumsum([len(effect.amplitudes) for effect in effects])[:-1]
    moved = list(moved_by(effects, np.concatenate([mean, others]) - sizes))
    return moved, np.split(errors, ends), log_factor + part * gained - told


@dataclass(frozen=True, eq=False)
class _Profiled:
    """Statistics of the first k sizes, whatever the others (n,) are; of these the covariance (n, n), the score (n,),
    and by how much they follow the first (n, k)."""

    first: Statistics
    of_others: Array
    score_of_others: Array
    follows: Array

    @classmethod
    def of(cls, statistics: Statistics, k: int) -> Self:
        """Return those of statistics of all sizes."""
        information, score = statistics.information, statistics.score
        of_others = pseudo_inverse(information[k:, k:])
        follows = of_others @ information[k:, :k]
        first = Statistics(information[:k, :k] - information[:k, k:] @ follows, score[:k] - follows.T @ score[k:])
        return cls(first, of_others, score[k:], follows)


def shared_cauchy(information: Array, score: Array, scale: Array) -> tuple[Array, Array, float]:
    """Return posterior means (k,) and covariance (k, k) of sizes that are Cauchy distributed together about 0, with
    these scales: normal, with one unknown factor on all of them. The third is the log Bayes factor against 0.
    information (k, k) and score (k,) at 0."""
    strength, way = np.linalg.eigh(information * np.outer(scale, scale))
    along, strength = way.T @ (scale * score), np.maximum(strength, 0.0)
    variance = 1 / (strength + SCALES[:, None] ** -2.0)
    log_evidence = np.sum(along**2 * variance - np.log1p(strength * SCALES[:, None] ** 2), axis=1) / 2 + LOG_WEIGHTS
    log_factor = float(np.logaddexp.reduce(log_evidence))
    weight = np.exp(log_evidence - log_factor)
    means = (along * variance) @ way.T
    mean = weight @ means
    off = means - mean
    covariance = (way * (weight @ variance)) @ way.T + (weight * off.T) @ off
    return scale * mean, covariance * np.outer(scale, scale), log_factor


def _numbers(robot: RobotDescription) -> Array:
    """Return all numbers of a robot's geometry as built."""
    geometry = Geometry.of(robot.as_built())
    return np.nan_to_num(np.concatenate([np.ravel(getattr(geometry, name)) for name in NUMBERS]))
