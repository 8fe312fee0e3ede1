"""Sample jitter, a random timing error that all encoders share: its probability and standard deviation.

Jitter has mean 0, so it is a variance and not a column of the linear problem; `delays` computes its statistics.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.special import expit

from castor_envs.effects.clocks import SampleJitter
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, prior_log_odds
from discrepancy.posterior.variances.delays import ORDER, SPREAD, delays_of, jitter_of
from discrepancy.validation.cost import cost_of

SIZES = np.geomspace(0.01, 1000.0, 201)
"""Sizes of jitter, in tolerances: a grid to integrate over."""

GOOD_ORDER = -(SIZES**2) / 2
"""Log density of each size in good order, up to a constant."""


def jitter_answer(
    robot: RobotDescription, logs: Sequence[Log], held_out: Sequence[Log], clean: Sequence[Log], names: int
) -> Answer | None:
    """Return the answer that samples jitter more than in clean logs; None if its probability is below `CREDIBLE`.

    names: number of other possible answers, all of the same prior probability.
    """
    seen = jitter_of(robot, logs)
    if seen is None:
        return None
    found = jitter_of(robot, clean) if clean else None
    usual, tolerance = 0.0 if found is None else found.value, SampleJitter.tolerance
    probability, size, error = weighed(_log_likelihood(robot, logs, usual), names)
    if probability < CREDIBLE:
        return None
    (kind,) = SampleJitter.variants(robot)
    effect = dataclasses.replace(kind, value=size * tolerance)
    candidate = Candidate(described(kind), (kind,))
    if seen.seldom:
        candidate = Candidate(f"all encoders are read early or late together at some times, most {seen.seldom}")
    confirmed = held_out_log_odds(_log_likelihood(robot, held_out, usual), size) if held_out else None
    cost = np.array([cost_of(robot, effect, logs) or 0.0, 0.0])
    return Answer.judged_apart(candidate, probability, effect.value, error * tolerance, cost, confirmed)


def _log_likelihood(robot: RobotDescription, logs: Sequence[Log], usual: float) -> Array:
    """Return the log-likelihood of logs (natural logarithm, up to a constant) with jitter of `SIZES` added to the usual
    jitter (s).

    Neighbouring differences share all but one of their samples, so `ORDER` of them count as one.
    """
    late, rounding, *_ = (np.concatenate(part) for part in zip(*(delays_of(robot, log) for log in logs), strict=True))
    variance = rounding + SPREAD * (usual**2 + (SIZES[:, None] * SampleJitter.tolerance) ** 2)
    return -np.sum(np.log(variance) + late**2 / variance, axis=1) / 2 / ORDER


def weighed(log_likelihood: Array, names: int) -> tuple[float, float, float]:
    """Return the probability of a fault, given the log-likelihood of logs with each of `SIZES`, and its size and
    standard error, in tolerances. names: number of possible faults, all of the same prior probability.

    Priors as for every other effect: in good order normal, with the tolerance as standard deviation; a fault is Cauchy
    distributed.
    """
    fault = -np.log1p((SIZES / FAULT) ** 2)
    log_odds = _averaged(log_likelihood, fault) - _averaged(log_likelihood, GOOD_ORDER)
    weight = np.exp(log_likelihood + fault - np.max(log_likelihood + fault)) * SIZES
    size = float(np.average(SIZES, weights=weight))
    error = float(np.sqrt(np.average((SIZES - size) ** 2, weights=weight)))
    return float(expit(log_odds + prior_log_odds(names))), size, error


def held_out_log_odds(log_likelihood: Array, size: float) -> float:
    """Return the log-likelihood ratio (natural logarithm) of other logs with a fault of this size, in tolerances,
    against good order."""
    return float(np.interp(size, SIZES, log_likelihood)) - _averaged(log_likelihood, GOOD_ORDER)


def _averaged(log_likelihood: Array, log_density: Array) -> float:
    """Return the log of the mean likelihood over sizes with this log density, up to a constant; the grid is even in log
    size."""
    steps = np.log(SIZES)
    return float(np.logaddexp.reduce(log_likelihood + log_density + steps) - np.logaddexp.reduce(log_density + steps))
