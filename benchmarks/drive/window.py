"""The window of a drive by hand: reads keys, moves the vehicle, draws truth and estimates, until the user closes it."""

import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.drive.follower import Follower
from benchmarks.drive.keys import Keyboard
from benchmarks.drive.vehicle import HandDrivenEnv
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.recorder import RecordLog
from castor_envs.rendering import Renderer
from castor_envs.rendering.drawing.canvas import import_pygame
from castor_envs.rendering.drawing.palette import BEAM, ESTIMATE, INK, ROUGH, SLIPPERY, Color

SIZE = (900, 900)
FPS = 30
"""Pictures a second at most; a sample period that is longer has a picture each."""
COLORS: tuple[Color, ...] = (ESTIMATE, BEAM, ROUGH, SLIPPERY, INK)
"""Of the estimators' paths, in turn."""
SHOWN = 2.0
"""m from the origin to the edge of the picture at first; it doubles whenever the vehicle comes near."""
NEAR = 0.85

UNSEEN, CHOSEN = "offscreen", "SDL_VIDEODRIVER"
"""The driver that SDL takes by itself where there is no display, and the variable by which a user chooses one."""

Events = Callable[[], Iterable[Any]]


class DriveWindow:
    """A window on a vehicle that has been reset. events: where they come from; None: pygame's own.

    Raises InputError where there is no display.
    """

    def __init__(self, env: HandDrivenEnv[Any], recorder: RecordLog, followers: Sequence[Follower], title: str) -> None:
        self._env, self._recorder, self._followers = env, recorder, followers
        self._keyboard = Keyboard(env.sideways)
        self._steps = max(1, round(1 / (FPS * env.vehicle.sample_period)))
        self._shown, self._time = SHOWN, 0.0
        self._renderer = Renderer(env.vehicle, env.floor, "rgb_array", FPS, SIZE, self._arena())
        self._pygame = import_pygame()
        try:
            self._pygame.display.init()
            if self._pygame.display.get_driver() == UNSEEN and not os.environ.get(CHOSEN):
                self._pygame.display.quit()
                raise self._pygame.error("none that can be seen")
            self._screen = self._pygame.display.set_mode(SIZE)
        except self._pygame.error as error:
            raise InputError(f"castor-bench drive found no display for its window ({error})") from None
        self._pygame.display.set_caption(title)

    def run(self, longest: float, events: Events | None = None, real_time: bool = True) -> None:
        """Drive until the window is closed or `longest` (s of the drive) have passed."""
        take: Events = self._pygame.event.get if events is None else events
        clock = self._pygame.time.Clock()
        try:
            self._draw()
            while self._time < longest and self._handle(take()):
                for _ in range(self._steps):
                    self._step()
                self._draw()
                if real_time:
                    clock.tick(1 / (self._steps * self._env.vehicle.sample_period))
        finally:
            self._pygame.display.quit()

    def picture(self) -> Array:
        """Return what the window shows (height, width, 3)."""
        return np.swapaxes(self._pygame.surfarray.array3d(self._screen), 0, 1)

    def _handle(self, events: Iterable[Any]) -> bool:
        """Handle events; return whether the drive goes on."""
        pygame, keyboard = self._pygame, self._keyboard
        for event in events:
            if event.type == pygame.QUIT or (event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE):
                return False
            if event.type == pygame.KEYDOWN:
                keyboard.press(pygame.key.name(event.key))
            elif event.type == pygame.KEYUP:
                keyboard.release(pygame.key.name(event.key))
            elif event.type == pygame.WINDOWFOCUSLOST:
                keyboard.release_all()
        return True

    def _step(self) -> None:
        if self._keyboard.stopping:
            self._env.stop()
        wish = np.zeros(3) if self._keyboard.stopping else self._keyboard.wish
        observation, *_ = self._recorder.step(wish)
        self._time = float(observation["time"][0])
        for follower in self._followers:
            follower.take(observation)

    def _draw(self) -> None:
        pose, env = self._env.pose, self._env
        while np.max(np.abs(pose[..., :2])) > NEAR * self._shown:
            self._shown *= 2
            self._renderer.look_at(self._arena())
        first = self._followers[0].pose if self._followers else None
        pixels = self._renderer.draw(pose, env.shape, estimate=first, time=self._time, sliding=env.sliding())
        assert pixels is not None
        self._screen.blit(self._pygame.image.frombuffer(pixels.tobytes(), SIZE, "RGB"), (0, 0))
        self._write(self._keyboard.legend, 44, INK)
        for k, follower in enumerate(self._followers):
            color = COLORS[k % len(COLORS)]
            if k > 0:
                self._draw_path(follower.poses, color)
            self._write(_label(follower, pose), 68 + 20 * k, color)
        self._pygame.display.flip()

    def _draw_path(self, poses: Sequence[Array], color: Color) -> None:
        places = np.array(poses).reshape(len(poses), -1)[:, :2]  # of a train its front axle
        places = places[np.isfinite(places).all(axis=1)]
        if len(places) > 1:
            self._pygame.draw.lines(self._screen, color, False, self._renderer.view.pixel(places).tolist(), 2)
            self._pygame.draw.circle(self._screen, color, self._renderer.view.pixel(places[-1]).tolist(), 6, 2)

    def _write(self, words: str, y: float, color: Color) -> None:
        self._pygame.font.init()
        self._screen.blit(self._pygame.font.Font(None, 22).render(words, True, color), (16, y))

    def _arena(self) -> tuple[float, float, float, float]:
        return (-self._shown, self._shown, -self._shown, self._shown)


def _label(follower: Follower, pose: Array) -> str:
    """Return an estimator's name and how far it is off (of a train, its axles in the mean), or why it has ended."""
    if follower.problem is not None:
        return f"{follower.name}: {follower.problem}"
    off = np.atleast_2d(follower.pose - pose)
    away = float(np.mean(np.hypot(off[:, 0], off[:, 1])))
    turned = float(np.mean(np.degrees((off[:, 2] + np.pi) % (2 * np.pi) - np.pi)))
    return f"{follower.name}: {1e3 * away:.1f} mm, {turned:+.2f} deg off"
