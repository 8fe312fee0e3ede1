"""castor/ASOC-v0: drive a robot on castors along a trajectory."""

from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from castor_envs.envs.actions import finite
from castor_envs.envs.base import RobotEnv, check_control
from castor_envs.errors import InputError, did_you_mean
from castor_envs.floor import Floor
from castor_envs.logs.trajectory_files import read_drive
from castor_envs.motion.controllers import Commands
from castor_envs.motion.trajectories import Trajectory, figure_eight, umbmark
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.robot import RobotDescription

TRAJECTORIES = {"figure-eight": figure_eight, "square": umbmark}
LOST = 0.5  # m from the target at which an episode ends


class ASOCEnv(RobotEnv):
    """Drive a robot on active split-offset castors (or any other) along a trajectory, by its own sensors.

    ## Description
    The agent commands every motor once a sample period and is to follow a trajectory that it knows as a
    function of time. It sees encoders only, so it has to keep track of its pose itself. Wheels slip, floors have
    patches, cables and slope.

    ## Action Space
    `Box(-1, 1, (driven wheels + driven castors,))`, float32, wheels first, in the order of the robot
    file. With `control="speed"` a fraction of `max_wheel_speed` (a servo holds it) and of `max_steering_speed`; with
    `control="voltage"` wheels get this fraction of the full voltage: torque max_wheel_torque (u - speed /
    max_wheel_speed).

    ## Observation Space
    `Dict` of 1-D boxes, float64; never truth.

    | Key     | Shape            | Content                                                             |
    |---------|------------------|---------------------------------------------------------------------|
    | `wheel` | (driven wheels,) | increments of the wheel encoders' counts since the last observation |
    | `pivot` | (pivot encoders,)| absolute counts of the pivot encoders, in [0, counts a turn)        |
    | `time`  | (1,)             | s since the start                                                   |
    | `gyro`  | (1,)             | yaw rate, rad/s; only if the robot has a gyro                       |

    ## Rewards
    Minus the tracking error, times the sample period: the distance to the target (m) plus a quarter of
    a metre times the heading error's size (rad, wrapped).

    ## Starting State
    At rest at the origin, castors trailing for the first leg. The encoders' phases are random.

    ## Episode End
    Terminates when the robot is more than 0.5 m from the target; truncates at the trajectory's end.

    ## Information
    `pose` (3,): the truth. `target` (3,): the trajectory's pose now. `position_error` (m),
    `heading_error` (rad). `command`, `steering_command`: what the motors were told in the last period (rad/s; with
    voltage control the wheels' fraction).

    ## Arguments
    - `robot`: a preset's name, the path of a robot file, or a `RobotDescription`
    - `trajectory`: "figure-eight", "square", the path of a drive file (.csv), or a `Trajectory`
    - `control`: "speed" or "voltage"
    - `held`: the number (from 1) of a castor whose wheels are blocked, whatever they are commanded, as for
      calibration by pivoting about it (`castor_envs.motion.trajectories.pivoting`)
    - `floor`: a `Floor` or the path of a floor file

    ## Version History
    * v0: first version
    """

    ID = "castor/ASOC-v0"

    def __init__(
        self,
        robot: RobotDescription | str = "asoc-prototype",
        *,
        trajectory: Trajectory | str = "figure-eight",
        control: Literal["speed", "voltage"] = "speed",
        held: int | None = None,
        floor: Floor | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if isinstance(trajectory, str) and trajectory.lower().endswith(".csv"):
            chosen = read_drive(trajectory)
        elif isinstance(trajectory, str):
            if trajectory not in TRAJECTORIES:
                raise InputError(f"unknown trajectory {trajectory!r}{did_you_mean(trajectory, TRAJECTORIES)}")
            chosen = TRAJECTORIES[trajectory]()
        else:
            chosen = trajectory
        check_control(control)
        super().__init__(robot, chosen, floor, render_mode, held)
        self._control = control
        motors = len(self.robot.driven_wheels) + len(self.robot.driven_castors)
        self.action_space = spaces.Box(-1.0, 1.0, (motors,), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the robot at the start."""
        observation = self._start(seed)
        self._show()
        return observation, self._info(self._no_commands)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Command the motors for one sample period."""
        fraction = np.clip(finite(action, self.action_space.shape, "action (a number per motor)"), -1.0, 1.0)
        wheel, steering = np.split(fraction, [len(self.robot.driven_wheels)])
        steering = steering * self.robot.max_steering_speed
        if self._control == "speed":
            commands = Commands(wheel * self.robot.max_wheel_speed, steering)
            self._sensed.advance(commands, "servo")
        else:
            commands = Commands(wheel, steering)
            self._sensed.advance(commands, "voltage")
        self._sample += 1
        self._show()
        info = self._info(commands)
        reward = -self.robot.sample_period * (info["position_error"] + 0.25 * abs(info["heading_error"]))
        terminated = info["position_error"] > LOST
        truncated = self._sample >= self._samples
        return self._sensed.observation, reward, terminated, truncated, info

    def _info(self, commands: Commands) -> dict[str, Any]:
        pose, target = self._sensed.pose, self._target()
        away = target - pose
        return {
            "pose": pose,
            "target": target,
            "position_error": float(np.hypot(away[0], away[1])),
            "heading_error": float(np.arctan2(np.sin(away[2]), np.cos(away[2]))),
            "command": commands.wheel,
            "steering_command": commands.steering,
        }
