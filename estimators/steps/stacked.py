"""What compiled estimators of robots work on: one robot or a stack of robots, one sample at a time.

Their arithmetic is for one robot at a time and loops over stacks of robots: plain Python, which is compiled
(`castor_envs.kernels`).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.kernels.kernel import Kernel
from castor_envs.motion.kinematics import Geometry
from estimators.protocol import Observation


class Part(NamedTuple):
    """An array (..., own axes) with any leading axes, and how many axes are its own."""

    array: NDArray[Any]
    axes: int = 1


class Stack:
    """All that a kernel works on as it takes samples of B robots: `parts` have the stack's leading axes.

    The kernel is a function of the parts, each (B, own axes), the counts of wheels (B, w) and of pivots (B, p; one 0 of
    robots without pivot encoders), and of what is `further` given, as it is. A stack grows where counts have more
    leading axes.
    """

    def __init__(self, kernel: Kernel, geometry: Geometry, parts: Sequence[Part], further: Sequence[Any] = ()) -> None:
        self._kernel, self._further, self._axes = kernel, tuple(further), [part.axes for part in parts]
        self._counts = int(np.sum(~np.isnan(geometry.counts_per_rev))), len(geometry.sensed)
        leading = (part.array.shape[: part.array.ndim - part.axes] for part in parts)
        self._lay_out(np.broadcast_shapes(*leading), [part.array for part in parts])

    def _lay_out(self, shape: tuple[int, ...], parts: Sequence[NDArray[Any]]) -> None:
        own = [part.shape[part.ndim - axes :] for part, axes in zip(parts, self._axes, strict=True)]
        self.shape = shape
        self.parts = [np.broadcast_to(part, (*shape, *of)).copy() for part, of in zip(parts, own, strict=True)]
        wheels, pivots = self._counts
        self._wheel, self._pivot = np.zeros((*shape, wheels)), np.zeros((*shape, max(pivots, 1)))
        self._bind()

    def _bind(self) -> None:
        stacks = zip((*self.parts, self._wheel, self._pivot), (*self._axes, 1, 1), strict=True)
        flat = (part.reshape(-1, *part.shape[part.ndim - axes :]) for part, axes in stacks)
        self._run = self._kernel.bind(*flat, *self._further)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_run"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._bind()

    def advance(self, observation: Observation) -> None:
        """Take one sample; raises InputError where it has another number of counts."""
        self.fit(observation)
        self._wheel[...], self._pivot[...] = self._counted(observation)
        self._run()

    def fit(self, observation: Observation) -> None:
        """Grow where a sample is of more robots; raises InputError where it has another number of counts."""
        wheel, pivot = self._counted(observation)
        if wheel.shape == self._wheel.shape and pivot.shape == self._pivot.shape:
            return
        if wheel.shape[-1] != self._wheel.shape[-1] or pivot.shape[-1] != self._pivot.shape[-1]:
            raise InputError(
                f"the observation has {wheel.shape[-1]} counts of wheels and {pivot.shape[-1]} of pivots; this robot "
                f"gives {self._counts[0]} and {self._counts[1]}"
            )
        shape = np.broadcast_shapes(self.shape, wheel.shape[:-1], pivot.shape[:-1])
        if shape != self.shape:
            self._lay_out(shape, self.parts)

    def _counted(self, observation: Observation) -> tuple[NDArray[Any], NDArray[Any]]:
        return observation["wheel"], observation["pivot"] if self._counts[1] else self._pivot
