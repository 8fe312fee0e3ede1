"""Body motion and what contradicts it in windows of a log, by counts alone."""

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Slip
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.motion.mobility import rows_in_use
from castor_envs.sensors.encoders import castor_angles


class Windows:
    """Body motion and residuals of W windows by counts, by least squares with equal weights.

    used: the constraints in use. weights (q + 1,): of a window's samples in its mean castor angles. rows (W, R, 3)
    times a body motion, plus arms (W, R) times their castors' turns, are the R measured distances. sideways (W, R, 3):
    the derivative of rows by their castor's angle. inverse (W, 3, R): the pseudo-inverse of rows. moved (W, 3): the
    body's motion, m and rad. left (W, R): residual of it, m. rolled (W, w): by each wheel, m.
    """

    def __init__(self, geometry: Geometry, wheel: Array, pivot: Array, q: int = 1, slip: Slip | None = None) -> None:
        """wheel (N, driven wheels), pivot (N, pivot encoders): counts, of which q steps are a window. slip: of
        contacts, if it is known."""
        used, windows = rows_in_use(geometry), (len(wheel) - 1) // q
        ends, driven = q * np.arange(windows + 1), np.flatnonzero(~np.isnan(geometry.counts_per_rev))
        weights: Array = np.ones(q + 1) / q
        weights[[0, -1]] /= 2
        phi = np.zeros((len(wheel), len(geometry.radius)))
        phi[:, driven] = wheel * (2 * np.pi / geometry.counts_per_rev[driven])
        theta = np.unwrap(castor_angles(geometry, pivot), axis=0)
        middle = np.sum([weight * theta[k : k + q * windows : q] for k, weight in enumerate(weights)], axis=0)
        rolled, turned = np.diff(phi[ends], axis=0) * geometry.radius, np.diff(theta[ends], axis=0)

        rows, arms = (part[:, used.place] for part in constraint_matrix(geometry, middle))
        measured = np.pad(rolled[:, used.wheels], ((0, 0), (0, len(used.castors)))) - turned[:, used.castor] * arms
        if slip is not None:
            slipped = np.concatenate([slip.rolling[:, used.wheels], slip.side[:, used.castors]], axis=1)
            measured += slipped[: ends[-1]].reshape(windows, q, -1).sum(axis=1)
        # The matrix is a part that turns with the castors and one that stays; half a turn on, the first is reversed.
        opposite, quarter = (constraint_matrix(geometry, middle + by)[0][:, used.place] for by in (np.pi, np.pi / 2))
        self.inverse = np.asarray(np.linalg.pinv(rows, rcond=1e-10), dtype=np.float64)
        self.moved: Array = np.einsum("wij,wj->wi", self.inverse, measured)
        self.left: Array = measured - np.einsum("wij,wj->wi", rows, self.moved)
        self.geometry, self.used, self.weights, self.rows, self.arms = geometry, used, weights, rows, arms
        self.sideways, self.rolled = quarter - (rows + opposite) / 2, rolled

    @property
    def redundancy(self) -> int:
        """The number of rows beyond the unknowns of the motion; at 0 no error is visible."""
        return len(self.used.place) - int(np.linalg.matrix_rank(self.rows, tol=1e-9).max(initial=0))

    def by_counts(self) -> Array:
        """Return derivatives of measured distances (W, R, q + 1, channels), m, by the counts at each sample of a
        window; channels: castors with pivot encoder, then wheels with encoder."""
        geometry, used, sensed = self.geometry, self.used, self.geometry.sensed
        driven = np.flatnonzero(~np.isnan(geometry.counts_per_rev))
        of_castor = (used.castor[:, None] == sensed) * (2 * np.pi / geometry.pivot_counts_per_rev[sensed])
        pointing = np.einsum("wij,wj->wi", self.sideways, self.moved)
        turning = np.pad(pointing[:, :, None] * of_castor, ((0, 0), (0, 0), (0, len(driven))))
        still = np.pad(-self.arms[:, :, None] * of_castor, ((0, 0), (0, 0), (0, len(driven))))
        length = geometry.radius * 2 * np.pi / geometry.counts_per_rev
        column = len(sensed) + np.searchsorted(driven, used.wheels)
        still[:, np.arange(len(used.wheels)), column] = length[used.wheels]
        by = -self.weights[:, None] * turning[:, :, None]
        by[:, :, 0] -= still
        by[:, :, -1] += still
        return by
