"""A small task of trains for tests: straight ahead, known in closed form."""

import dataclasses

import numpy as np

from benchmarks.tasks.task import Episode, Run
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr


def moving_train(samples=41):
    """Return the exact log of a straight train that drives ahead at 0.4 m/s, its frames seen as they are."""
    train, t = cfmmr(3), 0.05 * np.arange(samples)
    reference = np.zeros((samples, 3, 3))
    reference[:, :, 0] = 0.4 * t[:, None] + [0.7, 0.35, 0]
    wheel = train.modules[0].wheels[0]
    assert wheel.counts_per_rev is not None
    counts = 0.4 * t / wheel.radius * wheel.counts_per_rev / (2 * np.pi)
    log = Log(
        t,
        np.tile(counts[:, None], 6),
        np.empty((samples, 0)),
        reference=reference.reshape(samples, 9),
        rps=np.tile([0.35, 0, 0], (samples, 2)),
    )
    return Episode(train, (Run(log),))


@dataclasses.dataclass(frozen=True)
class Ahead:
    """A task of a train that drives straight ahead."""

    name: str = "ahead"
    version: int = 1
    title: str = "Ahead"
    description: str = "Straight ahead."
    metric: str = "mean_axle_position"
    group: str = "trains"
    standard: bool = True
    missing: str | None = None
    robot = cfmmr(3)

    def cases(self, n=None):
        return range(1 if n is None else n)

    def record(self, case):
        return moving_train()
