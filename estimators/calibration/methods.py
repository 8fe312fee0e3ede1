"""The calibration methods of this package, each as a `CalibrationMethod`."""

from collections.abc import Sequence

from castor_envs.errors import InputError
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration import maximum_likelihood, pivoting
from estimators.calibration.protocol import Recording
from estimators.calibration.umbmark import corrected, direction_of, from_logs


class Uncalibrated:
    """Returns the robot as it is described: the yardstick."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot unchanged."""
        return robot


class Pivoting:
    """Turns about held castors, both ways (Doebbler, eqs. 1-9); bases on two or more split castors."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot with the mean of what the turns about each castor tell of the others."""
        turns = [pivoting.Turn(one.log, one.held or pivoting.held_castor(robot, one.log)) for one in recordings]
        return pivoting.calibrate(robot, turns).applied()


class UMBmarkCorrection:
    """UMBmark squares, both ways, with the true pose at start and end (Borenstein and Feng); differential robots."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot with corrected wheel base and diameters; the diameters' mean stays."""
        squares = [(one.log, one.side) for one in recordings if one.side is not None]
        sides = sorted({side for _, side in squares})
        if len(sides) != 1:
            found = "none" if not sides else ", ".join(f"{side:g} m" for side in sides)
            raise InputError(f"needs UMBmark squares of one side; sides of these recordings: {found}")
        logs = [log for log, _ in squares]
        return corrected(robot, from_logs(robot, logs, [direction_of(log) for log in logs], sides[0]))


class MaximumLikelihood:
    """All parameters that the logs tell, by maximum likelihood of what the sensors reported."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot with the most likely parameters."""
        return maximum_likelihood.calibrate(robot, [one.log for one in recordings]).calibrated
