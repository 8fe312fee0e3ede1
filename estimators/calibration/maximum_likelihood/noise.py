"""Sizes of noise by their squares: variance components by restricted maximum likelihood.

The squares of each kind are brought to their expected values, which come from drawn residuals.
"""

from dataclasses import asdict

import numpy as np

from estimators.likelihood.log_likelihood import Noise
from estimators.likelihood.reduction import Leftover

LEAST = Noise(along=1e-5, across=1e-5, position=1e-5, heading=1e-5, gyro=1e-6)

MOST = Noise(along=0.015, across=0.015, position=0.15, heading=0.3, gyro=0.1)
"""Largest noise of a sound robot, reference and gyro: more has another cause."""

NOISE_CONVERGED, NOISE_CONVERGED_BY_ERROR = 0.02, 0.1
"""Converged when no noise changes by more than the first part of itself or, where few residuals determine it, the
second part of its standard error."""

LEAST_FREEDOM = 1e-3
"""Least degrees of freedom of residuals with which noise is estimated."""


def resized(sizes: Noise, left: list[Leftover], least: Noise = LEAST) -> Noise:
    """Return the sizes of noise, none below `least`, at which the sums of squares equal their expected values."""
    better = asdict(sizes)
    for name, size in asdict(sizes).items():
        squares, expected = (
            sum(getattr(leftover, part).get(name, 0.0) for leftover in left) for part in Leftover._fields
        )
        if expected > 0:
            ratio = squares / expected
            change = ratio if ratio < 0.25 else np.sqrt(ratio)  # There is hardly any: go on towards none faster.
            better[name] = max(size * float(np.clip(change, 0.05, 5.0)), getattr(least, name))
    return Noise(**better)


def same_noise(sizes: Noise, last: Noise, left: list[Leftover]) -> bool:
    """Whether each noise changed by no more than `NOISE_CONVERGED` of itself, or `NOISE_CONVERGED_BY_ERROR` of its
    standard error."""
    for name, size in asdict(sizes).items():
        freedom = sum(leftover.expected.get(name, 0.0) for leftover in left)
        error = 1 / np.sqrt(2 * max(freedom, LEAST_FREEDOM))
        if abs(size / getattr(last, name) - 1) > max(NOISE_CONVERGED, NOISE_CONVERGED_BY_ERROR * error):
            return False
    return True
