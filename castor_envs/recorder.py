"""A wrapper that records an environment's episodes as logs."""

import os
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from castor_envs.envs.robot_env import RobotEnv
from castor_envs.logs import Log, write_log

Array = NDArray[np.float64]


class RecordLog(gym.Wrapper[dict[str, Array], Any, dict[str, Array], Any]):
    """Records every sample of an episode: counts, pivots, commands and, as the reference, the truth.

    env: one of castor_envs' environments, wrapped or not. folder: where each finished episode goes as
    ``episode-0000.csv``, with the robot's description beside it as ``robot.json``; None keeps the newest episode in
    memory only (`log`).
    """

    def __init__(self, env: gym.Env[Any, Any], folder: str | os.PathLike[str] | None = None) -> None:
        super().__init__(env)
        if not isinstance(env.unwrapped, RobotEnv):
            raise TypeError(f"RecordLog records environments of castor_envs, not {type(env.unwrapped).__name__}")
        self._robot = env.unwrapped.robot
        self._folder = None if folder is None else Path(folder)
        self._episodes = 0
        self._rows: list[dict[str, Array]] = []
        if self._folder is not None:
            self._robot.save(self._folder / "robot.json")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start a new record."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._rows = [self._row(observation, info)]
        return observation, info

    def step(self, action: Any) -> tuple[dict[str, Array], Any, bool, bool, dict[str, Any]]:
        """Step and record; write the log when the episode ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        # The last action of an estimation task comes after the last sample: it brings no new one.
        if observation["time"][0] > self._rows[-1]["t"]:
            self._rows[-1] |= {"command": info["command"], "steering": info["steering_command"]}
            self._rows.append(self._row(observation, info))
        if (terminated or truncated) and self._folder is not None:
            write_log(self._folder / f"episode-{self._episodes:04d}.csv", self.log(), self._robot)
            self._episodes += 1
        return observation, reward, terminated, truncated, info

    def log(self) -> Log:
        """Return the episode recorded so far; the last row's commands, not yet given, are zero."""
        columns = {key: np.array([row[key] for row in self._rows]) for key in self._rows[0]}
        return Log(
            t=columns["t"],
            wheel=np.cumsum(columns["wheel"], axis=0),
            pivot=columns["pivot"],
            command=columns["command"],
            steering_command=columns["steering"] if columns["steering"].shape[1] else None,
            reference=columns["reference"],
            gyro=columns.get("gyro"),
        )

    def _row(self, observation: dict[str, Array], info: dict[str, Any]) -> dict[str, Array]:
        row = {
            "t": observation["time"][0],
            "wheel": observation["wheel"],
            "pivot": observation["pivot"],
            "command": np.zeros_like(info["command"]),
            "steering": np.zeros_like(info["steering_command"]),
            "reference": info["pose"],
        }
        return row | ({"gyro": observation["gyro"][0]} if "gyro" in observation else {})
