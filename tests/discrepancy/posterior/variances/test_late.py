"""An encoder that is read so late that its linear signature is wrong: found by when it agrees with the other wheels."""

import numpy as np
import pytest

from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.variances.at_times import Faulty
from discrepancy.posterior.variances.encoders import late_encoders
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("swerve")


def late(*effects):
    """What is proposed for wheel 3, of a log of a robot with effects."""
    motion = wander(np.random.default_rng([3, 1]), duration=15.0)
    log = drive(ROBOT.with_effects(*effects), motion, 3, duration=15.0)
    seen = linearise(ROBOT, [log], among=())
    return late_encoders(ROBOT, [log], seen, [Faulty(2, (), (), 0.0)])


def test_a_large_latency_is_proposed_to_within_a_sample_or_two():
    (proposed,) = late(EncoderLatency(castor=3, wheel=1, value=0.4))
    assert proposed.candidate.kinds[0] == EncoderLatency(castor=3, wheel=1, value=EncoderLatency.step)
    assert proposed.size == pytest.approx(0.4, abs=0.1)


def test_a_wheel_in_time_is_not_late():
    assert late() == []
    assert late(WheelRadius(castor=3, wheel=1, value=0.01)) == []
