"""What an estimator sees of a sample, and that stacks of it are the single ones."""

import numpy as np

from castor_envs.logs.log import Log
from castor_envs.sensors.observation import Observations, increments, observation


def a_log(seed, gyro=True):
    random = np.random.default_rng(seed)
    counts, pivot = random.integers(0, 99, (2, 7, 4)).astype(float)
    rate = random.normal(size=7) if gyro else None
    return Log(0.05 * np.arange(7), counts, pivot, reference=random.normal(size=(7, 3)), gyro=rate)


def test_increments_are_of_the_last_sample_and_start_at_zero():
    np.testing.assert_array_equal(increments([[5, 1], [7, 1], [4, 2]]), [[0, 0], [2, 0], [-3, 1]])


def test_a_robot_has_pivots_a_train_has_relative_poses_and_none_the_truth():
    log = a_log(0)
    assert log.gyro is not None
    for k, seen in enumerate(log.observations()):
        assert seen.keys() == {"wheel", "pivot", "time", "gyro"}
        np.testing.assert_array_equal(seen["time"], [0.05 * k])
        np.testing.assert_array_equal(seen["pivot"], log.pivot[k])
        np.testing.assert_array_equal(seen["gyro"], log.gyro[k : k + 1])
    assert next(iter(a_log(0, gyro=False).observations())).keys() == {"wheel", "pivot", "time"}
    rps = np.full((7, 6), np.nan)
    train = Log(0.05 * np.arange(7), np.zeros((7, 6)), np.empty((7, 0)), reference=np.zeros((7, 9)), rps=rps)
    for seen in train.observations():
        assert seen.keys() == {"wheel", "rps", "rps_age", "time"}
        np.testing.assert_array_equal(seen["rps_age"], [0.0, 0.0])


def test_an_observation_does_not_change_with_what_it_was_made_of():
    wheel = np.zeros(2)
    seen = observation(wheel, 1.0, pivot=wheel)
    wheel += 1.0
    np.testing.assert_array_equal(seen["wheel"] + seen["pivot"], [0.0, 0.0])


def test_a_stack_gives_each_members_observations_in_its_row():
    logs = [a_log(seed) for seed in range(3)]
    stack = Observations.stack([log.observations() for log in logs])
    assert len(stack) == 7
    for k in range(7):
        seen, members = stack.at(k), [log.observations().at(k) for log in logs]
        assert seen.keys() == members[0].keys()
        for key, values in seen.items():
            np.testing.assert_array_equal(values, [member[key] for member in members])


def test_commands_are_those_of_the_period_that_led_to_the_sample():
    t, told = 0.05 * np.arange(4), np.array([[1.0, 2], [3, 4], [5, 6], [0, 0]])
    log = Log(t, np.zeros((4, 2)), np.empty((4, 0)), command=told, steering_command=10 * told[:, :1])
    seen = list(log.observations())
    np.testing.assert_array_equal([one["command"] for one in seen], [[0, 0], [1, 2], [3, 4], [5, 6]])
    np.testing.assert_array_equal([one["steering_command"] for one in seen], [[0], [10], [30], [50]])
    stack = Observations.stack([log.observations()] * 2)
    np.testing.assert_array_equal(stack.at(2)["command"], [[3, 4], [3, 4]])
