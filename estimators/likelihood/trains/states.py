"""The likeliest motions of trains in logs, and sizes of noise: iterated least squares, nuisances integrated out."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array, vstack

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription
from estimators.likelihood.trains import bending
from estimators.likelihood.trains.motion import LEAST_SIZE, Motion, Sizes
from estimators.likelihood.trains.rows import TrainLog

PROBES = 8
"""Random vectors with which the degrees of freedom that the motion takes from each kind of equations are estimated."""

COLD_ROUNDS, WARM_ROUNDS = 10, 8
"""Most rounds in which motion and sizes are fitted, from no start and from those of a similar train."""

STILL = 1.0
"""Change of deviance between rounds at which a fit that began from a similar train ends."""

FIRST = 3
"""Rounds without a start before sizes are fitted."""

SHORTEST = 1 / 32
"""Part of a step of a fit down to which it is halved until the motion is likelier: frames are bent far where a
description is wrong, and equations hold near a motion only."""

OFTEN = 0.9
"""Largest part of the time that an axle may slide; if it seems to slide more, the cause is an error of the
description."""


@dataclass(frozen=True, eq=False)
class FittedStates:
    """The fitted motions of logs, and the sizes of noise.

    deviance: minus twice the logarithm of the likelihood, nuisances integrated out, up to a constant of the logs.
    """

    motions: tuple[Motion, ...]
    sizes: Sizes
    deviance: float


@dataclass(frozen=True, eq=False)
class Term:
    """What equations of one kind of a log (number from 0) may have in addition: `change` per unit."""

    log: int
    kind: str
    change: Array


@dataclass(frozen=True, eq=False)
class Equations:
    """One log's equations about a motion, weighed: residual (R,), derivatives by samples (R, K B) and nuisances (R, n).

    built: the train, with the noise of gauges that the sizes say. left, weights: of each kind, before weighing, and
    apart from 1 / size; kinds: its rows; used: how many of them have weight. ends: curvature at the frames' ends.
    factor: of the samples' normal equations.
    """

    built: TrainDescription
    sizes: Sizes
    left: dict[str, Array]
    weights: dict[str, Array]
    kinds: dict[str, slice]
    used: dict[str, int]
    ends: Array
    residual: Array
    by_sample: csr_array
    by_number: Array
    factor: tuple[Array, bool]

    @classmethod
    def of(cls, log: TrainLog, built: TrainDescription, motion: Motion, sizes: Sizes) -> "Equations":
        """Return the equations of a train as it is built; raises InputError where they have no solution."""
        built = sizes.with_noise(built)
        bends = log.bends(built, motion)
        weights, left = log.weights(built, bends), log.residuals(built, motion, bends.ends)
        derivatives, kinds, used, parts, at = log.jacobians(built, motion, bends), {}, {}, [], 0
        for kind, values in left.items():
            weight, jacobian = weights[kind] / sizes.of(kind), derivatives[kind]
            matrix = csr_array(
                _blocks(weight) @ jacobian.by_sample if _mixes(weight) else jacobian.by_sample * weight.reshape(-1, 1)
            )
            parts.append((_weighed(values.reshape(-1, 1), weight)[:, 0], matrix, _weighed(jacobian.by_number, weight)))
            kinds[kind] = slice(at, at + values.size)
            used[kind] = int(np.count_nonzero(np.any(weight.reshape(values.size, -1) != 0, axis=1)))
            at += values.size
        residuals, matrices, numbers = zip(*parts, strict=True)
        by_sample = csr_array(vstack(matrices, format="csr"))
        factor = _banded(by_sample, log.block)
        columns = np.concatenate(residuals), by_sample, np.concatenate(numbers)
        return cls(built, sizes, left, weights, kinds, used, bends.ends, *columns, factor)

    def without(self, kinds: Sequence[str], block: int) -> tuple["Equations", NDArray[np.bool_]]:
        """Return the equations to solve without those of some kinds, and which rows (R,) remain; block: unknowns of a
        sample."""
        kept = np.ones(len(self.residual), dtype=bool)
        for kind in kinds:
            kept[self.kinds.get(kind, slice(0))] = False
        by_sample = csr_array(self.by_sample[kept])
        return replace(self, by_sample=by_sample, factor=_banded(by_sample, block)), kept

    def weighed(self, kind: str, change: Array) -> Array:
        """Return the column (R,) of a parameter that adds `change` to the residuals of one kind of equations."""
        column = np.zeros(len(self.residual))
        column[self.kinds[kind]] = _weighed(change.reshape(-1, 1), self.weights[kind] / self.sizes.of(kind))[:, 0]
        return column

    def weighed_residual(self, left: Mapping[str, Array]) -> Array:
        """Return residuals of every kind, of another motion, with the weights of this one (R,)."""
        parts = [_weighed(left[kind].reshape(-1, 1), self.weights[kind] / self.sizes.of(kind)) for kind in self.kinds]
        return np.concatenate(parts)[:, 0]

    def solved(self, right: Array) -> Array:
        """Return the least-squares solution of the samples' unknowns for right-hand sides `right` (R, ...)."""
        return np.asarray(cho_solve_banded(self.factor, np.asarray(self.by_sample.T @ right), check_finite=False))

    def eliminated(self, columns: Array, prior: Array, number: Array) -> tuple[Array, Array]:
        """Return information (P, P) and score (P,) of P parameters, the last of `columns` (R, n + P), motion and n
        nuisances eliminated. prior: precisions of nuisances; number: where they are (n,)."""
        n = len(prior)
        apart = columns - self.by_sample @ self.solved(columns)
        strength, slope = columns.T @ apart, -(apart.T @ self.residual)
        strength[:n, :n] += np.diag(prior)
        slope[:n] -= prior * number
        taken = np.linalg.solve(strength[:n, :n], strength[:n, n:])
        information = strength[n:, n:] - strength[n:, :n] @ taken
        return (information + information.T) / 2, slope[n:] - taken.T @ slope[:n]

    def long_run(self, columns: Array, prior: Array, parts: NDArray[np.intp], draws: Array) -> Array:
        """Return the variance of the scores of P parameters over that of white noise (P,), by parts of the log.

        columns (R, n + P), prior: as of `eliminated`; each parameter beside all others. parts (R,): which part of the
        log each row is of. draws (R, D): white noise, by which the variance of white residuals is estimated.
        A score is a sum over rows, of which neighbours correlate where noise lasts, as slip on one kind of floor. The
        sums within parts that are longer than it lasts hardly do, so their squares estimate the variance (Newey and
        West, Econometrica 55(3), 1987, with non-overlapping blocks). It is 1 for parameters that leave no trace.
        """
        n = len(prior)
        apart = columns - self.by_sample @ self.solved(columns)
        strength = columns.T @ apart
        strength[:n, :n] += np.diag(prior)
        scale = np.sqrt(np.where(np.diag(strength) > 0, np.diag(strength), 1.0))
        inverse = np.linalg.pinv(strength / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(
            scale, scale
        )
        shown = np.diag(inverse)[n:] > 0
        seen = apart @ inverse[:, n:] / np.where(shown, np.diag(inverse)[n:], 1.0)
        rows = np.column_stack([self.residual, draws])
        left = rows - self.by_sample @ self.solved(rows)
        left = left - apart @ (inverse @ (apart.T @ rows))
        starts = np.argsort(parts, kind="stable")
        ends = np.flatnonzero(np.diff(parts[starts], prepend=parts[starts[0]] - 1))
        sums = np.add.reduceat((seen[:, :, None] * left[:, None])[starts], ends, axis=0)
        squares = np.sum(sums**2, axis=0)
        return np.divide(squares[:, 0], np.mean(squares[:, 1:], axis=1), out=np.ones(len(shown)), where=shown)

    def sample_of_rows(self, block: int) -> NDArray[np.intp]:
        """Return the first sample (R,) that each row depends on; block: unknowns of a sample."""
        matrix = self.by_sample
        filled = np.diff(matrix.indptr) > 0
        first = np.zeros(len(self.residual), dtype=np.intp)
        first[filled] = np.minimum.reduceat(matrix.indices, matrix.indptr[:-1][filled])
        return first // block


def _mixes(weight: Array) -> bool:
    """Whether weights are matrices (K, 3, 3), those of gauges."""
    return weight.ndim == 3 and weight.shape[1:] == (3, 3)


def _weighed(values: Array, weight: Array) -> Array:
    """Return values (rows, ...) of a kind, each multiplied by its weight."""
    if _mixes(weight):
        return np.asarray(weight @ values.reshape(len(weight), 3, -1)).reshape(3 * len(weight), -1)
    return values * weight.reshape(-1, 1)


def _blocks(weight: Array) -> csr_array:
    """Return matrices (K, 3, 3) as one of blocks along the diagonal."""
    k = len(weight)
    indices = np.broadcast_to(np.arange(3 * k).reshape(k, 1, 3), weight.shape).ravel()
    return csr_array((weight.ravel(), indices, np.arange(0, 9 * k + 1, 3)), shape=(3 * k, 3 * k))


def _banded(matrix: csr_array, block: int) -> tuple[Array, bool]:
    normal = (matrix.T @ matrix).tocoo()
    row, column = normal.coords
    lower = row >= column
    band = np.zeros((2 * block, normal.shape[0]))
    band[(row - column)[lower], column[lower]] = normal.data[lower]
    try:
        return cholesky_banded(band, lower=True), True
    except (np.linalg.LinAlgError, ValueError):
        raise InputError(
            "the logs do not fit the train at all; check the order of wheels and frames, their signs, and counts a turn"
        ) from None


def fit_states(
    train: TrainDescription,
    logs: Sequence[TrainLog],
    start: FittedStates | None = None,
    sizes: Sizes | None = None,
    terms: Sequence[Term] = (),
) -> FittedStates:
    """Return the likeliest motions in logs of a train with its effects, and the sizes of noise.

    start: the result of a similar train. sizes: known sizes; None: they are fitted. terms: fitted too, without
    prior.
    """
    amount, built = np.zeros(len(terms)), train.as_built()
    motions = [log.start(built) for log in logs] if start is None else list(start.motions)
    current = sizes or (Sizes(gauges=(1.0,) * len(train.frames)) if start is None else start.sizes)
    rounds, last, deviance = COLD_ROUNDS if start is None else WARM_ROUNDS, np.inf, 0.0
    for turn in range(rounds):
        squares, free, deviance = defaultdict[str, float](float), defaultdict[str, float](float), 0.0
        for j, log in enumerate(logs):
            problem = Equations.of(log, built, motions[j], current)
            prior, number, columns = log.prior(train) ** -2.0, log.nuisances(motions[j]), problem.by_number
            residual, own = problem.residual, [r for r, term in enumerate(terms) if term.log == j]
            for r in own:
                change = problem.weighed(terms[r].kind, terms[r].change)
                residual, columns = residual + amount[r] * change, np.column_stack([columns, change])
                prior, number = np.append(prior, 0.0), np.append(number, 0.0)
            states = problem.solved(np.column_stack([residual, columns]))
            apart = np.column_stack([residual, columns]) - problem.by_sample @ states
            strength = columns.T @ apart[:, 1:] + np.diag(prior)
            by_number: Array = -np.linalg.solve(strength, columns.T @ apart[:, 0] + prior * number).astype(float)
            by_sample = -(states[:, 0] + states[:, 1:] @ by_number).reshape(log.k, log.block)
            left = apart[:, 0] + apart[:, 1:] @ by_number
            before, squares_before, part = motions[j], residual @ residual + np.sum(prior * number**2), 1.0
            while True:
                motions[j] = before.moved(part * by_sample, part * by_number[: log.numbers])
                there = problem.weighed_residual(log.residuals(problem.built, motions[j]))
                there = there + columns[:, log.numbers :] @ (amount[own] + part * by_number[log.numbers :])
                squares_there = there @ there + np.sum(prior * (number + part * by_number) ** 2)
                if squares_there <= squares_before or part <= SHORTEST:
                    break
                part /= 2
            amount[own] += part * by_number[log.numbers :]
            deviance += float(left @ left + np.sum(prior * (number + by_number) ** 2))
            shared = strength[: log.numbers, : log.numbers]
            deviance += float(np.linalg.slogdet(shared)[1] - np.sum(np.log(prior[: log.numbers])))
            deviance += 2 * float(np.sum(np.log(problem.factor[0][0])))
            # All turns are as likely before, so of the ways that wheels roll those of a narrow track were denser.
            deviance -= 2 * (log.k - 1) * float(np.sum(np.log(bending.half_track(built))))
            for kind, rows in problem.used.items():
                deviance += 2 * rows * np.log(current.of(kind))
            for f in range(log.f):
                scale = np.linalg.det(problem.weights[f"gauges{f}"][log.read[:, f]])
                deviance -= 2 * float(np.sum(np.log(scale)))
            if sizes is None:
                probes = np.random.default_rng(0).choice([-1.0, 1.0], (len(left), PROBES))
                taken = probes * (problem.by_sample @ problem.solved(probes))
                for kind, span in problem.kinds.items():
                    squares[kind] += float(left[span] @ left[span])
                    free[kind] += max(problem.used[kind] - float(taken[span].sum()) / PROBES, 1.0)
        if start is not None and turn > 1 and abs(deviance - last) < STILL:
            break
        last = deviance
        if sizes is None and (start is not None or turn >= FIRST) and turn < rounds - 1:
            current = _resized(current, squares, free)
    return FittedStates(tuple(motions), current, deviance)


def _resized(sizes: Sizes, squares: Mapping[str, float], free: Mapping[str, float]) -> Sizes:
    for kind in squares:
        sizes = sizes.changed(kind, float(np.clip((squares[kind] / free[kind]) ** 0.5, 0.2, 5.0)))
    return sizes


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

    start: see `fit_states`. These steps follow from a fit without sliding, as forces show only in slip. If the
    remaining steps then show no tension, the apparent sliding has another cause, unless frames are bent so much.
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


def always_sliding(train: TrainDescription, logs: Sequence[TrainLog], motions: Sequence[Motion]) -> list[int]:
    """Return the axles, from 1, that seem to slide in more than the part `OFTEN` of a log's steps, by these motions of
    a train with its effects."""
    built = train.as_built()
    often = [log.sliding(built, motion).mean(axis=0) > OFTEN for log, motion in zip(logs, motions, strict=True)]
    return (np.flatnonzero(np.any(often, axis=0)) + 1).tolist()


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
