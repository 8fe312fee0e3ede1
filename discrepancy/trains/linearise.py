"""Information and score of every candidate in each log of a train, linearised about its motion, nuisances integrated
out."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.priors import bounds_of
from discrepancy.posterior.random_effects import Statistics
from discrepancy.trains.candidates import Candidate, Rival
from discrepancy.trains.evidence import Evidence, FittedStates, evidence_of, fit_states
from discrepancy.trains.gap import localised_off
from discrepancy.trains.motion import LEAST_SIZE, Motion, Sizes
from discrepancy.trains.rows import TrainLog

OFTEN = 0.9
"""Largest part of the time that an axle may slide; if it seems to slide more, the cause is an error of the
description."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Candidates of a train, one size each, and their statistics in its logs beyond its effects; see
    `posterior.linearise.Linearised`."""

    train: TrainDescription
    train_logs: tuple[TrainLog, ...]
    evidence: Evidence

    @property
    def fit(self) -> FittedStates:
        """The motions about which equations are linearised, and the sizes of noise."""
        return self.evidence.fit

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The candidates."""
        return self.evidence.candidates

    @property
    def columns(self) -> tuple[NDArray[np.intp], ...]:
        """The sizes of each candidate, by their numbers."""
        return tuple(np.array([k], dtype=np.intp) for k in range(len(self.candidates)))

    @property
    def logs(self) -> tuple[Statistics, ...]:
        """Information and score of each log."""
        return self.evidence.logs

    @property
    def usual(self) -> Array:
        """Size of unnamed alternatives in logs of a train in good order; NaN for effects."""
        return np.array([np.nan if candidate.rival is None else candidate.rival.usual for candidate in self.candidates])

    @property
    def cost(self) -> Array:
        """Error of the train's localisation per unit of each candidate."""
        return self.evidence.cost

    @property
    def lasting(self) -> NDArray[np.intp]:
        """None: of trains only single logs were compared."""
        return np.zeros(0, dtype=np.intp)

    @property
    def log_evidence(self) -> float:
        """Log evidence of the logs (natural logarithm, up to a constant of the logs)."""
        return -self.fit.deviance / 2

    @property
    def gap(self) -> tuple[float, float] | None:
        """Error of the train's localisation (`localised_off`), m and rad."""
        return self._gap

    @cached_property
    def _gap(self) -> tuple[float, float] | None:
        return localised_off(self.train, self.train_logs, self.fit)

    def reestimate_noise(self, effects: Sequence[Candidate]) -> "Linearised":
        """Return the statistics with the noise estimated anew beside effects of maximum-likelihood sizes, and beside
        the family of unnamed alternatives that explains most.

        Effects that are not in the model would count as slip and noise.
        """
        chosen = [k for k, candidate in enumerate(self.candidates) if candidate in effects]
        best, _ = self.evidence.best(chosen)
        built, information, score = self.train, self.evidence.information, self.evidence.score
        for k, size in zip(chosen, best.tolist(), strict=True):
            size = float(np.clip(size, *bounds_of(self.candidates[k].kinds[0])))
            if size * (2 * score[k] - size * information[k, k]) > 0:
                built = self.candidates[k].added(built, [size])
        with suppress(InputError):  # it does not fit at all
            beside = fit_states(built, self.train_logs, self.fit, unnamed=self._likeliest_unnamed())
            sizes = self.fit.sizes.at_most(beside.sizes)
            if sizes != self.fit.sizes:
                return linearise(self.train, self.train_logs, self.fit, self.candidates, sizes)
        return self

    def _likeliest_unnamed(self) -> list[Rival]:
        """Return all unnamed alternatives of the family that explains most together."""
        information, score = self.evidence.information, self.evidence.score
        families: dict[str, list[int]] = {}
        for k, candidate in enumerate(self.candidates):
            if candidate.rival is not None and information[k, k] > 0:
                families.setdefault(candidate.family, []).append(k)
        gains = {name: float(score[k] @ self.evidence.best(k)[0]) / len(k) for name, k in families.items()}
        chosen = families[max(gains, key=gains.__getitem__)] if gains else []
        return [rival for k in chosen if (rival := self.candidates[k].rival) is not None]


def linearise(
    train: TrainDescription,
    logs: Sequence[TrainLog],
    start: FittedStates | None,
    among: Sequence[Candidate],
    sizes: Sizes | None = None,
) -> Linearised:
    """Return the statistics of candidates in logs, linearised about their most likely motion.

    start: the motion of a similar train. sizes: known noise; None: fitted. Raises InputError for logs that the train
    cannot have made.
    """
    return Linearised(train, tuple(logs), evidence_of(train, logs, fit_states(train, logs, start, sizes), among))


def equations_of(train: TrainDescription, logs: Sequence[Log]) -> tuple[list[TrainLog], FittedStates]:
    """Return logs as equations, in which steps with possible sliding of axles have little weight, and their motion.

    Raises InputError for a log that is not of this train, or that has neither relative poses nor a reference.
    """
    for number, log in enumerate(logs, start=1):
        _check(train, log, number)
    return sliding_in(train, [TrainLog(train, log) for log in logs])


def sliding_in(
    train: TrainDescription, logs: Sequence[TrainLog], start: FittedStates | None = None
) -> tuple[list[TrainLog], FittedStates]:
    """Return logs in which steps with possible sliding of a train's axles have little weight, and their motion.

    start: see `linearise`. These steps follow from a fit without sliding, as forces show only in slip. If the remaining
    steps then show no tension, the apparent sliding has another cause, unless frames are bent so much.
    """
    built, rough = train.as_built(), [log.with_loose(np.zeros_like(log.loose)) for log in logs]
    gripping = fit_states(train, rough, start)
    loosened, state = _loosened(built, rough, gripping.motions), gripping
    if any(log.loose.any() for log in loosened):
        state = fit_states(train, loosened, gripping)
        if state.sizes.tension <= LEAST_SIZE["tension"]:
            loosened = _loosened(built, loosened, state.motions)
            state = fit_states(train, loosened, gripping)
    return loosened, state


def _loosened(built: TrainDescription, logs: Sequence[TrainLog], motions: Sequence[Motion]) -> list[TrainLog]:
    """Return logs with the steps in which axles slide by these motions, except axles that seem to slide all the
    time."""
    loose = [log.sliding(built, motion) for log, motion in zip(logs, motions, strict=True)]
    return [log.with_loose(slid & (slid.mean(axis=0) <= OFTEN)) for log, slid in zip(logs, loose, strict=True)]


def _check(train: TrainDescription, log: Log, number: int) -> None:
    if log.wheel.shape[1] != 2 * train.n_axles:
        raise InputError(
            f"log {number} has counts of {log.wheel.shape[1]} wheels; train {train.name!r} has {2 * train.n_axles}"
        )
    seen = [values is not None and bool(np.isfinite(values).any()) for values in (log.rps, log.reference)]
    if not any(seen):
        raise InputError(
            f"log {number} has neither relative poses nor a reference, so nothing is observable; give logs with rps or "
            "ref columns"
        )
