"""The driver keeps every axle of a train on its path, and each behind the one ahead; robots are driven as they roll."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.geometry.se2 import relative_pose
from castor_envs.motion.controllers import KinematicController, TrainDriver, trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.paths import TrainPath, named_path
from castor_envs.motion.trajectories import chained, figure_eight, umbmark
from castor_envs.physics.train_world import TrainWorld
from castor_envs.sensors.posture import PostureSensors
from castor_envs.vehicles.presets import cfmmr, preset

LENGTH, RADIUS, HALF_TRACK, PERIOD = 0.35, 0.075, 0.16, 0.05
BEND = TrainPath("bend", ((1.0, 0.8), (1.0, -0.5)))


def quiet(n, slip_stiffness=80.0):
    """A train whose sensors make no error."""
    train = cfmmr(n)
    contact = dataclasses.replace(
        train.modules[0].contact, slip_stiffness_long=slip_stiffness, slip_stiffness_lat=slip_stiffness
    )
    return dataclasses.replace(
        train,
        modules=tuple(dataclasses.replace(module, contact=contact) for module in train.modules),
        frames=tuple(dataclasses.replace(frame, gauge_noise=0.0, gauge_offset=0.0) for frame in train.frames),
    )


def places_on(path, n, t):
    """Where the axles belong at time t, written down from the path's legs by small straight steps: (N, 3)."""
    peak = min(path.speed, math.sqrt(path.acceleration * sum(length for length, _ in path.legs)))
    total, ramp = sum(length for length, _ in path.legs), peak / path.acceleration
    end = total / peak + ramp
    if t < ramp:
        covered = 0.5 * path.acceleration * t**2
    elif t < end - ramp:
        covered = peak * (t - 0.5 * ramp)
    else:
        covered = total - 0.5 * path.acceleration * max(end - t, 0.0) ** 2
    places = []
    for i in range(n):
        s = covered - LENGTH * i
        x, y, psi = min(s, 0.0), 0.0, 0.0
        for length, curvature in path.legs:
            distance = min(max(s, 0.0), length)
            steps = max(1, math.ceil(distance / 0.03))
            for _ in range(steps):
                ds, middle = distance / steps, psi + 0.5 * curvature * distance / steps
                x, y, psi = x + ds * math.cos(middle), y + ds * math.sin(middle), psi + curvature * ds
            s -= distance
        places.append([x, y, psi])
    return np.array(places)


def drive(train, path, *, sensing=True, kick=None, seed=0):
    """Drive a path; return how far axles are from their places, as seen from these, (samples, N, 3), the frames'
    relative poses (samples, F, 3), and the world.

    kick: (from, to, wheel rates) that the rearmost axle gets on top of its commands for that time, s.
    """
    world, driver = TrainWorld(train), TrainDriver(train.as_described(), path)
    sensors, off, bent = PostureSensors(train.as_built(), np.random.default_rng(seed)), [], []
    for _ in range(math.ceil(path.duration / PERIOD)):
        rps, age = sensors.read(world.joint_angles, world.time)
        command = driver.commands(world.time, rps if sensing else np.full_like(rps, np.nan), age)
        if kick is not None and kick[0] <= world.time < kick[1]:
            command[-2:] += kick[2]
        world.advance(command)
        off.append(relative_pose(places_on(path, train.n_axles, world.time), world.poses))
        bent.append(world.relative_poses)
    return np.array(off), np.array(bent), world


def distance(off):
    return np.hypot(off[..., 0], off[..., 1])


@pytest.mark.parametrize("name", ["straight", "arc", "s-bend", "random"])
@pytest.mark.parametrize("n", [2, 5])
def test_all_axles_follow_the_path(n, name):
    """Within 4 cm of where they belong, 8 cm after 5 m of random arcs: what the front axle loses to slip."""
    path = named_path(name, np.random.default_rng(1))
    off, _, world = drive(quiet(n), path)
    lost = distance(off).max(axis=0)
    assert lost[0] < {"straight": 1e-3, "random": 0.08}.get(name, 0.04)
    assert np.all(lost <= lost[0] + 2e-3)  # nobody behind is worse off than the front axle
    beside = relative_pose(world.poses[1:], world.poses[:-1]) - relative_pose(
        (true := places_on(path, n, world.time))[1:], true[:-1]
    )
    assert distance(beside).max() < 0.01
    assert np.abs(beside[:, 2]).max() < 0.03


def test_what_the_front_axle_misses_is_slip_and_half_samples():
    """Its wheels turn as the path says, but for up to half a sample where legs meet; stiffer contact mends the rest."""
    path, slip = named_path("arc"), []
    for stiffness in (80.0, 800.0):
        _, _, world = drive(quiet(3, stiffness), path)
        turned = (world.wheel_angles[1] - world.wheel_angles[0]) * RADIUS / (2 * HALF_TRACK)
        assert turned == pytest.approx(math.pi, abs=2 * 0.5 * PERIOD * path.speed * 1.0 + 2e-3)
        slip.append(turned - world.poses[0, 2])
    assert abs(slip[0]) > 0.01
    assert abs(slip[1]) < 0.2 * abs(slip[0])


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("n", [2, 3])
def test_an_axle_pushed_aside_returns_behind_the_one_ahead(n, side):
    """Without sensors it stays aside."""
    kick = (1.0, 1.8, side * 1.5 * np.array([-1.0, 1.0]))
    path, ends = named_path("straight"), {}
    for sensing in (True, False):
        _, bent, _ = drive(quiet(n), path, sensing=sensing, kick=kick)
        ahead = bent[:, -1, 1]  # where the axle ahead stands, to the side
        assert np.abs(ahead).max() > 0.015
        ends[sensing] = abs(ahead[-1])
    assert ends[True] < 2e-3
    assert ends[False] > 4 * ends[True]


def test_noise_and_offsets_of_the_defaults_do_not_take_axles_off_the_path():
    for seed in range(3):
        off, *_ = drive(cfmmr(3), named_path("s-bend"), seed=seed)
        assert distance(off).max() < 0.06


def expected_rates(n, t, path=BEND):
    """Wheel rates of axles that all move at the path's speed and turn with its curvature, in mid-period."""
    middle = t + 0.5 * PERIOD
    speed = min(path.speed, path.acceleration * middle)
    covered = 0.5 * path.acceleration * min(middle, 1.0) ** 2 + path.speed * max(middle - 1.0, 0.0)
    rates = []
    for i in range(n):
        s = covered - LENGTH * i
        turning = speed * (0.0 if s < 0 else 0.8 if s < 1.0 else -0.5)
        rates += [(speed - HALF_TRACK * turning) / RADIUS, (speed + HALF_TRACK * turning) / RADIUS]
    return np.array(rates)


STRAIGHT = np.tile([LENGTH, 0.0, 0.0], (2, 1))
WRONG = np.array([[0.3, 0.1, 0.5], [0.3, -0.1, -0.4]])
TIMES = [0.0, 0.5, 1.0, 3.0, 5.0]


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize(
    ("readings", "ages"),
    [(np.full((2, 3), np.nan), [0.0, 0.0]), (WRONG, [0.2, 0.5]), (np.full((2, 3), np.inf), [0.0, 0.0])],
    ids=["missing", "old", "infinite"],
)
def test_without_sound_readings_commands_are_the_path_s(readings, ages, flat):
    driver = TrainDriver(cfmmr(3), BEND)
    driver.commands(0.0, STRAIGHT, np.zeros(2))
    for t in TIMES:
        commands = driver.commands(t, readings.ravel() if flat else readings, np.array(ages))
        np.testing.assert_allclose(commands, expected_rates(3, t), rtol=1e-9)


def test_one_bad_reading_leaves_the_other_frame_its_correction():
    half = WRONG.copy()
    half[0, 1] = np.nan
    commands = []
    for readings in (half, WRONG):
        driver = TrainDriver(cfmmr(3), BEND)
        driver.commands(0.0, STRAIGHT, np.zeros(2))
        commands.append(driver.commands(3.0, readings, np.zeros(2)))
    expected = expected_rates(3, 3.0)
    np.testing.assert_allclose(commands[0][:4], expected[:4], rtol=1e-9)
    np.testing.assert_array_equal(commands[0][4:], commands[1][4:])
    assert np.all(np.abs(commands[0][4:] - expected[4:]) > 0.01)
    np.testing.assert_allclose(commands[1][:2], expected[:2], rtol=1e-9)  # the front axle follows nobody


@pytest.mark.parametrize("t", [2.0, 4.0])
def test_readings_as_they_should_be_change_nothing(t):
    places = places_on(BEND, 3, t)
    driver = TrainDriver(cfmmr(3), BEND)
    driver.commands(0.0, STRAIGHT, np.zeros(2))
    commands = driver.commands(t, relative_pose(places[1:], places[:-1]), np.zeros(2))
    np.testing.assert_allclose(commands, expected_rates(3, t), atol=5e-4)


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        ([0.0, 0.02, 0.0], "axle ahead to the left: turn left"),
        ([0.0, 0.0, 0.1], "axle ahead turned left: turn left"),
        ([0.03, 0.0, 0.0], "axle ahead too far: faster"),
    ],
)
def test_an_axle_steers_towards_its_place(change, seen):
    path = named_path("straight")
    differences = []
    for sign in (1, -1):
        driver = TrainDriver(cfmmr(2), path)
        driver.commands(0.0, STRAIGHT[:1], np.zeros(1))
        left, right = driver.commands(3.0, STRAIGHT[:1] + sign * np.array([change]), np.zeros(1))[2:]
        differences.append([right - left, left + right - 2 * path.speed / RADIUS])
    turn, faster = np.array(differences).T
    if "faster" in seen:
        assert faster[0] > 0.1 > -0.1 > faster[1]
        np.testing.assert_allclose(turn, 0.0, atol=1e-9)
    else:
        assert turn[0] > 0.1 > -0.1 > turn[1]


def test_at_rest_nothing_moves_whatever_the_sensors_say():
    """Before the start and after the end: a nonholonomic axle cannot step aside."""
    driver = TrainDriver(cfmmr(3), BEND)
    driver.commands(0.0, STRAIGHT, np.zeros(2))
    np.testing.assert_allclose(driver.commands(BEND.duration + 1.0, WRONG, np.zeros(2)), 0.0, atol=1e-12)


def test_a_constant_error_of_the_sensors_is_taken_for_their_zero():
    """The train starts straight: what is read then stands for straight."""
    off = np.array([[0.005, 0.02, 0.06], [-0.002, -0.015, -0.03]])
    sound, shifted = TrainDriver(cfmmr(3), BEND), TrainDriver(cfmmr(3), BEND)
    for t in (0.0, 1.0, 3.0):
        places = places_on(BEND, 3, t)
        seen = relative_pose(places[1:], places[:-1]) + (t > 0) * np.array([0.0, 0.01, 0.02])
        commands = sound.commands(t, seen, np.zeros(2))
        np.testing.assert_allclose(shifted.commands(t, seen + off, np.zeros(2)), commands, atol=1e-9)


@pytest.mark.parametrize("name", ["asoc-prototype", "swerve", "tricycle", "omni3", "differential"])
def test_what_a_trajectory_asks_of_wheels_is_what_the_controller_commands_on_it(name):
    """Rolling sample by sample without slip, castors where they trail to; long straights are not gone through."""
    robot = preset(name)
    course = chained("there", (umbmark(side=3.0), figure_eight()))
    controller, geometry = KinematicController(robot), Geometry.of(robot)
    wheels, twists = controller.rolled(course)
    theta = trailing_angles(geometry, course.runs[0].legs[0].motion)
    for wheel, twist in zip(wheels, twists, strict=True):
        commands = controller.commands(theta, twist)
        np.testing.assert_allclose(wheel, commands.wheel, atol=1e-9)
        theta = theta + robot.sample_period * controller._middle(theta, twist)[1]


def test_longer_straights_take_no_more_looks():
    looks = []

    class Counting(KinematicController):
        def _middle(self, theta, twist):
            looks[-1] += 1
            return super()._middle(theta, twist)

    for side in (10.0, 1000.0):
        looks.append(0)
        wheels, _ = Counting(preset("asoc-prototype")).rolled(umbmark(side=side))
    assert len(wheels) > 300_000 > 10 * looks[1]
    assert looks[1] < 1.1 * looks[0]
