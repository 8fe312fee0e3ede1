"""Metrics of trains, against numbers computed by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scoring import train_metrics
from benchmarks.scoring.path_metrics import STANDING_STILL
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks.task import Episode, Run
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr

STRAIGHT = np.array([[0.7, 0, 0], [0.35, 0, 0], [0, 0, 0]])
"""Three axles in a straight line, as their frames see them too."""


def episode(*beliefs, sound=(), rps=(0.35, 0, 0, 0.35, 0, 0), samples=3):
    """Return an episode of a train that rests straight; a belief makes a run a snapshot, None a drive."""
    t = 0.5 * np.arange(samples)
    log = Log(
        t,
        np.zeros((samples, 6)),
        np.empty((samples, 0)),
        reference=np.tile(STRAIGHT.ravel(), (samples, 1)),
        rps=np.tile(rps, (samples, 1)),
    )
    return Episode(cfmmr(3), tuple(Run(log, belief=b, sound=() if b is None else sound) for b in beliefs))


def off(axle, x=0.0, y=0.0, psi=0.0):
    """Return the straight train with an axle (from 1) put elsewhere."""
    poses = STRAIGHT.copy()
    poses[axle - 1] += x, y, psi
    return poses


def test_axle_errors_by_hand():
    estimate = np.stack([STRAIGHT, off(1, 0.03, 0.04, -0.2), off(2, 0.12, -0.05, 2 * np.pi + 0.1)], axis=1)
    run = episode(None).runs[0]
    scores = score(episode(None), [estimate])
    assert run.truth.shape == estimate.shape == (3, 3, 3)
    assert scores["mean_axle_position"] == pytest.approx((0.05 + 0.13) / 9)
    assert scores["final_axle_position"] == pytest.approx(0.13 / 3)
    assert scores["final_axle_heading"] == pytest.approx(0.1 / 3)
    assert scores["share_within_5cm"] == 1.0
    assert scores["ate"] == pytest.approx((0.05 + 0.13) / np.sqrt(3) / 3)
    assert scores[STANDING_STILL] == 0.0


def test_near_is_below_5_cm_on_average_at_a_sample():
    estimate = np.stack([off(1, 0.149), off(1, 0.151), off(2, 0.10)], axis=1)
    assert score(episode(None), [estimate])["share_within_5cm"] == pytest.approx(2 / 3)


def test_a_snapshot_is_scored_at_its_end_alone():
    belief = off(2, 0.3)
    snapshot = episode(belief)
    (run,) = snapshot.runs
    np.testing.assert_array_equal(run.samples, [2])
    np.testing.assert_array_equal(run.truth, STRAIGHT[:, None])
    np.testing.assert_array_equal(run.start, belief)
    scores = score(snapshot, [belief[:, None]])
    assert scores["mean_axle_position"] == scores["final_axle_position"] == pytest.approx(0.1)
    assert not {"ate", STANDING_STILL} & scores.keys()


def test_which_axle_was_kept_is_counted_where_exactly_one_was():
    belief = off(1, 0.3)
    moved = np.add(belief, [0.01, 0, 0])
    first, second, all_three, no_axle = moved.copy(), moved.copy(), belief.copy(), moved
    first[0], second[1] = belief[0], belief[1]
    first[1, 2] += 0.5
    snapshots = episode(*[belief] * 5, sound=(2, 3))
    found = score(snapshots, [e[:, None] for e in (first, second, second, all_three, no_axle)])
    assert found["sound_axle_chosen"] == pytest.approx(2 / 3)
    for estimate in (all_three, no_axle):
        assert "sound_axle_chosen" not in score(episode(belief, sound=(2, 3)), [estimate[:, None]])
    assert "sound_axle_chosen" not in score(episode(belief), [second[:, None]])


@pytest.mark.parametrize("change", [(2e-9, 0, 0), (0, 2e-9, 0), (0, 0, 2e-9)])
def test_kept_means_all_of_the_pose(change):
    belief = off(1, 0.3)
    estimate = np.add(belief, [[0, 0, 0], [1, 0, 0], [1, 0, 0]])
    assert train_metrics.kept_axle(belief, estimate) == 1
    estimate[0] += change
    assert train_metrics.kept_axle(belief, estimate) is None


def test_contradiction_by_hand():
    """Axle 2 turned by 90 deg sees axle 1, 0.35 m ahead in N, on its right; axle 3 sees axle 2 as before."""
    estimate = np.stack([off(2, psi=np.pi / 2)] * 3, axis=1)
    assert score(episode(None), [estimate])["contradiction"] == pytest.approx(np.hypot(0.35, 0.35) / 2)
    missing = episode(None, rps=(0.35, 0, 0, np.nan, np.nan, np.nan))
    assert score(missing, [estimate])["contradiction"] == pytest.approx(np.hypot(0.35, 0.35))
    nothing = episode(None, rps=[np.nan] * 6)
    assert "contradiction" not in score(nothing, [estimate])


poses = st.lists(st.tuples(*[st.floats(-3, 3)] * 3), min_size=3, max_size=3).map(np.array)


@given(poses, st.tuples(*[st.floats(-3, 3)] * 3), st.integers(-2, 2))
def test_moving_the_world_and_whole_turns_change_nothing(estimate, motion, turns):
    def moved(p):
        z = (p[:, 0] + 1j * p[:, 1]) * np.exp(1j * motion[2]) + motion[0] + 1j * motion[1]
        return np.stack([z.real, z.imag, p[:, 2] + motion[2] + 2 * np.pi * turns], axis=-1)

    def errors(true, estimated):
        true, estimated = true[:, None], estimated[:, None]
        rps = [[0.35, 0.01, 0.1, 0.34, 0.02, 0.2]]
        return np.concatenate(
            [
                train_metrics.axle_position_errors(true, estimated),
                train_metrics.axle_heading_errors(true, estimated),
                train_metrics.contradictions(estimated, rps),
            ]
        )

    moved_poses = moved(STRAIGHT)
    moved_poses[:, 2] += 2 * np.pi
    np.testing.assert_allclose(errors(moved_poses, moved(estimate)), errors(STRAIGHT, estimate), atol=1e-12)
    assert train_metrics.axle_heading_errors(STRAIGHT, estimate).max() <= np.pi + 1e-12


def test_the_truth_scores_zero_and_is_always_near():
    drive = episode(None, None)
    scores = score(drive, [run.truth for run in drive.runs])
    assert scores.pop("share_within_5cm") == 1.0
    assert set(scores.values()) == {0.0}
    assert scores.keys() <= {*BOARD_METRICS, STANDING_STILL}
