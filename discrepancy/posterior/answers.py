"""What a posterior answers: for each effect in the sum names with probabilities, sizes, and what they cost."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from discrepancy.posterior.random_effects import Statistics
from discrepancy.posterior.single_effects import Posterior, SingleEffects


class Cause(Protocol):
    """What may be missing in the description of a robot (`hypotheses.candidates`) or a train (`trains.candidates`)."""

    @property
    def what(self) -> str:
        """In words."""
        ...

    @property
    def family(self) -> str:
        """The same for all that are one answer."""
        ...

    @property
    def kinds(self) -> tuple[Effect, ...]:
        """Of the catalogue; none: it has no name."""
        ...

    @property
    def columns(self) -> int:
        """How many amplitudes it takes."""
        ...

    def effect(self, amplitudes: Array, /) -> Effect:
        """Return the effect of some amplitudes (columns,); raises ValueError for one that cannot be."""
        ...

    def added(self, vehicle: Any, amplitudes: Array, /) -> Any:
        """Return the robot, or train, with this effect beside its own; raises ValueError for one that cannot be."""
        ...


class Seen(Protocol):
    """What logs say of candidates, whoever made them: see `linearise.Linearised` and `trains.linearise.Linearised`."""

    @property
    def candidates(self) -> tuple[Cause, ...]:
        """What may be missing."""
        ...

    @property
    def columns(self) -> tuple[NDArray[np.intp], ...]:
        """The columns of each candidate, among C."""
        ...

    @property
    def logs(self) -> tuple[Statistics, ...]:
        """Information and score of each log: of C sizes beyond the vehicle's effects, and what may hide of each."""
        ...

    @property
    def usual(self) -> Array:
        """Size (C,) of what has no name in logs of a vehicle in good order; NaN of effects."""
        ...

    @property
    def cost(self) -> Array:
        """What a unit of each (2, C) costs in use: m after 10 m, rad after a turn."""
        ...

    @property
    def log_evidence(self) -> float:
        """How likely the logs are (natural logarithm), sizes 0 and all else integrated out."""
        ...

    @property
    def gap(self) -> tuple[float, float] | None:
        """What is left of the logs, m and rad; None where it cannot be told."""
        ...

    def quieter(self, effects: Sequence[Any], /) -> Self:
        """Return the same at the noise that is left beside effects, each as large as logs want."""
        ...


class Place(NamedTuple):
    """What a hypothesis is about: the candidate, by its number, and the part of it that wheels hide."""

    candidate: int
    hidden: float


Verdict = Literal["named", "ambiguous", "unexplained", "unconfirmed", "negligible", "no discrepancy"]

SHOWN = 1e-3
"""Probability from which on a name is told."""


@dataclass(frozen=True, eq=False)
class Answer:
    """One single effect.

    probabilities: of names, the likeliest first, and of "nothing". credible: names that hold it with 95 %. unnamed:
    whether one of these is an alternative without a name. candidate: the likeliest, with its amplitudes (c,), their
    covariance (c, c), and the part of it that wheels hide. explained: the deviance that it takes away. cost (2,): what
    a unit of its amplitudes costs, m after 10 m and rad after a turn. confirmed: by how much (natural logarithm) it
    makes held-out logs more likely, where that is known otherwise than by their columns. verdict, reason: see
    `verdicts`.
    """

    probabilities: dict[str, float]
    credible: tuple[str, ...]
    unnamed: bool
    candidate: Cause
    amplitudes: Array
    covariance: Array
    hidden: float
    explained: float
    cost: Array
    confirmed: float | None = None
    verdict: Verdict = "named"
    reason: str = ""

    @property
    def effect(self) -> Effect | None:
        """The effect; None if it has no name, or cannot be as large."""
        if not self.candidate.kinds:
            return None
        try:
            return self.candidate.effect(self.amplitudes)
        except ValueError:
            return None

    @property
    def learned(self) -> bool:
        """Whether it has no name, but what it depends on was learned."""
        return self.unnamed and len(self.credible) == 1 and self.effect is not None

    @property
    def probability(self) -> float:
        """Of the likeliest name."""
        return self.probabilities[self.credible[0]]

    @property
    def size(self) -> float:
        """How large it is, in the unit of its amplitude."""
        return float(self.amplitudes[0]) if len(self.amplitudes) == 1 else float(np.linalg.norm(self.amplitudes))

    @property
    def error(self) -> float:
        """The standard deviation of its size."""
        return float(np.sqrt(np.max(np.diag(self.covariance))))


def answers_of(
    seen: Seen, single: SingleEffects, posterior: Posterior, score: Array, places: Sequence[Place]
) -> list[Answer]:
    """Return an answer for every component of a posterior that is not likely to be nothing; for all of one candidate,
    which wheels hide in several parts, one."""
    answers: dict[Cause, Answer] = {}
    for j, component in enumerate(posterior.components):
        credible = posterior.credible_set(component)
        if not credible:
            continue
        probability = component.probability
        members = [k for k, hypothesis in enumerate(single.hypotheses) if hypothesis.name in credible]
        best = max(members, key=lambda k: (_is_called(seen, places[k], credible[0]), probability[k]))
        same = [k for k in members if places[k].candidate == places[best].candidate]
        weight = probability[same] / probability[same].sum()
        mean, covariance = _mixed(weight, [single.sizes(posterior, score, j, k) for k in same])
        told = {name: part for name, part in posterior.probabilities(component).items() if part > SHOWN}
        columns = seen.columns[places[best].candidate]
        answer = Answer(
            probabilities=told | ({"nothing": component.nothing} if component.nothing > SHOWN else {}),
            credible=credible,
            unnamed=any(not seen.candidates[places[k].candidate].kinds for k in members),
            candidate=seen.candidates[places[best].candidate],
            amplitudes=mean,
            covariance=covariance,
            hidden=float(weight @ [places[k].hidden for k in same]),
            explained=component.square,
            cost=np.max(seen.cost[:, columns], axis=1),
        )
        before = answers.get(answer.candidate)
        answers[answer.candidate] = answer if before is None else _added(before, answer)
    return list(answers.values())


def _is_called(seen: Seen, place: Place, name: str) -> bool:
    """Whether a hypothesis is about the candidate that a name stands for, of those that are one and the same."""
    return seen.candidates[place.candidate].family == name


def _added(first: Answer, second: Answer) -> Answer:
    return dataclasses.replace(
        first,
        amplitudes=first.amplitudes + second.amplitudes,
        covariance=first.covariance + second.covariance,
        explained=first.explained + second.explained,
    )


def _mixed(weight: Array, sizes: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture of distributions with these means and covariances."""
    means = np.array([mean for mean, _ in sizes])
    mean = weight @ means
    spread = sum(part * (own + np.outer(at - mean, at - mean)) for part, (at, own) in zip(weight, sizes, strict=True))
    return mean, np.asarray(spread)
