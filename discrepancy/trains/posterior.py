"""The finder for trains: the posterior of single robots (`posterior.finder`), given the statistics of logs of trains.

The motion is fitted first; about it every candidate acts linearly (`linearise`). Noise of gauges, which has mean 0, and
sensors that stop are treated separately (`gauges`).
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit, logit
from threadpoolctl import threadpool_limits

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.answers import Answer, Cause, Place
from discrepancy.posterior.calibrated import FAULT
from discrepancy.posterior.finder import Diagnosis
from discrepancy.posterior.model.named_together import Asked, asked, named_together
from discrepancy.posterior.model.refit import Effects, Sized, sizes_of, with_effects
from discrepancy.posterior.priors import hypothesis_of, order_of, tolerances
from discrepancy.posterior.single_effects import Hypothesis, Posterior
from discrepancy.posterior.verdicts import MATERIAL, Material, by_all_logs, judged, weakest
from discrepancy.trains.candidates import Candidate, dead_gauges, named_candidates, rivals
from discrepancy.trains.gauges import noise_answers, stop_answers, with_dead_gauges
from discrepancy.trains.linearise import Linearised, linearise
from discrepancy.validation.cost import WAY
from estimators.likelihood.trains.bending import half_track
from estimators.likelihood.trains.states import always_sliding, equations_of, sliding_in


@threadpool_limits.wrap(limits=1)
def diagnose_train(
    train: TrainDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log] = (),
    clean: Sequence[Log] = (),
    material: Material = MATERIAL,
) -> Diagnosis[TrainDescription, Linearised]:
    """Return the effects that a train's description is missing, their probabilities, and their costs in use.

    held_out: logs that must confirm a name. clean: logs of the train in good order. material: least error of odometry
    that matters.
    Raises InputError for logs that are not of this train, or that show nothing.
    """
    if not logs:
        raise InputError("there is no log to look at")
    good = _first(train, clean) if clean else None
    first = _first(train, logs)
    try:
        named, seen, posterior, answers = _named(train, first, good)
    except InputError:  # beside what seems likely of a train that has folded up, its motion has no solution
        if (jackknifed := _jackknifed(first)) is None:
            raise
        return _folded_up(train, jackknifed, first, first)
    if (jackknifed := _jackknifed(seen)) is not None:
        return _folded_up(train, jackknifed, first, seen)
    answers = _of_lasting_noise(answers, named, seen)
    held, order = None, None
    if held_out:
        among = _of_trains([effect.candidate for effect in named])
        found = with_effects(train, named)
        held_logs, state = equations_of(found, held_out)  # axles slide as with the named effects
        without, beside = (
            linearise(vehicle, held_logs, state, among, localised=state.sizes) for vehicle in (train, found)
        )
        held, order = (without, beside), order_of(beside, good)
    noisy = noise_answers(seen, None if held is None else held[1], good, len(posterior.names))
    apart = [*noisy, *stop_answers(train, logs, held_out, seen)]
    every = [*answers, *apart]
    usual_gap = None if good is None else good.gap
    answers = judged(every, named, held, order, material, usual_gap=usual_gap, own=(first, seen))
    inclusion = by_all_logs(posterior.inclusion(), every, answers)
    return Diagnosis(train, weakest(answer.verdict for answer in answers), answers, inclusion, first, seen, held)


def _folded_up(
    train: TrainDescription, jackknifed: Answer, first: Linearised, seen: Linearised
) -> Diagnosis[TrainDescription, Linearised]:
    """Return the diagnosis of a train that has jackknifed, which matters, whatever it costs."""
    answers = judged([jackknifed], (), None, None, Material(0.0, 0.0))
    return Diagnosis(train, weakest(answer.verdict for answer in answers), answers, {}, first, seen, None)


def _named(
    train: TrainDescription, first: Linearised, good: Linearised | None
) -> tuple[Effects, Linearised, Posterior, list[Answer]]:
    """Return the effects that logs name, the statistics beside these, and the answers."""

    def look(named: Sequence[Sized], start: Linearised, among: Sequence[Cause] | None) -> Linearised:
        built = with_effects(train, named)
        if among is not None:
            return linearise(built, start.train_logs, start.fit, _of_trains(among))
        return linearise(built, *sliding_in(built, start.train_logs, start.fit), first.candidates)

    def ask(seen: Linearised, named: Sequence[Sized], without: Collection[str]) -> Asked:
        found = asked(seen, *hypotheses_of(seen), order_of(seen, good), sizes_of(named, seen), without)
        answers = with_dead_gauges(found.answers, named, look, seen, len(found.posterior.names))
        return found._replace(answers=answers)

    return named_together(train, look, ask, first)


def _of_lasting_noise(answers: Sequence[Answer], named: Sequence[Sized], seen: Linearised) -> list[Answer]:
    """Return answers on effects in the model as their scores' variance over long times shows, as slip is not white:
    errors are larger by its ratio to that of white noise, and what an effect explains counts by so much less."""
    in_model = [cause for cause in _of_trains([effect.candidate for effect in named]) if not cause.kinds[0].binary]
    ratio: dict[Cause, float] = {}
    if in_model:
        ratio |= zip(in_model, seen.long_run(in_model).tolist(), strict=True)
    return [_less_certain(answer, ratio.get(answer.candidate, 1.0)) for answer in answers]


def _less_certain(answer: Answer, ratio: float) -> Answer:
    """Return an answer on an effect whose score has a variance larger by a ratio."""
    present, lost = 1 - answer.absent, answer.explained / 2 * (1 - 1 / ratio)
    absent = float(expit(logit(max(answer.absent, np.finfo(float).tiny)) + lost))
    kept = (1 - absent) / present if present else 0.0
    probabilities = {name: kept * part for name, part in answer.probabilities.items()} | {"nothing": absent}
    return replace(answer, covariance=answer.covariance * ratio, probabilities=probabilities, absent=absent)


def _jackknifed(seen: Linearised) -> Answer | None:
    """Return the answer that axles slide beside all that is named, nearly all the time; None if they do not.

    Such a train has jackknifed, as one does whose driver hears a dead gauge: frames are bent by more than their model
    covers, so that whatever explains some of it is likely, and wrong.
    """
    axles = always_sliding(seen.train, seen.train_logs, seen.fit.motions)
    if not axles:
        return None
    which = f"axle {axles[0]} seems" if len(axles) == 1 else f"axles {', '.join(map(str, axles))} seem"
    what = f"{which} to slide nearly all the time, as of a train that has jackknifed"
    slip, half = float(np.hypot(seen.noise.rolling, seen.noise.side)), float(np.mean(half_track(seen.train)))
    cost = slip * np.sqrt([WAY, np.pi / half])  # of a way, and of a turn on the spot
    return Answer.judged_apart(Candidate(what, what, what), 1.0, 1.0, 0.0, cost)


def hypotheses_of(seen: Linearised) -> tuple[list[Hypothesis], list[Place]]:
    """Return all hypotheses, and the candidate of each.

    All families have the same prior probability; unnamed alternatives share that of their family with all times at
    which they were tried.
    """
    names = [candidate.family for candidate in seen.candidates]
    places, scale = [Place(candidate, 0.0) for candidate in seen.candidates], FAULT * tolerances(seen)
    pairs = zip(places, names, strict=True)
    return [hypothesis_of(seen, place, name, 1 / names.count(name), scale) for place, name in pairs], places


def _first(train: TrainDescription, logs: Sequence[Log]) -> Linearised:
    """Return the statistics of all candidates in logs."""
    train_logs, state = equations_of(train, logs)
    unnamed = [rival for k, log in enumerate(train_logs) for rival in rivals(train, log, k)]
    candidates = [*dead_gauges(train), *named_candidates(train), *unnamed]
    return linearise(train, train_logs, state, candidates, localised=state.sizes)


def _of_trains(causes: Sequence[Cause]) -> list[Candidate]:
    return [cause for cause in causes if isinstance(cause, Candidate)]
