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
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np

from castor_envs.effects import Effect
from castor_envs.errors import InputError
from castor_envs.kinematics import Array
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from discrepancy.candidates import Candidate
from discrepancy.evidence import BURST, Evidence, evidence_of
from discrepancy.inspection import BLIND
from discrepancy.parity import parity_residual
from estimators.calibration.log_likelihood import Noise
from estimators.calibration.maximum_likelihood import State

Verdict = Literal["named", "ambiguous", "unconfirmed", "unexplained", "no discrepancy"]
WEAKEST_FIRST: tuple[Verdict, ...] = ("unexplained", "ambiguous", "unconfirmed", "named")

LEAST_GAIN = 30.0
"""The deviance that a candidate must take away; what robots in good order leave stays below (docs/diagnose.md)."""

LEAST_SOBER = 20.0
"""The deviance that it must take away where all wheels may creep."""

MOST = 4
"""Effects are found one after another, at most so many."""

SLIDING, IN_BURSTS = 2e-3, 0.5
"""m after 1 m, and the share of slip in the worst steps (`BURST`): more of both is sliding in some place, no effect of
the robot, and would be taken for many."""

BACKGROUND = 5
"""At most so many effects are taken from clean logs as background."""

MARGIN, PART = 6.0, 0.05
"""Deviance, and part of the gain, by which a candidate may be worse than the best and not be told from it."""

NEXT = 0.025
"""The part of what the first effect takes away that the next ones must."""

BESIDE = 0.15
"""What has no name is told beside effects if it takes away more than this part of what the first one does: amplitudes
that are a little wrong, and creep, leave some."""

EXERCISED = 25.0
"""The deviance that an effect of its size would make on held-out logs for them to bear it out or not."""

BORNE_OUT = 0.5
"""The part of itself by which held-out logs may want an effect changed."""

ROUGHLY = 0.25
"""The part by which amplitudes may be wrong before they are refitted."""

REFITS, EXCHANGES = 4, 2


@dataclass(frozen=True)
class Rank:
    """A candidate on its own, beside what was found before. gain: deviance; sober: where all wheels may creep; part:
    what wheels hide of it; amplitudes (columns,) and their standard errors, in the effect's unit."""

    candidate: Candidate
    gain: float
    sober: float
    part: float
    amplitudes: tuple[float, ...]
    errors: tuple[float, ...]

    @property
    def size(self) -> float:
        """The amplitude; of an effect of any phase how large it is."""
        return self.amplitudes[0] if len(self.amplitudes) == 1 else float(np.linalg.norm(self.amplitudes))

    @property
    def error(self) -> float:
        """The standard error of the size, roughly."""
        return max(self.errors)


@dataclass(frozen=True, eq=False)
class Left:
    """What a robot's description leaves of logs: how far odometry is off the reference (rms, m, rad; None without one),
    noise, and state: what truly happened, most likely, with clocks and mount of the reference."""

    position: float | None
    heading: float | None
    noise: Noise
    state: State


@dataclass(frozen=True)
class Finding:
    """One thing that was found. verdict: of it alone, with a reason.

    effect: the best one of the catalogue with its amplitude refitted, error: its standard error; None where no effect
    explains it. chosen: the candidates that cannot be told apart; beaten: others, the best first. families: the names
    of those chosen.
    """

    verdict: Verdict
    reason: str
    chosen: tuple[Rank, ...]
    beaten: tuple[Rank, ...]
    effect: Effect | None = None
    error: float | None = None

    @property
    def gain(self) -> float:
        """The deviance that it takes away."""
        return self.chosen[0].gain

    @property
    def families(self) -> tuple[str, ...]:
        """The names, each with its place, that cannot be told apart; the most likely first."""
        return tuple(dict.fromkeys(one.candidate.family for one in self.chosen if one.candidate.kinds))


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found. verdict: the weakest of all effects', "unexplained" only where there are none.

    ranks: all candidates beside nothing, the best first.
    before, after: what is left of the logs without and with the effects that were found, and of held-out logs if there
    are such.
    """

    robot: RobotDescription
    verdict: Verdict
    reason: str
    findings: tuple[Finding, ...]
    ranks: tuple[Rank, ...]
    before: Left
    after: Left | None = None
    held_out: tuple[Left, Left] | None = None

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that are named."""
        return tuple(one.effect for one in self.findings if one.verdict == "named" and one.effect is not None)

    @property
    def found(self) -> RobotDescription | None:
        """The robot with the effects that are named; None if there are none."""
        return self.robot.with_effects(*self.effects) if self.effects else None


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
    background = _background(evidence_of(robot, clean)) if clean else []

    first = last = evidence_of(robot, logs).less(background)

    def look(effects: Sequence[Effect], among: Sequence[Candidate] | None = None) -> Evidence:
        nonlocal last
        if not effects:
            return first
        last = evidence_of(robot.with_effects(*effects), logs, start=last, among=among).less(background)
        return last

    ranks = _ranks(first)
    result = Diagnosis(
        robot=robot,
        verdict="no discrepancy",
        reason="no candidate takes away more than robots without any effect leave",
        findings=(),
        ranks=ranks,
        before=_left(first),
    )
    if first.noise.along > SLIDING and first.burst.share > IN_BURSTS:
        burst = first.burst
        reason = (
            f"wheels slide in bursts, {100 * burst.share:.0f} % of all slip in {100 * BURST:.0f} % of the time; most "
            f"at {burst.t:.1f} s of log {burst.log + 1}, near x {burst.x:.2f}, y {burst.y:.2f} m: look at the floor"
        )
        return dataclasses.replace(result, verdict="unexplained", reason=reason)
    found, left = _one_after_another(robot, look, first)
    findings = [_judged(look, found, k) for k in range(len(found))]
    if held_out and found:
        findings, gaps = _borne_out(robot, held_out, found, findings)
        result = dataclasses.replace(result, held_out=gaps)
    if (rest := _pick(left)) is not None and (not found or rest.gain > BESIDE * findings[0].gain):
        findings.append(_nameless(left, rest))
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


def _one_after_another(robot: RobotDescription, look: Look, first: Evidence) -> tuple[list[_Found], Evidence]:
    """Return the effects that take something away, refitted together, and the evidence of what is left."""
    found: list[_Found] = []
    left, first_gain = first, 0.0
    while len(found) < MOST:
        best = _pick(left)
        if best is None or best.gain < NEXT * first_gain:
            break
        first_gain = max(first_gain, best.gain)
        named = next((one for one in _alike(left, best) if one.candidate.kinds), None)
        if named is None:
            break
        tried = _settled(robot, look, [*found, *_as_found(robot, named)])
        if tried is None or len(tried[0]) == len(found):
            break
        more = _exchanged(robot, look, *tried)
        if len(more[0]) <= len(found):
            break
        found, left = more
    return found, left


def _settled(robot: RobotDescription, look: Look, found: list[_Found]) -> tuple[list[_Found], Evidence] | None:
    """Return effects with the amplitudes at which the logs pull them no more, and what is left; None: impossible."""
    own = [one.candidate for one in found]
    for k in range(REFITS + 1):
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
        try:
            found = [
                dataclasses.replace(
                    new, effect=_within(robot, one.candidate, one.candidate.amplitudes(one.effect) + by)
                )
                for new, (one, by, _) in zip(found, parts, strict=True)
            ]
        except InputError:  # at the end of what can be
            break
    return found, look([one.effect for one in found])


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
                settled = _settled(robot, look, [*others, *_as_found(robot, named)])
                if settled is not None:
                    found, left = settled
                    break
        else:
            break
    return found, left


def _judged(look: Look, found: list[_Found], k: int) -> Finding:
    """Return what is to be said of effect k beside the others."""
    own = found[k]
    apart = look([one.effect for one in found[:k] + found[k + 1 :]])
    ranks = _ranks(apart)
    place = apart.index(own.candidate)
    best = ranks[0] if place is None else max(ranks[0], _rank(apart, place), key=lambda one: one.gain)
    chosen = _alike(apart, best)
    if all(one.candidate != own.candidate for one in chosen) and place is not None:
        chosen = (_rank(apart, place), *chosen)
    beaten = tuple(one for one in ranks if one not in chosen)
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
        reason = f"{best.candidate.what} would have to be {best.size:.3g} {kinds[0].unit}, which cannot be"
    return Finding("unexplained", reason, chosen, beaten)


def _borne_out(
    robot: RobotDescription, held_out: Sequence[Log], found: list[_Found], findings: list[Finding]
) -> tuple[list[Finding], tuple[Left, Left]]:
    """Return the findings, and what is left of held-out logs.

    What they do not bear out is unconfirmed; if it is but something found beside larger effects, it was nothing.
    """
    own = [one.candidate for one in found]
    nominal, with_all = (evidence_of(one, held_out, among=own) for one in (robot, _with(robot, found)))
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


def _with(robot: RobotDescription, found: Sequence[_Found]) -> RobotDescription:
    return robot.with_effects(*(one.effect for one in found))


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
    return Rank(seen.candidates[k], gain, sober, part, tuple(amplitudes.tolist()), tuple(errors.tolist()))


@lru_cache(maxsize=8)
def _ranks(seen: Evidence) -> tuple[Rank, ...]:
    """Return all candidates that can be, the one that takes away most first."""
    ranks = [_rank(seen, k) for k in range(len(seen.candidates))]
    return tuple(sorted((one for one in ranks if _possible(one)), key=lambda one: -one.gain))


def _pick(seen: Evidence) -> Rank | None:
    """Return the candidate that takes away most of those that take away enough; None if none does."""
    return next((one for one in _ranks(seen) if one.gain >= LEAST_GAIN and one.sober >= LEAST_SOBER), None)


def _alike(seen: Evidence, best: Rank) -> tuple[Rank, ...]:
    """Return the candidates that cannot be told from the best one, it first."""
    limit = best.gain - MARGIN - PART * best.gain
    return tuple(one for one in _ranks(seen) if limit <= one.gain <= best.gain)


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
