"""Effects of trains outside the catalogue: the right verdict on them is "unexplained".

Each changes a log after the drive; none changes the physics.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription

LASTING = 0.2
"""Part of a log for which counts are lost."""


@dataclass(frozen=True)
class Outside:
    """An effect outside the catalogue. name: in `KINDS`. wheel, frame: its place, from 0, if it has one. value: its
    size, in the unit of its kind. begins: its start, as a part of a log."""

    name: str
    wheel: int
    frame: int
    value: float
    begins: float

    def changed(self, train: TrainDescription, log: Log) -> Log:
        """Return a log changed by this effect."""
        return KINDS[self.name][0](self, train, log)


def draw_outside(train: TrainDescription, random: np.random.Generator) -> Outside:
    """Return a random effect outside the catalogue; all kinds are equally likely, sizes are log-uniform between
    bounds."""
    name = str(random.choice(sorted(KINDS)))
    _, low, high = KINDS[name]
    value = math.exp(random.uniform(math.log(low), math.log(high)))
    wheel, frame = int(random.integers(2 * train.n_axles)), int(random.integers(len(train.frames)))
    return Outside(name, wheel, frame, value, float(random.uniform(0.2, 0.6)))


def _lost_counts(outside: Outside, train: TrainDescription, log: Log) -> Log:
    t, wheel = (log.t - log.t[0]) / (log.t[-1] - log.t[0]), log.wheel.astype(float)
    during = (t[1:] > outside.begins) & (t[1:] <= outside.begins + LASTING)
    wheel[1:, outside.wheel] -= np.cumsum(outside.value * during * np.diff(wheel[:, outside.wheel]))
    return dataclasses.replace(log, wheel=np.round(wheel))


def _eccentric_encoder(outside: Outside, train: TrainDescription, log: Log) -> Log:
    wheels = [wheel for module in train.modules for wheel in module.castors[0].wheels]
    per_rad, wheel = (wheels[outside.wheel].counts_per_rev or 0.0) / (2 * np.pi), log.wheel.astype(float)
    wheel[:, outside.wheel] += per_rad * outside.value * np.sin(wheel[:, outside.wheel] / per_rad)
    return dataclasses.replace(log, wheel=np.round(wheel))


def _sensor_jumps(outside: Outside, train: TrainDescription, log: Log) -> Log:
    since = (log.t - log.t[0]) / (log.t[-1] - log.t[0]) > outside.begins
    return _read(outside, log, lambda seen: seen + since[:, None] * [0.0, 0.0, outside.value])


def _sensor_late(outside: Outside, train: TrainDescription, log: Log) -> Log:
    def late(seen: Array) -> Array:
        return np.stack([np.interp(log.t - outside.value, log.t, column) for column in seen.T], axis=1)

    return _read(outside, log, late)


def _sensor_saturates(outside: Outside, train: TrainDescription, log: Log) -> Log:
    def cut(seen: Array) -> Array:
        limit = outside.value * np.max(np.abs(seen[:, 2]))
        return np.column_stack([seen[:, :2], np.clip(seen[:, 2], -limit, limit)])

    return _read(outside, log, cut)


def _read(outside: Outside, log: Log, change: Callable[[Array], Array]) -> Log:
    """Return a log in which a frame's relative poses (K, 3) are changed."""
    assert log.rps is not None
    rps, columns = log.rps.copy(), slice(3 * outside.frame, 3 * outside.frame + 3)
    rps[:, columns] = change(rps[:, columns])
    return dataclasses.replace(log, rps=rps)


KINDS: dict[str, tuple[Callable[[Outside, TrainDescription, Log], Log], float, float]] = {
    "lost_counts": (_lost_counts, 0.02, 0.2),
    "eccentric_encoder": (_eccentric_encoder, 0.02, 0.2),
    "sensor_jumps": (_sensor_jumps, 0.01, 0.1),
    "sensor_late": (_sensor_late, 0.05, 0.5),
    "sensor_saturates": (_sensor_saturates, 0.5, 0.9),
}
"""The function that applies each kind to a log, and its smallest and largest size: part of the counts lost for a while;
rad of the wheel's angle; rad; s; part of the largest angle at which the reading saturates."""
