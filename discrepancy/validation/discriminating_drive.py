"""The drive that would distinguish candidates which the given logs do not."""

from collections.abc import Sequence

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.inference.evidence import Evidence, evidence_of
from estimators.calibration.drives import DRIVES, REFERENCE, TYPICAL, Poses, log_of

ENOUGH = 25.0
"""Expected deviance between two candidates from which on a drive tells them apart."""


def separating_drive(
    robot: RobotDescription, candidates: Sequence[tuple[Candidate, Array]], poses: Poses
) -> str | None:
    """Return the drive after which the first candidate, with its amplitudes, is farthest from the nearest other one.

    poses: how many reference poses can be had. None if no drive would tell them apart.
    """
    best, farthest = None, ENOUGH
    among = [candidate for candidate, _ in candidates] if all(candidate.kinds for candidate, _ in candidates) else None
    for drive, make in DRIVES.items():
        try:
            logs = [log_of(robot, trajectory, poses) for trajectory in make(robot)]
            seen = evidence_of(robot, logs, TYPICAL, among=among)
        except InputError:
            continue
        distance = _distance(seen, candidates)
        if distance > farthest:
            best, farthest = f"{drive} {REFERENCE[poses]}", distance
    return best


def _distance(seen: Evidence, candidates: Sequence[tuple[Candidate, Array]]) -> float:
    """Return the deviance by which the nearest of the other candidates would fit worse than the first."""
    (first, amplitudes), *others = candidates
    place = seen.index(first)
    if place is None:
        return 0.0
    expected = seen.expecting(place, 0.0, amplitudes)
    all_of_it = expected.foretold(first, 0.0, amplitudes)
    there = [k for k in (expected.index(other) for other, _ in others) if k is not None]
    return all_of_it - max((expected.best([(k, expected.parted(k))])[2] for k in there), default=0.0)
