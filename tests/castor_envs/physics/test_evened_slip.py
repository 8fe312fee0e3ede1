"""Slip that is averaged over the way rolled, against closed forms."""

import numpy as np
import pytest

from castor_envs.physics.contact_motion import evened

LENGTH = 1e-3
PERIOD = 1e-3


def test_slip_at_a_place_is_spread_along_the_way():
    """By exp(-|x| / length) / (2 length), whichever way the contact then rolls, and however fast."""
    speed = np.stack([np.full(801, 0.02), np.full(801, 0.04)], axis=1)
    slipping = np.zeros((801, 2))
    slipping[400] = 1e-3
    average = evened(slipping, speed, np.full(801, PERIOD), LENGTH)
    way = speed * PERIOD * (np.arange(801) - 400)[:, None]
    expected = speed * 1e-3 * PERIOD * np.exp(-np.abs(way) / LENGTH) / (2 * LENGTH)
    assert average == pytest.approx(expected, abs=2e-3 * expected.max())


def test_no_slip_is_lost():
    random = np.random.default_rng(0)
    speed, slipping = random.uniform(1e-6, 0.3, (500, 3)), random.normal(size=(500, 3))
    average = evened(slipping, speed, np.full(500, PERIOD), LENGTH)
    assert average.sum(axis=0) == pytest.approx(slipping.sum(axis=0), rel=1e-9)


def test_nothing_slips_at_a_stop():
    """What is seen there belongs to the way before and after it, and goes out if it is noise."""
    speed = np.where(np.abs(np.arange(600) - 300) < 100, 1e-6, 0.1)[:, None]
    slipping = np.where(speed < 1e-3, 1e-5 * (-1.0) ** np.arange(600)[:, None], 0.0)
    average = evened(slipping, speed, np.full(600, PERIOD), LENGTH)
    assert np.abs(average[201:400]).max() < 1e-5 * np.abs(slipping).max()
    assert np.abs(average).max() < 0.1 * np.abs(slipping).max()


def test_slip_that_lasts_stays_as_it_is():
    speed = np.full((50, 1), 0.1)
    assert evened(0.01 * speed, speed, np.full(50, PERIOD), LENGTH) == pytest.approx(0.01 * speed)
