"""Information and score of every candidate in logs of trains, motion and nuisances eliminated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array, vstack

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.random_effects import Statistics, summed
from discrepancy.trains.candidates import Candidate, Rival
from discrepancy.trains.motion import FITTED, LEAST_SIZE, MOST_SIZE, Motion, Sizes
from discrepancy.trains.rows import TrainLog
from discrepancy.validation.cost import cost_of_sizes

PROBES = 8
"""Random vectors with which the degrees of freedom that the motion takes from each kind of equations are estimated."""

COLD_ROUNDS, WARM_ROUNDS = 10, 8
"""Most rounds in which motion and sizes are fitted, from no start and from those of a similar train."""

STILL = 1.0
"""Change of deviance between rounds at which a fit that began from a similar train ends."""

FIRST = 3
"""Rounds without a start before sizes are fitted."""

LEAST_GAUGES = 0.3
"""Lower bound of the noise of gauges, as a part of the described noise."""


@dataclass(frozen=True, eq=False)
class FittedStates:
    """The fitted motions of logs, and the sizes of noise.

    deviance: minus twice the logarithm of the likelihood, nuisances integrated out, up to a constant of the logs.
    """

    motions: tuple[Motion, ...]
    sizes: Sizes
    deviance: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """Statistics of P candidates in each log, in their units. cost (2, P): error of the train's localisation by counts
    and relative poses per unit of each candidate that is ignored: m after 10 m, rad after a turn."""

    candidates: tuple[Candidate, ...]
    logs: tuple[Statistics, ...]
    cost: Array
    fit: FittedStates

    @property
    def information(self) -> Array:
        """Information of all logs together (P, P)."""
        return summed(self.logs).information

    @property
    def score(self) -> Array:
        """Score: the gradient of the log-likelihood of all logs (P,)."""
        return summed(self.logs).score

    def best(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return the maximum-likelihood amplitudes of these candidates together (c,), and their covariance (c, c)."""
        covariance = np.linalg.pinv(self.information[np.ix_(chosen, chosen)], rcond=1e-12, hermitian=True)
        return covariance @ self.score[list(chosen)], np.asarray(covariance, dtype=float)


@dataclass(frozen=True, eq=False)
class _Problem:
    """One log's equations around a motion, weighed: residual (R,), derivatives by samples and numbers (R, n)."""

    kinds: dict[str, slice]
    residual: Array
    by_sample: csr_array
    by_number: Array
    factor: tuple[Array, bool]
    rows: dict[str, int]

    def weighed(self, kind: str, change: Array, weights: dict[str, Array], sizes: Sizes) -> Array:
        """Return the column (R,) of a parameter that adds `change` to the residuals of one kind of equations."""
        column = np.zeros(len(self.residual))
        column[self.kinds[kind]] = _weighed(change.reshape(-1, 1), weights[kind] / sizes.of(kind))[:, 0]
        return column

    def solved(self, right: Array) -> Array:
        """Return the least-squares solution of the samples' unknowns for right-hand sides `right` (R, ...)."""
        return np.asarray(cho_solve_banded(self.factor, np.asarray(self.by_sample.T @ right), check_finite=False))


def _weighed(values: Array, weight: Array) -> Array:
    """Return values (rows, ...) of a kind, each multiplied by its weight; gauges' (K, 3, 3) by matrices."""
    if weight.ndim == 3 and weight.shape[1:] == (3, 3):
        k = len(weight)
        return np.asarray(weight @ values.reshape(k, 3, -1)).reshape(3 * k, -1)
    return values * weight.reshape(-1, 1)


def _problem(
    log: TrainLog, built: TrainDescription, motion: Motion, sizes: Sizes
) -> tuple[_Problem, dict[str, Array], dict[str, Array], Array]:
    """Return a log's equations, their residuals and weights by kinds, and the curvatures at the frames' ends."""
    bends = log.bends(built, motion)
    weights = log.weights(built, bends)
    left, derivatives = log.residuals(built, motion, bends.ends), log.jacobians(built, motion, bends)
    kinds, parts, matrices, numbers, rows, at = {}, [], [], [], {}, 0
    for kind, values in left.items():
        weight, jacobian = weights[kind] / sizes.of(kind), derivatives[kind]
        part = _weighed(values.reshape(-1, 1), weight)[:, 0]
        matrices.append(_sparse_weighed(jacobian.by_sample, weight))
        numbers.append(_weighed(jacobian.by_number, weight))
        parts.append(part)
        kinds[kind] = slice(at, at + len(part))
        rows[kind] = int(np.count_nonzero(np.any(weight.reshape(len(part), -1) != 0, axis=1)))
        at += len(part)
    matrix = csr_array(vstack(matrices, format="csr"))
    factor = _banded(matrix, log.block)
    problem = _Problem(kinds, np.concatenate(parts), matrix, np.concatenate(numbers), factor, rows)
    return problem, left, weights, bends.ends


def _sparse_weighed(matrix: csr_array, weight: Array) -> csr_array:
    if weight.ndim == 3 and weight.shape[1:] == (3, 3):
        k = len(weight)
        places = np.arange(3 * k).reshape(k, 1, 3)
        indices = np.broadcast_to(places, (k, 3, 3)).ravel()
        blocks = csr_array((weight.ravel(), indices, np.arange(0, 9 * k + 1, 3)), shape=(3 * k, 3 * k))
        return csr_array(blocks @ matrix)
    return csr_array(matrix * weight.reshape(-1, 1))


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
    unnamed: Sequence[Rival] = (),
) -> FittedStates:
    """Return the likeliest motions in logs of a train with its effects, and the sizes of noise.

    start: the result of a similar train. sizes: known sizes; None: they are fitted. unnamed: alternatives that are
    fitted too, without prior.
    """
    amount, built = np.zeros(len(unnamed)), train.as_built()
    motions = [log.start(built) for log in logs] if start is None else list(start.motions)
    current = sizes or (Sizes(gauges=(1.0,) * len(train.frames)) if start is None else start.sizes)
    deviance = 0.0
    rounds, last = COLD_ROUNDS if start is None else WARM_ROUNDS, np.inf
    for turn in range(rounds):
        squares: dict[str, float] = {}
        free: dict[str, float] = {}
        deviance = 0.0
        for j, log in enumerate(logs):
            problem, _, weights, _ = _problem(log, built, motions[j], current)
            prior, number, columns = log.prior(train) ** -2.0, log.nuisances(motions[j]), problem.by_number
            residual = problem.residual
            log_rivals = [r for r, rival in enumerate(unnamed) if rival.log == j]
            for r in log_rivals:
                change = problem.weighed(unnamed[r].kind, unnamed[r].change, weights, current)
                residual, columns = residual + amount[r] * change, np.column_stack([columns, change])
                prior, number = np.append(prior, 0.0), np.append(number, 0.0)
            states = problem.solved(np.column_stack([residual, columns]))
            apart = np.column_stack([residual, columns]) - problem.by_sample @ states
            strength = columns.T @ apart[:, 1:] + np.diag(prior)
            by_number: Array = -np.linalg.solve(strength, columns.T @ apart[:, 0] + prior * number).astype(float)
            by_sample = -(states[:, 0] + states[:, 1:] @ by_number)
            left = apart[:, 0] + apart[:, 1:] @ by_number
            motions[j] = motions[j].moved(by_sample.reshape(log.k, log.block), by_number[: log.numbers])
            amount[log_rivals] += by_number[log.numbers :]
            deviance += float(left @ left + np.sum(prior * (number + by_number) ** 2))
            shared = strength[: log.numbers, : log.numbers]
            deviance += float(np.linalg.slogdet(shared)[1] - np.sum(np.log(prior[: log.numbers])))
            deviance += 2 * float(np.sum(np.log(problem.factor[0][0])))
            for kind, rows in problem.rows.items():
                deviance += 2 * rows * np.log(current.of(kind))
            for f in range(log.f):
                scale = np.linalg.det(weights[f"gauges{f}"][log.read[:, f]])
                deviance -= 2 * float(np.sum(np.log(scale)))
            if sizes is None:
                probes = np.random.default_rng(0).choice([-1.0, 1.0], (len(left), PROBES))
                taken = probes * (problem.by_sample @ problem.solved(probes))
                for kind, span in problem.kinds.items():
                    squares[kind] = squares.get(kind, 0.0) + float(left[span] @ left[span])
                    dof = problem.rows[kind] - float(taken[span].sum()) / PROBES
                    free[kind] = free.get(kind, 0.0) + max(dof, 1.0)
        if start is not None and turn > 1 and abs(deviance - last) < STILL:
            break
        last = deviance
        if sizes is None and (start is not None or turn >= FIRST) and turn < rounds - 1:
            current = _resized(current, squares, free)
    return FittedStates(tuple(motions), current, deviance)


def _resized(sizes: Sizes, squares: dict[str, float], free: dict[str, float]) -> Sizes:
    for kind in squares:
        if kind not in FITTED and not kind.startswith("gauges"):
            continue
        least = LEAST_SIZE.get(kind, LEAST_GAUGES)
        change = np.clip((squares[kind] / free[kind]) ** 0.5, 0.2, 5.0)
        sizes = sizes.with_size(kind, float(np.clip(sizes.of(kind) * change, least, MOST_SIZE.get(kind, np.inf))))
    return sizes


def evidence_of(
    train: TrainDescription, logs: Sequence[TrainLog], found: FittedStates, candidates: Sequence[Candidate]
) -> Evidence:
    """Return the statistics of candidates beyond the effects in the train's file, linearised about fitted motions."""
    built = train.as_built()
    enlarged = [None if candidate.placed is None else candidate.placed.enlarged(train) for candidate in candidates]
    statistics, costs = [], []
    for j, (log, motion) in enumerate(zip(logs, found.motions, strict=True)):
        problem, zero, weights, ends = _problem(log, built, motion, found.sizes)
        columns = np.zeros((len(problem.residual), log.numbers + len(candidates)))
        columns[:, : log.numbers] = problem.by_number
        for column, candidate, larger in zip(columns.T[log.numbers :], candidates, enlarged, strict=True):
            if larger is not None:
                changed = log.residuals(larger[0].as_built(), motion, ends)
                changes = {kind: (changed[kind] - zero[kind]) / larger[1] for kind in zero}
                if (gauge := candidate.restored(larger[1])) is not None:
                    at, (kind, change) = log.offset_of(*gauge, larger[0].as_built(), motion, ends, changed)
                    columns[:, at] = problem.weighed(kind, change, weights, found.sizes)
            else:
                rival = candidate.rival
                assert rival is not None
                changes = {rival.kind: rival.change} if rival.log == j else {}
            for kind, change in changes.items():
                if change.any():
                    column += problem.weighed(kind, change, weights, found.sizes)
        prior = log.prior(train) ** -2.0
        statistics.append(_statistics_of(problem, columns, prior, log.nuisances(motion)))
        costs.append(_cost(log, motion, problem, columns, prior))
    return Evidence(tuple(candidates), tuple(statistics), np.sqrt(np.mean(np.square(costs), axis=0)), found)


def _statistics_of(problem: _Problem, columns: Array, prior: Array, number: Array) -> Statistics:
    """Return a log's statistics of P parameters, the last columns of `columns` (R, n + P), motion and n nuisances
    eliminated."""
    n = len(prior)
    apart = columns - problem.by_sample @ problem.solved(columns)
    strength, slope = columns.T @ apart, -(apart.T @ problem.residual)
    strength[:n, :n] += np.diag(prior)
    slope[:n] -= prior * number
    taken = np.linalg.solve(strength[:n, :n], strength[:n, n:])
    information = strength[n:, n:] - strength[n:, :n] @ taken
    return Statistics((information + information.T) / 2, slope[n:] - taken.T @ slope[:n])


def cost_of_noise(train: TrainDescription, logs: Sequence[TrainLog], found: FittedStates, f: int) -> Array:
    """Return the error of the train's localisation (2,) by white noise of 1 in each reading of a frame's gauges."""
    built, random, costs = train.as_built(), np.random.default_rng(0), []
    for log, motion in zip(logs, found.motions, strict=True):
        problem, _, weights, _ = _problem(log, built, motion, found.sizes)
        by_gauge = log.bends(built, motion).by_gauge[f]
        noise = random.standard_normal((PROBES, len(by_gauge), by_gauge.shape[-1], 1))
        changes = [(by_gauge @ draw)[..., 0] * log.read[:, f, None] for draw in noise]
        columns = [problem.weighed(f"gauges{f}", change, weights, found.sizes) for change in changes]
        all_columns = np.column_stack([problem.by_number, *columns])
        costs.append(np.mean(_cost(log, motion, problem, all_columns, log.prior(train) ** -2.0) ** 2, axis=1))
    return np.sqrt(np.mean(costs, axis=0))


def _cost(log: TrainLog, motion: Motion, problem: _Problem, columns: Array, prior: Array) -> Array:
    """Return the error of the train's localisation (2, P) per unit of each of P ignored columns (`cost_of_sizes`).

    Of the axle with the largest error. The train is localised by counts and relative poses, without a reference.
    """
    known = np.ones(len(columns), dtype=bool)
    for kind in ("position", "heading"):
        known[problem.kinds.get(kind, slice(0))] = False
    by_sample, n = csr_array(problem.by_sample[known]), len(prior)
    without = replace(problem, by_sample=by_sample, factor=_banded(by_sample, log.block))
    states = without.solved(columns[known])
    apart = columns[known] - by_sample @ states
    by_number = np.linalg.solve(
        columns[known, :n].T @ apart[:, :n] + np.diag(prior), columns[known, :n].T @ apart[:, n:]
    )
    off = (states[:, n:] - states[:, :n] @ by_number).reshape(log.k, log.block, -1)
    costs = [_cost_of_path(motion.pose[:, i], off[:, 3 * i : 3 * i + 3]) for i in range(log.n)]
    return np.max(costs, axis=0)


def _cost_of_path(pose: Array, off: Array) -> Array:
    """Return the cost (2, P) of errors `off` (K, 3, P) of a path (K, 3)."""
    step, heading = np.diff(pose, axis=0), (pose[1:, 2] + pose[:-1, 2]) / 2
    c, s, turned = np.cos(heading)[:, None], np.sin(heading)[:, None], (off[1:, 2] + off[:-1, 2]) / 2
    x = np.diff(off[:, 0], axis=0) + turned * step[:, 1:2]
    y = np.diff(off[:, 1], axis=0) - turned * step[:, :1]
    return cost_of_sizes([np.stack([c * x + s * y, c * y - s * x, np.diff(off[:, 2], axis=0)], axis=1)], pose)
