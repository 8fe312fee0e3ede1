"""Whether logs and a robot's encoders hold enough information for a diagnosis."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.mobility import Mobility
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.parity import BLIND

UNSEEN = (
    "the encoders of robot {!r} do not determine its motion: they and wheels that do not slip sideways hold {} of its "
    "3 directions (forward, to the side, turning); give the encoders that it has in the robot file, pivots too"
)
CONTRADICTION = (
    "the logs cannot be made to fit robot {!r}, or show too little motion; look for channels that are swapped, "
    "reversed or dead, counts per turn or dimensions that are wrong by a factor, reference poses not in m and rad, and "
    "counts or poses that jump: castor-diagnose inspect shows them"
)


def check_seen(robot: RobotDescription, *log_sets: Sequence[Log]) -> None:
    """Raise InputError for a robot whose motion its encoders leave open, or logs without the poses that it needs."""
    shown = redundancy(robot)
    for log in [log for logs in log_sets for log in logs] if shown == 0 else ():
        if not _has(log.reference) and (robot.gyro is None or not _has(log.gyro)):
            raise InputError(
                f"{BLIND}; give logs with ref_x, ref_y and ref_psi, or with gyro_z of a gyro in the robot file"
            )


def redundancy(robot: RobotDescription) -> int:
    """Return the number of rows that the encoders of a robot give beyond the three directions of its motion.

    Raises InputError where they leave a direction open.
    """
    mobility = Mobility.of(robot)
    if mobility.determined < 3:
        raise InputError(UNSEEN.format(robot.name, mobility.determined))
    return mobility.redundancy


def _has(measured: Array | None) -> bool:
    return measured is not None and bool(np.isfinite(measured).any())


@contextmanager
def must_fit(robot: RobotDescription) -> Iterator[None]:
    """Turn what linear algebra says of logs that a robot cannot have made into an InputError."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows has no fit
            yield
    except np.linalg.LinAlgError:
        raise InputError(CONTRADICTION.format(robot.name)) from None
