"""Elimination of a log's states from its normal equations, which are banded: each step ties two samples only."""

from collections.abc import Callable, Collection
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array

BLOCK, LARGE = 256, 1024
"""Samples whose columns are in memory at a time: of hundreds of columns, and of few."""

FEW = 64
"""Most columns of which `LARGE` blocks are made."""

ROUNDING = 1e-14
"""Part of an information matrix's diagonal that counts as rounding: fifty times the spacing of double precision."""


class Prior(NamedTuple):
    """Normal priors of independent numbers: their means and standard deviations (n,)."""

    expected: Array
    deviation: Array

    def off(self, numbers: Array) -> Array:
        """Return how far numbers (n,) are from their means, in standard deviations."""
        return (numbers - self.expected) / self.deviation

    def joined(self, other: "Prior") -> "Prior":
        """Return the priors of these numbers, then those of another."""
        return Prior(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class Rows(NamedTuple):
    """Equations of one kind, over their standard deviations, one sample or step k after another.

    at (k,): the sample, none before the last. values (k, rows). start, end, numbers map a slice of equations to
    derivatives: by the state at that sample (k, rows, m), at the next sample (or None), and by n numbers: parameters,
    mount, clock, and those of a gyro (k, rows, n). drawn (k, rows, probes): drawn residuals in place of values, of any
    type of number. own: where each row depends on one number of the state only, the number of the first, as the next
    row depends on the next; start and end then map to derivatives (k, rows, 1). None: rows depend on all m.
    """

    at: NDArray[np.intp]
    values: Array
    start: Callable[[slice], Array]
    end: Callable[[slice], Array] | None = None
    numbers: Callable[[slice], Array] | None = None
    drawn: Array | None = None
    own: int | None = None

    def within(self, first: int, last: int) -> slice:
        """Return the equations of samples from `first` to before `last`."""
        return slice(*np.searchsorted(self.at, (first, last)).tolist())

    def right(self, chosen: slice) -> Array:
        """Return derivatives by numbers, if there are any, values and drawn residuals of chosen equations (k, rows,
        columns)."""
        by = () if self.numbers is None else (self.numbers(chosen),)
        drawn = () if self.drawn is None else (self.drawn[chosen],)
        return np.concatenate([*by, self.values[chosen, :, None], *drawn], axis=-1)

    def left(self, chosen: slice, by: Array) -> Array:
        """Return the residuals (k, rows, 1 + probes) of values and drawn residuals of chosen equations after changes of
        numbers (n, 1 + probes)."""
        right = self.right(chosen)
        return right if self.numbers is None else right[..., len(by) :] + right[..., : len(by)] @ by

    def add_by_state(self, total: Array, first: int, chosen: slice, right: Array) -> None:
        """Add the products of derivatives by the state with columns (k, rows, c) of chosen equations to a total
        (K, m, c) that begins at sample `first`."""
        at = self.at[chosen] - first
        for after, derivatives in enumerate((self.start, self.end)):
            if derivatives is not None and self.own is None:
                add(total, at + after, np.swapaxes(derivatives(chosen), 1, 2) @ right)
            elif derivatives is not None:
                add(total[:, self._numbers], at + after, derivatives(chosen) * right)

    def by_state(self, chosen: slice, away: Array) -> Array:
        """Return the changes (k, rows, c) of chosen equations by changes of the state (K, m, c)."""
        at, by = self.at[chosen], np.matmul if self.own is None else np.multiply
        away = away[:, self._numbers]
        changes: Array = by(self.start(chosen), away[at])
        return changes if self.end is None else changes + by(self.end(chosen), away[at + 1])

    def add_information(self, diagonal: Array, above: Array, first: int, chosen: slice) -> None:
        """Add the information of chosen equations on each state (K + 1, m, m), and on each with the next (K, m, m), to
        totals that begin at sample `first`."""
        start, at = self.start(chosen), self.at[chosen] - first
        if self.own is None:
            turned = np.swapaxes(start, 1, 2)
            add(diagonal, at, turned @ start)
            if self.end is not None:
                end = self.end(chosen)
                add(diagonal, at + 1, np.swapaxes(end, 1, 2) @ end)
                add(above, at, turned @ end)
            return
        diagonal, above = (np.einsum("kii->ki", part)[:, self._numbers] for part in (diagonal, above))  # views
        add(diagonal, at, start[..., 0] ** 2)
        if self.end is not None:
            end = self.end(chosen)
            add(diagonal, at + 1, end[..., 0] ** 2)
            add(above, at, start[..., 0] * end[..., 0])

    @property
    def _numbers(self) -> slice:
        """The numbers of the state that the rows depend on."""
        return slice(None) if self.own is None else slice(self.own, self.own + self.values.shape[1])


def information_on_states(kinds: Collection[Rows], samples: int, size: int) -> Array:
    """Return the information on states (K, m) in upper banded form (2 m, K m), in the order of memory of LAPACK."""
    band, over = np.zeros((samples, size, 2 * size)), np.zeros((size, size))
    for block in blocks(samples, LARGE):
        first, last = block.start, block.stop
        diagonal, above = np.zeros((last - first + 1, size, size)), np.zeros((last - first, size, size))
        diagonal[0] = over
        for rows in kinds:
            chosen = rows.within(first, last)
            if chosen.start < chosen.stop:
                rows.add_information(diagonal, above, first, chosen)
        over, following = diagonal[-1], min(last + 1, samples) - first - 1
        for b in range(size):
            band[block, b, 2 * size - 1 - b :] = diagonal[:-1, : b + 1, b]
            band[first + 1 : first + 1 + following, b, size - 1 - b : 2 * size - 1 - b] = above[:following, :, b]
    return band.reshape(samples * size, 2 * size).T


def factored(information: Callable[[], Array], rounded: bool = False) -> Array:
    """Return the banded Cholesky factor of an information matrix, upper form, which may be overwritten.

    rounded: rounding may have taken all that is known of a state, as along a log whose slips are almost certain and of
    which no pose is measured; such a matrix is made larger by `ROUNDING`. Where poses are measured, it tells of a fit
    that diverged. Raises LinAlgError for a matrix that is not positive definite.
    """
    from scipy.linalg import cholesky_banded  # slow to import

    if rounded:
        with suppress(np.linalg.LinAlgError):
            return factored(information)
    matrix = information()
    matrix[-1] *= 1.0 + ROUNDING * rounded
    return np.asarray(cholesky_banded(matrix, overwrite_ab=True, check_finite=False), dtype=np.float64)


def log_determinant(information: Callable[[], Array], rounded: bool = False) -> float:
    """Return the logarithm of the determinant of an information matrix; see `factored`."""
    return 2 * float(np.sum(np.log(factored(information, rounded)[-1])))


def eliminated(kinds: Collection[Rows], factors: Array, columns: int) -> tuple[Array, Array | None]:
    """Return products of numbers' derivatives, values and drawn residuals (columns, columns), states eliminated; and of
    no more than one block what these columns times U^-T are (K m, columns), with the factors U; None of more.

    factors: upper banded Cholesky factors of the information on states. Columns are computed, and states eliminated,
    for `BLOCK` samples at a time, and few columns for `LARGE`: all at once they would take a hundred times the memory
    of a log.
    """
    from scipy.linalg import get_lapack_funcs  # slow to import

    (solve,) = get_lapack_funcs(("tbtrs",), (factors,))
    size = len(factors) // 2
    samples = factors.shape[1] // size
    total, over = np.zeros((columns, columns)), np.zeros((size, columns))
    of_samples, half = blocks(samples, most_of(columns)), None
    for samples_of_block in of_samples:
        first, last = samples_of_block.start, samples_of_block.stop
        block = np.zeros((last - first + 1, size, columns))
        block[0] = over
        for rows in kinds:
            chosen = rows.within(first, last)
            if chosen.start == chosen.stop:
                continue
            right = rows.right(chosen)
            own = slice(columns - right.shape[-1], None)  # without derivatives by numbers the last columns only
            rows.add_by_state(block[..., own], first, chosen, right)
            total[own, own] += _squared(right.reshape(-1, right.shape[-1]))
        half, _ = solve(factors[:, first * size : last * size], block[:-1].reshape(-1, columns), trans="T")
        total -= _squared(half)
        if last < samples:
            after = factors[:, last * size : (last + 1) * size]
            above = np.array([[after[size - 1 + a - b, b] for b in range(size)] for a in range(size)])
            over = block[-1] - above.T @ half[-size:]
    return total, half if len(of_samples) == 1 and columns <= FEW else None


def solved(factors: Array, half: Array) -> Array:
    """Return the solution (K m, c) of equations of states with upper banded Cholesky factors U, given U^-T times their
    right sides, which is overwritten."""
    from scipy.linalg import get_lapack_funcs  # slow to import

    (solve,) = get_lapack_funcs(("tbtrs",), (factors,))
    return np.asarray(solve(factors, half, overwrite_b=True)[0], dtype=np.float64)


def variances(factors: Array) -> Array:
    """Return the variances of states (K, m), the diagonal of the inverse of their information, from its upper banded
    Cholesky factors.

    With these in blocks, U_k beside V_k of the next sample, and the covariance C_k+1 of the next state, by a recursion
    from the last sample on

        C_k = U_k^-1 (1 + V_k C_k+1 V_k') U_k^-T
    """
    size = len(factors) // 2
    of_samples, row, column = factors.reshape(len(factors), -1, size), np.arange(size)[:, None], np.arange(size)
    found, eye = np.zeros(of_samples.shape[1:]), np.eye(size)
    beside = covariance = np.zeros((size, size))
    for block in reversed(blocks(len(found), LARGE)):
        of_block = of_samples[:, block]
        own = np.triu(np.moveaxis(of_block[np.minimum(2 * size - 1 + row - column, 2 * size - 1), :, column], -1, 0))
        inverse, before = np.linalg.inv(own), np.moveaxis(of_block[size - 1 + row - column, :, column], -1, 0)
        for k in range(len(inverse) - 1, -1, -1):
            covariance = inverse[k] @ (eye + beside @ covariance @ beside.T) @ inverse[k].T
            found[block.start + k], beside = np.diagonal(covariance), before[k]
    return found


def most_of(columns: int) -> int:
    """Return how many samples a block of so many columns may have."""
    return LARGE if columns <= FEW else BLOCK


def blocks(count: int, most: int = BLOCK) -> list[slice]:
    """Return slices of at most so many of samples or steps."""
    return [slice(first, min(first + most, count)) for first in range(0, count, most)]


def _squared(rows: Array) -> Array:
    """Return the products of all columns with each other (n, n); twice as fast as a product of two matrices."""
    return rows.T @ rows


def add(total: Array, at: NDArray[np.intp], values: Array) -> None:
    """Add values (k, ...) to a total (K, ...) at some samples, several times where a sample comes several times."""
    apart = np.diff(at)
    if len(at) == at[-1] - at[0] + 1 and np.all(apart == 1):
        total[at[0] : at[-1] + 1] += values
    elif np.all(apart > 0):
        total[at] += values
    else:
        np.add.at(total, at, values)
