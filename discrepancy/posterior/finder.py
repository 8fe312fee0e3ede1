"""The finder on one page: learn from clean logs what robots in good order show, search for the effects in the model
(`model.search`: fit states, linearise, compute the posterior, add the named effects, and repeat until the names stay
the same), and confirm them on held-out logs.

How much of each effect robots in good order show, differently in each log, comes from tolerances, too (`priors`); a
fault has to exceed that. The result is a probability of every name, and a verdict
that follows from it (`verdicts`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any, Generic, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from castor_envs.effects.clocks import SampleJitter
from castor_envs.effects.encoders import TickLossBursts
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, without
from discrepancy.posterior.answers import Answer, Verdict
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.model.dimensions import Dimension, dimensions_of, either_of, guessed
from discrepancy.posterior.model.refit import S, Sized, V, fit_with, with_effects
from discrepancy.posterior.model.search import Search
from discrepancy.posterior.other_logs import in_good_order, in_phase
from discrepancy.posterior.priors import order_of
from discrepancy.posterior.reference import Shown, reference_answers
from discrepancy.posterior.variances.events import Events, Released
from discrepancy.posterior.variances.learned import answer_of, encoders_of
from discrepancy.posterior.variances.noise_excess import noisy_answers
from discrepancy.posterior.verdicts import (
    MATERIAL,
    Material,
    by_all_logs,
    gap_grows,
    gap_shrinks,
    in_units,
    judged,
    negligible,
    weakest,
)
from discrepancy.validation.sufficient import check_seen, must_fit


@dataclass(frozen=True, eq=False)
class Diagnosis(Generic[V, S]):
    """The effects missing in a description, as logs show them. verdict: of the whole; answers: the most certain first.

    before, after: the logs linearised without and with the named effects and learned curves; held_out: both for
    held-out logs. inclusion: probability of every name to be among the missing effects. creep: factor of predicted
    creep under forces, if logs tell it; clean_gap: gap of these. in_phase: held-out logs,
    whose wheels are turned at the start as those of the logs are (`other_logs.in_phase`).
    """

    robot: V
    verdict: Verdict
    answers: tuple[Answer, ...]
    inclusion: dict[str, float]
    before: S
    after: S
    held_out: tuple[S, S] | None
    creep: float | None = None
    in_phase: tuple[Log, ...] = ()
    clean_gap: tuple[float, float] | None = None
    dimensions: tuple[Dimension, ...] = ()

    @property
    def found(self) -> V:
        """The robot, or the train, with the named effects, and with the learned curves of unnamed ones; dimensions as
        they are guessed together, if they are."""
        return with_effects(self.robot, self.sized)

    @property
    def sized(self) -> list[Sized]:
        """The effects that `found` has."""
        together = {dimension.sized.candidate: dimension.sized for dimension in self.dimensions}
        named = [
            Sized(answer.candidate, answer.amplitudes)
            for answer in self.answers
            if answer.learned or (answer.verdict == "named" and answer.effect is not None)
        ]
        return [*(effect for effect in named if effect.candidate not in together), *together.values()]


RobotDiagnosis = Diagnosis[RobotDescription, Linearised]


class Usual(NamedTuple):
    """What clean logs show of a robot, as it was described for them: their statistics, and the reference."""

    robot: RobotDescription
    seen: Linearised
    reference: Shown


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def diagnose(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log] = (),
    clean: Sequence[Log] = (),
    before: RobotDescription | None = None,
    material: Material = MATERIAL,
) -> RobotDiagnosis:
    """Return the effects that a robot's description is missing, their probabilities, and their costs in use.

    held_out: logs that must confirm a name. clean: logs of the robot in good order. before: the description of the
    robot when it made the clean logs, if it differed. material: odometry error from which on an effect matters.
    Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    check_seen(robot, logs, held_out, clean)
    with must_fit(robot):
        good, usual, robot_before = None, None, without(before or robot, SampleJitter)
        if clean:
            good = linearise(robot_before, clean)
            usual, good = Usual(robot_before, good, Shown.by(good)), replace(good, designs=())
            usual.seen.forget()
        search = Search(without(robot, SampleJitter), logs, held_out, clean, good, material)
        search.run()
        as_before = frozenset[str]() if good is None else in_good_order(robot_before, clean, good, search.named)
        return _confirmed(search, usual, as_before)


def unexamined(robot: RobotDescription, logs: Sequence[Log]) -> RobotDiagnosis:
    """Return the diagnosis of logs in which wheels slid so much that nothing is looked for."""
    check_seen(robot, logs)
    with must_fit(robot):
        seen = linearise(robot, logs, among=()).without_designs()
    return Diagnosis(robot, "no discrepancy", (), {}, seen, seen, None, seen.creep)


class _HeldOutLogs:
    """Held-out logs, beside the effects in the model, if there are any.

    pair: their statistics without and with these effects; lacking: without any learned curve, too. confirmed: the log
    Bayes factor of each event in them, or None; released: the steps in which contacts slip freely. mended: the
    statistics with the effects, and with counts lost in bursts (`_mended`). logs: with their wheels `in_phase`.
    """

    def __init__(self, search: Search) -> None:
        self.search, self.released = search, Released()
        self.confirmed: Sequence[float | None] = [None] * len(search.events)
        self.pair: tuple[Linearised, Linearised] | None = None
        self.lacking: Linearised | None = None
        self.mended: Linearised | None = None
        self.logs = list(search.held_out)
        if not self.logs:
            return
        self.logs = in_phase(search.base, self.logs, search.named, creep=search.creep_told, jitter=search.jitter)
        among, found = search.among, search.found
        after = self._linearised(found, among)
        after.forget()
        recurring = search.events
        if len(search.events):
            recurring, confirmed = search.events.in_other_logs(found, self.logs, after)
            self.confirmed, self.released = confirmed, recurring.released(found, self.logs, after)
            after = self._linearised(found, among)
        before = self._linearised(search.base, among) if search.named else after
        self.mended = _mended(found, recurring, self.logs, after, partial(self._linearised, among=(), released=()))
        self.pair = before, after
        self.lacking = before if search.curve is None else self._linearised(search.robot, (), jitter=0.0)

    def beside(self, robot: RobotDescription) -> Linearised:
        """Return the statistics of the logs as made by another robot, of no candidate."""
        if self.pair is not None and robot == self.search.found:
            return self.pair[1]
        return self._linearised(robot, ())

    def _linearised(self, robot: RobotDescription, among: Sequence[Candidate], **options: Any) -> Linearised:
        known = {"creep": self.search.creep_told, "jitter": self.search.jitter, "released": self.released}
        return linearise(robot, self.logs, among=among, own_clocks=True, **known | options)


def _mended(
    robot: RobotDescription, events: Events, logs: Sequence[Log], seen: Linearised, look: Callable[..., Linearised]
) -> Linearised:
    """Return logs linearised with the counts that events lose in bursts, in place of released steps, if they are
    likelier so; else as `seen`: in such steps other wheels slip, too, and odometry is off as if nothing were known."""
    lossy = events.lossy(robot, logs, seen)
    beside = seen if lossy == robot else look(lossy)
    return beside if beside.log_evidence > seen.log_evidence else seen


def _confirmed(search: Search, usual: Usual | None, as_before: frozenset[str]) -> RobotDiagnosis:
    """Return the diagnosis: what was found, as far as held-out logs confirm it, and clean logs do not show it as large.
    as_before: families that these show (`in_good_order`)."""
    robot, base, logs, seen, material = search.robot, search.base, search.logs, search.seen, search.material
    held_out = _HeldOutLogs(search)
    after = None if held_out.pair is None else held_out.pair[1]
    mended = _mended(search.found, search.events, logs, seen, partial(search.linearised, among=(), released=Released()))
    beside = search.events.answers(search.found, logs, seen, held_out.confirmed, encoders_of(search.answers))
    beside += [] if search.jittery is None else [search.jittery]
    beside += [] if search.curve is None else [answer_of(robot, search.curve, logs)]
    if usual is not None:
        beside += noisy_answers(mended, held_out.mended, usual.seen)
        shown = None if held_out.mended is None else Shown.by(held_out.mended)
        beside += reference_answers(robot, usual.robot, logs, mended, shown, usual.reference, search.names)
    called = {name: answer.credible[0] for answer in search.answers for name in answer.alike}
    inclusion = {called.get(name, name): part for name, part in search.posterior.inclusion().items()}

    def with_other_sizes(effects: Sequence[Sized]) -> Linearised | None:
        return fit_with(base, lambda others, *_: held_out.beside(with_effects(base, others)), tuple(effects), seen)

    order = None if after is None else order_of(after, search.good)
    every = [*search.answers, *beside]
    clean_gap = None if search.good is None else search.good.gap
    own, others = (search.plain, replace(seen, errors=mended.errors)), None
    if held_out.pair is not None and held_out.mended is not None:
        others = held_out.pair[0], replace(held_out.pair[1], errors=held_out.mended.errors)
    answers = judged(every, search.named, others, order, material, with_other_sizes, clean_gap, own)
    answers = tuple(
        negligible(answer, f"the clean logs show {answer.candidate.what} as large")
        if answer.candidate.family in as_before
        else answer
        for answer in answers
    )
    lossy = any(answer.verdict == "named" and isinstance(answer.effect, TickLossBursts) for answer in answers)
    after_own, after = own[1] if lossy else seen, after if others is None or not lossy else others[1]
    pair = None
    if held_out.lacking is not None and after is not None:
        pair = held_out.lacking.without_designs(), after.without_designs()
    inclusion = by_all_logs(inclusion, every, answers)
    whole, after_all = weakest(answer.verdict for answer in answers), after_own.without_designs()
    known = search.creep_told, tuple(held_out.logs), clean_gap
    diagnosis = Diagnosis(robot, whole, answers, inclusion, search.plain, after_all, pair, *known)
    return diagnosis if pair is None else _with_dimensions(diagnosis, search, held_out)


def _with_dimensions(diagnosis: RobotDiagnosis, search: Search, held_out: _HeldOutLogs) -> RobotDiagnosis:
    """Return a diagnosis with the dimensions as they are guessed together, and sizes of named ones beside these, if the
    guess shrinks the gap of held-out logs, and if any dimension is in a credible set, or all together are as likely off
    as what is in one; where nothing else that matters is missing, they are an answer then. Guessed is by all poses of
    the reference, and by fewer (`far_apart`): of both, what leaves the smaller gap stays."""
    guesses = [None if of is None else _guessed(diagnosis, of) for of in (search, search.with_fewer_poses())]
    found = [guess for guess in guesses if guess is not None]
    if not found:
        return diagnosis
    before, left = held_out.beside(diagnosis.found), list[tuple[float, RobotDiagnosis]]()
    for guess in found:
        after = held_out.beside(guess.found)
        if after.gap and gap_shrinks(before, after, search.material) and not gap_grows(before, after, search.material):
            left.append((in_units(after.gap, search.material), guess))
    return min(left, key=itemgetter(0), default=(0.0, diagnosis))[1]


def _guessed(diagnosis: RobotDiagnosis, search: Search) -> RobotDiagnosis | None:
    """Return a diagnosis with the dimensions as they are guessed together; None if there is no reason to."""
    seen, material = search.seen, search.material
    built, in_model = dimensions_of(search.robot, seen), (*search.begin, *search.named)
    sizes = {effect.candidate: effect for effect in in_model}
    named = [sizes.get(of.candidate, of) for of in diagnosis.sized if of.candidate in seen.columns]
    certain = {effect.candidate for effect in named}
    others = [sizes.get(effect.candidate, effect) for effect in built if effect.candidate not in certain]
    guess = guessed(search.base, search.look, seen, search.good, others, named)
    if guess is None:
        return None
    told = tuple(one for one in guess.dimensions if one.matters(seen, material))
    log_odds = guess.log_factor + search.odds
    answered = any(effect.candidate.family in answer.credible for effect in built for answer in diagnosis.answers)
    if not answered and (log_odds < LOG_ODDS or not told):
        return None
    dimensions = {effect.candidate for effect in built}
    beside = {one.sized.candidate: one for one in guess.named if one.sized.candidate in dimensions}
    answers = [
        answer
        if (one := beside.get(answer.candidate)) is None
        else replace(answer, amplitudes=one.sized.amplitudes, covariance=np.diag(one.error**2))
        for answer in diagnosis.answers
    ]
    inclusion = diagnosis.inclusion
    if not answered and all(answer.verdict == "negligible" for answer in answers):
        answers.append(either_of(told, seen, log_odds))
        inclusion = inclusion | {name: answers[-1].probabilities[name] for name in answers[-1].credible}
    whole = weakest(answer.verdict for answer in answers)
    return replace(diagnosis, verdict=whole, answers=tuple(answers), inclusion=inclusion, dimensions=told)
