"""Physics: rigid bodies in pymunk, one wheel force law, stepped two ways that agree."""

from castor_envs.physics.train_world import TrainWorld
from castor_envs.physics.world import World

__all__ = ["TrainWorld", "World"]
