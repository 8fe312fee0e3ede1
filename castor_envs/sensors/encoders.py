"""Encoders: cumulative counts, rounded from the true angle. Arithmetic broadcasts over leading axes."""

import copy
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry


class Encoders:
    """The encoders of one robot, as it is built, or of a train.

    geometry: of the real robot, or of each module of the real train, whose wheels and castors stand in a row. phase
    (..., driven wheels): where between two counts each wheel encoder stood at the start, in counts, [0, 1).
    """

    def __init__(self, geometry: Geometry | Sequence[Geometry], phase: ArrayLike) -> None:
        bodies = [geometry] if isinstance(geometry, Geometry) else geometry
        wheels, pivots, zero = (
            np.concatenate([getattr(body, name) for body in bodies], axis=-1)
            for name in ("counts_per_rev", "pivot_counts_per_rev", "pivot_zero")
        )
        self._driven, self._sensed = np.flatnonzero(~np.isnan(wheels)), np.flatnonzero(~np.isnan(pivots))
        self._zero, self._phase = zero, np.asarray(phase, dtype=float)
        self._steps, self._turn = wheels[self._driven] / (2 * np.pi), pivots[self._sensed]

    def started(self, random: np.random.Generator) -> "Encoders":
        """Return the same encoders at phases drawn from `random`, as `random_phase` draws them body by body."""
        drawn = copy.copy(self)
        drawn._phase = random.uniform(size=len(self._driven))
        return drawn

    @classmethod
    def stacked(cls, members: Sequence["Encoders"]) -> "Encoders":
        """Return the encoders of several vehicles of one layout, along one new leading axis; `take` changes phases."""
        joined = copy.copy(members[0])
        for name in ("_zero", "_steps", "_turn"):
            setattr(joined, name, np.stack([getattr(member, name) for member in members]))
        joined._phase = np.zeros(joined.shape)
        return joined

    def take(self, row: int, member: "Encoders") -> None:
        """Let a row of stacked encoders stand as those of a single vehicle."""
        self._phase[row] = member._phase

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the wheel counts (..., driven wheels)."""
        return self._steps.shape

    @staticmethod
    def random_phase(geometry: Geometry, random: np.random.Generator, *axes: int) -> Array:
        """Draw phases (*axes, driven wheels) uniformly."""
        return random.uniform(size=(*axes, int(np.sum(~np.isnan(geometry.counts_per_rev)))))

    def wheel(self, wheel_angle: Array) -> Array:
        """Return cumulative counts (..., driven wheels) for wheel angles (..., w); no remainder is ever lost."""
        return np.round(wheel_angle[..., self._driven] * self._steps + self._phase)

    def pivot(self, castor_angle: Array) -> Array:
        """Return absolute counts (..., pivot encoders) in [0, counts per turn) for castor angles (..., n)."""
        measured = (castor_angle + self._zero)[..., self._sensed]
        return np.mod(np.round(measured * self._turn / (2 * np.pi)), self._turn)


def castor_angles(geometry: Geometry, pivot_counts: ArrayLike) -> Array:
    """Return theta (..., n) from pivot counts (..., pivot encoders); fixed castors stand at their angle.

    Wrapped as the counts are. Castors without an encoder and not fixed are NaN.
    """
    sensed = geometry.sensed
    counts = np.asarray(pivot_counts, dtype=float)
    shape = np.broadcast_shapes(counts.shape[:-1], geometry.pivot_zero.shape[:-1])
    theta = np.empty((*shape, geometry.n_castors))
    theta[...] = geometry.known_angle
    turn = geometry.pivot_counts_per_rev[sensed]
    theta[..., sensed] = counts * (2 * np.pi / turn) - geometry.pivot_zero[..., sensed]
    return theta
