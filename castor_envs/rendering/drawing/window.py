"""The window that pictures are shown in."""

from typing import Any

from castor_envs.errors import InputError
from castor_envs.rendering.drawing.canvas import import_pygame


class Window:
    """A window of `size` (width, height) pixels, opened by the first picture, until the user closes it.

    fps: pictures a second, at most. dismissed: whether the user closed it; it then stays closed.
    """

    def __init__(self, title: str, size: tuple[int, int], fps: int) -> None:
        self.dismissed = False
        self._title, self._size, self._fps = title, size, fps
        self._window: Any = None
        self._clock: Any = None

    def show(self, picture: Any) -> None:
        """Show a pygame surface, and wait until it is time. Raises InputError where there is no display."""
        pygame = import_pygame()
        if self._window is None or pygame.display.get_surface() is not self._window:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(self._size)
            except pygame.error as error:
                raise InputError(
                    f"render mode 'human' found no display for its window ({error}); 'rgb_array' needs none"
                ) from None
            pygame.display.set_caption(self._title)
            self._clock = pygame.time.Clock()
        self._window.blit(picture, (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.dismissed = True
            self.close()
        else:
            self._clock.tick(self._fps)

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._window is not None:
            import_pygame().display.quit()
            self._window = None
