"""A first map, guessed from names as they are found in the field; what they do not tell is left open."""

import numpy as np
import pytest

from castor_envs.logs import import_log
from castor_envs.logs.mapping.guess import guess_map, possible_wheels
from castor_envs.logs.mapping.places import Places
from castor_envs.logs.recordings import open_recording
from castor_envs.logs.recordings.recording import Clock, Found, survey
from castor_envs.vehicles.presets import preset


def guessed(robot, *channels, whole=False):
    found = {name: Found(count=10, start=0, end=10**9, low=0.0, high=1.0, whole=whole) for name in channels}
    columns = guess_map(found, Clock("header"), preset(robot)).columns
    return {key: (column.channel, column.unit) for key, column in columns.items()}


@pytest.mark.parametrize(
    ("left", "right", "unit"),
    [
        ("/joint_states position[left_wheel_joint]", "/joint_states position[right_wheel_joint]", "rad"),
        ("/joint_states velocity[wheel_left]", "/joint_states velocity[wheel_right]", "rad/s"),
        ("/joint_states velocity[left]", "/joint_states velocity[right]", "rad/s"),
        ("left_ticks", "right_ticks", "counts"),
        ("encL", "encR", "counts"),
        ("left", "right", "rad"),
        ("left_rpm", "right_rpm", "rpm"),
        ("left_speed_m_s", "right_speed_m_s", "m/s"),
        ("LeftEncoderDistance", "RightEncoderDistance", "m"),
        ("NT:/drive/leftPosition_m", "NT:/drive/rightPosition_m", "m"),
        ("wheel speed left [rpm]", "wheel speed right [rpm]", "rpm"),
        ("wheel_1l", "wheel_1r", "counts"),
        ("Encoder Left [deg]", "Encoder Right [deg]", "deg"),
        ("left_encoder_rad", "right_encoder_rad", "rad"),
        ("Encoder Left [deg/s]", "Encoder Right [deg/s]", "deg/s"),
        ("left_ticks_per_s", "right_ticks_per_s", "counts/s"),
        ("left wheel (m/s)", "right wheel (m/s)", "m/s"),
        ("left_wheel_angle [deg]", "right_wheel_angle [deg]", "deg"),
        ("left_cps", "right_cps", "counts/s"),
        ("left_mps", "right_mps", "m/s"),
        ("M1 encoder left", "M2 encoder right", "counts"),
        ("v_left", "v_right", "m/s"),
        ("omega_left", "omega_right", "rad/s"),
    ],
)
def test_wheels_are_found_by_their_side(left, right, unit):
    others = ("/joint_states effort[left_wheel]", "left_motor_current", "cmd_left", "battery", "/odom pose.pose.x")
    found = guessed("differential", right, left, *others, whole=unit == "counts")
    assert (found["wheel_1l"], found["wheel_1r"]) == ((left, unit), (right, unit))


def test_a_bodys_velocity_is_no_wheels():
    found = guessed("differential", "t", "v", "omega", "v_x", "v_y", whole=False)
    assert found["wheel_1l"][0] == found["wheel_1r"][0] == "?"


def test_millimetres_of_a_wheel_are_metres_by_the_scale():
    found = {name: Found(count=10, whole=True) for name in ("left wheel [mm]", "right wheel [mm]")}
    column = guess_map(found, Clock("t"), preset("differential")).columns["wheel_1r"]
    assert (column.channel, column.unit, column.scale) == ("right wheel [mm]", "m", 0.001)


def test_states_of_wpilibs_modules_are_metres_a_second_and_radians():
    """By the definition of SwerveModuleState; measured ones are wheels, desired ones are none."""
    names = [
        f"NT:/{what}[{k}].{part}" for what in ("desired", "measured") for k in range(4) for part in ("speed", "angle")
    ]
    found = guessed("swerve", *names)
    for k in range(4):
        assert found[f"wheel_{k + 1}"] == (f"NT:/measured[{k}].speed", "m/s")
        assert found[f"pivot_{k + 1}"] == (f"NT:/measured[{k}].angle", "rad")


SWERVE = {"front left": 1, "rear left": 2, "rear right": 3, "front right": 4}
"""The castors of the preset swerve by their places, of which two are at x > 0 and two at y > 0."""


@pytest.mark.parametrize(
    ("wheel", "pivot", "places"),
    [
        ("{} drive position", "{} steer angle", ("front left", "front right", "rear left", "rear right")),
        ("{}_wheel_pos_position", "{}_azimuth", ("FL", "FR", "RL", "RR")),
        ("{}Drive", "{}Steer", ("frontLeft", "frontRight", "backLeft", "backRight")),
        ("{} Drive Pos (m)", "{} Turn (deg)", ("FL", "FR", "BL", "BR")),
        ("{}_drive_rotations", "{}_azimuth_rotations", ("lf", "rf", "lr", "rr")),
        ("NT:/{}/distance", "NT:/{}/angle", ("FrontLeft", "FrontRight", "BackLeft", "BackRight")),
        ("/js position[{}_wheel]", "/js position[{}_steer]", ("lf", "rf", "lb", "rb")),
        *(
            (wheel, "/js position[{}_steer_joint]", ("front_left", "front_right", "rear_left", "rear_right"))
            for wheel in ("/js velocity[{}_drive_joint]", "/states interface_values[{}_drive].values[velocity]")
        ),
    ],
)
def test_castors_are_found_by_their_places_in_any_order(wheel, pivot, places):
    found = guessed("swerve", *(text.format(place) for place in places for text in (wheel, pivot)))
    order = ("front left", "front right", "rear left", "rear right")
    for place, name in zip(order, places, strict=True):
        assert found[f"wheel_{SWERVE[place]}"][0] == wheel.format(name)
        assert found[f"pivot_{SWERVE[place]}"][0] == pivot.format(name)


def test_speeds_of_a_drive_are_a_wheels_and_those_of_its_body_are_not():
    found = guessed("swerve", *(f"NT:/Drive/Module{k}/{part}Velocity" for k in range(4) for part in ("Turn", "Drive")))
    assert [found[f"wheel_{k + 1}"] for k in range(4)] == [
        (f"NT:/Drive/Module{k}/DriveVelocity", "rad/s") for k in range(4)
    ]
    found = guessed("swerve", *(f"NT:/Drive/Speeds[{k}]" for k in range(3)), "/drive velocity[front_left_steer]")
    assert {channel for channel, _ in found.values()} == {"?"}


def test_places_are_those_of_the_robot_file():
    """Wheels of two castors one behind the other; wheels on a triangle, whose rear one is neither left nor right."""
    found = guessed("2-castor", "rl encoder", "fr encoder", "rr encoder", "fl encoder")
    assert {key: name for key, (name, _) in found.items() if name != "?"} == {
        "wheel_1l": "fl encoder", "wheel_1r": "fr encoder", "wheel_2l": "rl encoder", "wheel_2r": "rr encoder",
    }  # fmt: skip
    found = guessed("omni3", "rear wheel", "left wheel", "right wheel")
    assert [found[f"wheel_{k}"][0] for k in (1, 2, 3)] == ["right wheel", "left wheel", "rear wheel"]


def test_an_order_that_no_name_says_is_remarked_upon():
    robot = preset("swerve")

    def remark(*names):
        found = {name: Found(count=10) for name in names}
        return Places(robot).remark(guess_map(found, Clock(), robot))

    said = remark(*(f"NT:/modules[{k}].{part}" for k in range(4) for part in ("distance", "angle")))
    assert said is not None
    assert "front left, rear left, rear right, front right" in said
    assert remark(*(f"{place} {part}" for place in SWERVE for part in ("position", "steer"))) is None
    assert remark(*(f"{part}_{k}" for k in range(1, 5) for part in ("wheel", "pivot"))) is None  # a log's own columns


def test_one_castor_with_encoders_has_no_order():
    robot = preset("tricycle")
    found = {name: Found(count=10) for name in ("/joints position[traction_joint]", "/joints position[steer_joint]")}
    guess = guess_map(found, Clock("header"), robot)
    assert [column.channel for column in guess.columns.values()] == list(found)
    assert Places(robot, found).remark(guess) is None


def test_positions_go_before_speeds():
    names = [f"/joint_states {what}[{side}_wheel]" for what in ("velocity", "position") for side in ("right", "left")]
    assert guessed("differential", *names)["wheel_1l"] == ("/joint_states position[left_wheel]", "rad")


def test_channels_that_never_change_are_taken_only_where_no_others_fit():
    """As of a driver that fills in speeds alone, and of a tracker that has lost the robot."""
    joints = [f"/joint_states {what}[{side}]" for what in ("position", "velocity") for side in ("left", "right")]
    poses = [f"/{who} pose.{part}" for who in ("vicon", "robot") for part in ("x", "y", "heading")]
    names = [*joints, *poses, "gyro rate", "gyro yaw rad"]

    def map_of(*dead):
        found = {name: Found(count=9, low=0.0, high=0.0 if name.startswith(dead) else 1.0) for name in names}
        return {key: c.channel for key, c in guess_map(found, Clock("t"), preset("differential")).columns.items()}

    live = {
        "wheel_1l": joints[0], "wheel_1r": joints[1], "ref_x": poses[0], "ref_y": poses[1], "ref_psi": poses[2],
        "gyro_z": "gyro rate",
    }  # fmt: skip
    assert map_of("none") == live
    assert map_of("/joint_states pos") == live | {"wheel_1l": joints[2], "wheel_1r": joints[3]}
    assert map_of("/joint_states position[l") == live | {"wheel_1l": joints[2], "wheel_1r": joints[3]}
    assert map_of("/joint_states") == live
    assert map_of("/vicon") == live | dict(zip(("ref_x", "ref_y", "ref_psi"), poses[3:], strict=True))
    assert map_of("gyro rate") == live | {"gyro_z": "gyro yaw rad"}


def test_modules_of_an_array_are_counted_from_0():
    names = [f"NT:/modules[{k}].{part}" for k in range(4) for part in ("distance", "angle")]
    found = guessed("swerve", *names)
    for k in range(4):
        assert found[f"wheel_{k + 1}"] == (f"NT:/modules[{k}].distance", "m")
        assert found[f"pivot_{k + 1}"] == (f"NT:/modules[{k}].angle", "rad")


@pytest.mark.parametrize(
    ("wheel", "pivot"),
    [
        ("NT:/Drive/Module{}/DrivePositionRad", "NT:/Drive/Module{}/TurnPosition"),
        ("/Drive/Module{}/DrivePositionRad", "/Drive/Module{}/TurnPosition.heading"),
        ("wheel_{}", "steer_{}"),
        ("wheel{}", "pivot_{}"),
        ("/drive/state position[joint_{}]", "/steer/state position[joint_{}]"),
        ("/robot0/wheel_0{}_ticks", "/robot0/steer_0{}_ticks"),
    ],
)
@pytest.mark.parametrize("first", [0, 1])
def test_numbers_in_names_are_counted_from_0_where_one_name_has_0(wheel, pivot, first):
    found = guessed("swerve", *(name.format(k + first) for k in range(4) for name in (wheel, pivot)))
    assert [found[f"wheel_{k + 1}"][0] for k in range(4)] == [wheel.format(k + first) for k in range(4)]
    assert [found[f"pivot_{k + 1}"][0] for k in range(4)] == [pivot.format(k + first) for k in range(4)]


@pytest.mark.parametrize(
    ("wheel", "pivot", "units"),
    [
        ("drive_rev", "steer_deg", ("rev", "deg")),
        ("drive_rpm", "steering_rev", ("rpm", "rev")),
        ("traction_rev", "steering_rev", ("rev", "rev")),
        ("drive_angle_rad", "steering_angle_deg", ("rad", "deg")),
        ("drive_motor_pos_rad", "steer_motor_pos_rad", ("rad", "rad")),
        ("wheel_rev", "steer_rad", ("rev", "rad")),
    ],
)
def test_one_driven_wheel_and_one_pivot_need_no_place_in_their_names(wheel, pivot, units):
    others = ("fork_height", "drive_temp", "mast_angle_deg", "steering_mode", "drive_current")
    found = guessed("tricycle", *others, pivot, wheel)
    assert (found["wheel_1"], found["pivot_1"]) == ((wheel, units[0]), (pivot, units[1]))
    assert guessed("tricycle", *others)["pivot_1"][0] == guessed("tricycle", *others)["wheel_1"][0] == "?"


def test_numbers_of_wheels_tell_where_those_of_pivots_begin():
    """As where the pivot of the first one is called otherwise."""
    names = [*(f"c{k}_wheel" for k in range(4)), "front_pot", *(f"c{k}_angle_rad" for k in (1, 2, 3))]
    found = guessed("swerve", *names)
    assert [found[f"wheel_{k + 1}"][0] for k in range(4)] == [f"c{k}_wheel" for k in range(4)]
    assert [found[f"pivot_{k + 1}"][0] for k in range(4)] == ["?", *(f"c{k}_angle_rad" for k in (1, 2, 3))]


def test_wheels_that_are_numbered_from_0_are_fewer_or_more_than_those_of_the_robot():
    """What is missing is the last one; of one too many nothing tells where the count begins, but a log's own names."""
    found = guessed("omni3", "wheel0", "wheel1")
    assert [found[f"wheel_{k}"][0] for k in (1, 2, 3)] == ["wheel0", "wheel1", "?"]
    found = guessed("omni3", *(f"wheel_{k}" for k in range(4)))
    assert [found[f"wheel_{k}"][0] for k in (1, 2, 3)] == ["wheel_1", "wheel_2", "wheel_3"]


def test_what_stands_at_0_all_the_time_is_not_taken_for_counts_where_its_format_says_the_unit():
    names = [f"/joints position[{name}]" for name in ("left_wheel", "right_wheel")]
    assert {unit for _, unit in guessed("differential", *names, whole=True).values()} == {"rad"}
    assert {unit for _, unit in guessed("differential", "left", "right", whole=True).values()} == {"counts"}


def test_a_gyro_and_commands_are_found():
    names = ("left_ticks", "right_ticks", "cmd_left_rpm", "cmd_right_rpm", "/imu angular_velocity.x")
    found = guessed("differential", *names, "/imu angular_velocity.z")
    assert found["gyro_z"] == ("/imu angular_velocity.z", "rad/s")
    assert found["cmd_1l"] == ("cmd_left_rpm", "rpm")
    assert guessed("differential", "left_ticks", "right_ticks", "gyro_z_dps")["gyro_z"] == ("gyro_z_dps", "deg/s")
    assert guessed("differential", "gyroYawDeg")["gyro_z"] == ("gyroYawDeg", "deg")
    assert guessed("differential", "NT:/gyro/angle", "NT:/gyro/rate")["gyro_z"] == ("NT:/gyro/rate", "rad/s")
    assert guessed("differential", "gyro_yaw_rad_per_s")["gyro_z"] == ("gyro_yaw_rad_per_s", "rad/s")


def test_a_trackers_pose_is_the_reference_and_odometrys_is_not():
    def pose(prefix):
        return [f"{prefix}.{part}" for part in ("x", "y", "heading")]

    found = guessed("differential", *pose("/odom pose.pose"), *pose("/robot pose"), *pose("/vicon/robot pose"))
    assert found["ref_psi"] == ("/vicon/robot pose.heading", "rad")
    assert "ref_x" not in guessed("differential", *pose("/odom pose.pose"))
    found = guessed("differential", "x_mm", "y_mm", "yaw_deg")
    assert [found[key] for key in ("ref_x", "ref_y", "ref_psi")] == [("x_mm", "mm"), ("y_mm", "mm"), ("yaw_deg", "deg")]


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ("/leica/point point.x", "/leica/point point.y"),
        ("gps_x", "gps_y"),
        ("gt_x_mm", "gt_y_mm"),
        ("utm easting [m]", "utm northing [m]"),
        ("Easting", "Northing"),
    ],
)
def test_positions_of_a_receiver_or_a_prism_are_a_reference_without_a_heading(x, y):
    found = guessed("differential", "left_ticks", "right_ticks", "/odom pose.x", "/odom pose.y", x, y)
    unit = "mm" if x.endswith("mm") else "m"
    assert {key: of for key, of in found.items() if key.startswith("ref_")} == {"ref_x": (x, unit), "ref_y": (y, unit)}


def test_a_heading_that_never_changes_beside_positions_that_do_is_none():
    """As in a pose of ROS that a receiver fills with a position and the identity."""
    found = {
        f"/gps pose.{part}": Found(count=9, low=0, high=high) for part, high in (("x", 5), ("y", 6), ("heading", 0))
    }
    columns = guess_map(found, Clock("t"), preset("differential")).columns
    assert [key for key in columns if key.startswith("ref_")] == ["ref_x", "ref_y"]


def test_unknown_positions_and_degrees_of_latitude_are_no_reference():
    found = guessed("differential", "x", "y", "/odom pose.x", "/odom pose.y", "/gps latitude", "/gps longitude")
    assert not [key for key in found if key.startswith("ref_")]


def test_degrees_are_told_by_their_sign_and_by_how_far_they_go():
    assert guessed("differential", "Gyro Z [°/s]")["gyro_z"] == ("Gyro Z [°/s]", "deg/s")
    for high, unit in ((68.8, "deg"), (6.0, "rad")):
        found = {"Gyro Yaw": Found(count=10, low=0.0, high=high)}
        assert guess_map(found, Clock("t"), preset("differential")).columns["gyro_z"].unit == unit
    found = guessed("differential", "Pos X [mm]", "Pos Y [mm]", "Yaw [deg]")
    assert [unit for key, (_, unit) in found.items() if key.startswith("ref_")] == ["mm", "mm", "deg"]


def test_an_encoder_that_holds_no_whole_numbers_does_not_count():
    names = "Left Encoder", "Right Encoder"
    for whole, unit in ((True, "counts"), (False, "m")):
        found = {name: Found(count=10, start=0, end=10**9, high=5.99, whole=whole) for name in names}
        columns = guess_map(found, Clock("t"), preset("differential")).columns
        assert [columns[key].unit for key in ("wheel_1l", "wheel_1r")] == [unit, unit]


@pytest.mark.parametrize("name", ["{}.speed", "{}", "{} velocity"])
def test_wheels_of_one_family_have_one_unit(name):
    """As where one wheel stood all the time, or was told to turn at whole numbers."""
    found = {name.format("left"): Found(count=9, high=5.5, whole=False), name.format("right"): Found(count=9, high=5)}
    columns = guess_map(found, Clock("t"), preset("differential")).columns
    assert {columns[key].unit for key in ("wheel_1l", "wheel_1r")} == {"rad" if name == "{}" else "rad/s"}


def test_all_wheels_come_from_names_of_one_family():
    modules = [f"NT:/ModulePositions[{k}].distance" for k in range(4)]
    found = guessed("swerve", "SmartDashboard/Left Encoder", "SmartDashboard/Right Encoder", *modules)
    assert [found[f"wheel_{k + 1}"] for k in range(4)] == [(name, "m") for name in modules]


def test_poses_and_motions_of_a_body_cannot_be_a_wheel_and_what_else_counts_can():
    poses = ["/odom pose.pose.x", "/tf odom>base.heading", "/vicon/robot w>robot.y", "x_mm", "theta", "camera heading"]
    motions = ["/odom twist.twist.angular.z", "/imu linear_acceleration.x", "NT:/speeds.omega", "gyro", "cmd_left"]
    wheels = ["A", "links", "/joints velocity[base]", "/wheel_ticks vector.x", "NT:/modules[0].distance", "#2"]
    wheels += ["w_left", "omega_l", "theta_left", "phi_l", "x_left", "left_current_pos", "omegaRight", "phi_fl"]
    poses += ["E", "N", "Easting [m]", "Northing [m]", "Height [m]", "E (m)"]
    wheels += ["n1", "n_left"]
    poses += ["/left_camera pose.x", "/camera_left pose.pose.heading", "/tf odom>left.x", "NT:/leftPose.x"]
    motions += ["left_motor_current", "/joints effort[left]", "left_cmd", "/imu_left angular_velocity.z"]
    assert possible_wheels([*poses, *motions, *wheels]) == wheels


def test_what_nothing_speaks_for_is_left_open():
    assert guessed("differential", "s", "deg", "deg #3", "m/s")["wheel_1l"] == ("?", "?")
    assert guessed("differential", "a", "b") == {"wheel_1l": ("?", "?"), "wheel_1r": ("?", "?")}


def test_what_is_left_open_has_the_unit_of_the_others_of_its_kind():
    found = guessed("swerve", *(f"{part}_{k}" for part in ("wheel", "steer") for k in range(3)), whole=True)
    assert [found[key] for key in ("wheel_4", "pivot_4")] == [("?", "counts"), ("?", "counts")]
    assert guessed("differential", "left wheel speed [rpm]", "b")["wheel_1r"] == ("?", "rpm")
    found = {name: Found(count=10, whole=True) for name in ("left wheel [mm]", "b")}
    column = guess_map(found, Clock("t"), preset("differential")).columns["wheel_1r"]
    assert (column.unit, column.scale) == ("m", 0.001)


def test_the_position_of_a_joint_is_no_speed_whatever_its_topic_is_called():
    names = [f"/speed_controller/state position[{side}_wheel]" for side in ("left", "right")]
    assert guessed("differential", *names)["wheel_1l"] == (names[0], "rad")


def test_the_first_map_of_ticks_without_a_header_imports_as_it_is(tmp_path, bag_writer):
    """The bag's clock is 7 ms ahead of the stamps: counts have the times of receipt, the gyro those of its header."""
    with bag_writer(tmp_path / "bag", "mcap") as w:
        for k in range(101):
            t = 1_700_000_000.0 + 0.02 * k
            w.put("/left_ticks", "std_msgs/Int32", t, 10 * k)
            w.put("/right_ticks", "std_msgs/Int32", t, 12 * k)
            rate, none = w.make("geometry_msgs/Vector3", 0.0, 0.0, 0.02 * k - 0.007), np.zeros(9)
            w.put("/imu", "sensor_msgs/Imu", t, w.header(t - 0.007), w.quaternion(0), none, rate, none, rate, none)
    bag, robot = open_recording(tmp_path / "bag"), preset("differential")
    first = guess_map(survey(bag, bag.clock()), bag.clock(), robot)
    assert [first.sources[first.columns[key].source].time for key in ("wheel_1l", "gyro_z")] == ["receive", "header"]
    log = import_log(tmp_path / "bag", robot, first).log
    np.testing.assert_array_equal(np.diff(log.wheel, axis=0), np.tile([10, 12], (len(log) - 1, 1)))
    assert log.gyro is not None
    np.testing.assert_allclose(log.gyro, 0.02 * log.wheel[:, 0] / 10, atol=1e-6)  # by stamp, the rate is the time
