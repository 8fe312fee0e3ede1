"""Statistics of parameters in one log: its equations with states, and numbers of the log alone, eliminated."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from estimators.likelihood.elimination import (
    LARGE,
    Prior,
    Rows,
    blocks,
    eliminated,
    factored,
    information_on_states,
    solved,
    variances,
)

Fields = Callable[[str, Array, slice], list[tuple[str, Array]]]
"""From a kind of equations, residuals of some of them (k, rows, c), and which: residuals by the fields of `Noise`."""


class Leftover(NamedTuple):
    """Residuals by the fields of `Noise`: sums of squares over variances, and their expected values."""

    squares: dict[str, float]
    expected: dict[str, float]


class Reduced(NamedTuple):
    """Statistics of P parameters in one log, state and the log's own numbers eliminated, linearised about a state.

    Own numbers are those of the reference's clock, and of the gyro.

    information (P, P); gradient (P, 1 + probes): of half the sum of squares, then of the same with drawn residuals.
    with_own: information and gradient of half the sum of squares of the parameters and the log's own numbers.
    log_evidence: returns the log-likelihood of the log with the parameters unchanged, state and own numbers integrated
    out (natural logarithm, up to a constant of the log). finish: maps changes of the parameters (P, 1 + probes) and the
    part of the step that is taken to the changed state and clock, and the remaining residuals. squares: maps any
    geometry, state, clock and mount to the sum of squares there, with the weights of this state; at_state: here.
    variances: returns those of the state (K, m).
    """

    information: Array
    gradient: Array
    with_own: tuple[Array, Array]
    log_evidence: Callable[[], float]
    finish: Callable[..., tuple[Array, Array, Leftover]]
    squares: Callable[[Geometry, Array, Array, Array], float]
    at_state: float
    variances: Callable[[], Array]


def reduced(
    kinds: dict[str, Rows],
    state: Array,
    own: Array,
    prior: Prior,
    p: int,
    probes: int,
    fields: Fields,
    squares: Callable[[Geometry, Array, Array, Array], float],
    at_state: float,
) -> Reduced:
    """Return the statistics of p parameters from equations by kind, whose numbers are these and the log's own: first
    the clock's two, then any that are linear.

    The log evidence is that of equations over their standard deviations: without the logarithms of these.
    """
    from scipy.linalg import cho_solve_banded  # slow to import

    size, n = state.shape[1], p + len(own)
    factors = factored(lambda: information_on_states(kinds.values(), len(state), size), rounded="position" not in kinds)
    numbers_block, half = eliminated(kinds.values(), factors, n + 1 + probes)
    least = float(numbers_block[n, n])
    numbers_block = numbers_block[:n]
    numbers_block[p:, p:n] += np.diag(prior.deviation**-2.0)
    numbers_block[p:, n] += (own - prior.expected) / prior.deviation**2
    least += float(np.sum(prior.off(own) ** 2))
    set_to = np.linalg.solve(numbers_block[p:, p:n], np.delete(numbers_block[p:], np.s_[p:n], axis=1))
    reduced = np.delete(numbers_block[:p], np.s_[p:n], axis=1) - numbers_block[:p, p:n] @ set_to
    least -= float(numbers_block[p:, n] @ set_to[:, p])

    def log_evidence() -> float:
        by_own = float(np.linalg.slogdet(numbers_block[p:, p:n])[1]) / 2
        return -least / 2 - float(np.sum(np.log(factors[-1]))) - by_own

    def finish(moved_by: Array, part: float = 1.0) -> tuple[Array, Array, Leftover]:
        set_by = -(set_to[:, p:] + set_to[:, :p] @ moved_by)
        all_by = np.concatenate([moved_by, set_by])
        if half is not None:
            away = solved(factors, half[:, n:] + half[:, :n] @ all_by)
        else:
            columns = np.zeros((1 + probes, len(state), size)).transpose(1, 2, 0)  # LAPACK's order: solved in place
            for block in blocks(len(state), LARGE):
                for rows in kinds.values():
                    chosen = rows.within(block.start, block.stop)
                    if chosen.start < chosen.stop:
                        rows.add_by_state(columns, 0, chosen, rows.left(chosen, all_by))
            away = columns.reshape(-1, 1 + probes)
            away = cho_solve_banded((factors, False), away, overwrite_b=True, check_finite=False)
        away = np.negative(away, out=away).reshape(len(state), size, 1 + probes)
        if part < 1:
            away[..., 0], all_by[:, 0], set_by[:, 0] = part * away[..., 0], part * all_by[:, 0], part * set_by[:, 0]
        total: dict[str, Array] = {}
        for name, rows in kinds.items():
            for block in blocks(len(state), LARGE):
                chosen = rows.within(block.start, block.stop)
                left = rows.left(chosen, all_by) + rows.by_state(chosen, away)
                for field, residuals in fields(name, left, chosen):
                    total[field] = total.get(field, np.zeros(1 + probes)) + np.sum(residuals**2, axis=(0, 1))
        of_log = {field: float(sums[0]) for field, sums in total.items()}
        expected = {field: float(np.mean(sums[1:])) if probes else 0.0 for field, sums in total.items()}
        return state + away[..., 0], own[:2] + set_by[:2, 0], Leftover(of_log, expected)

    return Reduced(
        (reduced[:, :p] + reduced[:, :p].T) / 2,
        reduced[:, p:],
        (numbers_block[:, :n], numbers_block[:, n]),
        log_evidence,
        finish,
        squares,
        at_state,
        lambda: variances(factors),
    )
