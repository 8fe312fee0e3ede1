"""Logs that are noisier than clean ones, as nothing of the catalogue makes them."""

import dataclasses
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import TickLoss
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.noise_excess import LOUDER, louder_than, ratios
from discrepancy.inference.evidence import evidence_of
from discrepancy.inference.forward_selection import HIDDEN, diagnose
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.log_likelihood import Noise

pytestmark = pytest.mark.slow

ROBOT = preset("asoc-prototype")


@cache
def driven(seed, *effects):
    motion = wander(np.random.default_rng([seed, 1]), duration=26.0)
    return drive(ROBOT.with_effects(*effects), motion, seed, duration=26.0)


CLEAN = 21, 22


def clean():
    return [driven(seed) for seed in CLEAN]


def shaken(log, size, seed=0):
    """The log with more noise in its reference's position, of `size` (m) in all."""
    reference = log.reference.copy()
    more = np.random.default_rng(seed).normal(size=(len(log), 2)) * np.sqrt(size**2 - 1e-6)
    reference[:, :2] += more
    return dataclasses.replace(log, reference=reference)


def jumping(log, wheel, counts, seed=0):
    """The log with a wheel's counter that jumps up or down, about once in two seconds, and stays there."""
    random = np.random.default_rng(seed)
    hits = random.uniform(size=len(log)) < 0.5 * np.median(np.diff(log.t))
    more = np.zeros_like(log.wheel)
    more[:, wheel] = np.cumsum(hits * random.choice([-counts, counts], size=len(log)))
    return dataclasses.replace(log, wheel=log.wheel + more)


def test_a_noisier_reference_is_told():
    found = diagnose(ROBOT, [shaken(driven(23), 3e-3)], [shaken(driven(24), 3e-3, 1)], clean())
    assert found.verdict == "unexplained"
    assert "noise of the reference's position" in found.reason


def test_held_out_logs_must_be_noisier_too():
    found = diagnose(ROBOT, [shaken(driven(23), 3e-3)], [driven(24)], clean())
    assert found.verdict == "no discrepancy", found.reason


@pytest.mark.parametrize(("size", "told"), [(1.2e-3, False), (2e-3, True)])
def test_a_size_of_noise_counts_where_it_surely_is_another(size, told):
    good, seen = evidence_of(ROBOT, clean(), among=()), evidence_of(ROBOT, [shaken(driven(23), size)], among=())
    louder = ratios(good, seen, LOUDER)
    assert set(louder) == ({"position"} if told else set())
    if told:
        assert louder["position"] == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize(("before", "after", "told"), [(3.0, 2.0, True), (40.0, 2.0, False), (40.0, 5.0, True)])
def test_what_large_effects_leave_is_measured_by_what_they_take_away(before, after, told):
    """Of the squares of noise beyond that of clean logs: 3 of 8, 3 of 1599, 24 of 1599."""

    def noisy(times) -> Any:
        return SimpleNamespace(noise=Noise(1e-5 * times, 1e-5, 1e-3, 1e-3), steps=800, poses=40)

    found = louder_than(noisy(1.0), noisy(before), noisy(after), lambda: noisy(after))
    assert (found is not None) == told


def test_beside_noise_that_nothing_explains_no_name_is_sure():
    radius = WheelRadius(castor=1, wheel=1, value=4e-4)
    logs = [jumping(driven(seed, radius), 4, 6, seed) for seed in (23, 24)]
    found = diagnose(ROBOT, logs[:1], logs[1:], clean())
    assert found.effects == ()
    assert any(one.verdict == "unexplained" for one in found.findings)


def test_the_speed_from_which_on_counts_are_lost_is_found():
    effect = TickLoss(castor=2, wheel=1, value=0.004, above=3.7)
    found = diagnose(ROBOT, [driven(23, effect)])
    assert found.verdict == "named", found.reason
    (named,) = found.effects
    assert isinstance(named, TickLoss)
    assert (named.castor, named.wheel, named.direction) == (2, 1, "forward")
    assert named.above == pytest.approx(effect.above, abs=0.7)
    assert named.value == pytest.approx(effect.value, rel=0.1)
    (error,) = [one.error for one in found.findings if one.error is not None]
    assert error > HIDDEN * named.value
