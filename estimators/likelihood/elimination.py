"""Elimination of a log's states from its normal equations, which are banded: each step ties two samples only."""

from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array

BLOCK = 256
"""Samples whose columns are in memory at a time."""


class Rows(NamedTuple):
    """Equations of one kind, over their standard deviations, one sample or step k after another.

    at (k,): the sample, none before the last. values (k, rows); derivatives by the state at that sample, `start` (k,
    rows, m), and at the next sample, `end`, or None. numbers: maps a slice of equations to derivatives by parameters,
    mount and clock (k, rows, P + 5), or None; drawn (k, rows, probes): drawn residuals in place of values.
    """

    at: NDArray[np.intp]
    values: Array
    start: Array
    end: Array | None = None
    numbers: Callable[[slice], Array] | None = None
    drawn: Array | None = None

    def within(self, first: int, last: int) -> slice:
        """Return the equations of samples from `first` to before `last`."""
        return slice(*np.searchsorted(self.at, (first, last)).tolist())

    def right(self, chosen: slice, count: int) -> Array:
        """Return derivatives by `count` numbers, values and drawn residuals of chosen equations (k, rows, columns)."""
        values = self.values[chosen, :, None]
        by = np.zeros((*values.shape[:2], count)) if self.numbers is None else self.numbers(chosen)
        return np.concatenate([by, values, *(() if self.drawn is None else (self.drawn[chosen],))], axis=-1)


def eliminated(kinds: Collection[Rows], factors: Array, count: int, columns: int) -> Array:
    """Return products of numbers' derivatives, values and drawn residuals (columns, columns), states eliminated.

    factors: upper banded Cholesky factors of the information on states. Columns are computed, and states eliminated,
    for `BLOCK` samples at a time: all at once they would take a hundred times the memory of a log.
    """
    from scipy.linalg import get_lapack_funcs  # slow to import

    (solve,) = get_lapack_funcs(("tbtrs",), (factors,))
    size = len(factors) // 2
    samples = factors.shape[1] // size
    total, over = np.zeros((columns, columns)), np.zeros((size, columns))
    for samples_of_block in blocks(samples):
        first, last = samples_of_block.start, samples_of_block.stop
        block = np.zeros((last - first + 1, size, columns))
        block[0] = over
        for rows in kinds:
            chosen = rows.within(first, last)
            if chosen.start == chosen.stop:
                continue
            right, at = rows.right(chosen, count), rows.at[chosen] - first
            add(block, at, np.swapaxes(rows.start[chosen], 1, 2) @ right)
            if rows.end is not None:
                add(block, at + 1, np.swapaxes(rows.end[chosen], 1, 2) @ right)
            total += _squared(right.reshape(-1, columns))
        half, _ = solve(factors[:, first * size : last * size], block[:-1].reshape(-1, columns), trans="T")
        total -= _squared(half)
        if last < samples:
            after = factors[:, last * size : (last + 1) * size]
            above = np.array([[after[size - 1 + a - b, b] for b in range(size)] for a in range(size)])
            over = block[-1] - above.T @ half[-size:]
    return total


def blocks(count: int, most: int = BLOCK) -> list[slice]:
    """Return slices of at most so many of samples or steps."""
    return [slice(first, min(first + most, count)) for first in range(0, count, most)]


def left_by(rows: Rows, by: Array, samples: int) -> Array:
    """Return the residuals (k, rows, 1 + probes) of values and drawn residuals after changes of numbers (P + 5, 1 +
    probes)."""
    slices = (rows.within(block.start, block.stop) for block in blocks(samples))
    rights = (rows.right(chosen, len(by)) for chosen in slices)
    return np.concatenate([right[..., len(by) :] + right[..., : len(by)] @ by for right in rights])


def _squared(rows: Array) -> Array:
    """Return the products of all columns with each other (n, n); twice as fast as a product of two matrices."""
    return rows.T @ rows


def add(total: Array, at: NDArray[np.intp], values: Array) -> None:
    """Add values (k, ...) to a total (K, ...) at some samples, several times where a sample comes several times."""
    if len(at) == at[-1] - at[0] + 1 and np.all(np.diff(at) == 1):
        total[at[0] : at[-1] + 1] += values
    else:
        np.add.at(total, at, values)


def banded(diagonal: Array, above: Array) -> Array:
    """Return a symmetric matrix of blocks (K, m, m) and those right of them (K - 1, m, m) in upper banded form."""
    k, m, _ = diagonal.shape
    band = np.zeros((2 * m, k, m))
    for a in range(m):
        for b in range(m):
            if a <= b:
                band[2 * m - 1 + a - b, :, b] = diagonal[:, a, b]
            band[m - 1 + a - b, 1:, b] = above[:, a, b]
    return band.reshape(2 * m, k * m)
