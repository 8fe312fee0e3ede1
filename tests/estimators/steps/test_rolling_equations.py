"""Castors that the floor turns, integrated in conftest, against the equations of a sample."""

import numpy as np
import pytest

from castor_envs.vehicles.presets import preset
from estimators import WheelOdometry


def off_at_the_end(exact_motion, drive, steps):
    """How far odometry is off after a second of even driving that turns castors from where they do not trail, m."""
    motion = exact_motion(preset("asoc-prototype"), lambda t: (0.2, 0.1, 0.5), 1.0, theta=[1.2, -0.8, 0.4])
    true, observations = motion.sampled(steps)
    return np.hypot(*(drive(WheelOdometry(), motion.robot, observations, true[0]) - true)[-1, :2])


def test_of_an_evenly_moving_body_the_fourth_order_is_left(exact_motion, drive):
    """A castor follows a tractrix: without its third order in a sample, half the sample would quarter the error."""
    coarse, fine = (off_at_the_end(exact_motion, drive, steps) for steps in (20, 40))
    assert coarse / fine == pytest.approx(16.0, rel=0.15)
    assert coarse < 1e-5
