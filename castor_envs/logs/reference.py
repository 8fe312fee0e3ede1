"""A reference: its noise, its poses when they were taken, and at the times of counts: the one place that interpolates.

Between two readings a motion is taken to have a constant velocity. A motion with acceleration a is off from that by at
most a (t - t_0) (t_1 - t) / 2 at time t between readings at t_0 and t_1, which is exact where a is constant. So what
matters is not the gap between readings alone: near a reading even a long gap does no harm. No value is given where that
is worse than in the middle of `GAP`: 1.25 mm at 1 m/s2.
"""

from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array, Numbers

GAP = 0.1
"""s: the longest gap between readings that is bridged in its middle; up to 10 readings a second are needed."""

FARTHEST = 1e3
"""m: how far from its origin a reference may be to be diagnosed: patches and cables are searched on a grid of
centimetres from the origin to the robot, which must stay small."""


class ReferenceNoise(NamedTuple):
    """Standard deviations of a tracker's poses: of x and y each, m, and of psi, rad."""

    position: float
    heading: float


class TimedPoses(NamedTuple):
    """A tracker's poses at the times at which it took them: t (M,), s, strictly increasing; pose (M, 3 n), m and rad.

    n is 1 for a robot, and the number of axles for a train; headings are unwrapped, a robot's NaN where it has none.
    """

    t: Numbers
    pose: Numbers

    def at(self, t: Numbers) -> Array:
        """Return the poses (K, 3 n) at times t (K,), NaN where `interpolated` gives none."""
        return interpolated(self.t, self.pose, t)


def interpolated(seen: Numbers, values: Numbers, t: Numbers) -> Array:
    """Return values (K, ...) at times t (K,), of those (M, ...) seen at times (M,) that increase.

    NaN before the first and after the last reading, and where the readings around t are too far from it (see above). A
    reading at exactly t is taken as it is.
    """
    seen, values, t = np.asarray(seen, float), np.asarray(values, float), np.asarray(t, float)
    if not len(seen):
        return np.full((len(t), *values.shape[1:]), np.nan)
    columns = values.reshape(len(seen), -1).T
    found = np.column_stack([np.interp(t, seen, column) for column in columns]).reshape(len(t), *values.shape[1:])
    after = np.clip(np.searchsorted(seen, t), 0, len(seen) - 1)
    before = np.where(seen[after] == t, after, np.maximum(after - 1, 0))
    since, until = t - seen[before], seen[after] - t
    # Not more than a rounding error beyond, so that readings exactly `GAP` apart are near enough.
    found[(since < 0) | (until < 0) | (since * until > (GAP / 2) ** 2 * (1 + 1e-6))] = np.nan
    return found
