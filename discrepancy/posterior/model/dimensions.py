"""A robot's dimensions all together: where they are most likely, and how far off they are if no single one is certain.

A robot whose wheel base is wrong by 4 % was hardly built as described otherwise. As a single effect, each dimension is
as unlikely to be wrong as if all others were right, so that a radius beside that wheel base may stay uncertain; and of
two dimensions that logs hardly distinguish neither is certain. Here all are off at once, by about equally many
tolerances: their sizes are Cauchy distributed together, with the scale of a fault, and their posterior mean is the best
guess. It names nothing, and is written to the robot file where held-out logs confirm it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import NUMBERS
from discrepancy.posterior.answers import Cause
from discrepancy.posterior.calibrated import FAULT
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.model.refit import Effects, Sized, possible
from discrepancy.posterior.priors import directions_in_model, order_of, same_effects, tolerances
from discrepancy.posterior.random_effects import GoodOrder, agreeing
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


def guessed(
    robot: RobotDescription,
    look: Callable[[Sequence[Sized], Linearised, Sequence[Cause]], Linearised],
    seen: Linearised,
    good: Linearised | None,
    dimensions: Sequence[Sized],
    named: Sequence[Sized],
) -> list[Dimension]:
    """Return the posterior mean of all dimensions together and, after them, of named effects, with the states fitted
    anew beside it; none where no robot can have it, or no motion fits it, as logs of hardly any motion may guess.

    good: clean logs, linearised. dimensions: those that are not named, in sizes to begin with. named: effects in the
    model, of dimensions and others, whose prior is flat.
    """
    among = [effect.candidate for effect in (*dimensions, *named)]
    current, errors = [*dimensions, *named], []
    for _ in range(ROUNDS):
        try:
            seen = look([effect for effect in current if np.any(effect.amplitudes)], seen, among)
        except np.linalg.LinAlgError:
            return []
        current, errors = _together(seen, order_of(seen, good), current, len(dimensions))
        if not possible(robot, current):
            return []
    return [Dimension(effect, error) for effect, error in zip(current, errors, strict=True)]


def _together(
    seen: Linearised, order: GoodOrder, effects: Sequence[Sized], count: int
) -> tuple[list[Sized], list[Array]]:
    """Return effects with the posterior mean of their sizes, and their standard errors; the first `count` are
    dimensions that are Cauchy distributed together."""
    directions = directions_in_model(seen, [effect.candidate for effect in effects])
    sizes = np.concatenate([effect.amplitudes for effect in effects])
    logs = agreeing([log.at(-directions @ sizes) for log in seen.logs], seen.lasting)
    information, score = order.beyond(logs).of_combinations(directions)
    columns = [seen.columns[effect.candidate] for effect in effects[:count]]
    scale = FAULT * tolerances(seen)[np.concatenate([np.zeros(0, dtype=np.intp), *columns])]
    k = len(scale)
    of_others = pseudo_inverse(information[k:, k:])
    follows = of_others @ information[k:, :k]  # how much the others shrink as a dimension grows
    apart = information[:k, :k] - information[:k, k:] @ follows, score[:k] - follows.T @ score[k:]
    mean, covariance = shared_cauchy(*apart, scale)
    others = of_others @ score[k:] - follows @ mean
    errors = np.sqrt(np.concatenate([np.diag(covariance), np.diag(of_others + follows @ covariance @ follows.T)]))
    ends = np.cumsum([len(effect.amplitudes) for effect in effects])[:-1]
    moves = np.split(np.concatenate([mean, others]) - sizes, ends)
    moved = [effect.moved(np.asarray(move)) for effect, move in zip(effects, moves, strict=True)]
    return moved, np.split(errors, ends)


def shared_cauchy(information: Array, score: Array, scale: Array) -> tuple[Array, Array]:
    """Return posterior means (k,) and covariance (k, k) of sizes that are Cauchy distributed together about 0, with
    these scales: normal, with one unknown factor on all of them. information (k, k) and score (k,) at 0."""
    strength, way = np.linalg.eigh(information * np.outer(scale, scale))
    along, strength = way.T @ (scale * score), np.maximum(strength, 0.0)
    variance = 1 / (strength + SCALES[:, None] ** -2.0)
    log_evidence = np.sum(along**2 * variance - np.log1p(strength * SCALES[:, None] ** 2), axis=1) / 2 + LOG_WEIGHTS
    weight = np.exp(log_evidence - log_evidence.max())
    means = (along * variance) @ way.T
    mean = np.average(means, axis=0, weights=weight)
    off = means - mean
    covariance = (way * np.average(variance, axis=0, weights=weight)) @ way.T
    covariance += (weight / weight.sum() * off.T) @ off
    return scale * mean, covariance * np.outer(scale, scale)


def _numbers(robot: RobotDescription) -> Array:
    """Return all numbers of a robot's geometry as built."""
    geometry = Geometry.of(robot.as_built())
    return np.nan_to_num(np.concatenate([np.ravel(getattr(geometry, name)) for name in NUMBERS]))
