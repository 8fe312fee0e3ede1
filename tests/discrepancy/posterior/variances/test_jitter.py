"""Jitter that is put in by hand comes out with its size, its probability and its interval; nothing else does."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.clocks import SampleJitter
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.variances.jitter import jitter_answer

ROBOT, NAMES, STAMPS = preset("differential"), 50, np.arange(0, 60, 0.05)


def log_of(seed, size=0.0):
    """Return a log of two wheels that speed up and slow down smoothly, read early or late by `size` s (rms), but by no
    more than half a sample."""
    times = STAMPS + np.clip(size * np.random.default_rng(seed).normal(size=len(STAMPS)), -0.025, 0.025)
    angle = 8 * times[:, None] - 3 / 0.7 * np.cos(0.7 * times + seed)[:, None] * [1, -1]
    wheel = np.floor(angle * ROBOT.castors[0].wheels[0].counts_per_rev / (2 * np.pi))
    return Log(STAMPS, wheel - wheel[0], np.empty((len(STAMPS), 0)))


def answer(log, held_out=(), clean=()) -> Any:
    return jitter_answer(ROBOT, [log], held_out, clean, NAMES)


@pytest.mark.parametrize("size", [0.002, 0.005, 0.015, 0.035])
def test_intervals_hold_what_was_put_in(size):
    off = []
    for seed in range(20):
        found = answer(log_of(seed, size))
        assert found.effect.name == "sample_jitter"
        off.append((found.size - size) / found.error)
    assert np.sqrt(np.mean(np.square(off))) < 1.5
    assert np.mean(np.abs(off) < 1.96) >= 0.85


@pytest.mark.parametrize("seed", range(5))
def test_no_more_jitter_than_in_clean_logs_is_not_reported(seed):
    assert answer(log_of(seed)) is None
    assert answer(log_of(seed, 0.005), clean=[log_of(seed + 10, 0.005)]) is None
    assert answer(log_of(seed, 0.010), clean=[log_of(seed + 10, 0.005)]) is not None


def test_held_out_logs_confirm_jitter_or_deny_it():
    log = log_of(1, 0.005)
    assert answer(log, held_out=[log_of(2, 0.005)]).confirmed > 3
    assert answer(log, held_out=[log_of(2)]).confirmed < -3
    assert answer(log).confirmed is None


@pytest.mark.parametrize("value", [0.001, 0.02, 0.05])
def test_times_within_half_a_sample_have_the_deviation_of_draws(value):
    drawn = np.clip(value * np.random.default_rng(1).normal(size=200_000), -0.025, 0.025)
    assert SampleJitter.deviation(np.array([value]), 0.05)[0] == pytest.approx(np.std(drawn), rel=0.01)


def test_what_it_costs_is_in_proportion_to_its_size():
    found = answer(log_of(1, 0.005))
    assert found.cost[0] > 0
    assert dataclasses.replace(found, amplitudes=2 * found.amplitudes).effect.value == pytest.approx(2 * found.size)
