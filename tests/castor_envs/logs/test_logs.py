"""Logs keep every number, and every mistake in a file is named with its place."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from castor_envs.errors import InputError
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log, pivot_jumps
from castor_envs.logs.table import Line, numbers
from castor_envs.logs.trajectory_files import export_kitti, export_trajectory, export_tum
from castor_envs.vehicles.presets import cfmmr, preset

EVO = Path(sys.executable).parent / "evo_traj"
"""The program of the environment that the tests run in, which need not be active."""

HEADER = "t,wheel_1l,wheel_1r,ref_x,ref_y,ref_psi"
DIFFERENTIAL = preset("differential")
ASOC = preset("1-castor")

small = st.floats(-1e6, 1e6)


@st.composite
def robots_and_logs(draw):
    """Any log that a robot could have written: blank rows, whole and fractional counts, odd texts in extra columns."""
    robot = preset(draw(st.sampled_from(["asoc-prototype", "1-castor", "differential", "tricycle", "swerve"])))
    columns = LogColumns.of(robot)
    n = draw(st.integers(2, 5))
    t = sorted(draw(st.lists(small, min_size=n, max_size=n, unique=True)))
    counts = st.integers(-(2**53), 2**53).map(float) | st.floats(-(2.0**53), 2.0**53)

    def rows(width, values):
        return np.array(draw(st.lists(st.lists(values, min_size=width, max_size=width), min_size=n, max_size=n)))

    def maybe_blank(width, values):
        if not width or not draw(st.booleans()):
            return None
        array = rows(width, values)
        array[np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)))] = np.nan
        return array

    position, heading = maybe_blank(2, small), maybe_blank(1, small)
    fix, age, reference = None, None, maybe_blank(3, st.floats(-1.5, 1.5))
    if reference is not None:  # positions without headings
        reference[np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n))), 2] = np.nan
    if position is not None and heading is not None:
        fix = np.concatenate([position, heading], axis=1)
        age = np.where(np.isnan(fix).all(axis=1), np.nan, np.abs(rows(1, small)[:, 0]))
    turn = min([robot.castors[i].pivot_counts_per_rev or 0 for i in robot.pivot_encoders], default=0)
    names = st.text("abc ,\"'é", min_size=1).map(lambda name: f"note {name}!")
    extra = draw(st.dictionaries(names, st.lists(st.text(), min_size=n, max_size=n), max_size=2))
    return robot, Log(
        t=np.array(t),
        wheel=rows(len(columns.wheel), counts),
        pivot=rows(len(columns.pivot), st.integers(0, max(int(turn) - 1, 0))).reshape(n, -1),
        command=maybe_blank(len(columns.command), small),
        steering_command=maybe_blank(len(columns.steering_command), small),
        reference=reference,
        gyro=rows(1, small)[:, 0] if draw(st.booleans()) else None,
        fix=fix,
        fix_age=age,
        extra=extra,
    )


def same_values(a, b):
    if a is None or b is None:
        return a is b
    return np.array_equal(a, b, equal_nan=True)


@given(robots_and_logs())
@settings(max_examples=150, deadline=None)
def test_a_log_that_was_written_is_read_back_bit_for_bit(robot_and_log):
    robot, log = robot_and_log
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write_log(path, log, robot)
        again = read_log(path, robot)
    for part in ("t", "wheel", "pivot", "command", "steering_command", "reference", "gyro"):
        assert same_values(getattr(again, part), getattr(log, part)), part
    assert {name: list(cells) for name, cells in again.extra.items()} == {
        name: list(cells) for name, cells in log.extra.items()
    }


@st.composite
def trains_and_logs(draw):
    """Any log of a train: frames without a reading, rows without truth or commands, any ages."""
    train = cfmmr(draw(st.integers(2, 4)))
    n, axles, frames = draw(st.integers(2, 4)), train.n_axles, train.n_axles - 1

    def rows(width, values):
        return np.array(draw(st.lists(st.lists(values, min_size=width, max_size=width), min_size=n, max_size=n)))

    blank = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    reference, command, rps = rows(3 * axles, st.floats(-1.5, 1.5)), rows(2 * axles, small), rows(3 * frames, small)
    reference[blank], command[~blank] = np.nan, np.nan
    rps.reshape(n, frames, 3)[rows(frames, st.booleans())] = np.nan
    return train, Log(
        t=np.cumsum(rows(1, st.floats(0.01, 10))[:, 0]),
        wheel=rows(2 * axles, st.integers(-(2**53), 2**53).map(float) | small),
        pivot=np.empty((n, 0)),
        command=command if draw(st.booleans()) else None,
        reference=reference if draw(st.booleans()) else None,
        rps=rps,
        rps_age=np.abs(rows(frames, small)) if draw(st.booleans()) else None,
    )


@given(trains_and_logs())
@settings(max_examples=100, deadline=None)
def test_a_trains_log_is_read_back_bit_for_bit(train_and_log):
    train, log = train_and_log
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        write_log(path, log, train)
        again = read_log(path, train)
    for part in ("t", "wheel", "pivot", "command", "steering_command", "reference", "gyro", "rps", "rps_age"):
        assert same_values(getattr(again, part), getattr(log, part)), part
    for seen, expected in zip(again.observations(), log.observations(), strict=True):
        assert sorted(seen.keys() - {"command"}) == ["rps", "rps_age", "time", "wheel"]
        assert all(same_values(seen[key], expected[key]) for key in seen)


TRAIN = cfmmr(3)
TRAIN_HEADER = ",".join(["t", *(f"wheel_{name}" for name in ("1l", "1r", "2l", "2r", "3l", "3r"))])
RPS_HEADER = ",".join(f"rps_{frame}_{part}" for frame in "AB" for part in ("x", "y", "phi"))
TRUTH_HEADER = ",".join(f"ref_{axle}_{part}" for axle in (1, 2, 3) for part in ("x", "y", "psi"))
STILL = ",0" * 6


def test_a_trains_columns_are_named_by_axle_and_frame(tmp_path):
    n = 2
    log = Log(
        t=np.array([0.0, 0.05]),
        wheel=np.zeros((n, 6)),
        pivot=np.empty((n, 0)),
        command=np.zeros((n, 6)),
        reference=np.zeros((n, 9)),
        rps=np.array([[0.35, 0, 0, 0.3, 0.1, 0.5], [np.nan] * 3 + [0.3, 0.1, 0.5]]),
    )
    write_log(tmp_path / "log.csv", log, TRAIN)
    header, first, second = (tmp_path / "log.csv").read_text().splitlines()
    commands = ",".join(f"cmd_{name}" for name in TRAIN.wheel_names)
    assert header == f"{TRAIN_HEADER},{commands},{TRUTH_HEADER},{RPS_HEADER},rps_age_A,rps_age_B"
    assert first.endswith(",0.35,0.0,0.0,0.3,0.1,0.5,0.0,0.0")
    assert second.endswith(",,,,0.3,0.1,0.5,0.0,0.0")


def test_a_trains_log_may_lack_readings_ages_and_truth(tmp_path):
    (tmp_path / "bare.csv").write_text(f"{TRAIN_HEADER}\n0{STILL}\n1{STILL}\n")
    bare = read_log(tmp_path / "bare.csv", TRAIN)
    assert bare.reference is None
    for seen in bare.observations():
        np.testing.assert_array_equal(seen["rps"], np.full(6, np.nan))
        np.testing.assert_array_equal(seen["rps_age"], np.zeros(2))
    (tmp_path / "ageless.csv").write_text(f"{TRAIN_HEADER},{RPS_HEADER}\n0{STILL},1,2,3,,,\n1{STILL},1,2,3,4,5,6\n")
    first, second = read_log(tmp_path / "ageless.csv", TRAIN).observations()
    np.testing.assert_array_equal(first["rps"], [1, 2, 3, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(second["rps"], [1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(second["rps_age"], np.zeros(2))


TRAIN_MISTAKES = [
    ("t,wheel_1l\n0,0\n", r"log.csv:1: column 'wheel_1r': is missing; .* or give the robot or train that made"),
    (f"{TRAIN_HEADER},rps_A_x,rps_A_y,rps_A_phi\n", r"log.csv:1: column 'rps_B_x': is missing"),
    (f"{TRAIN_HEADER},{RPS_HEADER},rps_age_A\n", r"log.csv:1: column 'rps_age_B': is missing"),
    (
        f"{TRAIN_HEADER},{RPS_HEADER},rps_age_A,rps_age_B\n0{STILL},,,,,,,0,0\n1{STILL},,,,,,,0,inf\n",
        r"log.csv:3: column 'rps_age_B': 'inf'",
    ),
    (f"{TRAIN_HEADER},ref_1_x,ref_1_y,ref_1_psi\n", r"log.csv:1: column 'ref_2_x': is missing"),
    (
        f"{TRAIN_HEADER},{RPS_HEADER}\n0{STILL},1,1,1,1,,1\n1{STILL},1,1,1,1,1,1\n",
        r"log.csv:2: column 'rps_B_y': is blank, but not all of rps_B_x, rps_B_y, rps_B_phi; give all or none",
    ),
    (
        f"{TRAIN_HEADER},{RPS_HEADER}\n0{STILL},1,1,1,1,1,1\n1{STILL},1,inf,1,,,\n",
        r"log.csv:3: column 'rps_A_y': 'inf' is not finite",
    ),
    (
        f"{TRAIN_HEADER},{TRUTH_HEADER}\n0{STILL},0,0,0,,,,0,0,0\n1{STILL},0,0,0,0,0,0,0,0,0\n",
        r"log.csv:2: column 'ref_2_x': is blank, but not all of ref_1_x",
    ),
    (
        f"{TRAIN_HEADER},{TRUTH_HEADER}\n0{STILL},0,0,3,0,0,3,0,0,3\n1{STILL},0,0,3.1,0,0,-3.1,0,0,3.1\n",
        r"log.csv:3: column 'ref_2_psi': steps by over half a turn; unwrap",
    ),
]


@pytest.mark.parametrize(("text", "message"), TRAIN_MISTAKES)
def test_a_mistake_in_a_trains_log_is_named(tmp_path, text, message):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_log(tmp_path / "log.csv", TRAIN)


def test_a_train_log_that_could_not_be_read_is_not_written(tmp_path):
    good = Log(np.arange(2.0), np.zeros((2, 6)), np.empty((2, 0)), rps=np.zeros((2, 6)))
    for k, value in ((4, np.nan), (2, np.inf)):
        rps = np.zeros((2, 6))
        rps[1, k] = value
        with pytest.raises(InputError, match=r"log.csv:3: column 'rps_[AB]_(y|phi)': (nan|inf) is not finite"):
            write_log(tmp_path / "log.csv", Log(good.t, good.wheel, good.pivot, rps=rps), TRAIN)
    with pytest.raises(ValueError, match="has columns"):
        write_log(tmp_path / "log.csv", good, cfmmr(4))
    with pytest.raises(ValueError, match="age of what"):
        Log(good.t, good.wheel, good.pivot, rps_age=np.zeros((2, 2)))
    assert not list(tmp_path.iterdir())


def sample_log(n=6):
    k = np.arange(n, dtype=float)
    reference = np.column_stack([0.1 * k, -0.2 * k, 0.3 * k])
    reference[2] = np.nan
    return Log(t=0.05 * k, wheel=np.column_stack([10 * k, 7 * k]), pivot=np.empty((n, 0)), reference=reference)


def test_the_order_of_columns_and_blank_lines_do_not_matter(tmp_path):
    write_log(tmp_path / "a.csv", sample_log(), DIFFERENTIAL)
    lines = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    backwards = "\r\n\r\n".join(",".join(f' "{cell}"'.strip() for cell in reversed(line)) for line in lines)
    (tmp_path / "b.csv").write_text("\ufeff" + backwards)
    a, b = (read_log(tmp_path / name, DIFFERENTIAL) for name in ("a.csv", "b.csv"))
    assert same_values(a.t, b.t)
    assert same_values(a.wheel, b.wheel)
    assert same_values(a.reference, b.reference)


def test_columns_of_another_use_may_be_called_as_parts_of_a_log_are(tmp_path):
    (tmp_path / "a.csv").write_text("t,wheel_1l,wheel_1r,line,wheel,reference\n0,1,2,a,b,\n1,2,3,,é,a long remark\n")
    log = read_log(tmp_path / "a.csv", DIFFERENTIAL)
    assert {name: list(cells) for name, cells in log.extra.items()} == {
        "line": ["a", ""],
        "wheel": ["b", "é"],
        "reference": ["", "a long remark"],
    }
    assert log.reference is None
    np.testing.assert_array_equal(log.wheel, [[1, 2], [2, 3]])


def test_whole_counts_are_written_as_whole_numbers(tmp_path):
    write_log(tmp_path / "a.csv", sample_log(), DIFFERENTIAL)
    assert (tmp_path / "a.csv").read_text().splitlines()[:3] == [
        HEADER,
        "0.0,0,0,0.0,-0.0,0.0",
        "0.05,10,7,0.1,-0.2,0.3",
    ]


ROWS = "0,0,0,0,0,0\n0.05,5,5,0,0,0\n"
MISTAKES = [
    ("", r"log.csv: is empty"),
    ("\n \n", r"log.csv: is empty"),
    (HEADER, r"log.csv: a log needs at least 2 rows of numbers, not 0"),
    (f"{HEADER}\n0,0,0,0,0,0\n", r"log.csv: a log needs at least 2 rows of numbers, not 1"),
    ("t;wheel_1l;wheel_1r\n0;0;0\n1;1;1\n", r"log.csv:1: .* separate columns by commas; castor-bench import makes"),
    ("ms,left,left\n0,0,0\n", r"log.csv:1: no column of a log is in .* ms, left, left; castor-bench import makes"),
    ("t,wheel_1l\n0,0\n1,1\n", r"log.csv:1: column 'wheel_1r': is missing; the header has t, wheel_1l"),
    ("t,wheel_1l,wheel1r\n0,0,0\n1,1,1\n", r"log.csv:1: column 'wheel_1r': is missing; did you mean 'wheel1r'"),
    ("t,Wheel_1L,wheel_1r\n0,0,0\n1,1,1\n", r"log.csv:1: column 'wheel_1l': is missing; did you mean 'Wheel_1L'"),
    ("time,wheel_1l,wheel_1r\n0,0,0\n1,1,1\n", r"log.csv:1: column 't': is missing; did you mean 'time'"),
    ("t,wheel1l,wheel1r\n0,0,0\n1,1,1\n", r"'wheel1l'\? rename it, or give the robot or train that made the log"),
    ("t,wheel_1l,wheel_1r,ref_x,ref_psi\n0,0,0,0,0\n", r"log.csv:1: column 'ref_y': is missing"),
    ("t,wheel_1l,wheel_1r,cmd_1r\n0,0,0,0\n", r"log.csv:1: column 'cmd_1l': is missing"),
    ("t,wheel_1l,wheel_1r,t\n0,0,0,0\n", r"log.csv:1: column 't': appears twice, at places 1 and 4"),
    ("t,wheel_1l,wheel_1r,\n0,0,0,\n", r"log.csv:1: the column at place 4 has no name"),
    (f"{HEADER}\n{ROWS}0.1,6,5,0,0\n", r"log.csv:4: 5 cells where the columns of the header are 6"),
    (f"{HEADER}\n{ROWS}0.1,6,5,0,0,0,0\n", r"log.csv:4: 7 cells where the columns of the header are 6"),
    (f"{HEADER}\n{ROWS}\n0.1,6,5,0,0,0,0\n", r"log.csv:5: 7 cells"),
    (f"{HEADER}\n{ROWS}0.1,six,5,0,0,0\n", r"log.csv:4: column 'wheel_1l': 'six' is not a number; give a number"),
    (f"{HEADER}\n{ROWS}0.1,1_0,5,0,0,0\n", r"log.csv:4: column 'wheel_1l': '1_0' is not a number"),
    (f"{HEADER}\n{ROWS}0.1,,5,0,0,0\n", r"log.csv:4: column 'wheel_1l': is blank; give a number"),
    (f"{HEADER}\n{ROWS}0.1,6,nan,0,0,0\n", r"log.csv:4: column 'wheel_1r': 'nan' is not finite"),
    (f"{HEADER}\n{ROWS}inf,6,5,0,0,0\n", r"log.csv:4: column 't': 'inf' is not finite"),
    (f"{HEADER}\n{ROWS}0.1,6,5,nan,0,0\n", r"log.csv:4: column 'ref_x': 'nan' is not finite"),
    (f"{HEADER}\n{ROWS}0.1,6,5,0,,0\n", r"log.csv:4: column 'ref_y': is blank, but not all of ref_x, ref_y;"),
    (f"{HEADER}\n{ROWS}0.1,6,5,,,0\n", r"log.csv:4: column 'ref_x': is blank beside a heading"),
    (f"{HEADER}\n{ROWS}0.02,6,5,0,0,0\n", r"log.csv:4: column 't': goes back from 0.05 to 0.02; sort the rows"),
    (f"{HEADER}\n{ROWS}0.05,6,5,0,0,0\n", r"log.csv:4: column 't': repeats 0.05"),
    ("t,wheel_1l,wheel_1r,wheel_2l\n0,0,0,0\n1,1,1,1\n", r"log.csv:1: column 'wheel_2l': .* has no castor 2; give the"),
    ("t,wheel_1l,wheel_1r,pivot_3\n0,0,0,0\n1,1,1,1\n", r"log.csv:1: column 'pivot_3': .* has no castor 3; give the"),
    (f"{HEADER}\n{ROWS}0.1,6,5,0,0,40\n", r"log.csv:4: column 'ref_psi': steps .* are these degrees\? give rad"),
    (f"{HEADER}\n{ROWS}0.1,6,5,0,0,3.2\n", r"log.csv:4: column 'ref_psi': steps by over half a turn; unwrap"),
    (f'{HEADER}\n{ROWS}0.1,6,5,0,0,"3\n', r"log.csv:4: is not CSV"),
]


@pytest.mark.parametrize(("text", "message"), MISTAKES)
def test_a_mistake_is_named_with_file_line_and_column_in_one_line(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_log(path, DIFFERENTIAL)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text_or_not_there_are_named(tmp_path):
    with pytest.raises(InputError, match=r"gone.csv: cannot be read \(No such file"):
        read_log(tmp_path / "gone.csv", DIFFERENTIAL)
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00t")
    with pytest.raises(InputError, match=r"binary.csv: is not text in UTF-8"):
        read_log(tmp_path / "binary.csv", DIFFERENTIAL)
    with pytest.raises(InputError, match=r": is a folder; name a CSV file in it \(of a ROS bag, castor-bench import"):
        read_log(tmp_path, DIFFERENTIAL)


def test_a_recording_in_a_logs_place_is_told_as_one(tmp_path):
    (tmp_path / "bag").mkdir()
    contents = {
        "run.wpilog": (b"WPILOG\x00\x01", "WPILib"), "run.mcap": (b"", "ROS bag"), "run.bag": (b"", "ROS bag"),
        "run.db3": (b"", "ROS bag"), "bag/metadata.yaml": (b"", "ROS bag"), "run.tum": (b"0 0 0 0 0 0 0 1\n", "TUM"),
    }  # fmt: skip
    for name, (content, kind) in contents.items():
        (tmp_path / name).write_bytes(content)
        given = tmp_path / name.removesuffix("/metadata.yaml")
        with pytest.raises(InputError, match=f"is a recording, .*{kind}.*, not a log; castor-bench import makes a log"):
            read_log(given, DIFFERENTIAL)
    (tmp_path / "run.csv").write_text("t,left,right\n0,0,0\n1,1,1\n")
    with pytest.raises(InputError, match="castor-bench import makes a log of a recording by another program"):
        read_log(tmp_path / "run.csv", DIFFERENTIAL)


@given(st.integers(3, 6000), st.floats(0, 6000), st.lists(st.floats(-0.49, 0.49), min_size=2, max_size=40))
def test_steps_below_half_a_turn_are_never_refused_wrapped_or_not(turn, start, steps):
    unwrapped = start + np.cumsum(np.array(steps) * turn)
    assert not pivot_jumps(unwrapped, turn).size
    assert not pivot_jumps(np.mod(unwrapped, turn), turn).size
    assert not pivot_jumps(np.mod(unwrapped + turn / 2, turn) - turn / 2, turn).size


def test_a_jump_of_over_half_a_turn_in_an_unwrapped_pivot_column_is_refused(tmp_path):
    turn = ASOC.castors[0].pivot_counts_per_rev
    assert turn is not None
    path = tmp_path / "log.csv"
    counts = [0, turn // 3, 2 * turn // 3, turn + 5, turn + 5 + turn // 2 + 1]
    path.write_text("t,wheel_1l,wheel_1r,pivot_1\n" + "".join(f"{k},{k},{k},{c}\n" for k, c in enumerate(counts)))
    said = r"log.csv:6: column 'pivot_1': jumps from 5148 to 7720, over .* \(0 in line 2 to 7720 in line 6\)"
    with pytest.raises(InputError, match=said):
        read_log(path, ASOC)


def test_what_could_not_be_read_is_not_written(tmp_path):
    good = sample_log()
    times, wheel, pose = good.t.copy(), good.wheel.copy(), np.zeros((6, 3))
    times[3], wheel[2, 1], pose[4, 0] = times[1], np.nan, np.nan
    wrong = [
        Log(times, good.wheel, good.pivot),
        Log(good.t, wheel, good.pivot),
        Log(good.t, good.wheel, good.pivot, reference=pose),
        Log(good.t[:1], good.wheel[:1], good.pivot[:1]),
    ]
    for log in wrong:
        with pytest.raises(InputError):
            write_log(tmp_path / "log.csv", log, DIFFERENTIAL)
    with pytest.raises(ValueError, match="has columns"):
        write_log(tmp_path / "log.csv", Log(good.t, good.wheel[:, :1], good.pivot), DIFFERENTIAL)
    with pytest.raises(ValueError, match="rows"):
        Log(good.t, good.wheel[:2], good.pivot)
    assert not list(tmp_path.iterdir())


def test_observations_are_increments_and_hold_no_truth():
    n = 6
    log = Log(
        t=np.arange(n) * 0.1,
        wheel=np.arange(2 * n).reshape(n, 2) ** 2,
        pivot=np.arange(n).reshape(n, 1),
        reference=np.zeros((n, 3)),
        gyro=np.arange(n) * 0.5,
    )
    seen = list(log.observations())
    assert [sorted(observation) for observation in seen] == [["gyro", "pivot", "time", "wheel"]] * n
    assert all(value.dtype == np.float64 and value.ndim == 1 for observation in seen for value in observation.values())
    assert not seen[0]["wheel"].any()
    np.testing.assert_array_equal(
        log.wheel[0] + np.cumsum([observation["wheel"] for observation in seen], axis=0), log.wheel
    )
    np.testing.assert_array_equal([observation["pivot"] for observation in seen], log.pivot)
    np.testing.assert_array_equal(np.concatenate([observation["time"] for observation in seen]), log.t)


poses = st.lists(st.tuples(small, small, st.floats(-50, 50)), min_size=2, max_size=8).map(np.array)


@given(poses)
@settings(deadline=None)
def test_exports_are_rigid_motions_with_the_pose_in_them(pose):
    t = np.arange(len(pose)) * 0.1
    with tempfile.TemporaryDirectory() as folder:
        export_tum(Path(folder) / "tum.txt", t, pose)
        export_kitti(Path(folder) / "kitti.txt", pose)
        tum, kitti = np.loadtxt(Path(folder) / "tum.txt"), np.loadtxt(Path(folder) / "kitti.txt")
    assert tum.shape == (len(pose), 8)
    np.testing.assert_array_equal(tum[:, 0], t)
    np.testing.assert_array_equal(tum[:, 1:4], np.column_stack([pose[:, :2], np.zeros(len(pose))]))
    np.testing.assert_allclose(np.linalg.norm(tum[:, 4:], axis=1), 1)
    about_z = tum[:, 7] + 1j * tum[:, 6]
    np.testing.assert_allclose(about_z**2, np.exp(1j * pose[:, 2]), atol=1e-12)
    assert not tum[:, 4:6].any()
    matrix = kitti.reshape(-1, 3, 4)
    np.testing.assert_allclose(
        matrix[:, :, :3] @ np.swapaxes(matrix[:, :, :3], 1, 2), [np.eye(3)] * len(pose), atol=1e-12
    )
    np.testing.assert_allclose(matrix[:, 0, 0] + 1j * matrix[:, 1, 0], np.exp(1j * pose[:, 2]), atol=1e-12)
    np.testing.assert_array_equal(matrix[:, :, 3], tum[:, 1:4])


def test_rows_without_a_pose_are_left_out_of_tum_and_refused_by_kitti(tmp_path):
    log = sample_log()
    assert log.reference is not None
    export_tum(tmp_path / "tum.txt", log.t, log.reference)
    assert len(np.loadtxt(tmp_path / "tum.txt")) == len(log) - 1
    with pytest.raises(ValueError, match="without a pose"):
        export_kitti(tmp_path / "kitti.txt", log.reference)


def test_a_trajectory_is_exported_in_the_format_asked_for(tmp_path):
    log = sample_log()
    assert log.reference is not None
    export_trajectory(tmp_path / "a", log.t, log.reference)
    export_tum(tmp_path / "b", log.t, log.reference)
    export_trajectory(tmp_path / "c", log.t[3:], log.reference[3:], "kitti")
    export_kitti(tmp_path / "d", log.reference[3:])
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text()
    assert (tmp_path / "c").read_text() == (tmp_path / "d").read_text()
    with pytest.raises(InputError, match="'tum' or 'kitti'"):
        export_trajectory(tmp_path / "e", log.t, log.reference, "csv")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="no pose"):
        export_trajectory(tmp_path / "e", log.t, np.full_like(log.reference, np.nan))
    with pytest.raises(ValueError, match="shape"):
        export_trajectory(tmp_path / "e", log.t[1:], log.reference)
    assert not (tmp_path / "e").exists()


@pytest.mark.skipif(not EVO.exists(), reason="the program evo_traj (pip install evo) is not there")
def test_evo_reads_the_exports(tmp_path):
    log = sample_log()
    assert log.reference is not None
    export_tum(tmp_path / "tum.txt", log.t, log.reference)
    export_kitti(tmp_path / "kitti.txt", log.reference[3:])
    for kind, rows in (("tum", len(log) - 1), ("kitti", len(log) - 3)):
        command = [str(EVO), kind, str(tmp_path / f"{kind}.txt"), "--full_check"]
        done = subprocess.run(
            command, capture_output=True, text=True, check=True, env={**os.environ, "HOME": str(tmp_path)}
        )
        assert f"nr. of poses\t{rows}" in done.stdout
        assert "SE(3) conform\tyes" in done.stdout


@pytest.mark.parametrize(
    ("extra", "vehicle"),
    [
        ("rps_B_x", cfmmr(2)),
        ("rps_age_C", cfmmr(3)),
        ("ref_3_psi", cfmmr(2)),
        ("wheel_4l", cfmmr(3)),
        ("ref_1_x", preset("differential")),
        ("rps_A_phi", preset("differential")),
    ],
)
def test_columns_of_another_train_are_refused_and_not_kept_aside(tmp_path, extra, vehicle):
    columns = LogColumns.of(vehicle)
    names = [*columns.t, *columns.wheel, *columns.pivot, extra]
    rows = [",".join(str(float(k + j)) for j in range(len(names))) for k in range(3)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    with pytest.raises(InputError, match=f"{extra}.*belongs to a train of other axles"):
        read_log(path, vehicle)


def test_an_age_below_zero_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "t,wheel_1l,wheel_1r,wheel_2l,wheel_2r,rps_A_x,rps_A_y,rps_A_phi,rps_age_A\n"
        "0,0,0,0,0,0.35,0,0,0\n0.05,0,0,0,0,0.35,0,0,-1\n"
    )
    with pytest.raises(InputError, match=r"log\.csv:3: column 'rps_age_A': is -1\.0 s; an age is never below 0"):
        read_log(path, cfmmr(2))


@pytest.mark.parametrize("part", ["ref", "fix"])
def test_positions_need_no_column_of_headings(tmp_path, part):
    path = tmp_path / "log.csv"
    path.write_text(f"t,wheel_1l,wheel_1r,{part}_x,{part}_y\n0,0,0,,\n1,1,1,0.5,-0.25\n1.5,,,1,2\n2,2,2,,\n")
    if part == "fix":
        path.write_text(path.read_text().replace("1.5,,,1,2\n", ""))
    log = read_log(path, DIFFERENTIAL)
    positions = getattr(log, {"ref": "reference", "fix": "fix"}[part])
    assert positions.shape == (len(log), 3)
    np.testing.assert_array_equal(positions[1], [0.5, -0.25, np.nan])
    assert np.isnan(positions[:, 2]).all()


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ("1,2,0.5,", "is blank beside a fix; give its age, 0 or more"),
        (",,0.5,-1", "is -1.0 s; give its age, 0 or more"),
        ("1,,0.5,0", "column 'fix_y': is blank, but not all of fix_x, fix_y"),
    ],
)
def test_a_mistake_in_a_fix_is_named(tmp_path, cells, message):
    path = tmp_path / "log.csv"
    rows = f"0,0,0,,,,\n1,1,1,{cells}\n"
    path.write_text("t,wheel_1l,wheel_1r,fix_x,fix_y,fix_psi,fix_age\n" + rows)
    with pytest.raises(InputError, match=f"log\\.csv:3: .*{message}"):
        read_log(path, DIFFERENTIAL)


def test_fixes_without_ages_are_of_the_moment_and_estimators_see_both(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,wheel_1l,wheel_1r,fix_x,fix_y,fix_psi\n0,0,0,,,\n1,1,1,0.5,-0.25,9\n2,2,2,1,2,\n")
    first, second, third = read_log(path, DIFFERENTIAL).observations()
    assert np.isnan(first["fix"]).all()
    np.testing.assert_array_equal(second["fix"], [0.5, -0.25, 9.0])
    np.testing.assert_array_equal(third["fix"], [1.0, 2.0, np.nan])
    assert second["fix_age"] == third["fix_age"] == 0.0


def test_ages_of_nothing_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,wheel_1l,wheel_1r,wheel_2l,wheel_2r,rps_age_A\n0,0,0,0,0,0\n1,0,0,0,0,0\n")
    with pytest.raises(InputError, match="is the age of 'rps_A_x' and the others, which are missing"):
        read_log(path, cfmmr(2))


FULL_HEADER = "t,wheel_1l,wheel_1r,pivot_1,cmd_1l,cmd_1r,ref_x,ref_y,ref_psi,gyro_z"
BEYOND = [
    *((column, value) for column in FULL_HEADER.split(",") for value in ("1e200", "-1e308", "9" * 40)),
    ("t", "1e19"),
    ("wheel_1l", str(2**53 + 2)),
    ("pivot_1", str(-(2**53) - 2)),
    ("cmd_1r", "2e6"),
    ("ref_y", "-2e10"),
    ("ref_psi", "2e6"),
]


@pytest.mark.parametrize(("column", "value"), BEYOND)
def test_a_number_beyond_all_measure_is_refused_where_it_stands(tmp_path, column, value):
    names = FULL_HEADER.split(",")
    rows = [dict.fromkeys(names, "0") | {"t": "0"}, dict.fromkeys(names, "0") | {"t": "1"}]
    rows[0 if value.startswith("-") else 1][column] = value
    line = 2 if value.startswith("-") else 3
    text = "".join(",".join(row[name] for name in names) + "\n" for row in rows)
    (tmp_path / "log.csv").write_text(f"{FULL_HEADER}\n{text}")
    with pytest.raises(InputError) as error:
        read_log(tmp_path / "log.csv", ASOC)
    said = str(error.value)
    assert said.startswith(f"{tmp_path / 'log.csv'}:{line}: column {column!r}: {float(value):g} is beyond +-")
    assert "\n" not in said


@pytest.mark.parametrize(("column", "value"), [("rps_A_x", 1e200), ("rps_B_phi", -1e7), ("rps_age_A", 1e10)])
def test_a_trains_reading_beyond_all_measure_is_refused_by_its_column(tmp_path, column, value):
    rps, age = np.tile([0.35, 0.0, 0.0], (2, 2)), np.zeros((2, 2))
    columns = LogColumns.of(TRAIN)
    if column in columns.rps:
        rps[1, columns.rps.index(column)] = value
    else:
        age[1, columns.rps_age.index(column)] = value
    log = Log(np.array([0.0, 1.0]), np.zeros((2, 6)), np.empty((2, 0)), rps=rps, rps_age=age)
    with pytest.raises(InputError, match=rf":3: column '{column}': .* is beyond"):
        write_log(tmp_path / "log.csv", log, TRAIN)


@pytest.mark.parametrize(
    ("vehicle", "header", "first"),
    [(DIFFERENTIAL, "t,wheel_1,pivot_1", "wheel_1l"), (preset("tricycle"), "t,wheel_1l,wheel_1r", "wheel_1")],
)
def test_nothing_is_to_be_renamed_in_a_log_of_another_robot(tmp_path, vehicle, header, first):
    """A similar name for one of the missing columns leaves the others missing."""
    (tmp_path / "log.csv").write_text(f"{header}\n0,0,0\n1,1,1\n")
    with pytest.raises(
        InputError, match=f"column {first!r}: is missing; the header has {header.replace(',', ', ')};"
    ) as error:
        read_log(tmp_path / "log.csv", vehicle)
    assert "or give the robot or train that made the log" in str(error.value)


def test_counts_are_exact_up_to_their_bound(tmp_path):
    (tmp_path / "log.csv").write_text(f"t,wheel_1l,wheel_1r\n0,{2**53 - 1},{-(2**53)}\n1,{2**53},{1 - 2**53}\n")
    log = read_log(tmp_path / "log.csv", DIFFERENTIAL)
    np.testing.assert_array_equal(np.diff(log.wheel, axis=0), [[1.0, 1.0]])


@pytest.mark.parametrize("extra", [0, 30, 10**4])
def test_a_header_is_listed_as_far_as_people_read_it(tmp_path, extra):
    names = ["t", "wheel_1r", *(f"note {k}" for k in range(extra))]
    (tmp_path / "log.csv").write_text(",".join(names) + "\n" + ",".join("0" for _ in names) + "\n")
    with pytest.raises(InputError, match="column 'wheel_1l': is missing; the header has t, wheel_1r") as error:
        read_log(tmp_path / "log.csv", DIFFERENTIAL)
    said = str(error.value)
    assert len(said) < 600
    assert (f"({len(names)} columns)" in said) == (extra > 0)


@given(st.lists(st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.floats(-1, 1)), min_size=1))
def test_numbers_are_read_bit_for_bit_as_python_reads_them(rows):
    lines = [Line(k, [repr(a), "kept", f" {b!r}"]) for k, (a, b) in enumerate(rows)]
    np.testing.assert_array_equal(numbers(Path("log.csv"), lines, {"a": 0, "b": 2}), rows)


@pytest.mark.parametrize("cell", ["", "nan", "1e999", "1_000", "one"])
def test_a_cell_that_is_no_finite_number_is_named_with_its_place(cell):
    lines = [Line(1, ["1", "2"]), Line(2, ["3", cell])]
    with pytest.raises(InputError, match=r"log\.csv:2: column 'b'"):
        numbers(Path("log.csv"), lines, {"a": 0, "b": 1})
