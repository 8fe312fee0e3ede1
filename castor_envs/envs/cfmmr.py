"""castor/CFMMR-v0: drive a train of axle modules along a path."""

from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from castor_envs.envs.actions import finite
from castor_envs.envs.base import TrainEnv, check_control
from castor_envs.floor import Floor
from castor_envs.motion.paths import TrainPath
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.train import TrainDescription

LOST = 0.5  # m, mean over the axles, from the target at which an episode ends


class CFMMREnv(TrainEnv):
    """Drive a train of differential axle modules on compliant frames (CFMMR) along a path, by its own sensors.

    ## Description
    Every axle is to follow the same path, each a frame's length behind the next (Vogt and Minor's
    robot). The agent commands every wheel once a sample period. It knows the path as a function of time, sees wheel
    encoders and relative posture sensors, and has to keep track of the rest itself. Frames bend, wheels slip, floors
    have patches, cables and slope.

    ## Action Space
    `Box(-1, 1, (2 * axles,))`, float32, axle by axle from the front, left wheel first. With
    `control="speed"` a fraction of `max_wheel_speed` (a servo holds it); with `control="voltage"` a fraction of the
    full voltage: torque max_wheel_torque (u - speed / max_wheel_speed).

    ## Observation Space
    `Dict` of 1-D boxes, float64; never truth.

    | Key       | Shape         | Content                                                                          |
    |-----------|---------------|----------------------------------------------------------------------------------|
    | `wheel`   | (2 * axles,)  | increments of the wheel encoders' counts since the last observation              |
    | `rps`     | (3 * frames,) | each frame's front axle as its sensor sees it from the rear: x, y (m), phi (rad)  |
    | `rps_age` | (frames,)     | s since that reading was taken                                                   |
    | `time`    | (1,)          | s since the start                                                                |

    ## Rewards
    Minus the tracking error, times the sample period: the mean over the axles of the distance to where
    they would be on the path (m).

    ## Starting State
    At rest, straight, the front axle at the origin. Encoder phases and gauge offsets are random.

    ## Episode End
    Terminates when the axles are more than 0.5 m from the target in the mean; truncates at the path's end.

    ## Information
    `pose` (axles, 3): the truth. `target` (axles, 3): where the axles would be on the path now.
    `position_error` (m) and `heading_error` (rad): mean over the axles. `command` (2 * axles,): what the motors were
    told in the last period (rad/s; with voltage control the fraction).

    ## Arguments
    - `train`: a preset's name ("cfmmr-2" to "cfmmr-10"), the path of a train file, or a `TrainDescription`
    - `path`: "s-bend", "straight", "arc", "random" (drawn for every episode), or a `TrainPath`
    - `control`: "speed" or "voltage"
    - `floor`: a `Floor` or the path of a floor file

    ## Version History
    * v0: first version
    """

    ID = "castor/CFMMR-v0"

    def __init__(
        self,
        train: TrainDescription | str = "cfmmr-3",
        *,
        path: TrainPath | str = "s-bend",
        control: Literal["speed", "voltage"] = "speed",
        floor: Floor | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        check_control(control)
        super().__init__(train, path, floor, render_mode)
        self._control = control
        self._fastest = np.repeat([module.max_wheel_speed for module in self.train.modules], 2)
        self.action_space = spaces.Box(-1.0, 1.0, self._fastest.shape, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the train at the start."""
        observation = self._start(seed)
        self._show()
        return observation, self._info(np.zeros_like(self._fastest))

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Command the motors for one sample period."""
        fraction = np.clip(finite(action, self.action_space.shape, "action (a number per motor)"), -1.0, 1.0)
        speed = self._control == "speed"
        command = fraction * self._fastest if speed else fraction
        self._sensed.advance(command, "servo" if speed else "voltage")
        self._sample += 1
        self._show()
        info = self._info(command)
        reward = -self.train.sample_period * info["position_error"]
        terminated = info["position_error"] > LOST
        return self._sensed.observation, reward, terminated, self._sample >= self._samples, info

    def _info(self, command: NDArray[np.float64]) -> dict[str, Any]:
        pose, target = self._sensed.pose, self._target()
        away = target - pose
        return {
            "pose": pose,
            "target": target,
            "position_error": float(np.mean(np.hypot(away[:, 0], away[:, 1]))),
            "heading_error": float(np.mean(np.abs(np.arctan2(np.sin(away[:, 2]), np.cos(away[:, 2]))))),
            "command": command,
        }
