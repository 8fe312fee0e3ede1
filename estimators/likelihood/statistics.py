"""Sufficient statistics of sizes: the sizes that they determine, and those of sizes that scatter about a mean."""

import numpy as np

from castor_envs.geometry.arrays import Array

DETERMINED, IN_ANY_UNITS = 1e-9, 1e-12
"""Least singular value of a matrix, as a part of the largest, of what the matrix determines; and where units differ so
much that by these alone singular values do."""


def least_squares(matrix: Array, values: Array) -> Array:
    """Return x, (m,) or (m, k), for which matrix (n, m) @ x is the nearest to values, (n,) or (n, k); 0 of what the
    matrix leaves open. Of information and score these are sizes of maximum likelihood."""
    return np.asarray(np.linalg.lstsq(matrix, values, rcond=DETERMINED)[0], dtype=np.float64)


def pseudo_inverse(information: Array, least: float = DETERMINED) -> Array:
    """Return the covariance (m, m) of sizes that this information (m, m) determines; 0 of what it leaves open. least:
    see `DETERMINED`."""
    return np.asarray(np.linalg.pinv(information, rcond=least, hermitian=True), dtype=np.float64)


def scattered(information: Array, score: Array, covariance: Array) -> tuple[Array, Array]:
    """Return information (m, m) and score (m,) of the mean of sizes that scatter about it by a covariance (m, m), from
    the information and score of the sizes themselves, at sizes of 0."""
    blurred = np.eye(len(score)) + information @ covariance
    solved: Array = np.linalg.solve(blurred, np.column_stack([information, score])).astype(np.float64)
    return (solved[:, :-1] + solved[:, :-1].T) / 2, solved[:, -1]
