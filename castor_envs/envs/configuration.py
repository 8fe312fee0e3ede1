"""castor/Configuration-v0: estimate the poses of all axles of a train that drives along a path."""

from os import PathLike
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from castor_envs.envs.actions import finite
from castor_envs.envs.base import TrainEnv
from castor_envs.envs.driving.reward import tracking_error
from castor_envs.floor import Floor
from castor_envs.motion.controllers import TrainDriver
from castor_envs.motion.paths import LONGEST_RANDOM, TrainPath
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.train import TrainDescription

MARGIN = 2.0  # m beyond the path that estimates may use


class ConfigurationEnv(TrainEnv):
    """The agent is the estimator: a scripted driver takes a train along a path, the agent says where its axles are.

    ## Description
    A train of axle modules on compliant frames (CFMMR) drives along a path; the driver follows it by
    time and keeps each axle behind the next by the relative posture sensors, as a real one would. Wheels slip and
    floors have bumps. The agent is given the axles' poses at the start (`info["pose"]`), and estimates them from then
    on.

    ## Action Space
    `Box(3 * axles,)`, float64: the estimate of all axles' poses after the newest observation, axle by
    axle from the front: x, y (m), psi (rad, unwrapped), within the path's length and 2 m, and 8 pi. An array
    (axles, 3) is taken as well.

    ## Observation Space
    `Dict` of 1-D boxes, float64; never truth.

    | Key       | Shape         | Content                                                                          |
    |-----------|---------------|----------------------------------------------------------------------------------|
    | `wheel`   | (2 * axles,)  | increments of the wheel encoders' counts since the last observation              |
    | `rps`     | (3 * frames,) | each frame's front axle as its sensor sees it from the rear: x, y (m), phi (rad)  |
    | `rps_age` | (frames,)     | s since that reading was taken                                                   |
    | `time`    | (1,)          | s since the start                                                                |

    ## Rewards
    Minus the growth of the mean axle position error (m) since the last action: an episode's return is
    minus that error at its end.

    ## Starting State
    At rest, straight, the front axle at the origin. Encoder phases and gauge offsets are random.

    ## Episode End
    Terminates when the estimate for the last observation, after the path, has been given.

    ## Information
    `pose` (axles, 3): the truth. `position_error` (m), `heading_error` (rad, wrapped): sizes, of the last action,
    mean over the axles. `command` (2 * axles,): what the driver commanded in the period that led to this observation,
    rad/s.

    ## Arguments
    - `train`: a preset's name ("cfmmr-2" to "cfmmr-10"), the path of a train file, or a `TrainDescription`;
      `env.unwrapped.train` is what an estimator may know
    - `path`: "s-bend", "straight", "arc", "random" (drawn for every episode), or a `TrainPath`
    - `floor`: a `Floor`, "slippery", or the path of a floor file

    ## Version History
    * v0: first version
    """

    ID = "castor/Configuration-v0"

    def __init__(
        self,
        train: TrainDescription | str | PathLike[str] = "cfmmr-3",
        *,
        path: TrainPath | str = "s-bend",
        floor: Floor | str | PathLike[str] | None = None,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(train, path, floor, render_mode)
        reach = MARGIN + self._behind[-1] + (LONGEST_RANDOM if path == "random" else self.path.length)
        limits = np.tile([reach, reach, 8 * np.pi], self.train.n_axles)
        self.action_space = spaces.Box(-limits, limits, dtype=np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the train at the start."""
        observation = self._start(seed, options)
        self._driver = TrainDriver(self.train, self.path)
        self._error = 0.0
        self._off: NDArray[np.float64] | None = None
        self._show()
        return observation, self._info(np.zeros(2 * self.train.n_axles), 0.0)

    def step(self, action: NDArray[np.float64]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take the estimate for the newest observation, score it, and drive on for one sample period."""
        self._need_going()
        shape = (self.train.n_axles, 3)
        flat = np.ravel(action) if np.shape(action) == shape else action
        estimate = finite(flat, self.action_space.shape, "action (the estimate x, y, psi of every axle)").reshape(shape)
        pose = self.sensed.pose
        self._off = estimate - pose
        error, heading_error = map(float, tracking_error(pose, estimate))
        reward, self._error = self._error - error, error

        command = np.zeros(2 * self.train.n_axles)
        terminated = self._over = self.sample == self.samples
        if not terminated:
            seen = self.sensed.observation
            command = self._driver.commands(self.sensed.world.time, seen["rps"], seen["rps_age"])
            self.sensed.advance(command)
            self.sample += 1
        self._show()
        return self.readings, reward, terminated, False, self._info(command, heading_error)

    def _info(self, command: NDArray[np.float64], heading_error: float) -> dict[str, Any]:
        return {
            "pose": self.sensed.pose,
            "position_error": self._error,
            "heading_error": heading_error,
            "command": command,
        }

    def shown_estimate(self) -> NDArray[np.float64] | None:
        """Return the last estimate, moved along."""
        # The estimate is one sample older than the train that is drawn: it is moved along, so that its error shows.
        return None if self._off is None else self.sensed.pose + self._off
