"""Pictures of a robot or a train on its floor, seen from above.

Pygame is imported when the first renderer is made, not before.
"""

from castor_envs.rendering.renderer import Renderer

__all__ = ["Renderer"]
