"""What the environments of trains share: one sensed train that is to follow a path, and its pictures."""

from typing import Any, Literal, cast

import numpy as np

from castor_envs.envs.drawn_env import DrawnEnv
from castor_envs.envs.sensed_robot import Observation
from castor_envs.envs.sensed_train import SensedTrain
from castor_envs.floor import Floor, load_floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.paths import LONGEST_RANDOM, SPEED, TrainPath, axles_behind, named_path
from castor_envs.rendering import TrainRenderer
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.train import TrainDescription


class TrainEnv(DrawnEnv):
    """A sensed train, a path that starts at the origin, and rendering; subclasses say what the agent does."""

    def __init__(
        self,
        train: TrainDescription | str,
        path: TrainPath | str,
        floor: Floor | str | None,
        render_mode: str | None,
    ) -> None:
        floor = load_floor(floor)
        self._sensed = SensedTrain(load_train(train), floor)
        self.train = self._sensed.described
        self._wanted = path
        self.path = named_path(path, np.random.default_rng(0))  # a random one is drawn anew by `reset`
        self._behind = axles_behind([frame.length for frame in self.train.frames])
        longest = self.path.duration if path != "random" else LONGEST_RANDOM / SPEED + 2.0
        self.observation_space = self._sensed.observation_space(longest)
        self._fps = self._set_render_mode(render_mode, self.train.sample_period)

    def _start(self, seed: int | None) -> Observation:
        """Seed, and put the train at rest, straight, its front axle at the origin."""
        super().reset(seed=seed)
        self.path = named_path(self._wanted, self.np_random)
        self._samples = int(np.ceil(self.path.duration / self.train.sample_period - 1e-9))
        self._sensed.reset(self.np_random)
        self._sample = 0
        if self.render_mode is not None and (self._renderer is None or self._wanted == "random"):
            self._make_renderer()
        self._forget_picture()
        return self._sensed.observation

    def _reference(self) -> Array:
        """Return where the axles would be on the path now, (N, 3)."""
        covered, _ = self.path.run.progress(np.array(self._sample * self.train.sample_period))
        return self.path.at(covered - self._behind)[0]

    def _make_renderer(self) -> None:
        self.close()
        length = self.path.run.length
        self._drawn_path = self.path.at(np.linspace(-self._behind[-1], length, 400))[0]
        low, high = self._drawn_path[:, :2].min(axis=0) - 0.6, self._drawn_path[:, :2].max(axis=0) + 0.6
        mode = cast(Literal["human", "rgb_array"], self.render_mode)
        arena = (low[0], high[0], low[1], high[1])
        self._renderer = TrainRenderer(self.train, self._sensed.floor, mode, self._fps, arena=arena)

    def _draw(self) -> Any:
        if self._renderer is None:
            return None
        world = self._sensed.world
        return self._renderer.draw(
            world.poses,
            world.frame_shapes,
            estimate=self._drawn_estimate(),
            reference=self._drawn_path,
            time=world.time,
            sliding=self._sensed.sliding(),
        )

    def _drawn_estimate(self) -> Array | None:
        """Return the estimate to draw, (N, 3), if the agent makes one."""
        return None
