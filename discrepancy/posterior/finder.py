"""The finder on one page: fit states, linearise, posterior, name, and again until the names stay; then confirm.

What robots in good order show of each effect, differently in each log, is told by tolerances, and by clean logs where
there are any (`priors`); an effect has to stand out of that. What comes out is a probability of every name, and a
verdict that follows from it (`verdicts`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np
from threadpoolctl import threadpool_limits

from castor_envs.effects.clocks import SampleJitter
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, without
from discrepancy.measurement.creep_prediction import CREEPS
from discrepancy.posterior.answers import Answer, Cause, Place, Seen, Verdict, answers_of
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import hypotheses_of, order_of, sizes_of
from discrepancy.posterior.random_effects import GoodOrder
from discrepancy.posterior.refit import Look, S, Sized, V, possible, refitted, with_them
from discrepancy.posterior.single_effects import Hypothesis, Posterior, SingleEffects
from discrepancy.posterior.variances.events import Events, Released
from discrepancy.posterior.variances.jitter import jitter_answer
from discrepancy.posterior.variances.learned import answer_of, encoders_of, helps, learned
from discrepancy.posterior.verdicts import MATERIAL, Material, judged, verdict_of
from discrepancy.validation.sufficient import check_seen, must_fit

LOOKS = 6
"""Times that all candidates are looked at, at most, beside what has been named by then."""

BESIDE = 2
"""Effects beside which the size of noise is found."""

SECOND = 0.2
"""Part of what the largest new effect explains that another must, to be put into the model in the same round; where
that leads nowhere new, all are."""

WORSE = 0.5
"""By how much (natural logarithm, for every sample) logs may be less likely and count as explained no worse: creep is
predicted anew from what truly happened, so some is lost and won by chance."""


Asked = tuple[Posterior, list[Answer]]
"""What may be there, and the answers that this gives."""


@dataclass(frozen=True, eq=False)
class Diagnosis(Generic[V, S]):
    """What logs say is missing in a description. verdict: of all answers, the most certain first.

    before, after: what is left of the logs without and with the effects in `answers` that have a name; held_out: the
    same of held-out logs. inclusion: probability of every name to be among what is missing. creep: parts of predicted
    creep in clean logs, if there are any.
    """

    robot: V
    verdict: Verdict
    answers: tuple[Answer, ...]
    inclusion: dict[str, float]
    before: S
    after: S
    held_out: tuple[S, S] | None
    creep: Array | None = None

    @property
    def found(self) -> V:
        """The robot, or the train, with the effects that are named, and what was learned of what has no name."""
        named = [
            answer
            for answer in self.answers
            if answer.learned or (answer.verdict == "named" and answer.effect is not None)
        ]
        return with_them(self.robot, [Sized(answer.candidate, answer.amplitudes) for answer in named])


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def diagnose(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log] = (),
    clean: Sequence[Log] = (),
    before: RobotDescription | None = None,
    material: Material = MATERIAL,
) -> Diagnosis[RobotDescription, Linearised]:
    """Return what logs say is missing in a robot's description, how likely it is, and what it costs.

    held_out: logs that a name must be borne out by. clean: logs of the robot in good order. before: the robot as it
    made these, if its description was another. material: what matters.
    Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    check_seen(robot, logs, held_out, clean)
    with must_fit(robot):
        return _diagnosed(without(robot, SampleJitter), logs, held_out, clean, before, material)


def _diagnosed(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log],
    clean: Sequence[Log],
    before: RobotDescription | None,
    material: Material,
) -> Diagnosis[RobotDescription, Linearised]:
    """Return what `diagnose` does."""
    good = linearise(without(before or robot, SampleJitter), clean) if clean else None
    creep = None if good is None else good.parts
    places = () if good is None else tuple(candidate for candidate in good.candidates if candidate.at_a_place)
    events, released, base, curve, looked = Events(), Released(), robot, None, False

    def look(named: Sequence[Sized], start: Linearised, among: Sequence[Cause] | None) -> Linearised:
        mine = [one.candidate for one in named if isinstance(one.candidate, Candidate)]
        more = () if among is not None else tuple(dict.fromkeys((*places, *mine, *somewhere)))
        only = None if among is None else [one for one in among if isinstance(one, Candidate)]
        mended = with_them(base, named)
        return linearise(mended, logs, start=start, creep=creep, among=only, places=more, released=released)

    def ask(seen: Linearised, named: Sequence[Sized]) -> Asked:
        candidates = [seen.candidates.index(one.candidate) for one in named]  # type: ignore[arg-type]
        there = sizes_of(
            candidates, [one.amplitudes for one in named], seen.parts[CREEPS + len(base.effects) :].tolist(), seen
        )
        return asked(seen, *hypotheses_of(base, seen), order_of(seen, good), there)

    def depends(changed: RobotDescription, among: Sequence[Candidate]) -> Linearised:
        return linearise(changed, logs, start=seen, creep=creep, among=among, released=released)

    worse, plain = WORSE * sum(len(log) for log in logs), None
    while True:
        first = linearise(base, logs, creep=creep, places=places, released=released)
        somewhere = tuple(candidate for candidate in first.candidates if candidate.at_a_place)
        plain = plain or first
        named, seen, posterior, answers = named_together(base, look, ask, worse, first)
        found, names = with_them(base, named), len(posterior.names)
        if more := events.more(found, logs, seen, good, answers, names):
            events, released = more, more.released(found, logs, seen)
            continue
        if looked or not (channels := encoders_of(answers)):
            break
        looked, curve = True, learned(found, logs, seen, channels, depends)
        if curve is None or (held_out and not helps(found, curve, held_out, creep)):
            curve = None
            break
        base = robot.with_effects(curve.effect)
    held, order, confirmed = None, None, [None] * len(events)
    if held_out:
        among = [one.candidate for one in named if isinstance(one.candidate, Candidate)]
        after, free = linearise(found, held_out, creep=creep, among=among), Released()
        if len(events):
            there, confirmed = events.there(found, held_out, after)
            free = there.released(found, held_out, after)
            after = linearise(found, held_out, creep=creep, among=among, released=free)
        held = linearise(base, held_out, creep=creep, among=among, released=free), after
        order = order_of(after, good)
    late = jitter_answer(robot, logs, held_out, clean, names)
    beside = [*events.answers(found, logs, seen, confirmed), *([] if late is None else [late])]
    beside += [] if curve is None else [answer_of(robot, curve, logs)]
    inclusion = {answer.credible[0]: answer.probability for answer in beside} | posterior.inclusion()
    answers = [*answers, *beside]
    told = judged(answers, named, held, order, material)
    return Diagnosis(robot, verdict_of(told), told, inclusion, plain, seen, held, creep)


def named_together(
    vehicle: Any, look: Look[S], ask: Callable[[S, Sequence[Sized]], Asked], worse: float, first: S
) -> tuple[tuple[Sized, ...], S, Posterior, list[Answer]]:
    """Return the effects that the answers name, put into the model until names stay, and what is seen and said then.

    first: what logs say without any; worse: see `refitted`.
    """
    seen, tried = first, [frozenset[str]()]
    named: tuple[Sized, ...] = ()
    while True:
        posterior, answers = ask(seen, named)
        for least in (SECOND, 0.0):
            new = _taken_in(vehicle, answers, named, least)
            families = frozenset(one.candidate.family for one in new)
            if families not in tried:
                break
        if families in tried or len(tried) > LOOKS:
            return named, seen, posterior, answers
        tried.append(families)
        named, seen = refitted(vehicle, look, worse, named, new, seen)
        seen = look(named, seen, None)


def asked(
    seen: Seen,
    hypotheses: Sequence[Hypothesis],
    places: Sequence[Place],
    order: GoodOrder,
    there: Array,
    fitted: Array | None = None,
) -> Asked:
    """Return the posterior of all that may be there, and the answers that it gives, the most certain first.

    places: what each hypothesis is about. order: what is seen in good order. there: sizes in the model already; fitted:
    those of them that are as large as logs ask for; None: all.
    """
    fitted = there if fitted is None else fitted
    single, posterior, score = _posterior(hypotheses, order, seen, there, there - fitted, fitted)
    quiet = seen.quieter(_likeliest(seen, posterior, places))
    if quiet is not seen:
        seen = quiet
        single, posterior, score = _posterior(hypotheses, order, seen, there, there - fitted, fitted)
    believed = np.sum([component.mean for component in posterior.components], axis=0)
    single, posterior, score = _posterior(hypotheses, order, seen, there, believed - fitted, fitted)
    return posterior, answers_of(seen, single, posterior, score, places)


def _likeliest(seen: Seen, posterior: Posterior, places: Sequence[Place]) -> list[Cause]:
    """Return the candidate of the catalogue that is likeliest in each of the most certain components."""
    named = np.array([bool(seen.candidates[place.candidate].kinds) for place in places])
    best = (int(np.argmax(component.probability * named)) for component in posterior.components[:BESIDE])
    return list(dict.fromkeys(seen.candidates[places[k].candidate] for k in best))


def _taken_in(vehicle: Any, answers: Sequence[Answer], named: Sequence[Sized], least: float) -> tuple[Sized, ...]:
    """Return the effects to put into the model: those that stay, and new ones but for such as explain less than such a
    part of the largest of these, which may be what its linear signature is wrong by."""
    kept = {one.candidate for one in named}
    every = [(answer, Sized(answer.candidate, answer.amplitudes)) for answer in answers if answer.effect is not None]
    every = [(answer, one) for answer, one in every if possible(vehicle, [one])]
    largest = max((answer.explained for answer, one in every if one.candidate not in kept), default=0.0)
    return tuple(one for answer, one in every if one.candidate in kept or answer.explained >= least * largest)


def _posterior(
    hypotheses: Sequence[Hypothesis], order: GoodOrder, seen: Seen, there: Array, far: Array, fitted: Array
) -> tuple[SingleEffects, Posterior, Array]:
    """Return the posterior of hypotheses beside what robots in good order show, and the score that it comes from.

    there: sizes in the model already. far, fitted: sizes that tell how wrong signatures are (`Statistics.doubted`).
    """
    logs = [log.at(-there).doubted(far, fitted) for log in seen.logs]
    beyond = order.beyond(logs)
    single = SingleEffects(hypotheses, beyond.information)
    return single, single.posterior(beyond.score), beyond.score
