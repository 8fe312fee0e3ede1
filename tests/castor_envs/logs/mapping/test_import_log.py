"""A recording and a map become a log: units, signs, clocks, rates and mistakes, against known motions."""

import dataclasses
import struct

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs import ChannelMap, import_log, read_log, write_log
from castor_envs.vehicles.presets import preset

START = 1_700_000_000.0
WHEEL = preset("differential").wheels[0]
ROBOT = dataclasses.replace(preset("differential"), sample_period=0.02)
PER_RADIAN = (WHEEL.counts_per_rev or 0) / (2 * np.pi)


def mapped(columns, **sources):
    named = {key: {"channel": key, "sign": 1} | value for key, value in columns.items()}
    return ChannelMap.from_dict(
        {"format": "castor-map/1", "sources": sources or {"main": {"time": "t"}}, "columns": named}
    )


def table(path, **columns):
    cells = [[repr(v) if v == v else "" for v in np.asarray(c, dtype=float).tolist()] for c in columns.values()]
    rows = zip(*cells, strict=True)
    path.write_text("\n".join(",".join(row) for row in [tuple(columns), *rows]) + "\n")
    return path


WHEELS = {"wheel_1l": {"unit": "rad"}, "wheel_1r": {"unit": "rad"}}
T = 0.02 * np.arange(101)
ANGLE = 3 * T + 0.5 * np.sin(2 * T)
"""rad: the angle of a wheel that speeds up and slows down."""


@pytest.mark.parametrize(
    ("unit", "values", "within"),
    [
        ("counts", ANGLE * PER_RADIAN, 1e-9),
        ("rev", ANGLE / (2 * np.pi), 1e-9),
        ("deg", np.degrees(ANGLE), 1e-9),
        ("rad", ANGLE, 1e-9),
        ("m", ANGLE * WHEEL.radius, 1e-9),
        ("counts/row", np.diff(ANGLE, prepend=0) * PER_RADIAN, 1e-9),
        # The trapezoid rule is off by at most h^2/12 (b - a) max|f''|, f'' at most 4 rad/s3 here.
        ("rad/s", 3 + np.cos(2 * T), PER_RADIAN * 0.02**2 / 12 * 2 * 4),
        ("rpm", (3 + np.cos(2 * T)) * 30 / np.pi, PER_RADIAN * 0.02**2 / 12 * 2 * 4),
        ("m/s", (3 + np.cos(2 * T)) * WHEEL.radius, PER_RADIAN * 0.02**2 / 12 * 2 * 4),
    ],
)
def test_wheels_come_in_every_unit(tmp_path, unit, values, within):
    source = table(tmp_path / "run.csv", t=T, wheel_1l=values, wheel_1r=-2 * values)
    columns = {"wheel_1l": {"unit": unit}, "wheel_1r": {"unit": unit, "sign": -1, "scale": 0.5}}
    log = import_log(source, ROBOT, mapped(columns)).log
    np.testing.assert_allclose(log.t, T, atol=1e-9)
    counts = (log.wheel - log.wheel[0]) / 1.0
    np.testing.assert_allclose(counts[:, 0], ANGLE * PER_RADIAN, atol=within)
    np.testing.assert_allclose(counts[:, 1], counts[:, 0], atol=1e-9)


def test_whole_counts_that_a_driver_gave_in_radians_are_whole_again(tmp_path):
    """In single precision, and from an angle on at which the driver was started."""
    counts = np.round(ANGLE * PER_RADIAN)
    angle = (counts / PER_RADIAN + 0.1234).astype(np.float32)
    source = table(tmp_path / "run.csv", t=T, wheel_1l=angle, wheel_1r=ANGLE)
    log = import_log(source, ROBOT, mapped(WHEELS)).log
    np.testing.assert_array_equal(log.wheel[:, 0] - log.wheel[0, 0], counts)
    np.testing.assert_allclose(log.wheel[:, 1], ANGLE * PER_RADIAN, atol=1e-9)


def test_a_counter_that_wraps_counts_on(tmp_path):
    counts = np.round(400 * T * 50)
    source = table(tmp_path / "run.csv", t=T, wheel_1l=np.mod(counts, 2**15), wheel_1r=-counts)
    columns = {"wheel_1l": {"unit": "counts", "wraps_at": 2**15}, "wheel_1r": {"unit": "counts", "sign": -1}}
    log = import_log(source, ROBOT, mapped(columns)).log
    np.testing.assert_array_equal(log.wheel[:, 0], counts)
    np.testing.assert_array_equal(log.wheel[:, 1], counts)


def test_pivots_come_in_radians_of_any_encoder(tmp_path):
    """An encoder of 1000.5 counts a turn behind a gear; angles wrapped at half a turn."""
    robot = preset("1-castor")
    castor = dataclasses.replace(robot.castors[0], pivot_counts_per_rev=1000.5)
    robot = dataclasses.replace(robot, castors=(castor,), sample_period=0.02)
    angle = 4 * T - 1
    wrapped = np.degrees(np.angle(np.exp(1j * angle)))
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, steer=wrapped)
    columns = WHEELS | {"pivot_1": {"channel": "steer", "unit": "deg"}}
    imported = import_log(source, robot, mapped(columns))
    write_log(tmp_path / "log.csv", imported.log, robot)
    log = read_log(tmp_path / "log.csv", robot)
    off = log.pivot[:, 0] * 2 * np.pi / 1000.5 - angle
    np.testing.assert_allclose(np.angle(np.exp(1j * off)), 0.0, atol=1e-9)


def test_commands_gyro_and_reference_have_their_units_and_meaning(tmp_path):
    """Commands hold until the next, here given every second row; the gyro is read with the counts."""
    given = np.where(np.arange(101) % 2 == 0, 60.0 + np.arange(101), np.nan)
    source = table(
        tmp_path / "run.csv", t=1000 * T, wheel_1l=ANGLE, wheel_1r=ANGLE, left=given, right=-given, gyro=np.sin(T) * 90,
        x=1000 * T, y=T * 0, yaw=np.degrees(np.angle(np.exp(2j * T))),
    )  # fmt: skip
    columns = WHEELS | {
        "cmd_1l": {"channel": "left", "unit": "rpm"},
        "cmd_1r": {"channel": "right", "unit": "rpm"},
        "gyro_z": {"channel": "gyro", "unit": "deg/s", "sign": -1},
        "ref_x": {"channel": "x", "unit": "mm"},
        "ref_y": {"channel": "y", "unit": "cm"},
        "ref_psi": {"channel": "yaw", "unit": "deg"},
    }
    imported = import_log(source, ROBOT, mapped(columns, main={"time": "t", "unit": "ms"}))
    log = imported.log
    held = (60.0 + 2 * (np.arange(101) // 2)) * np.pi / 30
    assert log.command is not None
    assert log.gyro is not None
    assert log.reference is not None
    np.testing.assert_allclose(log.command, np.column_stack([held, -held]), atol=1e-12)
    np.testing.assert_allclose(log.gyro, -np.sin(T) * np.pi / 2, atol=1e-12)
    np.testing.assert_allclose(log.reference, np.column_stack([T, 0 * T, 2 * T]), atol=1e-9)
    assert [note.split(":")[0] for note in imported.notes] == ["gyro_z"]


def test_quaternions_are_read_as_headings(tmp_path):
    source = table(
        tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, x=T, y=T, qx=0 * T, qy=0 * T, qz=np.sin(2 * T),
        qw=np.cos(2 * T),
    )  # fmt: skip
    columns = WHEELS | {
        "ref_x": {"channel": "x", "unit": "m"},
        "ref_y": {"channel": "y", "unit": "m"},
        "ref_psi": {"channel": ["qx", "qy", "qz", "qw"], "unit": "quaternion"},
    }
    log = import_log(source, ROBOT, mapped(columns)).log
    assert log.reference is not None
    np.testing.assert_allclose(log.reference[:, 2], 4 * T, atol=1e-9)


@pytest.mark.parametrize("column", ["ref_psi", "fix_psi"])
def test_quaternions_of_0_are_missing_headings(tmp_path, column):
    """As a tracker writes that has lost the robot, here for the tenth of a second from row 10 on."""
    part = column.removesuffix("_psi")
    columns = WHEELS | {
        f"{part}_x": {"channel": "x", "unit": "m"},
        f"{part}_y": {"channel": "y", "unit": "m"},
        column: {"channel": ["qx", "qy", "qz", "qw"], "unit": "quaternion"},
    }

    def imported(seen):
        cells = {"t": T, "wheel_1l": ANGLE, "wheel_1r": ANGLE, "x": T, "y": T, "qx": 0 * T, "qy": 0 * T}
        source = table(tmp_path / "run.csv", **cells, qz=seen * np.sin(T), qw=seen * np.cos(T))
        return import_log(source, ROBOT, mapped(columns))

    seen = (np.arange(101) < 10) | (np.arange(101) >= 15)
    found = imported(seen)
    said = f"{column}: 5 of 101 readings are quaternions of 0, which are no headings and are left out"
    assert said in found.notes
    if column == "ref_psi":
        assert found.tracked is not None
        np.testing.assert_allclose(found.tracked.pose[:, 2], 2 * T[seen], atol=1e-9)
    with pytest.raises(InputError, match=rf"columns\.{column}: all quaternions are 0"):
        imported(0 * T)


def test_a_fast_gyro_is_averaged_so_that_its_whole_turn_stays(tmp_path, bag_writer):
    """500 Hz against counts at 50 Hz: rate 0.5 + t, and a vibration that alternates from reading to reading."""
    with bag_writer(tmp_path / "run", "mcap") as w:
        for k in range(1001):
            t = START + 0.002 * k
            vector = w.make("geometry_msgs/Vector3", 0.0, 0.0, 0.5 + 0.002 * k + (-1) ** k)
            w.put("/imu", "sensor_msgs/Imu", t, w.header(t), w.quaternion(0), np.zeros(9), vector, np.zeros(9), vector,
                  np.zeros(9))  # fmt: skip
            if k % 10 == 0:
                w.joints("/joints", t, t, left=0.02 * k, right=0.01 * k)
    columns = {
        "wheel_1l": {"channel": "/joints position[left]", "unit": "rad"},
        "wheel_1r": {"channel": "/joints position[right]", "unit": "rad"},
        "gyro_z": {"channel": "/imu angular_velocity.z", "unit": "rad/s"},
    }
    log = import_log(tmp_path / "run", ROBOT, mapped(columns, main={"time": "header"})).log
    assert log.gyro is not None
    np.testing.assert_allclose(log.gyro[1:-1], 0.5 + log.t[1:-1], atol=1e-6)
    assert np.trapezoid(log.gyro, log.t) == pytest.approx(0.5 * 2 + 2**2 / 2, abs=0.01)


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rad", 2 * np.pi), ("rev", 1.0)])
def test_a_gyro_that_shows_its_angle_gives_rates_that_sum_to_the_whole_turn(tmp_path, unit, turn):
    """The angle is read as within half a turn, clockwise positive, and turns 1.6 times round."""
    psi = 5 * T + np.sin(T)
    shown = -turn * np.angle(np.exp(1j * psi)) / (2 * np.pi)
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, yaw=shown)
    columns = WHEELS | {"gyro_z": {"channel": "yaw", "unit": unit, "sign": -1}}
    gyro = import_log(source, ROBOT, mapped(columns)).log.gyro
    assert gyro is not None
    np.testing.assert_allclose(gyro[1:-1], 5 + np.cos(T)[1:-1], atol=1e-4)
    edges = np.concatenate([T[:1], (T[1:] + T[:-1]) / 2, T[-1:]])
    assert gyro @ np.diff(edges) == pytest.approx(psi[-1] - psi[0], abs=1e-9)


def test_two_clocks_agree_by_an_offset(tmp_path):
    """The tracker's clock is 40 s behind; its poses come at times of their own."""
    seen = 0.013 * np.arange(154) - 40.0
    table(tmp_path / "tracker.csv", clock=seen, x=np.sin(seen + 40), y=0 * seen, yaw=seen + 40)
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE)
    reference = {
        "ref_x": {"channel": "x", "unit": "m", "source": "tracker"},
        "ref_y": {"channel": "y", "unit": "m", "source": "tracker"},
        "ref_psi": {"channel": "yaw", "unit": "rad", "source": "tracker"},
    }
    tracker = {"file": "tracker.csv", "time": "clock"}
    agreed = mapped(WHEELS | reference, main={"time": "t"}, tracker=tracker | {"offset": 40.0})
    imported = import_log(source, ROBOT, agreed)
    assert imported.tracked is not None
    assert imported.log.reference is not None
    np.testing.assert_allclose(imported.log.t, T, atol=1e-9)
    known = imported.log.t <= imported.tracked.t[-1]
    expected = np.column_stack([np.sin(T), 0 * T, T])[known]
    np.testing.assert_allclose(imported.log.reference[known], expected, atol=0.013**2 / 8 + 1e-9)
    said = r"reference in tracker.csv is from -40.000 to .* share no time, so that their clocks are apart: give"
    with pytest.raises(InputError, match=said):
        import_log(source, ROBOT, mapped(WHEELS | reference, main={"time": "t"}, tracker=tracker))


@pytest.mark.parametrize("with_fixes", [False, True])
def test_positions_far_from_their_origin_begin_near_it_and_what_is_subtracted_is_said(tmp_path, with_fixes):
    """As in UTM; north of the equator in metres, by millimetres."""
    place = {"east": np.round(431_000.7 + T, 3), "north": np.round(5_411_000.2 - 2 * T, 3), "yaw": T}
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, **place)
    units = (("x", "east", "m"), ("y", "north", "m"), ("psi", "yaw", "rad"))
    reference = {f"ref_{part}": {"channel": channel, "unit": unit} for part, channel, unit in units}
    fix = {f"fix_{part}": {"channel": channel, "unit": unit} for part, channel, unit in units} if with_fixes else {}
    log, tracked, notes, _ = import_log(source, ROBOT, mapped(WHEELS | reference | fix))
    assert tracked is not None
    for poses in (tracked.pose, log.reference, log.fix if with_fixes else tracked.pose):
        assert poses is not None
        np.testing.assert_allclose(poses, np.column_stack([0.7 + T, 0.2 - 2 * T, T]), atol=1e-9)
    (note,) = (note for note in notes if "origin" in note)
    assert "431000 m is subtracted from ref_x, 5411000 m from ref_y" in note
    assert ("from fixes too" in note) == with_fixes


def test_millimetres_taken_for_metres_have_no_origin_to_be_subtracted(tmp_path):
    """They begin near it, and only their unit makes them go far; that alone is said, in the first place."""
    place = {"east": 1000 * T - 500.0, "north": 0 * T}
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, **place)
    reference = {f"ref_{part}": {"channel": channel, "unit": "m"} for part, channel in (("x", "east"), ("y", "north"))}
    log, _, notes, _ = import_log(source, ROBOT, mapped(WHEELS | reference))
    assert log.reference is not None
    np.testing.assert_allclose(log.reference[:, 0], place["east"], atol=1e-9)
    assert notes[0].startswith("ref_x: the reference goes 2e+03 m in all, wheels roll ")
    assert not [note for note in notes if "origin" in note]


def test_a_reference_needs_no_heading(tmp_path):
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, x=T, y=-T)
    reference = {f"ref_{part}": {"channel": part, "unit": "cm"} for part in ("x", "y")}
    log, tracked, notes, _ = import_log(source, ROBOT, mapped(WHEELS | reference))
    assert log.reference is not None
    np.testing.assert_allclose(log.reference, np.column_stack([T / 100, -T / 100, np.nan * T]), atol=1e-12)
    write_log(tmp_path / "log.csv", log, ROBOT, tracked)
    again = read_log(tmp_path / "log.csv", ROBOT)
    assert again.reference is not None
    np.testing.assert_array_equal(again.reference, log.reference)
    assert not [note for note in notes if "poses" in note]


def test_fixes_stand_in_the_first_row_after_them_with_their_age(tmp_path):
    """Of two between the same rows the later one; those beyond the rows are left out."""
    seen = np.array([-0.5, 0.1, 0.505, 0.515, 1.21, 7.0])
    table(tmp_path / "markers.csv", clock=seen, east=1000 * seen, north=2 * seen, yaw=np.degrees(3 * seen))
    source = table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE)
    fix = {
        "fix_x": {"channel": "east", "unit": "mm", "source": "markers"},
        "fix_y": {"channel": "north", "unit": "m", "source": "markers"},
    }
    heading = {"fix_psi": {"channel": "yaw", "unit": "deg", "source": "markers"}}
    clocks = {"main": {"time": "t"}, "markers": {"file": "markers.csv", "time": "clock"}}
    log = import_log(source, ROBOT, mapped(WHEELS | fix | heading, **clocks)).log
    assert log.fix is not None
    assert log.fix_age is not None
    rows = np.flatnonzero(np.isfinite(log.fix_age))
    np.testing.assert_allclose(log.t[rows], [0.1, 0.52, 1.22], atol=1e-9)
    np.testing.assert_allclose(log.fix_age[rows], [0.0, 0.005, 0.01], atol=1e-9)
    np.testing.assert_allclose(log.fix[rows], np.outer([0.1, 0.515, 1.21], [1.0, 2.0, 3.0]), atol=1e-9)
    write_log(tmp_path / "log.csv", log, ROBOT)
    np.testing.assert_array_equal(read_log(tmp_path / "log.csv", ROBOT).fix, log.fix)
    positions = import_log(source, ROBOT, mapped(WHEELS | fix, **clocks)).log.fix
    np.testing.assert_array_equal(positions, np.where([True, True, False], log.fix, np.nan))
    with pytest.raises(InputError, match=r"no fix between the first and the last row .* 'offset'"):
        import_log(source, ROBOT, mapped(WHEELS | fix, main=clocks["main"], markers={**clocks["markers"], "offset": 9}))


@pytest.mark.parametrize("sources", [None, {}, {"main": {}}, {"other": {"file": "other.csv"}}])
def test_a_map_that_names_no_clock_takes_that_of_the_survey(tmp_path, bag_writer, sources):
    with bag_writer(tmp_path / "bag", "mcap") as w:
        for t, angle in zip(T.tolist(), ANGLE.tolist(), strict=True):
            w.joints("/joints", START + 1.1 * t, START + t, left=angle, right=angle)
    given = {} if sources is None else {"sources": sources}

    def imported(source, left, right):
        columns = {"wheel_1l": {"channel": left, "unit": "rad"}, "wheel_1r": {"channel": right, "unit": "rad"}}
        by = ChannelMap.from_dict({"format": "castor-map/1", "columns": columns} | given)
        return import_log(source, ROBOT, by).log.t

    names = ("/joints position[left]", "/joints position[right]")
    np.testing.assert_allclose(imported(tmp_path / "bag", *names), T, atol=1e-6)
    path = table(tmp_path / "run.csv", stamp_ms=1000 * T, left=ANGLE, right=ANGLE)
    np.testing.assert_allclose(imported(path, "left", "right"), T, atol=1e-9)
    untimed = table(tmp_path / "bare.csv", left=-ANGLE, right=-ANGLE)
    with pytest.raises(InputError, match='no column is known to be the time; give it as "time", or a "period"'):
        imported(untimed, "left", "right")


@pytest.mark.parametrize(
    ("unit", "second"), [(None, 1e3), ("s", 1.0), ("ms", 1e3), ("us", 1e6), ("min", 1 / 60), ("h", 1 / 3600)]
)
def test_a_unit_is_obeyed_where_the_clock_is_left_to_the_recording(tmp_path, unit, second):
    """A column that says ms, which is what counts where the map has no unit."""
    path = table(tmp_path / "run.csv", stamp_ms=second * T, left=ANGLE, right=ANGLE)
    columns = {"wheel_1l": {"channel": "left", "unit": "rad"}, "wheel_1r": {"channel": "right", "unit": "rad"}}
    log = import_log(path, ROBOT, mapped(columns, main={} if unit is None else {"unit": unit})).log
    np.testing.assert_allclose(log.t, T, atol=1e-9)


def test_topics_of_one_bag_may_have_two_clocks(tmp_path, bag_writer):
    """Ticks without a header, when they were received; poses by the stamps of a computer that is 3 s ahead."""
    with bag_writer(tmp_path / "run.bag", "ros1") as w:
        for k in range(51):
            t = START + 0.02 * k
            w.put("/left_ticks", "std_msgs/Int32", t, 10 * k)
            w.put("/right_ticks", "std_msgs/Int32", t, -12 * k)
            w.put("/vicon", "geometry_msgs/PoseStamped", t + 0.004, w.header(t + 3.0), w.pose(0.02 * k, 0.0, 0.0))
    pose = {"unit": "m", "source": "tracker"}
    columns = {
        "wheel_1l": {"channel": "/left_ticks data", "unit": "counts"},
        "wheel_1r": {"channel": "/right_ticks data", "unit": "counts", "sign": -1},
        "ref_x": {"channel": "/vicon pose.x"} | pose,
        "ref_y": {"channel": "/vicon pose.y"} | pose,
        "ref_psi": {"channel": "/vicon pose.heading"} | pose | {"unit": "rad"},
    }
    clocks = {"main": {"time": "receive"}, "tracker": {"time": "header", "offset": -3.0}}
    log = import_log(tmp_path / "run.bag", ROBOT, mapped(columns, **clocks)).log
    assert log.reference is not None
    np.testing.assert_array_equal(log.wheel, np.outer(np.arange(51), [10, 12]))
    np.testing.assert_allclose(log.reference[:, 0], log.t, atol=1e-6)


def test_wheels_of_two_topics_are_brought_to_the_times_of_the_slower_one(tmp_path):
    left, right = 0.02 * np.arange(101), 0.005 + 0.01 * np.arange(202)
    path = tmp_path / "run.csv"
    rows = sorted([(t, repr(3 * t), "") for t in left.tolist()] + [(t, "", repr(5 * t)) for t in right.tolist()])
    path.write_text("t,wheel_1l,wheel_1r\n" + "".join(f"{t!r},{a},{b}\n" for t, a, b in rows))
    log = import_log(path, ROBOT, mapped(WHEELS)).log
    np.testing.assert_allclose(log.t, left[1:] - left[1], atol=1e-8)
    np.testing.assert_allclose(log.wheel / PER_RADIAN, np.outer(left[1:], [3, 5]), atol=1e-6)


def test_readings_that_are_missing_or_no_numbers_are_left_out_and_said(tmp_path):
    left, right = ANGLE.copy(), ANGLE.copy()
    left[10:20:2], right[50] = np.nan, np.nan
    path = tmp_path / "run.csv"
    path.write_text("t,wheel_1l,wheel_1r\n" + "".join(f"{t},{a},{b}\n" for t, a, b in zip(T, left, right, strict=True)))
    imported = import_log(path, ROBOT, mapped(WHEELS))
    assert "wheel_1l: 5 of 101 readings are no finite numbers and are left out" in imported.notes
    np.testing.assert_allclose(imported.log.wheel[:, 0] / PER_RADIAN, np.interp(imported.log.t, T, ANGLE), atol=1e-9)
    assert len(imported.log) == 96


@pytest.mark.parametrize(
    ("gone", "said"),
    [
        ([(0.49, 1.01)], "rows: none for 0.54 s after 0.480 s of the log: was the recording interrupted"),
        (
            [(0.09, 0.29), (0.49, 1.01)],
            "rows: none for 0.54 s after 0.480 s of the log, the longest of 2 gaps: was the",
        ),
        ([(0.49, 0.61)], None),
    ],
)
def test_a_gap_in_the_counts_is_said(tmp_path, gone, said):
    kept = ~np.any([(start < T) & (end > T) for start, end in gone], axis=0)
    path = table(tmp_path / "run.csv", t=T[kept], wheel_1l=ANGLE[kept], wheel_1r=ANGLE[kept])
    notes = [note for note in import_log(path, ROBOT, mapped(WHEELS)).notes if note.startswith("rows: none")]
    assert [note.startswith(said or "-") for note in notes] == ([] if said is None else [True])


def test_entries_that_are_written_when_they_change_hold_in_between(tmp_path, write_wpilog):
    """The left wheel stands for a second, and is not written; both are written 30 us apart in each cycle of 20 ms."""
    pytest.importorskip("wpiutil", reason="WPILib's reader is not installed: pip install robotpy-wpiutil")
    angles = [(max(0, k - 50) * 0.1, k * 0.2) for k in range(101)]
    records = []
    for k, (left, right) in enumerate(angles):
        if k == 0 or left != angles[k - 1][0]:
            records.append((0, 20_000 * k, struct.pack("<d", left)))
        records.append((1, 20_000 * k + 30, struct.pack("<d", right)))
    path = tmp_path / "run.wpilog"
    path.write_bytes(write_wpilog([("NT:/left", "double"), ("NT:/right", "double")], records))
    columns = {
        "wheel_1l": {"channel": "NT:/left", "unit": "rad"},
        "wheel_1r": {"channel": "NT:/right", "unit": "rad"},
    }
    slow = dataclasses.replace(ROBOT, sample_period=0.1)  # of the robot file: no row is left out for it
    log = import_log(path, slow, mapped(columns, main={})).log
    np.testing.assert_allclose(log.t, T, atol=1e-4)
    np.testing.assert_allclose(log.wheel / PER_RADIAN, angles, atol=1e-9)
    speeds = {key: value | {"unit": "rad/s"} for key, value in columns.items()}
    summed = import_log(path, ROBOT, mapped(speeds, main={})).log
    rates = np.array(angles)[:-1]
    np.testing.assert_allclose(np.diff(summed.wheel, axis=0) / PER_RADIAN, rates * 0.02, atol=1e-3)


def test_a_typo_beside_a_column_of_text_is_no_text(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,left,left_ticks,wheel_1r\n" + "".join(f"{k},A,{k},{k}\n" for k in range(5)))
    with pytest.raises(InputError, match="did you mean 'left_ticks'"):
        import_log(path, ROBOT, mapped(WHEELS | {"wheel_1l": {"channel": "left ticks", "unit": "counts"}}))


@pytest.mark.parametrize("channel", ["NT:/left.x", "NT:/left[0].x", "NT:/left"])
def test_why_a_structs_numbers_are_absent_is_said(tmp_path, write_wpilog, channel):
    pytest.importorskip("wpiutil", reason="WPILib's reader is not installed: pip install robotpy-wpiutil")
    records = [(k, 20_000 * i, struct.pack("<d", i)) for i in range(5) for k in (0, 1)]
    path = tmp_path / "run.wpilog"
    path.write_bytes(write_wpilog([("NT:/left", "struct:Mine"), ("NT:/right", "double")], records))
    columns = {"wheel_1l": {"channel": channel, "unit": "rad"}, "wheel_1r": {"channel": "NT:/right", "unit": "rad"}}
    with pytest.raises(InputError, match=r"it is left out \(of type struct:Mine, of which no numbers are read\)"):
        import_log(path, ROBOT, mapped(columns, main={}))
    columns["wheel_1l"]["channel"] = "NT:/lefty"
    with pytest.raises(InputError, match="did you mean"):
        import_log(path, ROBOT, mapped(columns, main={}))


GOOD = {"t": T, "wheel_1l": ANGLE, "wheel_1r": ANGLE, "x": T, "y": T, "yaw": T}
POSE = {key: {"channel": key[4:].replace("psi", "yaw"), "unit": unit} for key, unit in
        (("ref_x", "m"), ("ref_y", "m"), ("ref_psi", "rad"))}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wheel_1l": {"unit": "rads"}}, ["columns.wheel_1l.unit", "'rads' does not fit wheel_1l", "counts, rev, deg"]),
        ({"wheel_1l": None}, ["columns.wheel_1l", "is missing", "counts_per_rev"]),
        (
            {"wheel_2l": {"unit": "rad"}},
            ["columns.wheel_2l", "no column of", "give the robot that was recorded", "did you mean 'wheel_1l'"],
        ),
        ({"wheel_1l": {"unit": "rad", "channel": "?"}}, ["columns.wheel_1l.channel", "is still '?'"]),
        ({"wheel_1l": {"unit": "rad", "channel": "wheel1l"}}, ["columns.wheel_1l", "did you mean 'wheel_1l'"]),
        ({"wheel_1l": {"unit": "rad", "source": "other"}}, ["columns.wheel_1l.source", "'other'", "known: main"]),
        ({"ref_x": None}, ["columns.ref_x", "is missing"]),
        ({"ref_psi": {"channel": "yaw", "unit": "quaternion"}}, ["columns.ref_psi.channel", "four"]),
        ({"gyro_z": {"channel": "yaw", "unit": "m"}}, ["columns.gyro_z.unit", "rad/s, deg/s"]),
        ({"t": {"unit": "s"}}, ["columns.t", "no column"]),
        ({"fix_age": {"unit": "s"}}, ["columns.fix_age", "no column"]),
        ({"fix_x": {"channel": "x", "unit": "m"}}, ["columns.fix_y", "is missing"]),
        ({"wheel_1r": {"unit": "rad", "channel": "wheel_1l"}}, ["columns.wheel_1r.channel", "that of wheel_1l too"]),
        ({"ref_y": {"unit": "m", "channel": "x"}}, ["columns.ref_y.channel", "'x' is that of ref_x too"]),
        ({"wheel_1l": {"unit": "rad", "wraps_at": 1.0}}, ["columns.wheel_1l.wraps_at", "range over 5.62"]),
    ],
)
def test_a_wrong_map_is_refused_by_its_place(tmp_path, change, words):
    columns = {key: value for key, value in (WHEELS | POSE | change).items() if value is not None}
    with pytest.raises(InputError) as caught:
        import_log(table(tmp_path / "run.csv", **GOOD), ROBOT, mapped(columns), "map.json")
    for word in ["map.json", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({}, ["'format' must be 'castor-map/1'"]),
        ({"format": "castor-map/1"}, ["columns", "required"]),
        ({"format": "castor-map/1", "columns": {"wheel_1l": {"channel": "a"}}}, ["columns.wheel_1l.unit", "required"]),
        ({"format": "castor-map/1", "columns": {"a": {"channel": "a", "unit": "rad", "sgn": 1}}}, ["sgn", "not known"]),
        ({"format": "castor-map/1", "columns": {"a": {"channel": "a", "unit": "rad", "sign": 2}}}, ["a.sign"]),
        (
            {"format": "castor-map/1", "columns": {}, "sources": {"main": {"unit": "week"}}},
            ["sources.main.unit", "'week'"],
        ),
        *(
            (
                {"format": "castor-map/1", "columns": {}, "sources": {"main": {"period": given}}},
                ["sources.main.period: Input should be more than 0 and at most 1e+06 s, or '?'"],
            )
            for given in (0, -0.1, 1e7, "0.1", True, [0.1])
        ),
        *(
            (
                {"format": "castor-map/1", "columns": {"a": {"channel": given, "unit": "rad"}}},
                ["columns.a.channel: Input"],
            )
            for given in (["a", "b"], ["a"], [], "", 7, None, ["a", "b", "c", 4])
        ),
    ],
)
def test_a_map_that_is_no_map_is_refused(data, words):
    with pytest.raises(InputError) as caught:
        ChannelMap.from_dict(data, "map.json")
    for word in ["map.json", *words]:
        assert word in str(caught.value)
    assert not any(word in str(caught.value) for word in ("constrained", "tuple", "pydantic"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"t": T - 0.78 * (T > 0.79)},
            ["columns.", "the clock goes back by 0.76 s at reading 41", "cut the recording"],
        ),
        ({"t": T + 9.0 * (np.arange(101) == 40)}, ["the clock goes back by 8.98 s at reading 42"]),
        ({"t": T + 9.0 * (np.arange(101) % 2)}, ["the clock goes back by 8.98 s at reading 3"]),
        ({"t": np.floor(T)}, ["columns.", "98 of 101 readings repeat a time", "another 'time'"]),
        ({"yaw": np.degrees(T)}, ["columns.ref_psi", "turns at 57.3 rad/s", "unit 'rad' right"]),
        ({"yaw": np.degrees(np.angle(np.exp(2.9j + 0.5j * T)))}, ["heading steps by 359 rad after", "'rad' right"]),
        ({"wheel_1r": np.full(101, np.nan)}, ["columns.wheel_1r", "no readings of 'wheel_1r'"]),
        ({"wheel_1r": np.where(T < 0.01, 1, np.nan)}, ["no two rows have readings of all of", "wheel_1r from 0.000"]),
    ],
)
def test_a_recording_that_cannot_be_used_is_refused(tmp_path, change, words):
    source = table(tmp_path / "run.csv", **(GOOD | change))
    with pytest.raises(InputError) as caught:
        import_log(source, ROBOT, mapped(WHEELS | POSE))
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("late", [[40], [40, 41, 42, 43], [1, 40, 100]])
@pytest.mark.parametrize("by", [0.1, 0.13, 1e4])
def test_a_few_readings_out_of_order_are_left_out_and_counted(tmp_path, late, by):
    """By as much as an earlier reading's time, by less, and by a time that is far off."""
    source = table(tmp_path / "run.csv", **(GOOD | {"t": T - np.where(np.isin(np.arange(101), late), by, 0.0)}))
    imported = import_log(source, ROBOT, mapped(WHEELS))
    np.testing.assert_allclose(imported.log.t, np.delete(T, late), atol=1e-9)
    np.testing.assert_allclose(imported.log.wheel[:, 0], np.delete(ANGLE, late) * PER_RADIAN, atol=1e-9)
    said = f"{len(late)} of 101 readings come after later ones and are left out"
    assert [note for note in imported.notes if "of 101" in note] == [f"2 columns (wheel_1l, wheel_1r): {said}"]


@pytest.mark.parametrize("late", [[40], [40, 42, 44], [2, 40, 98]])
@pytest.mark.parametrize("unit", ["rad", "rad/row"])
def test_messages_that_come_late_are_read_in_the_order_of_their_stamps(tmp_path, bag_writer, late, unit):
    """By two rows, but one whose stamp is that of another hour."""
    received, stamp = START + np.array(T), START + np.array(T)
    received[late] += 0.05
    stamp[70] -= 3600
    values = ANGLE if unit == "rad" else np.diff(ANGLE, prepend=0.0)
    with bag_writer(tmp_path / "bag", "mcap") as w:
        for k in np.argsort(received):
            w.joints("/joints", received[k], stamp[k], left=values[k], right=values[k])
    named = {
        key: {"channel": f"/joints position[{side}]", "unit": unit}
        for key, side in zip(WHEELS, ("left", "right"), strict=True)
    }
    log, _, notes, _ = import_log(tmp_path / "bag", ROBOT, mapped(named, main={"time": "header"}))
    np.testing.assert_allclose(log.t, np.delete(T, 70), atol=1e-6)
    np.testing.assert_allclose(log.wheel[:, 0], np.delete(ANGLE, 70) * PER_RADIAN, atol=1e-6)
    columns = "2 columns (wheel_1l, wheel_1r)"
    assert [note for note in notes if "of 101" in note] == [
        f"{columns}: 1 of 101 readings come after later ones and are left out",
        f"{columns}: {len(late)} of 101 readings come after later ones and are put in the order of their stamps",
    ]


def test_increments_that_are_left_out_are_summed_all_the_same(tmp_path):
    """Of readings that repeat a time, and that come after later ones, the wheel has still turned by them."""
    step = np.diff(ANGLE, prepend=0.0)
    t = T - np.where(np.isin(np.arange(101), [30, 31]), 0.05, 0.0) - np.where(np.arange(101) == 60, 0.02, 0.0)
    source = table(tmp_path / "run.csv", t=t, wheel_1l=step, wheel_1r=step)
    log = import_log(source, ROBOT, mapped({key: {"unit": "rad/row"} for key in WHEELS})).log
    assert len(log) == 98
    np.testing.assert_allclose(log.wheel[:, 0], np.delete(ANGLE, [30, 31, 60]) * PER_RADIAN, atol=1e-9)


def test_speeds_are_not_summed_over_a_gap(tmp_path):
    gone = (T < 0.5) | (T > 1.2)
    source = table(tmp_path / "run.csv", t=T[gone], wheel_1l=ANGLE[gone], wheel_1r=ANGLE[gone])
    columns = {"wheel_1l": {"unit": "rad/s"}, "wheel_1r": {"unit": "rad/s"}}
    with pytest.raises(InputError, match=r"no reading for 0.74 s from 0.480 s on.*cut the recording"):
        import_log(source, ROBOT, mapped(columns))


def test_doubtful_units_and_rates_are_said(tmp_path):
    source = table(tmp_path / "run.csv", t=T * 5, wheel_1l=np.degrees(ANGLE) * 20, wheel_1r=ANGLE)
    notes = import_log(source, ROBOT, mapped(WHEELS)).notes
    assert any(note.startswith("wheel_1l: turns at") and "unit" in note for note in notes)
    assert any("rows come every 0.1 s" in note and "sample_period is 0.02" in note for note in notes)


def test_a_sign_that_the_reference_contradicts_is_said(tmp_path):
    """A straight drive: both wheels roll as far as the reference goes, until the map turns one round."""
    way = ANGLE * WHEEL.radius
    source = table(tmp_path / "run.csv", **(GOOD | {"x": way, "y": 0 * T, "yaw": 0 * T}))
    assert import_log(source, ROBOT, mapped(WHEELS | POSE)).notes == ()
    turned = {"wheel_1r": {"unit": "rad", "sign": -1}}
    (note,) = import_log(source, ROBOT, mapped(WHEELS | turned | POSE)).notes
    assert note.startswith("wheel_1r: rolls against")


def test_a_slow_reference_is_used_near_its_poses_and_that_is_said(tmp_path):
    x = np.where(np.arange(101) % 25 == 0, T, np.nan)
    source = table(tmp_path / "run.csv", **(GOOD | {"x": x, "y": x, "yaw": x}))
    imported = import_log(source, ROBOT, mapped(WHEELS | POSE))
    assert imported.log.reference is not None
    assert np.flatnonzero(np.isfinite(imported.log.reference[:, 0])).tolist() == [0, 25, 50, 75, 100]
    assert "reference: 5 poses, 2 a second, near enough to 5 of 101 rows" in imported.notes


def test_a_recording_is_kept_in_memory_only_by_its_mapped_channels(tmp_path, monkeypatch):
    """Of a file with a hundred columns, readings of two are made."""
    from castor_envs.logs.recordings import csv_table

    made = []
    inner = csv_table.Reading
    monkeypatch.setattr(csv_table, "Reading", lambda *reading: made.append(reading[0]) or inner(*reading))
    other = {f"other_{k}": T for k in range(100)}
    import_log(table(tmp_path / "run.csv", t=T, wheel_1l=ANGLE, wheel_1r=ANGLE, **other), ROBOT, mapped(WHEELS))
    assert sorted({*made}) == ["wheel_1l", "wheel_1r"]
    assert len(made) == 202
