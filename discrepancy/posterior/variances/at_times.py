"""Intermittent faults: wheels that disagree with the other wheels far more in some windows than in the rest of a log.

In good order the disagreement of a window has Student's t distribution, with wide tails; the alternative is that in
some windows it comes from a fault, whose size is Cauchy distributed. When and why these windows occur is unknown, so
this is an unnamed alternative, and no simulation can predict it.

But if a wheel turns further than its encoder shows wherever it contradicts the others, counts were lost in bursts: any
other cause would have either sign with the same probability in each window. A window in which the fault is likelier
active than not counts by the probability that it is.
"""

import dataclasses
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaln, logit

from castor_envs.effects.encoders import TickLossBursts
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.measurement.design_matrix import DesignMatrix
from discrepancy.posterior.answers import Answer, Cause
from discrepancy.posterior.calibrated import FAULT, FREEDOM, LOG_ODDS, prior_log_odds
from discrepancy.posterior.linearise import Linearised
from estimators.likelihood.disagreement import LEAST_KEPT, Disagreement, of_row, slip_of_row

PARTS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4])
"""Parts of all windows in which the fault may be active."""

IN_LOG = 0.5
"""Prior probability that an intermittent fault of a robot shows in any given log."""

SELDOM = 0.5
"""Largest part of the time that bursts last: what a wheel does for longer has another cause, as that it slides."""

EVEN, MOSTLY = 0.1, 0.75
"""Largest deviation of bursts from a steady beat, as a part of the period, and the part of bursts that must keep within
it."""


AROUND = 20
"""Number of periods that are tried on either side of a beat's, each farther by a step in all of its bursts."""


class Faulty(NamedTuple):
    """A row of the constraints, a wheel's rolling or a castor's side slip, that contradicts the other rows
    intermittently.

    active: for each log the probability (W,) that it does so in a window; slips: for each log the slip (W,) in windows
    where this is likely, as a part of the way. log_odds: log odds (natural logarithm) of the fault.
    """

    row: int
    active: tuple[Array, ...]
    slips: tuple[Array, ...]
    log_odds: float

    @property
    def hits(self) -> tuple[NDArray[np.bool_], ...]:
        """For each log the windows (W,) in which the fault is likelier active than not."""
        return tuple(probability > 0.5 for probability in self.active)


def at_times(seen: Linearised, clean: Linearised | None, answers: Sequence[Answer], names: int) -> list[Faulty]:
    """Return the rows that disagree with the other rows intermittently with probability `CREDIBLE`, beyond the effects
    in `answers`.

    names: number of other possible answers, all of the same prior probability.
    """
    among = [answer.candidate for answer in answers if answer.effect is not None]
    disagreements = _beside(seen, among)
    usual = np.zeros(disagreements[0].shape[1])
    if clean is not None:
        good = [disagreement.beside([]) for disagreement in clean.disagreements]
        usual = np.max([usual, *map(_log_factors, good)], axis=0)
    found: list[Faulty] = []
    while len(found) < len(usual):
        log_odds = _in_some_logs([_log_factors(off) for off in disagreements]) - usual + prior_log_odds(names)
        row = int(np.argmax(log_odds))
        if log_odds[row] < LOG_ODDS:
            break
        fault = Faulty(row, tuple(_active(off[:, row]) for off in disagreements), (), float(log_odds[row]))
        by_log = zip(seen.designs, seen.disagreements, disagreements, fault.hits, strict=True)
        slips = [
            hit * off[:, row] * usually.scale[:, row] / _kept(design, usually, row)
            for design, usually, off, hit in by_log
        ]
        found.append(fault._replace(slips=tuple(slips)))
        disagreements = [off * ~hit[:, None] for off, hit in zip(disagreements, fault.hits, strict=True)]
    return found


def steps_of(seen: Linearised, faulty: Sequence[Faulty]) -> list[NDArray[np.bool_]]:
    """Return the steps (K - 1, rows) of every log in which faulty rows contradict the other rows."""
    steps = []
    for k, disagreement in enumerate(seen.disagreements):
        hits = np.zeros(disagreement.seen.shape, dtype=bool)
        for fault in faulty:
            hits[:, fault.row] |= fault.hits[k]
        steps.append(np.repeat(hits, disagreement.steps, axis=0))
    return steps


def recurring(seen: Linearised, faulty: Sequence[Faulty]) -> tuple[list[Faulty], list[float]]:
    """Return the windows of other logs in which the same rows contradict the rest, and the log Bayes factor of each
    fault in them."""
    disagreements, found, confirmed = _beside(seen, ()), [], []
    for fault in faulty:
        active = tuple(_active(off[:, fault.row]) for off in disagreements)
        confirmed.append(float(_in_some_logs([_log_factors(off) for off in disagreements])[fault.row]))
        found.append(fault._replace(active=active, slips=()))
        disagreements = [off * ~hit[:, None] for off, hit in zip(disagreements, found[-1].hits, strict=True)]
    return found, confirmed


def answer_of(
    robot: RobotDescription,
    logs: Sequence[Log],
    seen: Linearised,
    fault: Faulty,
    confirmed: float | None,
    unnamed: Collection[str],
) -> Answer:
    """Return the answer for a row that contradicts the other rows intermittently. confirmed: see `Answer`; unnamed:
    names of encoders on which there is an unnamed alternative: this, and no lost counts, gives slip its sign."""
    probability, largest = float(expit(fault.log_odds)), [np.abs(slips).max(initial=0.0) for slips in fault.slips]
    k = int(np.argmax(largest))
    worst = int(np.argmax(np.abs(fault.slips[k])))
    row, w = int(seen.designs[k].model.rows[fault.row]), len(robot.wheels)
    place = f"wheel_{robot.wheel_names[row]}" if row < w else f"castor_{robot.wheel_castors[row - w] + 1}"
    description = f"{place} contradicts the others at times, most at "
    description += f"{seen.disagreements[k].t[worst]:.0f} s" + (f" of log {k + 1}" if len(logs) > 1 else "")
    by_log = zip(seen.disagreements, fault.slips, strict=True)
    cost = seen.cost_of_slips([disagreement.slips(fault.row, slips) for disagreement, slips in by_log])
    bursts = None if place in unnamed else bursts_of(robot, logs, seen, fault.row, fault.active)
    if bursts is None:
        return Answer.judged_apart(Candidate(description), probability, largest[k], 0.0, cost, confirmed)
    candidate, lost = Candidate(described(bursts.effect), (bursts.effect,)), float(expit(bursts.log_odds))
    answer = Answer.judged_apart(candidate, probability, bursts.effect.value, bursts.error, cost, confirmed)
    parts = {candidate.family: lost * probability, description: (1 - lost) * probability}
    credible, unsure = (*answer.credible, description), bursts.log_odds < LOG_ODDS
    return dataclasses.replace(
        answer,
        probabilities=parts | {"nothing": 1 - probability},
        credible=credible if unsure else answer.credible,
        unnamed=unsure,
    )


def _beside(seen: Linearised, among: Sequence[Cause]) -> list[Array]:
    """Return the disagreement (W, rows) of each log in units of its usual size, after least squares of these
    candidates."""
    by_log = []
    for design, disagreement in zip(seen.designs, seen.disagreements, strict=True):
        chosen = [candidate in among for candidate in design.candidates for _ in range(candidate.columns)]
        columns = np.flatnonzero(chosen).tolist()
        by_log.append(disagreement.beside(columns))
    return by_log


def _kept(design: DesignMatrix, disagreement: Disagreement, row: int) -> Array:
    """Return the part (W,) of a row's slip that shows as its disagreement, if no other row slips."""
    rolled = np.abs(design.model.rolled(design.geometry, design.state)).max(axis=1)
    starts = np.cumsum(disagreement.steps) - disagreement.steps
    _, by_slip = of_row(design.model, design.geometry, design.state, row)
    kept = np.add.reduceat(by_slip * rolled, starts) / np.add.reduceat(disagreement.way, starts)
    return np.maximum(kept, LEAST_KEPT)


def _in_some_logs(log_factors: Sequence[Array]) -> Array:
    """Return the log Bayes factors (rows,) of faults that show in some of the logs, from the factors (rows,) of each
    log."""
    return np.asarray(np.sum(np.logaddexp(np.log1p(-IN_LOG), np.log(IN_LOG) + np.array(log_factors)), axis=0))


def _log_ratios(off: Array) -> Array:
    """Return the log densities of disagreements, in units of their usual size, under a fault beyond those in good
    order."""
    constant = gammaln((FREEDOM + 1) / 2) - gammaln(FREEDOM / 2) - np.log(np.pi * FREEDOM) / 2 + np.log(np.pi * FAULT)
    return (FREEDOM + 1) / 2 * np.log1p(off**2 / FREEDOM) - np.log1p((off / FAULT) ** 2) - constant


def _log_factors(off: Array) -> Array:
    """Return for every row the log Bayes factor of intermittent faults, given disagreements (W, rows) in units of their
    usual size."""
    return np.asarray(np.logaddexp.reduce(_by_part(off), axis=0) - np.log(len(PARTS)))


def _by_part(off: Array) -> Array:
    """Return the log Bayes factors (`PARTS`, rows) of faults that are active in these parts of all windows."""
    parts = PARTS[:, None, None]
    return np.asarray(np.logaddexp(np.log1p(-parts), np.log(parts) + _log_ratios(off)).sum(axis=1))


def _active(off: Array) -> Array:
    """Return the probability (W,) that the fault of a row is active in each window."""
    return np.asarray(expit(_log_ratios(off) + logit(PARTS[np.argmax(_by_part(off[:, None])[:, 0])])))


class Bursts(NamedTuple):
    """Counts lost in bursts, the standard error of the part lost, and the log odds (natural logarithm) of lost counts
    against another cause."""

    effect: TickLossBursts
    error: float
    log_odds: float


def bursts_of(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, row: int, active: Sequence[Array]
) -> Bursts | None:
    """Return the bursts in which the wheel of a row loses counts; None for a castor's row, or if another cause is
    likelier. active: for each log the probability (W,) that the fault is active in a window."""
    k = int(seen.designs[0].model.rows[row])
    if k >= len(robot.wheels):
        return None
    ways, shares, parts, fast_steps, windows, hits, log_odds = [], [], [], [], [], [], 0.0
    for design, disagreement, probability in zip(seen.designs, seen.disagreements, active, strict=True):
        windows.append(np.repeat(np.arange(len(probability)), disagreement.steps))
        lost, _ = slip_of_row(design.model, design.geometry, design.state, row)  # m in each step, as the way
        way = design.model.rolled(design.geometry, design.state)[:, row] + lost
        lost, way = lost * np.sign(way), np.abs(way)
        by_window, farthest = (np.bincount(windows[-1], part, len(probability)) for part in (lost, way))
        fewer = (by_window > 0) & (by_window <= farthest)
        likely = probability > 0.5
        log_odds += _log_odds(probability[likely], fewer[likely])
        hit = fewer & likely
        hits.append(hit)
        fast_steps.append(way > np.median(way) / 4)  # in slower steps the part lost is uncertain
        ways.append((lost, way))
        shares.append(lost / np.maximum(way, 1e-12))
        parts.append(shares[-1][fast_steps[-1] & hit[windows[-1]]])
    inside = np.concatenate(parts)
    if log_odds <= 0 or not len(inside):
        return None
    largest = np.sort(inside)[-sum(int(hit.sum()) for hit in hits) :]  # a step of each window, or more
    inside = inside[inside > np.median(largest) / 2]
    value = float(np.clip(np.median(inside), 0.0, 1.0))
    bursts = [
        _bursts(log.t, hit, window, fast, share / value)
        for log, hit, window, fast, share in zip(logs, hits, windows, fast_steps, shares, strict=True)
    ]
    all_starts, all_widths = zip(*bursts, strict=True)
    beat = _beat(all_starts[0]) if len(logs) == 1 else None
    width = float(np.median(np.concatenate(all_widths)))
    period = sum(float(np.ptp(log.t)) for log in logs) / sum(map(len, all_starts)) if beat is None else beat[1]
    if width > SELDOM * period:
        return None
    castor, wheel = robot.wheel_places[k]
    start, seed = 0.0, 0
    if beat is not None:
        lost, way = ways[0]
        (start, period, width, in_bursts), seed = _box(logs[0].t, lost, way, 2 * width, *beat), None
        if np.any(fast := in_bursts & fast_steps[0]):
            inside = shares[0][fast]
            value = float(np.clip(np.median(inside), 0.0, 1.0))
    error = float(np.std(inside) / np.sqrt(len(inside)))
    effect = TickLossBursts(castor=castor, wheel=wheel, value=value, period=period, width=width, start=start, seed=seed)
    return Bursts(effect, error, log_odds)


def _log_odds(active: Array, fewer: NDArray[np.bool_]) -> float:
    """Return the log odds (natural logarithm) of lost counts against another cause, given the windows (W,) in which
    the encoder shows less than the wheel turns.

    Where the fault is active, lost counts always show less and another cause does with probability 1/2; where it is
    not, either sign says nothing.
    """
    least = np.finfo(float).tiny  # of a window that certainly contradicts
    return float(np.sum(np.log(np.maximum(1 + np.where(fewer, active, -active), least))))


def _bursts(
    t: Array, hit: NDArray[np.bool_], window: NDArray[np.intp], fast: NDArray[np.bool_], share: Array
) -> tuple[Array, Array]:
    """Return when bursts start, and how long they last, s: one in every run of windows that are hit (W,).

    window (K - 1,): window of each step. fast: steps in which the part lost can be estimated; share: this part,
    relative to the part that bursts lose.
    """
    middle, length, starts, widths = (t[1:] + t[:-1]) / 2, np.diff(t), [], []
    near = np.convolve(hit, np.ones(3), "same") > 0  # a burst may begin or end in the neighbouring window
    for run in np.split(np.arange(len(hit)), np.flatnonzero(np.diff(near)) + 1):
        steps = np.flatnonzero(np.isin(window, run) & fast & (share > 0.5)) if near[run[0]] else np.zeros(0, np.intp)
        if not len(steps):
            continue
        around = np.arange(max(steps[0] - 1, 0), min(steps[-1] + 2, len(share)))  # neighbours may be lost in part
        between = (around > steps[0]) & (around < steps[-1])
        weight = np.where(between, 1.0, np.clip(np.where(fast[around], share[around], 0.0), 0.0, 1.0)) * length[around]
        starts.append(weight @ middle[around] / weight.sum() - weight.sum() / 2)
        widths.append(float(weight.sum()))
    return np.array(starts), np.array(widths)


def _box(
    t: Array, lost: Array, way: Array, longest: float, first: float, period: float
) -> tuple[float, float, float, NDArray[np.bool_]]:
    """Return when bursts of a steady beat start, their period, and how long they last, s, and which steps (K - 1,) are
    in them, that explain most of what is lost (K - 1,), m, of the way in steps, m, between times t (K,).

    Box least squares (Kovacs, Zucker and Mazeh, Astronomy and Astrophysics 391, 2002). longest: that bursts last, s,
    which keeps the boxes that are compared few in long logs. first, period: by the beat, s, which is known to about a
    step of each of its bursts.
    """
    middle, step, best = (t[1:] + t[:-1]) / 2, float(np.median(np.diff(t))), 0.0
    found = first, period, 0.0, np.zeros(len(way), dtype=bool)
    beats = max(np.ptp(t) / period, 1.0)
    for other in (period + step / beats * np.arange(-AROUND, AROUND + 1)).tolist():
        count = max(round(other / step), 2)
        phase = (middle - first) / other % 1 * count
        by_phase = [np.bincount(phase.astype(np.intp), part, count) for part in (lost * way, way**2)]
        sums = [np.concatenate([[0.0], np.cumsum(np.tile(part, 2))]) for part in by_phase]
        starts, lengths = np.arange(count)[:, None], np.arange(1, max(int(min(SELDOM * count, longest / step)), 1) + 1)
        score, information = (of[starts + lengths] - of[starts] for of in sums)
        explained = np.maximum(score, 0.0) ** 2 / np.maximum(information, 1e-12)
        if explained.max() > best:
            best, (begin, length) = explained.max(), np.unravel_index(np.argmax(explained), explained.shape)
            inside = (phase - begin) % count < lengths[length]
            found = (first + begin * other / count) % other, other, float(lengths[length] * other / count), inside
    return found


def _beat(t: Array) -> tuple[float, float] | None:
    """Return the first start and the period (s) of a steady beat that bursts keep; None if they do not.

    Beats may be missing, as a wheel at rest loses nothing.
    """
    if len(t) < 3:
        return None
    for times in range(1, 4):
        period, first, kept = float(np.median(np.diff(t))) / times, t[0], np.full(len(t), True)
        for _ in range(2):
            beats = np.round((t - first) / period)
            if len(np.unique(beats)) < len(t) or kept.mean() < MOSTLY:
                break
            period, first = (float(coefficient) for coefficient in np.polyfit(beats[kept], t[kept], 1))
            kept = np.abs(t - first - period * beats) < EVEN * period
        else:
            if kept.mean() >= MOSTLY:
                return first - period * np.floor(first / period), period
    return None
