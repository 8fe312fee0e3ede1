"""Memory of a linearisation: it bounds how long a log may be."""

import tracemalloc

import numpy as np
import pytest

from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.linearise import linearise
from estimators.calibration.drives import log_of

pytestmark = pytest.mark.slow

MOST = 7e3
"""Bytes a sample: 500 MB for an hour at 20 Hz. Where noise is estimated anew, one round at a time is held."""


def peak_of(robot, minutes, again=False):
    """Return the number of samples of a log, and the bytes that its linearisation takes at most; again: with noise
    estimated anew beside two effects."""
    log = log_of(robot, wander(np.random.default_rng(3), duration=60.0 * minutes), "all")
    tracemalloc.start()
    try:
        seen = linearise(robot, [log])
        if again:
            seen.reestimate_noise([candidate for candidate in seen.candidates if candidate.kinds][:2])
        return len(log), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_grows_by_no_more_than_seven_kilobytes_a_sample():
    """As arrays, the columns of the robot's 240 amplitudes and of what creep masks of each took many times as much."""
    (short, least), (long, most) = (peak_of(preset("asoc-prototype"), minutes) for minutes in (0.5, 1.0))
    assert most - least < MOST * (long - short)


def test_noise_is_estimated_anew_one_round_at_a_time():
    (short, least), (long, most) = (peak_of(preset("asoc-prototype"), minutes, again=True) for minutes in (0.5, 1.0))
    assert most - least < MOST * (long - short)
