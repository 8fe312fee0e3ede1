"""Slips of contacts as independent numbers: of each contact, or of the combinations that a balance of forces keeps."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from estimators.likelihood.elimination import blocks

SPANNED = 1e-8
"""Least size of a direction in which contacts move, as a part of the largest."""


class Whitening(NamedTuple):
    """What makes slips independent, each of standard deviation 1: weight (K - 1, rows), over standard deviations; and
    basis (K - 1, p, rows) of the combinations that contacts' balance keeps, None: all. moved: see `balanced`.
    by_turning (K - 1, rows): the part of slip's variance that is of contacts' turning on the floor."""

    weight: Array
    by_turning: Array
    basis: Array | None = None
    moved: Callable[[slice], Array] | None = None

    @classmethod
    def balanced(
        cls, weight: Array, by_turning: Array, stiffness: Array, moved: Callable[[slice], Array]
    ) -> "Whitening":
        """Return what is kept of slips where contacts of a stiffness (K - 1, rows) creep freely against each other.

        moved: how far every row's contact moves in some steps (k, rows, p) for a unit of each of p free motions, A. The
        creep c is any with A' C c = 0, C the stiffness: what is left are the combinations A' C of slips.
        """
        basis = [
            np.swapaxes(_orthonormal((stiffness[steps] / weight[steps])[..., None] * moved(steps)), 1, 2)
            for steps in blocks(len(weight))
        ]
        return cls(weight, by_turning, np.concatenate(basis), moved)

    def log_density(self) -> float:
        """Return the logarithm of the density of slips of 0, up to a constant of the log."""
        if self.basis is None or self.moved is None:
            return float(np.sum(np.log(self.weight)))
        total = 0.0
        for steps in blocks(len(self.weight)):
            ways = _orthonormal(self.moved(steps))
            onto = self.basis[steps] @ (self.weight[steps][..., None] * ways)
            onto += np.eye(onto.shape[-1]) * ~np.any(ways, axis=1)[:, None, :]
            total += float(np.sum(np.linalg.slogdet(onto)[1]))
        return total

    def applied(self, steps: slice, slips: Array) -> Array:
        """Return slips (k, rows, c), m, as independent numbers (k, p, c)."""
        slips = self.weight[steps, :, None] * slips
        return slips if self.basis is None else self.basis[steps] @ slips

    def of_contacts(self, steps: slice, independent: Array) -> Array:
        """Return the most likely slips of contacts (k, rows, c), in standard deviations, given independent numbers."""
        return independent if self.basis is None else np.swapaxes(self.basis[steps], 1, 2) @ independent


def _orthonormal(columns: Array) -> Array:
    """Return orthonormal bases (k, rows, q) of what columns (k, rows, q) span; 0 in place of columns that the columns
    before them span.

    Gram and Schmidt's method, twice for each column, as once leaves an error that grows with the columns' likeness.
    """
    ways, largest = np.zeros_like(columns), np.sqrt(np.sum(columns**2, axis=1).max(axis=1))
    for k in range(columns.shape[2]):
        found, way = ways[:, :, :k], columns[:, :, k : k + 1]
        for _ in range(2):
            way = way - found @ (np.swapaxes(found, 1, 2) @ way)
        size = np.sqrt(np.sum(way**2, axis=1))
        new = size > SPANNED * largest[:, None]
        ways[:, :, k] = np.where(new, way[:, :, 0] / np.where(new, size, 1.0), 0.0)
    return ways
