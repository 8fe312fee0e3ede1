"""What robots truly do when they are driven in physics, and the logs that their sensors make of it.

A drive holds true motion alone. Between it and a log stand the encoders, and what disturbs their readings
(`disturbances`): so that the same drive gives the log that estimators get, and the undisturbed one that the oracle
follows.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.floor import Floor
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.controllers import KinematicController, trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import Trajectory
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.sensors.gyro import GyroSensor
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True, eq=False)
class Drive:
    """What truly happened: K samples of time t (K,), s, and pose (K, 3).

    wheel (K, w), castor (K, n): true angles, unwrapped, rad. yaw_rate (K,), rad/s. command (K, driven wheels) and
    steering_command (K, driven castors), rad/s: of the period that begins.
    """

    t: Array
    pose: Array
    wheel: Array
    castor: Array
    yaw_rate: Array
    command: Array
    steering_command: Array

    def at(self, t: Array) -> "Drive":
        """Return the drive at other times t (M,), s, within it; motion between samples is taken as even."""

        def between(values: Array) -> Array:
            return np.stack([np.interp(t, self.t, column) for column in values.T], axis=-1)

        held = np.searchsorted(self.t, t, side="right") - 1
        return Drive(
            t,
            pose=between(self.pose),
            wheel=between(self.wheel),
            castor=between(self.castor),
            yaw_rate=np.interp(t, self.t, self.yaw_rate),
            command=self.command[held],
            steering_command=self.steering_command[held],
        )


def drive(
    robot: RobotDescription,
    described: RobotDescription,
    trajectory: Trajectory,
    duration: float,
    random: np.random.Generator,
    *,
    floor: Floor | None = None,
    castor_angle: Array | None = None,
) -> Drive:
    """Return `duration` s of a robot that follows a trajectory open loop, from rest at the origin.

    described: the robot as the controller knows it; it hears the true robot's pivot encoders. castor_angle (n,): at the
    start, rad; None: trailing for the first leg, off by up to 0.5 rad. What lies beyond `duration` is not driven, and
    where the trajectory ends before, the robot stands.
    """
    built, known, period = Geometry.of(robot), Geometry.of(described), robot.sample_period
    if castor_angle is None:
        trailing = trailing_angles(known, trajectory.runs[0].legs[0].motion)
        castor_angle = se2.wrap(trailing + random.uniform(-0.5, 0.5, known.n_castors))
    world = RobotWorld(robot, floor or Floor(), castor_angles=castor_angle)
    encoders, controller = Encoders(built, Encoders.random_phase(built, random)), KinematicController(described)
    rows = round(duration / period) + 1
    t = np.arange(rows) * np.float64(period)
    pose, yaw_rate = np.zeros((rows, 3)), np.zeros(rows)
    wheel, castor = np.zeros((rows, len(robot.wheels))), np.zeros((rows, built.n_castors))
    command = np.zeros((rows, len(robot.driven_wheels)))
    steering = np.zeros((rows, len(robot.driven_castors)))
    for k in range(rows):
        pose[k], yaw_rate[k], wheel[k], castor[k] = world.pose, world.twist[2], world.wheel_angles, world.castor_angles
        if k < rows - 1:
            heard = castor_angles(known, encoders.pivot(castor[k]))
            command[k], steering[k] = controller.commands(heard, trajectory.twist_at(float(t[k] + period / 2)))
            world.advance(command[k], steering[k])
    return Drive(t, pose, wheel, castor, yaw_rate, command, steering)


def joined(drives: Sequence[Drive]) -> Drive:
    """Return drives one after another: each begins where the last one ended, at rest, in the sample of its end."""
    whole = drives[0]
    for following in drives[1:]:
        whole = Drive(
            t=np.concatenate([whole.t, whole.t[-1] + following.t[1:]]),
            pose=np.concatenate([whole.pose, se2.compose(whole.pose[-1], following.pose[1:])]),
            wheel=np.concatenate([whole.wheel, whole.wheel[-1] + following.wheel[1:]]),
            castor=np.concatenate([whole.castor, whole.castor[-1] - following.castor[0] + following.castor[1:]]),
            **{
                name: np.concatenate([getattr(whole, name)[:-1], getattr(following, name)])
                for name in ("yaw_rate", "command", "steering_command")
            },
        )
    return whole


def recorded(robot: RobotDescription, true: Drive, random: np.random.Generator) -> Log:
    """Return the log of a drive: counts of encoders whose phases are drawn, a gyro's readings, the truth as reference.

    robot: the true one. Its gyro's noise is drawn anew.
    """
    built = Geometry.of(robot)
    encoders = Encoders(built, Encoders.random_phase(built, random))
    gyro = GyroSensor.of(robot, random)
    return Log(
        t=true.t,
        wheel=encoders.wheel(true.wheel),
        pivot=encoders.pivot(true.castor),
        command=true.command,
        steering_command=true.steering_command if true.steering_command.shape[1] else None,
        reference=true.pose,
        gyro=None if gyro is None else gyro.readings(true.t, true.yaw_rate),
    )


def disturbed(true: Drive, wheel: Array, castor: Array | None = None) -> Drive:
    """Return a drive with other angles for encoders to read, wheel (K, w) and castor (K, n), rad; its motion stays."""
    return dataclasses.replace(true, wheel=wheel, castor=true.castor if castor is None else castor)
