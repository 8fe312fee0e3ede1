"""External fixes of a robot's pose as a lidar against a map, or cameras that see markers, give them: sparse, late, and
some of them wrong."""

import dataclasses

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import Fixes

SENSOR = Fixes(noise_position=0.01, noise_heading=0.01)
"""A centimetre and half a degree, as of markers a few metres away."""
EVERY = 5.0
"""s between fixes, on average; they come at random times."""
LATE = (0.1, 0.5)
"""s: processing of an image or a scan, and a bus."""
WRONG, ASTRAY = 0.05, 2.0
"""The part of fixes that are wrong, as where a marker is taken for another, and how far in x and y these are off, m: up
to that; their heading is any."""


def with_fixes(log: Log, random: np.random.Generator) -> tuple[Log, Log]:
    """Return a log with fixes of its reference, and the same without those that are wrong, for an oracle."""
    if log.reference is None:
        raise ValueError("fixes are of a reference; the log has none")
    came = random.random(len(log)) < np.diff(log.t, prepend=log.t[0]) / EVERY
    age = np.where(came, random.uniform(*LATE, len(log)), np.nan)
    taken = np.clip(log.t - age, log.t[0], None)
    age = log.t - taken
    true = np.stack([np.interp(taken, log.t, column) for column in log.reference.T], axis=-1)
    noise = np.array([SENSOR.noise_position, SENSOR.noise_position, SENSOR.noise_heading])
    right = true + noise * random.standard_normal(true.shape)
    wrong = true + random.uniform(-1.0, 1.0, true.shape) * np.array([ASTRAY, ASTRAY, np.pi])
    is_wrong = (random.random(len(log)) < WRONG)[:, None]

    def seen(fix: Array) -> Log:
        return dataclasses.replace(log, fix=np.where(came[:, None], fix, np.nan), fix_age=age)

    return seen(np.where(is_wrong, wrong, right)), seen(np.where(is_wrong, np.nan, right))
