"""The residuals of a log in which the strength of an effect is measured.

    parity    in windows of 0.1 s: rolling and side slip that no rigid motion of the body explains
    steps     of 1 s: motion of the reference minus motion of the body by its counts, in the body's frame

Nothing of the finder is used: a diagnosis is not judged by its own equations.
"""

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose, rotate, rotation, wrap
from castor_envs.logs.log import Log
from discrepancy.validation.windows import Windows

WINDOW, STEP = 0.1, 1.0
"""s: lengths of parity windows and of reference steps."""


class Layout:
    """The windows of a log, and the steps between its reference poses.

    q: samples a window. per_step: windows a step. reference: whether there is one; there are no steps without.
    """

    def __init__(self, samples: int, period: float, *, reference: bool = True) -> None:
        self.q = max(round(WINDOW / period), 1)
        self.per_step = max(round(STEP / period) // self.q, 1)
        self.windows = (samples - 1) // self.q
        self.steps = self.windows // self.per_step if reference else 0


def followed(layout: Layout, moved: Array) -> tuple[Array, Array]:
    """Return the body's motion in each step (S, 3), in its frame at the step's start, from its windows' motions (W, 3).

    And the derivative by each window's motion (S * per_step, 3, 3).
    """
    steps = moved[: layout.steps * layout.per_step].reshape(layout.steps, layout.per_step, 3)
    heading = np.cumsum(steps[:, :, 2], axis=1) - steps[:, :, 2] / 2
    chord = np.sinc(steps[:, :, 2] / (2 * np.pi))
    part = rotate(steps[..., :2], heading) * chord[..., None]
    total = part.sum(axis=1)
    ahead = total[:, None] - np.cumsum(part, axis=1) + part / 2
    by = rotation(heading)
    by[..., 0, 2], by[..., 1, 2] = -ahead[..., 1], ahead[..., 0]
    return np.column_stack([total, steps[:, :, 2].sum(axis=1)]), by.reshape(-1, 3, 3)


def between(pose: Array) -> tuple[Array, Array, Array]:
    """Return the motions between successive poses (S + 1, 3), in the frame of the earlier pose (S, 3).

    And the derivatives (S, 3, 3) by the pose before and by the pose after.
    """
    way, after = relative_pose(pose[:-1], pose[1:]), rotation(-pose[:-1, 2])
    before = -after
    before[:, 0, 2], before[:, 1, 2] = way[:, 1], -way[:, 0]
    return way, before, after


def poses_of(layout: Layout, log: Log) -> Array:
    """Return the reference poses (S + 1, 3) between which steps go."""
    assert log.reference is not None
    return log.reference[:: layout.q * layout.per_step][: layout.steps + 1]


def steps_left(layout: Layout, windows: Windows, log: Log) -> Array:
    """Return the residuals of all steps (S, 3), m and rad; NaN where a pose is missing."""
    apart = between(poses_of(layout, log))[0] - followed(layout, windows.moved)[0]
    apart[:, 2] = wrap(apart[:, 2])
    return apart
