"""The filter of the whole train: exact where nothing is wrong, learns offsets, outvotes what slips, knows its error."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.tasks.trains import drive as driven
from benchmarks.tasks.trains import tasks
from castor_envs.errors import Declined, InputError
from castor_envs.floor import Floor
from castor_envs.geometry.se2 import relative_pose, wrap
from castor_envs.motion.paths import random_path
from castor_envs.sensors.posture import posture
from castor_envs.vehicles.presets import cfmmr, preset
from castor_envs.vehicles.robot import Contact
from estimators import RelativePoseWarning, TrainFilter, TrainOdometry
from estimators.plugins.train_drives import winding
from estimators.trains.train_filter import GRIP, GRIPS, LOST, SLIDES, Bank, branches, merged

STIFF = Contact(slip_stiffness_long=1e6, slip_stiffness_lat=1e6)


def stiff(train):
    """The train with tyres that do not creep, as the trains of the fixture `circling`."""
    return dataclasses.replace(train, modules=tuple(dataclasses.replace(m, contact=STIFF) for m in train.modules))


def run(estimator, train, start, observations):
    estimator.reset(train, start)
    return np.array([estimator.update(seen) for seen in observations])


def noisy(train, observations, random, curvature, offsets=True):
    """Observations of a circling train whose axles slip as if gripping, and whose gauges have offsets and noise.

    Returns them, and the offsets (F, 2) of y and phi.
    """
    n, frames = train.n_axles, train.frames
    errors = [random.normal(0.0, frame.gauge_offset * offsets, len(frame.gauge_positions)) for frame in frames]
    wheels = train.modules[0].castors[0].wheels
    count = 2 * np.pi * wheels[0].radius / wheels[0].counts_per_rev
    found = []
    for seen in observations:
        way = np.abs(seen["wheel"].reshape(n, 2).mean(axis=1)) * count
        along, turn = random.normal(0.0, 1.0, (2, n)) * np.sqrt(way) * GRIP[[0, 2], None]
        slip = np.stack([along - wheels[0].lateral * turn, along - wheels[1].lateral * turn], axis=-1)
        reads = [
            posture(frame, curvature + offset + random.normal(0.0, frame.gauge_noise, len(offset)))
            for frame, offset in zip(frames, errors, strict=True)
        ]
        found.append({**seen, "wheel": seen["wheel"] - (slip / count).ravel(), "rps": np.concatenate(reads)})
    bent = np.array([posture(frame, np.full(len(frame.gauge_positions), curvature)) for frame in frames])
    read = np.array([posture(frame, curvature + offset) for frame, offset in zip(frames, errors, strict=True)])
    return found, (read - bent)[:, 1:]


@pytest.mark.parametrize("n", [2, 3, 10])
@pytest.mark.parametrize("curvature", [0.0, 0.8, -1.7])
def test_exact_on_circles_and_lines(n, curvature, circling):
    train, truth, observations = circling(n, curvature=curvature, seconds=3.0)
    poses = run(TrainFilter(), stiff(train), truth[0], observations)
    np.testing.assert_allclose(poses, truth, rtol=0, atol=2e-5)


def test_headings_stay_unwrapped_over_many_turns(circling):
    train, truth, observations = circling(2, speed=0.6, curvature=1.5, seconds=24.0)
    poses = run(TrainFilter(), stiff(train), truth[0], observations)
    assert truth[-1, 0, 2] > 6 * np.pi
    np.testing.assert_allclose(poses, truth, rtol=0, atol=1e-3)


def test_moves_and_turns_with_the_start(circling):
    train, truth, observations = circling(3, curvature=1.3, seconds=2.0)
    observations, _ = noisy(train, observations, np.random.default_rng(1), 1.3)
    psi, shift = 4.1, np.array([3.0, -7.0])
    turn = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])

    def moved(poses):
        return np.concatenate([poses[..., :2] @ turn.T + shift, poses[..., 2:] + psi], axis=-1)

    straight, turned = TrainFilter(), TrainFilter()
    expected = moved(run(straight, train, truth[0], observations))
    np.testing.assert_allclose(run(turned, train, moved(truth[0]), observations), expected, rtol=0, atol=1e-9)
    by = np.eye(3)
    by[:2, :2] = turn
    np.testing.assert_allclose(turned.covariance, by @ straight.covariance @ by.T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("curvature", [0.0, 0.8])
def test_learns_offsets_of_gauges(curvature, circling):
    """Offsets are of 12 mm and 60 mrad, noise of one reading is a quarter; a fifth of the offsets is left at most."""
    train, truth, observations = circling(3, curvature=curvature, seconds=8.0)
    for seed in range(5):
        seen, offsets = noisy(train, observations, np.random.default_rng(seed), curvature)
        estimator = TrainFilter()
        run(estimator, stiff(train), truth[0], seen)
        np.testing.assert_allclose(estimator.offsets[:, 0], offsets[:, 0], rtol=0, atol=2.5e-3)
        np.testing.assert_allclose(estimator.offsets[:, 1], offsets[:, 1], rtol=0, atol=1.2e-2)


@pytest.mark.parametrize("axle", [0, 1, 2])
@pytest.mark.parametrize("wheel", ["left", "right", "neither"])
def test_an_axle_that_slips_is_outvoted(axle, wheel, circling):
    """A wheel rolls 4 % too far, or the axle is turned by a quarter of what it rolls, unseen, for two seconds."""
    train, truth, observations = circling(3, curvature=0.8, seconds=6.0)
    seen, _ = noisy(train, observations, np.random.default_rng(axle), 0.8)
    change = {"left": (1.04, 1.0), "right": (1.0, 1.04), "neither": (1.04, 0.96)}[wheel]
    for row in seen[60:100]:
        row["wheel"][2 * axle : 2 * axle + 2] *= change
    estimator = TrainFilter()
    estimator.reset(stiff(train), truth[0])
    poses, doubted = [], []
    for row in seen:
        poses.append(estimator.update(row))
        doubted.append(estimator.slipping)
    assert np.argmax(np.mean(doubted, axis=0)) == axle
    assert np.max(doubted, axis=0)[axle] > 0.9
    by_odometry = run(TrainOdometry(), train, truth[0], seen)
    error, before = np.abs(wrap(poses[-1] - truth[-1])[:, 2]), np.abs(wrap(by_odometry[-1] - truth[-1])[:, 2])
    assert error[axle] < before[axle] / 4


def test_is_not_surer_than_it_is_right(circling):
    """Normalised squared errors of the last axle, against chi-square with three degrees a run: 99.9 %."""
    train, truth, observations = circling(3, curvature=0.8, seconds=5.0)
    squares = []
    for seed in range(40):
        seen, _ = noisy(train, observations, np.random.default_rng(100 + seed), 0.8)
        estimator = TrainFilter()
        off = run(estimator, stiff(train), truth[0], seen)[-1] - truth[-1]
        squares.append(off[2] @ np.linalg.solve(estimator.covariance[2], off[2]))
    assert np.sum(squares) < chi2.ppf(0.999, 3 * len(squares))
    assert np.mean(squares) > 0.5


def test_knows_its_error_where_axles_slip():
    """Two axles on slippery strips, where it is hardest: 5 % of the poses should lie outside the 95 % region; of 15 at
    most."""
    (task,) = (task for task in tasks(None) if task.name == "train-2-patch")
    outside = []
    for seed in range(7200, 7212):
        episode = task.record(seed)
        log = episode.runs[0].log
        assert log.reference is not None
        truth = log.reference.reshape(len(log), 2, 3)
        estimator = TrainFilter()
        train: Any = episode.robot
        estimator.reset(train, truth[0])
        for k, seen in enumerate(log.observations()):
            off = estimator.update(seen) - truth[k]
            if k >= 20 and k % 10 == 0:
                squares = off[:, None] @ np.linalg.solve(estimator.covariance, off[..., None])
                outside.append(squares.ravel() > chi2.ppf(0.95, 3))
    assert np.mean(outside) < 0.15


def test_filters_of_one_history_become_their_mixture():
    """Against samples of the mixture; a filter with another history stays as it is."""
    random = np.random.default_rng(0)
    history = np.zeros((3, 6, 2), dtype=int)
    history[2, 0, 1] = SLIDES
    root = random.normal(0.0, 0.1, (3, 12, 12))
    state, covariance = random.normal(0.0, 0.3, (3, 12)), root @ root.swapaxes(-1, -2)
    weight = np.log([1.0, 0.25, 0.5])
    bank = Bank(
        state[:, :6].reshape(3, 2, 3), state[:, 6:8, None].reshape(3, 1, 2), state[:, 8:].reshape(3, 2, 2),
        covariance, history, weight,
    )  # fmt: skip
    one = merged(bank)
    assert len(one.poses) == 2
    (both,), (alone,) = (np.flatnonzero(one.history[:, 0, 1] == mode) for mode in (GRIPS, SLIDES))
    assert one.weight[alone] - one.weight[both] == pytest.approx(np.log(0.5 / 1.25))
    np.testing.assert_allclose(one.poses[alone], bank.poses[2])
    np.testing.assert_allclose(one.covariance[alone], covariance[2])
    drawn = np.concatenate(
        [random.multivariate_normal(state[k], covariance[k], size) for k, size in ((0, 80_000), (1, 20_000))]
    )
    found = np.concatenate([part[both].ravel() for part in (one.poses, one.offsets, one.radii)])
    np.testing.assert_allclose(found, drawn.mean(axis=0), atol=5e-3)
    np.testing.assert_allclose(one.covariance[both], np.cov(drawn.T), atol=1e-2)


def test_false_alarms_on_clean_floors():
    """Drives of the full physics: an axle that grips is rarely thought to slip."""
    alarms, axles = 0, 0
    for seed in range(6):
        random = np.random.default_rng(7000 + seed)
        train = cfmmr(3)
        log = driven(train, random_path(random), Floor(), seed=seed)
        estimator = TrainFilter()
        assert log.reference is not None
        estimator.reset(train, log.reference[0].reshape(3, 3))
        for seen in log.observations():
            estimator.update(seen)
            alarms, axles = alarms + int(np.sum(estimator.slipping > 0.5)), axles + 3
    assert alarms <= 0.01 * axles


def test_a_frame_without_readings_is_helped_by_the_others(circling):
    train, truth, observations = circling(3, curvature=0.8, seconds=4.0)
    for row in observations[20:]:
        row["rps"][:3] = np.nan
    estimator = TrainFilter()
    with pytest.warns(RelativePoseWarning, match="frame A has no reading"):
        poses = run(estimator, stiff(train), truth[0], observations)
    assert estimator.status is not None
    assert "frame A" in estimator.status
    np.testing.assert_allclose(poses, truth, rtol=0, atol=1e-4)


def test_readings_that_are_late_are_taken_where_they_were():
    """Readings of 0.2 s ago, on a path that bends to and fro: as good as new ones, if their age is told."""
    random = np.random.default_rng(7100)
    train, late = cfmmr(3), 4
    log = driven(train, random_path(random), Floor(), seed=1)
    assert log.reference is not None
    truth = log.reference.reshape(len(log), 3, 3)
    fresh = list(log.observations())

    def off(age):
        seen = [
            {**row, "rps": fresh[max(k - late, 0)]["rps"], "rps_age": np.full(2, min(0.05 * k, age))}
            for k, row in enumerate(fresh)
        ]
        poses = run(TrainFilter(), train, truth[0], seen)
        return np.hypot(*(poses - truth)[..., :2].reshape(-1, 2).T).mean()

    poses = run(TrainFilter(), train, truth[0], fresh)
    expected = np.hypot(*(poses - truth)[..., :2].reshape(-1, 2).T).mean()
    assert off(0.05 * late) < expected + 0.002
    assert off(0.0) > 2 * off(0.05 * late)


def test_a_sensor_that_stops_tells_nothing_new(circling):
    """Its readings age, and repeat the last one; then odometry and the frame's length go on."""
    train, truth, observations = circling(2, curvature=0.8, seconds=2.0)
    for k, row in enumerate(observations):
        row["rps"] = row["rps"] + (0.0, 0.02, 0.1) if k == 30 else row["rps"]
        if k > 30:
            row["rps"], row["rps_age"] = observations[30]["rps"], np.array([0.05 * (k - 30)])
    estimator = TrainFilter()
    poses = run(estimator, stiff(train), truth[0], observations[:41])
    np.testing.assert_allclose(poses, truth[:41], rtol=0, atol=3e-3)


@pytest.mark.parametrize("frame", [0, 1])
def test_a_frozen_sensor_costs_what_a_lost_one_does(frame):
    """Its readings repeat as if new, while the wheels say that its frame bends: they are left out, and it is said."""
    random = np.random.default_rng(7200 + frame)
    train, at = cfmmr(3), slice(3 * frame, 3 * frame + 3)
    log = driven(train, random_path(random), Floor(), seed=2)
    assert log.reference is not None
    assert log.rps is not None
    truth = log.reference.reshape(len(log), 3, 3)
    frozen, lost = log.rps.copy(), log.rps.copy()
    frozen[len(log) // 3 :, at], lost[len(log) // 3 :, at] = log.rps[len(log) // 3 - 1, at], np.nan
    estimators = [TrainFilter() for _ in range(2)]
    with pytest.warns(RelativePoseWarning):
        poses, of_lost = (
            run(estimator, train, truth[0], dataclasses.replace(log, rps=rps).observations())
            for estimator, rps in zip(estimators, (frozen, lost), strict=True)
        )
    assert estimators[0].status is not None
    assert f"frame {'AB'[frame]} repeats its last reading" in estimators[0].status
    np.testing.assert_array_equal(poses, of_lost)


@pytest.mark.parametrize("axle", [0, 1, 2])
def test_a_start_that_is_wrong_is_corrected_by_the_first_readings(axle, circling):
    """Two axles agree with the frames; the third is believed 20 cm and 30 deg away."""
    train, truth, observations = circling(3, curvature=0.8, seconds=2.0)
    start = truth[0].copy()
    start[axle] += (0.12, -0.16, np.radians(30.0))
    poses = run(TrainFilter(), stiff(train), start, observations)
    np.testing.assert_allclose(poses[-1, :, :2], truth[-1, :, :2], rtol=0, atol=0.01)


def test_branches_are_all_single_changes_or_two_losses_and_their_probabilities_add_up():
    history = np.zeros((2, 6, 3), dtype=int)
    history[1, -1] = (0, 2, 1)
    parents, new, weight = branches(history, 0.25, moving=True)
    assert len(parents) == 2 + 12 + 4 + 2 + 3
    twice = np.sum(new != history[parents, -1], axis=1) > 1
    assert (np.sum(new[twice] == LOST, axis=1) == 2).all()
    assert (parents[twice] == 0).all()
    for parent in (0, 1):
        assert np.exp(weight[parents == parent]).sum() == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("seconds", [0.25, 60.0])
def test_probabilities_stay_so_after_gaps(seconds):
    history = np.zeros((2, 6, 2), dtype=int)
    history[1, :, 0] = SLIDES
    _, _, weight = branches(history, seconds, moving=True)
    assert np.isfinite(weight).all()
    assert (weight < 0).all()


def test_a_train_that_stands_is_pushed_at_most():
    history = np.zeros((2, 6, 3), dtype=int)
    history[1, -1] = (0, 2, LOST)
    parents, new, weight = branches(history, 0.25, moving=False)
    old = history[parents, -1]
    assert ((new == old) | (new == LOST) | (old == LOST)).all()
    assert len(parents) == 2 + 3 + 2 + 3
    for parent in (0, 1):
        assert np.exp(weight[parents == parent]).sum() == pytest.approx(1.0, abs=0.02)


def test_an_axle_slips_more_probably_where_another_slipped_just_now():
    """Odds of the second axle's slip against none: larger while the first slips and a moment later, not long after."""
    history = np.zeros((3, 6, 2), dtype=int)
    history[0, -3:, 0] = history[1, 2, 0] = SLIDES
    parents, new, weight = branches(history, 0.25, moving=True)

    def odds(parent):
        ((begins,), (stays,)) = (
            weight[(parents == parent) & (new == (history[parent, -1, 0], mode)).all(axis=1)]
            for mode in (SLIDES, GRIPS)
        )
        return begins - stays

    assert odds(0) == pytest.approx(odds(1))
    assert odds(0) > odds(2) + 1.0


@pytest.mark.parametrize("spin", [(0,), (1,), (2,), (0, 2), (0, 1)])
def test_axles_whose_wheels_spin_while_the_train_stands_are_found(spin, circling):
    """Their wheels turn them by 40 deg within 0.2 s, as they say, at once; nothing moves."""
    train, truth, observations = circling(3, curvature=0.8, seconds=4.0)
    seen, _ = noisy(train, observations, np.random.default_rng(spin[0]), 0.8)
    wheels = train.modules[0].castors[0].wheels
    turned = [-np.radians(10.0) * w.lateral / w.radius * (w.counts_per_rev or np.nan) / (2 * np.pi) for w in wheels]
    after = []
    for k in range(60):
        counts = np.zeros(6)
        for axle in spin:
            counts[2 * axle : 2 * axle + 2] = np.round(turned) * (k < 4)
        now = {"time": seen[0]["time"] + 0.05 * (len(seen) + k), "wheel": counts, "rps": seen[-1 - k]["rps"]}
        after.append({**seen[-1], **now})
    by_odometry = run(TrainOdometry(), train, truth[0], [*seen, *after])
    poses = run(TrainFilter(), stiff(train), truth[0], [*seen, *after])
    assert (np.abs(by_odometry[-1, spin, 2] - truth[-1, spin, 2]) > np.radians(35.0)).all()
    np.testing.assert_allclose(poses[-1], truth[-1], rtol=0, atol=0.02)


def test_robots_are_declined_and_wrong_poses_named():
    robot: Any = preset("differential")
    with pytest.raises(Declined, match="serves trains"):
        TrainFilter().reset(robot, np.zeros((1, 3)))
    with pytest.raises(InputError, match="starts at poses of shape"):
        TrainFilter().reset(cfmmr(3), np.zeros((2, 3)))


def test_relative_poses_of_the_circle_are_those_of_its_frames(circling):
    """The fixture's frames are bent as the sensor computes them: what these tests rest on."""
    train, truth, observations = circling(2, curvature=0.8)
    np.testing.assert_allclose(relative_pose(truth[0, 1], truth[0, 0]), observations[0]["rps"], atol=1e-12)
    np.testing.assert_allclose(posture(train.frames[0], np.full(4, 0.8)), observations[0]["rps"], atol=1e-9)


@pytest.mark.parametrize("samples", [20, 40, 60])
def test_a_gap_makes_it_as_unsure_as_the_path_in_it_is_unknown(samples):
    """Of 1 to 3 s on a winding way: frames contradict where odometry ends, and its headings stay what they are."""
    train = cfmmr(3)
    whole, squares, headings = winding(train), [], []
    counts = np.cumsum([seen["wheel"] for seen in whole.observations], axis=0)
    for first in range(40, len(whole.pose) - samples - 1, 20):
        rows = np.r_[:first, first + samples : min(first + samples + 20, len(whole.pose))]
        seen = [
            {**whole.observations[row], "wheel": wheel}
            for row, wheel in zip(rows, np.diff(counts[rows], axis=0, prepend=counts[:1]), strict=True)
        ]
        estimator = TrainFilter()
        off = run(estimator, train, whole.pose[0], seen)[-1] - whole.pose[rows[-1]]
        squares.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(estimator.covariance), off))
        headings.append(np.abs(off[:, 2]).max())
    assert np.mean(squares) < 3.0
    assert np.max(headings) < 0.02
