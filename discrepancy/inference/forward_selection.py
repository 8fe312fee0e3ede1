"""Names the effects that a robot's description is missing, one after another, or says why it cannot.

1. Everything that is no property of the robot is fitted first: what truly happened, slip, noise and clock of the
   reference, the tracked point (`evidence_of`).
2. Every effect of the catalogue competes with rivals that have no name. The gain is the deviance that a candidate takes
   away; candidates hardly worse than the best one cannot be told from it (`ranking`).
3. What is found goes into the model and is refitted, all of it together; then the next is looked for. Each is checked
   against all others with the rest in place, and exchanged for a better one (`selection`).
4. Between near rivals held-out logs decide, where there are such; and a name must be borne out by them.
5. What no signature tells is looked for by itself: time (`timing`), counts lost in bursts (`bursts`), wheels that slide
   in places (`sliding`), and, if nothing else is found, a reference that goes to and fro (`swinging`).

A gain counts where it would count as well if every wheel crept a little (`sober`): contact is not as rigid as
rolling, and a log of a minute tells far smaller parts of a radius than mean anything.
"""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from threadpoolctl import threadpool_limits

from castor_envs.effects.clocks import SampleJitter
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.bursts import losing, lost_in_bursts
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.hypotheses.clocks import of_time
from discrepancy.hypotheses.floor_slip import slides, sliding, slips_in_bursts
from discrepancy.hypotheses.noise_excess import louder_than
from discrepancy.hypotheses.reference_drift import swinging
from discrepancy.inference.evidence import Evidence, evidence_of
from discrepancy.inference.evidence_cache import Known, Looks
from discrepancy.inference.findings import BORNE_OUT, WEAKEST_FIRST, Diagnosis, Finding, Left, Rank, without
from discrepancy.inference.ranking import LEAST_GAIN, MARGIN, alike, margin, pick, ranks_of, sine
from discrepancy.inference.selection import BESIDE, Found, Look, decided, foretold, one_after_another
from discrepancy.validation.sufficient import check_seen, must_fit

SHAKEN = 1.5
"""Times more that an effect must take away where encoders are read early and late at random."""

HIDDEN = 0.07
"""Standard deviation, as a part of an effect's size, of what wheels hide of it that no log tells."""

EXERCISED, SHOWN = 25.0, 10.0
"""The deviance that an effect of its size would make on held-out logs for them to bear it out or not; or that it takes
away from them."""


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def diagnose(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log] = (),
    clean: Sequence[Log] = (),
    before: RobotDescription | None = None,
) -> Diagnosis:
    """Return what logs say is missing in a robot's description.

    held_out: logs that a name must be borne out by. clean: logs of the robot before it had the effect; only what goes
    beyond them is named. before: the robot as it made these, if its description was another.
    Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    check_seen(robot, logs, held_out, clean)
    with must_fit(robot):
        return _diagnosed(robot, logs, held_out, clean, before)


def _diagnosed(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log],
    clean: Sequence[Log],
    before: RobotDescription | None,
) -> Diagnosis:
    """Return what `diagnose` does."""
    asked, robot = robot, without(robot, SampleJitter)
    good = _of_clean(without(before or robot, SampleJitter), tuple(clean)) if clean else None
    known = Known.of(robot, good)
    look = Looks(known, logs, finds=True)
    first = look([])
    timing = of_time(asked, logs, first, held_out, good, clean)

    ranks = ranks_of(first)
    result = Diagnosis(
        robot=asked,
        verdict="no discrepancy",
        reason="no candidate improves the fit by more than chance does on robots without any effect",
        findings=(),
        ranks=ranks,
        before=_left(first),
        clean=None if good is None else _left(good),
    )
    if (lost := losing(robot, logs)) is not None:
        finding = lost_in_bursts(robot, lost, held_out)
        after = _left(look([lost.effect])) if lost.steady else result.before
        return dataclasses.replace(
            result, verdict=finding.verdict, reason=finding.reason, findings=(finding, *timing), after=after
        )
    if not first.places and slides(first):
        return sliding(robot, logs, first, held_out, result)

    again = Looks(known, held_out, finds=False) if held_out else None
    shaken = any(one.effect is None or isinstance(one.effect, SampleJitter) for one in timing)
    least, noisy = LEAST_GAIN * (SHAKEN if shaken else 1.0), None
    if good is not None and again is not None and pick(first) is None:
        noisy = louder_than(good, first, first, lambda: again([]))
    found, left = one_after_another(robot, look, again, first, least, noisy is None)
    if not found and (slides(first) or slips_in_bursts(first)):
        place = sliding(robot, logs, first, held_out, result)
        if slides(first) or place.findings:
            return place
    if again is not None and found:
        found, left = decided(robot, look, again, found, left)
    known.finest.clear()  # Of others, which left more when they were refitted, none is a rival.
    known.admit([one.effect for one in found])
    findings = [_judged(look, again, found, k) for k in range(len(found))]
    if again is not None and found:
        findings, gaps = _borne_out(again, found, findings)
        result = dataclasses.replace(result, held_out=gaps)
    rest = None if shaken else pick(left)
    if rest is not None and rest.gain > BESIDE * max((one.gain for one in (findings or timing) if found), default=0.0):
        findings = [*(_in_doubt(one, rest) for one in findings), _nameless(alike(left, rest), rest, ranks_of(left))]
    if not findings and (swing := swinging(robot, logs, first)) is not None:
        findings.append(swing)
    rounded = any(kind.discrete for one in found for kind in one.candidate.kinds)
    if good is not None and not shaken and not rounded and all(one.verdict != "unexplained" for one in findings):
        effects = [one.effect for one in found]
        louder = louder_than(good, first, left, None if again is None else lambda: again(effects))
        if louder is not None:
            findings = [*(_in_doubt(one, louder) for one in findings), _nameless((louder,), louder)]
    findings += timing
    if not findings:
        return result
    judged = [one for one in findings if one.effect is not None] or findings
    weakest = min((one.verdict for one in judged), key=WEAKEST_FIRST.index)
    return dataclasses.replace(
        result,
        verdict=weakest,
        reason="; ".join(one.reason for one in findings),
        findings=tuple(findings),
        after=_left(left) if found else None,
    )


@lru_cache(maxsize=1)
def _of_clean(robot: RobotDescription, clean: tuple[Log, ...]) -> Evidence:
    """Return the evidence of clean logs, which often serve for many others."""
    return evidence_of(robot, clean)


def _judged(look: Look, again: Look | None, found: list[Found], k: int) -> Finding:
    """Return what is to be said of effect k beside the others."""
    own = found[k]
    near = foretold(look, again, found, k)
    top = max(near, key=lambda one: one.gain)
    apart = look([one.effect for one in found[:k] + found[k + 1 :]])
    chosen = tuple(
        one
        for n, one in enumerate(near)
        if top.gain - one.gain <= margin(top.gain, sine(apart, top, one)) or (n == 0 and one.candidate == own.candidate)
    )
    ranks = ranks_of(apart)
    among = {one.candidate for one in chosen}
    beaten = tuple(one for one in ranks if one.candidate not in among)
    error = float(np.hypot(own.error, HIDDEN * own.effect.value))
    finding = Finding("named", own.candidate.what, chosen, beaten, own.effect, error)
    its_gain = max((one.gain for one in near if one.candidate == own.candidate), default=0.0)
    in_logs = {one.candidate: one.gain for one in ranks}
    better = in_logs.get(top.candidate, 0.0) > in_logs.get(own.candidate, 0.0)  # not only where it foretells nothing
    if not top.candidate.kinds and better and top.gain - its_gain > MARGIN:
        best = f"the best effect is {own.candidate.what}"
        reason = f"an unmodelled alternative explains it better: {top.candidate.what}; {best}"
        return dataclasses.replace(finding, verdict="ambiguous", reason=reason)
    if len(finding.families) > 1:
        reason = f"these motions cannot distinguish: {'; '.join(finding.families)}"
        return dataclasses.replace(finding, verdict="ambiguous", reason=reason)
    return finding


def _in_doubt(one: Finding, rest: Rank) -> Finding:
    """Return the finding of an effect beside which much is left that has no name: it may be a part of that."""
    if one.verdict != "named" or rest.gain <= BESIDE * one.gain:
        return one
    other = Candidate(f"something that {rest.candidate.what} is a part of too")
    reason = f"it may be {one.reason}, or part of a disagreement that no effect explains: {rest.candidate.what}"
    return dataclasses.replace(
        one, verdict="ambiguous", reason=reason, chosen=(*one.chosen, dataclasses.replace(rest, candidate=other))
    )


def _nameless(chosen: tuple[Rank, ...], best: Rank, ranks: Sequence[Rank] = ()) -> Finding:
    """Return the finding of what is left and no effect explains: it looks like those chosen, the best one of all."""
    beaten = tuple(one for one in ranks if one not in chosen)
    kinds = best.candidate.kinds
    reason = f"no effect of the catalogue explains it; it looks like: {best.candidate.what}"
    if kinds:
        reason = f"{best.candidate.what} of {best.size:.3g} {kinds[0].unit} looks most like it, and does not explain it"
    return Finding("unexplained", reason, chosen, beaten)


def _borne_out(again: Look, found: list[Found], findings: list[Finding]) -> tuple[list[Finding], tuple[Left, Left]]:
    """Return the findings, and what is left of held-out logs.

    What they do not bear out is unconfirmed; if it is but something found beside larger effects, it was nothing.
    """
    own = [one.candidate for one in found]
    nominal, with_all = (again(effects, own) for effects in ([], [one.effect for one in found]))
    judged = []
    for one, finding in zip(found, findings, strict=True):
        shown, less, change = _wanted(with_all, one)
        reason = None
        if shown < EXERCISED and less < SHOWN:
            reason = f"the held-out motion does not show {one.candidate.what}"
        elif change > BORNE_OUT:
            if finding.gain < max(other.gain for other in findings) / 2:
                continue
            reason = f"the held-out logs do not confirm {one.candidate.what}"
        if reason is not None and one.effect is not None and one.effect.creep == "compliance" and len(findings) > 1:
            continue
        if reason is not None and finding.verdict == "named":
            finding = dataclasses.replace(finding, verdict="unconfirmed", reason=reason)
        judged.append(finding)
    return judged, (_left(nominal), _left(with_all))


def _wanted(with_all: Evidence, one: Found) -> tuple[float, float, float]:
    """Return the deviance that an effect of this size makes, that which it takes away, and by what part of itself the
    logs would change it."""
    place = with_all.index(one.candidate)
    if place is None:
        return 0.0, 0.0, 0.0
    amplitudes, columns = one.candidate.amplitudes(one.effect), with_all.columns[place]
    change, _, _ = with_all.best([(place, 0.0)])
    shown = float(amplitudes @ with_all.plain[0][np.ix_(columns, columns)] @ amplitudes)
    less = -with_all.foretold(one.candidate, 0.0, -amplitudes)
    return shown, less, float(np.linalg.norm(change) / np.linalg.norm(amplitudes))


def _left(seen: Evidence) -> Left:
    position, heading = seen.left or (None, None)
    return Left(position, heading, seen.noise, seen.state)
