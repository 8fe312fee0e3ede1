"""CSV files with any columns, TUM and KITTI text."""

import itertools
import math

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs.recordings import open_recording, recognised
from castor_envs.logs.recordings.recording import Clock, survey
from castor_envs.logs.trajectory_files import export_kitti, export_tum


def written(folder, text, name="run.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def read(path, channel, clock=None):
    recording = open_recording(path)
    found = recording.readings(frozenset([channel]), recording.clock() if clock is None else clock)
    return [(reading.time / 1e9, reading.value) for reading in found]


@pytest.mark.parametrize(
    "text",
    [
        "t,left\n0,1\n0.5,2\n",
        "time [s];left\n0;1\n0.5;2\n",
        "# run 7\n\n# t left\n0 1\n0.5 2\n",
        "Robot,7\nt\tleft\n0\t1\n0.5\t2\n",
        "left,mode,stamp_ms\n1,AUTO,0\n2,AUTO,500\n",
        "left,timestamp\n1,1700000000000000000\n2,1700000000500000000\n",
        "\ufeffleft,time\n1,1700000000.0\n2,1700000000.5\n",
        "title\n,\ntime_us,left\n0,1\n\n500000,2\n",
        "time (ms);left\n0,0;1,0\n500,0;2,00e0\n",
        "t\tleft\tright\n0,0\t1,0\t0\n0,5\t2,0\t0\n",
        "timestamp,left\n2024-05-01T12:00:00.250Z,1\n2024-05-01T12:00:00.750Z,2\n",
        "left;datetime\n1,0;2024-05-01 23:59:59,75\n2,0;2024-05-02 00:00:00,25\n",
        "mode,date,left\nAUTO,2024-05-01T13:00:00+01:00,1\nAUTO,2024-05-01T12:00:00.5+00:00,2\n",
        "time,left\n12:00:01.5,1\n12:00:02.0,2\n",
        "left;Uhrzeit\n1,0;9:59:59,75\n2,0;10:00:00,25\n",
        "time,left\n23:59:59.75,1\n00:00:00.25,2\n",
        "date,left\n2024/05/01 12:00:00.250,1\n2024/05/01 12:00:00.750,2\n",
        "left;Datum\n1,0;31.5.2024 23:59:59,75\n2,0;1.6.2024 0:00:00,25\n",
        "time,left\n01:30.000,1\n01:30.500,2\n",
        "left;Zeit\n1,0;59:59,75\n2,0;00:00,25\n",
        "date,left\n45943.36,1\n45943.360005787037,2\n",
        "date,time,left\n2024-05-31,23:59:59.75,1\n2024-06-01,00:00:00.25,2\n",
        "left clock day\n1 23:59:59.75 31.05.2024\n2 00:00:00.25 01.06.2024\n",
        "time,cycle_time,left,timestamp\nA,1,1,0\nA,1,2,0.5\n",
        "header.stamp.sec,header.stamp.nanosec,left\n1700000000,900000000,1\n1700000001,400000000,2\n",
        "left,field.header.stamp.secs,field.header.stamp.nsecs\n1,7,900000000\n2,8,400000000\n",
        "sec,nanosec,left\n1,900000000,1\n2,400000000,2\n",
        "t,mode,state,robot,left\n0,A,B,C,1\n0.5,A,B,C,2\n",
        "t,note,state\tnow,left\n0,a b,5 7,1\n0.5,c d,5 7,2\n",
        't,left\n"0,0","1,00"\n"0,5","2,00"\n',
        "t left x\n0,0 1,00 0\n0,5 2,00 0\n",
        "t | left\n0|1\n0.5|2\n",
        "t,left\n0,1,\n0.5,2,\n",
        "t,left,\n0,1\n0.5,2\n",
        "t,left,\n0,1,\n0.5,2,\n",
        "t,left,x\n0,1,NA\n0.25,-,NULL\n0.5,2,n/a\n",
        "# line\n" * 300 + "# t left\n" + "0 1\n  # in between\n0.5 2\n",
        "# my data\n#\nt, left\n0, 1\n0.5, 2\n",
    ],
)
def test_delimiter_header_and_time_are_found(tmp_path, text):
    (start, first), (end, second) = read(written(tmp_path, text), "left")
    assert (first, second) == (1.0, 2.0)
    assert end - start == pytest.approx(0.5, abs=1e-6)


def test_dates_are_seconds_since_1970(tmp_path):
    """11017.5 days after it; without a zone as in UTC."""
    zones = ("2000-03-01 12:00:00 UTC", "2000-03-01 14:00:00.0 +02:00")
    iso = ("2000-03-01T12:00:00", "2000-03-01T12:00:00Z", "2000-03-01T14:00:00+02:00")
    for day in (*iso, "2000/03/01 12:00:00", "2000.3.1 12:00", "01.03.2000 12:00:00", "1.3.2000 12:00:00Z", *zones):
        path = written(tmp_path, f"timestamp,left\n{day},1\n2000-03-01T15:00:00Z,2\n")
        assert read(path, "left")[0] == (11017.5 * 86400, 1.0)


@pytest.mark.parametrize("coding", ["utf-16", "utf-16-le", "utf-8-sig", "cp1252"])
def test_a_file_is_read_in_the_coding_of_the_program_that_wrote_it(tmp_path, coding):
    mark = "\ufeff" if coding == "utf-16-le" else ""
    path = tmp_path / "run.csv"
    path.write_bytes(f"{mark}t;Drehrate (°/s)\r\n0;1,5\r\n1;2,5\r\n".encode(coding))
    recording = open_recording(path)
    found = list(recording.readings(frozenset(["Drehrate (°/s)"]), Clock("t")))
    assert [(reading.time, reading.value) for reading in found] == [(0, 1.5), (10**9, 2.5)]
    said = ["run.csv: is not all UTF-8: other lines are read as Windows-1252; save it as UTF-8 if names look wrong"]
    assert recording.notes == (said if coding == "cp1252" else [])


def test_bytes_of_0_at_the_end_are_left_out_with_a_note(tmp_path):
    for last, count in ((b"1,2\n", 2), (b"1,2", 2), (b"1", 1)):
        path = tmp_path / "run.csv"
        path.write_bytes(b"t,left\n0,1\n" + last + bytes(4000))
        recording = open_recording(path)
        assert survey(recording, Clock("t"))["left"].count == count
        assert recording.notes[0] == "run.csv: 4000 bytes of 0 at its end are left out, as where power was lost"


def test_a_minus_of_print_and_a_degree_sign_are_read(tmp_path):
    path = written(tmp_path, "t,left,turn\n0,−1.5,−13.5°\n1,2,14 °\n")
    assert read(path, "left", Clock("t")) == [(0.0, -1.5), (1.0, 2.0)]
    assert read(path, "turn", Clock("t")) == [(0.0, -13.5), (1.0, 14.0)]


def test_what_is_no_text_and_cells_without_end_are_named(tmp_path):
    path = tmp_path / "run.csv"
    for content, words in ((b"t,left\n0,\0\n", ":2: is no text"), (b"\xff\xfet\0\xd8", "no text in UTF-16")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=words):
            read(path, "left")
    written(tmp_path, f"t,left\n0,1\n1,{'9' * 200_000}\n")
    with pytest.raises(InputError, match=r"run\.csv:3: is not CSV .* mend the line"):
        read(path, "left")


def test_units_in_a_line_of_their_own_are_added_to_the_names_above(tmp_path):
    path = written(tmp_path, "time,left,yaw_rate,mode\n[s],deg,(rad/s^2),-\n0,1,7,A\n5,2,8,A\n10,3,9,B\n")
    recording = open_recording(path)
    assert recording.clock() == Clock("time [s]")
    assert sorted(survey(recording, recording.clock())) == ["left [deg]", "yaw_rate [rad/s^2]"]
    assert read(written(tmp_path, "run 7,\nm,s\n1,0\n2,1\n"), "m", Clock("s")) == [(0.0, 1.0), (1.0, 2.0)]


@pytest.mark.parametrize(
    "unit",
    [
        "mps",
        "dps",
        "meters",
        "metres",
        "seconds",
        "degs",
        "rads",
        "cps",
        "usec",
        "µs",
        "μs",
        "mm",
        "ticks/s",
        "deg/s^2",
    ],
)
def test_every_word_for_a_unit_may_stand_in_a_line_of_units(tmp_path, unit):
    path = written(tmp_path, f"stamp,left,mode\ns,{unit},-\n0,1,A\n5,2,B\n")
    assert sorted(survey(open_recording(path), Clock("stamp [s]"))) == [f"left [{unit}]"]


@pytest.mark.parametrize(
    ("above", "names"),
    [
        ("t,left\n# calibrated\n", ["t", "left"]),
        ("t,left\n# calibrated on Monday, in the hall\n", ["t", "left"]),
        ("# robot 7, hall 2\nt,left\n#\n# a, b\n", ["t", "left"]),
        ("t,left\n# s,deg\n", ["t [s]", "left [deg]"]),
        ("# t,left\n# s,deg\n", ["t [s]", "left [deg]"]),
        ("A run of Monday\n# t,left\n", ["t", "left"]),
    ],
)
def test_comments_have_the_names_only_where_no_other_line_has(tmp_path, above, names):
    time, left = names
    assert read(written(tmp_path, f"{above}0,1\n1,2\n"), left, Clock(time)) == [(0.0, 1.0), (1.0, 2.0)]


def test_what_is_left_out_and_why(tmp_path):
    rows = "0,A,1,NA,,nan\n1,B,ERR,NULL,-,nan\n2,B,3,n/a,,nan\n"
    recording = open_recording(written(tmp_path, f"t,mode,left,gps,spare,bad\n{rows}"))
    assert sorted(survey(recording, Clock("t"))) == ["left"]
    assert recording.left_out == {
        "mode": "text",
        "left": "in part, from 'ERR' in line 3 on: an import refuses what is no number; mend or blank it",
        "gps": "blank in all rows",
        "spare": "blank in all rows",
        "bad": "no finite number",
    }


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("t;left;x\n0,000;250.000;-33,961\n1,960;256.221;-33,962\n", 256221.0),
        ("t;left;x\n0,00;0;1.234.567,5\n1,96;-1.256.221;0\n", -1256221.0),
        ("t;left;x\n0.000;1;-33.961\n1.960;1,376;-33.962\n", 1376.0),
        ("t\tleft\tx\n0.000\t1\t-33.961\n1.960\t1,376\t-33.962\n", 1376.0),
        ('t,left,x\n0.000,"0",-33.961\n1.960,"199,082",7\n', 199082.0),
        ("t;left;x\n" + "1;2;3\n" * 300 + "2;1.376;1,5\n", 1376.0),
        ("t,left,x\n1,1.250,1.125\n2,1.376,1.126\n", 1.376),
        ("t;left\n980;999\n1.000;1.001\n", 1001.0),  # a column that also has whole numbers
        ("t\tleft\n1.000\t1.125\n1.020\t1.250\n", 1.25),  # points alone
        ("t\tleft\n1.000\t1.125e+00\n1.020\t1.250e+01\n", 12.5),
        ("t;left;firmware\n1.000;7;2.104.118\n1.020;8;2.104.118\n", 8.0),
        ('t,mode,left,note\n0,"auto",1.125,"ok"\n1,"auto",1.250,"ok"\n', 1.25),
    ],
)
def test_the_sign_before_decimals_is_that_of_the_file_and_the_other_one_is_between_thousands(tmp_path, text, count):
    assert read(written(tmp_path, text), "left", Clock(period=1.0))[-1][1] == count


@pytest.mark.parametrize(
    ("text", "cell"),
    [
        ('t,left\n"0","1,234"\n"1","2,345"\n', "1,234"),
        ("t;left\n0;1,376\n1;1,377\n", "1,376"),
        ("t;x;left\n0,00;0,5;1.25\n0,02;0,6;1.250\n", "1.25"),
    ],
)
def test_a_number_is_refused_whose_sign_may_be_before_decimals_or_between_thousands(tmp_path, text, cell):
    recording = open_recording(written(tmp_path, text))
    with pytest.raises(InputError, match=rf"'left': '{cell}' has a sign that may stand before decimals or between"):
        list(recording.readings(frozenset(["left"]), Clock(period=1.0)))
    survey(recording, Clock(period=1.0))
    assert "may stand before decimals" in recording.left_out["left"] or "in part" in recording.left_out["left"]


@pytest.mark.parametrize("names", ["time;signal;value", "value;time;signal", "signal;stamp.sec;stamp.nanosec;value"])
def test_a_file_of_one_reading_a_row_has_a_channel_for_each_name(tmp_path, names):
    rows = [(k, name, value) for k in range(50) for name, value in (("drive.pos", k / 4), ("steer", -k), ("x", k))][:-2]
    cell = {"time": "{0}", "stamp.sec": "{0}", "stamp.nanosec": "500000000", "signal": "{1}", "value": "{2}"}
    line = ";".join(cell[name] for name in names.split(";"))
    path = written(tmp_path, f"{names}\n" + "".join(line.format(*row) + "\n" for row in rows))
    recording = open_recording(path)
    found = survey(recording, recording.clock())
    assert {name: channel.count for name, channel in found.items()} == {"drive.pos": 50, "steer": 49, "x": 49}
    assert recording.left_out == {}
    assert "each of these is a channel" in recording.notes[0]
    assert [(t - t % 1, value) for t, value in read(path, "steer")] == [(k, -k) for k in range(49)]


def test_a_map_that_names_the_column_of_numbers_has_all_of_it(tmp_path):
    path = written(tmp_path, "t,fix,left\n" + "".join(f"{k},{'RTK' if k % 2 else 'FLOAT'},{k}\n" for k in range(20)))
    assert sorted(survey(open_recording(path), Clock("t"))) == ["FLOAT", "RTK"]
    assert read(path, "left") == [(k, k) for k in range(20)]


def test_a_mode_beside_one_column_of_numbers_names_no_signals(tmp_path):
    rows = "".join(f"{k},{'AUTO' if k % 40 < 20 else 'MANUAL'},{k}\n" for k in range(100))
    recording = open_recording(written(tmp_path, f"t,mode,left\n{rows}"))
    assert list(survey(recording, Clock("t"))) == ["left"]
    assert recording.left_out == {"mode": "text"}


def test_columns_of_one_name_and_of_none_are_told_apart(tmp_path):
    path = written(tmp_path, "t,x,x,\n0,1,2,3\n1,4,5,6\n")
    assert sorted(survey(open_recording(path), Clock("t"))) == ["#4", "x", "x #3"]
    bare = written(tmp_path, "0,1\n1,2\n", "bare.csv")
    assert read(bare, "#2", Clock("#1")) == [(0.0, 1.0), (1.0, 2.0)]


def test_blank_cells_are_no_reading_and_nan_is_none_either(tmp_path):
    path = written(tmp_path, "t,left,ref\n0,1,\n1,,7\n2,3,nan\n")
    assert read(path, "left") == [(0.0, 1.0), (2.0, 3.0)]
    found = survey(open_recording(path), Clock("t"))
    assert (found["left"].count, found["ref"].count) == (2, 1)


@pytest.mark.parametrize(
    ("header", "unit"),
    [("%time", "ns"), ("millis", "ms"), ("micros", "us"), ("epoch", "ms"), ("elapsed", "ms"), ("a", "ms")],
)
def test_times_are_found_by_their_names_and_units_and_else_as_what_alone_increases(tmp_path, header, unit):
    step = {"ns": 50_000_000, "us": 50_000, "ms": 50}[unit]
    rows = "".join(f"{step * k},{7 * k % 3},{-k}\n" for k in range(5))
    clock = open_recording(written(tmp_path, f"{header},left,right\n{rows}")).clock()
    assert (clock.time, clock.unit) == (header, unit)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        *((name, "ms") for name in ("timestamp_ms", "Timestamp(ms)", "time-ms", "elapsedMillis", "ms", "msec")),
        *((name, "s") for name in ("Time (s)", "secs", "t / s", "elapsed_sec", "elapsedSeconds", "unix_time [s]")),
        *((name, "us") for name in ("TimeUS", "usec", "time_usec", "TIME_MICROSECONDS")),
        *((name, "ns") for name in ("timestamp_ns", "nsecs", "stamp-ns")),
        *((name, "min") for name in ("Time (min)", "t_min", "elapsedMinutes")),
        *((name, None) for name in ("stamp", "#time", "elapsed", "elapsedTime", "__time", "/clock/time", "ts", "t")),
    ],
)
def test_a_name_of_time_is_the_clock_whatever_else_goes_ahead(tmp_path, header, unit):
    """Counts that increase as times do stand beside it; a name that says no unit leaves that to the steps."""
    rows = "".join(f"{k},{50 * k},{3 * k}\n" for k in range(5))
    clock = open_recording(written(tmp_path, f"seq,{header},left\n{rows}")).clock()
    assert (clock.time, clock.unit) == (header, unit or "ms")


def test_times_of_day_go_on_past_each_midnight_and_a_late_row_stays_late(tmp_path):
    of_day = ("23:59:59.9", "00:00:00.1", "23:59:59.95", "00:00:00.2", "12:00:00", "18:00:00", "00:00:00")
    path = written(tmp_path, "time,left\n" + "".join(f"{time},1\n" for time in of_day))
    assert [round(t - 86400, 3) for t, _ in read(path, "left")] == [-0.1, 0.1, -0.05, 0.2, 43200, 64800, 86400]


def test_what_is_no_time_of_day_and_no_date_is_text_and_what_increases_beside_it_no_clock(tmp_path):
    odd = (
        "12:60:0{}",
        "12:0{}",
        "2024/13/01 12:00:0{}",
        "13/14/2024 12:00:0{}",
        "3{}.04.2024 x",
        "1.2.{}",
        "13:00:0{} PM",
        "0:00:0{} am",
        "2024-05-01 13:00:0{} PM",
        "00/01/2024 12:00:0{}",
        "01/02/0000 12:00:0{}",
    )
    for cell in odd:
        path = written(tmp_path, "stamp,left\n" + "".join(f"{cell.format(k)},{3 * k}\n" for k in range(1, 5)))
        assert open_recording(path).clock() == Clock(period=1.0)
        assert survey(open_recording(path), Clock(period=1.0)).keys() == {"left"}
    path = written(tmp_path, "time source,Zeit\n" + "".join(f"GPS,{0.1 * k}\n" for k in range(5)))
    assert open_recording(path).clock() == Clock("Zeit")


@pytest.mark.parametrize(
    ("cells", "starts"),
    [
        (("12:59:59 PM", "1:00:00 pm", "01:00:01.5 p.m."), 12 * 3600 + 3599),
        (("12:00:00 AM", "12:00:01AM", "12:00:02.5 a.m."), 0),
        (("2024-05-01 12:59:59 PM", "2024-05-01 01:00:00 PM", "2024-05-01 1:00:01.5 PM"), 1714568399),
        (("05/14/2024 11:59:59 PM", "05/15/2024 12:00:00 AM", "05/15/2024 12:00:01.5 AM"), 1715731199),
        (("14/05/2024 23:59:59", "15/05/2024 00:00:00", "15/05/2024 00:00:01.5"), 1715731199),
        (("11/01/2026 11:59:59 PM", "11/02/2026 12:00:00 AM", "11/02/2026 12:00:01.5 AM"), 1793577599),
        (("12/31/2023 23:59:59", "01/01/2024 00:00:00", "01/01/2024 00:00:01.5"), 1704067199),
        (("05/12/2024 23:59:59", "05/13/2024 00:00:00", "05/13/2024 00:00:01.5"), 1715558399),
        (("05/06/2024 23:59:59", "06/06/2024 00:00:00", "06/06/2024 00:00:01.5"), 1717631999),
        (("31-05-2024 23:59:59", "01-06-2024 00:00:00", "1-6-2024 00:00:01.5"), 1717199999),
        (("31.05.2024 23:59:59", "01.06.2024 00:00:00", "1.6.2024 00:00:01.5"), 1717199999),
    ],
)
def test_times_by_halves_of_the_day_and_dates_with_the_year_last(tmp_path, cells, starts):
    """Unix times by `date -u -d`."""
    path = written(tmp_path, "stamp,left\n" + "".join(f"{cell},{k}\n" for k, cell in enumerate(cells)))
    assert [t for t, _ in read(path, "left", open_recording(path).clock())] == [starts, starts + 1, starts + 2.5]
    assert open_recording(path).notes == []


def test_a_date_that_does_not_say_what_is_its_month_has_a_note(tmp_path):
    path = written(tmp_path, "stamp,built,left\n05/06/2024 10:00:00,1/1/2024,1\n05/06/2024 10:00:01,1/1/2024,2\n")
    recording = open_recording(path)
    assert recording.clock() == recording.clock() == Clock("stamp")
    (note,) = recording.notes
    assert "'05/06/2024 10:00:00' are read with the day before the month" in note


def test_a_last_line_that_is_cut_off_is_left_out_with_a_note(tmp_path):
    path = written(tmp_path, "t,left,right\n0,1,1\n1,2,2\n2,")
    recording = open_recording(path)
    assert survey(recording, Clock("t"))["left"].count == 2
    assert recording.notes == ["run.csv: line 4, the last, is cut off, and left out"]
    with pytest.raises(InputError, match=":4: has 2 cells"):
        survey(open_recording(written(tmp_path, "t,left,right\n0,1,1\n1,2,2\n2,\n")), Clock("t"))


@pytest.mark.parametrize(
    ("cells", "cut"),
    [
        (["139880", "139920", "139960", "139"], True),
        (["-13.25", "-13.5", "-13.75", "-1"], True),
        (["7", "7", "", "12.5", "12.625", "12"], False),
        (["139880", "139920", "139960", "140000"], False),
        (["12", "11", "10", "9"], False),
        (["1.5", "1.625", "1.75", "2"], False),
        (["65520", "65524", "65528", "0"], False),  # it wraps
        (["139880", "139"], False),
        (["AUTO", "AUTO", "AU"], False),
    ],
)
def test_a_last_number_without_a_line_end_is_cut_off_where_it_breaks_from_those_before(tmp_path, cells, cut):
    text = "t,left,right\n" + "\n".join(f"{k},{k},{cell}" for k, cell in enumerate(cells))
    recording = open_recording(written(tmp_path, text))
    assert survey(recording, Clock("t"))["left"].count == len(cells) - cut
    assert recording.notes == [f"run.csv: line {len(cells) + 1}, the last, is cut off, and left out"] * cut
    whole = open_recording(written(tmp_path, text + "\n"))
    assert survey(whole, Clock("t"))["left"].count == len(cells)
    assert whole.notes == []


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_of_tum_text_since_1970_are_in_the_unit_that_makes_them_near(tmp_path, unit):
    times = [round((1_700_000_000 + k) * {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]) for k in range(3)]
    path = tmp_path / "track.tum"
    path.write_text("".join(f"{t} 1 2 0 0 0 0 1\n" for t in times))
    assert open_recording(path).clock() == Clock(unit=unit)
    assert [t for t, _ in read(path, "x", Clock(unit=unit))] == [1.7e9, 1.7e9 + 1, 1.7e9 + 2]


@pytest.mark.parametrize(
    ("names", "cells", "time"),
    [
        ("Zeit,cycle_time,left", "{k},20,{turned}", "Zeit"),
        ("Zeit,motor_t,left", "{k},{turned},{turned}", "Zeit"),
        ("cycle_time,left", "20,{turned}", "cycle_time"),
        ("Zeit,build,left", "{k},2024-05-01,{turned}", "Zeit"),
        ("built,Zeit,left", "2024-05-01 12:00:00,{k},{turned}", "Zeit"),
        ("cycle_time,t,left", "20,{k},{k}", "t"),
    ],
)
def test_a_name_of_time_that_does_not_go_ahead_comes_after_what_alone_increases(tmp_path, names, cells, time):
    rows = "".join(cells.format(k=k, turned=7 * k % 5) + "\n" for k in range(20))
    assert open_recording(written(tmp_path, f"{names}\n{rows}")).clock().time == time


@pytest.mark.parametrize("rate", [50, 2000])
@pytest.mark.parametrize("names", ["stamp_sec,stamp_nsec", "stamp_nsec,stamp_sec", "stamp_sec,seq,stamp_nsec"])
def test_seconds_and_nanoseconds_are_one_clock_in_any_order_and_at_any_rate(tmp_path, names, rate):
    def row(k):
        sec, nsec = divmod(1_700_000_000 * 10**9 + 300_000_000 + k * 10**9 // rate, 10**9)
        return ",".join(str({"stamp_sec": sec, "stamp_nsec": nsec, "seq": k}[name]) for name in names.split(","))

    path = written(tmp_path, f"{names},left\n" + "".join(f"{row(k)},{k}\n" for k in range(1200)))
    assert open_recording(path).clock() == Clock("stamp_sec + stamp_nsec")


def test_of_columns_that_increase_the_one_with_a_unit_of_time_is_the_clock(tmp_path):
    """In any language; a spreadsheet's decimal commas, and a number of the row."""
    rows = "".join(f"{k};{20 * k},5;{-k}\n" for k in range(5))
    clock = open_recording(written(tmp_path, f"Nr;Zeit [ms];links\n{rows}")).clock()
    assert (clock.time, clock.unit) == ("Zeit [ms]", "ms")
    two = "".join(f"{k};{20 * k},5;{k + 1}\n" for k in range(5))
    assert open_recording(written(tmp_path, f"Nr;Zeit [ms];Dauer (s)\n{two}")).clock().time is None


def test_rows_without_times_need_a_period(tmp_path):
    path = written(tmp_path, "left,right\n1,2\n3,4\n")
    assert read(path, "right", Clock(period=0.05)) == [(0.0, 2.0), (0.05, 4.0)]
    with pytest.raises(InputError, match="period"):
        read(path, "right", Clock())


@pytest.mark.parametrize(
    ("text", "clock", "words"),
    [
        ("t,left\n0,1\n1,two\n", Clock("t"), [":3:", "'left'", "'two' is not a number"]),
        ("t,left\n0,1\n1,2,3\n", Clock("t"), [":3:", "3 cells"]),
        ("t,left\n0,1\nx,2\n", Clock("t"), [":3:", "'t'", "'x'"]),
        ("t,left\n0,1\n1e300,2\n", Clock("t"), [":3", "is no time"]),
        ("t,left\n2024-05-01T12:00:00,1\n2024-05-32T12:00:00,2\n", Clock("t"), [":3:", "'t'", "2024-05-32T12:00:00"]),
        ("sec,left\n0,1\n1,2\n", Clock("sec + nanosec"), ["no column 'nanosec'"]),
        ("t,left\n0,1\n", Clock("tt"), ["no column 'tt'", "did you mean 't'"]),
        ("name,place\nA,B\n", Clock("t"), ["no row of numbers"]),
        ("", Clock("t"), ["is empty"]),
        ("\n \n", Clock("t"), ["is empty"]),
    ],
)
def test_a_mistake_is_named_with_its_place(tmp_path, text, clock, words):
    with pytest.raises(InputError) as caught:
        read(written(tmp_path, text), "left", clock)
    for word in ["run.csv", *words]:
        assert word in str(caught.value)


def test_a_file_is_read_line_by_line(tmp_path):
    path = written(tmp_path, "t,left\n" + "".join(f"{k},{k}\n" for k in range(10_000)) + "damaged\n")
    readings = open_recording(path).readings(frozenset(["left"]), Clock("t"))
    assert [reading.value for reading in itertools.islice(readings, 5000)][-1] == 4999.0
    with pytest.raises(InputError, match=":10002:"):
        list(readings)


T, POSE = np.array([5.0, 5.5, 7.0]), np.array([[1.0, 2.0, 0.3], [1.5, 2.5, -3.0], [2.0, 3.0, 3.1]])


def test_tum_text_is_read_as_it_is_exported(tmp_path):
    export_tum(tmp_path / "truth.txt", T, POSE)
    for column, name in enumerate(("x", "y", "heading")):
        found = np.array(read(tmp_path / "truth.txt", name))
        np.testing.assert_allclose(found, np.column_stack([T, POSE[:, column]]), atol=1e-9)


def test_kitti_text_takes_times_from_a_file_or_a_period(tmp_path):
    export_kitti(tmp_path / "truth.txt", POSE)
    written(tmp_path, "5\n5.5\n7\n", "times.txt")
    for clock, times in ((Clock("times.txt"), T), (Clock(period=0.2), np.array([0.0, 0.2, 0.4]))):
        found = np.array(read(tmp_path / "truth.txt", "heading", clock))
        np.testing.assert_allclose(found, np.column_stack([times, POSE[:, 2]]), atol=1e-9)
    written(tmp_path, "5\n5.5\n", "times.txt")
    with pytest.raises(InputError, match=r"truth.txt:3: times.txt holds no time"):
        read(tmp_path / "truth.txt", "x", Clock("times.txt"))


def test_a_kitti_cameras_heading_is_about_its_own_vertical(tmp_path):
    """A camera that looks along z with x to its right turns left by psi: its z axis points to (-sin, 0, cos)."""
    psi = 0.4
    c, s = math.cos(psi), math.sin(psi)
    written(tmp_path, f"{c} 0 {-s} 0 0 1 0 0 {s} 0 {c} 0\n", "truth.kitti")
    assert read(tmp_path / "truth.kitti", "camera heading")[0][1] == pytest.approx(psi)


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("a.txt", "# t x y z\n1 2 3 4 0 0 0 1\n", "TUM"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "KITTI"),
        ("a.txt", "t x\n1 2\n", "CSV"),
        ("a.csv", "1 2 3 4 0 0 0 1\n", "CSV"),
        ("a.py", "print(1)\n", None),
    ],
)
def test_what_a_file_is_shows_in_its_first_line(tmp_path, name, text, kind):
    found = recognised(written(tmp_path, text, name))
    assert (found is None) if kind is None else (found is not None and kind in found.name)


def test_what_is_no_recording_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file or folder"):
        open_recording(tmp_path / "nothing")
    for name in ("run.wpilog", "run.csv", "run.mcap"):
        (tmp_path / name).touch()
        with pytest.raises(InputError, match=f"{name}: is empty; copy it again, or record it again"):
            open_recording(tmp_path / name)
        (tmp_path / name).unlink()
    with pytest.raises(InputError, match="no known kind of recording; known: CSV"):
        open_recording(tmp_path)
