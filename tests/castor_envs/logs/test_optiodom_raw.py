"""OptiOdom's raw pairs, on files made here and, where they are, on the measured ones."""

import dataclasses
import os

import numpy as np
import pytest

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.logs.csv import read_log
from castor_envs.logs.importers import import_sessions, importer, optiodom
from castor_envs.logs.importers.optiodom_raw import find_sessions, read_motive, read_session, tracker_yaw
from castor_envs.logs.log import Log
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import figure_eight, umbmark

METADATA = {
    "diff": {"type": "diff", "ngear": 43.7, "encRes": 64, "Li": 0.2, "Di": "0.084,0.09", "N": 1},
    "omni3": {"type": "omni3", "ngear": 12, "encRes": 1024, "Li": 0.195, "Di": "0.102,0.1,0.104", "N": 1},
}

MOUNT = np.array([-0.04, 0.02, np.radians(140.0)])
"""m, m, rad: the markers on the robot."""

CYCLE, BEGIN = 1.0233, 3.7
"""True time of a nominal second, and the tracker's time at the first row of odometry."""

HEADER = "Format Version,1.23,Take Name,x\n\n,Type\n,Name\n,ID\n,,Rotation,Rotation\nFrame,Time (Seconds),Y,X,Z,X,Y,Z\n"


def drive(robot, path):
    """Return times (K,), poses (K, 3) and wheel angles (K, w) of a drive that rests at both ends."""
    rolled, rest = roll(robot, path), 40
    poses, wheels = (np.pad(part, ((rest, rest), (0, 0)), mode="edge") for part in (rolled.pose, rolled.wheel_angle))
    return np.arange(len(poses)) * 0.05, poses, wheels


def write_pair(folder, robot, path, increments, k=1, lost=slice(0)):
    """Write a raw pair; `increments` turns increments of the robot's wheels into those of the file."""
    own, poses, wheels = drive(robot, path)
    counts = np.round(wheels * robot.wheels[robot.driven_wheels[0]].counts_per_rev / (2 * np.pi))
    rows = np.column_stack([500 + own, increments(np.diff(counts, axis=0, prepend=counts[:1]))])
    stem = folder / f"{folder.name}_run-{k:02d}"
    text = "".join(",".join(f"{value:.10g}" for value in row) + "\n" for row in rows)
    stem.with_name(stem.name + "_odo.csv").write_text("\ufeff" + text, encoding="utf-8")
    t = np.arange(0.0, BEGIN + own[-1] * CYCLE + 2.0, 0.01)
    true = np.column_stack([np.interp(t, BEGIN + own * CYCLE, column) for column in poses.T])
    seen = compose(true, MOUNT)
    lines = [
        f"{n},{time:.2f},{(np.degrees(psi) + 180) % 360 - 180:.6f},0.1,0.2,{y:.6f},0.09,{x:.6f},0.0003,1,2\n"
        for n, (time, (x, y, psi)) in enumerate(zip(t, seen, strict=True))
    ]
    for n in range(len(lines))[lost]:
        lines[n] = f"{n},{t[n]:.2f},,,,,,,,,\n"
    stem.with_name(stem.name + "_opti.csv").write_text(HEADER + "".join(lines))
    return poses


DRIVES = {
    "diff": (umbmark("ccw"), lambda counts: counts),
    "omni3": (figure_eight(), lambda counts: -counts),
}


def write_metadata(root, name, kind, **changes):
    """Return the folder of a session that holds its metadata alone."""
    folder = root / "optiodom" / kind / "x" / name
    folder.mkdir(parents=True)
    lines = (METADATA.get(kind) or METADATA["diff"]) | changes
    (folder / f"{name}_metadata.csv").write_text("".join(f"{key},{value}\n" for key, value in lines.items()))
    return folder


def session_with(tmp_path, kind, lost=slice(0)):
    """Return the folder of a session, whose raw pair is driven by the robot that its metadata describe; the poses."""
    path, increments = DRIVES[kind]
    folder = write_metadata(tmp_path, "1", kind)
    rest = Log(np.arange(2) * 0.05, np.zeros((2, 3)), np.empty((2, 0)), reference=np.zeros((2, 3)))
    robot = optiodom.session_of(folder, lambda *_: rest).robot
    return folder, write_pair(folder, robot, path, increments, lost=lost)


@pytest.mark.parametrize("kind", ["diff", "omni3"])
def test_clocks_axes_and_wheels_are_those_of_the_drive(tmp_path, kind):
    folder, poses = session_with(tmp_path, kind)
    session = read_session(folder)
    (run,) = session.runs
    assert session.robot.sample_period == pytest.approx(0.05 * CYCLE, rel=2e-3)
    assert run.reference is not None
    known = np.isfinite(run.reference[:, 0])
    assert known.mean() > 0.95
    body = compose(run.reference, [*-MOUNT[:2], 0.0])
    first = np.flatnonzero(known)[0]
    off = relative_pose(body[first], body)[known] - relative_pose(poses[first], poses)[known]
    assert np.abs(off[:, :2]).max() < 0.02  # 0.05 s, which the fit of a clock takes, at 0.25 m/s
    assert np.abs(off[:, 2]).max() < 0.05


def test_no_pose_is_made_up_where_the_tracker_lost_the_robot(tmp_path):
    folder, _ = session_with(tmp_path, "diff", lost=slice(1000, 1200))
    (run,) = read_session(folder).runs
    assert run.reference is not None
    lost = np.isnan(run.reference[:, 0])
    assert lost.sum() == pytest.approx(2.0 / (0.05 * CYCLE), abs=2)
    assert (np.diff(np.flatnonzero(lost)) == 1).all()


def test_a_log_that_is_written_holds_every_pose_and_reads_back_as_it_was_in_memory(tmp_path):
    session_with(tmp_path, "diff", lost=slice(1000, 1200))
    ((folder, session),) = import_sessions(tmp_path, tmp_path / "out", "optiodom-raw")
    (run,), (tracked,) = session.runs, session.tracked
    lines = (folder / "run-1.csv").read_text().splitlines()
    assert len(lines) == 1 + len(run) + len(tracked.t) - np.isin(tracked.t, run.t).sum()
    read = read_log(folder / "run-1.csv", session.vehicle)
    np.testing.assert_array_equal(read.wheel, run.wheel)
    assert run.reference is not None
    assert read.reference is not None
    known = np.isfinite(run.reference[:, 0])
    np.testing.assert_allclose(read.reference[known], run.reference[known], atol=1e-9)


def test_the_trackers_yaw_is_found_whatever_it_is(tmp_path):
    folder, _ = session_with(tmp_path, "diff")
    session = read_session(folder)
    for yaw in (-3.0, -1.0, 0.0, 2.0):
        turned = [dataclasses.replace(run, reference=run.reference + np.array([0, 0, yaw])) for run in session.runs]
        assert tracker_yaw(session.robot, turned) == pytest.approx(yaw, abs=0.01)


def test_sessions_without_both_files_are_left_out(tmp_path):
    folder, _ = session_with(tmp_path, "diff")
    assert list(find_sessions(tmp_path)) == ["1"]
    write_metadata(tmp_path, "2", "diff")
    assert list(find_sessions(tmp_path)) == ["1"]
    (folder / "1_run-01_opti.csv").unlink()
    assert find_sessions(tmp_path) == {}
    assert importer("optiodom-raw").find is find_sessions
    with pytest.raises(Declined, match="omni4"):
        read_session(write_metadata(tmp_path, "3", "omni4", type="omni4"))


@pytest.mark.parametrize(
    ("row", "complaint"),
    [("0,0,1,2\n", "x.csv:8: has 4 cells"), ("0,0,1,2,3,4,y,6\n", "x.csv:8: column 'Y': 'y' is not a number")],
)
def test_what_is_garbled_is_named(tmp_path, row, complaint):
    (tmp_path / "x.csv").write_text(HEADER + row)
    with pytest.raises(InputError, match=complaint):
        read_motive(tmp_path / "x.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read_motive(tmp_path / "gone.csv")
    (tmp_path / "x.csv").write_text(HEADER)
    with pytest.raises(InputError, match="fewer than 2 poses"):
        read_motive(tmp_path / "x.csv")


@pytest.mark.skipif("CASTOR_DATA" not in os.environ, reason="measured data are not here")
def test_raw_pairs_are_the_drives_of_the_synchronised_runs():
    """Counts are the authors' own; so is the path, up to where the markers stand, within what their clocks differ."""
    found = find_sessions(os.environ["CASTOR_DATA"])
    if not found:
        pytest.skip("the folder holds no raw pairs")
    for path in [path for path in found.values() if "diff" in path.parts][:5]:
        for raw, run in zip(read_session(path).runs, optiodom.read_session(path).runs, strict=True):
            if len(raw) != len(run) or raw.reference is None or run.reference is None:
                continue  # the authors cut this run
            np.testing.assert_array_equal(np.diff(raw.wheel[5:], axis=0), np.diff(run.wheel[5:], axis=0))
            turned = raw.reference[:, 2] - run.reference[:, 2]
            assert np.nanpercentile(np.abs(turned - np.nanmedian(turned)), 90) < 0.1
