"""External fixes: late ones against a smoother over time, wrong ones against none at all."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from castor_envs.geometry import se2
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Fixes
from castor_envs.vehicles.tolerances import Tolerances
from estimators import CalibratingFilter, WheelOdometry
from estimators.filtering.fixes import SAME_WAY, Belief, FixUpdates
from estimators.plugins import drives

SENSOR = Fixes(noise_position=0.02, noise_heading=0.01)
NOISE = np.array([0.02, 0.02, 0.01])
START = np.array([1.0, -2.0, 0.7])
PRIOR = np.diag([0.05, 0.03, 0.02]) ** 2
PATH = np.stack([np.linspace(0.0, 2.0, 21), 0.3 * np.sin(np.linspace(0.0, 3.0, 21)), np.linspace(0.0, 1.5, 21)], -1)
"""Poses at 0, 0.1 ... 2 s in the frame of `START`."""
NONE = np.full(3, np.nan)


def seen(k, fix=NONE, age=np.nan):
    return {"time": np.array([0.1 * k]), "fix": fix, "fix_age": np.array([age])}


def followed(fixes, path=PATH, sensor=SENSOR):
    """The belief after all samples of a path whose motion is known exactly; fixes: by sample, a fix and its age."""
    updates, belief = FixUpdates(sensor, START), Belief(path[:1], PRIOR[None], np.zeros(1))
    pose, known = path[0], []
    for k in range(len(path)):
        moved = se2.relative_pose(path[k - 1], path[k]) if k else np.zeros(3)
        later = se2.compose(belief.state, moved)
        x, y = (later - belief.state)[0, :2]
        jacobian = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        belief = Belief(later, jacobian @ belief.covariance @ jacobian.T, belief.log_likelihood)
        belief = updates.update(seen(k, *fixes.get(k, ())), belief)
        pose = belief.state[0]
        known.append(pose)
    return belief, np.array(known)


def in_world(pose):
    return se2.compose(START, pose)


def test_a_late_fix_gives_what_a_smoother_gives():
    """The pose at 0.5 s is measured, which is known at 1.2 s; the smoother corrects it there and drives on."""
    off = np.array([0.015, -0.02, 0.008])
    belief, _ = followed({12: (in_world(PATH[5] + off), 0.7)})
    x, y = PATH[5, :2] - PATH[0, :2]
    then = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    predicted = then @ PRIOR @ then.T
    turn = se2.rotation(START[2])  # the noise of x and y is the same along all axes
    measured = turn.T @ np.diag(NOISE**2) @ turn
    posterior = np.linalg.inv(np.linalg.inv(predicted) + np.linalg.inv(measured))
    pose = PATH[5] + posterior @ np.linalg.inv(measured) @ off
    expected = se2.compose(pose, se2.relative_pose(PATH[5], PATH[-1]))
    np.testing.assert_allclose(belief.state[0], expected, atol=3e-4)  # of a correction of 20 mm, the second order
    x, y = (PATH[-1] - PATH[5])[:2]
    after = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(belief.covariance[0], after @ posterior @ after.T, rtol=0.02, atol=1e-6)


def test_a_second_late_fix_knows_of_the_first():
    """Both are exact and of the same moment: the second finds nothing to correct."""
    off = np.array([0.03, 0.01, 0.01])
    twice, path = followed({10: (in_world(PATH[4] + off), 0.6), 14: (in_world(PATH[4] + off), 1.0)})
    first = path[10] - PATH[10]
    second = se2.relative_pose(PATH[14], path[14]) - se2.relative_pose(PATH[13], path[13])
    assert np.hypot(*first[:2]) > 0.02
    assert np.hypot(*second[:2]) < 0.2 * np.hypot(*first[:2])
    assert np.trace(twice.covariance[0]) < np.trace(followed({10: (in_world(PATH[4] + off), 0.6)})[0].covariance[0])


@pytest.mark.parametrize("wrong", [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [-1.5, 1.2, 3.0]])
def test_a_wrong_fix_moves_nothing(wrong):
    none, path = followed({})
    belief, seen_path = followed({8: (in_world(PATH[8] + wrong), 0.0)})
    np.testing.assert_array_equal(seen_path, path)
    np.testing.assert_array_equal(belief.covariance, none.covariance)
    assert belief.log_likelihood < none.log_likelihood


def test_two_wrong_fixes_that_do_not_fit_each_other_move_nothing():
    fixes = {8: (in_world(PATH[8] + [1.0, 0.5, 1.0]), 0.0), 15: (in_world(PATH[15] + [-1.0, 0.3, 2.0]), 0.0)}
    np.testing.assert_array_equal(followed(fixes)[1], followed({})[1])


def test_a_lost_pose_is_taken_from_two_fixes_that_fit_each_other():
    elsewhere = np.array([0.8, -0.9, 0.6])
    fixes = {k: (in_world(se2.compose(elsewhere, PATH[k])), 0.0) for k in (8, 15)}
    path = followed(fixes)[1]
    np.testing.assert_allclose(path[8], PATH[8], atol=1e-12)
    np.testing.assert_allclose(path[20], se2.compose(elsewhere, PATH[20]), atol=0.02)


def position(pose):
    """A fix of a pose in the frame of `START`, as of a beacon, that says no heading."""
    return np.array([*in_world(pose)[:2], np.nan]), 0.0


@pytest.mark.parametrize("sensor", [SENSOR, Fixes(noise_position=0.02)], ids=["a compass", "none"])
def test_two_wrong_positions_that_do_not_fit_each_other_move_nothing(sensor):
    """Metres from the pose and 0.9 m from where the second had to be, be the noise of headings stated or not."""
    fixes = {8: position(PATH[8] + [2.0, 1.0, 0.0]), 15: position(PATH[15] + [2.5, 1.8, 0.0])}
    np.testing.assert_array_equal(followed(fixes, sensor=sensor)[1], followed({})[1])


def test_a_lost_pose_is_taken_from_two_positions_that_fit_the_way_driven():
    elsewhere = np.array([0.8, -0.9, 0.0])
    path = followed({k: position(PATH[k] + elsewhere) for k in (8, 15)}, sensor=Fixes(noise_position=0.02))[1]
    np.testing.assert_allclose(path[14], PATH[14], atol=1e-12)
    np.testing.assert_allclose(path[15, :2], (PATH[15] + elsewhere)[:2], atol=0.01)


def test_a_place_is_taken_from_three_positions_as_far_apart_as_was_driven():
    """Where the heading is lost as well, ways go another way, and only their lengths agree."""
    elsewhere = np.array([0.8, 0.9, 1.0])
    there = se2.compose(elsewhere, PATH)
    path = followed({k: position(there[k]) for k in (4, 8, 12)}, sensor=Fixes(noise_position=0.02))[1]
    np.testing.assert_allclose(path[11], PATH[11], atol=1e-12)
    np.testing.assert_allclose(path[12, :2], there[12, :2], atol=0.01)


def test_the_same_way_is_recognised_but_for_one_in_a_thousand():
    assert chi2.sf(SAME_WAY, 3) == pytest.approx(1e-3)


def test_a_fix_without_a_heading_and_a_compass_say_what_they_know():
    position, _ = followed({20: (np.array([*in_world(PATH[20])[:2], np.nan]), 0.0)})
    compass, _ = followed({20: (np.array([np.nan, np.nan, in_world(PATH[20])[2] - 4 * np.pi]), 0.0)})
    none, _ = followed({})
    for belief in (position, compass):
        np.testing.assert_allclose(belief.state[0], PATH[20], atol=1e-9)
    assert np.linalg.det(position.covariance[0]) < np.linalg.det(none.covariance[0]) / 5
    prior = none.covariance[0, 2, 2]
    assert compass.covariance[0, 2, 2] == pytest.approx(1 / (1 / prior + 1 / NOISE[2] ** 2))


def test_what_is_older_than_the_drive_is_left_out():
    np.testing.assert_array_equal(followed({3: (in_world(PATH[3] + 0.01), 5.0)})[1], followed({})[1])


@pytest.fixture(scope="module", name="run")
def _run(exact_motion):
    """A differential robot's true poses and observations in 20 s, with a fix every second; every seventh is wrong."""
    true, observations = exact_motion(
        preset("differential"), lambda t: (0.3 + 0.1 * np.sin(t), 0.0, 0.6 * np.sin(0.7 * t)), 20.0
    ).sampled(400)
    random = np.random.default_rng(5)
    for k, observation in enumerate(observations):
        fix, age = NONE, np.nan
        if k % 20 == 19:
            late = int(random.integers(0, 9))
            fix, age = true[k - late] + NOISE * random.standard_normal(3), 0.05 * late
            fix = fix + (3.0 if k % 140 == 139 else 0.0)
        observation |= {"fix": fix, "fix_age": np.array([age])}
    return true, observations


def with_fixes(name, factor=1.0):
    """A preset that has fixes, its left wheel described too large by a factor."""
    robot = dataclasses.replace(preset(name), fixes=SENSOR, tolerances=Tolerances(radius=0.02, lateral=0.005))
    castor = robot.castors[0]
    wheels = (dataclasses.replace(castor.wheels[0], radius=factor * castor.wheels[0].radius), *castor.wheels[1:])
    return dataclasses.replace(robot, castors=(dataclasses.replace(castor, wheels=wheels), *robot.castors[1:]))


def farthest(path, true):
    return np.hypot(*(path - true)[len(path) // 2 :].T[:2]).max()


def test_fixes_teach_a_differential_robot_its_wheels(run, drive):
    """Two wheels cannot contradict: what is learned, is learned from fixes."""
    true, observations = run
    robot, estimator = with_fixes("differential", 1.03), CalibratingFilter()
    path = drive(estimator, robot, observations, true[0])
    wheels = preset("differential").castors[0].wheels
    ratio = estimator.geometry.radius[0] / estimator.geometry.radius[1]
    assert ratio == pytest.approx(wheels[0].radius / wheels[1].radius, rel=3e-3)
    assert farthest(path, true) < 0.04
    assert farthest(drive(WheelOdometry(), robot, observations, true[0]), true) > 0.2


def test_stacked_robots_take_their_fixes_as_single_ones_do(run, drive):
    true, observations = run
    robot = with_fixes("differential", 1.01)
    single = drive(CalibratingFilter(), robot, observations, true[0])
    nowhere = [{**seen, "fix": NONE} for seen in observations]
    alone = drive(CalibratingFilter(), robot, nowhere, true[0])
    estimator = CalibratingFilter()
    estimator.reset(robot, np.stack([true[0], true[0]]))
    for k, (one, other) in enumerate(zip(observations, nowhere, strict=True)):
        pose = estimator.update({name: np.stack([one[name], other[name]]) for name in one})
        np.testing.assert_allclose(pose, [single[k], alone[k]], atol=1e-9)


def test_a_robot_on_one_castor_is_not_taken_to_turn_about_its_pivot_without_force():
    """Wheels that roll perfectly, and rough fixes: these hardly move it. In ten starts of other noise."""
    robot = dataclasses.replace(
        preset("1-castor"), tolerances=Tolerances(), fixes=Fixes(noise_position=0.05, noise_heading=0.05)
    )
    whole, random, off = drives.winding(robot), np.random.default_rng(0), []
    for _ in range(10):
        estimator = CalibratingFilter()
        estimator.reset(robot, np.zeros(3))
        for seen in whole.observations:
            estimator.update({**seen, "fix": seen["fix"] + 0.05 * random.standard_normal(3)})
        off.append(estimator.pose - whole.pose[-1])
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.hypot(*rms[:2]) < 8e-3
    assert rms[2] < 0.02
