"""Wheels that disagree with the others at some times far more than at others: nothing of the catalogue, and no noise.

In good order a window's disagreement is as Student's t has it, whose tails are wide; the alternative is that in some
windows it is a fault's, Cauchy distributed. When and why is not known, so it has no name and cannot be foretold.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import expit, gammaln, logit

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, FREEDOM, NOTHING
from discrepancy.posterior.disagreement import FARTHEST
from discrepancy.posterior.linearise import Linearised
from discrepancy.validation.cost import cost_of_sizes

PARTS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4])
"""Of all windows, that may be a fault's."""


def at_times(
    robot: RobotDescription, seen: Linearised, clean: Linearised | None, told: Sequence[Answer], names: int
) -> list[Answer]:
    """Return for each log the encoder that surely disagrees with the others at times, beyond the answers told.

    names: of what else may be there, each as likely before logs are seen.
    """
    among = [answer.candidate for answer in told]
    usual = [] if clean is None else [_log_factors(one.beside([])) for one in clean.disagreements]
    answers = []
    for k, (design, disagreement) in enumerate(zip(seen.designs, seen.disagreements, strict=True)):
        of_column = [candidate for candidate in design.candidates for _ in range(candidate.columns)]
        off = disagreement.beside([column for column, candidate in enumerate(of_column) if candidate in among])
        log_odds = _log_factors(off) - np.max([np.zeros(off.shape[1]), *usual], axis=0) - logit(NOTHING) - np.log(names)
        row = int(np.argmax(log_odds))
        probability = float(expit(log_odds[row]))
        if probability < CREDIBLE:
            continue
        size = np.where(np.abs(off) > FARTHEST, off, 0.0)[:, row] * disagreement.sizes()[not disagreement.along[row]]
        largest, of = int(np.argmax(np.abs(size))), f" of log {k + 1}" if len(seen.designs) > 1 else ""
        what = f"{_row(robot, int(design.model.rows[row]))} contradicts the others at times, most at "
        what += f"{disagreement.t[largest]:.0f} s{of}"
        error = design.model.as_motion(design.geometry, design.state, disagreement.slips(row, size))
        answers.append(
            Answer(
                probabilities={what: probability, "nothing": 1 - probability},
                credible=(what,),
                unnamed=True,
                candidate=Candidate(what),
                amplitudes=np.abs(size[[largest]]),
                covariance=np.zeros((1, 1)),
                hidden=0.0,
                explained=2 * float(log_odds[row]),
                cost=cost_of_sizes(error, design.state[:, :3])[:, 0] / float(np.abs(size[largest])),
            )
        )
    return answers


def _log_factors(off: Array) -> Array:
    """Return for every row the log Bayes factor of faults at times, of disagreements (W, rows) in sizes."""
    good = gammaln((FREEDOM + 1) / 2) - gammaln(FREEDOM / 2) - np.log(np.pi * FREEDOM) / 2
    good = good - (FREEDOM + 1) / 2 * np.log1p(off**2 / FREEDOM)
    fault = -np.log(np.pi * FAULT) - np.log1p((off / FAULT) ** 2)
    factors = np.logaddexp(np.log1p(-PARTS)[:, None, None], np.log(PARTS)[:, None, None] + fault - good)
    return np.asarray(np.logaddexp.reduce(factors.sum(axis=1), axis=0) - np.log(len(PARTS)))


def _row(robot: RobotDescription, row: int) -> str:
    """Return the name of a row of the constraints: a wheel's rolling or a castor's side slip."""
    w = len(robot.wheels)
    return f"wheel_{robot.wheel_names[row]}" if row < w else f"castor_{robot.wheel_castors[row - w] + 1}"
