"""Symmetries that every estimator here must have."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators import CAST, IPEC, CASTArc, DeadReckoning, HolmbergKhatib, TidyBot, WheelOdometry

pytestmark = pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")

ESTIMATORS = [
    DeadReckoning(1),
    DeadReckoning(2),
    IPEC(1),
    IPEC(3),
    CAST(0),
    CAST(2),
    CAST(0, step="euler"),
    CASTArc(0),
    CASTArc(1),
    WheelOdometry(),
    HolmbergKhatib(),
    TidyBot(),
]


def name(estimator):
    return f"{type(estimator).__name__}-{'-'.join(str(value) for value in vars(estimator).values())}"


all_estimators = pytest.mark.parametrize("estimator", ESTIMATORS, ids=name)


@all_estimators
@given(st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-20, 20)), st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_moved_and_turned_start_moves_and_turns_the_path(estimator, odd_robot, noise, drive, start, seed):
    robot = odd_robot(3, centred=False)
    observations = noise(robot, seed)
    x, y, psi = drive(estimator, robot, observations).T
    moved = drive(estimator, robot, observations, start)
    z = complex(*start[:2]) + (x + 1j * y) * np.exp(1j * start[2])
    np.testing.assert_allclose(moved, np.stack([z.real, z.imag, psi + start[2]], axis=-1), atol=1e-9)


@all_estimators
def test_mirrored_robot_with_mirrored_counts_goes_the_mirrored_path(estimator, odd_robot, noise, drive):
    robot = odd_robot(3, centred=False)
    castors = []
    for castor in robot.castors:
        wheels = tuple(dataclasses.replace(wheel, lateral=-wheel.lateral) for wheel in reversed(castor.wheels))
        mirrored = (castor.pivot[0], -castor.pivot[1])
        castors.append(dataclasses.replace(castor, pivot=mirrored, wheels=wheels, pivot_zero=-castor.pivot_zero))
    mirror_robot = dataclasses.replace(robot, castors=tuple(castors))
    observations = noise(robot)
    swapped = [{**seen, "wheel": seen["wheel"][[1, 0, 3, 2, 5, 4]], "pivot": -seen["pivot"]} for seen in observations]
    path = drive(estimator, robot, observations, (1.0, 2.0, 0.3))
    mirror = drive(estimator, mirror_robot, swapped, (1.0, -2.0, -0.3))
    np.testing.assert_allclose(mirror, path * [1.0, -1.0, -1.0], atol=1e-12)


@all_estimators
def test_scaled_robot_with_the_same_counts_goes_the_scaled_path(estimator, odd_robot, noise, drive):
    robot = odd_robot(3, centred=False)
    castors = []
    for castor in robot.castors:
        wheels = tuple(
            dataclasses.replace(wheel, lateral=3 * wheel.lateral, radius=3 * wheel.radius) for wheel in castor.wheels
        )
        pivot = (3 * castor.pivot[0], 3 * castor.pivot[1])
        castors.append(dataclasses.replace(castor, pivot=pivot, wheels=wheels, offset=3 * castor.offset))
    larger = dataclasses.replace(robot, castors=tuple(castors))
    observations = noise(robot)
    path, larger_path = drive(estimator, robot, observations), drive(estimator, larger, observations)
    np.testing.assert_allclose(larger_path, path * [3.0, 3.0, 1.0], atol=1e-10)


@pytest.mark.parametrize("step", ["arc", "midpoint"])
def test_fixed_castor_run_backwards_ends_where_it_began(step, odd_robot, noise, drive):
    """Steps that look half way are the same from either end; heading-first Euler's are not."""
    castor = dataclasses.replace(
        odd_robot(1).castors[0], steering="fixed", angle=0.7, pivot_counts_per_rev=None, pivot_zero=0.0
    )
    robot = RobotDescription(name="one fixed castor", castors=(castor,))
    observations = noise(robot)
    reverse = [{**seen, "wheel": -seen["wheel"]} for seen in observations[::-1]]
    np.testing.assert_allclose(drive(DeadReckoning(step=step), robot, [*observations, *reverse])[-1], 0.0, atol=1e-12)
    euler = drive(DeadReckoning(step="euler"), robot, [*observations, *reverse])[-1]
    assert np.abs(euler).max() > 1e-4


@all_estimators
def test_wrapped_and_unwrapped_pivot_counts_are_the_same(estimator, odd_robot, exact_motion, winding, drive):
    robot = odd_robot(3)
    _, observations = exact_motion(robot, winding, 10.0).sampled(200)
    turn = np.array([castor.pivot_counts_per_rev for castor in robot.castors])
    wrapped = [{**seen, "pivot": seen["pivot"] % turn} for seen in observations]
    assert any(np.any(a["pivot"] != b["pivot"]) for a, b in zip(wrapped, observations, strict=True))
    a, b = drive(estimator, robot, wrapped), drive(estimator, robot, observations)
    np.testing.assert_allclose(a, b, atol=1e-9)


@all_estimators
def test_batch_gives_what_singles_give(estimator, odd_robot, noise, drive):
    """Robots that differ in every number, runs that differ in data and start: (robots, runs) at once and one by one."""
    base = odd_robot(3, centred=False)
    random = np.random.default_rng(5)

    def changed(castor):
        factors = random.uniform(0.9, 1.1, 8)
        wheels = tuple(
            dataclasses.replace(w, lateral=w.lateral * factors[k], radius=w.radius * factors[2 + k])
            for k, w in enumerate(castor.wheels)
        )
        pivot = (castor.pivot[0] * factors[4], castor.pivot[1] * factors[5])
        zero, offset = castor.pivot_zero * factors[6], castor.offset * factors[7]
        return dataclasses.replace(castor, wheels=wheels, pivot=pivot, pivot_zero=zero, offset=offset)

    robots = [dataclasses.replace(base, castors=tuple(changed(castor) for castor in base.castors)) for _ in range(4)]
    starts = random.normal(size=(4, 5, 3))
    data = [[noise(base, seed=10 * i + j) for j in range(5)] for i in range(4)]
    stacked = [
        {
            key: np.array([[data[i][j][k][key] for j in range(5)] for i in range(4)])
            for key in ("wheel", "pivot", "time")
        }
        for k in range(30)
    ]
    together = drive(estimator, Geometry.of(robots).expand(1), stacked, starts)
    assert together.shape == (30, 4, 5, 3)
    for i in range(4):
        for j in range(5):
            alone = drive(estimator, robots[i], data[i][j], starts[i, j])
            np.testing.assert_allclose(together[:, i, j], alone, atol=1e-12)


@all_estimators
def test_one_start_and_one_robot_broadcast_over_a_batch_of_observations(estimator, odd_robot, noise, drive):
    robot = odd_robot(3)
    runs = [noise(robot, seed=k) for k in range(3)]
    stacked = [{key: np.array([run[k][key] for run in runs]) for key in ("wheel", "pivot")} for k in range(30)]
    together = drive(estimator, robot, stacked)
    for j, run in enumerate(runs):
        np.testing.assert_allclose(together[:, j], drive(estimator, robot, run), atol=1e-12)


@all_estimators
def test_poses_handed_out_are_the_callers(estimator, odd_robot, noise, drive):
    """What is done to a returned pose, or to the start pose, does not change the next estimate."""
    robot, start = odd_robot(3), np.array([1.0, 2.0, 3.0])
    observations = noise(robot)
    expected = drive(estimator, robot, observations, start)
    estimator.reset(robot, start)
    start[:] = 99.0
    for k, observation in enumerate(observations):
        pose = estimator.update(observation)
        np.testing.assert_array_equal(pose, expected[k])
        pose[:] = 99.0
