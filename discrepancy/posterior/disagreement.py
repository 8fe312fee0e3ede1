"""How far wheels disagree: what encoders say that no motion of the body explains.

Wheels that disagree creep until they come to terms, so that no slip is left to wonder at: but in good order they hardly
do, for what drives them is told by the same description. How far they do is a size of noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from discrepancy.hypotheses.candidates import stacked
from discrepancy.measurement.design_matrix import Columns

WINDOW = 1.0
"""s: over which disagreement is summed. Rounding, and castors that turn between two commands, sum up to nothing."""

LEAST = 4e-4
"""Of the way: no robot's wheels are taken to agree better within a window. Rounding alone leaves as much."""

FARTHEST = 2.0
"""Sizes beyond which disagreement is not what it usually is (Huber's function)."""

LEAST_KEPT = 1e-3
"""Part of a row's slip that the others must contradict to tell how large it is."""

MEDIAN = 0.6745
"""Of the absolute value of a standard normal number."""

Sizes = tuple[float, float]
"""Of disagreement, as a part of the way, standard deviations: along, and to the side."""


@dataclass(frozen=True, eq=False)
class Disagreement:
    """One log's disagreement, summed over W windows, as a part of the way rolled in each.

    seen (W, rows): beyond what wheels hide of the robot's effects. by_size (W, rows, C): what a unit of each size adds.
    hidden (W, rows, e): what the robot's effects add where wheels hide them. told_by (W,): windows that count. along
    (rows,): rolling, not side slip.
    t (W,): when windows begin, s. way (K - 1,): of every step, the mean of its window. steps (W,): of each window.
    """

    seen: Array
    by_size: Array
    hidden: Array
    told_by: NDArray[np.bool_]
    along: NDArray[np.bool_]
    t: Array
    way: Array
    steps: NDArray[np.intp]

    @classmethod
    def of(cls, design: Columns, log: Log, hiding: Array, parts: Array, released: NDArray[np.bool_]) -> "Disagreement":
        """Return that of a log. hiding (K - 1, rows, e): slips by which wheels hide the robot's effects, in `parts`.

        released (K - 1, rows): steps of which windows do not count, as a contact may slip there as it likes.
        """
        model = design.model
        seen, by_size = model.disagreement(*design.alone())
        way = np.abs(model.rolled(design.geometry, design.state)).max(axis=1)
        samples = max(round(WINDOW / np.median(np.diff(log.t))), 1)
        starts = np.arange(0, len(way), samples)
        rolled = np.add.reduceat(way, starts)
        rolled = np.hypot(rolled, np.median(rolled) / 4) + 1e-9  # at rest, nothing says how far
        parts_of = (seen - hiding @ parts, by_size, hiding)
        sums = [np.add.reduceat(part, starts, axis=0) for part in parts_of]
        of_way, by_size, hidden = (part / rolled.reshape(-1, *[1] * (part.ndim - 1)) for part in sums)
        steps = np.diff([*starts, len(way)])
        along = model.rows < len(design.geometry.radius)
        told_by = ~np.logical_or.reduceat(released.any(axis=1), starts)
        way = np.repeat(rolled / steps, steps)
        return cls(of_way, by_size, hidden, told_by, along, log.t[starts], way, steps)

    def sizes(self) -> Sizes:
        """Return how far wheels disagree most of the time, whatever there is at others."""
        seen = self.seen[self.told_by]
        return _size(seen[:, self.along]), _size(seen[:, ~self.along])

    def beside(self, columns: Sequence[int]) -> Array:
        """Return by how many sizes wheels disagree (W, rows) beside the sizes of columns that suit best; by none in
        windows that do not count."""
        scale = np.where(self.along, *self.sizes())
        left = (self.told_by[:, None] * self.seen / scale).reshape(-1)
        if len(columns):
            by_size = (self.by_size[..., list(columns)] / scale[:, None]).reshape(len(left), len(columns))
            by_size = np.repeat(self.told_by, self.seen.shape[1])[:, None] * by_size
            left = left - by_size @ np.linalg.lstsq(by_size, left, rcond=1e-9)[0]
        return left.reshape(self.seen.shape)

    def slips(self, row: int, size: Array) -> Array:
        """Return the slips of every step (K - 1, rows, 1), m, of a row that disagrees by size (W,), as a part of the
        way."""
        slips = np.zeros((len(self.way), len(self.along), 1))
        slips[:, row, 0] = np.repeat(size, self.steps) * self.way
        return slips

    def told(self, sizes: Sizes) -> tuple[Array, Array, float]:
        """Return information and score of sizes (C,), of what wheels hide of each (C,) and of parts (e,), and how
        likely all is where these are 0.

        Beyond `FARTHEST` times its size a disagreement counts with its distance, not with the square of it.
        """
        size = np.where(self.along, *sizes)
        off = np.abs(self.seen) / size
        weight = self.told_by[:, None] * np.sqrt(np.minimum(FARTHEST / np.maximum(off, 1e-12), 1.0)) / size
        columns = np.concatenate([self.by_size, -self.by_size, self.hidden], axis=-1) * weight[..., None]
        columns, seen = columns.reshape(self.seen.size, -1), (self.seen * weight).reshape(-1)
        far = np.where(off > FARTHEST, FARTHEST * (off - FARTHEST / 2), off**2 / 2)
        likely = -float(self.told_by.sum() * np.sum(np.log(size))) - float(np.sum(far[self.told_by]))
        return columns.T @ columns, columns.T @ seen, likely


def of_row(design: Columns, row: int) -> tuple[Array, Array]:
    """Return by how much a row disagrees with the others in every step (K - 1,), m, and by how much for a metre of its
    own slip."""
    model, geometry, state = design.model, design.geometry, design.state
    slips = np.zeros((len(state) - 1, len(model.rows), 1))
    slips[:, row] = 1.0
    none = np.zeros((len(state), state.shape[1] - 3, 1))
    seen, by_slip = model.disagreement(geometry, stacked(geometry, []), np.zeros(0), state, none, slips)
    return seen[:, row], by_slip[:, row, 0]


def _size(seen: Array) -> float:
    """Return the size of disagreement (W, rows); where windows say the same as those before them it is taken for
    larger, as they count less."""
    if not seen.size:
        return LEAST
    size = max(float(np.median(np.abs(seen))) / MEDIAN, LEAST)
    held = np.clip(seen / size, -FARTHEST, FARTHEST)
    alike = float(np.mean(held[1:] * held[:-1]) / max(np.mean(held**2), 1e-12)) if len(seen) > 1 else 0.0
    alike = min(max(alike, 0.0), 0.9)
    return size * float(np.sqrt((1 + alike) / (1 - alike)))
