"""GRPEC, Geometric Relative Posture Error Correction: Method 3 of Vogt and Minor, for any number of axles.

The relative poses are made global by attaching them to one axle's odometry-derived (OD) pose. The axle whose
attachment differs least from all OD poses is the most trustworthy, and its attachment becomes the belief. The pure
functions broadcast over leading axes.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs import se2
from castor_envs.errors import InputError
from castor_envs.kinematics import Array
from castor_envs.train import TrainDescription
from estimators.castor_odometry import wrap
from estimators.configuration import DEFAULT_INTERVAL, Configuration, checked_interval, next_to
from estimators.protocol import Observation

Metric = Literal["xy", "phi", "dev"]

TIE = 1e-12
"""m and rad: errors closer than this are equal. theta_phi of two axles is always equal for even N."""


class Errors(NamedTuple):
    """How far each attachment is from the OD poses, (..., N) by the attached axle j.

    theta_xy: sum of distances, m (eqs. 3, 5). theta_phi: sum of heading differences, rad (eqs. 4, 5). theta_dev:
    deviation angle between the vectors from the last axle to the first, rad (eqs. 6, 7).
    """

    theta_xy: Array
    theta_phi: Array
    theta_dev: Array


def chain(relative: ArrayLike) -> Array:
    """Return the poses (..., N, 3) of all axles in the last axle's frame, from relative poses (..., N - 1, 3)."""
    relative = np.asarray(relative, dtype=float)
    poses = [np.zeros((*relative.shape[:-2], 3))]
    for frame in reversed(range(relative.shape[-2])):
        poses.append(se2.compose(poses[-1], relative[..., frame, :]))
    return np.stack(poses[::-1], axis=-2)


def attached(od: ArrayLike, relative: ArrayLike) -> Array:
    """Return the poses (..., N, N, 3) of the relative poses made global: [j, i] is axle i, attached to axle j (eq. 2).

    od: OD poses (..., N, 3) in N (eq. 1). relative: (..., N - 1, 3), the front axle in the rear axle's frame, from
    the front. [j, j] is the OD pose of axle j.
    """
    od, shape = np.asarray(od, dtype=float), chain(relative)
    seen = se2.relative_pose(shape[..., :, None, :], shape[..., None, :, :])
    return se2.compose(od[..., :, None, :], seen)


def errors(od: ArrayLike, relative: ArrayLike) -> Errors:
    """Return the errors (..., N) of every attachment, for OD poses (..., N, 3) and relative poses (..., N - 1, 3)."""
    od = np.asarray(od, dtype=float)
    difference = od[..., None, :, :] - (poses := attached(od, relative))
    distance = np.hypot(difference[..., 0], difference[..., 1])  # eq. 3
    turn = np.abs(wrap(difference[..., 2]))  # eq. 4
    deviation = _angle_between((od[..., 0, :2] - od[..., -1, :2])[..., None, :], poses[..., 0, :2] - poses[..., -1, :2])
    return Errors(distance.sum(axis=-1), turn.sum(axis=-1), deviation)  # eq. 5


def select(errors: ArrayLike, theta_xy: ArrayLike) -> NDArray[np.intp]:
    """Return the most trustworthy axle, (...) from 0: that of the smallest of `errors` (..., N).

    Ties within `TIE` go to the lower `theta_xy` (..., N); if that ties too, to the lower number.
    """
    errors, theta_xy = np.broadcast_arrays(np.asarray(errors, dtype=float), np.asarray(theta_xy, dtype=float))
    tied = errors <= errors.min(axis=-1, keepdims=True) + TIE
    distance = np.where(tied, theta_xy, np.inf)
    return np.argmax(distance <= distance.min(axis=-1, keepdims=True) + TIE, axis=-1)


def confidence(errors: ArrayLike) -> tuple[Array, Array]:
    """Return CON1 (eq. 8) and CON2 (eq. 9), each (...), of errors (..., N); 0 where all are 0.

    CON2 compares the smallest with the second smallest error ("the next most trustworthy axle"), which for N = 3 is
    the median that eq. 9 prints.
    """
    ordered = np.sort(np.asarray(errors, dtype=float), axis=-1)
    least = ordered[..., 0]
    return _shortfall(least, ordered[..., -1]), _shortfall(least, ordered[..., 1])


class GRPEC:
    """Every so often replaces the OD poses by the attachment to the most trustworthy axle; odometry goes on from it.

    metric: the error that is smallest. interval: sample periods between corrections.

    selected: the axle (from 1) that the last correction trusted; confidence: its (CON1, CON2); both None before.
    status: why relative poses cannot be used now, or None.
    """

    def __init__(self, metric: Metric = "xy", interval: int = DEFAULT_INTERVAL) -> None:
        if metric not in ("xy", "phi", "dev"):
            raise InputError(f"unknown metric {metric!r}; known: xy, phi, dev")
        self.metric: Metric = metric
        self.interval = checked_interval(interval)

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises InputError for anything but a train, and for poses of another shape."""
        self._configuration = Configuration(train, poses, self.interval)
        self.selected: int | None = None
        self.confidence: tuple[float, float] | None = None

    @property
    def status(self) -> str | None:
        """Which frame's relative pose cannot be used now, and why; None while all can."""
        return self._configuration.status

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the poses (N, 3)."""
        relative = self._configuration.advance(observation)
        if relative is not None:
            od = self._configuration.poses
            found = errors(od, relative)
            metric = getattr(found, f"theta_{self.metric}")
            axle = int(select(metric, found.theta_xy))
            con1, con2 = confidence(metric)
            self.selected, self.confidence = axle + 1, (float(con1), float(con2))
            self._configuration.correct(next_to(od[:, 2], attached(od, relative)[axle]))
        return self._configuration.poses.copy()


class GRPECXY(GRPEC):
    """GRPEC by position error, theta_xy: the one metric that passes all four static tests of the paper."""

    def __init__(self, interval: int = DEFAULT_INTERVAL) -> None:
        super().__init__("xy", interval)


class GRPECPhi(GRPEC):
    """GRPEC by orientation error, theta_phi."""

    def __init__(self, interval: int = DEFAULT_INTERVAL) -> None:
        super().__init__("phi", interval)


class GRPECDev(GRPEC):
    """GRPEC by deviation angle, theta_dev."""

    def __init__(self, interval: int = DEFAULT_INTERVAL) -> None:
        super().__init__("dev", interval)


def _angle_between(a: Array, b: Array) -> Array:
    """Return the angle between plane vectors (..., 2); 0 where either has no length.

    By atan2: the arccos of eq. 7 loses half of the digits near 0.
    """
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    dot = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    some = (np.hypot(a[..., 0], a[..., 1]) > TIE) & (np.hypot(b[..., 0], b[..., 1]) > TIE)
    return np.where(some, np.arctan2(np.abs(cross), dot), 0.0)


def _shortfall(least: Array, other: Array) -> Array:
    """Return (other - least) / other, 0 for 0 / 0: errors that are equal to 0 as ties are."""
    return np.where(other > TIE, (other - least) / np.maximum(other, TIE), 0.0)
