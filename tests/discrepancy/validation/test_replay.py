"""Replays: on logs that were simulated, the gap is what effects leave, and that of the right robot is the floor."""

import dataclasses
import json
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.catalogue import reference
from castor_envs.effects.clocks import ClockOffset, EncoderLatency
from castor_envs.effects.dimensions import CountsPerRev, PivotBias, PivotOffset, Track, WheelRadius
from castor_envs.effects.encoders import PivotBacklash, TickLoss
from castor_envs.effects.floor import FrictionPatch
from castor_envs.effects.reference import ReferenceLeverX, ReferenceYaw
from castor_envs.effects.wiring import EncoderReversed, EncodersSwapped
from castor_envs.envs.sensed import SensedRobot
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log
from castor_envs.motion.controllers import KinematicController, trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import umbmark, wander
from castor_envs.vehicles.presets import preset
from discrepancy.validation.replay import joined, replay

ASOC, DIFFERENTIAL = preset("asoc-prototype"), preset("differential")
EVERY = 20
WINDOW = 5.0
HIDDEN = {
    "wheel radius": WheelRadius(castor=2, wheel=1, value=0.005),
    "pivot bias": PivotBias(castor=2, value=0.005),
    "pivot offset": PivotOffset(castor=1, value=0.001),
    "track": Track(castor=3, value=0.01),
    "latency": EncoderLatency(castor=1, wheel=1, value=0.01),
    "backlash": PivotBacklash(castor=1, value=0.01),
    "counts lost": TickLoss(castor=3, wheel=2, above=1.0, value=0.02),
    "counts a turn": CountsPerRev(castor=1, wheel=2, value=0.01),
}


def drive(robot, trajectory, seed=0, noise=0.0):
    """A log of a robot that drives a trajectory, with a reference pose every second, off by `noise` (m and rad)."""
    random, geometry, period = np.random.default_rng(seed), Geometry.of(robot), robot.sample_period
    sensed = SensedRobot(robot, Floor())
    sensed.reset(random, trailing_angles(geometry, trajectory.runs[0].legs[0].motion) + random.uniform(-0.5, 0.5))
    controller = KinematicController(sensed.described)
    wheel, pivot = [np.zeros(len(robot.driven_wheels))], [sensed.observation["pivot"]]
    poses, commands, steering = [sensed.world.pose.copy()], [], []
    for k in range(round(trajectory.duration / period)):
        told = controller.commands(sensed.measured_castor_angles(), trajectory.at((k + 0.5) * period)[1])
        sensed.advance(told)
        wheel.append(wheel[-1] + sensed.observation["wheel"])
        pivot.append(sensed.observation["pivot"])
        poses.append(sensed.world.pose.copy())
        commands.append(told.wheel)
        steering.append(told.steering)
    t, poses = period * np.arange(len(poses)), reference(robot, period * np.arange(len(poses)), np.array(poses))
    poses += noise * random.normal(size=poses.shape)
    poses[np.arange(len(poses)) % EVERY > 0] = np.nan
    return Log(
        t,
        np.array(wheel),
        np.array(pivot),
        np.array([*commands, commands[-1]]),
        np.array([*steering, steering[-1]]) if robot.driven_castors else None,
        poses,
    )


@cache
def asoc(seed=5, *effects, **given):
    return drive(ASOC.with_effects(*effects), wander(np.random.default_rng(seed), duration=20.0), **given)


def seen_from(log, origin, mount):
    """The same log, its reference of another point of the body, `mount`, and with another `origin`, both (3,)."""
    assert log.reference is not None
    return dataclasses.replace(log, reference=compose(origin, compose(log.reference, mount)))


def sizes(found):
    """Gaps of position and heading (mm, mrad) and of encoders (mm, mrad), rms."""
    summary = found.summary()
    keys = ("position_rms_mm", "heading_rms_mrad", "wheels_rms_mm", "pivots_rms_mrad")
    return np.array([np.nan if summary[key] is None else summary[key] for key in keys])


@pytest.fixture(scope="module")
def clean():
    return asoc(noise=1e-3)


@pytest.fixture(scope="module")
def replayed(clean):
    """The replay of the clean log by the robot that made it."""
    return replay(ASOC, clean, WINDOW)


@pytest.fixture(scope="module")
def plain():
    """Gaps of the log without noise, by the robot that made it."""
    return sizes(replay(ASOC, asoc(), WINDOW))


def headless(log):
    return dataclasses.replace(log, reference=log.reference * [1.0, 1.0, np.nan])


def test_positions_need_a_path_and_then_leave_the_same_gap(clean):
    """Given the true headings they are replayed as poses without noise of headings; no gap of heading is measured."""
    true = asoc().reference
    assert true is not None
    path = np.column_stack([np.interp(clean.t, clean.t[::EVERY], column) for column in true[::EVERY].T])
    whole = dataclasses.replace(clean, reference=np.column_stack([clean.reference[:, :2], true[:, 2]]))
    expected, found = replay(ASOC, whole, WINDOW), replay(ASOC, headless(clean), WINDOW, path=path)
    np.testing.assert_allclose(found.body[:, :2], expected.body[:, :2], atol=1e-12)
    assert np.isnan(found.body[:, 2]).all()
    assert np.isfinite(expected.body).all()
    assert any("likely path" in note for note in found.notes)
    assert found.summary()["heading_rms_mrad"] is None
    assert found.expected(1e-3, None)["heading_rms_mrad"] is None
    without = replay(ASOC, headless(clean), WINDOW)
    assert any("no reference poses" in note for note in without.notes)


def test_a_yaw_of_the_reference_in_the_robot_file_does_not_turn_positions(clean):
    true = asoc().reference
    assert true is not None
    path = np.column_stack([np.interp(clean.t, clean.t[::EVERY], x) for x in true[::EVERY].T])
    plain, yawed = (
        replay(robot, headless(clean), WINDOW, path=path)
        for robot in (ASOC, ASOC.with_effects(ReferenceYaw(value=0.3)))
    )
    np.testing.assert_allclose(yawed.body[:, :2], plain.body[:, :2], atol=1e-9)


def test_a_clean_log_leaves_what_the_reference_and_the_rounding_of_counts_leave(replayed):
    """Expected from the noise put in; the rounding of two counts is 1 / sqrt(6) of a count."""
    expected = replayed.expected(1e-3, 1e-3)
    expected = {key: value or 0.0 for key, value in expected.items()}
    geometry = Geometry.of(ASOC)
    count = 2e3 * np.pi * np.mean(geometry.radius / geometry.counts_per_rev)
    pivot = 2e3 * np.pi / geometry.pivot_counts_per_rev[0]
    position, heading, wheels, pivots = sizes(replayed)
    assert 0.5 * expected["position_rms_mm"] < position < 1.5 * expected["position_rms_mm"]
    assert 0.5 * expected["heading_rms_mrad"] < heading < 1.5 * expected["heading_rms_mrad"]
    assert wheels < 1.5 * count / np.sqrt(6)
    assert pivots < 2 * pivot / np.sqrt(6)


def test_without_noise_a_clean_log_replays_to_fractions_of_a_millimetre(plain):
    """What is left is where pivots stood within a count, and what nobody can know of motors and contacts."""
    position, heading, _, _ = plain
    assert position < 0.3
    assert heading < 0.5


@pytest.mark.parametrize("name", HIDDEN)
def test_the_right_robot_comes_down_to_the_floor_of_a_clean_log(name, replayed):
    """The nominal robot is clearly above it in position, heading or what encoders count."""
    log = asoc(5, HIDDEN[name], noise=1e-3)
    floor, nominal = sizes(replayed), sizes(replay(ASOC, log, WINDOW))
    right = sizes(replay(ASOC.with_effects(HIDDEN[name]), log, WINDOW))
    rounding = np.array([0.0, 0.0, 0.05, 0.2])  # a fifth of a count, as what is rounded falls by chance
    assert np.all(right <= 1.2 * floor + rounding)
    assert np.max(nominal / np.maximum(floor, right)) > 2


def test_radius_and_track_of_a_differential_robot_show_against_the_reference():
    """It has no redundancy: what its encoders count says nothing. Half a per cent of 0.6 m is 3 mm."""
    for effect in (WheelRadius(castor=1, wheel=1, value=0.005), Track(castor=1, value=0.01)):
        real = DIFFERENTIAL.with_effects(effect)
        log, plain = (drive(robot, umbmark("cw", "rounded")) for robot in (real, DIFFERENTIAL))
        floor, nominal, right = (
            sizes(replay(robot, log_used, WINDOW))
            for robot, log_used in ((DIFFERENTIAL, plain), (DIFFERENTIAL, log), (real, log))
        )
        assert np.all(right[:3] <= 1.2 * floor[:3] + 0.05)
        assert nominal[1] > 5 * right[1]
        assert nominal[2] < 1.2 * floor[2] + 0.05


def test_one_radius_turns_a_differential_robot_by_rolled_distance_over_track():
    """Closed form: a left wheel larger by e turns it right by e times what that wheel rolled, over the track."""
    e = 0.005
    log = drive(DIFFERENTIAL.with_effects(WheelRadius(castor=1, wheel=1, value=e)), umbmark("cw", "rounded"))
    found = replay(DIFFERENTIAL, log, WINDOW)
    at = np.rint(np.array([found.start, found.end]) / DIFFERENTIAL.sample_period).astype(int)
    geometry = Geometry.of(DIFFERENTIAL)
    count, track = 2 * np.pi * geometry.radius[0] / geometry.counts_per_rev[0], np.ptp(geometry.lateral)
    rolled = np.diff(log.wheel[at, 0], axis=0)[0] * count
    assert found.body[:, 2] == pytest.approx(e * rolled / track, abs=count / track)


@pytest.mark.parametrize("name", ["tricycle", "swerve"])
def test_steering_motors_follow_commands_or_counts(name):
    robot = preset(name)
    trajectory = umbmark("cw", "rounded") if name == "tricycle" else wander(np.random.default_rng(5), duration=20.0)
    log = drive(robot, trajectory)
    unsteered = dataclasses.replace(log, steering_command=None)
    for log_used in (log, unsteered):
        position, heading, _, pivots = sizes(replay(robot, log_used, WINDOW))
        assert position < 3
        assert heading < 3
        assert pivots < 6
    assert not replay(robot, log).notes
    assert "no steering commands" in replay(robot, unsteered).notes[0]


@pytest.mark.parametrize("effect", [EncodersSwapped(castor=1), EncoderReversed(castor=2, wheel=1)])
def test_wrong_wiring_is_undone(effect):
    """The commands of such a robot are as bad as its readings are, but with the right wiring they replay."""
    log = asoc()
    wrong = log.wheel.copy()
    if isinstance(effect, EncodersSwapped):
        wrong[:, [0, 1]] = wrong[:, [1, 0]]
    else:
        wrong[:, 2] *= -1
    log = dataclasses.replace(log, wheel=wrong)
    for command in (log.command, None):
        found = replay(ASOC.with_effects(effect), dataclasses.replace(log, command=command), WINDOW)
        assert np.all(sizes(found)[:2] < 1)
    assert sizes(replay(ASOC, log, WINDOW))[2] > 50


def test_by_counts_needs_no_commands_and_finds_the_same_clean_floor(clean, replayed):
    blind = dataclasses.replace(clean, command=None)
    found = replay(ASOC, blind, WINDOW)
    assert found.drive == "counts"
    assert "no commands" in found.notes[0]
    assert np.all(sizes(found)[:2] < 1.2 * sizes(replayed)[:2])


def test_by_counts_a_wrong_radius_shows_in_the_motion():
    effect = HIDDEN["wheel radius"]
    log = dataclasses.replace(asoc(5, effect), command=None)
    nominal, right = sizes(replay(ASOC, log, WINDOW)), sizes(replay(ASOC.with_effects(effect), log, WINDOW))
    assert nominal[0] > 5 * right[0]


def test_without_a_reference_only_encoders_are_compared(clean):
    found = replay(ASOC, dataclasses.replace(clean, reference=None), WINDOW)
    position, heading, wheels, pivots = sizes(found)
    assert np.isnan(position)
    assert np.isnan(heading)
    assert wheels > 0
    assert pivots > 0
    assert "no reference" in found.notes[-1]
    assert found.summary()["windows_with_reference"] == 0


def test_the_tracked_point_and_its_clock_are_taken_as_given(plain):
    """The reference shows another point of the body, 33 ms early: known, it leaves as much as before."""
    mount, log = np.array([0.1, -0.05, 0.3]), asoc()
    moved = seen_from(log, np.zeros(3), mount)
    assert sizes(replay(ASOC, moved, WINDOW, mount=mount)) == pytest.approx(plain, rel=1e-6)
    assert sizes(replay(ASOC, moved, WINDOW))[0] > 20
    yawed = ASOC.with_effects(ReferenceYaw(value=0.01), ReferenceLeverX(value=0.02))
    assert sizes(replay(yawed, asoc(5, *yawed.effects), WINDOW)) == pytest.approx(plain, rel=1e-6)
    early = asoc(5, ClockOffset(value=0.033))
    assert sizes(replay(ASOC, early, WINDOW))[0] > 5
    assert np.all(sizes(replay(ASOC, early, WINDOW, clock=(0.033, 0.0)))[:2] < 0.7)
    assert np.all(sizes(replay(ASOC.with_effects(ClockOffset(value=0.033)), early, WINDOW))[:2] < 0.7)


def test_where_the_log_begins_on_the_clock_and_in_the_plane_does_not_matter():
    log = asoc()
    elsewhere = dataclasses.replace(seen_from(log, np.array([3.0, -2.0, 1.0]), np.zeros(3)), t=log.t + 1e3)
    original, moved = replay(ASOC, log, WINDOW), replay(ASOC, elsewhere, WINDOW)
    assert moved.body == pytest.approx(original.body, abs=1e-6)
    assert moved.start == pytest.approx(original.start + 1e3)


def test_no_window_goes_over_a_gap_and_rows_missing_here_and_there_are_bridged():
    log = asoc()
    rows = np.arange(len(log))

    def kept(rows):
        parts = ("t", "wheel", "pivot", "command", "reference")
        return dataclasses.replace(log, **{part: getattr(log, part)[rows] for part in parts})

    found = replay(ASOC, kept((rows < 130) | (rows > 190)), 2.0)
    assert len(found.start) > 3
    assert not np.any((found.start < log.t[130]) & (found.end > log.t[190]))
    assert np.all(sizes(replay(ASOC, kept(rows % 37 != 5), 2.0))[:2] < 5)


def test_several_logs_make_one_replay(replayed):
    joint = joined([replayed, replayed])
    assert len(joint.start) == 2 * len(replayed.start)
    assert sizes(joint) == pytest.approx(sizes(replayed))


def test_a_summary_is_json_with_channels_by_name(replayed):
    summary = replayed.summary()
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    names = [channel["name"] for channel in summary["channels"]]
    assert names == [f"wheel_{i}{side}" for i in (1, 2, 3) for side in "lr"] + [f"pivot_{i}" for i in (1, 2, 3)]


def test_a_castor_without_an_encoder_is_refused():
    robot = preset("asoc-prototype")
    castors = (dataclasses.replace(robot.castors[0], pivot_counts_per_rev=None), *robot.castors[1:])
    log = asoc()
    log = dataclasses.replace(log, pivot=log.pivot[:, 1:])
    with pytest.raises(InputError, match="castor 1 turns but has no pivot encoder"):
        replay(dataclasses.replace(robot, castors=castors), log)


def test_samples_further_apart_than_a_window_lasts_are_refused():
    """The pose at the start of a window was taken for the one at its end, so that no next window ever came."""
    log = asoc()
    slow = dataclasses.replace(log, t=log.t * 20 / ASOC.sample_period)
    with pytest.raises(InputError, match="samples are 20 s apart, and a replay takes windows of 5 s"):
        replay(ASOC, slow, WINDOW)


def test_only_windows_in_which_something_differs_need_to_be_simulated_again():
    """What windows hand on changes those after a patch by fractions of a millimetre; the one just after is simulated
    again."""
    wet = ASOC.with_effects(FrictionPatch(x=0.5, y=0.3, length=0.6, width=0.6, value=0.95))
    plain, whole = replay(ASOC, asoc(), 1.0), replay(wet, asoc(), 1.0)
    same, all_anew = (replay(wet, asoc(), 1.0, like=plain, anew=np.full(len(plain.start), anew)) for anew in (0, 1))
    np.testing.assert_array_equal(same.body, plain.body)
    np.testing.assert_array_equal(all_anew.body, whole.body)
    changed = np.abs(whole.body - plain.body).max(axis=1) > 1e-3
    part = replay(wet, asoc(), 1.0, like=plain, anew=changed)
    after = np.append(False, changed[:-1]) & ~changed
    assert changed.any()
    assert after.any()
    assert np.abs(part.body - whole.body)[changed].max() < 1e-4
    assert (np.abs(part.body - plain.body)[after] > 0).any()
    np.testing.assert_array_equal(part.body[~changed & ~after], plain.body[~changed & ~after])
    np.testing.assert_array_equal(part.wheels[~changed & ~after], plain.wheels[~changed & ~after])
