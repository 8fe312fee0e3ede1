"""Effects of trains outside the catalogue: the right verdict on them is "unexplained".

Each changes a log after the drive; none changes the physics.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from castor_envs.logs.log import Log
from castor_envs.vehicles.train import TrainDescription

LASTING = 0.2
"""Part of a log for which counts are lost."""

KINDS = {
    "lost_counts": (0.02, 0.2),
    "eccentric_encoder": (0.02, 0.2),
    "sensor_jumps": (0.01, 0.1),
    "sensor_late": (0.05, 0.5),
    "sensor_saturates": (0.5, 0.9),
}
"""The smallest and largest size of each kind: part of the counts lost for a while; rad of the wheel's angle; rad; s;
part of the largest angle at which the reading saturates."""


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
        assert log.rps is not None
        t, wheel, rps = (log.t - log.t[0]) / (log.t[-1] - log.t[0]), log.wheel.astype(float), log.rps.copy()
        counts, seen = wheel[:, self.wheel], rps[:, 3 * self.frame : 3 * self.frame + 3]
        match self.name:
            case "lost_counts":
                during = (t[1:] > self.begins) & (t[1:] <= self.begins + LASTING)
                counts[1:] -= np.cumsum(self.value * during * np.diff(counts))
            case "eccentric_encoder":
                wheels = [wheel for module in train.modules for wheel in module.castors[0].wheels]
                per_rad = (wheels[self.wheel].counts_per_rev or 0.0) / (2 * np.pi)
                counts += per_rad * self.value * np.sin(counts / per_rad)
            case "sensor_jumps":
                seen[:, 2] += self.value * (t > self.begins)
            case "sensor_late":
                seen[:] = np.stack([np.interp(log.t - self.value, log.t, column) for column in seen.T], axis=1)
            case "sensor_saturates":
                limit = self.value * np.max(np.abs(seen[:, 2]))
                seen[:, 2] = np.clip(seen[:, 2], -limit, limit)
        return dataclasses.replace(log, wheel=np.round(wheel), rps=rps)


def draw_outside(train: TrainDescription, random: np.random.Generator) -> Outside:
    """Return a random effect outside the catalogue; all kinds are equally likely, sizes are log-uniform between
    bounds."""
    name = str(random.choice(sorted(KINDS)))
    value = math.exp(random.uniform(*np.log(KINDS[name])))
    wheel, frame = int(random.integers(2 * train.n_axles)), int(random.integers(len(train.frames)))
    return Outside(name, wheel, frame, value, float(random.uniform(0.2, 0.6)))
