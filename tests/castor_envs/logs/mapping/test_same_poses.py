"""A drive that goes through a bag and a map gives estimators what its own log gives them."""

import numpy as np
import pytest

from castor_envs.logs import (
    ChannelMap,
    Log,
    TimedPoses,
    guess_map,
    import_log,
    open_recording,
    read_log,
    survey,
    write_log,
)
from castor_envs.vehicles.presets import preset
from estimators.plugins.drives import winding
from estimators.robots.cast import CAST

START = 1_700_000_000.0
ROBOT = preset("asoc-prototype")


def followed(log):
    """Return the poses (K, 3) that CAST finds from the log's first reference pose on."""
    estimator = CAST()
    estimator.reset(ROBOT, log.reference[0])
    return np.array([estimator.update(observation) for observation in log.observations()])


@pytest.fixture(scope="module")
def drive():
    return winding(ROBOT)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_an_imported_drive_is_followed_as_its_own_log_is(tmp_path, bag_writer, drive, kind):
    wheel = np.cumsum([observation["wheel"] for observation in drive.observations], axis=0)
    pivot = np.array([observation["pivot"] for observation in drive.observations])
    t = np.array([observation["time"][0] for observation in drive.observations])
    own = Log(t=t, wheel=wheel, pivot=pivot, reference=drive.pose)
    rolled = wheel * 2 * np.pi / np.array([w.counts_per_rev for w in ROBOT.wheels])
    turned = np.angle(np.exp(2j * np.pi * pivot / np.array([c.pivot_counts_per_rev for c in ROBOT.castors])))
    path = tmp_path / ("run.bag" if kind == "ros1" else "run")
    with bag_writer(path, kind) as w:
        for k in range(len(t)):
            stamp = START + t[k]
            names = dict(zip(("wheel_1_left", "wheel_1_right", "wheel_2_left", "wheel_2_right", "wheel_3_left",
                              "wheel_3_right"), rolled[k].tolist(), strict=True))  # fmt: skip
            steers = {f"castor_{i + 1}_steering": angle for i, angle in enumerate(turned[k].tolist())}
            w.joints("/joint_states", stamp + 0.004, stamp, **names, **steers)
            w.put("/truth", "geometry_msgs/PoseStamped", stamp + 0.02, w.header(stamp), w.pose(*drive.pose[k].tolist()))
            w.put("/odom", "geometry_msgs/PoseStamped", stamp + 0.02, w.header(stamp), w.pose(0.0, 0.0, 0.0))
    recording = open_recording(path)
    by = guess_map(survey(recording, recording.clock()), recording.clock(), ROBOT)
    by.save(tmp_path / "map.json")
    imported = import_log(path, ROBOT, ChannelMap.load(tmp_path / "map.json"))
    write_log(tmp_path / "log.csv", imported.log, ROBOT, imported.tracked)
    log = read_log(tmp_path / "log.csv", ROBOT)
    np.testing.assert_allclose(log.t, own.t, atol=2e-7)
    assert log.reference is not None
    np.testing.assert_allclose(log.reference, drive.pose, atol=1e-6)
    np.testing.assert_allclose(followed(log), followed(own), atol=2e-6)


def test_poses_at_other_times_leave_counts_as_they_are(tmp_path, drive):
    """A tracker at 97 Hz, out of step with the counts: the same estimates, and a reference within its chords' error."""
    wheel = np.cumsum([observation["wheel"] for observation in drive.observations], axis=0)
    pivot = np.array([observation["pivot"] for observation in drive.observations])
    t = np.array([observation["time"][0] for observation in drive.observations])
    own = Log(t=t, wheel=wheel, pivot=pivot, reference=drive.pose)
    seen = np.append(0.0, np.arange(0.003, t[-1], 1 / 97))
    poses = np.column_stack([np.interp(seen, t, column) for column in drive.pose.T])
    write_log(tmp_path / "log.csv", own, ROBOT, TimedPoses(seen, poses))
    log = read_log(tmp_path / "log.csv", ROBOT)
    np.testing.assert_array_equal(followed(log), followed(own))
    assert log.reference is not None
    known = np.isfinite(log.reference[:, 0])
    assert known[:-1].all()
    # The true motion's acceleration stays below 1 m/s2 and 1 rad/s2; chords are of 11 ms, and of 50 ms in `poses`.
    np.testing.assert_allclose(log.reference[known], drive.pose[known], atol=0.05 * 0.0104 / 2)
