"""What all correcting estimators of trains share: when they correct, what they refuse, how they bear bad sensors."""

import warnings
from typing import Any

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import cfmmr, preset
from estimators.plugins.registry import TRAINS, built_in_of, builtin_names, load_estimator
from estimators.trains.configuration import MAX_AGE
from estimators.trains.relative_poses import RelativePoseWarning

TRAIN_ESTIMATORS = list(built_in_of(TRAINS))
CORRECTING = [name for name in TRAIN_ESTIMATORS if name != "train-odometry"]
AT_INTERVALS = [name for name in CORRECTING if name != "train-filter"]  # which has tests of its own
BENT = np.array([[0.33, 0.09, 0.5], [0.34, -0.06, -0.4]])
STRAIGHT = np.array([[0.7, 0.0, 0.0], [0.35, 0.0, 0.0], [0.0, 0.0, 0.0]])


def made(name, poses=None, interval=None):
    """A new estimator, reset on a train that it serves, and that train's number of axles."""
    n = 2 if name == "two-truck-ipec" else 3
    estimator: Any = load_estimator(name if interval is None else f"{name}-{interval}").factory()
    estimator.reset(cfmmr(n), STRAIGHT[-n:] if poses is None else poses[-n:])
    return estimator, n


def rows(standing, name, times, relative=BENT):
    n = 2 if name == "two-truck-ipec" else 3
    return standing(n, relative[-(n - 1) :], times)


def test_trains_have_their_own_estimators_in_order():
    assert builtin_names(cfmmr(2)) == TRAIN_ESTIMATORS
    for n in (3, 10):
        assert builtin_names(cfmmr(n)) == [name for name in TRAIN_ESTIMATORS if name != "two-truck-ipec"]
    assert not set(builtin_names(preset("asoc-prototype"))) & set(TRAIN_ESTIMATORS)


@pytest.mark.parametrize("name", TRAIN_ESTIMATORS)
def test_robots_and_wrong_poses_are_refused(name):
    estimator = load_estimator(name).factory()
    robot = preset("differential")
    with pytest.raises(InputError, match="serves trains, and this is a robot"):
        estimator.reset(robot, np.zeros(3))
    with pytest.raises(InputError, match="serves trains, and this is a robot"):
        estimator.reset(Geometry.of(robot), np.zeros(3))
    with pytest.raises(InputError, match=r"poses of shape \(2, 3\), got \(3,\)"):
        estimator.reset(cfmmr(2), np.zeros(3))
    assert "this is a robot" in str(load_estimator(name).applicable(robot))


@pytest.mark.parametrize("name", ["dead-reckoning", "ipec", "cast", "cast-arc"])
def test_estimators_of_robots_refuse_trains(name):
    assert "is a train" in str(load_estimator(name).applicable(cfmmr(3)))


@pytest.mark.parametrize("name", AT_INTERVALS)
@pytest.mark.parametrize("interval", [1, 4])
def test_corrects_when_the_interval_is_over_and_not_before(name, interval, standing):
    estimator, n = made(name, interval=interval)
    period = cfmmr(n).sample_period
    # The clock starts at the first sample, whatever it says.
    for k, seen in enumerate(rows(standing, name, 100.0 + period * np.arange(interval + 1))):
        poses = estimator.update(seen)
        moved = np.abs(poses - STRAIGHT[-n:]).max()
        assert moved == 0.0 if k < interval else moved > 0.01


@pytest.mark.parametrize("name", AT_INTERVALS)
def test_a_longer_gap_than_the_interval_corrects_once_and_starts_anew(name, standing):
    estimator, n = made(name, interval=3)
    period = cfmmr(n).sample_period
    seen = rows(standing, name, period * np.array([0, 50, 51, 52, 53]))
    estimator.update(seen[0])
    first = estimator.update(seen[1])
    for row in seen[2:]:  # other readings from here on
        row["rps"] = -row["rps"]
    np.testing.assert_array_equal(estimator.update(seen[2]), first)
    np.testing.assert_array_equal(estimator.update(seen[3]), first)
    assert np.abs(estimator.update(seen[4]) - first).max() > 0.01


@pytest.mark.parametrize("name", AT_INTERVALS)
@pytest.mark.parametrize("interval", [0, -1, 2.5])
def test_an_interval_that_is_none_is_refused(name, interval):
    kind = load_estimator(name).kind
    with pytest.raises(InputError, match=f"1 to 1000000; got {interval}"):
        kind(interval=interval)


@pytest.mark.parametrize("name", AT_INTERVALS)
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rps": np.nan}, "frame A has no reading"),
        ({"rps": np.inf}, "frame A has no reading"),
        ({"rps_age": MAX_AGE + 0.01}, "frame A has an old reading, of 0.51 s ago"),
        ({"rps_age": np.nan}, "frame A has an old reading"),
        ({"rps_age": np.inf}, "frame A has an old reading"),
    ],
)
def test_unusable_readings_leave_odometry_and_the_correction_stays_due(name, change, says, standing):
    estimator, n = made(name)
    seen = rows(standing, name, (0.0, 10.0, 10.05, 10.1))
    for row in seen[1:3]:
        for key, value in change.items():
            row[key][0] = value
    estimator.update(seen[0])
    assert estimator.status is None
    with pytest.warns(RelativePoseWarning, match=says) as caught:
        np.testing.assert_array_equal(estimator.update(seen[1]), STRAIGHT[-n:])
    assert caught[0].filename == __file__
    assert says in estimator.status
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of each cause once
        np.testing.assert_array_equal(estimator.update(seen[2]), STRAIGHT[-n:])
        assert says in estimator.status
        assert np.abs(estimator.update(seen[3]) - STRAIGHT[-n:]).max() > 0.01
    assert estimator.status is None


def test_an_age_of_just_the_limit_is_used(standing):
    estimator, n = made("grpec-xy")
    seen = rows(standing, "grpec-xy", (0.0, 10.0))
    seen[1]["rps_age"][:] = MAX_AGE
    poses = [estimator.update(row) for row in seen]
    assert np.abs(poses[1] - STRAIGHT[-n:]).max() > 0.01


def test_every_frame_and_cause_warns_once_a_reset(standing):
    estimator, _ = made("grpec-xy")
    seen = rows(standing, "grpec-xy", (0.0, 1.0, 2.0, 3.0))
    seen[1]["rps"][0] = np.nan
    seen[2]["rps"][3] = np.nan
    seen[3]["rps_age"][0] = 9.0
    for _ in range(2):
        estimator.reset(cfmmr(3), STRAIGHT)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            again = [{**row, "time": row["time"] + 3.0} for row in seen[1:]]
            for row in [*seen, *again]:
                estimator.update(row)
        assert [str(warning.message).split(";")[0][:25] for warning in caught] == [
            "frame A has no reading",
            "frame B has no reading",
            "frame A has an old readin",
        ]


@pytest.mark.parametrize("name", CORRECTING)
@pytest.mark.parametrize("key", ["wheel", "time", "rps", "rps_age"])
def test_missing_and_wrong_sizes_are_refused(name, key, standing):
    estimator, _ = made(name)
    seen = rows(standing, name, (0.0,))[0]
    size = len(seen[key])
    with pytest.raises(InputError, match=rf"'{key}' has shape \({size + 3},\).* needs \({size},\)"):
        estimator.update({**seen, key: np.zeros(size + 3)})
    with pytest.raises(InputError, match=f"has no '{key}'"):
        estimator.update({name: value for name, value in seen.items() if name != key})


@pytest.mark.parametrize("name", AT_INTERVALS)
def test_the_belief_moves_with_the_start(name, circling):
    n = 2 if name == "two-truck-ipec" else 3
    train, truth, observations = circling(n, curvature=1.3, seconds=1.5)
    start = truth[0] + np.array([[0.02, -0.06, 0.1], [0.01, 0.02, -0.03], [0.03, 0.01, 0.02]])[:n]
    psi = 4.1
    turn = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])

    def moved(poses):
        return np.concatenate([poses[..., :2] @ turn.T + [3.0, -7.0], poses[..., 2:] + psi], axis=-1)

    def run(start):
        estimator = load_estimator(f"{name}-7").factory()
        estimator.reset(train, start)
        return np.array([estimator.update(seen) for seen in observations])

    moved_start, moved_path = run(moved(start)), moved(run(start))
    assert np.abs(moved_path[:, :, :2]).max() > 3.0
    np.testing.assert_allclose(moved_start, moved_path, rtol=0, atol=1e-6 if name == "rmspec" else 1e-9)


@pytest.mark.parametrize("name", AT_INTERVALS)
def test_what_is_consistent_stays(name, circling):
    n = 2 if name == "two-truck-ipec" else 4
    train, truth, observations = circling(n, curvature=-0.9, seconds=3.0)
    estimator = load_estimator(f"{name}-1").factory()
    estimator.reset(train, truth[0])
    poses = np.array([estimator.update(seen) for seen in observations])
    np.testing.assert_allclose(poses, truth, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["train-odometry", *AT_INTERVALS])
def test_headings_stay_unwrapped_over_many_turns(name, circling):
    n = 2 if name == "two-truck-ipec" else 3
    train, truth, observations = circling(n, speed=0.6, curvature=2.5, seconds=15.0)
    estimator = load_estimator(name).factory()
    estimator.reset(train, truth[0])
    poses = np.array([estimator.update(seen) for seen in observations])
    assert truth[-1, 0, 2] > 6 * np.pi
    np.testing.assert_allclose(poses[:, :, 2], truth[:, :, 2], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", TRAIN_ESTIMATORS)
def test_a_count_that_is_no_number_is_refused_and_not_integrated(name, standing):
    estimator, _ = made(name)
    (seen,) = rows(standing, name, [0.0])
    with pytest.raises(InputError, match="'wheel' is not finite"):
        estimator.update({**seen, "wheel": np.full_like(seen["wheel"], np.nan)})


@pytest.mark.parametrize("name", CORRECTING)
@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("time", np.nan, "'time' is nan"), ("time", np.inf, "'time' is inf"), ("rps_age", -1.0, "never below 0 s")],
)
def test_times_and_ages_that_are_none_are_refused(name, key, value, said, standing):
    estimator, _ = made(name)
    (seen,) = rows(standing, name, [0.0])
    with pytest.raises(InputError, match=said):
        estimator.update({**seen, key: np.full_like(seen[key], value)})


@pytest.mark.parametrize("name", CORRECTING)
def test_time_must_not_go_back(name, standing):
    estimator, _ = made(name)
    late, early = rows(standing, name, [5.0, 4.0])
    estimator.update(late)
    with pytest.raises(InputError, match=r"4\.0 s after 5\.0 s; times must not go back"):
        estimator.update(early)


@pytest.mark.parametrize("name", TRAIN_ESTIMATORS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_poses_to_start_at_that_are_no_numbers_are_refused(name, bad):
    n = 2 if name == "two-truck-ipec" else 3
    poses = STRAIGHT[-n:].copy()
    poses[0, 0] = bad
    with pytest.raises(InputError, match="poses to start at are not finite"):
        load_estimator(name).factory().reset(cfmmr(n), poses)


@pytest.mark.parametrize("given", [None, "cfmmr-4", {}])
def test_what_is_no_train_is_named(given):
    with pytest.raises(InputError, match=f"give it a TrainDescription, not {type(given).__name__}"):
        load_estimator("grpec-xy").factory().reset(given, STRAIGHT)


@pytest.mark.parametrize("name", AT_INTERVALS)
@pytest.mark.parametrize("far", [50.0, 1e300])
def test_a_reading_no_frame_can_reach_is_no_reading(name, far, standing):
    estimator, n = made(name)
    first, second = rows(standing, name, [0.0, 100.0])
    estimator.update(first)
    second["rps"][0] = far
    with pytest.warns(RelativePoseWarning, match="frame A has an impossible reading"):
        poses = estimator.update(second)
    np.testing.assert_array_equal(poses, STRAIGHT[-n:])
