"""A tracked point that swings is found with its period and size; noise has no period."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.reference_drift import LEAST_GAIN, MOST, TIMES, _period, swinging

ROBOT = preset("asoc-prototype")
T = np.arange(0, 60.01, 0.05)
POSES = np.stack([np.cos(T / 9), 0.5 * np.sin(T / 5), 0.7 * T], axis=-1)


def seen_with(swing, seed=1, every=20, wrapped=False):
    """Return the finding of a log whose reference is off by `swing` (K, 3) in the body, and by noise of 1 mm, mrad."""
    noise = np.random.default_rng(seed).normal(size=POSES.shape) * 1e-3
    reference = compose(POSES, swing) + noise
    if wrapped:
        reference[:, 2] = np.angle(np.exp(1j * reference[:, 2]))
    reference[np.arange(len(T)) % every > 0] = np.nan
    log = Log(T, np.zeros((len(T), 6)), np.zeros((len(T), 3)), reference=reference)
    state = SimpleNamespace(states=[np.pad(POSES, ((0, 0), (0, 9)))], clocks=np.zeros((1, 2)), mount=np.zeros(3))
    seen: Any = SimpleNamespace(state=state)
    return swinging(ROBOT, [log], seen)


def swing(axis, size, period):
    return np.where(np.arange(3) == axis, size * np.sin(2 * np.pi * T / period + 0.4)[:, None], 0.0)


@pytest.mark.parametrize(("axis", "said"), [(0, "forward"), (1, "to the left"), (2, "turning")])
def test_a_swing_is_found_with_its_period_and_size(axis, said):
    found = seen_with(swing(axis, 4e-3, 7.3))
    assert found is not None
    assert found.verdict == "unexplained"
    assert f"swings {said} every 7." in found.reason
    assert found.chosen[0].size == pytest.approx(4e-3, rel=0.2)


@pytest.mark.parametrize("wrapped", [False, True])
def test_noise_does_not_swing(wrapped):
    for seed in range(20):
        assert seen_with(np.zeros((len(T), 3)), seed, wrapped=wrapped) is None


def test_a_tracker_that_drifts_on_a_circle_is_found():
    drift = 4e-3 * np.stack([np.cos(T / 8), np.sin(T / 8), 0 * T], axis=-1)
    c, s = np.cos(POSES[:, 2]), np.sin(POSES[:, 2])
    in_body = np.stack([c * drift[:, 0] + s * drift[:, 1], c * drift[:, 1] - s * drift[:, 0], 0 * T], axis=-1)
    found = seen_with(in_body)
    assert found is not None
    assert "the reference's place drifts slowly" in found.reason
    assert found.chosen[0].size == pytest.approx(4e-3, rel=0.1)
    assert seen_with(in_body / 100) is None


def test_neither_few_poses_nor_a_slow_drift_tell_of_a_swing():
    assert seen_with(swing(1, 4e-3, 7.3), every=120) is None
    assert seen_with(swing(1, 1.5e-3, 240.0)) is None


def test_by_chance_a_sine_takes_away_what_the_f_distribution_says():
    """P(R^2 > r) = (1 - r)^((n - 3) / 2) at one frequency; a family of them at most so many times that."""
    random, n, draws = np.random.default_rng(5), 40, 400
    gains = [_period(np.arange(float(n)), random.normal(size=(n, 1)), TIMES, MOST)[0] for _ in range(draws)]
    frequencies = 2 * (n / 2 - TIMES)
    for level in (14.0, 18.0):
        chance = frequencies * np.exp(-level / n) ** ((n - 3) / 2)
        assert np.mean(np.array(gains) > level) < chance + 3 * np.sqrt(chance / draws)
    assert frequencies * np.exp(-LEAST_GAIN / n) ** ((n - 3) / 2) < 1e-6
