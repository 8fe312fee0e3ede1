"""What counts where all wheels may creep a little.

Contact is not as rigid as rolling, and a log of a minute tells far smaller parts of a radius than mean anything. How
much each wheel creeps by itself is found: as much as logs allow beside the effects that explain most of them.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from discrepancy.inference.design_matrix import without

if TYPE_CHECKING:
    from discrepancy.inference.evidence import Evidence

CREEP, LEAST_CREEP = 7e-5, 1e-5
"""Standard deviation of what all wheels together may always roll too much, as a part of their way; what each may by
itself, and each castor to the side, is between these two."""

UNLIKELY = 2.0
"""By how much (natural logarithm) another size of uneven creep may be less likely than the likeliest, and allowed."""

BESIDE, LEAST_GAIN = 2, 30.0
"""Uneven creep is what at most so many effects leave that take away so much each."""


def sober(
    seen: "Evidence", information: Array, gradient: Array, e: int, along: NDArray[np.bool_], told: bool
) -> tuple[Array, Array]:
    """Return information (2C, 2C) and pull (2C,) of `Evidence`, where wheels may creep.

    information, gradient: of these numbers, e more, the creep of each row, which is along or to the side, and others.
    told: whether clean logs tell how much all wheels together creep.
    """
    n = len(seen.plain[1])
    creep = np.arange(n + e, n + e + len(along))
    together: Array = (LEAST_CREEP if told else CREEP) ** 2 * np.outer(along, along).astype(np.float64)
    information = information.copy()
    uneven = _uneven(seen, information, gradient, creep, together)
    information[np.ix_(creep, creep)] += np.linalg.inv(together + uneven**2 * np.eye(len(along)))
    return without(information, gradient, n)


def _uneven(seen: "Evidence", information: Array, gradient: Array, creep: NDArray[np.intp], together: Array) -> float:
    """Return the largest standard deviation of uneven creep that logs allow beside the effects that explain most."""
    n, every = len(seen.plain[1]), np.eye(len(seen.plain[1]))
    order = np.concatenate([np.arange(n), creep, np.setdiff1d(np.arange(n, len(gradient)), creep)])
    information, pull = without(information[np.ix_(order, order)], gradient[order], n + len(creep))
    mix = np.zeros((n, 0))
    for k, part in seen.greedily(BESIDE, LEAST_GAIN):
        own = seen.columns[k]
        mix = np.column_stack([mix, every[:, own] + part * every[:, own + n // 2]])
    mix = np.pad(mix, ((0, len(creep)), (0, 0)))
    told = information @ mix
    explained = told @ np.linalg.pinv(mix.T @ told, rcond=1e-9, hermitian=True)
    pull, information = (pull - explained @ (mix.T @ pull))[n:], (information - explained @ told.T)[n:, n:]
    sizes, likely = np.geomspace(LEAST_CREEP, CREEP, 20), []
    for size in sizes:
        prior = together + size**2 * np.eye(len(creep))
        spread = np.eye(len(creep)) + prior @ information
        likely.append((pull @ np.linalg.solve(spread, prior @ pull) - np.linalg.slogdet(spread)[1]) / 2)
    return float(sizes[np.array(likely) >= max(likely) - UNLIKELY][-1])
