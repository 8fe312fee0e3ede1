"""The reference in a trial's logs: how often a pose is recorded, and with how much noise."""

from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array

REFERENCE_EVERY = 20
"""Samples between reference poses."""

REFERENCE_NOISE = (1e-3, 1e-3, 1e-3)
"""Standard deviations of a reference pose: x, y (m) and psi (rad)."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a reference pose, x, y (m) and psi (rad), and how many samples apart poses are."""

    x: float = REFERENCE_NOISE[0]
    y: float = REFERENCE_NOISE[1]
    psi: float = REFERENCE_NOISE[2]
    every: int = REFERENCE_EVERY

    def sparse(self, pose: Array, random: np.random.Generator) -> Array:
        """Return the poses (K, 3) of a log's reference: with noise where one is taken, NaN elsewhere."""
        seen = pose + random.normal(size=pose.shape) * (self.x, self.y, self.psi)
        seen[np.arange(len(seen)) % self.every > 0] = np.nan
        return seen


EXACT = Noise(0.0, 0.0, 0.0, every=1)
"""The true pose in every row, with which the strength of an effect is measured."""
