"""The Gymnasium environments. This module stays light: an environment's own module is imported when it is made."""

import gymnasium as gym

ENVIRONMENTS = {
    "castor/ASOC-v0": "castor_envs.envs.asoc:ASOCEnv",
    "castor/UMBmark-v0": "castor_envs.envs.umbmark:UMBmarkEnv",
}


def register_envs() -> None:
    """Register all environments with Gymnasium; doing it again changes nothing."""
    for name, entry_point in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(id=name, entry_point=entry_point)
