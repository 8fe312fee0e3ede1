"""GRPEC, Geometric Relative Posture Error Correction: Method 3 of Vogt and Minor, for any number of axles.

The relative poses are made global by attaching them to one axle's odometry-derived (OD) pose. The axle whose
attachment differs least from all OD poses is the most trustworthy, and its attachment becomes the belief. The pure
functions broadcast over leading axes.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import InputError
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.trains.configuration import DEFAULT_INTERVAL, Configuration, checked_interval, next_to

Metric = Literal["xy", "phi", "dev"]

TIE = 1e-12
"""m and rad: errors closer than this count as equal, and lengths and errors up to this as 0, so that rounding never
decides. theta_phi of two axles is always equal for even N."""

AT_ONCE = 4096
"""Snapshots whose errors are computed at once: more do not stay in a processor's cache."""


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
    the front. [j, j] is the OD pose of axle j. Raises InputError for other shapes.
    """
    od, relative = _checked(od, relative)
    shape = chain(relative)
    seen = se2.relative_pose(shape[..., :, None, :], shape[..., None, :, :])
    return se2.compose(od[..., :, None, :], seen)


def corrected(od: ArrayLike, relative: ArrayLike, axle: ArrayLike) -> Array:
    """Return the poses (..., N, 3) of the relative poses made global by one axle (...), from 0: `attached` for that
    axle alone. All have the same leading axes. Raises InputError for other shapes."""
    od, relative = _checked(od, relative)
    shape, axle = chain(relative), np.asarray(axle)[..., None, None]
    trusted, seen_from = (np.take_along_axis(poses, axle, axis=-2) for poses in (od, shape))
    return se2.compose(trusted, se2.relative_pose(seen_from, shape))


def errors(od: ArrayLike, relative: ArrayLike) -> Errors:
    """Return the errors (..., N) of every attachment, for OD poses (..., N, 3) and relative poses (..., N - 1, 3).

    For each attachment j, OD pose i minus attached pose i is computed from vectors relative to axle j: the chain from j
    to i, turned by the OD heading of j minus its heading in the chain. So neither distant positions nor whole turns of
    a heading cost digits, and errors that tie do so exactly. Raises InputError for other shapes.
    """
    od, relative = _checked(od, relative)
    if od.ndim == relative.ndim == 3 and len(od) == len(relative) > AT_ONCE:
        starts = range(0, len(od), AT_ONCE)
        parts = [errors(od[start : start + AT_ONCE], relative[start : start + AT_ONCE]) for start in starts]
        return Errors(*map(np.concatenate, zip(*parts, strict=True)))
    shape = chain(relative)
    turned = wrap(od[..., 2] - shape[..., 2])
    cos, sin = np.cos(turned)[..., None], np.sin(turned)[..., None]

    def attached_arm(arm: Array) -> tuple[Array, Array]:
        return cos * arm[..., 0] - sin * arm[..., 1], sin * arm[..., 0] + cos * arm[..., 1]

    def arms(poses: Array) -> Array:
        return poses[..., None, :, :2] - poses[..., :, None, :2]

    x, y = attached_arm(arms(shape))
    between = arms(od)
    distance = np.hypot(between[..., 0] - x, between[..., 1] - y)  # eq. 3
    turn = np.abs(wrap(turned[..., None, :] - turned[..., :, None]))  # eq. 4
    whole_arm = attached_arm((shape[..., 0, :2] - shape[..., -1, :2])[..., None, None, :])
    dev_od = (od[..., 0, :2] - od[..., -1, :2])[..., None, :]
    deviation = _angle_between(dev_od, np.stack(whole_arm, axis=-1)[..., 0, :])  # eqs. 6, 7
    return Errors(distance.sum(axis=-1), turn.sum(axis=-1), deviation)  # eq. 5


def select(errors: ArrayLike, theta_xy: ArrayLike) -> NDArray[np.intp]:
    """Return the most trustworthy axle (...), from 0: the one with the smallest of `errors` (..., N).

    Ties within `TIE` go to the lower `theta_xy` (..., N); if that ties too, to the lower number. Raises InputError
    where the shapes differ or an error is not a number.
    """
    errors, theta_xy = np.asarray(errors, dtype=float), np.asarray(theta_xy, dtype=float)
    if errors.shape != theta_xy.shape:
        raise InputError(f"errors have shape {errors.shape}, theta_xy has {theta_xy.shape}; give one for each axle")
    if np.isnan(errors).any() or np.isnan(theta_xy).any():
        raise InputError("an error is not a number, so no axle can be selected; check odometry and relative poses")
    tied = errors <= errors.min(axis=-1, keepdims=True) + TIE
    distance = np.where(tied, theta_xy, np.inf)
    return np.argmax(distance <= distance.min(axis=-1, keepdims=True) + TIE, axis=-1)


def confidence(errors: ArrayLike) -> tuple[Array, Array]:
    """Return CON1 (eq. 8) and CON2 (eq. 9), each (...), of errors (..., N), N at least 2.

    CON2 compares the smallest with the second smallest error ("the next most trustworthy axle"), which for N = 3 is the
    median that eq. 9 prints. Where the error that the smallest is compared with is 0 (at most `TIE`), so is the
    confidence.
    """
    ordered = np.sort(np.asarray(errors, dtype=float), axis=-1)
    if ordered.ndim == 0 or ordered.shape[-1] < 2:
        raise InputError(f"confidence compares two axles or more, got errors of shape {ordered.shape}")
    least = ordered[..., 0]
    return _shortfall(least, ordered[..., -1]), _shortfall(least, ordered[..., 1])


class GRPEC:
    """At intervals replaces the OD poses by the attachment to the most trustworthy axle; odometry goes on from it.

    metric: the error that is smallest. interval: sample periods between corrections.

    selected: the axle (from 1) that the last correction trusted; confidence: its (CON1, CON2); both None before.
    status: why relative poses cannot be used now, or None.
    """

    def __init__(self, metric: Metric = "xy", interval: int = DEFAULT_INTERVAL) -> None:
        if metric not in ("xy", "phi", "dev"):
            raise InputError(f"unknown metric {metric!r}; known: xy, phi, dev")
        self.metric: Metric = metric
        self.interval = checked_interval(interval)
        self.selected: int | None = None
        self.confidence: tuple[float, float] | None = None

    def reset(self, train: TrainDescription, poses: ArrayLike) -> None:
        """Start at `poses` (N, 3); raises InputError for anything but a train, and for poses of another shape."""
        self._configuration = Configuration(train, poses, self.interval)
        self.selected = self.confidence = None

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
            self._configuration.correct(next_to(od[:, 2], corrected(od, relative, axle)))
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


def _checked(od: ArrayLike, relative: ArrayLike) -> tuple[Array, Array]:
    """Return both as arrays; raises InputError unless their shapes are (..., N, 3) and (..., N - 1, 3), N >= 2."""
    od, relative = np.asarray(od, dtype=float), np.asarray(relative, dtype=float)
    fits = od.ndim >= 2 and relative.ndim >= 2 and od.shape[-1] == relative.shape[-1] == 3
    if not fits or od.shape[-2] < 2 or relative.shape[-2] != od.shape[-2] - 1:
        raise InputError(
            f"odometry needs shape (..., N, 3) and relative poses (..., N - 1, 3) for a train of N >= 2 axles, "
            f"got {od.shape} and {relative.shape}"
        )
    return od, relative


def _angle_between(a: Array, b: Array) -> Array:
    """Return the angle between plane vectors (..., 2); 0 where either has no length (at most `TIE`).

    By atan2: the arccos of eq. 7 loses half of the digits near 0.
    """
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    dot = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    degenerate = (np.hypot(a[..., 0], a[..., 1]) <= TIE) | (np.hypot(b[..., 0], b[..., 1]) <= TIE)
    return np.where(degenerate, 0.0, np.arctan2(np.abs(cross), dot))


def _shortfall(least: Array, compared: Array) -> Array:
    """Return (compared - least) / compared, and 0 where `compared` is 0 (at most `TIE`)."""
    return np.where(compared <= TIE, 0.0, (compared - least) / np.maximum(compared, TIE))


ESTIMATORS = {"grpec-phi": GRPECPhi, "grpec-dev": GRPECDev, "grpec-xy": GRPECXY}
