"""What Stable-Baselines3 (SB3) trains on, a `VecEnv`, made of a vector of Gymnasium: many environments stepped as one.

``PPO("MlpPolicy", GymnasiumVecEnv(gym.make_vec(..., num_envs=64, autoreset_mode="SameStep", scaled=True)))``.
"""

# pyright: reportMissingImports=false

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from castor_envs.errors import InputError, with_extra

try:
    from stable_baselines3.common.env_util import is_wrapped
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn
except ImportError as error:
    raise ImportError(f"needs Stable-Baselines3 ({error}); {with_extra('rl')}", name=error.name) from None


class GymnasiumVecEnv(VecEnv):
    """The members of a vector of Gymnasium, with the same numbers as in SB3's loop over single environments.

    vector: what ``gymnasium.make_vec`` makes of this project's environments, or another `SyncVectorEnv`, with
    ``autoreset_mode="SameStep"``: for SB3, an episode ends and the next one begins in the same step. What SB3's
    `Monitor` says of an episode that ends (``info["episode"]``: return, length, time) is said here, too.
    """

    def __init__(self, vector: Any) -> None:
        if not isinstance(vector.unwrapped, SyncVectorEnv):
            raise InputError(f"{vector} is no vector of environments in this process, as gymnasium.make_vec makes them")
        if vector.metadata.get("autoreset_mode") != AutoresetMode.SAME_STEP:
            raise InputError(f"{vector} resets in another step than SB3; make it with autoreset_mode='SameStep'")
        self.vector, self._members = vector, vector.unwrapped  # without wrappers of the vector, which do not find them
        super().__init__(vector.num_envs, vector.single_observation_space, vector.single_action_space)
        self._began = time.time()
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)

    def reset(self) -> VecEnvObs:
        """Begin an episode in each, with the seeds of `seed` and the options of `set_options`, which must be alike."""
        first = self._options[0]
        if any(options != first for options in self._options):
            raise InputError("a vector of Gymnasium takes the same options for all its members")
        observations, infos = self.vector.reset(seed=list(self._seeds), options=first or None)
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = _rows(infos, self.num_envs)
        self._returns[:], self._lengths[:] = 0, 0
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (B, ...) of the next step."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Return observations, rewards (B,), who has ended (B,) and infos; those that have ended have begun again."""
        observations, rewards, terminated, truncated, infos = self.vector.step(self._actions)
        over = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        rows = _rows(infos, self.num_envs)
        for lane in np.flatnonzero(over).tolist():
            begun = rows[lane]
            final, seen = begun.pop("final_info"), begun.pop("final_obs")
            rows[lane] = {**final, "terminal_observation": seen, "episode": self._episode(lane)}
            self.reset_infos[lane] = begun
        for row, late in zip(rows, (truncated & ~terminated).tolist(), strict=True):
            row["TimeLimit.truncated"] = late
        return observations, rewards.astype(np.float32), over, rows

    def _episode(self, lane: int) -> dict[str, float]:
        """Return what `Monitor` says of a member's episode, and count anew: return, steps, time (s) since the start."""
        said = {
            "r": round(float(self._returns[lane]), 6),
            "l": int(self._lengths[lane]),
            "t": round(time.time() - self._began, 6),
        }
        self._returns[lane], self._lengths[lane] = 0, 0
        return said

    def close(self) -> None:
        """Close all members."""
        self.vector.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return what each member draws."""
        return self.vector.render()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of members, as they are now."""
        values = self._members.call("get_wrapper_attr", attr_name)
        return [values[lane] for lane in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of members; if not of all, it must be one that all have."""
        lanes = set(self._get_indices(indices))
        values = [value] * self.num_envs if len(lanes) == self.num_envs else self.get_attr(attr_name)
        self._members.set_attr(attr_name, [value if lane in lanes else kept for lane, kept in enumerate(values)])

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Return what members answer to a call of a method."""
        methods = self.get_attr(method_name, indices)
        answers = [method(*method_args, **method_kwargs) for method in methods]
        self.get_attr("unwrapped")  # a vector that keeps its members' states takes them anew at any call
        return answers

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return whether members are in such a wrapper. All are as if in a `Monitor`, whose work is done here."""
        members = [self._members.envs[lane] for lane in self._get_indices(indices)]
        return [wrapper_class is Monitor or is_wrapped(member, wrapper_class) for member in members]


def _rows(infos: dict[str, Any], size: int) -> list[dict[str, Any]]:
    """Return the information of each of B members, given that of a vector: arrays (B, ...), masks (B,) of whose."""
    rows: list[dict[str, Any]] = [{} for _ in range(size)]
    for name, values in infos.items():
        whose = infos.get(f"_{name}")
        if whose is None:  # a mask itself
            continue
        if isinstance(values, dict):
            parts = _rows(values, size)
        else:
            parts = values.tolist() if values.ndim == 1 else list(values)
        for lane in np.flatnonzero(whose).tolist():
            rows[lane][name] = parts[lane]
    return rows
