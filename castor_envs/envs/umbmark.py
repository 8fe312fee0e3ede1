"""castor/UMBmark-v0: estimate the pose of a robot that drives the square of UMBmark."""

from os import PathLike
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from castor_envs.envs.actions import finite
from castor_envs.envs.base import RobotEnv
from castor_envs.envs.driving.reward import tracking_error
from castor_envs.floor import Floor
from castor_envs.motion.controllers import Commands, KinematicController
from castor_envs.motion.mobility import check_fast_enough
from castor_envs.motion.trajectories import Corners, Direction, umbmark
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.robot import RobotDescription

MARGIN = 2.0  # m around the square that estimates may use


class UMBmarkEnv(RobotEnv):
    """The agent is the estimator: a scripted driver runs a square, the agent says where the robot is.

    ## Description
    The University of Michigan Benchmark (Borenstein and Feng 1994): a robot drives a square in one
    direction, back to where it began, and its odometry is judged by the error at the end. The driver is Doebbler's
    kinematics-based controller, open loop; wheels slip and floors have bumps, so the robot itself does not return
    exactly. The pose at the start is (0, 0, 0).

    ## Action Space
    `Box(3,)`, float64: the estimate of the pose after the newest observation.

    | Num | Action  | Min              | Max           | Unit |
    |-----|---------|------------------|---------------|------|
    | 0   | x       | -(side + 2)      | side + 2      | m    |
    | 1   | y       | -(side + 2)      | side + 2      | m    |
    | 2   | psi     | -8 pi            | 8 pi          | rad, unwrapped |

    ## Observation Space
    `Dict` of 1-D boxes, float64; never truth.

    | Key     | Shape            | Content                                                             |
    |---------|------------------|---------------------------------------------------------------------|
    | `wheel` | (driven wheels,) | increments of the wheel encoders' counts since the last observation |
    | `pivot` | (pivot encoders,)| absolute counts of the pivot encoders, in [0, counts a turn)        |
    | `time`  | (1,)             | s since the start                                                   |
    | `gyro`  | (1,)             | yaw rate, rad/s; only if the robot has a gyro                       |

    ## Rewards
    Minus the growth of the estimate's position error (m) since the last action: an episode's return is
    minus the error at its end.

    ## Starting State
    At rest at the origin, castors trailing for the first side. The encoders' phases are random.

    ## Episode End
    Terminates when the estimate for the last observation, after the square, has been given.

    ## Information
    `pose` (3,): the truth. `position_error` (m), `heading_error` (rad, wrapped): sizes, of the last action.
    `command`, `steering_command`: what the driver commanded in the period that led to this observation, rad/s.

    ## Arguments
    - `robot`: a preset's name, the path of a robot file, or a `RobotDescription`; `env.unwrapped.robot` is
      what an estimator may know
    - `direction`: "ccw" or "cw"; `corners`: "turn", "fixed" (heading) or "rounded"
    - `side` (m), `speed` (m/s), `acceleration` (m/s2), `turn_speed` (rad/s), `turn_acceleration` (rad/s2); speeds that
      the wheels' motors do not reach are refused with the largest ones possible
    - `floor`: a `Floor`, "slippery", or the path of a floor file

    ## Version History
    * v0: first version
    """

    ID = "castor/UMBmark-v0"

    def __init__(
        self,
        robot: RobotDescription | str | PathLike[str] = "asoc-prototype",
        *,
        direction: Direction = "ccw",
        corners: Corners = "turn",
        side: float = 1.5,
        speed: float = 0.25,
        acceleration: float = 0.5,
        turn_speed: float = np.pi / 4,
        turn_acceleration: float = np.pi / 2,
        floor: Floor | str | PathLike[str] | None = None,
        render_mode: str | None = None,
    ) -> None:
        square = umbmark(
            direction,
            corners,
            side=side,
            speed=speed,
            acceleration=acceleration,
            turn_speed=turn_speed,
            turn_acceleration=turn_acceleration,
        )
        super().__init__(robot, square, floor, render_mode)
        check_fast_enough(self.robot, square)
        self._controller = KinematicController(self.robot)
        limits = np.array([side + MARGIN, side + MARGIN, 8 * np.pi])
        self.action_space = spaces.Box(-limits, limits, dtype=np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the robot at the start."""
        observation = self._start(seed, options)
        self._error = 0.0
        self._off: NDArray[np.float64] | None = None
        self._show()
        return observation, self._info(self._no_commands, 0.0)

    def step(self, action: NDArray[np.float64]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take the estimate for the newest observation, score it, and drive on for one sample period."""
        self._need_going()
        estimate, pose = finite(action, (3,), "action (the estimate x, y, psi)"), self.sensed.pose
        self._off = estimate - pose
        error, heading_error = map(float, tracking_error(pose, estimate))
        reward, self._error = self._error - error, error

        commands = self._no_commands
        terminated = self._over = self.sample == self.samples
        if not terminated:
            middle = (self.sample + 0.5) * self.robot.sample_period
            twist = self.trajectory.twist_at(middle)
            commands = self._controller.commands(self.sensed.measured_castor_angles(), twist)
            self.sensed.advance(commands)
            self.sample += 1
        self._show()
        return self.readings, reward, terminated, False, self._info(commands, heading_error)

    def _info(self, commands: Commands, heading_error: float) -> dict[str, Any]:
        return {
            "pose": self.sensed.pose,
            "position_error": self._error,
            "heading_error": heading_error,
            "command": commands.wheel,
            "steering_command": commands.steering,
        }

    def shown_estimate(self) -> ArrayLike | None:
        """Return the last estimate, moved along."""
        # The estimate is one sample older than the robot that is drawn: it is moved along, so that its error shows.
        return None if self._off is None else self.sensed.pose + self._off
