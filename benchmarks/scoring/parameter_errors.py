"""How far a calibrated robot's parameters are from the true ones."""

import numpy as np

from benchmarks.scoring.metric import DEG, PER_CENT, Column, Judged, Metric, shared
from castor_envs.vehicles.robot import RobotDescription


def parameter_errors(found: RobotDescription, true: RobotDescription) -> dict[str, float]:
    """Return mean absolute errors of parameters, by the names of the metrics.

    offset_error, radius_error, half_track_error: relative, over the castors with an offset, the wheels with an encoder,
    and those of these wheels that stand beside their castor's centre line. pivot_zero_error: rad, over the castors with
    a pivot encoder, whole turns left out. Metrics of parts that a robot lacks are left out. Nothing is subtracted: an
    error of the common scale, which no log can show, counts in full.
    """
    castors = list(zip(found.castors, true.castors, strict=True))
    wheels = [(found.wheels[k], true.wheels[k]) for k in true.driven_wheels]
    errors = {
        "offset_error": [a.offset / b.offset - 1 for a, b in castors if b.offset > 0],
        "radius_error": [a.radius / b.radius - 1 for a, b in wheels],
        "half_track_error": [a.lateral / b.lateral - 1 for a, b in wheels if b.lateral != 0],
        "pivot_zero_error": [
            np.angle(np.exp(1j * (a.pivot_zero - b.pivot_zero)))
            for a, b in castors
            if b.pivot_counts_per_rev is not None
        ],
    }
    return {name: float(np.mean(np.abs(values))) for name, values in errors.items() if values}


@shared
def _errors(judged: Judged) -> dict[str, float]:
    """Return the errors; an empty dict where no robot was calibrated, or the true robot is unknown."""
    calibration = judged.episode.calibration
    if judged.calibrated is None or calibration is None or calibration.true_robot is None:
        return {}
    return parameter_errors(judged.calibrated, calibration.true_robot)


METRICS = (
    Metric(
        "offset_error",
        lambda judged: _errors(judged).get("offset_error"),
        key="offset_error",
        title="r_c error",
        short="r_c",
        description="calibration: mean absolute relative error of the castors' offsets",
        place=170,
        column=Column(place=90, keep=80),
        **PER_CENT,
    ),
    Metric(
        "radius_error",
        lambda judged: _errors(judged).get("radius_error"),
        key="radius_error",
        title="r_w error",
        short="r_w",
        description="calibration: mean absolute relative error of the wheels' radii",
        place=180,
        column=Column(place=100, keep=100),
        **PER_CENT,
    ),
    Metric(
        "half_track_error",
        lambda judged: _errors(judged).get("half_track_error"),
        key="half_track_error",
        title="d error",
        short="d",
        description="calibration: mean absolute relative error of the wheels' lateral distances",
        place=190,
        column=Column(place=110, keep=90),
        **PER_CENT,
    ),
    Metric(
        "pivot_zero_error",
        lambda judged: _errors(judged).get("pivot_zero_error"),
        key="pivot_zero_error_rad",
        title="beta error",
        short="beta",
        description="calibration: mean absolute error of the pivot encoders' zeros",
        place=200,
        column=Column(place=120, keep=110),
        **DEG,
    ),
)
