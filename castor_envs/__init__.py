"""The world: robots on castors, their physics, and Gymnasium environments for odometry.

Importing this package registers the environments; ``gym.make("castor_envs:castor/UMBmark-v0")`` does both.
"""

__version__ = "0.1.0"

from castor_envs.envs import register_envs
from castor_envs.shadowed import watch as _watch

register_envs()
_watch()
