"""The finder on one page: fit states, linearise, compute the posterior, add the named effects to the model, and repeat
until the names stay the same; then confirm on held-out logs.

How much of each effect robots in good order show, differently in each log, comes from tolerances, and from clean logs
where there are any (`priors`); a fault has to exceed that. The result is a probability of every name, and a verdict
that follows from it (`verdicts`).
"""

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic

import numpy as np
from threadpoolctl import threadpool_limits

from castor_envs.effects.clocks import SampleJitter
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, without
from discrepancy.posterior.answers import Answer, Cause, Place, Seen, Verdict, answers_of
from discrepancy.posterior.calibrated import LOG_ODDS, SIGNATURE, prior_log_odds
from discrepancy.posterior.dimensions import Dimension, dimensions_of, guessed, most_likely
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import hypotheses_of, order_of
from discrepancy.posterior.random_effects import GoodOrder, agreeing
from discrepancy.posterior.refit import (
    Look,
    S,
    Sized,
    V,
    exchanged,
    families_of,
    fit_with,
    in_place_of,
    possible,
    refitted,
    sizes_of,
    statistics_of,
    with_effects,
)
from discrepancy.posterior.single_effects import Hypothesis, Posterior, SingleEffects
from discrepancy.posterior.variances.events import Events, Released
from discrepancy.posterior.variances.jitter import jitter_answer
from discrepancy.posterior.variances.late import late_encoders
from discrepancy.posterior.variances.learned import answer_of, encoders_of, helps, learned
from discrepancy.posterior.variances.lost import lossy_encoders
from discrepancy.posterior.variances.noise_excess import noise_of, noisy_answers
from discrepancy.posterior.verdicts import MATERIAL, Material, gap_grows, gap_shrinks, judged, verdict_of
from discrepancy.validation.cost import WAY
from discrepancy.validation.sufficient import check_seen, must_fit

LOOKS = 6
"""Most rounds in which the posterior of all candidates is computed beside the effects named before."""

BESIDE = 2
"""Number of likeliest effects, beside those in the model, that are fitted while the noise is estimated: until it is in
the model, an effect counts as noise, and may hide itself."""

SECOND = 0.2
"""Least part of the deviance explained by the largest new effect that another new effect must explain to enter the
model in the same round; if the set of effects is then one tried before, all new effects enter."""


Asked = tuple[Posterior, list[Answer]]
"""A posterior over all hypotheses, and the answers that it gives."""


@dataclass(frozen=True, eq=False)
class Diagnosis(Generic[V, S]):
    """The effects missing in a description, as logs show them. verdict: of the whole; answers: the most certain first.

    before, after: the logs linearised without and with the named effects and learned curves; held_out: both for
    held-out logs. inclusion: probability of every name to be among the missing effects. creep: factor of predicted
    creep under forces in clean logs, if there are any.
    """

    robot: V
    verdict: Verdict
    answers: tuple[Answer, ...]
    inclusion: dict[str, float]
    before: S
    after: S
    held_out: tuple[S, S] | None
    creep: float | None = None
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


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def diagnose(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log] = (),
    clean: Sequence[Log] = (),
    before: RobotDescription | None = None,
    material: Material = MATERIAL,
) -> Diagnosis[RobotDescription, Linearised]:
    """Return the effects that a robot's description is missing, their probabilities, and their costs in use.

    held_out: logs that must confirm a name. clean: logs of the robot in good order. before: the description of the
    robot when it made the clean logs, if it differed. material: odometry error from which on an effect matters.
    Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    check_seen(robot, logs, held_out, clean)
    with must_fit(robot):
        return _diagnosed(without(robot, SampleJitter), logs, held_out, clean, before, material)


def unexamined(robot: RobotDescription, logs: Sequence[Log]) -> Diagnosis[RobotDescription, Linearised]:
    """Return the diagnosis of logs in which wheels slid so much that nothing is looked for."""
    check_seen(robot, logs)
    with must_fit(robot):
        seen = linearise(robot, logs, among=()).without_designs()
    return Diagnosis(robot, "no discrepancy", (), {}, seen, seen, None, seen.creep)


def _diagnosed(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log],
    clean: Sequence[Log],
    before: RobotDescription | None,
    material: Material,
) -> Diagnosis[RobotDescription, Linearised]:
    """Compute the diagnosis that `diagnose` returns, of checked logs."""
    good, usual = None, None
    if clean:
        good = linearise(without(before or robot, SampleJitter), clean)
        usual, good = noise_of(good), replace(good, designs=())
    creep = None if good is None else good.creep
    places = () if good is None else tuple(candidate for candidate in good.candidates if candidate.at_a_place)
    events, released, base, curve, looked = Events(), Released(), robot, None, False
    plain = linearise(base, logs, creep=creep, places=places)
    names = len({hypothesis.name for hypothesis in hypotheses_of(base, plain)[0]})
    jittery = jitter_answer(robot, logs, held_out, clean, names)
    jitter = 0.0 if jittery is None or jittery.unnamed else jittery.size

    def look(named: Sequence[Sized], start: Linearised, among: Sequence[Cause] | None) -> Linearised:
        known = [effect.candidate for effect in named if isinstance(effect.candidate, Candidate)]
        extra = () if among is not None else tuple(dict.fromkeys((*places, *known, *somewhere)))
        only = None if among is None else [candidate for candidate in among if isinstance(candidate, Candidate)]
        mended = with_effects(base, named)
        return linearise(
            mended, logs, start=start, creep=creep, among=only, places=extra, released=released, jitter=jitter
        )

    def ask(seen: Linearised, named: Sequence[Sized], without: Collection[str]) -> Asked:
        try:
            hypotheses = hypotheses_of(base, seen, {effect.candidate for effect in named})
            return asked(seen, *hypotheses, order_of(seen, good), sizes_of(named, seen), without=without)
        finally:
            seen.forget()

    def depends(changed: RobotDescription, among: Sequence[Candidate]) -> Linearised:
        return linearise(changed, logs, start=seen, creep=creep, among=among, released=released, jitter=jitter)

    def afresh(effects: Sequence[Sized]) -> Linearised:
        changed = with_effects(base, effects)
        return linearise(changed, logs, creep=creep, places=places, released=released, jitter=jitter)

    mounted = np.zeros(2) if good is None else good.state.mount[:2]

    def displaced(seen: Linearised) -> float:
        return float(np.hypot(*(seen.state.mount[:2] - mounted))) / max(material.position, 1e-12)

    def hidden(seen: Linearised) -> bool:
        """Whether what passes for noise of contacts costs more than matters, and may be an effect."""
        return float(np.hypot(seen.noise.along, seen.noise.across)) * WAY**0.5 > material.position

    begin, tried = most_likely(robot, logs, plain), frozenset[str]()
    first = afresh(begin) if jitter or begin else plain
    plain = plain.without_designs()
    while True:
        somewhere = tuple(candidate for candidate in first.candidates if candidate.at_a_place)
        named, seen, posterior, answers = named_together(base, look, ask, first, begin, displaced)
        found = with_effects(base, named)
        odds = prior_log_odds(names)
        if extended := events.extended(found, logs, seen, good, answers, names):
            new = late_encoders(robot, logs, seen, extended.faulty[len(events.faulty) :])
            if new and (late := exchanged(base, look, named, (), seen, new, odds)):
                begin = late[0]
                first = afresh(begin)
                continue
            events, released = extended, extended.released(found, logs, seen)
            first = afresh(begin)
            continue
        better = None
        while better is None and (
            lossy := lossy_encoders(found, logs, seen, LOG_ODDS - odds, tried | families_of(named))
        ):
            tried |= families_of(lossy)
            better = exchanged(base, look, named, (), seen, lossy, odds)
        if better is not None:
            begin = better[0]
            first = afresh(begin)
            continue
        if not (begin or named) and seen.redundant and hidden(seen):
            more = most_explaining(base, posterior.names, seen, named)
            if better := exchanged(base, look, named, (), seen, more, odds):
                begin = better[0]
                first = afresh(begin)
                continue
        if looked or not (channels := encoders_of(answers)):
            break
        looked, curve = True, learned(found, logs, seen, channels, depends)
        if curve is None or (held_out and not helps(found, curve, held_out, creep)):
            curve = None
            break
        base = robot.with_effects(curve.effect)
        first = afresh(begin)
    held, lacking, order, confirmed, free = None, None, None, [None] * len(events), Released()
    if held_out:
        among = [effect.candidate for effect in named if isinstance(effect.candidate, Candidate)]
        after = linearise(found, held_out, creep=creep, among=among, jitter=jitter, own_clocks=True)
        after.forget()
        if len(events):
            recurring, confirmed = events.in_other_logs(found, held_out, after)
            free = recurring.released(found, held_out, after)
            after = linearise(found, held_out, creep=creep, among=among, released=free, jitter=jitter, own_clocks=True)
        plainly = linearise(base, held_out, creep=creep, among=among, released=free, jitter=jitter) if named else after
        held = plainly, after
        lacking = held[0] if curve is None else linearise(robot, held_out, creep=creep, among=(), released=free)
        order = order_of(after, good)

    def in_held_out(vehicle: RobotDescription) -> Linearised:
        if held is not None and vehicle == found:
            return held[1]
        return linearise(vehicle, held_out, creep=creep, among=(), released=free, jitter=jitter, own_clocks=True)

    beside = [
        *events.answers(found, logs, seen, confirmed, encoders_of(answers)),
        *([] if jittery is None else [jittery]),
    ]
    beside += [] if curve is None else [answer_of(robot, curve, logs)]
    beside += noisy_answers(seen, None if held is None else held[1], usual)
    inclusion = {answer.credible[0]: answer.probability for answer in beside} | posterior.inclusion()
    called = {name: answer.credible[0] for answer in answers for name in answer.alike}
    inclusion = {called.get(name, name): probability for name, probability in inclusion.items()}
    answers = [*answers, *beside]

    def with_other_sizes(effects: Sequence[Sized]) -> Linearised | None:
        return fit_with(base, lambda others, *_: in_held_out(with_effects(base, others)), tuple(effects), seen)

    answers = judged(answers, named, held, order, material, with_other_sizes)
    held = None if held is None or lacking is None else (lacking.without_designs(), held[1].without_designs())
    diagnosis = Diagnosis(robot, verdict_of(answers), answers, inclusion, plain, seen.without_designs(), held, creep)
    built = dimensions_of(robot, seen)
    if not held_out or not any(effect.candidate.family in answer.credible for effect in built for answer in answers):
        return diagnosis
    of_model = {effect.candidate: effect for effect in (*begin, *named)}
    built = [of_model.get(effect.candidate, effect) for effect in built]
    others = [effect for effect in diagnosis.sized if effect.candidate not in {one.candidate for one in built}]
    together = [one for one in guessed(look, seen, good, built, others) if one.matters(seen, material)]
    changed = replace(diagnosis, dimensions=tuple(together))

    pair = in_held_out(diagnosis.found), in_held_out(changed.found)
    return changed if gap_shrinks(*pair, material) and not gap_grows(*pair, material) else diagnosis


def named_together(
    vehicle: Any,
    look: Look[S],
    ask: Callable[[S, Sequence[Sized], Collection[str]], Asked],
    first: S,
    begin: Sequence[Sized] = (),
    displaced: Callable[[S], float] = lambda seen: 0.0,
) -> tuple[tuple[Sized, ...], S, Posterior, list[Answer]]:
    """Add the effects that the answers name to the model until the names stay the same; return these effects, the
    statistics beside them, the posterior and the answers.

    first: statistics of the logs with the effects `begin` in the model; displaced: see `exchanged`. ask: returns the
    posterior without hypotheses of some families. The posterior compares effects by signatures, which are wrong of
    large ones, so that an effect which takes the place of another, or may do so, is refused if fits with both in turn
    are at odds with that.
    """
    seen, named, refused, compared = first, tuple(begin), set[tuple[str, str]](), frozenset[str]()
    tried = [families_of(named)]
    while True:
        in_model = families_of(named)
        posterior, answers = ask(seen, named, {new for old, new in refused if old in {*in_model, ""}})
        odds = prior_log_odds(len(posterior.names))
        for least in (SECOND, 0.0):
            new = _taken_in(vehicle, answers, named, least)
            families = families_of(new)
            if families not in tried:
                break
        if len(tried) > LOOKS:
            return named, seen, posterior, answers
        if families not in tried:
            tried.append(families)
            better = refitted(vehicle, look, named, new, seen)
            if families_of(better[0]) == in_model < families:  # with no part of the new ones the logs are as likely
                refused |= {("", new) for new in families - in_model}
                continue
            if unlikely := _unlikely(named, seen, *better, odds):
                refused |= unlikely
                continue
        else:
            if in_model != compared:
                compared, unlikely = in_model, set[tuple[str, str]]()
                for rival in _ambiguous(answers, named, seen):
                    fit = refitted(vehicle, look, named, rival, seen, seen.log_evidence - LOG_ODDS)
                    unlikely |= _unlikely(named, seen, rival, fit[1] if fit[0] else None, odds)
                if unlikely:
                    refused |= unlikely
                    continue
            more = [] if seen.redundant else most_explaining(vehicle, posterior.names, seen, named)
            same = _same(answers, seen)
            better = exchanged(vehicle, look, named, _large(answers), seen, more, odds, same, displaced)
            if better is None or families_of(better[0]) in tried:  # what is returned belongs to these answers
                return named, seen, posterior, answers
            tried.append(families_of(better[0]))
        named, seen = better
        seen = look(named, seen, None)


def _ambiguous(answers: Sequence[Answer], named: Sequence[Sized], seen: Seen) -> Iterator[tuple[Sized, ...]]:
    """Yield the effects of a model with one exchanged for an effect that these motions may not distinguish from it."""
    causes = _by_family(seen)
    for answer, k in itertools.product(answers, range(len(named))):
        if named[k].candidate == answer.candidate:
            for name in answer.credible:
                if name in causes and name not in families_of(named):
                    yield (*named[:k], in_place_of(named[k], causes[name], seen), *named[k + 1 :])


def _same(answers: Sequence[Answer], seen: Seen) -> dict[Cause, list[Cause]]:
    """Return the effects that are the same as those of answers on this vehicle, whatever it does."""
    causes = _by_family(seen)
    return {answer.candidate: [causes[name] for name in answer.alike if name in causes] for answer in answers}


def _by_family(seen: Seen) -> dict[str, Cause]:
    """Return the candidates of the catalogue by their families."""
    return {cause.family: cause for cause in seen.candidates if cause.kinds}


def _unlikely(
    named: Sequence[Sized], seen: Seen, new: Sequence[Sized], beside: Seen | None, odds: float
) -> set[tuple[str, str]]:
    """Return the families of effects that take the place of others in a model, each with the family of one of these, or
    "" if they only come to it, where logs are so much less likely with them that they are not in the credible set.

    beside: None where the new effects do not fit. odds: prior log odds (natural logarithm) of an effect.
    """
    before, after = families_of(named), families_of(new)
    if beside is not None and seen.log_evidence - beside.log_evidence + odds * (len(named) - len(new)) < LOG_ODDS:
        return set()
    return set(itertools.product(before - after or {""}, after - before))


def most_explaining(vehicle: Any, names: Collection[str], seen: Seen, named: Sequence[Sized]) -> list[Sized]:
    """Return the effects, `BESIDE` of them, that would explain most of what those in the model leave, in the sizes that
    the formula gives; of too few wheels for any to contradict the others also in half and twice these.

    What wheels cannot contradict, as there are too few or as all contacts give way, passes for noise, beside which the
    formula hardly sees it: an effect that explains most of it is as likely as its rivals. If it is much more than
    signatures can be extrapolated by, as a latency of 0.2 s is, only a fit with it in the model shows that. Sizes and
    noise change together, so logs may be likely at sizes far apart, and much less likely between. names: of possible
    answers, of which each stands for all that are the same on this vehicle.
    """
    in_model, explained, found = families_of(named), dict[Sized, float](), list[Sized]()
    for candidate in seen.candidates:
        searched = isinstance(candidate, Candidate) and candidate.at_a_place  # for the place that explains most
        if candidate.kinds and candidate.family in names and candidate.family not in in_model and not searched:
            none = Sized(candidate, np.zeros(candidate.columns))
            information, score = statistics_of([none], seen)
            effect = none.moved(np.asarray(np.linalg.lstsq(information, score, rcond=1e-9)[0], dtype=np.float64))
            gain = score @ effect.amplitudes - effect.amplitudes @ information @ effect.amplitudes / 2
            explained[effect] = float(gain) - candidate.columns / 2  # which noise alone explains
    for effect in sorted(explained, key=explained.__getitem__)[: -BESIDE - 1 : -1]:
        others = () if seen.redundant else (-0.5, 1.0)
        sizes = [effect, *(effect.moved(part * effect.amplitudes) for part in others)]
        found += [sized for sized in sizes if possible(vehicle, [sized]) and np.any(sized.amplitudes)]
    return found


def _large(answers: Sequence[Answer]) -> list[Cause]:
    """Return the effects that explain so much that their linear signatures may be wrong by more than noise, and the
    binary ones: what is there or not is no linear question."""
    return [
        answer.candidate
        for answer in answers
        if answer.explained * SIGNATURE**2 > 1 or any(kind.binary for kind in answer.candidate.kinds)
    ]


def asked(
    seen: Seen,
    hypotheses: Sequence[Hypothesis],
    places: Sequence[Place],
    order: GoodOrder,
    in_model: Array,
    fitted: Array | None = None,
    without: Collection[str] = (),
) -> Asked:
    """Return the posterior over all hypotheses, and the answers that it gives, the most certain first.

    places: the candidate of each hypothesis. order: what robots in good order show. in_model: sizes in the model
    already; fitted: those of them that have their maximum-likelihood size; None: all. without: families of which
    there is no hypothesis.
    """
    kept = [k for k, place in enumerate(places) if seen.candidates[place.candidate].family not in without]
    hypotheses, places = [hypotheses[k] for k in kept], [places[k] for k in kept]
    fitted = in_model if fitted is None else fitted
    single, posterior, score = _posterior(hypotheses, order, seen, in_model, in_model - fitted, fitted)
    reestimated = seen.reestimate_noise(_likeliest(seen, posterior, places, in_model))
    if reestimated is not seen:
        seen = reestimated
        single, posterior, score = _posterior(hypotheses, order, seen, in_model, in_model - fitted, fitted)
    expected = sum((component.mean for component in posterior.components if component.nothing < 0.5), 0 * in_model)
    single, posterior, score = _posterior(hypotheses, order, seen, in_model, expected - fitted, fitted)
    return posterior, answers_of(seen, single, posterior, score, places, in_model)


def _likeliest(seen: Seen, posterior: Posterior, places: Sequence[Place], in_model: Array) -> list[Cause]:
    """Return the likeliest candidate of the catalogue in each component that is of one in the model, and in the most
    certain of the others."""
    named = np.array([bool(seen.candidates[place.candidate].kinds) for place in places])
    best = (int(np.argmax(component.probability * named)) for component in posterior.components)
    causes = list(dict.fromkeys(seen.candidates[places[k].candidate] for k in best))
    fitted = {cause for cause, columns in zip(seen.candidates, seen.columns, strict=True) if np.any(in_model[columns])}
    return [cause for cause in causes if cause in fitted] + [cause for cause in causes if cause not in fitted][:BESIDE]


def _taken_in(vehicle: Any, answers: Sequence[Answer], named: Sequence[Sized], least: float) -> tuple[Sized, ...]:
    """Return the effects to put into the model: those that stay, and new effects that explain at least the part `least`
    of the deviance that the largest new effect explains. A smaller effect may only be the linearisation error of the
    largest."""
    kept = {effect.candidate for effect in named}
    choices = [(answer, Sized(answer.candidate, answer.amplitudes)) for answer in answers if answer.effect is not None]
    choices = [(answer, effect) for answer, effect in choices if possible(vehicle, [effect])]
    largest = max((answer.explained for answer, effect in choices if effect.candidate not in kept), default=0.0)
    return tuple(
        effect for answer, effect in choices if effect.candidate in kept or answer.explained >= least * largest
    )


def _posterior(
    hypotheses: Sequence[Hypothesis], order: GoodOrder, seen: Seen, in_model: Array, far: Array, fitted: Array
) -> tuple[SingleEffects, Posterior, Array]:
    """Return the posterior of hypotheses beyond what robots in good order show, and the score that it comes from.

    in_model: sizes in the model already. far, fitted: sizes that determine the error of signatures
    (`Statistics.doubted`).
    """
    logs = agreeing([log.at(-in_model) for log in seen.logs], seen.lasting)
    logs = [log.doubted(far, fitted) for log in logs]
    beyond = order.beyond(logs)
    single = SingleEffects(hypotheses, beyond.information)
    return single, single.posterior(beyond.score), beyond.score
