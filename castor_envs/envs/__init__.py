"""The Gymnasium environments. This module stays light: an environment's own module is imported when it is made."""

import gymnasium as gym

#: For each id, what makes one environment and what makes many at once.
ENVIRONMENTS = {
    "castor/ASOC-v0": ("castor_envs.envs.asoc:ASOCEnv", "castor_envs.envs.vector:asoc"),
    "castor/UMBmark-v0": ("castor_envs.envs.umbmark:UMBmarkEnv", "castor_envs.envs.vector:umbmark"),
    "castor/CFMMR-v0": ("castor_envs.envs.cfmmr:CFMMREnv", "castor_envs.envs.vector:cfmmr"),
    "castor/Configuration-v0": (
        "castor_envs.envs.configuration:ConfigurationEnv",
        "castor_envs.envs.vector:configuration",
    ),
}


def register_envs() -> None:
    """Register all environments with Gymnasium; doing it again changes nothing."""
    for name, (entry_point, vector_entry_point) in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(id=name, entry_point=entry_point, vector_entry_point=vector_entry_point)
