"""The search for the effects in the model of a robot: those that are named beside each other, and what its logs show
beside these, from which it begins anew."""

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import replace
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from castor_envs.effects.clocks import SampleJitter
from castor_envs.effects.contact import ContactCreep, SlipStiffness, SlipStiffnessLateral
from castor_envs.effects.encoders import PivotBacklash
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, candidates_of, encoder_of
from discrepancy.posterior.answers import Answer, Cause
from discrepancy.posterior.calibrated import LOG_ODDS, prior_log_odds
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.model.dimensions import dimensions_of, most_likely
from discrepancy.posterior.model.exchange import exchanged
from discrepancy.posterior.model.named_together import (
    BESIDE,
    MOST_SEARCHES,
    Asked,
    asked,
    by_formula,
    most_explaining,
    named_together,
)
from discrepancy.posterior.model.refit import Effects, Sized, families_of, fit_with, refitted, sizes_of, with_effects
from discrepancy.posterior.priors import hypotheses_of, order_of
from discrepancy.posterior.single_effects import Posterior
from discrepancy.posterior.variances.events import Alone, Events, Released
from discrepancy.posterior.variances.jitter import jitter_answer
from discrepancy.posterior.variances.late import late_encoders
from discrepancy.posterior.variances.learned import encoders_of, helps, learned
from discrepancy.posterior.variances.lost import (
    advantage,
    as_one_loss,
    lossy_above,
    lossy_encoders,
    of_same_wheel,
    without_wheels_of_losses,
)
from discrepancy.posterior.variances.slippery import slippery_in
from discrepancy.posterior.verdicts import Material
from discrepancy.validation.cost import WAY
from estimators.likelihood.measurements.poses import far_apart


class Search:
    """Effects in the model of a robot, and what its logs show beside them.

    named, seen, posterior, answers: as `named_together` returns them. slid: families of effects of which nothing is
    said, as wrong wiring drove wheels against each other until they slid. events: at certain times or places, whose
    steps are `released`; alone: those beside no effect. doubted: the encoders, and the families in the model, whose
    faults were looked for. base: the robot with `curve`, if one was learned. jitter: of the times of samples, s.
    creep: factor of predicted creep under forces, if clean logs tell it. good: clean logs, linearised.
    """

    named: Effects
    seen: Linearised
    posterior: Posterior
    answers: list[Answer]

    def __init__(
        self,
        robot: RobotDescription,
        logs: Sequence[Log],
        held_out: Sequence[Log],
        clean: Sequence[Log],
        good: Linearised | None,
        material: Material,
    ) -> None:
        self.robot = self.base = robot
        self.logs, self.held_out, self.good, self.material = logs, held_out, good, material
        self.creep = good.creep if good is not None and good.shared.told else None
        self.places = () if good is None else _at_places(good)
        self.events, self.released, self.curve = Events(), Released(), None
        self.alone: Alone | None = None
        self.lossy, self.curve_sought = frozenset[str](), False
        self.timed, self.one_loss = set[frozenset[str]](), set[frozenset[str]]()
        self.doubted = set[tuple[frozenset[str], frozenset[str]]]()
        self.slid = _of_contacts(robot) if any(log.undone for log in logs) else frozenset[str]()
        self.plain = linearise(robot, logs, creep=self.creep, places=self.places)
        self.names = len({hypothesis.name for hypothesis in hypotheses_of(robot, self.plain)[0]})
        self.odds = prior_log_odds(self.names)
        self.jittery = jitter_answer(robot, logs, held_out, clean, self.names)
        self.jitter = 0.0  # standard deviation of the times at which encoders are read, s
        if self.jittery is not None and not self.jittery.unnamed:
            period = float(np.median(np.concatenate([np.diff(log.t) for log in logs])))
            self.jitter = float(SampleJitter.deviation(self.jittery.amplitudes, period)[0])
        self.begin: Sequence[Sized] = ()

    def run(self) -> None:
        """Name effects, and begin anew with what else the logs show beside these, until they show nothing else, or for
        `MOST_SEARCHES` times: as more and more of a log is released, what is left looks more and more unusual."""
        first = self.begun()
        looks = [
            self.with_one_loss,
            self.with_events_alone,
            self.without_events,
            self.with_events,
            self.with_fault,
            self.with_lost_counts,
            self.with_hidden,
            self.with_curve,
        ]
        look, events, before, proposed = looks[0], self.events, frozenset[str](), frozenset[str]()
        for left in reversed(range(MOST_SEARCHES)):
            self.somewhere = _at_places(first)
            self.named, self.seen, self.posterior, self.answers = named_together(
                self.base, self.look, self.ask, first, self.begin, self.displaced
            )
            if not left:
                return
            if events is self.events and proposed != before == families_of(self.named):
                looks.remove(look)  # what it proposed was not kept, and the like would not be
            events, before = self.events, families_of(self.named)
            look, begin = next(((look, begin) for look in looks if (begin := look()) is not None), (look, None))
            if begin is None:
                return
            self.begin, proposed = begin, families_of(begin)
            first = self.afresh()

    def begun(self) -> Linearised:
        """Return the statistics to begin with: beside dimensions that calibration finds if these make logs likelier."""
        first = self.afresh() if self.jitter else self.plain
        if built := most_likely(self.robot, self.logs, self.plain):
            without, self.begin = first, built
            first = self.afresh()
            if first.log_evidence <= without.log_evidence + LOG_ODDS:  # none of them would be named
                first, self.begin = without, ()
        self.plain = self.plain.without_designs()
        if self.begin:
            return first
        known = self.robot, self.logs, first, self.good, self.names
        self.alone = Alone.found(*known)
        sliding = Alone.sliding(*known, self.alone)
        if sliding is None or not self._explained_by(sliding, first):
            return first
        patch = slippery_in(self.robot, self.logs, first, self.names)
        self.events, self.alone = sliding.events if patch is None else Events(patch=patch, looked=True), None
        self.released = self.events.released(self.robot, self.logs, first)
        return self.afresh()

    def _explained_by(self, alone: Alone, first: Linearised) -> bool:
        """Whether the logs are likelier with events beside no effect than with any of the `BESIDE` likeliest effects:
        fits with these do not converge where contacts slide freely."""
        least = self.linearised(self.robot, released=alone.released, start=first, among=()).log_evidence - LOG_ODDS
        if least <= first.log_evidence:
            return False
        single = sorted((by_formula(one, first) for one in first.candidates if one.kinds), key=itemgetter(1))
        fits = (fit_with(self.base, self.look, (effect,), first) for effect, _ in single[-BESIDE:])
        return all(fit is None or fit.log_evidence < least for fit in fits)

    @property
    def found(self) -> RobotDescription:
        """The robot with the effects in the model."""
        return with_effects(self.base, self.named)

    @property
    def creep_told(self) -> float | None:
        """The factor of predicted creep as clean logs tell it, or else the logs beside the effects in the model; None
        if these do not."""
        told_here = self.creep is None and self.seen.shared.told
        return self.seen.creep if told_here else self.creep

    @property
    def among(self) -> list[Candidate]:
        """The candidates in the model."""
        return [effect.candidate for effect in self.named if isinstance(effect.candidate, Candidate)]

    def afresh(self) -> Linearised:
        """Return the statistics beside the effects to begin with, the states fitted from the readings."""
        known = (effect.candidate for effect in self.begin if isinstance(effect.candidate, Candidate))
        return self.linearised(with_effects(self.base, self.begin), places=tuple(dict.fromkeys((*self.places, *known))))

    def look(self, named: Sequence[Sized], start: Linearised, among: Sequence[Cause] | None) -> Linearised:
        """Return the statistics beside effects; see `refit.Look`."""
        known = [effect.candidate for effect in named if isinstance(effect.candidate, Candidate)]
        extra = () if among is not None else tuple(dict.fromkeys((*self.places, *known, *self.somewhere)))
        only = None if among is None else [candidate for candidate in among if isinstance(candidate, Candidate)]
        return self.linearised(with_effects(self.base, named), start=start, among=only, places=extra)

    def linearised(self, robot: RobotDescription, **options: Any) -> Linearised:
        """Return the statistics of the logs as made by a robot; options: of `linearise`.

        Where shafts are within a backlash has several likely answers, and a fit keeps the one that it begins with: it
        is begun from the readings, too, and the likelier fit stays.
        """
        at: dict[str, Any] = {"creep": self.creep, "released": self.released, "jitter": self.jitter} | options
        found = linearise(robot, self.logs, **at)
        if at.get("start") is None or not any(isinstance(effect, PivotBacklash) for effect in robot.effects):
            return found
        return max(found, linearise(robot, self.logs, **dict(at, start=None)), key=attrgetter("log_evidence"))

    def with_fewer_poses(self) -> "Search | None":
        """Return the search as it stands, by logs with fewer reference poses (`far_apart`), and with the dimensions
        that calibration finds by these; None where encoders contradict each other, and tell dimensions themselves,
        where no log has more poses, or where logs do not fit so."""
        sparse = copy(self)
        sparse.logs = [far_apart(log) for log in self.logs]
        if self.seen.redundant or all(fewer is log for fewer, log in zip(sparse.logs, self.logs, strict=True)):
            return None
        calibrated = {effect.candidate: effect for effect in most_likely(self.robot, sparse.logs, self.seen)}
        sparse.named = tuple(({effect.candidate: effect for effect in self.named} | calibrated).values())
        built = [effect.candidate for effect in dimensions_of(self.robot, self.seen)]
        try:
            sparse.seen = sparse.look(sparse.named, self.seen, list(dict.fromkeys([*built, *self.among])))
        except np.linalg.LinAlgError:
            return None
        return sparse

    def fit(self, effects: Sequence[Sized], among: Sequence[Cause]) -> Linearised | None:
        """Return the statistics beside effects, of these candidates; None if they do not fit at all."""
        return fit_with(self.base, lambda *_: self.look(effects, self.seen, among), tuple(effects), self.seen)

    def ask(self, seen: Linearised, named: Sequence[Sized], without: Collection[str]) -> Asked:
        """Return the posterior and the answers beside effects; see `named_together`."""
        try:
            hypotheses = hypotheses_of(self.base, seen, {effect.candidate for effect in named})
            order = order_of(seen, self.good)
            return asked(seen, *hypotheses, order, sizes_of(named, seen), without={*without, *self.slid})
        finally:
            seen.forget()

    def displaced(self, seen: Linearised) -> float:
        """Return how far the reference is mounted from where clean logs show it, or from the middle; see
        `exchanged`."""
        mounted = np.zeros(2) if self.good is None else self.good.state.mount[:2]
        return float(np.hypot(*(seen.state.mount[:2] - mounted))) / max(self.material.position, 1e-12)

    def with_events(self) -> Sequence[Sized] | None:
        """Return the effects to begin anew with where contacts slip at certain times or places, or an encoder that is
        late or loses counts makes it seem so; None if nothing does."""
        found, before = self.found, self.events.faulty
        extended = self.events.extended(found, self.logs, self.seen, self.good, self.answers, self.names)
        if extended is None:
            return None
        released = extended.released(found, self.logs, self.seen)
        new = [fault for fault in extended.faulty if all(fault is not known for known in before) and fault.of_others]
        instead = [*late_encoders(self.robot, self.logs, self.seen, new), *self.lossy_encoders()]
        if instead and (better := self.likelier(instead)):
            slipping = self.linearised(found, released=released, start=self.seen, among=())
            if better[1].log_evidence > slipping.log_evidence:
                return better[0]
        self.events, self.released = extended, released
        return self.begin

    def with_events_alone(self) -> Sequence[Sized] | None:
        """Return no effects to begin anew with where the logs are likelier with events that they show beside none than
        with the effects in the model, which explain some of what events cause, and hide the rest; None if they are
        not."""
        if self.alone is None or not self.named:
            return None
        alone, self.alone = self.alone, None
        slipping = self.linearised(self.robot, released=alone.released, start=self.seen, among=())
        lossy = self.linearised(alone.lossy, start=self.seen, among=())
        if max(slipping.log_evidence, lossy.log_evidence) <= self.seen.log_evidence + LOG_ODDS:
            return None
        self.events, self.released = alone.events, alone.released
        return ()

    def without_events(self) -> Sequence[Sized] | None:
        """Return the effects in the model, to begin anew with, where the logs are likelier with these alone than with
        events beside them that the reference tells; None if they are not."""
        if not self.named or not self.events.of_reference:
            return None
        alone = self.linearised(self.found, released=Released(), start=self.seen, among=())
        if alone.log_evidence <= self.seen.log_evidence:
            return None
        self.events, self.released = replace(self.events, faulty=()), Released()
        return self.named

    def with_one_loss(self) -> Sequence[Sized] | None:
        """Return the effects to begin anew with where an encoder in the model loses counts above another speed, or both
        ways as one, beside the other effects or all that are not of its wheel; None if none does."""
        in_model = families_of(self.named)
        if in_model in self.one_loss:
            return None
        self.one_loss.add(in_model)
        best, found = 0.0, None
        for named in dict.fromkeys((tuple(self.named), without_wheels_of_losses(self.named))):
            effects = as_one_loss(self.robot, self.logs, named, self.fit)
            if {effect.candidate for effect in effects} == {effect.candidate for effect in self.named}:
                continue
            least = self.seen.log_evidence + advantage(effects, self.named, self.odds)
            fitted, beside = refitted(self.base, self.look, self.named, effects, self.seen, least + best)
            if beside.log_evidence > least + best:
                best, found = beside.log_evidence - least, fitted
        return found

    def with_lost_counts(self) -> Sequence[Sized] | None:
        """Return the effects to begin anew with where a wheel's encoder loses counts at speed; None if none does."""
        while lossy := self.lossy_encoders(self.lossy):
            self.lossy |= families_of(lossy)
            if better := self.likelier(lossy):
                return better[0]
        in_model = families_of(self.named)
        if in_model in self.timed:
            return None
        self.timed.add(in_model)
        effects = lossy_above(self.robot, self.logs, self.named, self.fit, self.odds)
        if effects is None:
            return None
        as_it_is = self.look(self.named, self.seen, self.among)  # its states may not have converged either
        least = advantage(effects, self.named, self.odds)
        best = max(self.seen.log_evidence, as_it_is.log_evidence) + least
        fitted, beside = refitted(self.base, self.look, self.named, effects, self.seen, best)

        def exceeds(than: Linearised, by: float) -> bool:
            """By the motion, too: what gives way fits any speed."""
            of_motion = beside.log_evidence_of_motion - than.log_evidence_of_motion
            return min(beside.log_evidence - than.log_evidence, of_motion) > by

        if beside.log_evidence <= best or not exceeds(as_it_is, least):
            return None
        rival = self.likelier(of_same_wheel(effects[-1], self.named, self.seen))
        if rival is None or exceeds(rival[1], advantage(effects, effects, self.odds)):
            return fitted
        return rival[0]

    def lossy_encoders(self, besides: Collection[str] = ()) -> list[Sized]:
        """Return the loss of counts that the logs show best beside the effects in the model, if they show one; besides:
        families that are not considered."""
        known = families_of(self.named) | set(besides)
        return lossy_encoders(self.found, self.logs, self.seen, LOG_ODDS - self.odds, known)

    def with_fault(self) -> Sequence[Sized] | None:
        """Return the effects to begin anew with where an encoder of which the answers have an unnamed alternative has a
        fault of the catalogue, so large that its signature hardly shows it; None if it has none."""
        doubted, in_model = frozenset(encoders_of(self.answers)), families_of(self.named)
        if not doubted or (doubted, in_model) in self.doubted:
            return None
        self.doubted.add((doubted, in_model))
        faults = [
            candidate
            for candidate in self.seen.candidates
            if candidate.kinds
            and candidate.family not in in_model
            and encoder_of(self.robot, candidate.kinds[0]) in doubted
        ]
        if not faults:
            return None
        as_it_is = self.look(self.named, self.seen, self.among)  # its states may not have converged either
        best, found = max(self.seen.log_evidence, as_it_is.log_evidence) + LOG_ODDS - self.odds, None
        for candidate in faults:
            effects = (*self.named, by_formula(candidate, self.seen)[0])
            fitted, beside = refitted(self.base, self.look, self.named, effects, self.seen, best)
            if len(fitted) == len(effects) and beside.log_evidence > best:
                best, found = beside.log_evidence, fitted
        if found is not None and len(self.events):  # the fault may be what seemed to happen at certain times
            alone = self.linearised(with_effects(self.base, found), released=Released(), start=self.seen, among=())
            if alone.log_evidence > best:
                self.events, self.released = Events(), Released()
        return found

    def with_hidden(self) -> Sequence[Sized] | None:
        """Return the effects to begin anew with where what passes for noise of contacts costs more than matters, and is
        likelier an effect; None if it is not."""
        slip = float(np.hypot(self.seen.noise.along, self.seen.noise.across)) * WAY**0.5
        if self.begin or self.named or not self.seen.redundant or slip <= self.material.position:
            return None
        better = self.likelier(most_explaining(self.base, self.posterior.names, self.seen, self.named))
        return None if better is None else better[0]

    def with_curve(self) -> Sequence[Sized] | None:
        """Return the effects to begin anew with beside a curve that explains an unnamed alternative; None if none
        does. It is sought once."""
        channels = [] if self.curve_sought else encoders_of(self.answers)
        if not channels:
            return None
        self.curve_sought, found = True, self.found

        def look(changed: RobotDescription, among: Sequence[Candidate]) -> Linearised:
            return self.linearised(changed, start=self.seen, among=among)

        def held_out(changed: RobotDescription) -> Linearised:
            known = {"creep": self.creep_told, "jitter": self.jitter}
            return linearise(changed, self.held_out, among=(), own_clocks=True, **known)

        curve = learned(found, self.logs, self.seen, channels, look)
        if curve is None or (self.held_out and not helps(found, curve, held_out)):
            return None
        self.curve, self.base = curve, self.robot.with_effects(curve.effect)
        return self.begin

    def likelier(self, more: Sequence[Sized]) -> tuple[Sequence[Sized], Linearised] | None:
        """Return effects with one of `more`, with which logs are likelier than with those in the model, and the
        statistics beside them; None if they are with none."""
        return exchanged(self.base, self.look, self.named, None, self.seen, more, self.odds)


def _of_contacts(robot: RobotDescription) -> frozenset[str]:
    """Return the families of effects on how contacts give way to forces."""
    kinds = SlipStiffness, SlipStiffnessLateral, ContactCreep
    return frozenset(candidate.family for candidate in candidates_of(robot) if isinstance(candidate.kinds[0], kinds))


def _at_places(seen: Linearised) -> tuple[Candidate, ...]:
    """Return the candidates that depend on a place, at the place that was found for each."""
    return tuple(candidate for candidate in seen.candidates if candidate.at_a_place)
