"""What the members of a vector environment do and see in one sample period, as arrays over the members.

The arithmetic is that of `castor_envs.envs.sensed` and of the two worlds, on arrays with one row a member.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from castor_envs.envs.sensed import SensedRobot, SensedTrain
from castor_envs.geometry.arrays import Array, vectors
from castor_envs.physics.fleet import Fleet
from castor_envs.physics.solver import MOTOR
from castor_envs.physics.stepper import Drive
from castor_envs.sensors.encoders import Encoders
from castor_envs.sensors.observation import Observation, observation
from castor_envs.sensors.posture import PostureSensors


class Lanes:
    """The sensed vehicles of a vector's B members, of one layout, moved as a fleet.

    Members keep their own states: `load` takes a member's after its reset, `give_back` gives it to the member.
    """

    def __init__(self, members: Sequence[SensedRobot] | Sequence[SensedTrain], threads: int | None) -> None:
        self.members = members
        self.fleet = Fleet([member.world.simulation for member in members], threads)
        self.encoders = Encoders.stacked([member.encoders for member in members])
        self.counts = np.zeros(self.encoders.shape)

    def load(self, lane: int) -> None:
        """Take the state of a member."""
        member = self.members[lane]
        self.fleet.load(lane)
        self.encoders.take(lane, member.encoders)
        self.counts[lane] = member.counts

    def give_back(self, lane: int, seen: Observation) -> None:
        """Give a member its state, and its newest observation."""
        member = self.members[lane]
        self.fleet.give_back(lane)
        member.counts, member.observation = self.counts[lane].copy(), seen

    def _increments(self) -> Array:
        """Return how far the wheel encoders (B, driven wheels) have counted since they were read last."""
        counts = self.encoders.wheel(self.fleet.wheel_angles())
        before, self.counts = self.counts, counts
        return counts - before

    def _poses(self, bodies: Sequence[int], centers: Array) -> Array:
        """Return the poses (B, k, 3) of the frames of bodies with centres of mass (B, k, 2) in them."""
        motion = self.fleet.motion[:, bodies]
        c, s = np.cos(motion[..., 2]), np.sin(motion[..., 2])
        right, up = centers[..., 0], centers[..., 1]
        x, y = motion[..., 0] - (c * right - s * up), motion[..., 1] - (s * right + c * up)
        return vectors(x, y, motion[..., 2])


class RobotLanes(Lanes):
    """Robots."""

    members: Sequence[SensedRobot]

    def __init__(self, members: Sequence[SensedRobot], threads: int | None) -> None:
        super().__init__(members, threads)
        worlds = [member.world for member in members]
        first, robots = worlds[0], [world.robot for world in worlds]
        self._driven, self._castor_bodies = first.driven_wheels, first.castor_bodies
        self._held = self._driven[first.held]
        self._fixed, self._has_gyro = first.geometry.fixed, robots[0].gyro is not None
        self._angle = np.stack([world.geometry.angle for world in worlds])
        self._centers = np.stack([world.center for world in worlds])[:, None]
        self._fastest = np.array([[robot.max_wheel_speed] for robot in robots])
        self._steering_speed = np.array([[robot.max_steering_speed] for robot in robots])
        dt = np.array([[world.dt] for world in worlds])
        self._steering_impulse = np.array([[robot.max_steering_torque] for robot in robots]) * dt
        self._motors = np.flatnonzero(first.simulation.joints["kind"] == MOTOR)

    def advance(self, wheels: Array, castors: Array, drive: Drive) -> None:
        """Drive for one sample period: commands (B, driven wheels) and (B, driven castors), as for `RobotWorld`."""
        limit = self._fastest if drive == "servo" else np.ones_like(self._fastest)
        self.fleet.command(self._driven, wheels, limit, drive)
        if self._held.size:
            blocked = np.zeros((len(self.members), self._held.size))
            self.fleet.command(self._held, blocked, np.ones_like(self._fastest), "servo")
        if self._motors.size:
            most = self._steering_speed
            rates = np.minimum(np.maximum(castors, -most), most)
            self.fleet.steer(self._motors, rates, np.broadcast_to(self._steering_impulse, rates.shape))
        self.fleet.advance()

    def sense(self, going: NDArray[np.bool_]) -> tuple[Observation, Array]:
        """Return what all sensors say, with leading axis B, and the true poses (B, 3). going: who is read at all."""
        angle = self.fleet.motion[..., 2]
        theta = np.where(self._fixed, self._angle, angle[:, self._castor_bodies] - angle[:, :1])
        yaw_rate = self.fleet.motion[:, 0, 5].copy() if self._has_gyro else None
        for lane in np.flatnonzero(going).tolist():
            if yaw_rate is not None and (gyro := self.members[lane].gyro) is not None:
                yaw_rate[lane] = gyro.read(float(self.fleet.time[lane]), float(yaw_rate[lane]))
        seen = observation(self._increments(), self.fleet.time, pivot=self.encoders.pivot(theta), gyro=yaw_rate)
        return seen, self._poses([0], self._centers)[:, 0]


class TrainLanes(Lanes):
    """Trains."""

    members: Sequence[SensedTrain]

    def __init__(self, members: Sequence[SensedTrain], threads: int | None) -> None:
        super().__init__(members, threads)
        worlds = [member.world for member in members]
        self._axles = list(range(worlds[0].train.n_axles))
        self._centers = np.stack([world.centers for world in worlds])
        self._fastest = np.stack([world.limits for world in worlds])
        self._frame_bodies = worlds[0].frame_bodies
        self._sensors = PostureSensors.stacked([world.train for world in worlds])

    def load(self, lane: int) -> None:
        """Take the state of a member."""
        super().load(lane)
        self._sensors.take(lane, self.members[lane].sensors)

    def give_back(self, lane: int, seen: Observation) -> None:
        """Give a member its state, and its newest observation."""
        super().give_back(lane, seen)
        self._sensors.give_back(lane, self.members[lane].sensors)

    def advance(self, wheels: Array, castors: Array, drive: Drive) -> None:
        """Drive for one sample period: commands (B, 2N), as for `TrainWorld`; there are no castors to steer."""
        limit = self._fastest if drive == "servo" else np.ones_like(self._fastest)
        self.fleet.command(np.arange(wheels.shape[1]), wheels, limit, drive)
        self.fleet.advance()

    def sense(self, going: NDArray[np.bool_]) -> tuple[Observation, Array]:
        """Return what all sensors say, with leading axis B, and the true poses (B, N, 3). going: who is read at all."""
        angle = self.fleet.motion[..., 2]
        joints = [bent[:, 1:] - bent[:, :-1] for bent in (angle[:, bodies] for bodies in self._frame_bodies)]
        poses, age = self._sensors.read(joints, self.fleet.time, going)
        rps = poses.reshape(len(self.members), -1)
        seen = observation(self._increments(), self.fleet.time, rps=rps, rps_age=age)
        return seen, self._poses(self._axles, self._centers)
