"""Swerve odometries that others run: exact where theory says so, equal to others where algebra says so."""

import dataclasses
import sys

import numpy as np
import pytest

from castor_envs.errors import Declined
from castor_envs.vehicles.presets import differential, n_castor, omnimate, preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from estimators import HolmbergKhatib, TidyBot, builtin_names, load_estimator
from estimators.peers.modules import rigid_motion
from estimators.plugins.conformance.check import check

ALL = ("module-mean", "skid-ratio", "wpilib-swerve", "wpilib-swerve-midpoint")
ARCS = ALL[1:]
TWISTS = [(0.3, 0.0, 0.0), (0.3, -0.2, 0.8), (0.0, 0.25, -1.0), (-0.4, 0.1, 0.5)]


@pytest.fixture(name="made")
def _made():
    """Make a peer by its name; skips those of WPILib where its wheel is not installed."""

    def made(name):
        if name.startswith("wpilib"):
            pytest.importorskip("wpimath")
        return load_estimator(name).factory()

    return made


def steady(robot, twist):
    """Return the angles of castors that have long trailed at a constant twist: their sideways speed is omega offset."""
    angles = []
    for castor in robot.castors:
        u = complex(twist[0], twist[1]) + 1j * twist[2] * complex(*castor.pivot)
        angles.append(np.angle(u) - np.arcsin(twist[2] * castor.offset / abs(u)))
    return angles


def with_gyro(observations, rate):
    """Return observations with a gyro that reads `rate` (K,), rad/s."""
    return [{**seen, "gyro": np.array([w])} for seen, w in zip(observations, rate, strict=True)]


def positions(poses):
    return poses[:, 0] + 1j * poses[:, 1]


@pytest.mark.parametrize("name", ARCS)
@pytest.mark.parametrize("twist", TWISTS)
@pytest.mark.parametrize("split", [False, True], ids=["swerve", "split"])
def test_lines_and_circles_at_constant_speed_are_followed_exactly(
    name, twist, split, made, odd_robot, exact_motion, drive
):
    """All modules then keep their angles against the body, and paths are arcs: half a radian of turn a sample."""
    robot = odd_robot(3) if split else preset("swerve")
    motion = exact_motion(robot, lambda t: twist, 5.0, theta=steady(robot, twist), pose=(1.0, 1.0, 1.0))
    true, observations = motion.sampled(10)
    np.testing.assert_allclose(drive(made(name), robot, observations, true[0]), true, atol=1e-9)


def test_the_mean_of_modules_steps_along_tangents(exact_motion, drive):
    """On a circle each step is as long as the arc, along the heading before it; the heading itself is exact."""
    robot, v, omega = preset("swerve"), 0.3 - 0.2j, 0.8
    twist = (v.real, v.imag, omega)
    motion = exact_motion(robot, lambda t: twist, 5.0, theta=steady(robot, twist), pose=(1.0, 1.0, 1.0))
    true, observations = motion.sampled(10)
    path = drive(load_estimator("module-mean").factory(), robot, observations, true[0])
    np.testing.assert_allclose(path[:, 2], true[:, 2], atol=1e-9)
    steps = 0.5 * v * np.exp(1j * true[:-1, 2])
    np.testing.assert_allclose(np.diff(positions(path)), steps, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "order"), [("module-mean", 1), ("skid-ratio", 2), ("wpilib-swerve", 1), ("wpilib-swerve-midpoint", 2)]
)
@pytest.mark.parametrize("split", [False, True], ids=["swerve", "split"])
def test_order(name, order, split, made, odd_robot, exact_motion, winding, drive):
    def askew(t):
        return 0.5 + 0.1 * np.sin(0.7 * t), 0.2 * np.cos(0.9 * t), 0.3 * np.sin(1.1 * t + 0.4)

    robot = odd_robot(3) if split else preset("swerve")
    motion, errors = exact_motion(robot, winding if split else askew, 4.0, pose=(1.0, -2.0, 0.5)), []
    for steps in (200, 400, 800):
        true, observations = motion.sampled(steps)
        errors.append(np.hypot(*(drive(made(name), robot, observations, true[0])[-1] - true[-1])[:2]))
    assert errors[-1] < 0.01
    assert np.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize("gyro", [False, True])
def test_wpilib_is_a_pseudo_inverse_and_a_pose_exponential(gyro, made, noise, drive):
    """Written once more with complex numbers: least squares of v + i omega p = v_i, then (e^(i d) - 1) / (i d)."""
    robot = preset("swerve")
    observations = noise(robot, counts=300)
    rate = np.random.default_rng(1).normal(size=len(observations)) if gyro else None
    pivot = np.array([complex(*castor.pivot) for castor in robot.castors])
    rows = np.array([row for p in pivot for row in ([1, 0, -p.imag], [0, 1, p.real])])
    pose, expected, turned = 1.0 - 2.0j, [], 0.0
    for k, seen in enumerate(observations):
        angle = seen["pivot"] * 2 * np.pi / 4096
        module = seen["wheel"] * 2 * np.pi * 0.0508 / 4096 * np.exp(1j * angle)
        x, y, turn = np.linalg.lstsq(rows, module.view(float), rcond=None)[0]
        if rate is not None:
            turn = 0.0 if k == 0 else 0.05 * (rate[k] + rate[k - 1]) / 2
        pose += np.exp(1j * (0.5 + turned)) * (x + 1j * y) * ((np.exp(1j * turn) - 1) / (1j * turn) if turn else 1)
        turned += turn
        expected.append((pose.real, pose.imag, 0.5 + turned))
    seen = observations if rate is None else with_gyro(observations, rate)
    path = drive(made("wpilib-swerve"), robot, seen, (1.0, -2.0, 0.5))
    np.testing.assert_allclose(path, expected, atol=1e-9)


@pytest.mark.parametrize(("name", "same"), [("wpilib-swerve", TidyBot()), ("wpilib-swerve-midpoint", HolmbergKhatib())])
def test_wpilib_is_equal_weights_with_arcs(name, same, made, noise, drive):
    """Of a wheel under its pivot, rolling and no side slip are the two components of the module's velocity: WPILib's
    least squares are Holmberg and Khatib's. Its steps are chords of arcs, theirs as long as the arcs."""
    robot = preset("swerve")
    observations = noise(robot, counts=100)
    a, b = drive(made(name), robot, observations), drive(same, robot, observations)
    np.testing.assert_allclose(a[:, 2], b[:, 2], atol=1e-12)
    turn = np.diff(b[:, 2])
    chord = np.sin(turn / 2) / (turn / 2)
    np.testing.assert_allclose(np.diff(positions(a)), chord * np.diff(positions(b)), atol=1e-9)


def test_the_mean_of_centred_modules_is_least_squares(noise, drive):
    """So it turns as TidyBot's odometry does, and steps as far, but along the heading before."""
    robot = preset("swerve")
    observations = noise(robot, counts=100)
    a, b = (drive(e, robot, observations) for e in (load_estimator("module-mean").factory(), TidyBot()))
    np.testing.assert_allclose(a[:, 2], b[:, 2], atol=1e-12)
    half_back = np.exp(-0.5j * np.diff(b[:, 2]))
    np.testing.assert_allclose(np.diff(positions(a)), half_back * np.diff(positions(b)), atol=1e-12)


def test_rigid_motions_are_found_and_weights_of_zero_leave_out():
    random = np.random.default_rng(3)
    pivot, t, turn = random.normal(size=(5, 2)), np.array([0.3, -0.1]), 0.2
    path = t + turn * np.stack([-pivot[:, 1], pivot[:, 0]], axis=-1)
    path[1] += 7.0
    found, turned = rigid_motion(pivot, path, np.array([1.0, 0.0, 2.0, 1.0, 0.5]))
    np.testing.assert_allclose([*found, turned], [*t, turn], atol=1e-12)


@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("wheel", [0, 2])
def test_a_wheel_that_spins_is_dropped(gyro, wheel, exact_motion, drive):
    """One wheel turns half as fast again for a while: the others are followed exactly, heading and all."""
    robot, twist = preset("swerve"), (0.5, 0.1, 0.2)
    motion = exact_motion(robot, lambda t: twist, 4.0, theta=steady(robot, twist))
    true, observations = motion.sampled(80)
    spun = [dict(seen) for seen in observations]
    for seen in spun[20:50]:
        seen["wheel"] = seen["wheel"] * np.where(np.arange(4) == wheel, 1.5, 1.0)
    if gyro:
        spun = with_gyro(spun, np.full(len(spun), twist[2]))
    np.testing.assert_allclose(drive(load_estimator("skid-ratio").factory(), robot, spun), true, atol=1e-9)
    assert np.abs(drive(HolmbergKhatib(), robot, spun) - true).max() > 0.05


def test_nothing_is_dropped_at_rest_or_while_turning_on_the_spot(exact_motion, drive):
    robot = preset("swerve")
    motion = exact_motion(robot, lambda t: (0.0, 0.0, 0.5), 4.0, theta=steady(robot, (0.0, 0.0, 0.5)))
    true, observations = motion.sampled(80)
    shaken = [{**seen, "wheel": seen["wheel"] + np.array([1.0, 0.0, 0.0, -1.0])} for seen in observations]
    path = drive(load_estimator("skid-ratio").factory(), robot, shaken)
    np.testing.assert_allclose(path, drive(HolmbergKhatib(), robot, shaken), atol=1e-3)
    np.testing.assert_allclose(drive(load_estimator("skid-ratio").factory(), robot, observations), true, atol=1e-9)


@pytest.mark.parametrize("name", ALL)
def test_a_mirrored_robot_goes_the_mirrored_path(name, made, odd_robot, noise, drive):
    robot, castors = odd_robot(3), []
    for castor in robot.castors:
        wheels = tuple(dataclasses.replace(wheel, lateral=-wheel.lateral) for wheel in reversed(castor.wheels))
        pivot = (castor.pivot[0], -castor.pivot[1])
        castors.append(dataclasses.replace(castor, pivot=pivot, wheels=wheels, pivot_zero=-castor.pivot_zero))
    mirror_robot = dataclasses.replace(robot, castors=tuple(castors))
    observations = noise(robot, counts=100)
    swapped = [{**seen, "wheel": seen["wheel"][[1, 0, 3, 2, 5, 4]], "pivot": -seen["pivot"]} for seen in observations]
    path = drive(made(name), robot, observations, (1.0, 2.0, 0.3))
    mirror = drive(made(name), mirror_robot, swapped, (1.0, -2.0, -0.3))
    np.testing.assert_allclose(mirror, path * [1.0, -1.0, -1.0], atol=1e-9)


@pytest.mark.parametrize("robot", ["swerve", "asoc-prototype", "2-castor"])
@pytest.mark.parametrize("name", ALL)
def test_conforms(name, robot, made):
    made(name)
    findings = check(load_estimator(name), preset(robot))
    assert [finding for finding in findings if not finding.passed] == []


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (differential(), "at least two swerve modules; the robot has 1"),
        (preset("tricycle"), "wheels all have encoders"),
        (preset("powered-caster"), "one wheel under the pivot.*tidybot"),
        (preset("omni3"), "no rollers"),
        (dataclasses.replace(omnimate(), castors=(omnimate().castors[0],) * 2), "stand apart"),
    ],
)
def test_robots_that_are_no_swerves_are_declined(name, robot, message):
    with pytest.raises(Declined, match=message):
        load_estimator(name).factory().reset(robot, np.zeros(3))


def test_castors_without_encoders_are_declined():
    castor = dataclasses.replace(n_castor(2).castors[0], pivot_counts_per_rev=None)
    robot = dataclasses.replace(n_castor(2), castors=(castor, n_castor(2).castors[1]))
    with pytest.raises(Declined, match="pivot encoders"):
        load_estimator("skid-ratio").factory().reset(robot, np.zeros(3))


def test_the_mean_declines_modules_that_are_not_centred(odd_robot):
    with pytest.raises(Declined, match="centre is the body's origin"):
        load_estimator("module-mean").factory().reset(odd_robot(3, centred=False), np.zeros(3))


def test_wpilib_declines_numbers_of_modules_that_it_has_no_class_for(made):
    with pytest.raises(Declined, match="2, 3, 4 or 6; the robot has 5"):
        made("wpilib-swerve").reset(n_castor(5), np.zeros(3))


def test_without_its_wheel_wpilib_declines_and_breaks_nothing(monkeypatch):
    for name in ("wpimath", "wpimath.geometry", "wpimath.kinematics"):
        monkeypatch.setitem(sys.modules, name, None)
    assert not [name for name in builtin_names(preset("swerve")) if name.startswith("wpilib")]
    entry = load_estimator("wpilib-swerve")
    reason = entry.applicable(preset("swerve"))
    assert reason is not None
    assert "pip install robotpy-wpimath" in reason


def test_fixed_and_single_wheels_mix(exact_motion, drive):
    """A fixed pair and a steered wheel, a tricycle whose rear wheels have encoders, is two modules."""
    wheels = tuple(Wheel(lateral=side, radius=0.05, counts_per_rev=1000.0) for side in (0.15, -0.15))
    rear = Castor(pivot=(-0.2, 0.0), steering="fixed", wheels=wheels)
    front = Castor(
        pivot=(0.3, 0.0),
        steering="driven",
        pivot_counts_per_rev=4096,
        wheels=(Wheel(radius=0.05, counts_per_rev=1000.0),),
    )
    robot = RobotDescription(name="tricycle with encoders", castors=(rear, front))
    v, omega = 0.4, 0.5
    motion = exact_motion(robot, lambda t: (v, 0.2 * omega, omega), 3.0, theta=[0.0, np.arctan2(0.5 * omega, v)])
    true, observations = motion.sampled(6)
    np.testing.assert_allclose(drive(load_estimator("skid-ratio").factory(), robot, observations), true, atol=1e-9)
