"""Jitter of a size that is put in by hand comes out as large, and nothing else is taken for it."""

import numpy as np
import pytest

from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.variances.jitter import LEAST_JITTER, jitter_of

ROBOT = preset("differential")
PER_REV = 2000


def log_of(times, stamps=None, jerk=0.0, seed=0, rate=0.7, mean=8.0):
    """A log of two wheels that speed up and slow down smoothly, at `rate` (rad/s) about a mean speed (rad/s), read at
    `times` and recorded as read at `stamps`."""
    random = np.random.default_rng(seed)
    fine = np.linspace(-1, 61, 62001)
    speed = mean + 3 * np.sin(rate * fine)[:, None] * [1, -1]
    if jerk:
        speed = speed + jerk * np.repeat(random.normal(size=(1241, 2)), 50, axis=0)[: len(fine)]
    angle = np.cumsum(speed, axis=0) * (fine[1] - fine[0])
    turned = np.column_stack([np.interp(times, fine, column) for column in angle.T])
    wheel = np.floor(turned * PER_REV / (2 * np.pi))
    return Log(times if stamps is None else stamps, wheel - wheel[0], np.empty((len(times), 0)))


@pytest.mark.parametrize("size", [0.001, 0.004])
def test_jitter_is_as_large_as_it_was_made(size):
    even = np.arange(0, 60, 0.05)
    read = even + size * np.random.default_rng(1).normal(size=len(even))
    found = jitter_of(ROBOT, [log_of(read, even)])
    assert found is not None
    assert found.value == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_jitter_is_seen_between_many_short_pauses(seed):
    """A robot that swings to and fro pauses at every turning: differences before and after a pause are not alike."""
    even = np.arange(0, 60, 0.05)
    read = even + 0.01 * np.random.default_rng(seed).normal(size=len(even))
    found = jitter_of(ROBOT, [log_of(read, even, rate=3.0, mean=0.0)])
    assert found is not None
    assert found.value == pytest.approx(0.01, rel=0.2)


def test_a_steady_log_has_none():
    even = np.arange(0, 60, 0.05)
    assert jitter_of(ROBOT, [log_of(even)]) is None


def test_uneven_samples_whose_times_are_known_are_no_jitter():
    even = np.arange(0, 60, 0.05)
    read = even + 0.004 * np.random.default_rng(1).uniform(-1, 1, size=len(even))
    assert jitter_of(ROBOT, [log_of(read)]) is None
    assert jitter_of(ROBOT, [log_of(read, even)]) is not None


def test_a_jerky_drive_is_no_jitter():
    """Speeds that jump every sample leave as much in differences, but neighbours of it are less alike."""
    even = np.arange(0, 60, 0.05)
    rough = log_of(even, jerk=0.3)
    shaken = log_of(even + 2 * LEAST_JITTER * np.random.default_rng(1).normal(size=len(even)), even)
    assert np.std(np.diff(rough.wheel, n=6, axis=0)) > np.std(np.diff(shaken.wheel, n=6, axis=0))
    assert jitter_of(ROBOT, [rough]) is None
    assert jitter_of(ROBOT, [shaken]) is not None


def test_a_log_too_short_has_none():
    assert jitter_of(ROBOT, [log_of(np.arange(10) * 0.05)]) is None


def test_samples_that_are_late_at_some_times_only_are_no_jitter():
    """A computer that stalls twice for half a second; jitter is always there."""
    even = np.arange(0, 60, 0.05)
    stalled = (np.abs(even - 20) < 0.25) | (np.abs(even - 40) < 0.25)
    found = jitter_of(ROBOT, [log_of(even), log_of(even - 0.02 * stalled, even)])
    assert found is not None
    assert found.seldom in [f"at {at:.1f} s of log 2" for at in np.arange(19.5, 41, 0.1)]
    shaken = jitter_of(ROBOT, [log_of(even + 0.001 * np.random.default_rng(1).normal(size=len(even)), even)])
    assert shaken is not None
    assert not shaken.seldom


@pytest.mark.parametrize("size", [0.0, 0.004])
def test_castors_that_motors_turn_at_once_are_read_in_time(size):
    """A swerve stops every 6 s and turns all castors by a radian, as servos do: fast at once, then more slowly."""
    robot, even = preset("swerve"), np.arange(0, 60, 0.05)
    read = even + size * np.random.default_rng(1).normal(size=len(even))
    fine = np.linspace(-1, 61, 62001)
    rolled = np.cumsum(8 * np.sin(np.pi * np.clip(fine % 6.0 / 5.0, 0, 1)) ** 2) * (fine[1] - fine[0])
    turned = np.floor(fine / 6.0) + 1 - np.exp(-np.maximum(fine % 6.0 - 5.0, 0.0) / 0.06)
    wheel, pivot = (
        np.tile(np.floor(np.interp(read, fine, angle) * per_rev / (2 * np.pi))[:, None], (1, 4))
        for angle, per_rev in (
            (rolled, robot.wheels[0].counts_per_rev),
            (turned, robot.castors[0].pivot_counts_per_rev),
        )
    )
    found = jitter_of(robot, [Log(even, wheel - wheel[0], pivot % robot.castors[0].pivot_counts_per_rev)])
    assert (0.0 if found is None else found.value) == pytest.approx(size, rel=0.05)
