"""What the environments share: one sensed robot that follows a trajectory, and its pictures."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.envs.drawn_env import DrawnEnv
from castor_envs.envs.sensed_robot import Observation, SensedRobot
from castor_envs.errors import InputError
from castor_envs.floor import Floor, load_floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.kinematics import Geometry
from castor_envs.motion.controllers import Commands, trailing_angles
from castor_envs.motion.trajectories import Trajectory
from castor_envs.rendering import Renderer
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.robot import RobotDescription


class RobotEnv(DrawnEnv):
    """A sensed robot, a trajectory that starts at the origin, and rendering; subclasses say what the agent does."""

    def __init__(
        self,
        robot: RobotDescription | str,
        trajectory: Trajectory,
        floor: Floor | str | None,
        render_mode: str | None,
        held: int | None = None,
    ) -> None:
        floor = load_floor(floor)
        if not isinstance(trajectory, Trajectory):
            raise InputError(f"trajectory must be a Trajectory or the name of one, got {type(trajectory).__name__}")
        self._sensed = SensedRobot(load_robot(robot), floor, held)
        self.robot = self._sensed.described
        self.real_robot = self._sensed.robot  # with its effects: for recorders and tests, never for estimators
        self.trajectory = trajectory
        self._samples = int(np.ceil(trajectory.duration / self.robot.sample_period - 1e-9))
        check_drivable(self.robot, trajectory)
        self.observation_space = self._sensed.observation_space(trajectory.duration)

        fps = self._set_render_mode(render_mode, self.robot.sample_period)
        if render_mode is not None:
            path = self._path = trajectory.at(np.linspace(0.0, trajectory.duration, 400))[0]
            low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
            margin = 0.6 + max(np.hypot(*castor.pivot) for castor in self.robot.castors)
            arena = (low[0] - margin, high[0] + margin, low[1] - margin, high[1] + margin)
            self._renderer = Renderer(self.robot, floor, render_mode, fps, arena=arena)  # pyright: ignore[reportArgumentType]

    def _start(self, seed: int | None) -> Observation:
        """Seed, and put the robot at rest at the origin, castors trailing for the first leg."""
        super().reset(seed=seed)
        first = self.trajectory.runs[0].legs[0].motion
        self._sensed.reset(self.np_random, trailing_angles(Geometry.of(self.robot), first))
        self._sample = 0
        self._forget_picture()
        return self._sensed.observation

    @property
    def _no_commands(self) -> Commands:
        return Commands(np.zeros(len(self.robot.driven_wheels)), np.zeros(len(self.robot.driven_castors)))

    def _reference(self) -> Array:
        """Return where the trajectory is now, (3,)."""
        return self.trajectory.at(self._sample * self.robot.sample_period)[0]

    def _draw(self) -> Any:
        if self._renderer is None:
            return None
        world = self._sensed.world
        return self._renderer.draw(
            world.pose,
            world.castor_angles,
            estimate=self._drawn_estimate(),
            reference=self._path,
            time=world.time,
            sliding=self._sensed.sliding(),
        )

    def _drawn_estimate(self) -> ArrayLike | None:
        """Return the estimate to draw, (3,), if the agent makes one."""
        return None


def check_drivable(robot: RobotDescription, trajectory: Trajectory) -> None:
    """Raise InputError if a leg of the trajectory would make a fixed castor of the robot slip sideways."""
    geometry = Geometry.of(robot)
    for run in trajectory.runs:
        for leg in run.legs:
            slip = geometry.side_slip_of_fixed(np.array(leg.motion))
            if np.any(np.abs(slip) > 1e-9):
                castor = int(np.flatnonzero(np.abs(slip) > 1e-9)[0]) + 1
                raise InputError(
                    f"robot {robot.name!r} cannot drive the {trajectory.name}: its fixed castor {castor} would slip "
                    "sideways; choose other corners or another trajectory"
                )
