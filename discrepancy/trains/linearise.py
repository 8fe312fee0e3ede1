"""Information and score of every candidate in each log of a train, linearised about its motion, nuisances integrated
out."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from castor_envs.effects.train import FrameLength
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.answers import Seen
from discrepancy.posterior.calibrated import FREEDOM
from discrepancy.posterior.priors import bounds_of
from discrepancy.posterior.random_effects import Statistics, summed
from discrepancy.trains.candidates import Candidate
from discrepancy.validation.cost import cost_of_sizes, gap_of
from estimators.likelihood.statistics import IN_ANY_UNITS, pseudo_inverse
from estimators.likelihood.trains.motion import Motion, Sizes
from estimators.likelihood.trains.rows import TrainLog
from estimators.likelihood.trains.states import PROBES, Equations, FittedStates, fit_states

PART, DRAWS = 2.0, 32
"""s: parts of a log that are longer than slip lasts, by which its noise over long times is estimated; and draws of
white noise with which that is compared."""

HORIZON = 5.0
"""s of localisation by wheel counts alone before the train is reset to its fitted pose."""


@dataclass(frozen=True, eq=False)
class Linearised(Seen):
    """Statistics of a train's logs, linearised about their most likely motion; one size of each candidate.

    cost: of the train's localisation by counts and relative poses. fit: motions about which equations are linearised,
    and sizes of noise.
    localised: the sizes of noise with which the train is localised for `gap`; None: those of `fit`. Where two
    descriptions are compared, both have the same: beside larger noise of a sensor localisation relies on others, which
    changes its error, too.
    """

    train: TrainDescription
    train_logs: tuple[TrainLog, ...]
    fit: FittedStates
    localised: Sizes | None = None

    @property
    def noise(self) -> Sizes:
        """The sizes of noise with which the logs were fitted."""
        return self.fit.sizes

    @property
    def gap(self) -> tuple[float, float] | None:
        """Error of the train's localisation by counts and relative poses within `HORIZON` against the reference, m and
        rad (rms); None without a reference, or where there is no solution."""
        return self._gap

    @cached_property
    def _gap(self) -> tuple[float, float] | None:
        built, poses = self.train.as_built(), list[Array]()
        try:
            counts = [log.without_reference() for log in self.train_logs]
            blind = fit_states(self.train, counts, self.fit, self.localised or self.fit.sizes)
        except InputError:
            return None
        for log, motion, by_counts in zip(self.train_logs, self.fit.motions, blind.motions, strict=True):
            if len(log.at):
                left = log.residuals(built, replace(motion, pose=_carried(by_counts.pose, motion, log.t)))
                poses.append(np.concatenate([left["position"], left["heading"][..., None]], axis=-1).reshape(-1, 3))
        return gap_of(poses)

    def long_run(self, effects: Sequence[Candidate]) -> Array:
        """Return by how much larger the variances of the sizes of effects in the model are (E,), at least 1, than with
        white noise, which the linear formula takes all noise for (`Equations.long_run`).

        Each log's ratio counts by its parts, and that of white noise, 1, as much as `FREEDOM` of them.
        """
        built = self.train.as_built()
        squares, parts = np.zeros(len(effects)), 0
        for j, (log, motion) in enumerate(zip(self.train_logs, self.fit.motions, strict=True)):
            equations = Equations.of(log, built, motion, self.noise)
            columns = _columns(self.train, log, j, motion, equations, effects)
            part = (log.t[equations.sample_of_rows(log.block)] - log.t[0]) // PART
            draws = np.random.default_rng(0).standard_normal((len(columns), DRAWS))
            ratio = equations.long_run(columns, log.prior(self.train) ** -2.0, part.astype(np.intp), draws)
            count = int(part.max()) + 1
            squares, parts = squares + count * ratio, parts + count
        return np.maximum((FREEDOM + squares) / (FREEDOM + parts), 1.0)

    def reestimate_noise(self, effects: Sequence[Candidate]) -> "Linearised":
        """See `Seen`; beside the family of unnamed alternatives that explains most, too."""
        built, (information, score) = self.train, summed(self.logs)
        chosen = [k for k, candidate in enumerate(self.candidates) if candidate.kinds and candidate in effects]
        for k, size in zip(chosen, _likeliest(information, score, chosen).tolist(), strict=True):
            size = float(np.clip(size, *bounds_of(self.candidates[k].kinds[0])))
            if size * (2 * score[k] - size * information[k, k]) > 0:
                built = self.candidates[k].added(built, [size])
        families: dict[str, list[int]] = {}
        for k, candidate in enumerate(self.candidates):
            if candidate.term is not None and information[k, k] > 0:
                families.setdefault(candidate.family, []).append(k)
        gains = {name: float(score[k] @ _likeliest(information, score, k)) / len(k) for name, k in families.items()}
        family = families[max(gains, key=gains.__getitem__)] if gains else []
        unnamed = [term for k in family if (term := self.candidates[k].term) is not None]
        with suppress(InputError):  # it does not fit at all
            sizes = self.fit.sizes.at_most(fit_states(built, self.train_logs, self.fit, terms=unnamed).sizes)
            if sizes != self.fit.sizes:
                return linearise(self.train, self.train_logs, self.fit, self.candidates, sizes)
        return self


def linearise(
    train: TrainDescription,
    logs: Sequence[TrainLog],
    start: FittedStates | None,
    among: Sequence[Candidate],
    sizes: Sizes | None = None,
    localised: Sizes | None = None,
) -> Linearised:
    """Return the statistics of candidates in logs, linearised about their most likely motion.

    start: the motion of a similar train. sizes: known noise; None: fitted. localised: see `Linearised`. Raises
    InputError for logs that the train cannot have made.
    """
    found, built = fit_states(train, logs, start, sizes), train.as_built()
    statistics, costs = [], []
    for j, (log, motion) in enumerate(zip(logs, found.motions, strict=True)):
        equations = Equations.of(log, built, motion, found.sizes)
        columns = _columns(train, log, j, motion, equations, among)
        prior = log.prior(train) ** -2.0
        statistics.append(Statistics(*equations.eliminated(columns, prior, log.nuisances(motion))))
        costs.append(_cost(log, motion, equations, columns, prior))
    return Linearised(
        columns={candidate: np.array([k], dtype=np.intp) for k, candidate in enumerate(among)},
        logs=tuple(statistics),
        usual=np.array([candidate.usual for candidate in among]),
        cost=np.sqrt(np.mean(np.square(costs), axis=0)),
        log_evidence=-found.deviance / 2,
        log_evidence_of_motion=-found.deviance / 2,  # axles that disagree are a part of the motion
        redundant=True,  # axles are seen by posture sensors, so encoders can contradict each other
        masked=0.0,
        lasting=np.zeros(0, dtype=np.intp),  # of trains only single logs were compared
        poses=sum(len(log.at) * log.n for log in logs),
        train=train,
        train_logs=tuple(logs),
        fit=found,
        localised=localised,
    )


def _columns(
    train: TrainDescription, log: TrainLog, j: int, motion: Motion, equations: Equations, among: Sequence[Candidate]
) -> Array:
    """Return the change (R, n + P) of the weighed equations of a log, the j-th, by its n nuisances, then by a unit of
    each candidate."""
    zero, ends, sizes = equations.left, equations.ends, equations.sizes
    columns = np.zeros((len(equations.residual), log.numbers + len(among)))
    columns[:, : log.numbers] = equations.by_number
    for column, candidate in zip(columns.T[log.numbers :], among, strict=True):
        changes = {}
        if candidate.kind is not None:
            larger, by = candidate.enlarged(train)
            real = sizes.with_noise(larger.as_built())
            changed = log.residuals(real, motion, None if isinstance(candidate.kind, FrameLength) else ends)
            changes = {kind: (changed[kind] - zero[kind]) / by for kind in zero}
            if (gauge := candidate.restored(by)) is not None:
                at, (kind, change) = log.offset_of(*gauge, real, motion, ends, changed)
                columns[:, at] = equations.weighed(kind, change)
        elif (term := candidate.term) is not None and term.log == j:
            changes = {term.kind: term.change}
        for kind, change in changes.items():
            if change.any():
                column += equations.weighed(kind, change)
    return columns


def cost_of_noise(seen: Linearised, f: int) -> Array:
    """Return the error of the train's localisation (2,) by white noise of 1 in each reading of a frame's gauges."""
    built, random, costs = seen.train.as_built(), np.random.default_rng(0), []
    for log, motion in zip(seen.train_logs, seen.fit.motions, strict=True):
        equations = Equations.of(log, built, motion, seen.fit.sizes)
        by_gauge = log.bends(built, motion).by_gauge[f]
        noise = random.standard_normal((PROBES, len(by_gauge), by_gauge.shape[-1], 1))
        columns = [equations.weighed(f"gauges{f}", (by_gauge @ draw)[..., 0] * log.read[:, f, None]) for draw in noise]
        every = np.column_stack([equations.by_number, *columns])
        costs.append(np.mean(_cost(log, motion, equations, every, log.prior(seen.train) ** -2.0) ** 2, axis=1))
    return np.sqrt(np.mean(costs, axis=0))


def _likeliest(information: Array, score: Array, chosen: Sequence[int]) -> Array:
    """Return the maximum-likelihood amplitudes of these candidates together (c,)."""
    return pseudo_inverse(information[np.ix_(chosen, chosen)], IN_ANY_UNITS) @ score[list(chosen)]


def _carried(odometry: Array, motion: Motion, t: Array) -> Array:
    """Return poses (K, N, 3) by odometry (K, N, 3) alone, reset to the motion every `HORIZON`."""
    start = np.searchsorted(t, np.floor(t / HORIZON) * HORIZON - 1e-9)
    return compose(compose(motion.pose[start], inverse(odometry[start])), odometry)


def _cost(log: TrainLog, motion: Motion, equations: Equations, columns: Array, prior: Array) -> Array:
    """Return the error of the train's localisation (2, P) per unit of each of P ignored columns (`cost_of_sizes`).

    Of the axle with the largest error. The train is localised by counts and relative poses, without a reference.
    """
    n = len(prior)
    blind, known = equations.without(("position", "heading"), log.block)
    seen = columns[known]
    states = blind.solved(seen)
    apart = seen - blind.by_sample @ states
    by_number = np.linalg.solve(seen[:, :n].T @ apart[:, :n] + np.diag(prior), seen[:, :n].T @ apart[:, n:])
    off = (states[:, n:] - states[:, :n] @ by_number).reshape(log.k, log.block, -1)
    return np.max([_cost_of_path(motion.pose[:, i], off[:, 3 * i : 3 * i + 3]) for i in range(log.n)], axis=0)


def _cost_of_path(pose: Array, off: Array) -> Array:
    """Return the cost (2, P) of errors `off` (K, 3, P) of a path (K, 3)."""
    step, heading = np.diff(pose, axis=0), (pose[1:, 2] + pose[:-1, 2]) / 2
    c, s, turned = np.cos(heading)[:, None], np.sin(heading)[:, None], (off[1:, 2] + off[:-1, 2]) / 2
    x = np.diff(off[:, 0], axis=0) + turned * step[:, 1:2]
    y = np.diff(off[:, 1], axis=0) - turned * step[:, :1]
    return cost_of_sizes([np.stack([c * x + s * y, c * y - s * x, np.diff(off[:, 2], axis=0)], axis=1)], pose)
