"""A train driven by hand: the axle that leads draws a path, and the others follow on it."""

import numpy as np

from benchmarks.drive.vehicle import FASTEST, PART, HandDrivenEnv
from castor_envs.envs.sensed import SensedTrain
from castor_envs.floor import Floor, load_floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import TrainSteering
from castor_envs.motion.paths import axles_behind
from castor_envs.motion.trajectories import moved
from castor_envs.vehicles.train import TrainDescription

SHARPEST = 0.5
"""rad by which frames bend at most from axle to axle: a little more than on the sharpest path of trains here."""


class HandDrivenTrain(HandDrivenEnv[SensedTrain]):
    """A train that moves at a speed of at most `limits[0]`, m/s, along a path bent by at most `limits[2]`, 1/m.

    The front axle leads forward, the last axle backward, and the one that leads draws the path. At rest it cannot turn.
    """

    def __init__(self, train: TrainDescription, floor: Floor | str | None = None) -> None:
        super().__init__(SensedTrain(train, load_floor(floor)))
        described: TrainDescription = self._sensed.described
        self._behind = axles_behind([frame.length for frame in described.frames])
        self.limits = limits(described)

    def _start(self) -> dict[str, Array]:
        train = self._sensed.described
        self._sensed.reset(self.np_random)
        self._path, self._steering = DrawnPath(float(self._behind[-1])), TrainSteering(train)
        return {"command": np.zeros(2 * train.n_axles)}

    def _move(self, motion: Array) -> dict[str, Array]:
        way = float(motion[0]) * self._sensed.described.sample_period
        place = self._path.behind_front(self._behind)
        self._path.go(way, float(motion[2]))
        after, seen = self._path.behind_front(self._behind), self._sensed.observation
        twists = self._steering.twists(place, after, way, seen["rps"], seen["rps_age"])
        command = self._steering.wheel_rates(twists)
        self._sensed.advance(command)
        return {"command": command}


class DrawnPath:
    """The path under a train: a chain of poses from its last to its front axle, drawn on at the end that leads.

    length: m of path that the train covers. It is straight, along x, and the front is at the origin.
    """

    def __init__(self, length: float) -> None:
        self._length = length
        self._at = np.array([-length, 0.0])  # m along the path, increasing; the front's place is the last
        self._poses = np.array([[-length, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def go(self, way: float, curvature: float) -> None:
        """Move by `way`, m, negative backward, on an arc of `curvature`, 1/m, around a centre on the train's left.

        As a car whose wheel is held: backward it turns the other way.
        """
        if way == 0:
            return
        end = -1 if way > 0 else 0
        new, at = moved(self._poses[end], way * np.array([1.0, 0.0, curvature])), self._at[end] + way
        order = (self._at, [at]) if way > 0 else ([at], self._at)
        chain = (self._poses, [new]) if way > 0 else ([new], self._poses)
        self._at, self._poses = np.concatenate(order), np.concatenate(chain)
        self._cut(at - self._length if way > 0 else at, at if way > 0 else at + self._length)

    def behind_front(self, distances: Array) -> Array:
        """Return the poses (N, 3) at distances (N,) behind the front, m along the path."""
        at = self._at[-1] - distances
        return np.stack([np.interp(at, self._at, column) for column in self._poses.T], axis=-1)

    def _cut(self, first: float, last: float) -> None:
        """Keep the path between two places on it."""
        ends = np.array([first, last])
        poses = np.stack([np.interp(ends, self._at, column) for column in self._poses.T], axis=-1)
        inside = (self._at > first) & (self._at < last)
        self._at = np.concatenate([ends[:1], self._at[inside], ends[1:]])
        self._poses = np.concatenate([poses[:1], self._poses[inside], poses[1:]])


def limits(train: TrainDescription) -> Array:
    """Return how fast a train is driven, m/s, nothing sideways, and its path's sharpest curvature, 1/m."""
    rim = min(
        PART * module.max_wheel_speed * min(module.wheels[k].radius for k in module.driven_wheels)
        for module in train.modules
    )
    return np.array([min(FASTEST, rim), 0.0, SHARPEST / max(frame.length for frame in train.frames)])
