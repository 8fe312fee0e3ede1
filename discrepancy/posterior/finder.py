"""The finder on one page: fit states, linearise, posterior, name, and again until the names stay; then confirm.

What robots in good order show of each effect, differently in each log, is told by tolerances, and by clean logs where
there are any (`priors`); an effect has to stand out of that. What comes out is a probability of every name, and a
verdict that follows from it (`verdicts`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from castor_envs.effects.clocks import SampleJitter
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.inference.creep_prediction import CREEPS
from discrepancy.inference.findings import without
from discrepancy.posterior.answers import Answer, Verdict, answers_of
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import Place, hypotheses_of, order_of, sizes_of
from discrepancy.posterior.random_effects import GoodOrder
from discrepancy.posterior.refit import Sized, possible, refitted, robot_with
from discrepancy.posterior.single_effects import Hypothesis, Posterior, SingleEffects
from discrepancy.posterior.variances.at_times import at_times
from discrepancy.posterior.variances.jitter import jitter_answer
from discrepancy.posterior.verdicts import MATERIAL, Material, judged, verdict_of

LOOKS = 6
"""Times that all candidates are looked at, at most, beside what has been named by then."""

BESIDE = 2
"""Effects beside which the size of noise is found."""

SECOND = 0.2
"""Part of what the largest new effect explains that another must, to be put into the model in the same round; where
that leads nowhere new, all are."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What logs say is missing. verdict: of all answers, the most certain first.

    before, after: what is left of the logs without and with the effects in `answers` that have a name; held_out: the
    same of held-out logs. inclusion: probability of every name to be among what is missing. creep: parts of predicted
    creep in clean logs, if there are any.
    """

    robot: RobotDescription
    verdict: Verdict
    answers: tuple[Answer, ...]
    inclusion: dict[str, float]
    before: Linearised
    after: Linearised
    held_out: tuple[Linearised, Linearised] | None
    creep: Array | None = None

    @property
    def found(self) -> RobotDescription:
        """The robot with the effects that are named."""
        effects = [answer.effect for answer in self.answers if answer.verdict == "named"]
        return self.robot.with_effects(*(effect for effect in effects if effect is not None))


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def diagnose(
    robot: RobotDescription,
    logs: Sequence[Log],
    held_out: Sequence[Log] = (),
    clean: Sequence[Log] = (),
    before: RobotDescription | None = None,
    material: Material = MATERIAL,
) -> Diagnosis:
    """Return what logs say is missing in a robot's description, how likely it is, and what it costs.

    held_out: logs that a name must be borne out by. clean: logs of the robot in good order. before: the robot as it
    made these, if its description was another. material: what matters.
    Raises InputError for logs that the robot cannot have made, or that show nothing.
    """
    robot = without(robot, SampleJitter)
    good = linearise(without(before or robot, SampleJitter), clean) if clean else None
    creep = None if good is None else good.parts
    places = () if good is None else tuple(candidate for candidate in good.candidates if candidate.at_a_place)
    first = seen = linearise(robot, logs, creep=creep, places=places)
    named: tuple[Sized, ...] = ()
    tried = [frozenset[str]()]
    while True:
        posterior, answers = _answers(robot, seen, good, named)
        for least in (SECOND, 0.0):
            new = _taken_in(robot, answers, named, least)
            families = frozenset(one.candidate.family for one in new)
            if families not in tried:
                break
        if families in tried or len(tried) > LOOKS:
            break
        tried.append(families)
        named, seen = refitted(robot, logs, new, seen, creep)
        more = dict.fromkeys(
            (*places, *(one.candidate for one in named), *(c for c in first.candidates if c.at_a_place))
        )
        seen = linearise(robot_with(robot, named), logs, start=seen, creep=creep, places=tuple(more))
    late = jitter_answer(robot, logs, held_out, clean, len(posterior.names))
    beside = [*([] if late is None else [late]), *at_times(robot, seen, good, answers, len(posterior.names))]
    inclusion = {answer.credible[0]: answer.probability for answer in beside} | posterior.inclusion()
    answers = [*answers, *beside]
    held, order = None, None
    if held_out:
        among, found = [one.candidate for one in named], robot_with(robot, named)
        held = (
            linearise(robot, held_out, creep=creep, among=among),
            linearise(found, held_out, creep=creep, among=among),
        )
        order = order_of(held[1], good)
    answers = judged(answers, named, held, order, material)
    return Diagnosis(robot, verdict_of(answers), answers, inclusion, first, seen, held, creep)


def _answers(
    robot: RobotDescription, seen: Linearised, good: Linearised | None, named: Sequence[Sized]
) -> tuple[Posterior, list[Answer]]:
    """Return the posterior of all that may be there, and the answers that it gives, the most certain first."""
    hypotheses, places = hypotheses_of(robot, seen)
    candidates = [seen.candidates.index(one.candidate) for one in named]
    there = sizes_of(
        candidates, [one.amplitudes for one in named], seen.parts[CREEPS + len(robot.effects) :].tolist(), seen
    )
    order = order_of(seen, good)
    single, posterior, score = _posterior(hypotheses, order, seen, there, there)
    seen = seen.quieter(_likeliest(seen, posterior, places))
    single, posterior, score = _posterior(hypotheses, order, seen, there, there)
    believed = np.sum([component.mean for component in posterior.components], axis=0)
    single, posterior, score = _posterior(hypotheses, order, seen, there, believed)
    return posterior, answers_of(seen, single, posterior, score, places)


def _likeliest(seen: Linearised, posterior: Posterior, places: Sequence[Place]) -> list[Candidate]:
    """Return the candidate of the catalogue that is likeliest in each of the most certain components."""
    named = np.array([bool(seen.candidates[place.candidate].kinds) for place in places])
    best = (int(np.argmax(component.probability * named)) for component in posterior.components[:BESIDE])
    return list(dict.fromkeys(seen.candidates[places[k].candidate] for k in best))


def _taken_in(
    robot: RobotDescription, answers: Sequence[Answer], named: Sequence[Sized], least: float
) -> tuple[Sized, ...]:
    """Return the effects to put into the model: those that stay, and new ones but for such as explain less than such a
    part of the largest of these, which may be what its linear signature is wrong by."""
    kept = {one.candidate for one in named}
    every = [(answer, Sized(answer.candidate, answer.amplitudes)) for answer in answers if answer.effect is not None]
    every = [(answer, one) for answer, one in every if possible(robot, [one])]
    largest = max((answer.explained for answer, one in every if one.candidate not in kept), default=0.0)
    return tuple(one for answer, one in every if one.candidate in kept or answer.explained >= least * largest)


def _posterior(
    hypotheses: Sequence[Hypothesis], order: GoodOrder, seen: Linearised, there: Array, believed: Array
) -> tuple[SingleEffects, Posterior, Array]:
    """Return the posterior of hypotheses beside what robots in good order show, and the score that it comes from.

    there: sizes in the model already. believed: sizes that are there, which tell how wrong signatures are.
    """
    logs = [log.at(-there).doubted(believed - there, there) for log in seen.logs]
    beyond = order.beyond(logs)
    single = SingleEffects(hypotheses, beyond.information)
    return single, single.posterior(beyond.score), beyond.score
