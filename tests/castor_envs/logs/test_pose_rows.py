"""A reference that is slower than a log's rows, and between them: rows at its times, against motions in closed form."""

from typing import Any

import numpy as np
import pytest

from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.logs.pose_rows import with_reference
from castor_envs.logs.reference import TimedPoses
from castor_envs.vehicles.presets import cfmmr, preset
from estimators.calibration.maximum_likelihood.calibrate import calibrate

ROBOT = preset("differential")
T = 0.05 * np.arange(40)
SLOW = 0.02 + 0.5 * np.arange(4)


def straight(**parts) -> Log:
    return Log(t=T, wheel=np.outer(100 * T, [1.0, 2.0]), pivot=np.zeros((len(T), 0)), **parts)


def with_rows(log, tracked, vehicle: Any = ROBOT) -> Any:
    """A log of which no part is None: for tests that ask for its parts."""
    return with_reference(log, tracked, vehicle)


def poses(t):
    return TimedPoses(t, np.column_stack([t, -t, 0 * t]))


def test_a_pose_between_rows_has_a_row_with_the_counts_of_its_time():
    log = straight(command=np.column_stack([T, T]), gyro=3 * T, fix=np.zeros((40, 3)), extra={"note": ["x"] * 40})
    read = with_rows(log, poses(SLOW))
    added = np.isin(read.t, SLOW)
    assert (len(read), added.sum()) == (44, 4)
    assert np.all(np.diff(read.t) > 0)
    np.testing.assert_allclose(read.wheel, np.outer(100 * read.t, [1.0, 2.0]), atol=1e-9)
    np.testing.assert_array_equal(read.reference[added], poses(SLOW).pose)
    assert np.isnan(read.reference[~added]).all()
    np.testing.assert_allclose(read.gyro, 3 * read.t)
    np.testing.assert_array_equal(read.command[added, 0], T[[0, 10, 20, 30]])  # that of the row before holds
    assert np.isnan(read.fix[added]).all()
    assert np.unique(read.extra["note"][added]).tolist() == [""]


@pytest.mark.parametrize("rate", [10.0, 33.0])
def test_a_fast_reference_adds_no_row(rate):
    tracked = poses(np.arange(0.0, 2.0, 1 / rate))
    read = with_rows(straight(), tracked)
    np.testing.assert_array_equal(read.t, T)
    np.testing.assert_array_equal(read.reference, tracked.at(T))


def test_a_pose_far_from_all_counts_is_left_out():
    """Counts are blank from 0.5 to 1.5 s: in the middle of that nobody knows them; near its ends they are known."""
    log = straight()
    kept = (T < 0.51) | (T > 1.49)
    log = Log(t=T[kept], wheel=log.wheel[kept], pivot=log.pivot[kept])
    read = with_rows(log, poses(np.array([-0.02, 0.27, 1.02, 1.97])))
    assert sorted(set(read.t) - set(log.t)) == [0.27]


@pytest.mark.parametrize("way", [1, -1])
def test_a_pivot_that_wraps_is_interpolated_the_shorter_way_and_wraps(way):
    robot: Any = preset("tricycle")
    turn = robot.castors[0].pivot_counts_per_rev
    count = np.mod(way * 0.21 * turn * np.arange(40), turn)
    log = Log(t=T, wheel=np.zeros((40, len(robot.driven_wheels))), pivot=np.floor(count)[:, None])
    read = with_rows(log, poses(SLOW), robot)
    expected = np.mod(way * 0.21 * turn * read.t / 0.05, turn)
    off = np.mod(read.pivot[:, 0] - expected + turn / 2, turn) - turn / 2
    assert np.abs(off).max() <= 1.0
    assert np.ptp(read.pivot) <= turn


def test_logs_with_a_slow_reference_are_read_and_can_be_written_again(tmp_path):
    write_log(tmp_path / "log.csv", straight(), ROBOT, poses(SLOW))
    log: Any = read_log(tmp_path / "log.csv", ROBOT)
    np.testing.assert_array_equal(log.t[np.isfinite(log.reference[:, 0])], SLOW)
    write_log(tmp_path / "again.csv", log, ROBOT)
    again = read_log(tmp_path / "again.csv", ROBOT)
    for part in ("t", "wheel", "reference"):
        np.testing.assert_array_equal(getattr(again, part), getattr(log, part))


def test_axles_of_a_train_have_such_rows_too(tmp_path):
    tracked = TimedPoses(SLOW, np.outer(SLOW, np.arange(6)))
    log = Log(t=T, wheel=np.outer(T, np.ones(4)), pivot=np.zeros((40, 0)), rps=np.zeros((40, 3)))
    read = with_rows(log, tracked, cfmmr(2))
    added = np.isin(read.t, SLOW)
    assert added.sum() == 4
    assert np.isnan(read.rps[added]).all()
    np.testing.assert_array_equal(read.rps_age[added], 0)


def test_a_wheel_is_calibrated_by_poses_between_rows():
    """A left wheel 1 % larger, on arcs both ways; the pose by the arcs' closed form, every half second."""
    wheel: Any = ROBOT.castors[0].wheels[0]
    radius, half, t = wheel.radius, abs(wheel.lateral), np.arange(0.0, 40.0, 0.05)
    per_count = 2 * np.pi * radius / wheel.counts_per_rev

    def turned(t):
        return 0.8 * np.sin(0.3 * t) + 0.05 * t

    fine = np.linspace(0.0, 40.0, 80_001)
    x, y = (
        np.concatenate([[0.0], np.cumsum(0.3 * f(turned((fine[1:] + fine[:-1]) / 2)) * 5e-4)]) for f in (np.cos, np.sin)
    )
    at = 0.023 + 0.5 * np.arange(79)
    pose = np.column_stack([np.interp(at, fine, x), np.interp(at, fine, y), turned(at)])
    ways = np.column_stack([(0.3 * t - half * turned(t)) / 1.01, 0.3 * t + half * turned(t)])
    log = Log(t=t, wheel=np.round(ways / per_count), pivot=np.zeros((len(t), 0)))
    found = calibrate(ROBOT, [with_reference(log, TimedPoses(at, pose), ROBOT)])
    left = [k for k, p in enumerate(found.parameters) if (p.kind, p.wheel) == ("radius", 0)]
    assert found.after[left] == pytest.approx(1.01 * radius, rel=3e-4)
