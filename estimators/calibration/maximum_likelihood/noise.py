"""Sizes of noise by their squares: variance components by restricted maximum likelihood.

The squares of each kind are brought to their expected values, which come from drawn residuals.
"""

from dataclasses import asdict, astuple
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from estimators.likelihood.log_likelihood import Noise
from estimators.likelihood.reduction import Leftover

LEAST = Noise(along=1e-5, across=1e-5, position=1e-5, heading=1e-5, gyro=1e-6, turning=3e-6)

MOST = Noise(along=0.015, across=0.015, position=0.15, heading=0.3, gyro=0.1, turning=0.015)
"""Largest noise of a sound robot, reference and gyro: more has another cause."""

NOISE_CONVERGED, NOISE_CONVERGED_BY_ERROR = 0.02, 0.1
"""Converged when no noise changes by more than the first part of itself or, where few residuals determine it, the
second part of its standard error."""

LEAST_FREEDOM = 1e-3
"""Least degrees of freedom of residuals with which noise is estimated."""

FEWER, MORE = 0.05, 5.0
"""Least and largest factor by which a size changes in a round."""

FASTEST = 16.0
"""Largest factor by which the change of a size's logarithm is extrapolated."""


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
            better[name] = max(size * float(np.clip(change, FEWER, MORE)), getattr(least, name))
    return Noise(**better)


class Pace(NamedTuple):
    """How the sizes of noise (6,) approach those that `resized` leaves as they are. Changes are of logarithms.

    off: how far `resized` changed them in the last round. moved: how far they were changed. factor: the second over the
    first.
    """

    off: Array
    moved: Array
    factor: Array

    @classmethod
    def extrapolated(
        cls, sizes: Noise, changed: Noise, last: "Pace | None", least: Noise = LEAST
    ) -> tuple[Noise, "Pace"]:
        """Return sizes nearer to the limit than `changed`, which `resized` makes of `sizes`; last: of the round before.

        Where few residuals show a noise, each round goes only a small part of the way, and dozens are needed. Each size
        is extrapolated by the secant of the last two rounds: no farther than twice as much as in the round before, and
        not at all where the direction has changed.
        """
        was = np.log(astuple(sizes))
        off = np.log(astuple(changed)) - was
        factor = np.ones(len(off))
        if last is not None:
            slope = np.divide(last.off - off, last.moved, out=np.zeros_like(off), where=last.moved != 0)
            secant = np.divide(1.0, slope, out=np.full_like(off, np.inf), where=slope > 0)
            ahead = np.clip(np.minimum(secant, 2 * last.factor), 1.0, FASTEST)
            factor = np.where(off * last.off > 0, ahead, 1.0)
        moved = np.clip(factor * off, np.log(FEWER), np.log(MORE))
        moved = np.maximum(was + moved, np.log(astuple(least))) - was
        return Noise(*np.exp(was + moved).tolist()), cls(off, moved, factor)


def same_noise(sizes: Noise, last: Noise, left: list[Leftover]) -> bool:
    """Whether each noise changed by no more than `NOISE_CONVERGED` of itself, or `NOISE_CONVERGED_BY_ERROR` of its
    standard error."""
    for name, size in asdict(sizes).items():
        freedom = sum(leftover.expected.get(name, 0.0) for leftover in left)
        error = 1 / np.sqrt(2 * max(freedom, LEAST_FREEDOM))
        if abs(size / getattr(last, name) - 1) > max(NOISE_CONVERGED, NOISE_CONVERGED_BY_ERROR * error):
            return False
    return True
