"""What an estimator may say beside its pose: the attributes `covariance` and `status` after an update, checked."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from castor_envs.geometry.arrays import Array
from estimators.plugins.real_numbers import real_numbers

ROUNDING = 1e-9
"""Largest asymmetry and largest negative eigenvalue of a covariance in units of the variances on its diagonal."""


def covariance_of(estimator: Any, shape: tuple[int, ...]) -> Array | None:
    """Return a copy of an estimator's covariance, float64, of poses of a shape; None if it has none now.

    Raises ValueError, with what is wrong, for anything but numbers in the shape (*shape, 3). Whether these can be
    covariances, `invalid` says.
    """
    given = getattr(estimator, "covariance", None)
    if given is None:
        return None
    try:
        return real_numbers(given, (*shape, 3))
    except ValueError as error:
        raise ValueError(f"covariance has {error}") from None


def invalid(covariance: Array) -> str | None:
    """Return why one of the matrices (..., 3, 3) is no covariance, None if all are: finite, symmetric, not negative."""
    if not np.isfinite(covariance).all():
        return "covariance is not finite"
    variance = np.einsum("...ii->...i", covariance)
    if (variance < 0).any():
        return "covariance is not positive semidefinite: a variance is negative"
    # Metres and radians are made comparable: as a correlation, whose eigenvalues are at most 3.
    sigma = np.sqrt(variance)
    scale = sigma[..., :, None] * sigma[..., None, :]
    if (np.abs(covariance - np.swapaxes(covariance, -1, -2)) > ROUNDING * scale).any():
        return "covariance is not symmetric"
    if ((scale == 0) & (covariance != 0)).any():
        return "covariance is not positive semidefinite: a variance is 0, and a covariance beside it is not"
    correlation = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0)
    if (np.linalg.eigvalsh(correlation) < -ROUNDING).any():
        return "covariance is not positive semidefinite"
    return None


def has_status(estimator: Any, stack: tuple[int, ...] = ()) -> Array | None:
    """Return whether an estimator has a status now, for each vehicle of a stack, as booleans (*stack,).

    A status is None or a text, on a stack also an array (*stack,) of these. None for an estimator without the
    attribute; raises ValueError for any other value.
    """
    if not hasattr(estimator, "status"):
        return None
    given: Any = estimator.status
    statuses = np.array(given, dtype=object)
    if statuses.shape not in ((), stack) or any(not isinstance(one, str | None) for one in statuses.ravel()):
        raise ValueError(f"status is of type {type(given).__name__}: None or a text")
    return np.array(np.broadcast_to(np.vectorize(lambda one: one is not None, otypes=[bool])(statuses), stack))


def takes_covariance(function: Callable[..., Any]) -> bool:
    """Return whether an estimator's `reset` or `estimate` has a parameter `covariance`, for that of the start pose."""
    try:
        return "covariance" in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False
