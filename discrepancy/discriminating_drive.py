"""The drive that would distinguish effects which logs do not: that of the largest expected log Bayes factor."""

from collections.abc import Sequence

import numpy as np

from castor_envs.errors import InputError
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import PARTS, order_of, sizes_of
from estimators.calibration.drives import DRIVES, REFERENCE, Poses, log_of


def drive_for(robot: RobotDescription, answer: Answer, among: Sequence[Candidate], poses: Poses) -> str | None:
    """Return the drive that best tells the effects in an answer's credible set from each other.

    among: candidates, of which those with a name in the set count. poses: where reference poses can be had. None where
    the set has no two names of effects, or no drive makes the odds between them as large as a credible set asks for.
    """
    own = [one for one in among if one == answer.candidate and one.kinds]
    others = {one.family: one for one in among if one.kinds and one.family in answer.credible}
    likely = [*own, *(one for family, one in others.items() if family != answer.candidate.family)]
    if not own or len(likely) < 2:
        return None
    best, most = None, LOG_ODDS
    for drive, make in DRIVES.items():
        try:
            logs = [log_of(robot, trajectory, poses) for trajectory in make(robot)]
            found = _expected(linearise(robot, logs, among=likely), answer)
        except (InputError, np.linalg.LinAlgError):  # the robot cannot drive it, or it shows nothing
            continue
        if found > most:
            best, most = f"{drive} {REFERENCE[poses]}", found
    return best


def _expected(seen: Linearised, answer: Answer) -> float:
    """Return the expected log Bayes factor of an answer's effect, as it was found, against the nearest other one of any
    size, hidden by wheels in any part, in logs of a robot that is in good order beside it."""
    if answer.candidate not in seen.candidates:
        return 0.0
    own = [one == answer.candidate for one in seen.candidates]
    size = sizes_of([own.index(True)], [answer.amplitudes], [answer.hidden], seen)
    told = order_of(seen, None).beyond(seen.logs).information
    explained, every = [0.0], np.eye(len(size))
    for columns, mine in zip(seen.columns, own, strict=True):
        for part in () if mine else PARTS:
            way = every[:, columns] + part * every[:, columns + len(seen.usual)]
            score, strength = way.T @ told @ size, way.T @ told @ way
            explained.append(float(score @ np.linalg.pinv(strength, hermitian=True) @ score))
    return (float(size @ told @ size) - max(explained)) / 2
