"""Whether logs and a robot's encoders hold enough information for a diagnosis."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.logs.reference import FARTHEST
from castor_envs.motion.mobility import Mobility
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.parity import BLIND

SHORT, FEWEST_ROWS = 10.0, 10
"""s: a shorter log shows hardly anything; least number of rows with which noise can be distinguished from motion."""

MOVED = 0.05
"""m and rad: a reference that ranges further has moved, as no tracker is so noisy."""

UNSEEN = (
    "the encoders of robot {!r} do not determine its motion: they and wheels that do not slip sideways hold {} of its "
    "3 directions (forward, to the side, turning); give the encoders that it has in the robot file, pivots too"
)
CONTRADICTION = (
    "the logs cannot be made to fit robot {!r}, or show too little motion; look for channels that are swapped, "
    "reversed or dead, counts per turn or dimensions that are wrong by a factor, reference poses not in m and rad, and "
    "counts or poses that jump: castor-diagnose inspect shows them"
)


def check_logs(logs: Mapping[str, Log]) -> None:
    """Raise InputError, with its name, for a log without information.

    That is one of hardly any rows, or in which no encoder count changes (and of a train no relative pose: a standing
    one shows the noise of its gauges).
    """
    for name, log in logs.items():
        if len(log) < FEWEST_ROWS:
            raise InputError(
                f"{name}: has {len(log)} rows; a diagnosis needs at least {FEWEST_ROWS}, and less shows little "
                f"than {SHORT:g} s"
            )
        reference = np.zeros((1, 3)) if log.reference is None else log.reference
        channels = [log.wheel, log.pivot, *([] if log.rps is None else [np.nan_to_num(log.rps)])]
        if not any(np.any(np.ptp(part, axis=0) > 0) for part in channels):
            message = "shows no motion: no encoder count ever changes; leave it out, and record a log while driving"
            taken = reference[np.isfinite(reference[:, 0])]
            if len(taken) and np.any(np.ptp(taken, axis=0) > MOVED):
                message += " (the reference does move: if the robot did, its encoders are not connected)"
            raise InputError(f"{name}: {message}")


def check_near(logs: Mapping[str, Log]) -> None:
    """Raise InputError, with its name, for a robot's log whose reference is far from its origin."""
    for name, log in logs.items():
        reference = np.zeros((1, 3)) if log.reference is None else log.reference
        far = np.abs(np.nan_to_num(reference, posinf=0.0, neginf=0.0))[:, :2]
        row, axis = np.unravel_index(int(np.argmax(far)), far.shape)
        if far[row, axis] > FARTHEST:
            raise InputError(
                f"{name}: ref_{'xy'[axis]} is {reference[row, axis]:g} m in row {row + 1}, and a diagnosis takes "
                f"positions within {FARTHEST:g} m of the origin; mend it, or subtract the place where the robot started"
            )


def check_seen(robot: RobotDescription, *log_sets: Sequence[Log]) -> None:
    """Raise InputError for a robot whose motion its encoders leave open, or logs without the poses that it needs."""
    shown = redundancy(robot)
    for log in [log for logs in log_sets for log in logs] if shown == 0 else ():
        if not _has(log.reference) and (robot.gyro is None or not _has(log.gyro)):
            raise InputError(
                f"{BLIND}; give logs with ref_x, ref_y and, if there is one, ref_psi, or with gyro_z of a gyro in the "
                "robot file"
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
