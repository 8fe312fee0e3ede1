"""Columns of a design matrix, of which most differ from 0 in one row only: an hour's would be gigabytes as an array."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array


class ByBlocks(Protocol):
    """Columns (K, rows, C) that are made for some samples or steps at a time; an array is such as well."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape (K, rows, C)."""
        ...

    def __getitem__(self, block: slice, /) -> Array:
        """Return the columns (k, rows, C) of a block of samples or steps."""
        ...


class SparseColumns:
    """Columns (K, rows, C) as the series (K,) of each column and row in which it differs from 0, in single precision,
    which is finer than any linearisation."""

    def __init__(
        self,
        shape: tuple[int, int, int],
        series: Sequence[NDArray[np.floating]] = (),
        rows: Iterable[int] = (),
        at: Iterable[int] = (),
    ) -> None:
        """series (N times (K,)): with the row and the column (`at`) of each."""
        self.shape, self._series = shape, tuple(part.astype(np.float32, copy=False) for part in series)
        self._rows, self._at = np.array([*rows], dtype=np.intp), np.array([*at], dtype=np.intp)

    @classmethod
    def of(cls, columns: Array) -> "SparseColumns":
        """Return columns given as an array (K, rows, C)."""
        rows, at = np.nonzero(np.any(columns, axis=0))
        series = [columns[:, row, column] for row, column in zip(rows.tolist(), at.tolist(), strict=True)]
        return cls(columns.shape, series, rows.tolist(), at.tolist())

    @classmethod
    def diagonal(cls, series: Array) -> "SparseColumns":
        """Return a column for each row (K, rows, rows): the series (K, rows) in this row, 0 in all others."""
        k, rows = series.shape
        return cls((k, rows, rows), list(series.T), range(rows), range(rows))

    @classmethod
    def joined(cls, parts: Sequence["SparseColumns"], empty: tuple[int, int]) -> "SparseColumns":
        """Return the columns of several parts in sequence. empty: samples and rows, if there is no part."""
        count, series, rows, at = 0, [], [], []
        for part in parts:
            series += part._series
            rows += part._rows.tolist()
            at += (part._at + count).tolist()
            count += part.shape[-1]
        return cls((*empty, count), series, rows, at)

    def only(self, columns: Iterable[int]) -> "SparseColumns":
        """Return the columns of these numbers, in this order."""
        return SparseColumns.joined([self._column(column) for column in columns], self.shape[:2])

    def in_rows(self, rows: Iterable[int]) -> "SparseColumns":
        """Return the columns in these rows, in this order; a row may come several times."""
        chosen = [*rows]
        places = [(n, row) for row, old in enumerate(chosen) for n in np.flatnonzero(self._rows == old).tolist()]
        kept, in_rows = [n for n, _ in places], [row for _, row in places]
        shape = self.shape[0], len(chosen), self.shape[2]
        return SparseColumns(shape, [self._series[n] for n in kept], in_rows, self._at[kept].tolist())

    def __getitem__(self, block: slice) -> Array:
        """Return the columns (k, rows, C) of a block of samples or steps."""
        values = np.zeros((len(range(*block.indices(self.shape[0]))), *self.shape[1:]))
        for series, row, column in zip(self._series, self._rows.tolist(), self._at.tolist(), strict=True):
            values[:, row, column] = series[block]
        return values

    def _column(self, column: int) -> "SparseColumns":
        chosen = np.flatnonzero(self._at == column).tolist()
        series, rows = [self._series[n] for n in chosen], self._rows[chosen].tolist()
        return SparseColumns((*self.shape[:2], 1), series, rows, np.zeros(len(chosen), dtype=np.intp))
