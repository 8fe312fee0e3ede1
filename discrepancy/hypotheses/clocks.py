"""Clocks that run apart: the rate at which a reference's gains, which is fitted to every log in any case."""

from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array


class Amount(NamedTuple):
    """A size, its standard error, and the deviance that it takes away."""

    value: float
    error: float
    gain: float


def skew_of(clocks: Array, errors: Array) -> Amount:
    """Return the mean rate (s/s) at which the reference's clock gains in several logs (L, 2), errors (L, 2)."""
    weights = errors[:, 1] ** -2.0
    value = float(np.average(clocks[:, 1], weights=weights))
    scatter = float(np.sum(weights * (clocks[:, 1] - value) ** 2)) / max(len(clocks) - 1, 1)
    error = float(np.sqrt(max(scatter, 1.0) / np.sum(weights)))
    return Amount(value, error, (value / error) ** 2)
