"""A wrapper that records an environment's episodes as logs."""

import os
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.vehicles.load import check_beside, file_name


class RecordLog(gym.Wrapper[dict[str, Array], Any, dict[str, Array], Any]):
    """Records every sample of an episode: counts, pivots or relative poses, commands and, as the reference, the truth.

    Commands of a log are speeds, so wheels that are driven by voltage have none in it. Where the vehicle has effects on
    the clock of its reference, the reference comes early or late, and is blank after the last sample.

    env: an environment that offers its `vehicle`, as those of castor_envs do, and maybe `drive`, "voltage" where that
    is what wheels are commanded, `reference(t, pose)`, what a tracker reports of true poses, and `readings`, what its
    sensors say where the agent sees something else (scaled); wrapped or not. folder: where each episode goes as
    ``episode-0000.csv``, with the vehicle's description beside it as ``robot.json`` or ``train.json``; None keeps the
    newest episode in memory only (`log`). An episode is written when it ends; one that is left, or cut by a wrapper
    around this one, by the next `reset` or by `close`. Raises InputError for a folder that holds episodes, or another
    vehicle's file.
    """

    def __init__(self, env: gym.Env[Any, Any], folder: str | os.PathLike[str] | None = None) -> None:
        super().__init__(env)
        bare: Any = env.unwrapped
        if not hasattr(bare, "vehicle"):
            raise TypeError(f"RecordLog needs an environment with a `vehicle`; {type(bare).__name__} has none")
        self._vehicle = bare.vehicle
        self._readings = lambda observation: getattr(bare, "readings", observation)
        self._reference = getattr(bare, "reference", lambda t, pose: pose)
        self._has_speeds = getattr(bare, "drive", "servo") == "servo"
        self._folder = None if folder is None else Path(folder)
        self._episodes = 0
        self._rows: list[dict[str, Array]] = []
        self._written = True
        if self._folder is not None:
            self._begin(self._folder)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start a new record; write the log of an episode that has not ended."""
        self._write()
        observation, info = self.env.reset(seed=seed, options=options)
        self._rows = [self._row(self._readings(observation), info)]
        self._written = False
        return observation, info

    def step(self, action: Any) -> tuple[dict[str, Array], Any, bool, bool, dict[str, Any]]:
        """Step and record; write the log when the episode ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        # The last action of an estimation task comes after the last sample: it brings no new one.
        readings = self._readings(observation)
        if readings["time"][0] > self._rows[-1]["t"]:
            self._rows[-1] |= _commands(info)
            self._rows.append(self._row(readings, info))
        if terminated or truncated:
            self._write()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Write the log of an episode that has not ended, and close the environment."""
        try:
            self._write()
        finally:
            super().close()

    def log(self) -> Log:
        """Return the episode recorded so far; the last row's commands, not yet given, are zero."""
        columns = {key: np.array([row[key] for row in self._rows]) for key in self._rows[0]}
        return Log(
            t=columns["t"],
            wheel=np.cumsum(columns["wheel"], axis=0),
            pivot=columns["pivot"],
            command=columns["command"] if self._has_speeds else None,
            steering_command=columns["steering_command"] if columns["steering_command"].shape[1] else None,
            reference=self._reference(columns["t"], columns["pose"]),
            gyro=columns.get("gyro"),
            rps=columns.get("rps"),
            rps_age=columns.get("rps_age"),
        )

    def _begin(self, folder: Path) -> None:
        """Put the vehicle's file into a folder; raises InputError, before that, for one that is not for it."""
        for episode in sorted(folder.glob("episode-*.csv"))[:1]:
            raise InputError(f"{folder}: holds {episode.name} already; name a new folder, or remove what was recorded")
        check_beside(folder, self._vehicle, str(folder))
        if not (folder / file_name(self._vehicle)).exists():
            self._vehicle.save(folder / file_name(self._vehicle))

    def _write(self) -> None:
        """Write the log of an episode once, if anything was driven; raises InputError where another recorder has."""
        if self._written or self._folder is None or len(self._rows) < 2:
            return
        self._written = True
        path = self._folder / f"episode-{self._episodes:04d}.csv"
        if path.exists():
            raise InputError(f"{path}: was written by another recorder; give each a folder of its own")
        write_log(path, self.log(), self._vehicle)
        self._episodes += 1

    def _row(self, observation: dict[str, Array], info: dict[str, Any]) -> dict[str, Array]:
        row = {
            "t": observation["time"][0],
            "wheel": observation["wheel"],
            "pivot": observation.get("pivot", np.empty(0)),
            "pose": np.ravel(info["pose"]),
        }
        row |= {key: np.zeros_like(command) for key, command in _commands(info).items()}
        row |= {key: observation[key] for key in ("rps", "rps_age") if key in observation}
        return row | ({"gyro": observation["gyro"][0]} if "gyro" in observation else {})


def _commands(info: dict[str, Any]) -> dict[str, Array]:
    return {key: info.get(key, np.empty(0)) for key in ("command", "steering_command")}
