"""What may be missing, and what else may look like it: where an encoder jumps is found in the log."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("asoc-prototype")


@cache
def driven():
    return drive(ROBOT, wander(np.random.default_rng([1, 1]), duration=20.0), 1, duration=20.0)


@pytest.mark.parametrize("at", [12.0, 0.3])
def test_a_jump_is_looked_for_where_it_is_and_never_near_the_ends(at):
    """There it is a bias in all but name."""
    log = driven()
    pivot = log.pivot + np.where(log.t >= at, 8.0, 0.0)[:, None] * [0, 1, 0]
    seen = linearise(ROBOT, [dataclasses.replace(log, pivot=pivot)])
    (jump,) = [one.what for one in seen.candidates if one.what.startswith("pivot_2 jumps at ")]
    time = float(jump.split()[3])
    assert time == at if at == 12.0 else 1.0 <= time <= 19.0
