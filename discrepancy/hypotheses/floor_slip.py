"""Wheels that slide in some place: a slippery patch of the floor, or what cannot be told more of."""

import dataclasses
from collections.abc import Sequence

from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.hypotheses.patches import slides_there, slippery_in
from discrepancy.inference.evidence import BURST, Evidence, evidence_of
from discrepancy.inference.findings import Diagnosis, Finding, Rank

SLIDING, IN_BURSTS = 4e-4, 0.5
"""m after 1 m, and the share of slip in the worst steps (`BURST`): more of both is sliding in some place, no effect of
the robot, and would be taken for many."""

SLIPPING, PARTLY_IN_BURSTS, PASSED = 1e-4, 0.4, 20
"""The same, from which on a slippery patch is looked for where nothing else is found; and the wheels' steps in it that
held-out logs must have."""

SLIDES = 2.0
"""So many times larger than elsewhere the squares of slip are where held-out logs bear out a slippery patch."""


def slides(seen: Evidence) -> bool:
    """Whether wheels slide in bursts, so much that no effect on the robot can be told beside it."""
    return seen.noise.along > SLIDING and seen.burst.share > IN_BURSTS


def slips_in_bursts(seen: Evidence) -> bool:
    """Whether wheels may slide somewhere."""
    return seen.noise.along > SLIPPING and seen.burst.share > PARTLY_IN_BURSTS


def sliding(
    robot: RobotDescription, logs: Sequence[Log], seen: Evidence, held_out: Sequence[Log], result: Diagnosis
) -> Diagnosis:
    """Return the diagnosis of wheels that slide in some place: a slippery patch, or what cannot be told more of."""
    finding = _of_place(robot, logs, seen, held_out)
    if finding is not None:
        after = result.before if finding.verdict == "named" else None
        return dataclasses.replace(
            result, verdict=finding.verdict, reason=finding.reason, findings=(finding,), after=after
        )
    burst = seen.burst
    reason = (
        f"wheels slide in bursts, {100 * burst.share:.0f} % of all slip in {100 * BURST:.0f} % of the time; most "
        f"at {burst.t:.1f} s of log {burst.log + 1}, near x {burst.x:.2f}, y {burst.y:.2f} m: look at the floor"
    )
    return dataclasses.replace(result, verdict="unexplained", reason=reason)


def _of_place(robot: RobotDescription, logs: Sequence[Log], seen: Evidence, held_out: Sequence[Log]) -> Finding | None:
    """Return the finding of a slippery patch; None where wheels slip no more in one place than elsewhere."""
    patch = None if seen.left is None else slippery_in(robot, logs, seen.state, seen.slips)
    if patch is None:
        return None
    effect = patch.effect
    candidate = Candidate(described(effect), (effect,))
    rank = Rank(candidate, patch.gain, patch.gain, 0.0, (effect.value,), (patch.error,))
    finding = Finding("named", candidate.what, (rank,), (), effect, patch.error)
    if held_out:
        again = evidence_of(robot, held_out, among=())
        reason = None
        steps, times = slides_there(robot, held_out, again.state, again.slips, effect)
        if steps < PASSED:
            reason = f"the held-out motion does not show {candidate.what}"
        elif times < SLIDES:
            reason = f"the held-out logs do not confirm {candidate.what}"
        if reason is not None:
            finding = dataclasses.replace(finding, verdict="unconfirmed", reason=reason)
    return finding
