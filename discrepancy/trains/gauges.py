"""Gauges that are dead or noisier than described, and sensors that stop: probabilities and sizes."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from castor_envs.effects.train import DeadGauge, GaugeNoise, SensorStops
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.answers import SHOWN, Answer, Cause
from discrepancy.posterior.calibrated import CREDIBLE, NOTHING
from discrepancy.posterior.model.refit import Sized, fit_with
from discrepancy.posterior.variances.jitter import SIZES, excess_of
from discrepancy.trains.candidates import Candidate
from discrepancy.trains.linearise import Linearised, cost_of_noise

DIFFERENCES = 2 / 3
"""Information on noise in a difference of successive readings, relative to that of an independent reading."""

STOPPED = 5
"""Least number of equal readings at the end of a log with which a sensor counts as stopped."""


def with_dead_gauges(
    answers: Sequence[Answer], named: Sequence[Sized], look: Callable[..., Linearised], seen: Linearised, names: int
) -> list[Answer]:
    """Return the answers, with the probabilities of dead gauges computed with each gauge of the frame dead in the
    model.

    A dead gauge distorts the whole fit, so its linear extrapolation is not reliable. named: effects in the model.
    names: number of possible answers, all of the same prior probability.
    """
    judged: dict[Cause, Answer] = {}

    def log_evidence(effects: Sequence[Sized]) -> float:
        fitted = fit_with(seen.train, look, tuple(effects), seen)
        return -np.inf if fitted is None else fitted.log_evidence

    for answer in answers:
        (kind,) = answer.candidate.kinds or (None,)
        if not isinstance(kind, DeadGauge):
            judged[answer.candidate] = answer
            continue
        kept = [effect for effect in named if effect.candidate != answer.candidate]
        without = seen.log_evidence if len(kept) == len(named) else log_evidence(kept)
        known = {effect.candidate for effect in kept}
        gauges = [
            candidate
            for candidate in seen.candidates
            for gauge in candidate.kinds
            if isinstance(gauge, DeadGauge) and gauge.frame == kind.frame and candidate not in known
        ]
        evidences = [log_evidence([*kept, Sized(gauge, np.ones(1))]) for gauge in gauges]
        weights = np.array([without + np.log(NOTHING), *(np.array(evidences) + np.log1p(-NOTHING) - np.log(names))])
        nothing, *parts = np.exp(weights - np.logaddexp.reduce(weights)).tolist()
        likeliest = sorted(zip(parts, gauges, strict=True), key=lambda entry: -entry[0])
        if nothing > 1 - CREDIBLE:
            continue
        count = int(np.searchsorted(np.cumsum([part for part, _ in likeliest]), CREDIBLE * (1 - nothing))) + 1
        best, parts_of_names = (
            likeliest[0][1],
            [*((part, gauge.family) for part, gauge in likeliest), (nothing, "nothing")],
        )
        judged[best] = dataclasses.replace(
            answer,
            probabilities={name: part for part, name in parts_of_names if part > SHOWN},
            absent=nothing,
            credible=tuple(gauge.family for _, gauge in likeliest[:count]),
            unnamed=False,
            candidate=best,
            amplitudes=np.ones(1),
            covariance=np.zeros((1, 1)),
            cost=seen.cost[:, seen.candidates.index(best)],
        )
    return list(judged.values())


def noise_answers(seen: Linearised, held: Linearised | None, good: Linearised | None, names: int) -> list[Answer]:
    """Return the answers that gauges of frames are noisier than described, and than in clean logs.

    names: number of possible answers, all of the same prior probability.
    """
    answers = []
    for kind in GaugeNoise.variants(seen.train):
        f, usual = kind.frame - 1, 0.0
        if good is not None:
            usual = float(good.train.as_built().frames[f].gauge_noise * max(_noise(good, f)[1] - 1, 0.0) ** 0.5)
        elsewhere = None if held is None else _log_likelihood(held, f, usual)
        found = excess_of(kind.tolerance, _log_likelihood(seen, f, usual), elsewhere, names)
        if found is not None:
            probability, size, error, confirmed = found
            candidate, cost = Candidate.of(kind, seen.train), size * cost_of_noise(seen, f)
            answers.append(Answer.judged_apart(candidate, probability, size, error, cost, confirmed))
    return answers


def stop_answers(
    train: TrainDescription, logs: Sequence[Log], held_out: Sequence[Log], seen: Linearised
) -> list[Answer]:
    """Return the answers that sensors stop within logs, as long after the start of all of them; the cost is that of the
    repeated reading."""
    answers = []
    for f in range(len(train.frames)):
        stops, period = [_stop(train, log, f) for log in logs], train.sample_period
        known = [time for time in stops if time is not None]
        expected, time = train.as_built().frames[f].rps_stops, float(np.median(known or np.nan))
        if not known or (expected is not None and abs(expected - time) < 2 * period):
            continue
        candidate, error = Candidate.of(SensorStops(frame=f + 1, value=time), train), period / 12**0.5
        if not _agree(train, logs, f, time):
            times = ", ".join("not" if stop is None else f"at {stop:.2f} s" for stop in stops)
            what = f"{candidate.what}, but not always at one time: {times}"
            candidate = Candidate(what, what, what)
        confirmed = None
        if held_out:
            shown = any(_lasts(train, log, time) for log in held_out)
            confirmed = 0.0 if not shown else np.inf if _agree(train, held_out, f, time) else -np.inf
        off = [_kept(seen, k, f, time) for k in range(len(logs))]
        cost = np.sqrt(np.mean(np.square(off), axis=0))
        answers.append(Answer.judged_apart(candidate, 1.0, time, error, cost, confirmed))
    return answers


def _log_likelihood(seen: Linearised, f: int, usual: float) -> Array:
    """Return the log-likelihood of a frame's readings (natural logarithm, up to a constant) with noise of `SIZES` added
    to the described and the usual noise, 1/m."""
    number, square = _noise(seen, f)
    described = seen.train.as_built().frames[f].gauge_noise
    part = 1 + (usual**2 + (SIZES * GaugeNoise.tolerance) ** 2) / max(described, 1e-12) ** 2
    return -number / 2 * (np.log(part) + square / part)


def _noise(seen: Linearised, f: int) -> tuple[float, float]:
    """Return the number of readings of a frame, and their squared noise relative to the described noise."""
    built = seen.train.as_built()
    noises = [log.noise(built, motion, f) for log, motion in zip(seen.train_logs, seen.fit.motions, strict=True)]
    number = sum(count for _, count in noises)
    square = sum(count * size**2 for size, count in noises) / max(number, 1)
    return DIFFERENCES * number, square


def _stop(train: TrainDescription, log: Log, f: int) -> float | None:
    """Return the time after the log's start (s) of the reading that a frame's sensor repeats to its end; None where it
    does not stop."""
    if log.rps is None or log.rps_age is None:
        return None
    read, age = log.rps[:, 3 * f : 3 * f + 3], log.rps_age[:, f]
    others = np.flatnonzero(np.any(read != read[-1], axis=1))  # all, if the last is NaN
    first = int(others[-1]) + 1 if len(others) else 0
    if len(read) - first <= STOPPED:
        return None
    aged = age[-1] > STOPPED * train.sample_period / 2
    noisy = train.as_built().frames[f].gauge_noise > 0
    return max(float(log.t[first] - age[first] - log.t[0]), 0.0) if aged or noisy else None


def _lasts(train: TrainDescription, log: Log, time: float) -> bool:
    """Whether a log goes on long enough to show that a sensor stops at a time."""
    return bool(log.t[-1] - log.t[0] > time + 2 * STOPPED * train.sample_period)


def _agree(train: TrainDescription, logs: Sequence[Log], f: int, time: float) -> bool:
    """Whether a frame's sensor stops at a time in all logs that last so long."""
    stops = [(_stop(train, log, f), log) for log in logs]
    return all(
        abs(stop - time) < 2 * train.sample_period if stop is not None else not _lasts(train, log, time)
        for stop, log in stops
    )


def _kept(seen: Linearised, k: int, f: int, time: float) -> Array:
    """Return the rms difference (2,), m and rad, of a frame's relative pose from that at which its sensor stopped."""
    log, relative = seen.train_logs[k], seen.fit.motions[k].relative[:, f]
    after = log.t >= time
    if not after.any():
        return np.zeros(2)
    off = relative[after] - relative[after][0]
    return np.sqrt([np.mean(np.sum(off[:, :2] ** 2, axis=1)), np.mean(off[:, 2] ** 2)])
