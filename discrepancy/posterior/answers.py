"""The answers that a posterior gives: for each single effect the probabilities of names, the size, and its cost in
use."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.encoders import LearnedTerm
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from discrepancy.posterior.random_effects import Statistics
from discrepancy.posterior.single_effects import Component, Posterior, SingleEffects


class Cause(Protocol):
    """A candidate cause of a discrepancy: what the description of a robot (`hypotheses.candidates`) or of a train
    (`trains.candidates`) may be missing."""

    @property
    def what(self) -> str:
        """The cause in words."""
        ...

    @property
    def family(self) -> str:
        """Name of the answer: candidates of one family are one answer."""
        ...

    @property
    def kinds(self) -> tuple[Effect, ...]:
        """Effects of the catalogue; empty for an unnamed alternative."""
        ...

    @property
    def alike(self) -> str:
        """What the cause does, wherever it is: causes that do the same scatter alike among robots in good order."""
        ...

    @property
    def when(self) -> str:
        """The end of `what` that tells a time in one of the logs; empty for causes that other logs may have."""
        ...

    @property
    def columns(self) -> int:
        """The number of amplitudes."""
        ...

    def effect(self, amplitudes: Array, /) -> Effect:
        """Return the effect with these amplitudes (columns,); raises ValueError for amplitudes that it cannot have."""
        ...

    def added(self, vehicle: Any, amplitudes: Array, /) -> Any:
        """Return the robot, or train, with this effect added; raises ValueError for amplitudes that it cannot have."""
        ...


@dataclass(frozen=True, eq=False)
class Seen:
    """The statistics of candidates in logs of a robot or a train.

    columns: of each candidate, among C. logs: information and score of each log, of C sizes beyond the vehicle's
    effects, and of the masked amount of each where wheel creep may mask effects (2C sizes). usual (C,): size of unnamed
    alternatives in logs of a vehicle in good order; NaN for effects of the catalogue. cost (2, C): odometry error that
    a unit of each size causes in use: m after 10 m, rad after a turn. log_evidence: log-likelihood of the logs (natural
    logarithm, up to a constant of the logs) with all sizes 0 and the nuisances integrated out; log_evidence_of_motion:
    without how far wheels disagree. redundant: whether encoders can contradict each other; else an effect that is not
    in the model passes for noise. masked: part of the effects in the model that wheel creep masks. lasting: columns of
    effects that add up over a whole log, by which logs may agree better than their noise lets them; empty: none is
    known to. poses: number of reference poses in use.
    """

    columns: Mapping[Any, NDArray[np.intp]]
    logs: tuple[Statistics, ...]
    usual: Array
    cost: Array
    log_evidence: float
    log_evidence_of_motion: float
    redundant: bool
    masked: float
    lasting: NDArray[np.intp]
    poses: int

    @property
    def candidates(self) -> tuple[Any, ...]:
        """The causes that were considered."""
        return tuple(self.columns)

    @property
    def gap(self) -> tuple[float, float] | None:
        """Gap between odometry and reference (rms), m and rad; None for logs without a reference."""
        raise NotImplementedError

    def reestimate_noise(self, effects: Sequence[Any], /) -> Any:
        """Return the statistics with the noise estimated anew beside effects of maximum-likelihood sizes: those that
        are not in the model would count as noise."""
        raise NotImplementedError


class Place(NamedTuple):
    """The candidate that a hypothesis is about, and the part of it that wheel creep masks."""

    candidate: Cause
    masked: float


Verdict = Literal["named", "ambiguous", "unexplained", "unconfirmed", "negligible", "no discrepancy"]

SHOWN = 1e-3
"""Least probability of a name that is reported."""


def size_of(amplitudes: Array) -> float:
    """Return the size of an effect of one amplitude, or of two that are its parts at right angles."""
    return float(amplitudes[0]) if len(amplitudes) == 1 else float(np.linalg.norm(amplitudes))


@dataclass(frozen=True, eq=False)
class Learned:
    """A curve in the robot file. errors: standard deviations of its values. log_odds: log odds of the curve against
    none, natural logarithm. nearest: the effect of the catalogue with the most similar signature, in words, and the
    cosine between both signatures; None where no effect overlaps."""

    effect: LearnedTerm
    errors: tuple[float, ...]
    log_odds: float
    nearest: tuple[str, float] | None


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer on one single effect.

    probabilities: of names, the likeliest first, and of "nothing"; absent: that of "nothing", however small. credible:
    the 95 % credible set of names. unnamed:
    whether this set contains an unnamed alternative. candidate: the likeliest candidate, with its amplitudes (c,),
    their covariance (c, c), and the part of it that wheel creep masks (`masked`). explained: the deviance (twice the
    log-likelihood ratio) that the effect explains. cost (2,): odometry error that a unit of its amplitudes causes, m
    after 10 m and rad after a turn. alike: names of effects that are the same on this vehicle, whatever it does, as the
    likeliest. confirmed: log-likelihood ratio of held-out logs with and without the effect, where
    it is not computed from their linear columns. curve: what an unnamed alternative was found to depend on. verdict,
    reason: see `verdicts`.
    """

    probabilities: dict[str, float]
    credible: tuple[str, ...]
    unnamed: bool
    candidate: Cause
    amplitudes: Array
    covariance: Array
    cost: Array
    masked: float = 0.0
    explained: float = 0.0
    absent: float = 0.0
    alike: tuple[str, ...] = ()
    confirmed: float | None = None
    curve: Learned | None = None
    verdict: Verdict = "named"
    reason: str = ""

    @classmethod
    def judged_apart(
        cls,
        candidate: Cause,
        probability: float,
        size: float,
        error: float,
        cost: Array,
        confirmed: float | None = None,
    ) -> Self:
        """Return the answer on a fault that is no column of the linear problem. size, error: its amplitude and the
        standard deviation; cost (2,): of all of it."""
        return cls(
            probabilities={candidate.family: probability, "nothing": 1 - probability},
            credible=(candidate.family,),
            unnamed=not candidate.kinds,
            candidate=candidate,
            amplitudes=np.array([size]),
            covariance=np.array([[error**2]]),
            cost=cost / size if size else cost,
            confirmed=confirmed,
        )

    @property
    def effect(self) -> Effect | None:
        """The effect; None for an unnamed alternative, or for amplitudes that the effect cannot have."""
        if not self.candidate.kinds:
            return None
        try:
            return self.candidate.effect(self.amplitudes)
        except ValueError:
            return None

    @property
    def learned(self) -> bool:
        """Whether the answer is an unnamed alternative whose dependence on a known quantity was learned as a curve."""
        return self.unnamed and len(self.credible) == 1 and self.effect is not None

    @property
    def probability(self) -> float:
        """Probability of the likeliest name."""
        return self.probabilities[self.credible[0]]

    @property
    def size(self) -> float:
        """The size of the effect, in the unit of its amplitude."""
        return size_of(self.amplitudes)

    @property
    def error(self) -> float:
        """The standard deviation of the size."""
        return float(np.sqrt(np.max(np.diag(self.covariance))))


def answers_of(
    seen: Seen, single: SingleEffects, posterior: Posterior, score: Array, places: Sequence[Place], in_model: Array
) -> list[Answer]:
    """Return an answer for every component of a posterior unless its likeliest value is "nothing"; components of one
    candidate are added into one answer.

    in_model (m,): sizes in the model. Of effects that are the same on this vehicle, that in the model gives the name.
    """
    modelled = {cause for cause, columns in seen.columns.items() if np.any(in_model[columns])}
    likeliest = [_likeliest(posterior, component, places, modelled) for component in posterior.components]
    answers: dict[Cause, Answer] = {}
    for component, best in zip(posterior.components, likeliest, strict=True):
        if best is None:
            continue
        cause, credible = places[best].candidate, posterior.credible_set(component)
        if cause in answers:  # of all components of one candidate, whose sizes are one
            explained = answers[cause].explained + component.square
            answers[cause] = dataclasses.replace(answers[cause], explained=explained)
            continue
        others = [
            other
            for other, k in zip(posterior.components, likeliest, strict=True)
            if k is None or places[k].candidate != cause
        ]
        members = [k for k, hypothesis in enumerate(single.hypotheses) if hypothesis.name in credible]
        families = [places[k].candidate.family for k in members if single.hypotheses[k].name == credible[0]]
        same_candidate = [k for k in members if places[k].candidate == cause]
        weight = component.probability[same_candidate] / component.probability[same_candidate].sum()
        mean, covariance = mixed(weight, [single.sizes(score, k, others) for k in same_candidate])
        called = {credible[0]: cause.family} if credible[0] in families else {}
        shown = {
            called.get(name, name): p
            for name, p in posterior.probabilities(component).items()
            if p > SHOWN or name == credible[0]
        }
        answers[cause] = Answer(
            probabilities=shown | ({"nothing": component.nothing} if component.nothing > SHOWN else {}),
            absent=component.nothing,
            credible=tuple(called.get(name, name) for name in credible),
            alike=tuple(dict.fromkeys(name for name in families if called and name != cause.family)),
            unnamed=any(not places[k].candidate.kinds for k in members),
            candidate=cause,
            amplitudes=mean,
            covariance=covariance,
            masked=float(weight @ [places[k].masked for k in same_candidate]),
            explained=component.square,
            cost=np.max(seen.cost[:, seen.columns[cause]], axis=1),
        )
    return list(answers.values())


def _likeliest(
    posterior: Posterior, component: Component, places: Sequence[Place], modelled: Collection[Cause]
) -> int | None:
    """Return the likeliest hypothesis of a component, of those that are the same on this vehicle preferably one of a
    candidate in the model (`modelled`); None if its likeliest value is "nothing"."""
    credible = posterior.credible_set(component)
    if not credible:
        return None
    return max(
        (k for k, hypothesis in enumerate(posterior.hypotheses) if hypothesis.name == credible[0]),
        key=lambda k: (
            places[k].candidate in modelled,
            places[k].candidate.family == credible[0],  # which gave the name to all that are alike
            component.probability[k],
        ),
    )


def mixed(weight: Array, sizes: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture of distributions with these means and covariances."""
    means, covariances = (np.array(part) for part in zip(*sizes, strict=True))
    away = means - weight @ means
    return weight @ means, np.tensordot(weight, covariances, 1) + (weight * away.T) @ away
