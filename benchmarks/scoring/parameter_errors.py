"""How far a calibrated robot's parameters are from the true ones."""

import numpy as np

from castor_envs.vehicles.robot import RobotDescription


def parameter_errors(found: RobotDescription, true: RobotDescription) -> dict[str, float]:
    """Return mean absolute errors of parameters, by the names of `evaluation.METRICS`.

    offset_error, radius_error, half_track_error: relative, over the castors with an offset, the wheels with an encoder,
    and of these the ones beside their castor's centre line. pivot_zero_error: rad, over the castors with a pivot
    encoder, whole turns left out. What a robot has none of is left out. Nothing is taken off: a common scale that no
    log can show counts in full.
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
