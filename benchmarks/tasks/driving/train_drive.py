"""What trains truly do when they are driven in physics, and the logs that their sensors make of it.

As `drive` for robots: a drive holds the true motion alone, so that the same drive gives the log that estimators get,
and the undisturbed one that the oracle follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.controllers import TrainDriver
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.paths import TrainPath
from castor_envs.physics.train_world import TrainWorld
from castor_envs.sensors.encoders import Encoders
from castor_envs.sensors.posture import PostureSensors, curvature_at_gauges, sensed
from castor_envs.vehicles.train import TrainDescription


@dataclass(frozen=True, eq=False)
class TrainDrive:
    """What truly happened: K samples of time t (K,), s, and the axles' poses (K, 3N), front first.

    wheel (K, 2N): true angles, unwrapped, rad. joints: of each frame the angles (K, links) of its joints, rad. command
    (K, 2N), rad/s: of the period that begins.
    """

    t: Array
    pose: Array
    wheel: Array
    joints: tuple[Array, ...]
    command: Array

    def at(self, t: Array) -> "TrainDrive":
        """Return the drive at other times t (M,), s, within it; motion between samples is taken as even."""

        def between(values: Array) -> Array:
            return np.stack([np.interp(t, self.t, column) for column in values.T], axis=-1)

        held = np.searchsorted(self.t, t, side="right") - 1
        joints = tuple(between(angles) for angles in self.joints)
        return TrainDrive(t, between(self.pose), between(self.wheel), joints, self.command[held])


def drive_train(
    train: TrainDescription, described: TrainDescription, path: TrainPath, random: np.random.Generator
) -> TrainDrive:
    """Return a drive along a path, from rest and straight, its front axle at the origin.

    described: the train as its driver knows it, who hears the true train's relative posture sensors.
    """
    world, driver, sensors = TrainWorld(train), TrainDriver(described, path), PostureSensors(train, random)
    rows = int(np.ceil(path.duration / train.sample_period)) + 1
    pose, wheel = np.zeros((rows, 3 * train.n_axles)), np.zeros((rows, 2 * train.n_axles))
    command, joints = np.zeros_like(wheel), []
    for k in range(rows):
        pose[k], wheel[k] = world.poses.ravel(), world.wheel_angles
        joints.append(world.joint_angles)
        if k < rows - 1:
            command[k] = driver.commands(world.time, *sensors.read(joints[k], world.time))
            world.advance(command[k])
    t = np.arange(rows) * np.float64(train.sample_period)
    return TrainDrive(t, pose, wheel, tuple(np.array(angles) for angles in zip(*joints, strict=True)), command)


def recorded_train(train: TrainDescription, true: TrainDrive, random: np.random.Generator) -> Log:
    """Return the log of a drive: encoders' phases and gauges' offsets and noise are drawn, the truth is the reference.

    train: the true one.
    """
    return Log(
        t=true.t,
        wheel=_counts(train, true.wheel, random),
        pivot=np.zeros((len(true.t), 0)),
        command=true.command,
        reference=true.pose,
        rps=np.concatenate(_postures(train, true, random), axis=-1),
    )


def _counts(train: TrainDescription, wheel: Array, random: np.random.Generator) -> Array:
    """Return the counts (K, 2N) of wheel encoders at angles (K, 2N), rad."""
    built = [Geometry.of(module) for module in train.modules]
    encoders = [Encoders(geometry, Encoders.random_phase(geometry, random)) for geometry in built]
    return np.concatenate([of.wheel(wheel[:, 2 * i : 2 * i + 2]) for i, of in enumerate(encoders)], axis=-1)


def _postures(train: TrainDescription, true: TrainDrive, random: np.random.Generator) -> Sequence[Array]:
    """Return each frame's readings (K, 3), front frame first."""
    readings = []
    for frame, angles in zip(train.frames, true.joints, strict=True):
        curvature = curvature_at_gauges(frame, angles)
        offset = frame.gauge_offset * random.standard_normal(curvature.shape[1])
        noise = frame.gauge_noise * random.standard_normal(curvature.shape)
        readings.append(sensed(frame, curvature, offset + noise, true.t))
    return readings
