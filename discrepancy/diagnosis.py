"""Names the effects that a robot's description is missing, one after another, or says why it cannot.

1. Everything that is no property of the robot is fitted first: what truly happened, slip, noise and clock of the
   reference, the tracked point (`evidence_of`).
2. Every effect of the catalogue competes with rivals that have no name. The gain is the deviance that a candidate takes
   away; candidates hardly worse than the best one cannot be told from it.
3. What is found goes into the model and is refitted, all of it together; then the next is looked for. Each is checked
   against all others with the rest in place, and exchanged for a better one.
4. A name must be borne out by logs that it was not fitted to, where there are such.

A gain counts where it would count as well if every wheel crept a little (`evidence.CREEP`): contact is not as rigid as
rolling, and a log of a minute tells far smaller parts of a radius than mean anything.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from castor_envs.effects import ClockSkew, ContactCreep, Effect, SampleJitter, SlipStiffness, SlipStiffnessLateral
from castor_envs.errors import InputError
from castor_envs.kinematics import Array
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from discrepancy.candidates import Candidate, described
from discrepancy.evidence import BURST, Evidence, evidence_of
from discrepancy.findings import WEAKEST_FIRST, Diagnosis, Finding, Left, Rank, without
from discrepancy.inspection import BLIND
from discrepancy.parity import parity_residual
from discrepancy.places import slides_there, slippery_in
from discrepancy.timing import Amount, jitter_of, skew_of

LEAST_GAIN = 30.0
"""The deviance that a candidate must take away."""

CREEPING = SlipStiffness, SlipStiffnessLateral, ContactCreep
LEAST_OF_CREEP, MUCH_CREEP = 60.0, 2.0
"""The same of how contacts creep, which is predicted within a third or so; and how many times more than any other
candidate these must take away, as wrong contacts look a little like everything."""

EACH_MORE = 10.0
"""Deviance that a candidate with two amplitudes must take away more than one with one."""

LEAST_SOBER = 20.0
"""The deviance that it must take away where all wheels may creep."""

LEAST_OF_PLACE, MUCH_OF_PLACE = 60.0, 2.0
"""The same of something on the floor, whose place was looked for in the same logs: lines of all places and directions
look a little like everything too."""

MOST = 4
"""Effects are found one after another, at most so many."""

SLIDING, IN_BURSTS = 4e-4, 0.5
"""m after 1 m, and the share of slip in the worst steps (`BURST`): more of both is sliding in some place, no effect of
the robot, and would be taken for many."""

SLIPPING, PARTLY_IN_BURSTS, PASSED = 1e-4, 0.4, 20
"""The same, from which on a slippery patch is looked for where nothing else is found; and the wheels' steps in it that
held-out logs must have."""

SLIDES = 2.0
"""So many times larger than elsewhere the squares of slip are where held-out logs bear out a slippery patch."""

BACKGROUND = 5
"""At most so many effects are taken from clean logs as background."""

MARGIN, PART = 6.0, 0.03
"""Deviance, and part of the gain, by which a candidate may be worse than the best and not be told from it."""

WIDER = 3.0
"""Margins within which held-out logs decide: which candidate, as large as the logs ask for, takes away more there."""

SHAKEN = 1.5
"""Times more that an effect must take away where encoders are read early and late at random."""

LEAST_SKEW, LEAST_SKEW_GAIN = 1e-4, 18.0
"""s/s, and deviance, from which on clocks are said to run apart."""

SINGLES = 8
"""Effects with an amplitude each, the best ones, of which two are tried in the place of one with two."""

NEXT = 0.025
"""The part of what the first effect takes away that the next ones must."""

BESIDE = 0.15
"""What has no name is told beside effects if it takes away more than this part of what the first one does: amplitudes
that are a little wrong, and creep, leave some."""

LOUDER, RIGID = 2.5, 1.5e-5
"""So many times more noise than in clean logs is a discrepancy; slip in these is at least so much, m after 1 m."""

EXERCISED = 25.0
"""The deviance that an effect of its size would make on held-out logs for them to bear it out or not."""

BORNE_OUT = 0.5
"""The part of itself by which held-out logs may want an effect changed."""

ROUGHLY = 0.25
"""The part by which amplitudes may be wrong before they are refitted."""

REFITS, EXCHANGES, RIVALS = 4, 2, 3


@dataclass(frozen=True)
class _Found:
    """An effect on its way: of which candidate, and how large, with the standard error of its size."""

    candidate: Candidate
    effect: Effect
    error: float


class Look(Protocol):
    """Looks at what is left of the logs beside some effects, by all candidates or only some."""

    def __call__(self, effects: Sequence[Effect], among: Sequence[Candidate] | None = None) -> Evidence:
        """Return the evidence beside effects; among: candidates to look at, None: all."""
        ...


def diagnose(
    robot: RobotDescription, logs: Sequence[Log], held_out: Sequence[Log] = (), clean: Sequence[Log] = ()
) -> Diagnosis:
    """Return what logs say is missing in a robot's description.

    held_out: logs that a name must be borne out by. clean: logs of the robot before it had the effect; only what goes
    beyond them is named. Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    for some in (logs, held_out, clean):
        blind = [log for log in some if log.reference is None or not np.isfinite(log.reference).any()]
        if blind and parity_residual(robot, blind[0]).redundancy == 0:
            raise InputError(f"{BLIND}; give logs with ref_x, ref_y and ref_psi")
    asked, robot = robot, without(robot, SampleJitter)
    good = _of_clean(robot, tuple(clean)) if clean else None
    background = [] if good is None else _background(good)
    first = last = evidence_of(robot, logs, places=() if good is None else good.places).less(background)
    places = dict.fromkeys(first.places)
    timing = _of_time(asked, logs, first, held_out, good, clean)

    seen: dict[tuple[tuple[Effect, ...], tuple[Candidate, ...] | None], Evidence] = {((), None): first}

    def look(effects: Sequence[Effect], among: Sequence[Candidate] | None = None) -> Evidence:
        nonlocal last
        key = tuple(effects), None if among is None else tuple(among)
        if key not in seen:
            changed = robot.with_effects(*effects)
            seen[key] = evidence_of(changed, logs, start=last, among=among, places=tuple(places)).less(background)
            places.update(dict.fromkeys(seen[key].places))
        last = seen[key]
        return last

    ranks = _ranks(first)
    result = Diagnosis(
        robot=asked,
        verdict="no discrepancy",
        reason="no candidate takes away more than robots without any effect leave",
        findings=(),
        ranks=ranks,
        before=_left(first),
    )
    if not first.places and _slides(first):
        return _sliding(robot, logs, first, held_out, result)

    def look_again(effects: Sequence[Effect], among: Sequence[Candidate] | None = None) -> Evidence:
        changed = robot.with_effects(*effects)
        return evidence_of(changed, held_out, among=among, places=tuple(places)).less(background)

    again = look_again if held_out else None
    shaken = any(isinstance(one.effect, SampleJitter) for one in timing)
    found, left = _one_after_another(robot, look, again, first, LEAST_GAIN * (SHAKEN if shaken else 1.0))
    if not found and (_slides(first) or _slips_in_bursts(first)):
        sliding = _sliding(robot, logs, first, held_out, result)
        if _slides(first) or sliding.findings:
            return sliding
    if again is not None and found:
        found, left = _decided(robot, look, again, found, left)
    findings = [_judged(look, again, found, k) for k in range(len(found))]
    if again is not None and found:
        findings, gaps = _borne_out(again, found, findings)
        result = dataclasses.replace(result, held_out=gaps)
    rest = None if shaken else _pick(left)
    if rest is not None and rest.gain > BESIDE * max((one.gain for one in (findings or timing) if found), default=0.0):
        findings.append(_nameless(left, rest))
    if good is not None and not findings and (louder := _louder(first, good)) is not None:
        findings.append(louder)
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


def _slides(seen: Evidence) -> bool:
    return seen.noise.along > SLIDING and seen.burst.share > IN_BURSTS


def _slips_in_bursts(seen: Evidence) -> bool:
    return seen.noise.along > SLIPPING and seen.burst.share > PARTLY_IN_BURSTS


def _sliding(
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
    patch = None if seen.left is None else slippery_in(robot, logs, seen.state, seen.patches)
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
            reason = f"the held-out logs do not bear out {candidate.what}"
        if reason is not None:
            finding = dataclasses.replace(finding, verdict="unconfirmed", reason=reason)
    return finding


@lru_cache(maxsize=1)
def _of_clean(robot: RobotDescription, clean: tuple[Log, ...]) -> Evidence:
    """Return the evidence of clean logs, which often serve for many others."""
    return evidence_of(robot, clean)


def _of_time(
    robot: RobotDescription,
    logs: Sequence[Log],
    seen: Evidence,
    held_out: Sequence[Log],
    good: Evidence | None,
    clean: Sequence[Log],
) -> list[Finding]:
    """Return what is wrong with time, beyond the robot's effects and clean logs."""
    findings = []
    jitter = jitter_of(robot, logs)
    known = max((one.value for one in robot.effects if isinstance(one, SampleJitter)), default=0.0)
    usual = jitter_of(robot, clean) if clean else None
    known = max(known, 0.0 if usual is None else usual.value)
    if jitter is not None and jitter.value > (1 + BORNE_OUT) * known:
        again = jitter_of(robot, held_out) if held_out else jitter
        findings += _in_time(SampleJitter, robot, jitter, 0.0 if again is None else again.value)
    if seen.left is not None:
        skew = skew_of(seen.state.clocks, seen.clock_errors)
        known, unsure = sum(one.value for one in robot.effects if isinstance(one, ClockSkew)), 0.0
        if good is not None and good.left is not None:
            known, unsure, _ = skew_of(good.state.clocks, good.clock_errors)
        value, error = skew.value - known, float(np.hypot(skew.error, unsure))
        beyond = Amount(value, error, (value / error) ** 2)
        if abs(value) >= LEAST_SKEW and beyond.gain >= LEAST_SKEW_GAIN:
            again = evidence_of(without(robot, SampleJitter), held_out, among=()) if held_out else None
            if again is None or again.left is None:
                shown = value
            else:
                shown = skew_of(again.state.clocks, again.clock_errors).value - known
            findings += _in_time(ClockSkew, robot, beyond, shown)
    return findings


def _in_time(kind: type[Effect], robot: RobotDescription, amount: Amount, again: float) -> list[Finding]:
    """Return the finding of an effect on time; again: its size in held-out logs."""
    findings = []
    for variant in kind.variants(robot):
        candidate = Candidate(described(variant), (variant,))
        rank = Rank(candidate, amount.gain, amount.gain, 0.0, (amount.value,), (amount.error,))
        finding = Finding(
            "named", candidate.what, (rank,), (), dataclasses.replace(variant, value=amount.value), amount.error
        )
        if abs(again - amount.value) > BORNE_OUT * abs(amount.value):
            reason = f"the held-out logs do not bear out {candidate.what}"
            finding = dataclasses.replace(finding, verdict="unconfirmed", reason=reason)
        findings.append(finding)
    return findings


def _one_after_another(
    robot: RobotDescription, look: Look, again: Look | None, first: Evidence, least: float
) -> tuple[list[_Found], Evidence]:
    """Return the effects that take something away, refitted together, and the evidence of what is left."""
    found: list[_Found] = []
    left, first_gain = first, 0.0
    tried_before: list[set[str]] = []
    vanished: list[Candidate] = []
    while len(found) < MOST:
        best = _pick(left, vanished)
        if best is None or best.gain < max(least, NEXT * first_gain):
            break
        if any(best.candidate == one.candidate for one in found):  # which cannot be as large as the logs want
            break
        first_gain = max(first_gain, best.gain)
        near = _near(left, best, [one.effect for one in found], again)
        chosen = _chosen(left, [one for one in near if one.candidate not in vanished])
        if not chosen:
            break
        more = [one for rank in chosen for one in _as_found(robot, rank)]
        tried = _settled(robot, look, [*found, *more]) if more else None
        if tried is None:
            break
        if _wanting(*tried) > BESIDE * best.gain:
            more, tried = _or_another(robot, look, found, left, more, tried)
        kept = [one.candidate for one in tried[0]]
        gone = [one.candidate for one in more if one.candidate not in kept]
        vanished += gone
        if len(gone) == len(more):
            continue
        more = _exchanged(robot, look, *tried)
        families = {one.candidate.family for one in more[0]}
        if not families or families in tried_before:
            break
        tried_before.append(families)
        found, left = more
    return found, left


def _wanting(found: list[_Found], left: Evidence) -> float:
    """Return what more of the effects found would take away: 0 if they explain what they stand for."""
    best = _pick(left)
    return best.gain if best is not None and any(best.candidate == one.candidate for one in found) else 0.0


def _or_another(
    robot: RobotDescription,
    look: Look,
    found: list[_Found],
    left: Evidence,
    more: list[_Found],
    tried: tuple[list[_Found], Evidence],
) -> tuple[list[_Found], tuple[list[_Found], Evidence]]:
    """Return the effects to take in, and all refitted with what is left: those tried, or a rival that leaves less.

    Where an effect is large, contacts creep much otherwise than predicted until it is in the model; the best candidate
    by then may be a rival of the right one.
    """
    ranks = [one for one in _ranks(left) if one.candidate.kinds and not _creeps(one)]
    families = {one.candidate.family for one in more}
    rivals = [one for one in ranks if one.gain > ranks[0].gain / 2 and one.candidate.family not in families][:RIVALS]
    options = [(more, tried)]
    for rival in rivals:
        other = _as_found(robot, rival)
        settled = _settled(robot, look, [*found, *other]) if other else None
        if settled is not None and len(settled[0]) > len(found):
            options.append((other, settled))
    return min(options, key=lambda one: max((rank.gain for rank in _ranks(one[1][1])), default=0.0))


def _near(left: Evidence, best: Rank, effects: list[Effect], again: Look | None) -> tuple[Rank, ...]:
    """Return the candidates that cannot be told from the best one, it first; by held-out logs too, if it has no name
    and others nearly as good have."""
    near = _alike(left, best)
    if again is None or best.candidate.kinds or not any(one.candidate.kinds for one in _alike(left, best, WIDER)):
        return near
    seen = again(effects)
    told = sorted((_beside(seen, one) for one in _alike(left, best, WIDER)), key=lambda one: -one.gain)
    return tuple(one for one in told if one.gain >= told[0].gain - MARGIN - PART * told[0].gain)


def _chosen(left: Evidence, near: Sequence[Rank]) -> list[Rank]:
    """Return the effect to take in, or two where two with an amplitude each do better than any one with two, or than
    what has no name; none if there is none."""
    best, named = near[0], next((one for one in near if one.candidate.kinds), None)
    if named is not None and named.candidate.columns == 1:
        return [named]
    gain, pair = _best_pair(left)
    if named is None:
        return list(pair) if gain - EACH_MORE > best.gain + MARGIN + PART * best.gain else []
    return list(pair) if gain - EACH_MORE > named.gain - MARGIN - PART * named.gain else [named]


def _best_pair(left: Evidence) -> tuple[float, tuple[Rank, ...]]:
    """Return what two effects with an amplitude each gain together at best, and these; 0 and none if there are none."""
    single = [one for one in _ranks(left) if one.candidate.kinds and one.candidate.columns == 1 and not _creeps(one)]
    pairs = []
    for pair in itertools.combinations(single[:SINGLES], 2):
        places = [(left.index(one.candidate), one.part) for one in pair]
        pairs.append((left.best([(k, part) for k, part in places if k is not None])[2], pair))
    return max(pairs, key=lambda one: one[0], default=(0.0, ()))


def _settled(robot: RobotDescription, look: Look, found: list[_Found]) -> tuple[list[_Found], Evidence] | None:
    """Return effects with the amplitudes at which the logs pull them no more, and what is left; None: impossible."""
    own = [one.candidate for one in found]
    for k in range(REFITS + 1 if found else 0):
        left = look([one.effect for one in found], own)
        places = [left.index(one) for one in own]
        if None in places:
            return None
        changes, covariance, _ = left.best([(place, 0.0) for place in places if place is not None])
        errors = np.sqrt(np.diag(covariance))
        ends = np.cumsum([one.columns for one in own])[:-1]
        parts = list(zip(found, np.split(changes, ends), np.split(errors, ends), strict=True))
        found = [dataclasses.replace(one, error=float(error.max())) for one, _, error in parts]
        if np.all(np.abs(changes) < 0.1 * errors) or k == REFITS:
            break
        moved = [_moved(robot, new, by) for new, (_, by, _) in zip(found, parts, strict=True)]
        if None in moved:
            return _settled(robot, look, [one for one, new in zip(found, moved, strict=True) if new is not None])
        found = [one for one in moved if one is not None]
    return found, look([one.effect for one in found])


def _moved(robot: RobotDescription, one: _Found, by: Array) -> _Found | None:
    """Return an effect with its amplitudes changed; as it is at the end of what can be; None if it would vanish."""
    before = one.candidate.amplitudes(one.effect)
    try:
        return dataclasses.replace(one, effect=_within(robot, one.candidate, before + by))
    except InputError:
        return one if before @ by > 0 else None


def _exchanged(
    robot: RobotDescription, look: Look, found: list[_Found], left: Evidence
) -> tuple[list[_Found], Evidence]:
    """Return effects each of which is the best one beside the others."""
    for _ in range(EXCHANGES):
        for k in range(len(found)) if len(found) > 1 else ():
            others = found[:k] + found[k + 1 :]
            apart = look([one.effect for one in others])
            best = _pick(apart)
            if best is None:
                settled = _settled(robot, look, others)
                return (found, left) if settled is None else settled
            named = next((one for one in _alike(apart, best) if one.candidate.kinds), None)
            if named is not None and named.candidate.family != found[k].candidate.family:
                own = apart.index(found[k].candidate)
                if own is not None and named.gain - _rank(apart, own).gain < MARGIN + PART * named.gain:
                    continue
                twice = any(named.candidate == one.candidate for one in others)
                settled = _settled(robot, look, others if twice else [*others, *_as_found(robot, named)])
                if settled is not None:
                    found, left = settled
                    break
        else:
            break
    return found, left


def _decided(
    robot: RobotDescription, look: Look, again: Look, found: list[_Found], left: Evidence
) -> tuple[list[_Found], Evidence]:
    """Return the effects, each exchanged for a rival if it foretells the held-out logs better."""
    for k in range(len(found)):
        near = _foretold(look, again, found, k)
        best = max(near, key=lambda one: one.gain)
        if best.candidate.kinds and all(best.candidate.family != one.candidate.family for one in found):
            if best.gain - max(one.gain for one in near if one.candidate == found[k].candidate) < MARGIN:
                continue
            settled = _settled(robot, look, [*found[:k], *_as_found(robot, best), *found[k + 1 :]])
            if settled is not None:
                found, left = settled
    return found, left


def _foretold(look: Look, again: Look | None, found: list[_Found], k: int) -> list[Rank]:
    """Return effect k beside the others, first, and its rivals, with what they take away from the logs and, as large
    as these ask for, from the held-out ones."""
    others = [one.effect for one in found[:k] + found[k + 1 :]]
    apart = look(others)
    place = apart.index(found[k].candidate)
    own = [] if place is None else [_rank(apart, place)]
    best = max([*own, _pick(apart) or _ranks(apart)[0]], key=lambda one: one.gain)
    near = own + [one for one in _alike(apart, best, WIDER) if one.candidate != found[k].candidate]
    if again is None or len({one.candidate.family for one in near}) < 2:
        return near
    named = [one.candidate for one in near] if all(one.candidate.kinds for one in near) else None
    held = again(others, named)
    return [_beside(held, one) for one in near]


def _beside(held: Evidence, one: Rank) -> Rank:
    """Return a candidate with what it takes away from held-out logs besides, as large as the logs ask for."""
    return dataclasses.replace(one, gain=one.gain + held.foretold(one.candidate, one.part, one.amplitudes))


def _judged(look: Look, again: Look | None, found: list[_Found], k: int) -> Finding:
    """Return what is to be said of effect k beside the others."""
    own = found[k]
    near = _foretold(look, again, found, k)
    limit = max(one.gain for one in near)
    limit -= MARGIN + PART * limit
    chosen = tuple(
        one for n, one in enumerate(near) if one.gain >= limit or (n == 0 and one.candidate == own.candidate)
    )
    ranks = _ranks(look([one.effect for one in found[:k] + found[k + 1 :]]))
    among = {one.candidate for one in chosen}
    beaten = tuple(one for one in ranks if one.candidate not in among)
    finding = Finding("named", own.candidate.what, chosen, beaten, own.effect, own.error)
    if len(finding.families) > 1:
        reason = f"these motions do not tell apart: {'; '.join(finding.families)}"
        return dataclasses.replace(finding, verdict="ambiguous", reason=reason)
    return finding


def _nameless(left: Evidence, best: Rank) -> Finding:
    """Return the finding of what is left and no effect explains."""
    ranks = _ranks(left)
    chosen = _alike(left, best)
    beaten = tuple(one for one in ranks if one not in chosen)
    kinds = best.candidate.kinds
    reason = f"no effect of the catalogue looks like it; it is: {best.candidate.what}"
    if kinds:
        reason = f"{best.candidate.what} of {best.size:.3g} {kinds[0].unit} looks most like it, and does not explain it"
    return Finding("unexplained", reason, chosen, beaten)


def _louder(seen: Evidence, good: Evidence) -> Finding | None:
    """Return the finding that logs are noisier than clean ones, though nothing looks like it; None if they are not."""
    told = {
        "along": ("slip along", 1e3, "mm after 1 m"),
        "across": ("slip to the side", 1e3, "mm after 1 m"),
        "position": ("noise of the reference's position", 1e3, "mm"),
        "heading": ("noise of the reference's heading", 1e3, "mrad"),
    }
    ratios = {}
    for name in told:
        size, usual = getattr(seen.noise, name), max(getattr(good.noise, name), RIGID)
        if (size / usual) > LOUDER and (seen.left is not None or name in ("along", "across")):
            ratios[name] = size / usual
    if not ratios:
        return None
    name = max(ratios, key=ratios.__getitem__)
    what, scale, unit = told[name]
    size, usual = scale * getattr(seen.noise, name), scale * getattr(good.noise, name)
    said = f"{what} of {size:.2g} {unit}, {usual:.2g} in the clean logs"
    samples = sum(len(state) for state in seen.state.states)
    gain = float(samples * (ratios[name] ** 2 - 1 - 2 * np.log(ratios[name])))
    rank = Rank(Candidate(said), gain, gain, 0.0, (size / scale,), (size / scale / np.sqrt(samples),))
    return Finding("unexplained", f"no effect of the catalogue looks like it; it is: {said}", (rank,), ())


def _borne_out(again: Look, found: list[_Found], findings: list[Finding]) -> tuple[list[Finding], tuple[Left, Left]]:
    """Return the findings, and what is left of held-out logs.

    What they do not bear out is unconfirmed; if it is but something found beside larger effects, it was nothing.
    """
    own = [one.candidate for one in found]
    nominal, with_all = (again(effects, own) for effects in ([], [one.effect for one in found]))
    judged = []
    for one, finding in zip(found, findings, strict=True):
        shown, change = _wanted(with_all, one)
        reason = None
        if shown < EXERCISED:
            reason = f"the held-out motion does not show {one.candidate.what}"
        elif change > BORNE_OUT:
            if finding.gain < max(other.gain for other in findings) / 2:
                continue
            reason = f"the held-out logs do not bear out {one.candidate.what}"
        if reason is not None and isinstance(one.effect, CREEPING) and len(findings) > 1:
            continue
        if reason is not None and finding.verdict == "named":
            finding = dataclasses.replace(finding, verdict="unconfirmed", reason=reason)
        judged.append(finding)
    return judged, (_left(nominal), _left(with_all))


def _wanted(with_all: Evidence, one: _Found) -> tuple[float, float]:
    """Return the deviance that an effect of this size makes, and by what part of itself the logs would change it."""
    place = with_all.index(one.candidate)
    if place is None:
        return 0.0, 0.0
    amplitudes, columns = one.candidate.amplitudes(one.effect), with_all.columns[place]
    change, _, _ = with_all.best([(place, 0.0)])
    shown = float(amplitudes @ with_all.plain[0][np.ix_(columns, columns)] @ amplitudes)
    return shown, float(np.linalg.norm(change) / np.linalg.norm(amplitudes))


def _as_found(robot: RobotDescription, rank: Rank) -> list[_Found]:
    """Return a candidate as an effect of its size, or of its step if it cannot have this size; none if neither."""
    for amplitudes in (np.array(rank.amplitudes), rank.candidate.amplitudes(rank.candidate.kinds[0])):
        try:
            return [_Found(rank.candidate, _within(robot, rank.candidate, amplitudes), rank.error)]
        except InputError:
            continue
    return []


def _within(robot: RobotDescription, candidate: Candidate, amplitudes: Array) -> Effect:
    """Return the effect; raises InputError if it or the robot cannot have these amplitudes."""
    try:
        effect = candidate.effect(amplitudes)
        robot.with_effects(effect).as_built()
    except ValueError as error:
        raise InputError(str(error)) from None
    return effect


def _rank(seen: Evidence, k: int) -> Rank:
    part = seen.parted(k)
    amplitudes, covariance, gain = seen.best([(k, part)])
    _, _, sober = seen.best([(k, part)], sober=True)
    errors = np.sqrt(np.diag(covariance))
    gain, sober = (one - EACH_MORE * (len(amplitudes) - 1) for one in (gain, sober))
    return Rank(seen.candidates[k], gain, sober, part, tuple(amplitudes.tolist()), tuple(errors.tolist()))


@lru_cache(maxsize=8)
def _ranks(seen: Evidence) -> tuple[Rank, ...]:
    """Return all candidates that can be, the one that takes away most first."""
    ranks = [_rank(seen, k) for k in range(len(seen.candidates))]
    return tuple(sorted((one for one in ranks if _possible(one)), key=lambda one: -one.gain))


def _pick(seen: Evidence, but: Sequence[Candidate] = ()) -> Rank | None:
    """Return the candidate that takes away most of those that take away enough, but for some; None if none does."""
    some = [one for one in _ranks(seen) if one.candidate not in but]
    enough = [one for one in some if one.gain >= _least(one) and one.sober >= LEAST_SOBER]
    plain = [one for one in enough if not (_creeps(one) or one.candidate.at_a_place)]
    if plain and plain[0].gain * (MUCH_CREEP if _creeps(enough[0]) else MUCH_OF_PLACE) > enough[0].gain:
        return plain[0]
    return enough[0] if enough else None


def _least(one: Rank) -> float:
    if one.candidate.at_a_place:
        return LEAST_OF_PLACE
    return LEAST_OF_CREEP if _creeps(one) else LEAST_GAIN


def _creeps(one: Rank) -> bool:
    return bool(one.candidate.kinds) and isinstance(one.candidate.kinds[0], CREEPING)


def _alike(seen: Evidence, best: Rank, wider: float = 1.0) -> tuple[Rank, ...]:
    """Return the candidates that cannot be told from the best one, it first; `wider` for so many times the margin."""
    limit = best.gain - wider * (MARGIN + PART * best.gain)
    return tuple(one for one in _ranks(seen) if limit <= one.gain <= best.gain and (_creeps(best) or not _creeps(one)))


def _possible(one: Rank) -> bool:
    """Whether an effect can have an amplitude within three standard errors, or `ROUGHLY`, of this one."""
    if not one.candidate.kinds or one.candidate.columns > 1:
        return True
    kind, far = one.candidate.kinds[0], max(3 * one.errors[0], ROUGHLY * abs(one.size))
    low, high = one.size - far, one.size + far
    for value in (one.size, low, high, *(end for end in (kind.step, 0.0) if low <= end <= high)):
        try:
            dataclasses.replace(kind, value=value)
        except ValueError:
            continue
        return True
    return False


def _background(clean: Evidence) -> list[tuple[Candidate, float, Array]]:
    """Return the effects, one by one, that take something away from clean logs, with hidden parts and amplitudes."""
    chosen: list[tuple[int, float]] = []
    named = [k for k, candidate in enumerate(clean.candidates) if candidate.kinds]
    for _ in range(BACKGROUND):
        before = clean.best(chosen)[2]
        tried = [(k, clean.parted(k, chosen)) for k in named if k not in dict(chosen)]
        best = max(tried, key=lambda one: clean.best([*chosen, one])[2])
        if clean.best([*chosen, best])[2] - before < LEAST_GAIN:
            break
        chosen.append(best)
    amplitudes = clean.best(chosen)[0]
    sizes = np.split(amplitudes, np.cumsum([len(clean.columns[k]) for k, _ in chosen])[:-1]) if chosen else []
    return [(clean.candidates[k], part, size) for (k, part), size in zip(chosen, sizes, strict=True)]


def _left(seen: Evidence) -> Left:
    position, heading = seen.left or (None, None)
    return Left(position, heading, seen.noise, seen.state)
