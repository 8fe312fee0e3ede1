"""Sufficient statistics of sizes whose values scatter about a mean."""

import numpy as np

from castor_envs.geometry.arrays import Array


def scattered(information: Array, score: Array, covariance: Array) -> tuple[Array, Array]:
    """Return information (m, m) and score (m,) of the mean of sizes that scatter about it by a covariance (m, m), from
    the information and score of the sizes themselves, at sizes of 0."""
    blurred = np.eye(len(score)) + information @ covariance
    solved: Array = np.linalg.solve(blurred, np.column_stack([information, score])).astype(np.float64)
    return (solved[:, :-1] + solved[:, :-1].T) / 2, solved[:, -1]
