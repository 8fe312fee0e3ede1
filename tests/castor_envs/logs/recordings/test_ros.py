"""Bags of ROS 1 and 2, written by rosbags: every number comes out with its name and its time."""

import contextlib
import sqlite3
import sys

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from castor_envs.errors import InputError
from castor_envs.logs.recordings import open_recording
from castor_envs.logs.recordings.recording import Clock, survey

START = 1_700_000_000.0
KINDS = ("mcap", "sqlite3", "ros1")


def read(path, *channels, time="header"):
    """Return times (s since START) and values of channels."""
    found = [(r.time, r.value) for r in open_recording(path).readings(frozenset(channels), Clock(time))]
    return [round(ns / 1e9 - START, 6) for ns, _ in found], [value for _, value in found]


@pytest.fixture(params=KINDS)
def bag(request, tmp_path, bag_writer):
    """Three messages of each kind, 0.1 s apart, received 7 ms after their stamps."""
    path = tmp_path / ("run.bag" if request.param == "ros1" else "run")
    with bag_writer(path, request.param) as w:
        for k in range(3):
            stamp, received = START + 0.1 * k, START + 0.1 * k + 0.007
            vector = w.make("geometry_msgs/Vector3", 0.0, 0.5, float(k))
            pose = w.pose(1.0 + k, 2.0, 0.1 * k)
            twist = w.make("geometry_msgs/Twist", vector, vector)
            tf = w.make("geometry_msgs/Transform", vector, w.quaternion(-0.1 * k))
            transform = w.make("geometry_msgs/TransformStamped", w.header(stamp, "/odom"), "base", tf)
            cov = np.zeros(36)
            w.joints("/joints", received, stamp, left=1.5 * k, right=-2.5 * k)
            w.put("/pose", "geometry_msgs/PoseStamped", received, w.header(stamp), pose)
            w.put(
                "/odom", "nav_msgs/Odometry", received, w.header(stamp), "base",
                w.make("geometry_msgs/PoseWithCovariance", pose, cov),
                w.make("geometry_msgs/TwistWithCovariance", twist, cov),
            )  # fmt: skip
            w.put(
                "/imu", "sensor_msgs/Imu", received, w.header(stamp), w.quaternion(1.0), cov[:9], vector, cov[:9],
                vector, cov[:9],
            )  # fmt: skip
            w.put("/tf", "tf2_msgs/TFMessage", received, [transform, transform])
            w.put("/ticks", "std_msgs/Int32", received, 1000 * k)
            w.put("/cmd_vel", "geometry_msgs/Twist", received, vector, vector)
    return path


@pytest.mark.parametrize(
    ("channel", "values"),
    [
        ("/joints position[left]", [0.0, 1.5, 3.0]),
        ("/joints position[right]", [0.0, -2.5, -5.0]),
        ("/pose pose.x", [1.0, 2.0, 3.0]),
        ("/pose pose.heading", [0.0, 0.1, 0.2]),
        ("/odom pose.pose.heading", [0.0, 0.1, 0.2]),
        ("/odom twist.twist.angular.z", [0.0, 1.0, 2.0]),
        ("/imu angular_velocity.z", [0.0, 1.0, 2.0]),
        ("/imu orientation.heading", [1.0, 1.0, 1.0]),
    ],
)
def test_numbers_have_the_times_of_their_headers(bag, channel, values):
    times, found = read(bag, channel)
    assert times == [0.0, 0.1, 0.2]
    np.testing.assert_allclose(found, values, atol=1e-15)
    assert read(bag, channel, time="receive")[0] == [0.007, 0.107, 0.207]


def test_transforms_are_named_by_their_frames(bag):
    times, values = read(bag, "/tf odom>base.heading")
    assert times == [0.0, 0.0, 0.1, 0.1, 0.2, 0.2]
    np.testing.assert_allclose(values, [0.0, 0.0, -0.1, -0.1, -0.2, -0.2], atol=1e-15)


def test_messages_without_a_header_have_the_time_of_their_receipt_alone(bag):
    assert read(bag, "/ticks data", time="receive") == ([0.007, 0.107, 0.207], [0.0, 1000.0, 2000.0])
    with pytest.raises(InputError, match="/ticks has messages without a time in their header") as caught:
        read(bag, "/ticks data")
    assert '"time": "receive"' in str(caught.value)


def test_a_survey_shows_every_number_but_no_covariances(bag):
    recording = open_recording(bag)
    assert recording.clock() == Clock("header")
    found = survey(recording, Clock("header"))
    left = found["/joints position[left]"]
    assert (left.count, left.low, left.high, left.whole) == (3, 0.0, 3.0, False)
    assert left.rate == pytest.approx(10.0)
    assert found["/ticks data"].whole
    assert not [name for name in found if "covariance" in name or "header" in name]


def test_transforms_alone_have_the_times_of_their_own_stamps(tmp_path, bag_writer):
    with bag_writer(tmp_path / "run", "mcap") as w:
        for k in range(3):
            tf = w.make("geometry_msgs/Transform", w.make("geometry_msgs/Vector3", 0.0, 0.0, 0.0), w.quaternion(0.0))
            stamped = w.make("geometry_msgs/TransformStamped", w.header(START + k, "mocap"), "robot", tf)
            w.put("/tf", "tf2_msgs/TFMessage", START + k + 0.02, [stamped])
    recording = open_recording(tmp_path / "run")
    assert recording.clock() == Clock("header")
    assert read(tmp_path / "run", "/tf mocap>robot.x")[0] == [0.0, 1.0, 2.0]


def test_topics_without_numbers_and_of_types_that_the_bag_does_not_define_are_said(tmp_path, bag_writer):
    """A recorder of an older ROS leaves definitions out of a data base."""
    with bag_writer(tmp_path / "run", "sqlite3") as w:
        w.store.register(get_types_from_msg("int32 left", "mine/msg/Ticks"))
        w.put("/ticks", "mine/Ticks", START, 7)
        w.put("/log", "std_msgs/String", START, "hello")
        w.joints("/joints", START, START, left=1.0)
    (file,) = (tmp_path / "run").glob("*.db3")
    with contextlib.closing(sqlite3.connect(file)) as base:
        base.execute("delete from message_definitions")
        base.commit()
    recording = open_recording(tmp_path / "run")
    assert sorted(survey(recording, Clock("header"))) == ["/joints position[left]", "/joints velocity[left]"]
    assert recording.left_out == {
        "/ticks": "messages of type mine/msg/Ticks, which the bag does not define; convert it to MCAP where the type "
        "is installed",
        "/log": "no message with numbers, or arrays of more than 32",
    }


def test_an_unknown_clock_is_refused(bag):
    with pytest.raises(InputError, match="no clock 'stamp'"):
        read(bag, "/joints position[left]", time="stamp")


def test_joints_that_are_missing_in_some_messages_have_fewer_readings(tmp_path, bag_writer):
    with bag_writer(tmp_path / "run", "mcap") as w:
        for k in range(4):
            names = {"left": float(k), "right": 1.0} if k % 2 else {"right": 1.0}
            w.joints("/joints", START + 0.1 * k, START + 0.1 * k, **names)
    assert read(tmp_path / "run", "/joints position[left]") == ([0.1, 0.3], [1.0, 3.0])
    assert read(tmp_path / "run", "/joints position[right]")[0] == [0.0, 0.1, 0.2, 0.3]


def test_numbers_have_the_names_in_their_own_message_in_whatever_order(tmp_path, bag_writer):
    """Of joints, and of the interfaces of each joint, as ros2_control publishes them."""
    values, states = "string[] interface_names\nfloat64[] values", "control_msgs/DynamicJointState"
    joints = "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values"
    with bag_writer(tmp_path / "run", "mcap") as w:
        w.store.register(get_types_from_msg(values, "control_msgs/msg/InterfaceValue"))
        w.store.register(get_types_from_msg(joints, "control_msgs/msg/DynamicJointState"))
        for k in range(4):
            turned = slice(None, None, -1 if k % 2 else 1)
            w.joints("/joints", START + k, START + k, **dict([("left", 1.0), ("right", 2.0)][turned]))
            one, other = (
                w.make("control_msgs/InterfaceValue", ["position", "velocity"][turned], np.array([a, b][turned]))
                for a, b in ((1.0, 2.0), (3.0, 4.0))
            )
            names = ["left", "right"][turned]
            w.put("/dynamic", states, START + k, w.header(START + k), names, [one, other][turned])
    found = survey(open_recording(tmp_path / "run"), Clock("header"))
    assert {name: (channel.low, channel.high) for name, channel in found.items() if channel.low} == {
        "/joints position[left]": (1.0, 1.0),
        "/joints position[right]": (2.0, 2.0),
        "/dynamic interface_values[left].values[position]": (1.0, 1.0),
        "/dynamic interface_values[left].values[velocity]": (2.0, 2.0),
        "/dynamic interface_values[right].values[position]": (3.0, 3.0),
        "/dynamic interface_values[right].values[velocity]": (4.0, 4.0),
    }


def test_joints_without_names_are_told_apart_by_their_places(tmp_path, bag_writer):
    with bag_writer(tmp_path / "run", "mcap") as w:
        none = np.array([])
        w.put("/joints", "sensor_msgs/JointState", START, w.header(START), ["", ""], np.array([1.0, 2.0]), none, none)
    assert read(tmp_path / "run", "/joints position[1]") == ([0.0], [2.0])


def test_transforms_without_frames_have_the_names_of_their_joints(tmp_path, bag_writer):
    with bag_writer(tmp_path / "run", "mcap") as w:
        tf = w.make("geometry_msgs/Transform", w.make("geometry_msgs/Vector3", 1.5, 0.0, 0.0), w.quaternion(0.5))
        w.put("/joints", "sensor_msgs/MultiDOFJointState", START, w.header(START), ["base"], [tf], [], [])
    assert read(tmp_path / "run", "/joints transforms[base].x") == ([0.0], [1.5])


def test_one_file_of_a_bag_is_read_without_its_folder(tmp_path, bag_writer):
    with bag_writer(tmp_path / "run", "mcap") as w:
        w.joints("/joints", START, START, left=2.0)
    (file,) = (tmp_path / "run").glob("*.mcap")
    assert read(file, "/joints position[left]") == ([0.0], [2.0])


def test_a_damaged_bag_is_refused_in_one_line(tmp_path):
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    (tmp_path / "run.mcap").write_bytes(b"nothing at all")
    sqlite3.connect(tmp_path / "run.db3").close()
    (tmp_path / "run.db3").write_bytes(b"no data base")
    for name in ("run.bag", "run.mcap", "run.db3"):
        with pytest.raises(InputError) as caught:
            survey(open_recording(tmp_path / name), Clock("receive"))
        assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize("metadata", ["", "rosbag2: [\nfoo", "relative_file_paths: [run.mcap]"])
def test_metadata_that_do_not_fit_are_told_and_the_files_are_read_without_them(tmp_path, bag_writer, metadata):
    with bag_writer(tmp_path / "run", "mcap") as w:
        w.joints("/joints", START, START, left=1.0)
    written = (tmp_path / "run" / "metadata.yaml").read_text()
    missing = written.replace("run.mcap", "other.mcap")
    (tmp_path / "run" / "metadata.yaml").write_text(missing if "run.mcap" in metadata else metadata)
    with pytest.raises(InputError, match=r"metadata.yaml does not fit: remove it, and the files"):
        read(tmp_path / "run", "/joints position[left]")
    (tmp_path / "run" / "metadata.yaml").unlink()
    assert read(tmp_path / "run", "/joints position[left]")[1] == [1.0]


@pytest.mark.parametrize(("kind", "mended"), [("mcap", "'mcap recover'"), ("sqlite3", "'ros2 bag reindex'")])
def test_a_bag_that_was_cut_off_says_what_mends_it(tmp_path, bag_writer, kind, mended):
    with bag_writer(tmp_path / "run", kind) as w:
        for k in range(50):
            w.joints("/joints", START + k, START + k, left=float(k))
    (file,) = (path for path in (tmp_path / "run").iterdir() if path.suffix in (".mcap", ".db3"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    for path in (tmp_path / "run", file):
        with pytest.raises(InputError, match=mended):
            survey(open_recording(path), Clock("receive"))


def test_files_in_a_folder_are_one_bag_in_pieces_or_refused(tmp_path, bag_writer):
    """Pieces follow each other; two robots, or a tracker beside the robot, may be recorded at the same time."""

    def piece(name, start, topic):
        with bag_writer(tmp_path / name, "ros1") as w:
            for k in range(11):
                w.joints(topic, START + start + k, START + start + k, left=start + k)

    piece("0.bag", 0.0, "/joints")
    piece("1.bag", 10.5, "/joints")
    piece("tracker.bag", 5.0, "/tracker")
    times, values = read(tmp_path, "/joints position[left]")
    assert times == values == [float(k) for k in range(11)] + [10.5 + k for k in range(11)]
    piece("2.bag", 15.5, "/joints")
    with pytest.raises(InputError, match=r"1.bag and 2.bag overlap by 5 s, in both of which is /joints: .*name one"):
        read(tmp_path, "/joints position[left]")


def test_without_rosbags_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"pip install '\.\[ros\]' in the project's folder"):
        survey(open_recording(tmp_path / "run.bag"), Clock("receive"))


def test_a_bag_is_read_message_by_message(tmp_path, bag_writer, monkeypatch):
    """Of a topic that is not asked for, nothing is decoded; of the others one message at a time."""
    import rosbags.highlevel

    with bag_writer(tmp_path / "run", "mcap") as w:
        for k in range(50):
            w.joints("/joints", START + k, START + k, left=float(k))
            w.put("/pose", "geometry_msgs/PoseStamped", START + k, w.header(START + k), w.pose(0.0, 0.0, 0.0))
    decoded = []
    inner = rosbags.highlevel.AnyReader.deserialize
    monkeypatch.setattr(
        rosbags.highlevel.AnyReader,
        "deserialize",
        lambda self, raw, kind: decoded.append(kind) or inner(self, raw, kind),
    )
    readings = open_recording(tmp_path / "run").readings(frozenset(["/joints position[left]"]), Clock("header"))
    for k, _ in enumerate(readings, start=1):
        assert len(decoded) == k
    assert set(decoded) == {"sensor_msgs/msg/JointState"}


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("String name", lambda w: w.make("mine/String", "left")),
        ("Byte[] name", lambda w: [w.make("mine/Byte", np.array([k], dtype=np.uint8)) for k in (7, 8)]),
        ("uint8[2] name", lambda w: np.array([7, 8], dtype=np.uint8)),
        ("string name", lambda w: "left"),
        ("string[] name", lambda w: ["left", ""]),
        ("string[] name", lambda w: ["left", "left"]),
    ],
)
def test_a_field_called_name_that_is_no_list_of_names_leaves_places(tmp_path, bag_writer, kind, value):
    """As of a message's own name, whatever type that has."""
    with bag_writer(tmp_path / "run", "mcap") as w:
        w.store.register(get_types_from_msg("string data", "mine/msg/String"))
        w.store.register(get_types_from_msg("uint8[1] data", "mine/msg/Byte"))
        w.store.register(get_types_from_msg(f"{kind}\nfloat64[2] position", "mine/msg/Name"))
        w.put("/encoders", "mine/Name", START, value(w), np.array([1.0, 2.0]))
    assert {*survey(open_recording(tmp_path / "run"), Clock("header"))} == {
        "/encoders position[0]", "/encoders position[1]",
    }  # fmt: skip
