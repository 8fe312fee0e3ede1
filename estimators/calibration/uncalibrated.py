"""No calibration: the baseline with which every method is compared."""

from collections.abc import Sequence

from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording


class Uncalibrated:
    """Returns the robot as it is described: the baseline."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot unchanged."""
        return robot


METHODS = {"uncalibrated": Uncalibrated}
