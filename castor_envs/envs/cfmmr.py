"""castor/CFMMR-v1: drive a train of axle modules along a path."""

from os import PathLike

from castor_envs.envs.base import TrainEnv
from castor_envs.envs.driving.followers import TrainFollower
from castor_envs.envs.driving.tracking import Control, EstimatorClass, TrackingEnv
from castor_envs.envs.sensed import SensedTrain
from castor_envs.floor import Floor
from castor_envs.motion.controllers import Commands
from castor_envs.motion.paths import TrainPath
from castor_envs.physics.stepper import Drive
from castor_envs.vehicles.train import TrainDescription


class CFMMREnv(TrackingEnv[SensedTrain], TrainEnv):
    """Drive a train of differential axle modules on compliant frames (CFMMR) along a path.

    ## Description
    Every axle is to follow the same path, each a frame's length behind the next (Vogt and Minor's robot). The agent
    commands every wheel once a sample period. It sees its sensors, and from each axle the reference of that axle: as an
    ideal tracker tells it, or as an estimator believes. Frames bend, wheels slip, floors have patches, cables and
    slope.

    ## Action Space
    `Box(-1, 1, (2 * axles,))`, float32, axle by axle from the front.

    | `control`    | What an action is                                                                               |
    |--------------|-------------------------------------------------------------------------------------------------|
    | `"speed"`    | of each axle the left and the right wheel's fraction of `max_wheel_speed`; a servo holds it     |
    | `"voltage"`  | the same of the full voltage: torque max_wheel_torque (u - speed / max_wheel_speed)             |
    | `"residual"` | what is added to each axle's velocity by the scripted driver: up to 0.25 m/s ahead, 0.5 rad/s  |

    ## Observation Space
    `Dict` of 1-D boxes, float64.

    | Key               | Shape         | Content                                                                  |
    |-------------------|---------------|--------------------------------------------------------------------------|
    | `wheel`           | (2 * axles,)  | increments of the wheel encoders' counts since the last sample           |
    | `rps`             | (3 * frames,) | each frame's front axle as its sensor sees it from the rear axle         |
    | `rps_age`         | (frames,)     | s since that reading was taken                                           |
    | `time`            | (1,)          | s since the start                                                        |
    | `reference`       | (12 * axles,) | where the axles would be on the path, all now, then in 0.25, 0.5 and 1 s |
    | `reference_twist` | (3 * axles,)  | their velocities on the path in the middle of the coming period          |
    | `goal`            | (3 * axles,)  | where the axles end                                                      |

    Poses are as seen from each axle: x (m, ahead), y (m, left), psi (rad, wrapped); velocities in m/s and rad/s.

    With `scaled=True` one `Box(-5, 5)`, float32, with the same numbers divided by what is usual (within about [-1, 1]
    when driven well): `castor_envs.envs.driving.scaling`.

    ## Rewards
    The sample period (s) times how well the path is followed: 1 on it, less in proportion to the mean over the axles of
    the distance to where they would be and of a quarter of a metre for each radian of heading error, 0 where these are
    0.5 m or more. A return is thus in [0, duration of the path]; it is largest for perfect tracking, and an episode
    that ends early only loses.

    ## Starting State
    At rest, straight, the front axle at the origin. Encoder phases and gauge offsets are random, and so is the path,
    unless another one is chosen.

    ## Episode End
    Terminates when the axles are more than 0.5 m from the target in the mean; truncates at the path's end.

    ## Information
    `pose` (axles, 3): the truth. `target` (axles, 3): where the axles would be on the path now. `position_error` (m)
    and `heading_error` (rad, wrapped): sizes, mean over the axles. `command` (2 * axles,): what the motors were told in
    the last period (rad/s; with voltage control the fraction).

    ## Arguments
    - `train`: a preset's name ("cfmmr-2" to "cfmmr-10"), the path of a train file, or a `TrainDescription`
    - `path`: "random" (drawn for every episode), "s-bend", "straight", "arc", or a `TrainPath`
    - `control`: "speed", "voltage" or "residual"
    - `estimator`: a class of estimators or its name, such as "estimators.trains.odometry:TrainOdometry", which tells
      the agent where the axles are; None: an ideal tracker does
    - `scaled`: whether observations are one vector of scaled numbers
    - `floor`: a `Floor`, "slippery", or the path of a floor file

    `env.unwrapped.follower.action(observation)` is the scripted driver's action for an observation that is not scaled;
    `env.unwrapped.unscaled` is the newest one, whether or not observations are.

    ## Version History
    * v1: a reward that is never better for ending early; the reference in observations; random paths
    * v0: never released
    """

    ID = "castor/CFMMR-v1"

    def __init__(
        self,
        train: TrainDescription | str | PathLike[str] = "cfmmr-3",
        *,
        path: TrainPath | str = "random",
        control: Control = "speed",
        estimator: EstimatorClass | str | None = None,
        scaled: bool = False,
        floor: Floor | str | PathLike[str] | None = None,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(train, path, floor, render_mode)
        self._track(TrainFollower(self.train), control, estimator, scaled)

    def _advance(self, commands: Commands, drive: Drive) -> None:
        self.sensed.advance(commands.wheel, drive)
