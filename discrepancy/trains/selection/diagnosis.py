"""Names the effects that a train's description is missing, one after another, or says why it cannot.

1. What truly happened is fitted first, with slip, noise, offsets of gauges, and clock and tracked points of the
   reference, if there is one (`settled`).
2. Every effect of the catalogue competes with rivals that have no name (`evidence_of`). Those that promise most are put
   into the model, amplitude and all, and everything is fitted anew: the gain is the deviance that this takes away.
   Candidates hardly worse than the best one cannot be told from it.
3. What is found stays in the model, its amplitudes refitted together; then the next is looked for.
4. A name must be borne out by logs that it was not fitted to, where there are such.
"""

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter
from threadpoolctl import threadpool_limits

from castor_envs.effects.train import AxleSlip, DeadGauge, GaugeGain, GaugeNoise, SensorStops
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trains.candidates import Candidate, Placed, dead_gauges
from discrepancy.trains.evidence import Evidence, Settled, evidence_of, settled
from discrepancy.trains.gap import Gap, gap_of
from discrepancy.trains.linearise import equations_of
from discrepancy.trains.rows import TrainLog

Verdict = Literal["named", "ambiguous", "unconfirmed", "unexplained", "no discrepancy"]
WEAKEST_FIRST: tuple[Verdict, ...] = ("unexplained", "ambiguous", "unconfirmed", "named")

LEAST_GAIN = 30.0
"""The deviance that a candidate must take away: simulated trains without any effect leave at most about 20."""

MOST = 4
"""Effects are found one after another, at most so many."""

PROMISING, SHORTLIST, RIVALS = 0.35, 5, 1
"""Part of the best gain that a candidate must promise to be tried, and how many effects and rivals are tried."""

MARGIN, PART = 6.0, 0.05
"""Deviance, and part of the gain, by which a candidate may be worse than the best and not be told from it."""

NEXT = 0.02
"""Part of the first effect's gain that the next one must promise."""

EXERCISED = 25.0
"""The deviance that an effect of its size would make on held-out logs for them to bear it out or not."""

TRIES, REFITS = 1, 4
"""Rounds in which an amplitude is found, while candidates are compared and in the end."""

NOISIER = 1.15
"""Times the noise that a description gives to gauges, from which on it is thought to be larger."""

DIFFERENCES = 2 / 3
"""Of a reading's worth is what a difference of successive ones tells of their noise."""

STOPPED = 5
"""Samples for which a sensor must repeat itself to the end of a log to have stopped."""


@dataclass(frozen=True)
class Rank:
    """A candidate on its own. gain: deviance; amplitude and its standard error in the candidate's unit."""

    candidate: Candidate
    gain: float
    amplitude: float
    error: float


@dataclass(frozen=True)
class Finding:
    """One thing that was found. verdict: of it alone, with a reason.

    placed: the best effect, its amplitude refitted, with its standard error; None where no effect explains it. gain:
    the deviance that it takes away. families: names that cannot be told apart, the best first. beaten: names that were
    tried and were worse, with by how much, deviance.
    """

    verdict: Verdict
    reason: str
    gain: float
    placed: Placed | None = None
    error: float | None = None
    families: tuple[str, ...] = ()
    beaten: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class TrainDiagnosis:
    """What was found. verdict: the weakest of all findings'. ranks: all candidates beside nothing, the best first.

    before, after: the gap on the logs; held_out: before and after, on held-out logs. clocks: by how much the reference
    of each log is ahead of its counts, s; None without one. slip: of wheels and of axles to their sides, after 1 m, m.
    sliding: part of the time in which an axle may have slid, pushed and pulled by its frames; that counts for little.
    """

    train: TrainDescription
    verdict: Verdict
    reason: str
    findings: tuple[Finding, ...]
    ranks: tuple[Rank, ...]
    before: Gap
    after: Gap | None
    held_out: tuple[Gap, Gap] | None
    clocks: tuple[float | None, ...]
    slip: tuple[float, float]
    sliding: float

    @property
    def robot(self) -> TrainDescription:
        """The train, under the name that a report of any vehicle asks for."""
        return self.train

    @property
    def families(self) -> tuple[str, ...]:
        """The names that cannot be told apart, of all findings that are ambiguous."""
        return tuple(name for one in self.findings if one.verdict == "ambiguous" for name in one.families)

    @property
    def effects(self) -> tuple[Placed, ...]:
        """The effects that are named."""
        return tuple(one.placed for one in self.findings if one.verdict == "named" and one.placed is not None)

    @property
    def found(self) -> TrainDescription | None:
        """The train with the effects that are named; None if there are none."""
        return _with(self.train, self.effects) if self.effects else None


@dataclass(frozen=True)
class _Found:
    """An effect on its way, and all that it was weighed against."""

    placed: Placed
    error: float
    gain: float
    families: tuple[str, ...]
    beaten: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class _Try:
    """A candidate in the model, all else fitted anew."""

    candidate: Candidate
    gain: float
    placed: Placed | None
    error: float
    state: Settled


@threadpool_limits.wrap(limits=1)
def diagnose_train(
    train: TrainDescription, logs: Sequence[Log], held_out: Sequence[Log] = (), clean: Sequence[Log] = ()
) -> TrainDiagnosis:
    """Return what logs say is missing in a train's description.

    held_out: logs that a name must be borne out by. clean: logs of the train before it had the effect; only what goes
    beyond them is named. Raises InputError for logs that are not of this train, or that show nothing.
    """
    if not logs:
        raise InputError("there is no log to look at")
    background: list[Placed] = []
    least = LEAST_GAIN
    if clean:
        there, settling = equations_of(train, clean)
        background = [one.placed for one in _noise(train, there, settling) if one.placed is not None]
        found, rest, _ = _one_after_another(_with(train, background), there, LEAST_GAIN)
        background += _placed(found)
        least = max(least, 2 * max((one.gain for one in _ranks(rest)), default=0.0))
    base = _with(train, background)
    own, state = equations_of(base, logs)
    first = evidence_of(base, own, state)
    beside = [*_stops(base, logs), *_noise(base, own, state)]
    noisier = _with(base, [one.placed for one in beside if one.placed is not None])
    anew = evidence_of(noisier, own, settled(noisier, own)) if noisier is not base else first
    found, left, unnamed = _one_after_another(noisier, own, least, anew)
    findings = [*beside, *(_judged(base, one) for one in found)]
    held = None
    kept = _with(noisier, _placed(found))
    if held_out and findings:
        findings, held = _borne_out(base, held_out, findings)
    if unnamed is not None:
        reason = f"no effect of the catalogue explains it; it looks like: {unnamed.candidate.what}"
        findings.append(Finding("unexplained", reason, unnamed.gain))
    verdict: Verdict = "no discrepancy"
    reason = "no candidate improves the fit by more than chance does on trains without any effect"
    if findings:
        verdict = next(one for one in WEAKEST_FIRST if any(own.verdict == one for own in findings))
        reason = "; ".join(one.reason for one in findings)
    return TrainDiagnosis(
        train=train,
        verdict=verdict,
        reason=reason,
        findings=tuple(findings),
        ranks=tuple(_ranks(first)),
        before=gap_of(base, own, state),
        after=gap_of(kept, own, left.settled) if findings else None,
        held_out=held,
        clocks=tuple(m.clock if len(log.at) else None for m, log in zip(left.settled.motions, own, strict=True)),
        slip=(left.settled.sizes.rolling, left.settled.sizes.side),
        sliding=float(np.mean(np.concatenate([log.loose.any(axis=1) for log in own]))),
    )


def _with(train: TrainDescription, effects: Sequence[Placed]) -> TrainDescription:
    for effect in effects:
        train = effect.added(train)
    return train


def _placed(found: Sequence[_Found]) -> list[Placed]:
    return [one.placed for one in found]


def _one_after_another(
    train: TrainDescription, logs: Sequence[TrainLog], least: float, first: Evidence | None = None
) -> tuple[list[_Found], Evidence, Rank | None]:
    """Return the effects that take something away, what is left, and the best of the rest if that has no name."""
    found: list[_Found] = []
    left = evidence_of(train, logs, settled(train, logs)) if first is None else first
    for _ in range(MOST):
        ranks = _ranks(left)
        if not ranks or ranks[0].gain < least or (found and ranks[0].gain < NEXT * found[0].gain):
            break
        tries = _tried(_with(train, _placed(found)), logs, left, ranks)
        if not tries:
            return found, left, ranks[0]
        best = tries[0]
        chosen = [one for one in tries if one.gain >= best.gain - MARGIN - PART * best.gain]
        named = [one for one in chosen if one.placed is not None]
        if not named or best.gain < least:
            return found, left, ranks[0] if not named else None
        families = tuple(dict.fromkeys(one.candidate.what for one in named))
        beaten = tuple(
            (one.candidate.what, best.gain - one.gain) for one in tries if one.candidate.what not in families
        )
        placed = named[0].placed
        assert placed is not None
        if isinstance(placed.effect, DeadGauge):  # whatever else its readings are multiplied by
            found = [one for one in found if not _reads(one.placed, placed.effect)]
        found.append(_Found(placed, named[0].error, named[0].gain, families, beaten))
        found, left = _refitted(train, logs, found, named[0].state, REFITS)
        kept = [one for one in found if _errors_off(one) ** 2 >= least]
        if len(kept) < len(found):
            found, left = _refitted(train, logs, kept, left.settled, REFITS)
            break
    return found, left, None


def _tried(train: TrainDescription, logs: Sequence[TrainLog], left: Evidence, ranks: Sequence[Rank]) -> list[_Try]:
    """Return the candidates that promise most, each put into the model with all else fitted anew, the best first."""
    promising = [one for one in ranks if one.gain >= PROMISING * ranks[0].gain]
    named = [one for one in promising if one.candidate.placed is not None][:SHORTLIST]
    without = [one for one in promising if one.candidate.rival is not None][:RIVALS]
    frames = {one.candidate.frame for one in (*named, *without)}
    now, tries = left.settled, []
    for one in named:
        placed = one.candidate.placed
        assert placed is not None
        start = _Found(placed.sized(_possible(placed, one.amplitude)), one.error, 0.0, (), ())
        with suppress(InputError):  # it does not fit at all
            (got,), _, state = _settled_with(train, logs, [start], now, TRIES)
            tries.append(_Try(one.candidate, now.deviance - state.deviance, got.placed, got.error, state))
    for candidate in dead_gauges(train):
        if candidate.frame in frames:
            assert candidate.placed is not None
            with suppress(InputError):
                state = settled(candidate.placed.added(train), logs, now)
                tries.append(_Try(candidate, now.deviance - state.deviance, candidate.placed, 0.0, state))
    for one in without:
        with suppress(InputError):
            state = settled(train, logs, now, unnamed=[] if one.candidate.rival is None else [one.candidate.rival])
            tries.append(_Try(one.candidate, now.deviance - state.deviance, None, one.error, state))
    return sorted(tries, key=lambda one: -one.gain)


def _settled_with(
    train: TrainDescription, logs: Sequence[TrainLog], found: Sequence[_Found], start: Settled, rounds: int
) -> tuple[list[_Found], TrainDescription, Settled]:
    """Return effects with amplitudes at which the logs pull them no more, the train with them, and its motion."""
    now = list(found)
    free = [k for k, one in enumerate(now) if not one.placed.effect.binary]
    for turn in range(rounds + 1):
        built = _with(train, _placed(now))
        start = settled(built, logs, start)
        if turn == rounds or not free:
            break
        only = [Candidate(now[k].placed.what(train), "", now[k].placed) for k in free]
        seen = evidence_of(built, logs, start, only)
        changes, covariance = seen.best(range(len(free)))
        errors = np.sqrt(np.diag(covariance))
        for k, change, error in zip(free, changes.tolist(), errors.tolist(), strict=True):
            value = _possible(now[k].placed, now[k].placed.value + change)
            now[k] = dataclasses.replace(now[k], placed=now[k].placed.sized(value), error=error)
        if np.all(np.abs(changes) < 0.1 * errors):
            break
    return now, _with(train, _placed(now)), start


def _reads(placed: Placed, dead: DeadGauge) -> bool:
    """Whether an effect is the gain of a gauge, and that gauge is dead."""
    effect = placed.effect
    return isinstance(effect, GaugeGain) and (effect.frame, effect.gauge) == (dead.frame, dead.gauge)


def _errors_off(one: _Found) -> float:
    """Return by how many standard errors an effect is there; slip's error is a part of it, as only its part is seen."""
    value = one.placed.value
    if one.error == 0.0:
        return np.inf
    return (1 + value) * np.log1p(value) / one.error if isinstance(one.placed.effect, AxleSlip) else value / one.error


def _refitted(
    train: TrainDescription, logs: Sequence[TrainLog], found: Sequence[_Found], start: Settled, rounds: int
) -> tuple[list[_Found], Evidence]:
    """Return all effects refitted together, and the evidence of what is left."""
    now, built, state = _settled_with(train, logs, found, start, rounds)
    return now, evidence_of(built, logs, state)


def _possible(placed: Placed, value: float) -> float:
    """Return the amplitude within what the effect can have."""
    schema: dict[str, Any] = TypeAdapter(type(placed.effect)).json_schema()["properties"]["value"]
    low, high = (float(schema.get(key, sign * np.inf)) for key, sign in (("minimum", -1.0), ("maximum", 1.0)))
    return float(np.clip(value, low, high))


def _ranks(seen: Evidence) -> list[Rank]:
    """Return all candidates on their own, the best first, without names whose amplitude cannot be."""
    ranks = []
    for k, candidate in enumerate(seen.candidates):
        strength = float(seen.information[k, k])
        if strength <= 0:
            continue
        amplitude, error = float(seen.pull[k]) / strength, strength**-0.5
        placed, gain = candidate.placed, float(seen.pull[k]) ** 2 / strength
        if placed is not None:
            inside = _possible(placed, amplitude)
            gain = 2 * inside * float(seen.pull[k]) - inside**2 * strength
            if gain <= 0:
                continue
        ranks.append(Rank(candidate, gain, amplitude, error))
    return sorted(ranks, key=lambda one: -one.gain)


def _judged(train: TrainDescription, one: _Found) -> Finding:
    """Return what is to be said of an effect from the logs that it was found in."""
    if len(one.families) > 1:
        reason = f"these motions cannot distinguish: {'; '.join(one.families)}"
        return Finding("ambiguous", reason, one.gain, one.placed, one.error, one.families, one.beaten)
    return Finding("named", one.placed.what(train), one.gain, one.placed, one.error, one.families, one.beaten)


def _noise(train: TrainDescription, logs: Sequence[TrainLog], state: Settled) -> list[Finding]:
    """Return the frames whose gauges are noisier than described."""
    findings, built = [], train.as_built()
    for f, frame in enumerate(built.frames):
        each = [log.noise(built, motion, f) for log, motion in zip(logs, state.motions, strict=True)]
        n = DIFFERENCES * sum(count for _, count in each)
        if n == 0:
            continue
        square = DIFFERENCES * sum(count * size**2 for size, count in each) / n
        gain = n * (square - 1 - np.log(square))
        if square < NOISIER**2 or gain < LEAST_GAIN:
            continue
        value = frame.gauge_noise * (square - 1) ** 0.5
        error = frame.gauge_noise * square / (square - 1) ** 0.5 / (2 * n) ** 0.5
        placed = Placed(GaugeNoise(frame=f + 1, value=value))
        what = placed.what(train)
        findings.append(Finding("named", what, float(gain), placed, float(error), (what,)))
    return findings


def _stops(train: TrainDescription, logs: Sequence[Log]) -> list[Finding]:
    """Return the frames whose sensors stop within the logs, at one time in all of them."""
    findings = []
    for f in range(len(train.frames)):
        when = [_stop(train, log, f) for log in logs]
        known = [own for own in when if own is not None]
        expected = train.as_built().frames[f].rps_stops
        if not known or (expected is not None and abs(expected - known[0]) < 2 * train.sample_period):
            continue
        placed = Placed(SensorStops(frame=f + 1, value=float(np.median(known))))
        what, each = placed.what(train), 2 * train.sample_period
        longer = [log.t[-1] > placed.value + STOPPED * train.sample_period for log in logs]
        if np.ptp(known) > each or any(own is None for own, long in zip(when, longer, strict=True) if long):
            times = ", ".join("not" if own is None else f"at {own:.2f} s" for own in when)
            findings.append(Finding("unexplained", f"{what}, but not always at one time: {times}", LEAST_GAIN))
            continue
        error = train.sample_period / 12**0.5
        findings.append(Finding("named", what, LEAST_GAIN, placed, error, (what,)))
    return findings


def _stop(train: TrainDescription, log: Log, f: int) -> float | None:
    """Return when (s) a frame's sensor took the reading that it repeats to the log's end; None where it goes on."""
    if log.rps is None or log.rps_age is None:
        return None
    read, age = log.rps[:, 3 * f : 3 * f + 3], log.rps_age[:, f]
    if not np.isfinite(read[-1]).all():
        return None
    same = np.all(read == read[-1], axis=1)
    first = int(len(same) - np.argmin(same[::-1])) if not same.all() else 0
    if len(same) - first <= STOPPED:
        return None
    aged = age[-1] > STOPPED * train.sample_period / 2
    noisy = train.as_built().frames[f].gauge_noise > 0
    return float(log.t[first] - age[first]) if aged or noisy else None


def _borne_out(
    train: TrainDescription, held_out: Sequence[Log], findings: Sequence[Finding]
) -> tuple[list[Finding], tuple[Gap, Gap]]:
    """Return the findings as held-out logs bear them out, and the gap there before and after."""
    logs, apart = equations_of(train, held_out)
    every = [one.placed for one in findings if one.placed is not None]
    full = _with(train, every)
    state = settled(full, logs)
    judged = []
    for one in findings:
        if one.placed is None or one.verdict != "named":
            judged.append(one)
            continue
        gain, most = _borne(train, held_out, logs, state, every, one.placed)
        if most < EXERCISED:
            reason = f"the held-out motion does not show {one.reason}"
            one = dataclasses.replace(one, verdict="unconfirmed", reason=reason)
        elif gain < most / 2:
            one = dataclasses.replace(one, verdict="unconfirmed", reason=f"{one.reason} does not help on held-out logs")
        judged.append(one)
    return judged, (gap_of(train, logs, apart), gap_of(full, logs, state))


def _borne(
    train: TrainDescription,
    held_out: Sequence[Log],
    logs: Sequence[TrainLog],
    full: Settled,
    every: Sequence[Placed],
    placed: Placed,
) -> tuple[float, float]:
    """Return the deviance that an effect takes away on held-out logs beside all others, and the most it could."""
    without = _with(train, [other for other in every if other is not placed])
    if isinstance(placed.effect, SensorStops):
        times = [_stop(train, log, placed.effect.frame - 1) for log in held_out]
        long = [log.t[-1] > placed.value + 2 * STOPPED * train.sample_period for log in held_out]
        right = [t is not None and abs(t - placed.value) < 2 * train.sample_period for t in times]
        return 2 * EXERCISED * all(r for r, n in zip(right, long, strict=True) if n), 2 * EXERCISED * any(long)
    if isinstance(placed.effect, GaugeNoise):
        built, f = without.as_built(), placed.effect.frame - 1
        each = [log.noise(built, motion, f) for log, motion in zip(logs, full.motions, strict=True)]
        n, described = DIFFERENCES * sum(count for _, count in each), built.frames[f].gauge_noise
        square, wanted = DIFFERENCES * sum(s**2 * c for s, c in each) / max(n, 1.0), 1 + (placed.value / described) ** 2
        return n * (np.log(1 / wanted) + square - square / wanted), n * (np.log(1 / wanted) + wanted - 1)
    if placed.effect.binary or isinstance(placed.effect, AxleSlip):  # slip is far from linear in it
        gain = (
            settled(without, logs, full, full.sizes).deviance
            - settled(_with(train, every), logs, full, full.sizes).deviance
        )
        return gain, max(gain, EXERCISED if abs(gain) > MARGIN else 0.0)
    state = settled(without, logs, full, full.sizes)
    seen = evidence_of(without, logs, state, [Candidate(placed.what(train), placed.effect.unit, placed)])
    value, strength = placed.value, float(seen.information[0, 0])
    return 2 * value * float(seen.pull[0]) - value**2 * strength, value**2 * strength
