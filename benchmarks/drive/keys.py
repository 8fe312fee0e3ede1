"""From keys to how a robot is to move. Nothing of a window or of physics."""

import numpy as np

from castor_envs.geometry.arrays import Array

STOP = "space"
FORWARD, BACK = ("w", "up"), ("s", "down")
LEFT, RIGHT = ("q", "left"), ("e", "right")
ASIDE_LEFT, ASIDE_RIGHT = ("a",), ("d",)


class Keyboard:
    """The keys that are held. sideways: whether the robot can move sideways; the keys for it turn other robots."""

    def __init__(self, sideways: bool) -> None:
        self.sideways = sideways
        self._held: set[str] = set()

    def press(self, key: str) -> None:
        """Take a key that goes down, by its name as pygame has it."""
        self._held.add(key)

    def release(self, key: str) -> None:
        """Take a key that comes up."""
        self._held.discard(key)

    def release_all(self) -> None:
        """Take all keys as up, as when another window gets the keyboard."""
        self._held.clear()

    @property
    def stopping(self) -> bool:
        """Whether the robot is to stop at once."""
        return STOP in self._held

    @property
    def wish(self) -> Array:
        """Where the robot is to go: forward, to its left and turning left, (3,) in [-1, 1] of its limits."""
        aside = self._between(ASIDE_LEFT, ASIDE_RIGHT)
        turn = self._between(LEFT, RIGHT)
        if not self.sideways:
            aside, turn = 0, max(-1, min(1, turn + aside))
        return np.array([self._between(FORWARD, BACK), aside, turn], dtype=float)

    @property
    def legend(self) -> str:
        """What the keys do, in a line."""
        aside = "A D: sideways   Q E or arrows: turn" if self.sideways else "A D or arrows: turn"
        return f"W S or arrows: forward, back   {aside}   space: stop   Esc: end"

    def _between(self, more: tuple[str, ...], less: tuple[str, ...]) -> int:
        return bool(self._held & {*more}) - bool(self._held & {*less})
