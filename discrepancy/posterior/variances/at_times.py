"""Wheels that disagree with the others at some times far more than at others: nothing of the catalogue, and no noise.

In good order a window's disagreement is as Student's t has it, whose tails are wide; the alternative is that in some
windows it is a fault's, Cauchy distributed. When and why is not known, so it has no name and cannot be foretold.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaln, logit

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.measurement.design_matrix import Columns
from discrepancy.posterior.answers import Answer, Cause
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, FREEDOM, NOTHING
from discrepancy.posterior.disagreement import LEAST_KEPT, Disagreement, of_row
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.variances.bursts import Bursts, bursts_of

PARTS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4])
"""Of all windows, that may be a fault's."""

IN_SOME = 0.5
"""Probability that a fault at times is in one log, as it may be in another."""


class Faulty(NamedTuple):
    """A row of the constraints, a wheel's rolling or a castor's side slip, that contradicts the others at times.

    hits, (W,) of each log: windows in which it does; slips (W,): by how much, as a part of the way. log_odds: of that
    it does against that it does not, natural logarithm.
    """

    row: int
    hits: tuple[NDArray[np.bool_], ...]
    slips: tuple[Array, ...]
    log_odds: float


def at_times(seen: Linearised, clean: Linearised | None, told: Sequence[Answer], names: int) -> list[Faulty]:
    """Return the rows that surely disagree with the others at times, beyond the effects told.

    names: of what else may be there, each as likely before logs are seen.
    """
    among = [answer.candidate for answer in told if answer.effect is not None]
    every = _beside(seen, among)
    usual = np.zeros(every[0].shape[1])
    if clean is not None:
        usual = np.max([usual, *(_log_factors(one.beside([])) for one in clean.disagreements)], axis=0)
    found: list[Faulty] = []
    while len(found) < len(usual):
        log_odds = _in_some([_log_factors(off) for off in every]) - usual - logit(NOTHING) - np.log(names)
        row = int(np.argmax(log_odds))
        if expit(log_odds[row]) < CREDIBLE:
            break
        hits = tuple(_hit(off[:, row]) for off in every)
        told_by = zip(seen.designs, seen.disagreements, every, hits, strict=True)
        slips = tuple(_slips(design, one, off, row, hit) for design, one, off, hit in told_by)
        found.append(Faulty(row, hits, slips, float(log_odds[row])))
        every = [off * ~hit[:, None] for off, hit in zip(every, hits, strict=True)]
    return found


def steps_of(seen: Linearised, faulty: Sequence[Faulty]) -> list[NDArray[np.bool_]]:
    """Return the steps (K - 1, rows) of every log in which rows contradict the others."""
    every = []
    for k, one in enumerate(seen.disagreements):
        hits = np.zeros(one.seen.shape, dtype=bool)
        for fault in faulty:
            hits[:, fault.row] |= fault.hits[k]
        every.append(np.repeat(hits, one.steps, axis=0))
    return every


def again(seen: Linearised, faulty: Sequence[Faulty]) -> tuple[list[Faulty], list[float]]:
    """Return where the same rows contradict the others in other logs, and by how much (natural logarithm) these are
    likelier for it."""
    every, found, confirmed = _beside(seen, ()), [], []
    for fault in faulty:
        hits = tuple(_hit(off[:, fault.row]) for off in every)
        confirmed.append(float(_in_some([_log_factors(off) for off in every])[fault.row]))
        found.append(fault._replace(hits=hits, slips=tuple(np.zeros(len(hit)) for hit in hits)))
        every = [off * ~hit[:, None] for off, hit in zip(every, hits, strict=True)]
    return found, confirmed


def answer_of(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, fault: Faulty, confirmed: float | None
) -> Answer:
    """Return what is said of a row that contradicts the others at times. confirmed: as `Answer` has it."""
    probability, largest = float(expit(fault.log_odds)), [np.abs(slips).max(initial=0.0) for slips in fault.slips]
    k = int(np.argmax(largest))
    most = int(np.argmax(np.abs(fault.slips[k])))
    what = f"{_row(robot, int(seen.designs[k].model.rows[fault.row]))} contradicts the others at times, most at "
    what += f"{seen.disagreements[k].t[most]:.0f} s" + (f" of log {k + 1}" if len(logs) > 1 else "")
    slipped = [one.slips(fault.row, slips) for one, slips in zip(seen.disagreements, fault.slips, strict=True)]
    cost = seen.cost_of_slips(slipped)
    answer = Answer(
        probabilities={what: probability, "nothing": 1 - probability},
        credible=(what,),
        unnamed=True,
        candidate=Candidate(what),
        amplitudes=np.array([largest[k]]),
        covariance=np.zeros((1, 1)),
        hidden=0.0,
        explained=2 * fault.log_odds,
        cost=cost / largest[k],
        confirmed=confirmed,
    )
    bursts = bursts_of(robot, logs, seen, fault.row, fault.hits)
    return _losing(answer, bursts, cost, sum(int(hit.sum()) for hit in fault.hits))


def _losing(answer: Answer, bursts: Bursts | None, cost: Array, hits: int) -> Answer:
    """Return the answer that counts are lost in bursts, if they may be: where they are not, what is missing is of
    either sense in each of the windows that are hit."""
    if bursts is None:
        return answer
    lost, what = float(expit(hits * np.log(2))), answer.credible[0]
    candidate = Candidate(described(bursts.effect), (bursts.effect,))
    credible = (candidate.family,) if lost >= CREDIBLE else (candidate.family, what)
    parts = {candidate.family: lost * answer.probability, what: (1 - lost) * answer.probability}
    return dataclasses.replace(
        answer,
        probabilities=parts | {"nothing": answer.probabilities["nothing"]},
        credible=credible,
        unnamed=len(credible) > 1,
        candidate=candidate,
        amplitudes=np.array([bursts.effect.value]),
        covariance=np.array([[bursts.error**2]]),
        cost=cost / bursts.effect.value,
    )


def _beside(seen: Linearised, among: Sequence[Cause]) -> list[Array]:
    """Return by how many sizes wheels disagree (W, rows) in each log, beside some candidates."""
    every = []
    for design, disagreement in zip(seen.designs, seen.disagreements, strict=True):
        of_column = [candidate for candidate in design.candidates for _ in range(candidate.columns)]
        columns = [column for column, candidate in enumerate(of_column) if candidate in among]
        every.append(disagreement.beside(columns))
    return every


def _slips(design: Columns, disagreement: Disagreement, off: Array, row: int, hit: NDArray[np.bool_]) -> Array:
    """Return the slip of a row (W,), as a part of the way, that is alone to slip in windows that are hit."""
    rolled = np.abs(design.model.rolled(design.geometry, design.state)).max(axis=1)
    starts = np.cumsum(disagreement.steps) - disagreement.steps
    _, by_slip = of_row(design, row)
    kept = np.add.reduceat(by_slip * rolled, starts) / np.add.reduceat(disagreement.way, starts)
    kept = np.maximum(kept, LEAST_KEPT)
    return np.where(hit, off[:, row] * disagreement.sizes()[not disagreement.along[row]] / kept, 0.0)


def _in_some(log_factors: Sequence[Array]) -> Array:
    """Return log Bayes factors (rows,) of faults that may be in some logs only, of those (rows,) of each log."""
    return np.asarray(np.sum(np.logaddexp(np.log1p(-IN_SOME), np.log(IN_SOME) + np.array(log_factors)), axis=0))


def _log_densities(off: Array) -> tuple[Array, Array]:
    """Return how likely disagreements, in sizes, are in good order and of a fault (natural logarithm)."""
    good = gammaln((FREEDOM + 1) / 2) - gammaln(FREEDOM / 2) - np.log(np.pi * FREEDOM) / 2
    good = good - (FREEDOM + 1) / 2 * np.log1p(off**2 / FREEDOM)
    return good, -np.log(np.pi * FAULT) - np.log1p((off / FAULT) ** 2)


def _log_factors(off: Array) -> Array:
    """Return for every row the log Bayes factor of faults at times, of disagreements (W, rows) in sizes."""
    return np.asarray(np.logaddexp.reduce(_each(off), axis=0) - np.log(len(PARTS)))


def _each(off: Array) -> Array:
    """Return the log Bayes factors (`PARTS`, rows) of faults in these parts of all windows."""
    good, fault = _log_densities(off)
    return np.asarray(
        np.logaddexp(np.log1p(-PARTS)[:, None, None], np.log(PARTS)[:, None, None] + fault - good).sum(axis=1)
    )


def _hit(off: Array) -> NDArray[np.bool_]:
    """Return which windows (W,) of a row are a fault's rather than not."""
    good, fault = _log_densities(off)
    return np.asarray(fault - good + logit(PARTS[np.argmax(_each(off[:, None])[:, 0])]) > 0)


def _row(robot: RobotDescription, row: int) -> str:
    """Return the name of a row of the constraints: a wheel's rolling or a castor's side slip."""
    w = len(robot.wheels)
    return f"wheel_{robot.wheel_names[row]}" if row < w else f"castor_{robot.wheel_castors[row - w] + 1}"
