"""Where a course is at the samples of an episode, computed for many samples at once."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from castor_envs.envs.course import Course
from castor_envs.geometry.arrays import Array

ROWS = 64
"""Samples computed at once: as long as a few calls for a single one."""


class Reference(NamedTuple):
    """Of one sample: poses (a + 1, ..., 3) at times `ahead` and at the course's end; twist (..., 3) in mid-period."""

    places: Array
    twist: Array


class ReferenceTable:
    """The reference of each sample of a course, (..., 3) standing for (3,) of a robot and (N, 3) of a train.

    ahead (a,): when after a sample places are shown, s. period: of sampling, s.
    """

    def __init__(self, course: Course, period: float, ahead: Sequence[float]) -> None:
        self._course, self._period, self._ahead = course, period, np.array(ahead)
        self._block = -1

    def at(self, sample: int) -> Reference:
        """Return the reference of a sample, counted from 0; its arrays are not to be changed."""
        places, twist = self.block(sample)
        return Reference(places[sample % ROWS], twist[sample % ROWS])

    def block(self, sample: int) -> Reference:
        """Return the references of the `ROWS` samples, from a multiple of it, among which a sample is."""
        block = sample // ROWS
        if block != self._block:
            now = np.arange(block * ROWS, (block + 1) * ROWS) * self._period
            times = np.full((ROWS, len(self._ahead) + 1), self._course.duration)
            times[:, :-1] = now[:, None] + self._ahead
            self._rows = Reference(self._course.target(times), self._course.twist(now + 0.5 * self._period))
            self._block = block
        return self._rows
