"""A reference at its own times: in files, and between its readings, where a closed form says how far off it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.logs.reference import GAP, TimedPoses, interpolated
from castor_envs.vehicles.presets import cfmmr, preset

ROBOT = preset("differential")
HEADER = "t,wheel_1l,wheel_1r,ref_x,ref_y,ref_psi"


@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(0.01, GAP), st.floats(0, 1))
def test_between_readings_a_constant_acceleration_is_off_by_what_the_formula_says(a, v, gap, share):
    seen, t = np.array([0.0, gap]), np.array([share * gap])
    (found,) = interpolated(seen, v * seen + a * seen**2 / 2, t)
    off = found - (v * t + a * t**2 / 2)
    assert off == pytest.approx(a * t * (gap - t) / 2, abs=1e-12)
    assert abs(off) <= abs(a) * GAP**2 / 8 + 1e-12


@pytest.mark.parametrize("gap", [0.1001, 0.3, 1.0, 60.0])
def test_a_long_gap_is_bridged_only_where_that_is_no_worse_than_in_the_middle_of_a_short_one(gap):
    t = np.linspace(0.0, gap, 100_001)
    found = interpolated(np.array([0.0, gap]), np.array([0.0, 1.0]), t)
    assert np.nanmax(t * (gap - t) * np.isfinite(found)) <= (GAP / 2) ** 2 * (1 + 1e-5)
    assert np.isnan(found[50_000])
    assert found[[0, -1]].tolist() == [0.0, 1.0]
    assert np.isfinite(found[1]) == (t[1] * (gap - t[1]) < (GAP / 2) ** 2)


def test_nothing_is_said_before_the_first_and_after_the_last_reading():
    seen, poses = np.array([1.0, 1.05, 1.1]), np.arange(9.0).reshape(3, 3)
    found = interpolated(seen, poses, np.array([0.999, 1.0, 1.1, 1.101]))
    np.testing.assert_array_equal(found[1:3], poses[[0, 2]])
    assert np.isnan(found[[0, 3]]).all()
    assert np.isnan(interpolated(seen[:0], poses[:0], seen)).all()
    np.testing.assert_array_equal(interpolated(seen[:1], poses[:1], seen)[0], poses[0])
    assert np.isnan(interpolated(seen[:1], poses[:1], seen)[1:]).all()


def test_rows_with_a_pose_and_no_counts_are_read(tmp_path):
    """A pose of a circle of 1 m at 1 rad/s every 30 ms, counts every 50 ms."""
    poses = [(0.03 * k, np.cos(0.03 * k), np.sin(0.03 * k), 0.03 * k) for k in range(11)]
    rows = [f"{t},,,{x},{y},{psi}" for t, x, y, psi in poses[1:]]
    rows += [f"{0.05 * k},{3 * k},{4 * k},,," for k in range(1, 7) if k != 6] + ["0,0,0,1,0,0"]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([HEADER, *sorted(rows, key=lambda row: float(row.split(",")[0]))]) + "\n")
    log = read_log(path, ROBOT)
    np.testing.assert_allclose(log.t, 0.05 * np.arange(6))
    np.testing.assert_array_equal(log.wheel[:, 1], 4 * np.arange(6))
    assert log.reference is not None
    # A chord of 30 ms of the unit circle is at most (0.03 / 2)^2 / 2 inside of it.
    np.testing.assert_allclose(np.hypot(*log.reference[:, :2].T), 1.0, atol=1.2e-4)
    np.testing.assert_allclose(log.reference[:, 2], log.t, atol=1e-12)


def test_a_log_with_poses_at_their_own_times_is_written_and_read(tmp_path):
    t, seen = 0.05 * np.arange(20), 0.0111 + 0.013 * np.arange(60)
    tracked = TimedPoses(seen, np.column_stack([seen, seen**2, -seen]))
    log = Log(t=t, wheel=np.column_stack([t, 2 * t]) // 0.01, pivot=np.empty((20, 0)), gyro=-t)
    path = tmp_path / "log.csv"
    write_log(path, log, ROBOT, tracked)
    again = read_log(path, ROBOT)
    for part in ("t", "wheel", "gyro"):
        np.testing.assert_array_equal(getattr(again, part), getattr(log, part))
    np.testing.assert_array_equal(again.reference, tracked.at(t))
    lines = path.read_text().splitlines()
    assert len(lines) == 1 + 20 + 60
    assert sum(line.split(",")[1] == "" for line in lines[1:]) == 60


def test_a_pose_at_the_time_of_counts_stands_in_their_row(tmp_path):
    t = 0.5 * np.arange(4)
    tracked = TimedPoses(t[1:3], np.ones((2, 3)))
    log = Log(t=t, wheel=np.zeros((4, 2)), pivot=np.empty((4, 0)))
    write_log(tmp_path / "log.csv", log, ROBOT, tracked)
    assert len((tmp_path / "log.csv").read_text().splitlines()) == 5
    again = read_log(tmp_path / "log.csv", ROBOT)
    assert again.reference is not None
    assert np.isfinite(again.reference[:, 0]).tolist() == [False, True, True, False]


def test_a_blank_pose_stays_blank_where_every_row_has_counts(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(f"{HEADER}\n0,0,0,0,0,0\n0.01,1,1,,,\n0.02,2,2,0.2,0,0\n")
    log = read_log(path, ROBOT)
    assert log.reference is not None
    assert np.isnan(log.reference[1]).all()


def test_a_trains_axles_have_poses_at_their_own_times(tmp_path):
    train, t = cfmmr(2), 0.05 * np.arange(5)
    seen = np.linspace(0, 0.2, 9)
    tracked = TimedPoses(seen, np.outer(seen, np.arange(6)))
    log = Log(t=t, wheel=np.zeros((5, 4)), pivot=np.empty((5, 0)), rps=np.zeros((5, 3)))
    write_log(tmp_path / "log.csv", log, train, tracked)
    again = read_log(tmp_path / "log.csv", train).reference
    assert again is not None
    np.testing.assert_allclose(again, np.outer(t, np.arange(6)), atol=1e-15)


@pytest.mark.parametrize(
    ("rows", "line", "words"),
    [
        (["0,0,0,,,", "0.01,,,0,,0", "0.02,1,1,,,"], 3, ["ref_y", "blank"]),
        (["0,0,0,,,", "0.01,,,,,", "0.02,1,1,,,"], 3, ["wheel_1l", "blank"]),
        (["0,0,0,,,", "0.01,,3,0,0,0", "0.02,1,1,,,"], 3, ["wheel_1l", "blank"]),
        (["0,0,0,,,", "0,,,0,0,0", "0.02,1,1,,,"], 3, ["'t'", "repeats"]),
        (["0,0,0,,,", "0.02,1,1,,,", "0.01,,,0,0,0"], 4, ["'t'", "goes back"]),
        (["0,0,0,,,", "0.01,,,0,0,0", "0.02,1,1,,,", "0.03,,,0,0,90"], 5, ["ref_psi", "degrees"]),
        (["0,0,0,,,", "0.01,,,nan,0,0", "0.02,1,1,,,"], 3, ["ref_x", "not finite"]),
        (["0,0,0,,,", "0.01,,,1e30,0,0", "0.02,1,1,,,"], 3, ["ref_x", "beyond"]),
        (["0,0,0,,,", "0.01,,,0,0,0", "0.02,,,0,0,0"], None, ["at least 2 rows"]),
    ],
)
def test_a_mistake_in_a_row_of_a_pose_is_named_with_its_place(tmp_path, rows, line, words):
    path = tmp_path / "log.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    with pytest.raises(InputError) as caught:
        read_log(path, ROBOT)
    assert f"{path}:{line}:" in str(caught.value) or line is None
    for word in words:
        assert word in str(caught.value)
