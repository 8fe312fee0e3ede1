"""What a calibration method is: anything with `calibrate` as below. No base class is needed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True, eq=False)
class Recording:
    """One log for calibration, with what its maker knows of it.

    log: its reference, where there is one, may be known in some rows only (the first and the last). held: the castor
    (from 1) whose wheels were blocked, or None. side: of the UMBmark square that was driven, m, or None.
    """

    log: Log
    held: int | None = None
    side: float | None = None


@runtime_checkable
class CalibrationMethod(Protocol):
    """Finds a robot's parameters in logs of its own. The class is constructed without arguments."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording], /) -> RobotDescription:
        """Return the robot with the parameters that the recordings tell, its layout unchanged.

        robot: as its user describes it. Raises `Declined` (`castor_envs.errors`) where the method does not serve this
        robot or such recordings; whatever else it raises is a fault, of its own or in the recordings.
        """
        ...
