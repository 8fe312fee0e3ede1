"""WPILib's swerve odometry, by its own published wheel `robotpy-wpimath`: what robots of the FRC run.

``SwerveDriveOdometry.update(gyro_angle, module_positions)`` takes the module's angles as they are read last and the
distances since the call before. Its kinematics are the pseudo-inverse of v + omega J p_i = v_i over all modules. The
gyro's turn replaces that of the wheels; then the pose moves along the exponential of the twist, an arc. Without a gyro,
teams add up the turn of ``SwerveDriveKinematics.toTwist2d`` in its place, and so does this.

The wheel is an extra: ``pip install '.[peers]'`` in the project's folder. Where it is missing, both rows decline.
"""

import importlib
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.peers.modules import Modules
from estimators.protocol import Observation
from estimators.steps.castor_odometry import start
from estimators.steps.gyro import GyroTurns


class WPILibSwerve:
    """``SwerveDriveOdometry`` as it runs: with the modules' angles read last.

    When to use: to see what a robot with WPILib reports. First order in the sample period, which is 20 ms or less on
    FRC robots. No bias of the gyro is removed but the one that the robot file states: their gyros remove it
    themselves. Of split castors each is a module whose velocity is that of its pivot.
    """

    at = 1.0

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (3,); raises Declined for all but swerves of 2, 3, 4 or 6 modules, and without the wheel."""
        geometry, self._start = start(robot, pose)
        self._modules = Modules(geometry, self.at)
        self._gyro = GyroTurns(geometry.gyro, geometry.sample_period)
        self._geometry, kinematics = (_module(f"wpimath.{name}") for name in ("geometry", "kinematics"))
        n = geometry.n_castors
        if not hasattr(kinematics, f"SwerveDrive{n}Kinematics"):
            raise Declined(f"needs as many modules as WPILib has classes for, 2, 3, 4 or 6; the robot has {n}")
        places = [self._geometry.Translation2d(*map(float, pivot)) for pivot in geometry.pivot]
        self._kinematics = getattr(kinematics, f"SwerveDrive{n}Kinematics")(*places)
        self._position = kinematics.SwerveModulePosition
        self._distance, self._turned = np.zeros(n), 0.0
        x, y, psi = map(float, self._start)
        rotation = self._geometry.Rotation2d
        self._odometry = getattr(kinematics, f"SwerveDrive{n}Odometry")(
            self._kinematics,
            rotation(0.0),
            self._positions(self._distance, np.zeros(n)),
            self._geometry.Pose2d(x, y, rotation(psi)),
        )

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (3,)."""
        path = self._modules.read(observation).path
        length, angle = np.hypot(path[:, 0], path[:, 1]), np.arctan2(path[:, 1], path[:, 0])
        read = self._gyro.read(observation)
        wheels = self._kinematics.toTwist2d(self._positions(length, angle)).dtheta
        self._turned += float(read.turn) if read.known else wheels
        self._distance += length
        moved = self._odometry.update(self._geometry.Rotation2d(self._turned), self._positions(self._distance, angle))
        return np.array([moved.X(), moved.Y(), self._start[2] + self._turned])

    def _positions(self, distance: Array, angle: Array) -> tuple:
        return tuple(
            self._position(float(d), self._geometry.Rotation2d(float(a))) for d, a in zip(distance, angle, strict=True)
        )


class WPILibSwerveMidpoint(WPILibSwerve):
    """The same with the modules' angles half-way between samples, so that its error is of second order."""

    at = 0.5


def _module(name: str) -> ModuleType:
    """Return a module of WPILib; raises Declined where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise Declined(
            "needs WPILib's wheel robotpy-wpimath, which is not installed; pip install robotpy-wpimath"
        ) from None


ESTIMATORS = {"wpilib-swerve": WPILibSwerve, "wpilib-swerve-midpoint": WPILibSwerveMidpoint}
