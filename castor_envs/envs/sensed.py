"""A simulated robot or train as its sensors report it: what all environments share."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from castor_envs.effects.catalogue import reference, sensor_model_of
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import Commands
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.stepper import FASTEST, Drive
from castor_envs.physics.train_world import TrainWorld
from castor_envs.physics.tyre import OMNI
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.sensors.gyro import GyroSensor
from castor_envs.sensors.observation import Observation, observation
from castor_envs.sensors.posture import PostureSensors
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

FASTEST_YAW = 100.0  # rad/s: no reading of a gyro goes beyond
MOST_BENT = 100.0  # rad: no reading of a relative heading goes beyond


class SensedVehicle(ABC):
    """A vehicle in a world, seen through the encoders of its bodies: a robot is one body, a train one for each axle.

    vehicle: with its effects; `described` is what controllers and estimators may know. The state is made anew by the
    `reset` of subclasses. observation: the newest. held: which of the driven wheels (from 0) are blocked.
    """

    world: Any  # RobotWorld or TrainWorld
    described: Any  # RobotDescription or TrainDescription

    def __init__(
        self,
        vehicle: Vehicle,
        bodies: Sequence[RobotDescription],
        built: Sequence[RobotDescription],
        floor: Floor,
    ) -> None:
        self.vehicle, self.floor = vehicle, floor
        self.described = vehicle.as_described()
        self._bodies, self._built = bodies, [Geometry.of(body) for body in built]
        self.encoders = Encoders(self._built, 0.0)
        self.observation: Observation = {}
        self.held = np.empty(0, dtype=np.intp)

    @property
    @abstractmethod
    def pose(self) -> Array:
        """The true pose (3,) of a robot, or poses (N, 3) of a train's axles."""

    @property
    @abstractmethod
    def shape(self) -> Any:
        """What a picture needs beside the pose: castor angles (n,) of a robot, outlines of a train's frames."""

    @abstractmethod
    def reference(self, t: ArrayLike, pose: Array) -> Array:
        """Return what a tracker reports, in rows of time t (K,), of true poses (K, 3) or (K, 3N)."""

    @abstractmethod
    def _sense(self) -> None:
        """Read all sensors into `observation`."""

    @abstractmethod
    def _other_spaces(self, latest: float) -> dict[str, spaces.Box]:
        """Return the spaces of what is observed beside "wheel" and "time", which is `latest` (s) at most."""

    def _start_encoders(self, random: np.random.Generator) -> None:
        """Draw the phases of the wheel encoders."""
        self.encoders = self.encoders.started(random)
        self.models = [sensor_model_of(body) if body.effects else None for body in self._bodies]
        self.counts: Array | None = None

    def _read(self, wheels: Array, castors: Array) -> tuple[Array, Array]:
        """Return all wheel and castor angles, rad, with effects on sensors, before encoders round them."""
        if not any(self.models):
            return wheels, castors
        t, read, wheel, castor = np.array([self.world.time]), [], 0, 0
        for body, model in zip(self._bodies, self.models, strict=True):
            wheel_end, castor_end = wheel + len(body.wheels), castor + len(body.castors)
            angles = wheels[None, wheel:wheel_end], castors[None, castor:castor_end]
            read.append(angles if model is None else model(t, *angles))
            wheel, castor = wheel_end, castor_end
        return np.concatenate([part[0][0] for part in read]), np.concatenate([part[1][0] for part in read])

    def _increments(self, wheel_angles: Array) -> Array:
        """Return how far the wheel encoders have counted since they were read last."""
        counts = self.encoders.wheel(wheel_angles)
        before = counts if self.counts is None else self.counts
        self.counts = counts
        return counts - before

    @property
    def layout(self) -> tuple[object, ...]:
        """What vehicles must have in common, beside their bodies, to be moved and seen as one: what is driven, held and
        sensed."""
        of_bodies = [(body.driven_wheels, body.pivot_encoders, body.gyro is not None) for body in self._bodies]
        return *of_bodies, tuple(self.held.tolist())

    @property
    def steps_in_fleet(self) -> bool:
        """Whether many of it can be moved and seen as one: no body has effects of its own."""
        return not any(body.effects for body in self._bodies)

    def sliding(self) -> NDArray[np.bool_]:
        """Return which wheels (w,) slide: their force is at the friction limit."""
        wheels = self.world.wheels
        aside = np.where(wheels["grip"] == OMNI, wheels["roller"] * wheels["force_long"], wheels["force_lat"])
        force = np.hypot(wheels["force_long"], aside)
        return (wheels["limit"] > 0) & (force >= wheels["limit"] * (1 - 1e-9))

    def observation_space(self, duration: float) -> spaces.Space[Any]:
        """Return the space of observations in an episode of at most `duration` s."""
        period = self.vehicle.sample_period
        # A wheel that others push, or a slope, runs ahead of its own limit, and effects on encoders add to it.
        fastest = []
        for body, built in zip(self._bodies, self._built, strict=True):
            driven = np.array(body.driven_wheels)
            most = body.max_wheel_speed + FASTEST / np.minimum(built.radius[driven], 1.0)  # rad/s
            fastest.append(most * period * built.counts_per_rev[driven] / (2 * np.pi) + 1)
        fastest = np.concatenate(fastest)
        latest = duration + period
        return spaces.Dict(
            {
                "wheel": spaces.Box(-fastest, fastest, dtype=np.float64),
                "time": spaces.Box(0.0, latest, (1,), dtype=np.float64),
                **self._other_spaces(latest),
            }
        )


class SensedRobot(SensedVehicle):
    """A robot in a world, seen through its encoders (and gyro).

    held: the castor (from 1) whose wheels are blocked. sensed_angles: of wheels (w,) and castors (n,), rad, as effects
    on sensors change them, before encoders round them.
    """

    world: RobotWorld
    described: RobotDescription

    def __init__(self, robot: RobotDescription, floor: Floor, held: int | None = None) -> None:
        blind = [
            castor for castor in robot.castors if castor.steering != "fixed" and castor.pivot_counts_per_rev is None
        ]
        if blind:
            raise InputError(
                f"robot {robot.name!r}: the castor at {blind[0].pivot} turns but has no pivot encoder; "
                "give it pivot_counts_per_rev"
            )
        if not robot.driven_wheels:
            raise InputError(f"robot {robot.name!r} has no driven wheel; give one wheel counts_per_rev")
        self._robot = robot
        self.world = RobotWorld(robot, floor, held=held)  # refuses what cannot stand or be computed
        super().__init__(robot, (robot,), (robot.as_built(),), floor)
        self.held = self.world.held
        self._geometry = Geometry.of(self.described)

    def reset(self, random: np.random.Generator, theta: Array) -> None:
        """Put the robot at the origin, at rest, castors at theta (n,); encoder phases are drawn from `random`."""
        self._start_encoders(random)
        self.gyro = GyroSensor.of(self._robot, random)
        self.world.restart(theta)
        self._sense()

    def advance(self, commands: Commands, drive: Drive = "servo") -> None:
        """Drive for one sample period and read the sensors."""
        self.world.advance(commands.wheel, commands.steering, drive)
        self._sense()

    @property
    def pose(self) -> Array:
        """The true pose (3,)."""
        return self.world.pose

    @property
    def shape(self) -> Array:
        """The castor angles (n,), rad."""
        return self.world.castor_angles

    def reference(self, t: ArrayLike, pose: Array) -> Array:
        """Return what a tracker reports of true poses (K, 3): early, late or off where effects say so."""
        return reference(self._robot, t, pose)

    def _sense(self) -> None:
        world = self.world
        self.sensed_angles = self._read(world.wheel_angles, world.castor_angles)
        wheel, castor = self.sensed_angles
        yaw_rate = None if self.gyro is None else self.gyro.read(world.time, float(world.twist[2]))
        pivot = self.encoders.pivot(castor)
        self.observation = observation(self._increments(wheel), world.time, pivot=pivot, gyro=yaw_rate)

    def measured_castor_angles(self) -> Array:
        """Theta (n,) as the robot believes it to be, from its pivot encoders."""
        return castor_angles(self._geometry, self.observation["pivot"])

    def _other_spaces(self, latest: float) -> dict[str, spaces.Box]:
        turn = self._built[0].pivot_counts_per_rev[np.array(self._robot.pivot_encoders, dtype=np.intp)]
        most = np.where(turn == np.round(turn), turn - 1, turn)  # whole counts, wrapped at a turn that may not be whole
        pivot = spaces.Box(np.zeros_like(turn), most, dtype=np.float64)
        gyro = spaces.Box(-FASTEST_YAW, FASTEST_YAW, (1,), dtype=np.float64)
        return {"pivot": pivot} if self._robot.gyro is None else {"pivot": pivot, "gyro": gyro}


class SensedTrain(SensedVehicle):
    """A train in a world, seen through its wheel encoders and relative posture sensors."""

    world: TrainWorld
    described: TrainDescription

    def __init__(self, train: TrainDescription, floor: Floor) -> None:
        self._built_train = train.as_built()
        self.world = TrainWorld(train, floor)  # refuses what cannot stand or be computed
        super().__init__(train, train.modules, self._built_train.modules, floor)
        self._fixed = np.concatenate([built.angle for built in self._built])

    def reset(self, random: np.random.Generator) -> None:
        """Put the train straight, its front axle at the origin, at rest; draws encoder phases and gauge offsets."""
        self._start_encoders(random)
        self.sensors = PostureSensors(self._built_train, random)
        self.world.restart()
        self._sense()

    def advance(self, command: ArrayLike, drive: Drive = "servo") -> None:
        """Drive for one sample period and read the sensors; command (2N,) as for `TrainWorld.advance`."""
        self.world.advance(command, drive)
        self._sense()

    @property
    def pose(self) -> Array:
        """The true poses (N, 3) of the axles, front first."""
        return self.world.poses

    @property
    def shape(self) -> list[Array]:
        """The true outlines of the frames, polylines (k, 2), front first."""
        return self.world.frame_shapes

    def reference(self, t: ArrayLike, pose: Array) -> Array:
        """Return what a tracker reports of true poses (K, 3N): the truth, for no effect of a train disturbs it."""
        return pose

    def _sense(self) -> None:
        wheels, _ = self._read(self.world.wheel_angles, self._fixed)
        rps, age = self.sensors.read(self.world.joint_angles, self.world.time)
        self.observation = observation(self._increments(wheels), self.world.time, rps=rps.ravel(), rps_age=age)

    def _other_spaces(self, latest: float) -> dict[str, spaces.Box]:
        frames = self._built_train.frames
        longest = [1.001 * max(frame.length, frame.computed_length) for frame in frames]  # and rounding
        reach = np.concatenate([[length, length, MOST_BENT] for length in longest])
        return {
            "rps": spaces.Box(-reach, reach, dtype=np.float64),
            "rps_age": spaces.Box(0.0, latest, (len(frames),), dtype=np.float64),
        }
