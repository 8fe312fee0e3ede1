"""Turns by a gyro: of what is read at both ends, less the file's bias, and as certain as their time stamps."""

import numpy as np
import pytest

from castor_envs.vehicles.robot import Gyro
from estimators.steps.gyro import SETTLED, GyroTurns

PERIOD = 0.05


def turns(t, rate, gyro=None):
    """The turns, durations, variances and what is known (K, 4) of readings (K,) at times t (K,)."""
    by_gyro = GyroTurns(gyro, PERIOD)
    read = [by_gyro.read({"time": np.array([s]), "gyro": np.array([w])}) for s, w in zip(t, rate, strict=True)]
    return np.array([[float(of) for of in sample] for sample in read])


def test_the_bias_of_the_file_turns_nothing():
    t = PERIOD * np.arange(20)
    rate = np.sin(t)
    biased = turns(t, rate + 0.3, Gyro(bias=0.3))
    np.testing.assert_allclose(biased, turns(t, rate), atol=1e-12)


@pytest.mark.parametrize("reading", [np.nan, np.inf])
def test_a_missing_reading_hides_the_turns_on_its_either_side_alone(reading):
    t = PERIOD * np.arange(20)
    rate = np.cos(t)
    whole, cut = turns(t, rate), turns(t, np.where(np.arange(20) == 7, reading, rate))
    hidden = np.isin(np.arange(20), [0, 7, 8])
    np.testing.assert_array_equal(cut[:, 3] == 0, hidden)
    np.testing.assert_array_equal(cut[hidden], 0.0)
    np.testing.assert_array_equal(cut[~hidden], whole[~hidden])


def test_what_is_not_read_at_all_is_missing_as_well():
    by_gyro, told = GyroTurns(None, PERIOD), []
    for k in range(6):
        seen = {"time": np.array([PERIOD * k])}
        told.append(bool(by_gyro.read(seen if k == 2 else seen | {"gyro": np.ones(1)}).known))
    assert told == [False, True, False, False, True, True]


def test_a_turn_is_off_by_as_much_as_its_stamps_are():
    """Of a body that turns at one rate: a stamp 10 ms late makes a turn longer, and the next one shorter."""
    t = PERIOD * np.arange(40)
    t[30] += 0.01
    found = turns(t, np.full(40, 2.0))
    deviation, off = np.sqrt(found[1:, 2]), found[1:, 0] - 2.0 * PERIOD
    np.testing.assert_allclose(deviation, np.abs(off), atol=1e-12)
    assert np.flatnonzero(deviation > 1e-9).tolist() == [29, 30]


def test_a_log_at_another_rate_is_as_certain_once_its_period_shows():
    t = PERIOD / 5 * np.arange(60)
    variance = turns(t, np.full(60, 2.0))[:, 2]
    assert (variance[1 : SETTLED + 1] > 0).all()
    np.testing.assert_allclose(variance[SETTLED + 1 :], 0.0, atol=1e-20)
