"""The residuals of a log in which the strength of an effect is measured.

    parity    in windows of 0.1 s: rolling and side slip that no rigid motion of the body explains
    steps     of 1 s: motion of the reference minus motion of the body by its counts, in the body's frame

Nothing of the finder is used: a diagnosis is not judged by its own equations.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Slip
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.motion.mobility import rows_in_use
from castor_envs.sensors.encoders import castor_angles
from discrepancy.validation.parity import constraints_by_angle

Index = NDArray[np.intp]

WINDOW, STEP = 0.1, 1.0
"""s: lengths of parity windows and of reference steps."""


class Layout:
    """The channels and rows of a robot, and the windows of its log.

    sensed (s,), driven (d,): castors with pivot encoder and wheels with encoder; channels are these, in this order.
    rows: the constraints in use. q: samples a window. per_step: windows a step. reference: whether there is one; there
    are no steps without.
    """

    def __init__(self, geometry: Geometry, samples: int, period: float, *, reference: bool = True) -> None:
        self.sensed: Index = geometry.sensed
        self.driven: Index = np.flatnonzero(~np.isnan(geometry.counts_per_rev))
        self.rows = rows_in_use(geometry)
        self.q = max(round(WINDOW / period), 1)
        self.per_step = max(round(STEP / period) // self.q, 1)
        self.windows = (samples - 1) // self.q
        self.steps = self.windows // self.per_step if reference else 0

    @property
    def ends(self) -> Index:
        """The samples at which windows begin and end (windows + 1,)."""
        return self.q * np.arange(self.windows + 1)

    @property
    def mean(self) -> Array:
        """The weights (q + 1,) of a window's samples in its mean castor angles."""
        weights = np.ones(self.q + 1)
        weights[[0, -1]] = 0.5
        return weights / self.q


@dataclass(frozen=True, eq=False)
class Windows:
    """Body motion and residuals of W windows by counts, by least squares with equal weights.

    rows (W, R, 3) times a body motion, plus arms (R,) times their castors' turns, are the R measured distances.
    sideways (W, R, 3): the derivative of rows by their castor's angle. inverse (W, 3, R): the pseudo-inverse of rows.
    moved (W, 3): the body's motion, m and rad. left (W, R): residual of it, m. rolled (W, w): by each wheel, m.
    """

    rows: Array
    arms: Array
    sideways: Array
    inverse: Array
    moved: Array
    left: Array
    rolled: Array


def windows_of(geometry: Geometry, layout: Layout, log: Log, slip: Slip | None = None) -> Windows:
    """Return motion and residuals of a log's windows by its counts, with a known slip of contacts (None: no slip)."""
    ends, used = layout.ends, layout.rows
    phi = np.zeros((len(log), len(geometry.radius)))
    phi[:, layout.driven] = log.wheel * (2 * np.pi / geometry.counts_per_rev[layout.driven])
    theta = np.unwrap(castor_angles(geometry, log.pivot), axis=0)
    parts = [weight * theta[k : k + ends[-1] : layout.q] for k, weight in enumerate(layout.mean)]
    middle = np.sum([part[: layout.windows] for part in parts], axis=0)
    rolled, turned = np.diff(phi[ends], axis=0) * geometry.radius, np.diff(theta[ends], axis=0)

    rows, arms = (part[:, used.place] for part in constraint_matrix(geometry, middle))
    measured = np.pad(rolled[:, used.wheels], ((0, 0), (0, len(used.castors)))) - turned[:, used.castor] * arms
    if slip is not None:
        slipped = np.concatenate([slip.rolling[:, used.wheels], slip.side[:, used.castors]], axis=1)
        measured += slipped[: ends[-1]].reshape(layout.windows, layout.q, -1).sum(axis=1)
    sideways = constraints_by_angle(geometry, middle)[:, used.place]
    inverse = np.asarray(np.linalg.pinv(rows, rcond=1e-10), dtype=np.float64)
    moved = np.einsum("wij,wj->wi", inverse, measured)
    left = measured - np.einsum("wij,wj->wi", rows, moved)
    return Windows(rows, arms[0], sideways, inverse, moved, left, rolled)


def followed(layout: Layout, moved: Array) -> tuple[Array, Array]:
    """Return the body's motion in each step (S, 3), in its frame at the step's start, from its windows' motions (W, 3).

    And the derivative by each window's motion (S * per_step, 3, 3).
    """
    steps = moved[: layout.steps * layout.per_step].reshape(layout.steps, layout.per_step, 3)
    heading = np.cumsum(steps[:, :, 2], axis=1) - steps[:, :, 2] / 2
    chord = np.sinc(steps[:, :, 2] / (2 * np.pi))
    c, s = np.cos(heading), np.sin(heading)
    part = (
        np.stack([c * steps[..., 0] - s * steps[..., 1], s * steps[..., 0] + c * steps[..., 1]], axis=-1)
        * chord[..., None]
    )
    total = part.sum(axis=1)
    ahead = total[:, None] - np.cumsum(part, axis=1) + part / 2
    by = np.zeros((*heading.shape, 3, 3))
    by[..., 0, 0], by[..., 0, 1], by[..., 0, 2] = c, -s, -ahead[..., 1]
    by[..., 1, 0], by[..., 1, 1], by[..., 1, 2] = s, c, ahead[..., 0]
    by[..., 2, 2] = 1.0
    return np.column_stack([total, steps[:, :, 2].sum(axis=1)]), by.reshape(-1, 3, 3)


def between(pose: Array) -> tuple[Array, Array, Array]:
    """Return the motions between successive poses (S + 1, 3), in the frame of the earlier pose (S, 3).

    And the derivatives (S, 3, 3) by the pose before and by the pose after.
    """
    way, psi = np.diff(pose, axis=0), pose[:-1, 2]
    c, s = np.cos(psi), np.sin(psi)
    x, y = c * way[:, 0] + s * way[:, 1], c * way[:, 1] - s * way[:, 0]
    after = np.zeros((len(way), 3, 3))
    after[:, 0, 0], after[:, 0, 1], after[:, 1, 0], after[:, 1, 1], after[:, 2, 2] = c, s, -s, c, 1.0
    before = -after
    before[:, 0, 2], before[:, 1, 2] = y, -x
    return np.column_stack([x, y, way[:, 2]]), before, after


def poses_of(layout: Layout, log: Log) -> Array:
    """Return the reference poses (S + 1, 3) between which steps go."""
    assert log.reference is not None
    return log.reference[layout.ends[:: layout.per_step]][: layout.steps + 1]


def steps_left(layout: Layout, windows: Windows, log: Log) -> Array:
    """Return the residuals of all steps (S, 3), m and rad; NaN where a pose is missing."""
    apart = between(poses_of(layout, log))[0] - followed(layout, windows.moved)[0]
    apart[:, 2] -= 2 * np.pi * np.round(apart[:, 2] / (2 * np.pi))
    return apart
