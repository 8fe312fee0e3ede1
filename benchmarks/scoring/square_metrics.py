"""UMBmark's metrics: where odometry says that a robot ends, though it truly returned to its start.

Sources:

- UMBmark: Borenstein and Feng, "UMBmark: A Method for Measuring, Comparing, and Correcting Dead-reckoning Errors in
  Mobile Robots", University of Michigan UM-MEAM-94-22, 1994
- extended UMBmark: the same, "UMBmark: A Benchmark Test for Measuring Odometry Errors in Mobile Robots", SPIE 1995
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.scoring.metric import DEG, MM, Column, Judged, Metric, shared
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose


def return_errors(start: ArrayLike, true_end: ArrayLike, estimated_end: ArrayLike) -> Array:
    """Return UMBmark's return errors (..., 3): eps_x, eps_y (m), eps_theta (rad) = true minus odometry.

    All poses (..., 3). The errors are in the frame of the start pose, which UMBmark puts in the corner of two walls.
    """
    return relative_pose(start, true_end) - relative_pose(start, estimated_end)


class UMBmark(NamedTuple):
    """UMBmark's numbers, m: centroids (..., 2) of both clusters, their distances from 0 and the larger one (...)."""

    centroid_cw: Array
    centroid_ccw: Array
    r_cw: Array
    r_ccw: Array
    e_max_syst: Array


def umbmark(cw: ArrayLike, ccw: ArrayLike) -> UMBmark:
    """Return UMBmark's measure of systematic errors from return errors (..., n, 2 or 3) of clockwise and ccw runs.

    The centres of gravity of both clusters of errors lie r_cw and r_ccw from the origin, and E_max,syst is the larger
    of the two (Borenstein and Feng 1994).
    """
    centroid_cw = np.mean(np.asarray(cw, dtype=float)[..., :2], axis=-2)
    centroid_ccw = np.mean(np.asarray(ccw, dtype=float)[..., :2], axis=-2)
    r_cw, r_ccw = np.linalg.norm(centroid_cw, axis=-1), np.linalg.norm(centroid_ccw, axis=-1)
    return UMBmark(centroid_cw, centroid_ccw, r_cw, r_ccw, np.maximum(r_cw, r_ccw))


def orientation_error(
    cw: ArrayLike, ccw: ArrayLike, clean_cw: ArrayLike | None = None, clean_ccw: ArrayLike | None = None
) -> Array:
    """Return the extended UMBmark's average absolute orientation error (...), rad.

    cw, ccw: return orientation errors (..., n), rad, of the runs over bumps. clean_cw, clean_ccw: those of the same
    robot on the clean floor (..., m); their mean in each direction is the systematic error, which is subtracted before
    the absolute value, so that only the effect of the bumps is left. Without them nothing is subtracted. The two
    directions' means of |eps_theta| are averaged. Positions are not used: they depend on where the bumps lay, the
    orientation does not (Borenstein and Feng 1995).
    """

    def mean_absolute(errors: ArrayLike, clean: ArrayLike | None) -> Array:
        bias = 0.0 if clean is None else np.mean(np.asarray(clean, dtype=float), axis=-1, keepdims=True)
        return np.mean(np.abs(np.asarray(errors, dtype=float) - bias), axis=-1)

    return (mean_absolute(cw, clean_cw) + mean_absolute(ccw, clean_ccw)) / 2


@shared
def _returns(judged: Judged) -> dict[tuple[str, bool], Array] | None:
    """Return the return errors (n, 3) by direction and whether the runs are the baseline.

    None without scored squares in both directions.
    """
    if judged.of_train:
        return None
    errors = {
        (direction, baseline): np.reshape(
            [
                return_errors(true[0], true[-1], estimate[-1])
                for run, true, estimate in judged.paths
                if (run.direction, run.baseline) == (direction, baseline)
            ],
            (-1, 3),
        )
        for direction in ("cw", "ccw")
        for baseline in (False, True)
    }
    return errors if len(errors["cw", False]) and len(errors["ccw", False]) else None


@shared
def _umbmark(judged: Judged) -> UMBmark | None:
    errors = _returns(judged)
    return None if errors is None else umbmark(errors["cw", False], errors["ccw", False])


def _e_max_syst(judged: Judged) -> Array | None:
    square = _umbmark(judged)
    return None if square is None else square.e_max_syst


def _r_cw(judged: Judged) -> Array | None:
    square = _umbmark(judged)
    return None if square is None else square.r_cw


def _r_ccw(judged: Judged) -> Array | None:
    square = _umbmark(judged)
    return None if square is None else square.r_ccw


def _orientation_error(judged: Judged) -> Array | None:
    errors = _returns(judged)
    return None if errors is None else orientation_error(errors["cw", False][:, 2], errors["ccw", False][:, 2])


def _nonsystematic_orientation_error(judged: Judged) -> Array | None:
    """Return None without baseline squares in both directions."""
    errors = _returns(judged)
    if errors is None or not (len(errors["cw", True]) and len(errors["ccw", True])):
        return None
    kinds = (("cw", False), ("ccw", False), ("cw", True), ("ccw", True))
    return orientation_error(*(errors[kind][:, 2] for kind in kinds))


METRICS = (
    Metric(
        "E_max_syst",
        _e_max_syst,
        key="E_max_syst_m",
        title="E_max,syst",
        short="E_max",
        description="UMBmark, systematic",
        place=10,
        **MM,
    ),
    Metric(
        "r_cw",
        _r_cw,
        key="r_cw_m",
        title="r_cw",
        short="r_cw",
        description="UMBmark, clockwise centroid",
        place=20,
        **MM,
    ),
    Metric(
        "r_ccw",
        _r_ccw,
        key="r_ccw_m",
        title="r_ccw",
        short="r_ccw",
        description="UMBmark, other centroid",
        place=30,
        **MM,
    ),
    Metric(
        "orientation_error",
        _orientation_error,
        key="orientation_error_rad",
        title="orientation",
        short="orient.",
        description="mean absolute return orientation error",
        place=40,
        **DEG,
    ),
    Metric(
        "nonsystematic_orientation_error",
        _nonsystematic_orientation_error,
        key="nonsystematic_orientation_error_rad",
        title="orientation, non-syst.",
        short="non-syst.",
        description="extended UMBmark: the same less the mean error on the clean floor",
        place=50,
        column=Column(place=10, keep=10),
        **DEG,
    ),
)
