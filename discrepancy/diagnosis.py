"""Names the effect that a robot's description is missing, or says why it cannot.

1. Everything that is no property of the robot is fitted first: what truly happened, slip, noise and clock of the
   reference, the tracked point (`evidence_of`).
2. Every effect of the catalogue competes with rivals that have no name. The gain is the deviance that a candidate takes
   away; candidates hardly worse than the best one cannot be told from it.
3. A name must be borne out by logs that it was not fitted to, where there are such.
4. The amplitude is refitted with the effect in the model.

Thresholds are above what simulated robots without any effect leave: their wheels creep, and rounding is not quite as
random as it is taken to be.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

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

Verdict = Literal["named", "ambiguous", "unconfirmed", "unexplained", "no discrepancy"]

LEAST_GAIN, LEAST_GAIN_OF_MANY = 30.0, 100.0
"""The deviance that a candidate must take away: five standard errors squared, and ten on robots with more driven wheels
than motions: creep, by which these come to terms with each other, looks like an effect of up to eight."""

SLIDING, IN_BURSTS = 2e-3, 0.5
"""m after 1 m, and the share of slip in the worst steps (`BURST`): more of both is sliding in some place, no effect of
the robot, and would be taken for many."""

MOTIONS = 3
"""Of a body in the plane."""

BACKGROUND = 5
"""At most so many effects are taken from clean logs as background."""

MARGIN, PART = 6.0, 0.05
"""Deviance, and part of the gain, by which a candidate may be worse than the best and not be told from it."""

EXERCISED = 25.0
"""The deviance that an effect of its size would make on held-out logs for them to bear it out or not."""

REFITS = 4


@dataclass(frozen=True)
class Rank:
    """A candidate on its own. gain: deviance; amplitude and its standard error in the effect's unit."""

    candidate: Candidate
    gain: float
    amplitude: float
    error: float


@dataclass(frozen=True)
class Gap:
    """How far odometry is off the reference (rms, m, rad; None without one), and the slip that explains the rest, m."""

    position: float | None
    heading: float | None
    along: float
    across: float


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found. ranks: all candidates, the best first. chosen: those that cannot be told from the best.

    effect: what is named, with its amplitude refitted (error: its standard error); None where nothing is. before,
    after: the gap on the logs and, if there are such, on held-out ones. mount, clocks: of the reference, as in
    `maximum_likelihood.Calibration`.
    """

    robot: RobotDescription
    verdict: Verdict
    reason: str
    ranks: tuple[Rank, ...]
    chosen: tuple[Rank, ...]
    mount: Array
    clocks: Array
    before: Gap
    effect: Effect | None = None
    error: float | None = None
    after: Gap | None = None
    held_out: tuple[Gap, Gap] | None = None
    families: tuple[str, ...] = field(default=())

    @property
    def found(self) -> RobotDescription | None:
        """The robot with the effect that is named."""
        return None if self.effect is None else self.robot.with_effects(self.effect)


def diagnose(
    robot: RobotDescription, logs: Sequence[Log], held_out: Sequence[Log] = (), clean: Sequence[Log] = ()
) -> Diagnosis:
    """Return what logs say is missing in a robot's description, one effect at a time.

    held_out: logs that a name must be borne out by. clean: logs of the robot before it had the effect; only what goes
    beyond them is named. Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    for some in (logs, held_out, clean):
        blind = [log for log in some if log.reference is None or not np.isfinite(log.reference).any()]
        if blind and parity_residual(robot, blind[0]).redundancy == 0:
            raise InputError(f"{BLIND}; give logs with ref_x, ref_y and ref_psi")
    seen = evidence_of(robot, logs)
    least = LEAST_GAIN_OF_MANY if len(robot.driven_wheels) > MOTIONS else LEAST_GAIN
    if clean:
        seen = _beyond(seen, evidence_of(robot, clean), least)
    ranks = sorted(_ranks(seen), key=lambda one: -one.gain)
    result = Diagnosis(
        robot=robot,
        verdict="no discrepancy",
        reason="no candidate takes away more than robots without any effect leave",
        ranks=tuple(ranks),
        chosen=(),
        mount=seen.state.mount,
        clocks=seen.state.clocks,
        before=_gap(seen),
    )
    if seen.noise.along > SLIDING and seen.burst.share > IN_BURSTS:
        burst = seen.burst
        reason = (
            f"wheels slide in bursts, {100 * burst.share:.0f} % of all slip in {100 * BURST:.0f} % of the time; most "
            f"at {burst.t:.1f} s of log {burst.log + 1}, near x {burst.x:.2f}, y {burst.y:.2f} m: look at the floor"
        )
        return dataclasses.replace(result, verdict="unexplained", reason=reason)
    best = ranks[0]
    if best.gain < least:
        return result
    limit = best.gain - MARGIN - PART * best.gain
    chosen = tuple(one for one in ranks if one.gain >= limit)
    named = [one for one in chosen if one.candidate.effect is not None]
    families = tuple(dict.fromkeys(one.candidate.family for one in named))
    result = dataclasses.replace(result, chosen=chosen, families=families)
    if not named:
        return dataclasses.replace(
            result,
            verdict="unexplained",
            reason=f"no effect of the catalogue looks like it; it is: {best.candidate.what}",
        )
    if len(families) > 1:
        return dataclasses.replace(
            result, verdict="ambiguous", reason=f"these motions do not tell apart: {'; '.join(families)}"
        )
    return _confirmed(result, named[0], logs, held_out)


def _confirmed(result: Diagnosis, best: Rank, logs: Sequence[Log], held_out: Sequence[Log]) -> Diagnosis:
    """Return the diagnosis with the best candidate refitted and, where there are held-out logs, borne out or not."""
    robot, kind = result.robot, best.candidate.effect
    assert kind is not None
    try:
        effect, error, after = _refitted(robot, logs, kind, best.amplitude)
    except InputError:
        reason = f"{best.candidate.what} would have to be {best.amplitude:.3g} {kind.unit}, which cannot be"
        return dataclasses.replace(result, verdict="unexplained", reason=reason)
    result = dataclasses.replace(result, after=_gap(after), error=error)
    if held_out:
        apart, with_it = evidence_of(robot, held_out), evidence_of(robot.with_effects(effect), held_out)
        there = _index(apart, best.candidate)
        pull, strength = (0.0, 0.0) if there is None else (apart.pull[there], apart.information[there, there])
        gain, most = 2 * effect.value * pull - effect.value**2 * strength, effect.value**2 * strength
        result = dataclasses.replace(result, held_out=(_gap(apart), _gap(with_it)))
        if most < EXERCISED:
            return dataclasses.replace(
                result, verdict="unconfirmed", reason=f"the held-out motion does not show {best.candidate.what}"
            )
        if gain < most / 2:
            return dataclasses.replace(
                result, verdict="unconfirmed", reason=f"{best.candidate.what} does not help on the held-out logs"
            )
    return dataclasses.replace(result, verdict="named", reason=best.candidate.what, effect=effect)


def _refitted(
    robot: RobotDescription, logs: Sequence[Log], kind: Effect, value: float
) -> tuple[Effect, float, Evidence]:
    """Return an effect with the amplitude at which the logs pull it no more, its standard error, and what is left."""
    effect = dataclasses.replace(kind, value=_within(robot, kind, value))
    for k in range(REFITS + 1):
        left = evidence_of(robot.with_effects(effect), logs)
        there = _index(left, Candidate("", kind))
        assert there is not None
        (change,), ((variance,),) = left.best([there])
        error = float(np.sqrt(variance))
        if abs(change) < 0.1 * error or k == REFITS:
            return effect, error, left
        try:
            effect = dataclasses.replace(kind, value=_within(robot, kind, effect.value + float(change)))
        except InputError:  # at the end of what can be
            return effect, error, left
    raise AssertionError


def _within(robot: RobotDescription, kind: Effect, value: float) -> float:
    """Return the amplitude; raises InputError if the effect or the robot cannot have it."""
    try:
        robot.with_effects(dataclasses.replace(kind, value=value)).as_built()
    except ValueError as error:
        raise InputError(str(error)) from None
    return value


def _index(seen: Evidence, candidate: Candidate) -> int | None:
    """Return the place of a candidate's effect; None where the motion leaves it without any trace."""
    return next((k for k, one in enumerate(seen.candidates) if one.effect == candidate.effect), None)


def _ranks(seen: Evidence) -> list[Rank]:
    ranks = []
    for k, candidate in enumerate(seen.candidates):
        strength = seen.information[k, k]
        if strength > 0:
            amplitude = float(seen.pull[k] / strength)
            if not _possible(candidate, amplitude, float(strength**-0.5)):
                continue
            ranks.append(Rank(candidate, float(seen.pull[k] ** 2 / strength), amplitude, float(strength**-0.5)))
    return ranks


def _possible(candidate: Candidate, amplitude: float, error: float) -> bool:
    """Whether an effect can have an amplitude within three standard errors of this one."""
    if candidate.effect is None:
        return True
    for value in (amplitude, amplitude - 3 * error, amplitude + 3 * error):
        try:
            dataclasses.replace(candidate.effect, value=value)
        except ValueError:
            continue
        return True
    return False


def _beyond(seen: Evidence, clean: Evidence, least: float) -> Evidence:
    """Return the evidence less what clean logs show: the effects, one by one, that take something away there too."""
    chosen: list[int] = []
    named = [k for k, candidate in enumerate(clean.candidates) if candidate.effect is not None]
    for _ in range(BACKGROUND):
        gains = {k: clean.gain([*chosen, k]) - clean.gain(chosen) for k in named if k not in chosen}
        best = max(gains, key=gains.__getitem__)
        if gains[best] < least:
            break
        chosen.append(best)
    pull = seen.pull.copy()
    amplitudes = clean.best(chosen)[0] if chosen else []
    for k, amplitude in zip(chosen, amplitudes, strict=True):
        there = _index(seen, clean.candidates[k])
        if there is not None:
            pull -= seen.information[:, there] * amplitude
    return dataclasses.replace(seen, pull=pull)


def _gap(seen: Evidence) -> Gap:
    position, heading = seen.left or (None, None)
    return Gap(position, heading, seen.noise.along, seen.noise.across)
