"""Headings from positions: exact where odometry is, near where it drifts, the same in any world of the reference."""

import numpy as np
import pytest

from castor_envs.geometry.positions import headings_along
from castor_envs.geometry.se2 import compose

SIZE = 0.3
S = np.linspace(0.0, 30.0, 61)
PATH = np.column_stack([4 * np.sin(S / 4), 2 * np.sin(S / 2), 1.5 * np.sin(S / 3) + S / 5])
"""Poses of a body that moves forward, to the side, and turns."""


def blank(poses):
    return poses * [1.0, 1.0, np.nan]


@pytest.mark.parametrize("point", [(0.0, 0.0), (0.2, -0.1)])
@pytest.mark.parametrize("world", [(0.0, 0.0, 0.0), (7.0, -3.0, 2.5)])
def test_headings_of_an_exact_path_are_found_in_any_world_and_from_any_tracked_point(point, world):
    true = compose(world, PATH)
    found = headings_along(PATH, blank(compose(true, [*point, 0.0])), S, SIZE)
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * true[:, 2]), atol=0.01 if any(point) else 1e-9)


def test_odometry_that_drifts_is_followed():
    """By 2 rad in all, of which the windows of 16 steps out of 60 see a part."""
    drift = S / 15
    steps = np.diff(PATH[:, :2] @ [1, 1j]) * np.exp(1j * (drift[1:] + drift[:-1]) / 2)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    odometry = np.column_stack([np.real(way), np.imag(way), PATH[:, 2] + drift])
    assert np.abs(headings_along(odometry, blank(PATH), S, SIZE) - PATH[:, 2]).max() < 0.3
    inner = slice(10, -10)
    assert np.abs(headings_along(odometry, blank(PATH), S, SIZE) - PATH[:, 2])[inner].max() < 0.1


def test_a_robot_that_waits_keeps_its_heading():
    still = np.concatenate([np.arange(20), np.full(200, 20), np.arange(20, 61)])
    noise = 1e-3 * np.random.default_rng(0).normal(size=(len(still), 2))
    seen = blank(PATH[still]) + np.column_stack([noise, np.zeros(len(still))])
    found = headings_along(PATH[still], seen, S[still] + 1e-7 * np.arange(len(still)), SIZE)
    np.testing.assert_allclose(found, PATH[still, 2], atol=0.02)


def test_headings_that_are_known_stay_and_tell_the_turns_of_the_others():
    turned = PATH + np.array([0.0, 0.0, 4 * np.pi])
    seen = blank(turned)
    seen[[3, 40], 2] = turned[[3, 40], 2]
    found = headings_along(PATH, seen, S, SIZE)
    np.testing.assert_array_equal(found[[3, 40]], turned[[3, 40], 2])
    np.testing.assert_allclose(found, turned[:, 2], atol=1e-9)


def test_one_position_turns_nothing():
    np.testing.assert_array_equal(headings_along(PATH[:1], blank(PATH[:1]), S[:1], SIZE), PATH[:1, 2])
