"""Parity residual: how far the encoders of one robot are from agreeing with any rigid motion of its body.

Between two samples the body moves by (dx, dy, dpsi) in B, each castor turns by dtheta and each wheel rolls
r dphi. The rolling constraints (castor_envs.motion.kinematics) say, with castor angles half way,

    A(theta) (dx, dy, dpsi) + B dtheta = (r dphi of each wheel with an encoder, 0 for each castor's side slip)

A robot with more such rows than unknowns (an ASOC base of n castors has 3 n against 3) contradicts itself where its
description is wrong, where a wheel slips, and, by a known amount, where counts are rounded. No reference pose is
needed. The half-way angle makes the equations exact to second order: the residual of a smooth motion shrinks with the
cube of the sample period.

Residuals of a wrong description add up along the way; those of rounding do not, as a count that is read too high makes
one step too long and the next too short. So an error of half a percent of a radius, far below the rounding of single
samples, is nine times the rounding in sums over a second (`Parity.drift`).
"""

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import Rows
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.windows import Windows

WINDOW, WINDOWS = 1.0, 5
"""Length, s, of the sums in which a wrong description adds up and rounding does not; the fewest sums for an rms."""

BLIND = (
    "this robot's encoders cannot contradict each other (no redundancy): nothing is observable without reference poses"
)


class Parity:
    """The parity residual of one log, of each row in use: its misfit to the motion of a rigid body on the wheels of a
    robot. All lengths in m, a sample.

    redundancy: number of rows beyond the unknowns of the motion; at 0 no error is visible. residual (N - 1, rows):
    after least squares with equal weights. moving (N - 1,): whether any count changed. rounding (rows,): the rms that
    rounded counts alone would leave while moving. window: the samples in a sum of residuals, up to `WINDOW` s and a
    fifth of the log; 0 for a log of fewer than `WINDOWS` steps. drift (rows,): the rms of those sums, in units of their
    expected rms from rounding and curved motion between samples; about 1 or less where the description is right, 0
    without motion. explained (castors of the robot,): the part of those sums that errors in the rows of this castor
    alone can explain.
    """

    def __init__(self, robot: RobotDescription, log: Log) -> None:
        geometry = Geometry.of(robot.as_built())
        steps = Windows(geometry, log.wheel, log.pivot)
        self.rows, self.redundancy, self.residual = steps.used, steps.redundancy, steps.left
        self.moving = np.any(np.diff(np.column_stack([log.wheel, log.pivot]), axis=0), axis=1)
        left = np.eye(len(self.rows.place)) - steps.rows @ steps.inverse
        start, end = np.moveaxis(left[:, None] @ np.swapaxes(steps.by_counts(), 1, 2), 1, 0)
        self.rounding = _rms(np.sqrt(np.sum(start**2 + end**2, axis=-1) / 12)[self.moving])
        self.window = min(max(round(WINDOW / float(np.median(np.diff(log.t)))), 1), len(steps.left) // WINDOWS)
        self.drift, self.explained = np.zeros(len(self.rows.place)), np.zeros(geometry.n_castors)
        if self.window:
            second = Windows(geometry, log.wheel[::2], log.pivot[::2]).left
            self.drift = _drift(steps.left, second, self.moving, start, end, self.window)
            self.explained = _explained(steps.left, left, self.rows, self.window, geometry.n_castors)

    @property
    def rms(self) -> Array:
        """The rms (rows,) while moving, m; 0 for a log without motion."""
        return _rms(self.residual[self.moving])


def _drift(residual: Array, second: Array, moving: NDArray[np.bool_], start: Array, end: Array, window: int) -> Array:
    """Return each row's (rows,) rms sum of residuals (s, rows) over `window` steps, in units of its expected rms.

    start, end (s, rows, channels): change of the residual for a count read one too high at the start and at the end of
    a step; in their sum only the part remains that comes from the half-way angle.

    The rounding error of a count is uniform over one count, variance 1/12. Taken as independent from sample to sample,
    it contributes to a sum only where the end of a step and the start of the next differ. The rounding error of a
    castor that stands still is constant, so its pointing error is counted as constant for all castors: too much for a
    castor that turns, never too little. The residual of a curved motion is four times as large in sums over steps twice
    as long (`second`), that of a wrong description the same: so a third of the difference is due to the motion. The
    whole difference is allowed for, as a castor that swings round within a few samples does not follow the factor of
    four.
    """
    n, rows = len(residual) // window, residual.shape[1]
    size = n * window
    sums, coherent = (
        part[:size].reshape(n, window, *part.shape[1:]).sum(axis=1) for part in (residual, abs(start + end))
    )
    blocks = [part[:size].reshape(n, window, *part.shape[1:]) for part in (start, end)]
    met = np.concatenate([blocks[0][:, :1], blocks[1][:, :-1] + blocks[0][:, 1:], blocks[1][:, -1:]], axis=1)
    variance = (np.sum(met**2, axis=(1, 3)) + np.sum(coherent**2, axis=-1)) / 12
    curved = np.zeros((n, rows))
    if window > 1:
        pairs = window // 2
        at = window * np.arange(n)[:, None] + np.arange(2 * pairs)
        # A pair of steps begins at an even sample; a window that does not is compared from the next sample on.
        at = np.minimum(at + at[:, :1] % 2, len(second) * 2 - 1)
        once = residual[np.minimum(at, len(residual) - 1)].sum(axis=1)
        curved = second[at[:, ::2] // 2].sum(axis=1) - once
    in_motion = moving[:size].reshape(n, window).any(axis=1)
    expected = np.sqrt(_rms(np.sqrt(variance)[in_motion]) ** 2 + _rms(curved[in_motion]) ** 2)
    return np.divide(_rms(sums[in_motion]), expected, out=np.zeros(rows), where=expected > 0)


def _explained(residual: Array, left: Array, rows: Rows, window: int, castors: int) -> Array:
    """Return for each castor the part of the sums over `window` steps that errors in its rows alone can explain, 0 to
    1.

    An error of rows appears as its projection by `left` (s, rows, rows) on residuals that no motion explains, taken
    half way through the sum. On a robot with two castors either castor can explain the whole residual.
    """
    n = len(residual) // window
    sums = residual[: n * window].reshape(n, window, -1).sum(axis=1)
    left = left[window // 2 : n * window : window]
    found = np.zeros(castors)
    for i in np.unique(rows.castor):
        castor_left = left[:, :, rows.castor == i]
        fitted = np.einsum("kij,kjl,kl->ki", castor_left, np.linalg.pinv(castor_left, rcond=1e-6), sums)
        found[i] = np.sum(fitted**2)
    total = np.sum(sums**2)
    return found / total if total > 0 else found


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(values**2, axis=0)) if len(values) else np.zeros(values.shape[1])
