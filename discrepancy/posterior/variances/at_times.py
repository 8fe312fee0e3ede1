"""Intermittent faults: wheels that disagree with the other wheels far more in some windows than in the rest of a log.

In good order the disagreement of a window has Student's t distribution, with wide tails; the alternative is that in
some windows it comes from a fault, whose size is Cauchy distributed. When and why these windows occur is unknown, so
this is an unnamed alternative, and no simulation can predict it.

Where there is a reference, it tells each wheel's slip as well: a floor that is slippery at some places lets all wheels
slide at the same time, which then hardly disagree, and of two wheels none can contradict the other.

But if a wheel turns further than its encoder shows wherever it contradicts the others, counts were lost in bursts: any
other cause would have either sign with the same probability each time. Neighbouring windows are one time, which counts
by the largest probability that the fault is active in one of them.
"""

import dataclasses
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaln, logit

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.measurement.design_matrix import DesignMatrix
from discrepancy.posterior.answers import Answer, Cause
from discrepancy.posterior.calibrated import FAULT, FREEDOM, LOG_ODDS, prior_log_odds
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.variances.bursts import bursts_of, losses, steady_box
from estimators.likelihood.creep_prediction import UNEVEN
from estimators.likelihood.disagreement import LEAST, LEAST_KEPT, MEDIAN, Disagreement, of_row, way_of

PARTS = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.4])
"""Parts of all windows in which the fault may be active."""

IN_LOG = 0.5
"""Prior probability that an intermittent fault of a robot shows in any given log."""


class Faulty(NamedTuple):
    """A row of the constraints, a wheel's rolling or a castor's side slip, that contradicts the other rows
    intermittently, or the reference.

    active: for each log the probability (W,) that it does so in a window; slips: for each log the slip (W,) in windows
    where this is likely, as a part of the way. log_odds: log odds (natural logarithm) of the fault. of_others:
    whether the other rows tell it, and not the reference.
    """

    row: int
    active: tuple[Array, ...]
    slips: tuple[Array, ...]
    log_odds: float
    of_others: bool = True

    @property
    def hits(self) -> tuple[NDArray[np.bool_], ...]:
        """For each log the windows (W,) in which the fault is likelier active than not."""
        return tuple(probability > 0.5 for probability in self.active)

    def together(self, later: "Faulty") -> "Faulty":
        """Return this fault with windows that were found to be of the same row beside it."""
        by_log = zip(self.slips, later.slips, self.hits, strict=True)
        return self._replace(
            active=tuple(np.maximum(one, other) for one, other in zip(self.active, later.active, strict=True)),
            slips=tuple(np.where(hit, one, other) for one, other, hit in by_log),
            log_odds=self.log_odds + later.log_odds,
        )


def at_times(
    logs: Sequence[Log],
    seen: Linearised,
    clean: Linearised | None,
    answers: Sequence[Answer],
    names: int,
    known: Collection[int] = (),
) -> list[Faulty]:
    """Return the rows that disagree with the other rows intermittently with probability `CREDIBLE`, beyond the effects
    in `answers`; if there are none, that of a wheel that loses counts in bursts of a steady beat, so often that they
    are the usual disagreement of windows.

    names: number of other possible answers, all of the same prior probability. known: rows that are known to.
    """
    among = [answer.candidate for answer in answers if answer.effect is not None]
    disagreements = _beside(seen, among)
    usual = np.zeros(disagreements[0].shape[1])
    if clean is not None:
        good = [disagreement.beside([]) for disagreement in clean.disagreements]
        usual = np.max([usual, *map(_log_factors, good)], axis=0)
    found = list[Faulty]()
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
    return found or _beating(logs, seen, names, known)


def sliding(
    logs: Sequence[Log], seen: Linearised, clean: Linearised | None, names: int, known: Collection[int] = ()
) -> list[Faulty]:
    """Return the rows of wheels that slip intermittently, as the reference tells, with probability `CREDIBLE`, beside
    the effects in the model. names, known: see `at_times`."""
    by_log = _slipping(logs, seen)
    told = [off for off, _ in by_log if np.any(off)]
    if not told:
        return []
    rows = seen.designs[0].model.rows
    good = [] if clean is None else [_by_reference(clean, k, rows)[0] for k in range(len(clean.slips))]
    usual = np.max([np.zeros(len(rows)), *map(_log_factors, good)], axis=0)
    log_odds = _in_some_logs([_log_factors(off) for off in told]) - usual + prior_log_odds(names)
    likely = [row for row in np.argsort(-log_odds).tolist() if row not in known and log_odds[row] >= LOG_ODDS]
    return [_sliding(by_log, row, float(log_odds[row])) for row in likely]


def _slipping(logs: Sequence[Log], seen: Linearised) -> list[tuple[Array, Array]]:
    """Return what `_by_reference` does for each log; 0 of logs without a reference."""
    by_log = [_by_reference(seen, k, seen.designs[k].model.rows) for k in range(len(logs))]
    return [
        (off, parts) if log.reference is not None else (0 * off, 0 * parts)
        for log, (off, parts) in zip(logs, by_log, strict=True)
    ]


def _sliding(by_log: Sequence[tuple[Array, Array]], row: int, log_odds: float) -> Faulty:
    """Return the windows of logs in which a wheel slips, as the reference tells. by_log: as of `_slipping`."""
    active = tuple(_active(off[:, row]) * np.any(off) for off, _ in by_log)
    slips = tuple(parts[:, row] * (probability > 0.5) for probability, (_, parts) in zip(active, by_log, strict=True))
    return Faulty(row, active, slips, log_odds, of_others=False)


def _by_reference(seen: Linearised, k: int, rows: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the slips (W, rows) of wheels in windows of log k beyond the predicted ones, in units of their usual size,
    and as a part of the way; 0 of castors. Where much is predicted, more is usual."""
    of, slips = seen.disagreements[k], _of_rows(np.nan_to_num(seen.slips[k]), rows)
    starts = np.cumsum(of.steps) - of.steps
    way = way_of(of.way, starts)[:, None]
    parts = of.counted[:, None] * np.add.reduceat(slips, starts, axis=0) / way
    size = np.median(np.abs(parts[of.counted]), axis=0) / MEDIAN if np.any(of.counted) else np.zeros(parts.shape[1])
    usual = np.maximum(size, LEAST)
    if seen.designs:
        design = seen.designs[k]
        predicted = design.model.residuals(design.geometry, design.state) - slips
        usual = np.hypot(usual, UNEVEN * np.add.reduceat(predicted, starts, axis=0) / way)
    return parts / usual, parts


def _of_rows(of_wheels: Array, rows: NDArray[np.intp]) -> Array:
    """Return what wheels (K - 1, w) do for each row of the constraints (K - 1, rows): 0 for castors."""
    wheels = of_wheels.shape[1]
    found: Array = (rows < wheels) * of_wheels[:, np.minimum(rows, wheels - 1)]
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


def recurring(logs: Sequence[Log], seen: Linearised, faulty: Sequence[Faulty]) -> tuple[list[Faulty], list[float]]:
    """Return the windows of other logs in which the same rows contradict the rest, and the log Bayes factor of each
    fault in them."""
    disagreements, found, confirmed = _beside(seen, ()), [], []
    by_log = _slipping(logs, seen)
    told = [off for off, _ in by_log if np.any(off)]
    for fault in faulty:
        if not fault.of_others:
            factor = _in_some_logs([_log_factors(off[:, [fault.row]]) for off in told])[0] if told else 0.0
            confirmed.append(float(factor))
            found.append(_sliding(by_log, fault.row, fault.log_odds))
            continue
        active = tuple(_active(off[:, fault.row]) for off in disagreements)
        factor = float(_in_some_logs([_log_factors(off) for off in disagreements])[fault.row])
        beating = _beats(logs, seen, fault.row)
        if beating is not None and beating.log_odds > factor:
            active, factor = beating.active, beating.log_odds
        confirmed.append(factor)
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
    description = f"{place} contradicts the {'others' if fault.of_others else 'reference'} at times, most at "
    description += f"{seen.disagreements[k].t[worst]:.0f} s" + (f" of log {k + 1}" if len(logs) > 1 else "")
    by_log = zip(seen.disagreements, fault.slips, strict=True)
    cost = seen.cost_of_slips([disagreement.slips(fault.row, slips) for disagreement, slips in by_log])
    apart = place in unnamed or not fault.of_others
    bursts = None if apart else bursts_of(robot, logs, seen, fault.row, fault.active)
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


def _beating(logs: Sequence[Log], seen: Linearised, names: int, known: Collection[int]) -> list[Faulty]:
    """Return the row that contradicts the others most if its wheel is likely to lose counts in bursts of a steady beat:
    other rows disagree with it then, too. names, known: see `at_times`."""
    squares = np.sum(
        [np.sum((of.counted[:, None] * of.seen * of.along) ** 2, axis=0) for of in seen.disagreements], axis=0
    )
    row = int(np.argmax(squares))
    found = None if row in known else _beats(logs, seen, row)
    log_odds = -np.inf if found is None else found.log_odds + prior_log_odds(names)
    return [] if found is None or log_odds < LOG_ODDS else [found._replace(log_odds=log_odds)]


def _beats(logs: Sequence[Log], seen: Linearised, row: int) -> Faulty | None:
    """Return the windows in which the wheel of a row loses counts if it does so in bursts of a steady beat, with their
    log Bayes factor; None of several logs, whose bursts have no common beat, of a castor's row, of encoders that cannot
    contradict each other, and where nothing is lost."""
    (design, disagreement), *others = zip(seen.designs, seen.disagreements, strict=True)
    if others or not (design.redundant and disagreement.along[row]):
        return None
    counted = np.repeat(disagreement.counted, disagreement.steps)
    lost, way = (of * counted for of in losses(design, row))
    if (box := steady_box(logs[0].t, lost, way)) is None:
        return None
    starts = np.cumsum(disagreement.steps) - disagreement.steps
    hit, rolled = np.logical_or.reduceat(box.inside & counted, starts), np.add.reduceat(disagreement.way, starts)
    slips = hit * np.add.reduceat(lost, starts) / rolled
    return Faulty(row, (hit.astype(np.float64),), (slips,), box.log_factor)


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
