"""What the environments share: a sensed vehicle that is to follow a course, and its pictures."""

from os import PathLike
from typing import Any, ClassVar, Generic, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import ArrayLike, NDArray

from castor_envs.envs.course import Course, RobotCourse, TrainCourse
from castor_envs.envs.sensed import SensedRobot, SensedTrain
from castor_envs.errors import InputError, shortened
from castor_envs.floor import Floor, load_floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import Commands, trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import check_drivable
from castor_envs.motion.paths import LONGEST_RANDOM, SPEED, TrainPath, axles_behind, named_path
from castor_envs.motion.trajectories import Trajectory
from castor_envs.rendering import Renderer
from castor_envs.sensors.observation import Observation, copied
from castor_envs.vehicles.load import Vehicle, load_robot, load_train
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

Sensed = TypeVar("Sensed", SensedRobot, SensedTrain)

OF_WRAPPERS = {"minari_autoseed"}
"""Options of `reset` that wrappers read and hand on."""

MOST_SAMPLES = 1_000_000  # of an episode: 14 hours at 50 ms; all of them are looked at before the first one

VIEW_MARGIN = 0.6  # m of floor shown around the course and the robot on it


class VehicleEnv(gym.Env[Any, NDArray[Any]], Generic[Sensed]):
    """A sensed vehicle, a course, and pictures. Environments say what the agent does, and under which ID.

    vehicle: as estimators may know it. sensed: it and its sensors. course: what is followed. sample: how many sample
    periods of it have passed. samples: how many it takes. Before the first `reset` there is no episode: ResetNeeded. A
    step after the end of one raises InputError.
    """

    ID: ClassVar[str]
    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's)

    def __init__(self, sensed: Sensed, course: Course, longest: float, render_mode: str | None, margin: float) -> None:
        """Take a vehicle and a course. longest: duration of any episode's course, s. margin: m shown around it."""
        self.sensed, self.course, self._margin = sensed, course, margin
        self.vehicle: Vehicle = sensed.described
        self._longest, self.observation_space = longest, sensed.observation_space(longest)
        self.metadata = {**self.metadata, "render_fps": max(1, round(1 / self.vehicle.sample_period))}
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode must be None, 'human' or 'rgb_array', got {render_mode!r}")
        self.render_mode = render_mode
        self._renderer: Renderer | None = None
        self._began = self._over = False

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_renderer": None}  # windows are not copied: a copy opens its own

    def reference(self, t: ArrayLike, pose: Array) -> Array:
        """Return what a tracker reports, in rows of time t (K,), of true poses (K, 3) or (K, 3N): for recorders."""
        return self.sensed.reference(t, pose)

    @property
    def readings(self) -> Observation:
        """What the sensors say now, whatever the agent is shown: a copy, as all that is handed out."""
        self._need_reset("readings")
        return copied(self.sensed.observation)

    @property
    def longest_episode(self) -> float:
        """How long this episode is unless it ends early, s; where the agent drives, the largest return of it."""
        self._need_reset("longest_episode")
        return self.samples * self.vehicle.sample_period

    def _need_reset(self, what: str) -> None:
        """Raise ResetNeeded if no episode has begun. what: was asked for."""
        if not self._began:
            raise ResetNeeded(f"{what} needs an episode that has begun; call env.reset() first")

    def _need_going(self) -> None:
        """Raise ResetNeeded if no episode has begun, InputError if it has ended."""
        self._need_reset("a step")
        if self._over:
            raise InputError("a step needs an episode that goes on, and this one has ended; call env.reset()")

    def _start(self, seed: int | None, options: dict[str, Any] | None) -> Observation:
        """Seed, and put the vehicle at rest at the start of the course; raises InputError for any option."""
        if not isinstance(options, dict | None):
            raise InputError(f"options must be a dictionary or None, got {shortened(repr(options))}")
        for name in sorted((options or {}).keys() - OF_WRAPPERS, key=repr)[:1]:
            raise InputError(
                f"reset has no option {name!r}; known: 'reset_mask', of vectors only; robot, course and floor are "
                "given to gymnasium.make"
            )
        super().reset(seed=seed)
        course = self._next_course()
        self.samples = int(np.ceil(course.duration / self.vehicle.sample_period - 1e-9))
        self._put_at_start()
        self.sample, self._began, self._over = 0, True, False
        if course is not self.course:
            self.course = course
            self.close()
        if self._renderer is not None:
            self._renderer.reset()
        return self.readings

    def _next_course(self) -> Course:
        """Return the course of the episode that begins."""
        return self.course

    def _put_at_start(self) -> None:
        """Reset the sensed vehicle to where its course starts."""
        raise NotImplementedError

    def shown_estimate(self) -> ArrayLike | None:
        """Return the estimate to draw, (3,) or (N, 3), if the agent makes one."""
        return None

    def render(self) -> Any:
        """Return a picture of the newest state and what the agent makes of it, or None in human mode."""
        return self._draw() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _show(self) -> None:
        """In human mode, draw the newest state."""
        if self.render_mode == "human":
            self._draw()

    def _started_renderer(self) -> Renderer:
        """Return a renderer of as much floor as the course needs: made when it is needed, for most episodes of learning
        are never drawn."""
        self._line = self.course.line()
        low, high = self._line[:, :2].min(axis=0) - self._margin, self._line[:, :2].max(axis=0) + self._margin
        arena = (low[0], high[0], low[1], high[1])
        fps = self.metadata["render_fps"]
        mode: Any = self.render_mode
        return Renderer(self.vehicle, self.sensed.floor, mode, fps, arena=arena)

    def _draw(self) -> Any:
        self._need_reset("a picture")
        self._renderer = self._renderer or self._started_renderer()
        return self._renderer.draw(
            self.sensed.pose,
            self.sensed.shape,
            estimate=self.shown_estimate(),
            target=self._line,
            time=self.sensed.world.time,
            sliding=self.sensed.sliding(),
        )


class RobotEnv(VehicleEnv[SensedRobot]):
    """A robot that follows a trajectory: at rest at the origin first, its castors trailing for the first leg."""

    def __init__(
        self,
        robot: RobotDescription | str | PathLike[str],
        trajectory: Trajectory,
        floor: Floor | str | PathLike[str] | None,
        render_mode: str | None,
        held: int | None = None,
        longest: float | None = None,
    ) -> None:
        """Take a robot and a trajectory. longest: duration of any episode's trajectory, s, if they change."""
        floor = load_floor(floor)
        if not isinstance(trajectory, Trajectory):
            raise InputError(f"trajectory must be a Trajectory or the name of one, got {type(trajectory).__name__}")
        if any(trajectory.start):
            raise InputError(
                f"trajectory {trajectory.name!r} starts at {trajectory.start}, and robots of environments at the "
                "origin; leave start out"
            )
        sensed = SensedRobot(load_robot(robot), floor, held)
        if (longest or trajectory.duration) > MOST_SAMPLES * sensed.described.sample_period:
            raise InputError(
                f"trajectory {trajectory.name!r} takes {trajectory.duration:.3g} s, more than {MOST_SAMPLES:,} sample "
                "periods; choose a shorter or a faster one"
            )
        self.robot, self.trajectory = sensed.described, trajectory
        check_drivable(self.robot, trajectory)
        margin = VIEW_MARGIN + max(np.hypot(*castor.pivot) for castor in self.robot.castors)
        super().__init__(sensed, RobotCourse(trajectory), longest or trajectory.duration, render_mode, margin)

    def _put_at_start(self) -> None:
        first = self.trajectory.runs[0].legs[0].motion
        self.sensed.reset(self.np_random, trailing_angles(Geometry.of(self.robot), first))

    @property
    def _no_commands(self) -> Commands:
        return Commands(np.zeros(len(self.robot.driven_wheels)), np.zeros(len(self.robot.driven_castors)))


class TrainEnv(VehicleEnv[SensedTrain]):
    """A train whose axles follow a path, each a frame's length behind the next: at rest and straight first."""

    def __init__(
        self,
        train: TrainDescription | str | PathLike[str],
        path: TrainPath | str,
        floor: Floor | str | PathLike[str] | None,
        render_mode: str | None,
    ) -> None:
        floor = load_floor(floor)
        sensed = SensedTrain(load_train(train), floor)
        self.train = sensed.described
        self._behind = axles_behind([frame.length for frame in self.train.frames])
        self._given_path = path
        self.path = named_path(path, np.random.default_rng(0))  # a random one is drawn anew by `reset`
        longest = self.path.duration if path != "random" else LONGEST_RANDOM / SPEED + 2.0
        super().__init__(sensed, TrainCourse(self.path, self._behind), longest, render_mode, VIEW_MARGIN)

    def _next_course(self) -> Course:
        if self._given_path != "random":
            return self.course
        self.path = named_path(self._given_path, self.np_random)
        return TrainCourse(self.path, self._behind)

    def _put_at_start(self) -> None:
        self.sensed.reset(self.np_random)
