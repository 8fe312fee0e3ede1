"""Training by Stable-Baselines3's PPO on many environments stepped as one, by its own loop, and on CartPole.

All train the same network with the same settings. An update of the network costs all of them alike.
"""

# pyright: reportMissingImports=false

import statistics
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
from gymnasium.vector import SyncVectorEnv

import castor_envs  # noqa: F401  (registers the environments)
from benchmarks.speed.figures import Effort, Figure, Group, Work, by_turns, ratio

DRIVEN, CARTPOLE = "castor/ASOC-v1", "CartPole-v1"
ARGUMENTS: dict[str, Any] = {"floor": "slippery", "scaled": True, "control": "residual"}
MEMBERS = 64
STEPS = 4096
"""Steps of all members together from one update to the next."""
PPO: dict[str, Any] = {"batch_size": 256, "n_epochs": 10, "learning_rate": 0.001, "gamma": 0.98}
NETWORK: dict[str, Any] = {"net_arch": [64, 64], "log_std_init": -1.5}
"""Arguments, settings and network as in docs/tutorials/policies.md."""


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield the steps a CPU second of each, on one thread, and of how many of ours a step of the others takes the time.

    Nothing without Stable-Baselines3. It is imported here, with torch, so that groups before are measured without.
    """
    try:
        import torch

        made = _vectors()
    except ImportError:  # the extra "rl"
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    times = by_turns({name: _training(env) for name, env in made.items()}, max(1, effort.rounds // 4))
    torch.set_num_threads(threads)
    for name, of in times.items():
        yield Figure(f"PPO on {name}", STEPS / statistics.median(of), "steps/s")
    ours, *others = times
    for name in others:
        yield Figure(f"a step of PPO on {name} / on {ours}", ratio(times, name, ours), "x")
    for env in made.values():
        env.close()


def _vectors() -> dict[str, Any]:
    """Return what is trained on, ours first, by what the table calls it."""
    from stable_baselines3.common.env_util import make_vec_env

    from castor_envs.envs.stable_baselines import GymnasiumVecEnv

    ours = gym.make_vec(DRIVEN, num_envs=MEMBERS, autoreset_mode="SameStep", threads=1, **ARGUMENTS)
    loop = SyncVectorEnv([lambda: gym.make(CARTPOLE)] * MEMBERS, autoreset_mode="SameStep")
    return {
        f"{DRIVEN}, {MEMBERS} at once": GymnasiumVecEnv(ours),
        f"{DRIVEN} in SB3's loop": make_vec_env(DRIVEN, MEMBERS, env_kwargs=ARGUMENTS),
        f"{CARTPOLE} in SyncVectorEnv": GymnasiumVecEnv(loop),
        f"{CARTPOLE} in SB3's loop": make_vec_env(CARTPOLE, MEMBERS),
    }


def _training(env: Any) -> Work:
    """Return work that gathers `STEPS` steps in an environment and learns from them."""
    from stable_baselines3 import PPO as Learner  # noqa: N811

    steps = STEPS // MEMBERS
    model = Learner("MlpPolicy", env, n_steps=steps, policy_kwargs=NETWORK, seed=0, device="cpu", **PPO)
    return lambda: model.learn(STEPS, reset_num_timesteps=False)


GROUP = Group("Training", figures)
