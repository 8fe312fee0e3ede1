"""The residuals of a log in which the strength of an effect is measured, and their covariance by the declared noise.

    parity    in windows of 0.1 s: rolling and side slip that no rigid motion of the body explains
    steps     of 1 s: motion of the reference minus motion of the body by its counts, in the body's frame

Nothing of the finder is used: a diagnosis is not judged by its own equations.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cholesky_banded, get_lapack_funcs

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose, rotate, rotation, wrap
from castor_envs.logs.log import Log
from discrepancy.trials.reading import USUAL
from discrepancy.validation.windows import Windows

WINDOW, STEP = 0.1, 1.0
"""s: lengths of parity windows and of reference steps."""

Index = NDArray[np.intp]


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


@dataclass(frozen=True)
class NoiseModel:
    """The declared noise with which residuals are whitened.

    counts: variance of an absolute reading, counts^2. position, heading: of reference poses, m and rad, one standard
    deviation. slip: of every rolling row, m after 1 m. least: slip of a window in which nothing moves, m.
    """

    counts: float = 1 / 12
    position: float = USUAL.position
    heading: float = USUAL.heading
    slip: float = 3e-5
    least: float = 1e-7


class Whitening:
    """Whitens the residuals of one run by the covariance that noise causes in them.

    null (W, R, redundancies): an orthonormal basis, at every window, of the residuals that no motion explains; parity
    is expressed in it. by_counts: the derivative of the residuals by all counts (sparse; columns: samples, then
    channels). covariance: sparse. Residuals: parity, window by window, then steps.
    """

    def __init__(self, layout: Layout, windows: Windows, log: Log, noise_model: NoiseModel) -> None:
        redundant, per = windows.redundancy, layout.per_step
        self.null = np.linalg.svd(windows.rows)[0][:, :, len(windows.used.place) - redundant :]
        parity = np.arange(layout.windows * redundant).reshape(layout.windows, redundant)
        steps = parity.size + np.arange(layout.steps * 3).reshape(layout.steps, 3)
        self._size = parity.size + steps.size
        of_window, by_motion = np.repeat(steps, per, axis=0), -followed(layout, windows.moved)[1]

        def spread(by_row: Array, column: Index, columns: int) -> sparse.csr_array:
            """Return derivatives of residuals, given those of the rows' measured distances (W, R, k) by columns (W,
            k)."""
            n = len(by_motion)
            shared = by_motion @ (windows.inverse @ by_row)[:n]
            blocks = [(parity, column, np.swapaxes(self.null, 1, 2) @ by_row), (of_window, column[:n], shared)]
            return _sparse(blocks, (self._size, columns))

        by_counts = windows.by_counts()
        channels = by_counts.shape[-1]
        samples = (layout.q * np.arange(layout.windows))[:, None] + np.arange(layout.q + 1)
        column = (samples[:, :, None] * channels + np.arange(channels)).reshape(layout.windows, -1)
        self.by_counts = spread(by_counts.reshape(*by_counts.shape[:2], -1), column, len(log) * channels)
        slip_columns = np.arange(windows.left.size).reshape(windows.left.shape)
        slip = np.sqrt(noise_model.slip**2 * _distance(windows) + noise_model.least**2)
        by_slip = spread(slip[:, :, None] * np.eye(slip.shape[1]), slip_columns, slip_columns.size)

        sigma = np.array([noise_model.position, noise_model.position, noise_model.heading])
        place = np.arange((layout.steps + 1) * 3).reshape(-1, 3)
        _, before, after = between(poses_of(layout, log))
        blocks = [(steps, place[:-1], before * sigma), (steps, place[1:], after * sigma)]
        by_poses = _sparse(blocks, (self._size, place.size))

        self.covariance = noise_model.counts * (self.by_counts @ self.by_counts.T)
        self.covariance += by_slip @ by_slip.T + by_poses @ by_poses.T
        middle = [
            np.repeat(np.arange(layout.windows) + 0.5, redundant),
            np.repeat(np.arange(layout.steps) + 0.5, 3) * per,
        ]
        self._order = np.argsort(np.concatenate(middle), kind="stable")
        self._factor = cholesky_banded(_band(sparse.csr_array(self.covariance), self._order), lower=True)

    def whitened(self, residuals: Array) -> Array:
        """Return residuals (size, ...) in standard deviations, uncorrelated (and in another order)."""
        (solve,) = get_lapack_funcs(("tbtrs",), (self._factor,))
        solved, info = solve(self._factor, residuals[self._order].reshape(self._size, -1), uplo="L")
        if info:
            raise ArithmeticError(f"the covariance of residuals is singular at row {info}")
        return solved.reshape(residuals.shape)


def _distance(windows: Windows) -> Array:
    """Return the distances that the wheels of each row roll in each window (W, R), m; for side slip the mean of the
    castor's wheels."""
    rolled, geometry = np.abs(windows.rolled), windows.geometry
    columns = [rolled[:, wheel] for wheel in windows.used.wheels]
    for castor in windows.used.castors:
        wheels = np.flatnonzero((geometry.wheel_castor == castor) & ~np.isnan(geometry.counts_per_rev))
        columns.append(rolled[:, wheels].mean(axis=1) if wheels.size else np.hypot(*windows.moved[:, :2].T))
    return np.stack(columns, axis=-1)


def _sparse(blocks: list[tuple[Index, Index, Array]], shape: tuple[int, int]) -> sparse.csr_array:
    """Return a matrix of dense blocks: rows (B, r), columns (B, c) and values (B, r, c); overlapping values are
    added."""
    row = [np.broadcast_to(rows[:, :, None], values.shape).ravel() for rows, _, values in blocks]
    column = [np.broadcast_to(columns[:, None, :], values.shape).ravel() for _, columns, values in blocks]
    values = [values.ravel() for _, _, values in blocks]
    entries = (np.concatenate(values), (np.concatenate(row), np.concatenate(column)))
    return sparse.csr_array(sparse.coo_array(entries, shape=shape))


def _band(matrix: sparse.csr_array, order: Index) -> Array:
    """Return the lower band of a symmetric matrix, with rows and columns in another order."""
    diagonals = sparse.dia_array(sparse.tril(matrix[order][:, order]))
    band = np.zeros((1 - int(diagonals.offsets.min()), len(order)))
    band[-diagonals.offsets, : diagonals.data.shape[1]] = diagonals.data
    return band
