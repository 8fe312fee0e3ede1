"""How far a tracker is turned follows from any ways that turn, and from none that do not."""

import numpy as np
import pytest

from castor_envs.geometry.mounting import TURNED, fit_mount, turn_of_tracker
from castor_envs.geometry.se2 import compose, relative_pose


def path(random, circle=False):
    """Poses of a body that wanders; or one circle."""
    moves = random.normal(size=(40, 3)) * [0.3, 0.3, 0.8]
    if circle:
        moves[:] = [0.3, 0.0, 0.4]
    poses = [np.zeros(3)]
    for move in moves:
        poses.append(compose(poses[-1], move))
    return np.array(poses)


@pytest.mark.parametrize("turn", [-3.0, -1.5, -0.5, 0.5, 1.5, 3.0])
def test_any_turn_is_found_wherever_the_tracked_point_and_the_world_are(turn):
    ways = []
    for seed in range(2):
        body = path(np.random.default_rng(seed))
        ways.append((body, compose([3.0, -1.0, 2.0 + seed], compose(body, [0.1, -0.05, turn]))))
    assert turn_of_tracker(ways, 0.4) == pytest.approx(turn, abs=0.01)


def test_a_tracker_hardly_turned_or_unseen_is_not_turned():
    body = path(np.random.default_rng(1))
    assert turn_of_tracker([(body, compose(body, [0.1, 0.0, 0.8 * TURNED]))], 0.4) == 0.0
    assert turn_of_tracker([], 0.4) == 0.0
    assert turn_of_tracker([(body[:1], body[:1])], 0.4) == 0.0
    mirrored = body * [1, -1, -1]
    assert turn_of_tracker([(body, mirrored)], 0.4) == 0.0


def test_on_a_circle_another_point_of_the_body_looks_the_same():
    body = path(np.random.default_rng(1), circle=True)
    assert turn_of_tracker([(body, compose(body, [0.3, 0.3, 0.0]))], 0.4) == 0.0


def test_no_tracked_point_of_a_body_that_stands_goes_round_a_circle():
    body = path(np.random.default_rng(1), circle=True)
    seen = relative_pose(body[:-1], body[1:])
    squares = np.sum(seen[:, :2] ** 2, axis=1)
    _, *agreeing = fit_mount(seen, seen, 0.4, np.ones(len(seen)))
    _, *standing = fit_mount(np.zeros_like(seen), seen, 0.4, np.ones(len(seen)))
    assert np.max(agreeing) < 1e-6 * np.min(squares)
    assert np.all(standing > 0.9 * squares)
