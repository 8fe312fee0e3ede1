"""Pictures of a robot on its floor, seen from above.

Pygame is imported when the first `Renderer` is made, not before.
"""

from castor_envs.rendering.renderer import Renderer

__all__ = ["Renderer"]
