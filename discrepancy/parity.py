"""Parity residual: how far the encoders of one robot are from agreeing with any rigid motion of its body.

Between two samples the body moves by (dx, dy, dpsi) in B, each castor turns by dtheta and each wheel rolls
r dphi. The rolling constraints (castor_envs.kinematics) say, with castor angles half way,

    A(theta) (dx, dy, dpsi) + B dtheta = (r dphi of each wheel with an encoder, 0 for each castor's side slip)

A robot with more such rows than unknowns (an ASOC base of n castors has 3 n against 3) contradicts itself where
its description is wrong, where a wheel slips, and, by a known amount, where counts are rounded. No reference pose is
needed. The half-way angle makes the equations exact to second order: what is left of a smooth motion shrinks with the
cube of the sample period.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.encoders import castor_angles
from castor_envs.kinematics import Geometry, constraint_matrix
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Parity:
    """The parity residual of one log. All lengths in m, a sample.

    wheels (w,) and castors (c,): the indices (from 0) of the wheels whose rolling and of the castors whose side slip
    could be used. redundancy: rows beyond what the motion takes; at 0 nothing can be seen. rolling (N - 1, w) and
    side_slip (N - 1, c): what is left of each row, by least squares with equal weights. moving (N - 1,): whether any
    count changed. rolling_rounding (w,) and side_slip_rounding (c,): the rms that rounded counts alone would leave
    while moving.
    """

    wheels: NDArray[np.intp]
    castors: NDArray[np.intp]
    redundancy: int
    rolling: Array
    side_slip: Array
    moving: NDArray[np.bool_]
    rolling_rounding: Array
    side_slip_rounding: Array

    @property
    def rolling_rms(self) -> Array:
        """The rms (w,) of each wheel's rolling while moving, m; 0 for a log without motion."""
        return _rms(self.rolling[self.moving])

    @property
    def side_slip_rms(self) -> Array:
        """The rms (c,) of each castor's side slip while moving, m; 0 for a log without motion."""
        return _rms(self.side_slip[self.moving])


def parity_residual(robot: RobotDescription, log: Log) -> Parity:
    """Return the misfit of a log to the motion of a rigid body on the wheels of `robot`.

    A castor's rows are used where its angle is known: it is fixed or has a pivot encoder. The side slip of a
    castor's wheels is one row, as they stand on one axle, and is left out where all of them are omni wheels.
    """
    geometry = Geometry.of(robot)
    rows = _usable_rows(geometry)
    w = len(rows.wheels)

    angle = castor_angles(geometry, log.pivot)
    turned = np.diff(angle, axis=0)
    turned -= 2 * np.pi * np.round(turned / (2 * np.pi))
    half_way = angle[:-1] + turned / 2
    counted = np.diff(log.wheel, axis=0)
    rolled = np.zeros((len(counted), len(geometry.radius)))
    rolled[:, robot.driven_wheels] = counted
    rolled = rolled[:, rows.wheels] * _length_of_count(geometry)[rows.wheels]

    a, b = (matrix[:, rows.place] for matrix in constraint_matrix(geometry, half_way))
    inverse = np.linalg.pinv(a, rcond=1e-10)
    left = np.eye(len(rows.place)) - a @ inverse
    measured = np.pad(rolled, ((0, 0), (0, len(rows.castors)))) - b * turned[:, rows.castor]
    residual = np.einsum("kij,kj->ki", left, measured)
    motion = np.einsum("kij,kj->ki", inverse, measured)
    moving = (counted != 0).any(axis=1) | (turned[:, rows.castor] != 0).any(axis=1)
    rounding = left @ _rounding_errors(geometry, rows, half_way, b, motion)
    rounding = _rms(np.linalg.norm(rounding, axis=-1)[moving])
    return Parity(
        wheels=rows.wheels,
        castors=rows.castors,
        redundancy=len(rows.place) - int(np.linalg.matrix_rank(a, tol=1e-9).max(initial=0)),
        rolling=residual[:, :w],
        side_slip=residual[:, w:],
        moving=moving,
        rolling_rounding=rounding[:w],
        side_slip_rounding=rounding[w:],
    )


class _Rows(NamedTuple):
    """The rows in use: wheels and castors as in `Parity`, place in `constraint_matrix`, and each row's castor."""

    wheels: NDArray[np.intp]
    castors: NDArray[np.intp]
    place: NDArray[np.intp]
    castor: NDArray[np.intp]


def _usable_rows(geometry: Geometry) -> _Rows:
    known = (geometry.fixed | ~np.isnan(geometry.pivot_counts_per_rev))[geometry.wheel_castor]
    wheels = np.flatnonzero(known & ~np.isnan(geometry.counts_per_rev))
    standard = np.flatnonzero(known & geometry.standard)
    castors, first = np.unique(geometry.wheel_castor[standard], return_index=True)
    return _Rows(
        wheels=wheels,
        castors=castors,
        place=np.concatenate([wheels, len(geometry.radius) + standard[first]]),
        castor=np.concatenate([geometry.wheel_castor[wheels], castors]),
    )


def _length_of_count(geometry: Geometry) -> Array:
    """Return what each wheel (w,) rolls in a count, m; NaN without encoder."""
    return 2 * np.pi * geometry.radius / geometry.counts_per_rev


def _rounding_errors(geometry: Geometry, rows: _Rows, angle: Array, b: Array, motion: Array) -> Array:
    """Return each row's error (N - 1, rows, sources), one standard deviation of each independent rounding.

    A count is off by an even spread of one count, variance 1/12, afresh at each sample, as long as about a count or
    more goes by in one (slower motion leaves less). So a step of a wheel or castor has 1/6; a half-way angle has
    1/24, and is not correlated with the castor's step.
    """
    samples, (r, w) = len(angle), (len(rows.place), len(rows.wheels))
    rolling = np.zeros((samples, r, w))
    rolling[:, range(w), range(w)] = _length_of_count(geometry)[rows.wheels] / np.sqrt(6)
    count = np.nan_to_num(2 * np.pi / geometry.pivot_counts_per_rev)
    of_castor = (rows.castor[:, None] == np.arange(geometry.n_castors)) * count
    turning = b[..., None] * of_castor / np.sqrt(6)
    # A(theta) is a part that turns with theta and one that stays; half a turn on, the first is reversed.
    here, opposite, quarter = (constraint_matrix(geometry, angle + by)[0] for by in (0.0, np.pi, np.pi / 2))
    derivative = (quarter - (here + opposite) / 2)[:, rows.place]
    pointing = np.einsum("kij,kj->ki", derivative, motion)[..., None] * of_castor / np.sqrt(24)
    return np.concatenate([rolling, turning, pointing], axis=-1)


def _rms(values: Array) -> Array:
    return np.sqrt(np.mean(values**2, axis=0)) if len(values) else np.zeros(values.shape[1])
