"""Averages over neighbouring steps."""

import numpy as np
import pytest

from castor_envs.geometry.steps import Motion, smoothed


def test_smoothing_many_times_is_smoothing_once_again_and_again():
    course, n = np.random.default_rng(2).normal(size=(200, 3)), 9
    again = course
    for _ in range(n):
        again = smoothed(again)
    inner = slice(n, -n)  # ends are repeated
    np.testing.assert_allclose(smoothed(course, n)[inner], again[inner], rtol=0, atol=1e-4)


@pytest.mark.parametrize("rate", [5, 20, 250])
def test_rates_are_averaged_over_a_time_whatever_the_sample_rate(rate):
    """A pulse becomes a bell whose standard deviation is that time, and at least that of 1/4, 1/2, 1/4."""
    count, averaging = 4 * rate + 1, 0.1
    t = np.arange(count + 1) / rate
    still = np.zeros((count + 1, 3))
    motion = Motion(t, still, still, still, averaging=averaging)
    pulse = np.zeros((count, 1))
    pulse[count // 2] = 1.0
    bell = motion.averaged(pulse)[:, 0]
    assert np.sum(bell) == pytest.approx(1.0)
    deviation = np.sqrt(np.sum(bell * (motion.middle - motion.middle[count // 2]) ** 2))
    assert deviation == pytest.approx(max(averaging, np.sqrt(0.5) / rate), rel=0.02)


def test_what_is_constant_stays_constant_when_averaged():
    np.testing.assert_allclose(smoothed(np.full((3, 2), 7.0), 50), 7.0, rtol=1e-12)
