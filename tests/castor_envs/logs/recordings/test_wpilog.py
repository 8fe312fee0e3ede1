"""Data logs of WPILib, packed by hand as the published format says, and read by WPILib's own reader."""

import struct
import sys

import pytest

from castor_envs.errors import InputError
from castor_envs.logs.recordings import open_recording
from castor_envs.logs.recordings.recording import Clock, survey

pytest.importorskip("wpiutil", reason="WPILib's reader is not installed: pip install robotpy-wpiutil")

ENTRIES = [
    ("NT:/left", "double"),
    ("NT:/right", "int64"),
    ("NT:/state", "string"),
    ("NT:/both", "float[]"),
    ("NT:/pose", "struct:Pose2d"),
    ("NT:/modules", "struct:SwerveModulePosition[]"),
    ("NT:/unknown", "struct:Mine"),
    ("NT:/pose3d", "struct:Pose3d"),
]


def doubles(*values):
    return struct.pack(f"<{len(values)}d", *values)


RECORDS = [
    (0, 1_000_000, doubles(1.5)),
    (1, 1_020_000, struct.pack("<q", -7)),
    (2, 1_020_000, b"AUTO"),
    (3, 1_040_000, struct.pack("<2f", 0.5, 0.25)),
    (4, 1_060_000, doubles(1.0, 2.0, 0.3)),
    (5, 1_080_000, doubles(0.1, 0.2, 0.3, 0.4)),
    (6, 1_080_000, doubles(9.0)),
    (7, 1_090_000, doubles(1.0, 2.0, 3.0, 2**-0.5, 0.0, 0.0, 2**-0.5)),
    (0, 1_100_000, doubles(2.5)),
]


@pytest.fixture
def log(tmp_path, write_wpilog):
    path = tmp_path / "FRC_1.wpilog"
    path.write_bytes(write_wpilog(ENTRIES, RECORDS))
    return path


@pytest.mark.parametrize(
    ("channel", "found"),
    [
        ("NT:/left", [(1.0, 1.5), (1.1, 2.5)]),
        ("NT:/right", [(1.02, -7.0)]),
        ("NT:/both[1]", [(1.04, 0.25)]),
        ("NT:/pose.heading", [(1.06, 0.3)]),
        ("NT:/modules[1].distance", [(1.08, 0.3)]),
        ("NT:/modules[1].angle", [(1.08, 0.4)]),
        ("NT:/pose3d.heading", [(1.09, pytest.approx(1.5707963267948966))]),
    ],
)
def test_entries_of_numbers_are_channels(log, channel, found):
    readings = open_recording(log).readings(frozenset([channel]), Clock())
    assert [(reading.time / 1e9, reading.value) for reading in readings] == found


def test_a_survey_leaves_out_texts_and_unknown_structs_and_says_so(log):
    recording = open_recording(log)
    assert recording.held
    found = survey(recording, recording.clock())
    assert {name.split("[")[0].split(".")[0] for name in found} == {
        "NT:/left", "NT:/right", "NT:/both", "NT:/pose", "NT:/modules", "NT:/pose3d",
    }  # fmt: skip
    assert recording.left_out == {
        "NT:/state": "of type string, of which no numbers are read",
        "NT:/unknown": "of type struct:Mine, of which no numbers are read",
    }


@pytest.mark.parametrize(("cut", "values"), [(1, [1.5]), (3, [1.5]), (10, [1.5])])
def test_a_log_that_was_cut_off_is_read_to_its_last_whole_record_which_is_read_once(log, cut, values):
    log.write_bytes(log.read_bytes()[:-cut])
    for _ in range(2):
        recording = open_recording(log)
        for channel, found in (("NT:/left", values), ("NT:/pose3d.x", [1.0])):
            assert [r.value for r in recording.readings(frozenset([channel]), Clock())] == found
        (note,) = recording.notes
        assert "FRC_1.wpilog: is cut off or damaged: the last" in note


def test_a_damaged_log_is_read_to_the_first_record_of_no_entry(log, write_wpilog):
    whole = log.read_bytes()
    log.write_bytes(write_wpilog(ENTRIES, [*RECORDS[:2], (99, 1_030_000, bytes(50)), *RECORDS[2:]]))
    recording = open_recording(log)
    assert [reading.value for reading in recording.readings(frozenset(["NT:/left"]), Clock())] == [1.5]
    assert "are no records, and left out" in recording.notes[0]
    log.write_bytes(whole)
    assert len(list((recording := open_recording(log)).readings(frozenset(["NT:/left"]), Clock()))) == 2
    assert recording.notes == []


def test_reading_may_stop_anywhere(log):
    readings = open_recording(log).readings(frozenset(["NT:/left"]), Clock())
    assert next(readings).value == 1.5
    readings.close()


def test_mistakes_are_refused_in_one_line(log, monkeypatch):
    with pytest.raises(InputError, match="has one clock"):
        list(open_recording(log).readings(None, Clock("header")))
    short = log.with_name("short.wpilog")
    short.write_bytes(b"WPILOG\x00")
    with pytest.raises(InputError, match="damaged"):
        list(open_recording(short).readings(None, Clock()))
    monkeypatch.setitem(sys.modules, "wpiutil.log", None)
    with pytest.raises(InputError, match=r"pip install '\.\[wpilog\]' in the project's folder"):
        list(open_recording(log).readings(None, Clock()))
