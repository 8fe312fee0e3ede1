"""castor/ASOC-v1: drive a robot on castors along a trajectory."""

from os import PathLike, fspath

import numpy as np

from castor_envs.envs.base import RobotEnv
from castor_envs.envs.course import Course, RobotCourse
from castor_envs.envs.driving.followers import RobotFollower
from castor_envs.envs.driving.tracking import Control, EstimatorClass, TrackingEnv
from castor_envs.envs.sensed import SensedRobot
from castor_envs.errors import InputError, did_you_mean
from castor_envs.floor import Floor
from castor_envs.logs.trajectory_files import read_drive
from castor_envs.motion.controllers import Commands
from castor_envs.motion.mobility import moves_sideways, turned_by_motors
from castor_envs.motion.trajectories import LONGEST_RANDOM, RANDOM, Trajectory, figure_eight, umbmark, wander
from castor_envs.physics.stepper import Drive
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.robot import RobotDescription

TRAJECTORIES = {"figure-eight": figure_eight, "square": umbmark}


class ASOCEnv(TrackingEnv[SensedRobot], RobotEnv):
    """Drive a robot on active split-offset castors (or any other) along a trajectory.

    ## Description
    The agent commands every motor once a sample period, and is to be where the trajectory is at that time. It sees its
    sensors and the reference from where it is: as an ideal tracker tells it, or as an estimator believes. Wheels slip,
    floors have patches, cables and slope.

    ## Action Space
    `Box(-1, 1)`, float32; motors are driven wheels first, then driven castors, in the order of the robot file.

    | `control`    | Shape     | What an action is                                                                  |
    |--------------|-----------|------------------------------------------------------------------------------------|
    | `"speed"`    | (motors,) | fractions of `max_wheel_speed` and `max_steering_speed`; a servo holds them        |
    | `"voltage"`  | (motors,) | of wheels, fractions of the full voltage; of castors, speeds as above              |
    | `"residual"` | (3,)      | what is added to the scripted driver's velocity                                    |

    At a voltage u the torque is max_wheel_torque (u - speed / max_wheel_speed). A residual adds up to 0.25 m/s ahead
    and to the left, and 0.5 rad/s of turning; robots that cannot move sideways have no second number, so (2,).

    ## Observation Space
    `Dict` of 1-D boxes, float64.

    | Key               | Shape             | Content                                                           |
    |-------------------|-------------------|-------------------------------------------------------------------|
    | `wheel`           | (driven wheels,)  | increments of the wheel encoders' counts since the last sample    |
    | `pivot`           | (pivot encoders,) | absolute counts of the pivot encoders, in [0, counts a turn)      |
    | `time`            | (1,)              | s since the start                                                 |
    | `gyro`            | (1,)              | yaw rate, rad/s; only if the robot has a gyro                     |
    | `reference`       | (12,)             | the trajectory's poses now and in 0.25, 0.5 and 1 s               |
    | `reference_twist` | (3,)              | its velocity in the middle of the coming period, in its own frame |
    | `goal`            | (3,)              | its last pose                                                     |

    Poses are as seen from the robot: x (m, ahead), y (m, left), psi (rad, wrapped); velocities in m/s and rad/s.

    With `scaled=True` one `Box(-5, 5)`, float32, with the same numbers divided by what is usual (within about [-1, 1]
    when driven well), and pivot counts as cosines and sines: `castor_envs.envs.driving.scaling`.

    ## Rewards
    The sample period (s) times how well the target is tracked: 1 on it, less in proportion to the distance and to a
    quarter of a metre for each radian of heading error, 0 where these are 0.5 m or more. A return is thus in [0,
    duration of the trajectory]; it is largest for perfect tracking, and an episode that ends early only loses.

    ## Starting State
    At rest at the origin, castors trailing for the first leg. The encoders' phases are random, and so is the
    trajectory, unless another one is chosen.

    ## Episode End
    Terminates when the robot is more than 0.5 m from the target; truncates at the trajectory's end.

    ## Information
    `pose` (3,): the truth. `target` (3,): the trajectory's pose now. `position_error` (m), `heading_error` (rad,
    wrapped): sizes. `command`, `steering_command`: what the motors were told in the last period (rad/s; with voltage
    control the wheels' fraction), 0 of wheels that are held.

    ## Arguments
    - `robot`: a preset's name, the path of a robot file, or a `RobotDescription`
    - `trajectory`: "random" (drawn for every episode; without turns for a robot whose motors cannot turn it, as on a
      single free castor), "figure-eight", "square", the path of a drive file (.csv), or a `Trajectory`
    - `control`: "speed", "voltage" or "residual"
    - `estimator`: a class of estimators or its name, such as "estimators.robots.cast:CAST", which tells the agent where
      it is; None: an ideal tracker does
    - `scaled`: whether observations are one vector of scaled numbers
    - `held`: the number (from 1) of a castor whose wheels are blocked, whatever they are commanded, as for
      calibration by pivoting about it (`castor_envs.motion.trajectories.pivoting`)
    - `floor`: a `Floor`, "slippery", or the path of a floor file

    `env.unwrapped.follower.action(observation)` is the scripted driver's action for an observation that is not scaled;
    `env.unwrapped.unscaled` is the newest one, whether or not observations are.

    ## Version History
    * v1: a reward that is never better for ending early; the reference in observations; random trajectories
    * v0: never released
    """

    ID = "castor/ASOC-v1"

    def __init__(
        self,
        robot: RobotDescription | str | PathLike[str] = "asoc-prototype",
        *,
        trajectory: Trajectory | str | PathLike[str] = "random",
        control: Control = "speed",
        estimator: EstimatorClass | str | None = None,
        scaled: bool = False,
        held: int | None = None,
        floor: Floor | str | PathLike[str] | None = None,
        render_mode: str | None = None,
    ) -> None:
        robot = load_robot(robot)
        self._random = trajectory == "random"
        self._sideways, self._turned = moves_sideways(robot), turned_by_motors(robot)
        chosen = self._drawn(np.random.default_rng(0)) if self._random else named_trajectory(trajectory)
        super().__init__(robot, chosen, floor, render_mode, held, LONGEST_RANDOM if self._random else None)
        self._track(RobotFollower(self.robot), control, estimator, scaled)

    def _drawn(self, random: np.random.Generator) -> Trajectory:
        return wander(random, duration=RANDOM, holonomic=self._sideways, turning=self._turned)

    def _next_course(self) -> Course:
        if not self._random:
            return self.course
        self.trajectory = self._drawn(self.np_random)
        return RobotCourse(self.trajectory)

    def _advance(self, commands: Commands, drive: Drive) -> None:
        self.sensed.advance(commands, drive)


def named_trajectory(trajectory: Trajectory | str | PathLike[str]) -> Trajectory:
    """Return a trajectory given as such, by its name or as the path of a drive file; raises InputError for others."""
    trajectory = fspath(trajectory) if isinstance(trajectory, PathLike) else trajectory
    if not isinstance(trajectory, str):
        return trajectory
    if trajectory.lower().endswith(".csv"):
        return read_drive(trajectory)
    if trajectory not in TRAJECTORIES:
        raise InputError(f"unknown trajectory {trajectory!r}{did_you_mean(trajectory, [*TRAJECTORIES, 'random'])}")
    return TRAJECTORIES[trajectory]()
