"""Many environments of one kind at once: what ``gymnasium.make_vec`` makes, equal to single environments bit for bit.

They run side by side in one process. A step costs mostly the compiled physics of each robot, so there is nothing to
gain from arrays over robots, and nothing to lose: seeds, episodes and numbers are those of the single environments.
"""

from typing import Any

from gymnasium.vector import SyncVectorEnv

from castor_envs.envs.asoc import ASOCEnv
from castor_envs.envs.cfmmr import CFMMREnv
from castor_envs.envs.configuration import ConfigurationEnv
from castor_envs.envs.umbmark import UMBmarkEnv


def asoc(num_envs: int, **arguments: Any) -> SyncVectorEnv:
    """Return `num_envs` environments castor/ASOC-v0 with the same arguments."""
    return SyncVectorEnv([lambda: ASOCEnv(**arguments)] * num_envs)


def umbmark(num_envs: int, **arguments: Any) -> SyncVectorEnv:
    """Return `num_envs` environments castor/UMBmark-v0 with the same arguments."""
    return SyncVectorEnv([lambda: UMBmarkEnv(**arguments)] * num_envs)


def cfmmr(num_envs: int, **arguments: Any) -> SyncVectorEnv:
    """Return `num_envs` environments castor/CFMMR-v0 with the same arguments."""
    return SyncVectorEnv([lambda: CFMMREnv(**arguments)] * num_envs)


def configuration(num_envs: int, **arguments: Any) -> SyncVectorEnv:
    """Return `num_envs` environments castor/Configuration-v0 with the same arguments."""
    return SyncVectorEnv([lambda: ConfigurationEnv(**arguments)] * num_envs)
