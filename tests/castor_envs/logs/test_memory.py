"""A row more of a long recording takes little more than its numbers: nothing else of a line or a message stays."""

import gc
import tracemalloc

import numpy as np
import pytest

from castor_envs.logs import ChannelMap, import_log, read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.logs.reference import TimedPoses
from castor_envs.vehicles.presets import preset

ROBOT = preset("differential")
FEW, MANY, PIECE = 1000, 4000, 100
"""Rows, and those of a piece: what one takes is in both."""

NUMBER = 8
"""Bytes."""


@pytest.fixture(autouse=True)
def short_pieces(monkeypatch):
    """Few rows are many pieces."""
    monkeypatch.setattr("castor_envs.logs.csv.CHUNK", PIECE)
    monkeypatch.setattr("castor_envs.logs.mapping.agreement.PIECE", PIECE)


def peak_of(run, rows):
    gc.collect()
    tracemalloc.start()
    try:
        run(rows)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def bytes_a_row(run):
    """Return by how much the peak of `run(rows)` grows, a row, without what is needed once, as tables of Python."""
    run(FEW)
    few, many = (min(peak_of(run, rows) for _ in range(2)) for rows in (FEW, MANY))
    return (many - few) / (MANY - FEW)


def run_of(rows):
    """Return a drive on a circle at 50 Hz: times, counts (K, 2), poses (K, 3)."""
    t = 0.02 * np.arange(rows)
    pose = np.column_stack([np.cos(t), np.sin(t), t + np.pi / 2])
    return t, np.column_stack([np.round(3000 * t), np.round(4000 * t)]), pose


@pytest.mark.parametrize("tracked", [False, True])
def test_a_log_is_read_in_little_more_than_its_numbers(tmp_path, tracked):
    for rows in (FEW, MANY):
        t, wheel, pose = run_of(rows)
        log = Log(
            t, wheel, np.empty((rows, 0)), gyro=np.ones(rows), reference=pose, extra={"state": ["driving"] * rows}
        )
        write_log(tmp_path / f"{rows}.csv", log, ROBOT, TimedPoses(t + 0.01, pose) if tracked else None)
    of_counts, of_pose, text, line = 4 * NUMBER, 4 * NUMBER, 16, NUMBER
    held = of_counts + of_pose + text + line + (of_pose if tracked else 0)
    assert bytes_a_row(lambda rows: read_log(tmp_path / f"{rows}.csv", ROBOT)) < 3 * held


COLUMNS = {"wheel_1l": "counts", "wheel_1r": "counts", "ref_x": "m", "ref_y": "m", "ref_psi": "rad"}


def map_of(channels, **source):
    columns = {
        key: {"channel": channel, "unit": unit} for (key, unit), channel in zip(COLUMNS.items(), channels, strict=True)
    }
    return ChannelMap.from_dict({"format": "castor-map/1", "sources": {"main": source}, "columns": columns})


READING = 2 * NUMBER
"""A time and a value."""


def test_a_table_is_imported_in_little_more_than_its_readings(tmp_path):
    for rows in (FEW, MANY):
        t, wheel, pose = run_of(rows)
        text = "".join(",".join(map(repr, row)) + "\n" for row in np.column_stack([t, wheel, pose]).tolist())
        (tmp_path / f"{rows}.csv").write_text("t,l,r,x,y,psi\n" + text)
    by = map_of(("l", "r", "x", "y", "psi"), time="t")
    assert bytes_a_row(lambda rows: import_log(tmp_path / f"{rows}.csv", ROBOT, by)) < 4 * len(COLUMNS) * READING


def test_a_bag_is_imported_in_little_more_than_its_readings(tmp_path, bag_writer):
    """A message of counts and one of the pose make a row."""
    for rows in (FEW, MANY):
        with bag_writer(tmp_path / f"{rows}", "sqlite3") as bag:
            for t, (left, right), (x, y, psi) in zip(*(part.tolist() for part in run_of(rows)), strict=True):
                bag.joints("/joints", 1000 + t, 1000 + t, left=left, right=right)
                bag.put("/pose", "geometry_msgs/PoseStamped", 1000 + t, bag.header(1000 + t), bag.pose(x, y, psi))
    channels = [f"/joints position[{side}]" for side in ("left", "right")]
    by = map_of([*channels, *(f"/pose pose.{part}" for part in ("x", "y", "heading"))], time="header")
    assert bytes_a_row(lambda rows: import_log(tmp_path / f"{rows}", ROBOT, by)) < 4 * len(COLUMNS) * READING
