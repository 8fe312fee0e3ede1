"""Intermittent faults: wheels that disagree with the other wheels far more in some windows than in the rest of a log.

In good order the disagreement of a window has Student's t distribution, with wide tails; the alternative is that in
some windows it comes from a fault, whose size is Cauchy distributed. When and why these windows occur is unknown, so
this is an unnamed alternative, and no simulation can predict it.
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
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.variances.bursts import Bursts, bursts_of
from estimators.likelihood.disagreement import LEAST_KEPT, Disagreement, of_row

PARTS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4])
"""Parts of all windows in which the fault may be active."""

IN_LOG = 0.5
"""Prior probability that an intermittent fault of a robot shows in any given log."""


class Faulty(NamedTuple):
    """A row of the constraints, a wheel's rolling or a castor's side slip, that contradicts the other rows
    intermittently.

    active: for each log the probability (W,) that it does so in a window; slips: for each log the slip (W,) in windows
    where this is likely, as a part of the way. log_odds: log odds (natural logarithm) of the fault.
    """

    row: int
    active: tuple[Array, ...]
    slips: tuple[Array, ...]
    log_odds: float

    @property
    def hits(self) -> tuple[NDArray[np.bool_], ...]:
        """For each log the windows (W,) in which the fault is likelier active than not."""
        return tuple(probability > 0.5 for probability in self.active)


def at_times(seen: Linearised, clean: Linearised | None, answers: Sequence[Answer], names: int) -> list[Faulty]:
    """Return the rows that disagree with the other rows intermittently with probability `CREDIBLE`, beyond the effects
    in `answers`.

    names: number of other possible answers, all of the same prior probability.
    """
    among = [answer.candidate for answer in answers if answer.effect is not None]
    disagreements = _beside(seen, among)
    usual = np.zeros(disagreements[0].shape[1])
    if clean is not None:
        good = [disagreement.beside([], clean.noise.turning) for disagreement in clean.disagreements]
        usual = np.max([usual, *map(_log_factors, good)], axis=0)
    found: list[Faulty] = []
    while len(found) < len(usual):
        log_odds = _in_some_logs([_log_factors(off) for off in disagreements]) - usual - logit(NOTHING) - np.log(names)
        row = int(np.argmax(log_odds))
        if expit(log_odds[row]) < CREDIBLE:
            break
        active = tuple(_active(off[:, row]) for off in disagreements)
        fault = Faulty(row, active, (), float(log_odds[row]))
        sized = zip(seen.disagreements, disagreements, strict=True)
        off = [usually.scale(seen.noise.turning)[:, row] * of_log[:, row] for usually, of_log in sized]
        told_by = zip(seen.designs, seen.disagreements, off, fault.hits, strict=True)
        slips = tuple(_slips(design, disagreement, row, size, hit) for design, disagreement, size, hit in told_by)
        found.append(fault._replace(slips=slips))
        disagreements = [off * ~hit[:, None] for off, hit in zip(disagreements, fault.hits, strict=True)]
    return found


def steps_of(seen: Linearised, faulty: Sequence[Faulty]) -> list[NDArray[np.bool_]]:
    """Return the steps (K - 1, rows) of every log in which faulty rows contradict the other rows."""
    steps = []
    for k, disagreement in enumerate(seen.disagreements):
        hits = np.zeros(disagreement.seen.shape, dtype=bool)
        for fault in faulty:
            hits[:, fault.row] |= fault.hits[k]
        steps.append(np.repeat(hits, disagreement.steps, axis=0))
    return steps


def recurring(seen: Linearised, faulty: Sequence[Faulty]) -> tuple[list[Faulty], list[float]]:
    """Return the windows of other logs in which the same rows contradict the rest, and the log Bayes factor of each
    fault in them."""
    disagreements, found, confirmed = _beside(seen, ()), [], []
    for fault in faulty:
        active = tuple(_active(off[:, fault.row]) for off in disagreements)
        confirmed.append(float(_in_some_logs([_log_factors(off) for off in disagreements])[fault.row]))
        found.append(fault._replace(active=active, slips=tuple(np.zeros(len(of_log)) for of_log in active)))
        disagreements = [off * ~hit[:, None] for off, hit in zip(disagreements, found[-1].hits, strict=True)]
    return found, confirmed


def answer_of(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, fault: Faulty, confirmed: float | None
) -> Answer:
    """Return the answer for a row that contradicts the other rows intermittently. confirmed: see `Answer`."""
    probability, largest = float(expit(fault.log_odds)), [np.abs(slips).max(initial=0.0) for slips in fault.slips]
    k = int(np.argmax(largest))
    worst = int(np.argmax(np.abs(fault.slips[k])))
    description = f"{_row(robot, int(seen.designs[k].model.rows[fault.row]))} contradicts the others at times, most at "
    description += f"{seen.disagreements[k].t[worst]:.0f} s" + (f" of log {k + 1}" if len(logs) > 1 else "")
    slipped = [
        disagreement.slips(fault.row, slips)
        for disagreement, slips in zip(seen.disagreements, fault.slips, strict=True)
    ]
    cost = seen.cost_of_slips(slipped)
    answer = Answer.judged_apart(Candidate(description), probability, largest[k], 0.0, cost, confirmed)
    return _losing(answer, bursts_of(robot, logs, seen, fault.row, fault.active), cost)


def _losing(answer: Answer, bursts: Bursts | None, cost: Array) -> Answer:
    """Return the answer that counts are lost in bursts, if this is likelier than another cause."""
    if bursts is None:
        return answer
    lost, contradiction = float(expit(bursts.log_odds)), answer.credible[0]
    candidate = Candidate(described(bursts.effect), (bursts.effect,))
    credible = (candidate.family,) if lost >= CREDIBLE else (candidate.family, contradiction)
    parts = {candidate.family: lost * answer.probability, contradiction: (1 - lost) * answer.probability}
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
    """Return the disagreement (W, rows) of each log in units of its usual size, after least squares of these
    candidates."""
    by_log = []
    for design, disagreement in zip(seen.designs, seen.disagreements, strict=True):
        of_column = [candidate for candidate in design.candidates for _ in range(candidate.columns)]
        columns = [column for column, candidate in enumerate(of_column) if candidate in among]
        by_log.append(disagreement.beside(columns, seen.noise.turning))
    return by_log


def _slips(design: Columns, disagreement: Disagreement, row: int, size: Array, hit: NDArray[np.bool_]) -> Array:
    """Return the slip (W,) of a row, as a part of the way, if no other row slips in the windows that are hit. size
    (W,): disagreement of the row, as a part of the way."""
    rolled = np.abs(design.model.rolled(design.geometry, design.state)).max(axis=1)
    starts = np.cumsum(disagreement.steps) - disagreement.steps
    _, by_slip = of_row(design.model, design.geometry, design.state, row)
    kept = np.add.reduceat(by_slip * rolled, starts) / np.add.reduceat(disagreement.way, starts)
    kept = np.maximum(kept, LEAST_KEPT)
    return np.where(hit, size / kept, 0.0)


def _in_some_logs(log_factors: Sequence[Array]) -> Array:
    """Return the log Bayes factors (rows,) of faults that show in some of the logs, from the factors (rows,) of each
    log."""
    return np.asarray(np.sum(np.logaddexp(np.log1p(-IN_LOG), np.log(IN_LOG) + np.array(log_factors)), axis=0))


def _log_densities(off: Array) -> tuple[Array, Array]:
    """Return the log densities of disagreements, in units of their usual size, in good order and under a fault."""
    good = gammaln((FREEDOM + 1) / 2) - gammaln(FREEDOM / 2) - np.log(np.pi * FREEDOM) / 2
    good = good - (FREEDOM + 1) / 2 * np.log1p(off**2 / FREEDOM)
    return good, -np.log(np.pi * FAULT) - np.log1p((off / FAULT) ** 2)


def _log_factors(off: Array) -> Array:
    """Return for every row the log Bayes factor of intermittent faults, given disagreements (W, rows) in units of their
    usual size."""
    return np.asarray(np.logaddexp.reduce(_by_part(off), axis=0) - np.log(len(PARTS)))


def _by_part(off: Array) -> Array:
    """Return the log Bayes factors (`PARTS`, rows) of faults that are active in these parts of all windows."""
    good, fault = _log_densities(off)
    return np.asarray(
        np.logaddexp(np.log1p(-PARTS)[:, None, None], np.log(PARTS)[:, None, None] + fault - good).sum(axis=1)
    )


def _active(off: Array) -> Array:
    """Return the probability (W,) that the fault of a row is active in each window."""
    good, fault = _log_densities(off)
    return np.asarray(expit(fault - good + logit(PARTS[np.argmax(_by_part(off[:, None])[:, 0])])))


def _row(robot: RobotDescription, row: int) -> str:
    """Return the name of a row of the constraints: a wheel's rolling or a castor's side slip."""
    w = len(robot.wheels)
    return f"wheel_{robot.wheel_names[row]}" if row < w else f"castor_{robot.wheel_castors[row - w] + 1}"
