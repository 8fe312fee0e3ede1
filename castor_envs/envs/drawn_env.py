"""What environments share that can be drawn: render modes, and when a picture is made."""

from typing import Any

import gymnasium as gym
from numpy.typing import NDArray

from castor_envs.envs.sensed_robot import Observation
from castor_envs.errors import InputError


class DrawnEnv(gym.Env[Observation, NDArray[Any]]):
    """An environment with a picture: subclasses set `_renderer` where a render mode is wanted, and say how to draw."""

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's)
    _renderer: Any = None

    def _set_render_mode(self, render_mode: str | None, sample_period: float) -> int:
        """Check and keep the render mode; returns the pictures a second."""
        self.metadata = {**self.metadata, "render_fps": max(1, round(1 / sample_period))}
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode must be None, 'human' or 'rgb_array', got {render_mode!r}")
        self.render_mode = render_mode
        return self.metadata["render_fps"]

    def _draw(self) -> Any:
        """Draw the newest state and return the picture (None in human mode)."""
        raise NotImplementedError

    def render(self) -> Any:
        """Return a picture of the newest state and what the agent makes of it, or None in human mode."""
        return self._draw() if self.render_mode == "rgb_array" else None

    def _show(self) -> None:
        """In human mode, draw the newest state."""
        if self.render_mode == "human":
            self._draw()

    def _forget_picture(self) -> None:
        """Start a new picture, for a new episode."""
        if self._renderer is not None:
            self._renderer.reset()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
