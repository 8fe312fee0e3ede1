"""Whether an estimator knows how far it is off: its covariance beside its true errors.

NEES is the normalised estimation error squared, e' P^-1 e, of a pose's error e = (x, y, psi) and its covariance P. For
normal errors that P describes it is distributed as chi-square with three degrees of freedom: 3 on average, and below
7.81 in 95 % of the cases (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation",
Wiley 2001, section 5.4). Below 3 an estimator is too modest, above 3 it is too sure of itself.

Where the truth is what a tracker read, the error is the estimate's and the tracker's together, twice: of the pose that
is compared, and of the start, which was given to the estimator as true. P is then the sum of all three covariances.
"""

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.scoring.metric import PER_CENT, Column, Judged, Metric, Path, shared
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap

NUMBERS = 3
"""Of a pose: the mean of its NEES if the covariance is right."""

WITHIN_95 = 7.814727903251179
"""The chi-square distribution of three degrees of freedom holds 95 % below this."""

EXACT = 1e-9
"""m and rad: no pose is known better, as poses are rounded too."""


def normalised_error_squared(true: ArrayLike, estimated: ArrayLike, covariance: ArrayLike) -> Array:
    """Return the NEES (...) of poses (..., 3) with covariances (..., 3, 3); the error of heading is wrapped."""
    error = np.asarray(estimated, dtype=float) - np.asarray(true, dtype=float)
    error[..., 2] = wrap(error[..., 2])
    spread = np.asarray(covariance, dtype=float) + EXACT**2 * np.eye(NUMBERS)
    return np.sum(error * np.linalg.solve(spread, error[..., None])[..., 0], axis=-1)


def reference_covariance(path: Path) -> Array:
    """Return the covariance (..., M, 3, 3) of the differences between an exact estimate and a run's reference.

    The start's error moves and turns with the way driven since. A belief is no reference, and its covariance is given
    to the estimator.
    """
    noise = path.run.reference_noise
    if noise is None:
        return np.zeros((*path.true.shape, NUMBERS))
    of_pose = np.diag(np.square([noise.position, noise.position, noise.heading]))
    if path.run.belief is not None:
        return np.broadcast_to(of_pose, (*path.true.shape, NUMBERS))
    way = path.true[..., :2] - path.run.start[..., None, :2]
    carried = np.tile(np.eye(NUMBERS), (*path.true.shape[:-1], 1, 1))
    carried[..., 0, 2], carried[..., 1, 2] = -way[..., 1], way[..., 0]
    return of_pose + carried @ of_pose @ np.swapaxes(carried, -1, -2)


@shared
def _squared(judged: Judged) -> Array | None:
    """Return the NEES of all scored poses with a covariance but the start, which is given; None if there are none."""
    found = []
    for path, covariance in zip(judged.paths, judged.covariances, strict=False):
        if covariance is not None and not path.run.baseline:
            later = path.run.samples > 0
            together = covariance + reference_covariance(path)
            chosen = path.true[..., later, :], path.estimate[..., later, :], together[..., later, :, :]
            found.append(normalised_error_squared(*chosen).ravel())
    squared = np.concatenate(found) if found else np.empty(0)
    return squared if squared.size else None


def _nees(judged: Judged) -> np.floating | None:
    squared = _squared(judged)
    return None if squared is None else np.mean(squared) / NUMBERS


def _inside(judged: Judged) -> np.floating | None:
    squared = _squared(judged)
    return None if squared is None else np.mean(squared <= WITHIN_95)


def _status(judged: Judged) -> np.floating | None:
    runs = zip(judged.paths, judged.stated, strict=False)
    scored = [stated for path, stated in runs if stated is not None and not path.run.baseline]
    return np.mean(np.concatenate(scored)) if scored else None


_beside = partial(Metric, ranks=False)

METRICS = (
    _beside(
        "nees",
        _nees,
        unit="1",
        key="nees_over_3",
        title="NEES / 3",
        short="NEES/3",
        shown_unit="1",
        factor=1.0,
        description="squared error of the pose by the estimator's covariance and the reference's, mean over the "
        "scored samples, by 3: 1 if the covariance is right, above it the estimator is too sure",
        place=170,
        column=Column(place=150, keep=15),
    ),
    _beside(
        "inside_95",
        _inside,
        key="share_inside_95_ellipsoid",
        title="inside 95 %",
        short="in 95 %",
        description="share of the scored poses whose error is inside the 95 % ellipsoid of the estimator's covariance "
        "and the reference's",
        place=180,
        column=Column(place=160, keep=10),
        **PER_CENT,
    ),
    _beside(
        "status_share",
        _status,
        key="share_with_status",
        title="with status",
        short="status",
        description="share of the scored samples at which the estimator had a status",
        place=190,
        **PER_CENT,
    ),
)
