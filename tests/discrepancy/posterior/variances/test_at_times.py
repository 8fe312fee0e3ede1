"""What happens at certain times only, as the reference tells of wheels that do not contradict each other."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.floor import FrictionPatch
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset, preset_names
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.variances.at_times import recurring, sliding
from discrepancy.trials.pymunk_generator import drive

JUMPS = {6.3: 120, 14.7: -105, 21.4: 150}
"""Counts by which an encoder jumps at these times, s."""


def driven(robot, seed, *effects, duration=30.0):
    described = preset(robot)
    path = wander(
        np.random.default_rng([seed, 1]), duration=duration, holonomic=robot not in ("differential", "tricycle")
    )
    return drive(described.with_effects(*effects), path, seed, duration=duration)


def jumping(log, wheel):
    """The log with counts of a wheel that jump."""
    counts = log.wheel.copy()
    counts[:, wheel] += sum(jump * (log.t - log.t[0] > at) for at, jump in JUMPS.items())
    return dataclasses.replace(log, wheel=counts)


@pytest.mark.slow
def test_an_encoder_that_jumps_contradicts_the_reference_where_no_other_wheel_can():
    robot = preset("differential")
    log, held_out = (jumping(driven("differential", seed), 1) for seed in (3, 4))
    (fault,) = sliding([log], linearise(robot, [log], among=()), None, 100)
    assert np.flatnonzero(fault.hits[0]).tolist() == [int(at) for at in JUMPS]
    assert np.sign(fault.slips[0][fault.hits[0]]).tolist() == [-np.sign(jump) for jump in JUMPS.values()]
    _, (factor,) = recurring([held_out], linearise(robot, [held_out], among=()), [fault])
    assert factor > 3
    diagnosis = diagnose(robot, [log], [held_out])
    assert diagnosis.verdict == "unexplained"
    assert any("wheel_1r contradicts the reference at times" in answer.reason for answer in diagnosis.answers)


@pytest.mark.slow
def test_wheels_that_slide_together_contradict_the_reference():
    """Where all slide, as a body, none contradicts another one."""
    log = driven("2-castor", 3, FrictionPatch(value=0.99, x=0.0, y=0.0, length=0.8, width=0.8))
    found = sliding([log], linearise(preset("2-castor"), [log], among=()), None, 100)
    assert {fault.row for fault in found} == {0, 1, 2, 3}


@pytest.mark.parametrize("robot", preset_names())
def test_wheels_in_good_order_slip_regularly(robot):
    log = driven(robot, 5, duration=20.0)
    assert sliding([log], linearise(preset(robot), [log], among=()), None, 100) == []
    assert (
        sliding([dataclasses.replace(log, reference=None)], linearise(preset(robot), [log], among=()), None, 100) == []
    )
