"""Encoders as a state's counts hold them: where a backlash leaves the shaft free, worked out by hand."""

import numpy as np
import pytest

from castor_envs.effects.clocks import AllLatency
from castor_envs.effects.encoders import PivotBacklash
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from estimators.likelihood.channels import HELD, LOBES, Channels

ROBOT, BACKLASH = preset("asoc-prototype"), 0.2


def turned_there_and_back():
    """A log in which the second castor turns from 0 to 1 rad and back in steps of 0.05 rad, and its counts (K, s +
    d)."""
    channels = Channels(ROBOT)
    angle = np.concatenate([np.arange(0, 21), np.arange(19, -1, -1)]) * 0.05
    counts = np.zeros((len(angle), len(channels.per_rev)))
    counts[:, 1] = (angle + channels.geometry.pivot_zero[1]) * channels.per_rev[1] / (2 * np.pi)
    sensed = len(channels.sensed)
    log = Log(0.05 * np.arange(len(angle)), np.round(counts[:, sensed:]), np.round(counts[:, :sensed]))
    return channels, log, counts


def test_a_reading_stands_still_until_the_shaft_has_turned_by_the_backlash():
    """It begins in the middle, and so is free for the first half of the backlash, and for all of it on the way back."""
    channels, log, counts = turned_there_and_back()
    play = channels.play(ROBOT.with_effects(PivotBacklash(castor=2, value=BACKLASH)), log, counts, held=False)
    free = np.flatnonzero(play[:, 1])
    np.testing.assert_array_equal(free, [0, 1, 21, 22, 23])  # 0.1 rad after the start and 0.2 rad after 1 rad it turns
    expected = BACKLASH / np.sqrt(12) * channels.per_rev[1] / (2 * np.pi)
    assert play[free, 1] == pytest.approx(expected, rel=1e-9)
    assert not np.delete(play, 1, axis=1).any()


def test_a_shaft_that_is_held_is_as_free_as_it_is_far_within_the_backlash():
    """On its way back it is 0.05, 0.1 and again 0.05 rad from an end; it begins in the middle and turns by 0.05 rad."""
    channels, log, counts = turned_there_and_back()
    play = channels.play(ROBOT.with_effects(PivotBacklash(castor=2, value=BACKLASH)), log, counts, held=True)
    depth = np.array([0.1, 0.05, 0.05, 0.1, 0.05])
    expected = np.minimum(HELD * depth, BACKLASH / np.sqrt(12)) * channels.per_rev[1] / (2 * np.pi)
    assert play[[0, 1, 21, 22, 23], 1] == pytest.approx(expected, rel=1e-9)
    assert np.count_nonzero(play) == 5


def test_without_a_backlash_every_reading_follows():
    channels, log, counts = turned_there_and_back()
    assert not channels.play(ROBOT, log, counts, held=False).any()


@pytest.mark.parametrize("periods", [0.3, 0.5, 1.0, 1.7])
def test_noise_of_a_late_encoder_keeps_its_variance(periods):
    """Half of the noise of two neighbours each has half the variance: logs would be likelier with encoders late by half
    a period."""
    noise = np.random.default_rng(1).normal(size=(2000, 9))
    t = np.arange(2000) * 0.05
    robot = preset("asoc-prototype")
    moved = Channels(robot).undelayed(
        robot.with_effects(AllLatency(value=0.05 * periods)), Log(t, noise[:, 3:], noise[:, :3]), noise
    )
    assert np.var(moved) == pytest.approx(np.var(noise), rel=0.02)
    if periods == 1.0:
        assert moved[:-1] == pytest.approx(noise[1:])


def test_a_slow_excess_of_a_late_encoder_is_what_it_was_when_it_was_read():
    t = np.arange(400) * 0.05
    slow = np.sin(2.0 * t)[:, None] * np.ones(9)
    robot = preset("asoc-prototype")
    late = robot.with_effects(AllLatency(value=0.12))
    moved = Channels(robot).undelayed(late, Log(t, slow[:, 3:], slow[:, :3]), slow)
    inside = slice(LOBES, -LOBES)
    assert moved[inside, 0] == pytest.approx(np.sin(2.0 * (t[inside] + 0.12)), abs=0.02)
