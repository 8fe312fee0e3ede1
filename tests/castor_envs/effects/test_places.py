# pyright: reportArgumentType=false
"""Effects at places, of loads, of the reference's point and in bursts: closed forms, and physics beside prediction."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.effects.catalogue import catalogue, floor_of, radii_of, readings, reference, slip_of
from castor_envs.effects.clocks import ClockOffset
from castor_envs.effects.dimensions import LoadRadius, PivotBias
from castor_envs.effects.encoders import TickLossBursts
from castor_envs.effects.floor import Bump, FloorSlope, FrictionPatch
from castor_envs.effects.reference import ReferenceLeverX, ReferenceLeverY, ReferenceYaw
from castor_envs.envs.sensed import SensedRobot
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch, cable_extra_roll
from castor_envs.geometry.se2 import compose
from castor_envs.geometry.steps import Motion
from castor_envs.physics.contact_motion import ContactMotion, contact_paths
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import preset, preset_names

ASOC, DIFFERENTIAL = preset("asoc-prototype"), preset("differential")
G = 9.80665


def rolling(robot, way, heading=0.0, lateral=0.0):
    """Return the motion of a robot whose origin goes `way` (K,) along a straight line, castors straight ahead."""
    pose = np.column_stack([way, np.full(len(way), lateral), np.zeros(len(way))])
    pose = compose([0.0, 0.0, heading], pose)
    radius = np.array([wheel.radius for wheel in robot.wheels])
    return Motion(0.05 * np.arange(len(way)), pose, way[:, None] / radius, np.zeros((len(way), len(robot.castors))))


@pytest.mark.parametrize("diameter", [0.004, 0.01, 0.02])
@pytest.mark.parametrize("back", [False, True])
def test_a_crossing_costs_the_extra_roll_of_a_cable(diameter, back):
    """Each wheel once: forward it rolls so much more than its contact moves, backward so much less."""
    way = np.linspace(-0.5, 0.7, 120)
    motion = rolling(ASOC, way[::-1] if back else way)
    robot = ASOC.with_effects(Bump(x=0.05, y=0.0, direction=math.pi / 2, value=diameter))
    slip = slip_of(ContactMotion(robot, motion))
    extra = cable_extra_roll(0.0381, diameter) * (-1.0 if back else 1.0)
    np.testing.assert_allclose(slip.rolling.sum(axis=0), -extra, rtol=0.01)
    np.testing.assert_array_equal(slip.side, 0.0)
    # Only there: the wheels stand on it within sqrt(2 r d) of its axis.
    for wheel, at in enumerate((0.168, 0.168, -0.192, -0.192, -0.192, -0.192)):
        middle = (motion.pose[1:, 0] + motion.pose[:-1, 0]) / 2 + at
        away = np.abs(middle - 0.05) > math.sqrt(2 * 0.0381 * diameter) + 0.0101
        np.testing.assert_array_equal(slip.rolling[away, wheel], 0.0)


@pytest.mark.parametrize("direction", [math.pi / 2, 1.0, 2.2])
def test_wheels_in_physics_roll_over_a_bump_as_predicted(direction):
    """Only the left wheel crosses; over the whole crossing path less rolling is what is reported."""
    robot = dataclasses.replace(DIFFERENTIAL, sample_period=0.01, max_wheel_torque=30.0)
    robot = robot.with_effects(Bump(x=0.4, y=0.17, direction=direction, length=0.2, value=0.01))
    world = RobotWorld(robot, Floor(climbing=False), twist=(0.25, 0.0, 0.0))
    rows = [(0.0, world.pose, world.wheel_angles, world.castor_angles)]
    for _ in range(300):
        world.advance([0.25 / 0.075] * 2)
        rows.append((world.time, world.pose, world.wheel_angles, world.castor_angles))
    motion = Motion(*(np.array(column) for column in zip(*rows, strict=True)))
    assert motion.pose[-1, 0] > 0.6
    truly = contact_paths(robot, motion)[:, :2].sum(axis=0) - 0.075 * motion.wheel_angle[-1]
    told = slip_of(ContactMotion(robot, motion)).rolling.sum(axis=0)
    assert told[0] == pytest.approx(truly[0], rel=0.01)
    assert told[1] == 0.0
    assert truly[1] == pytest.approx(0.0, abs=0.01 * abs(truly[0]))


def test_floor_effects_build_the_floor_that_they_say():
    robot = ASOC.with_effects(
        FloorSlope(direction="x", value=0.02),
        FloorSlope(direction="y", value=-0.01),
        Bump(x=0.1, y=0.2, direction=0.3, length=2.0, value=0.008),
        FrictionPatch(x=1.0, y=2.0, length=0.5, width=0.4, angle=0.6, value=0.75),
    )
    laid = Cable(center=(9.0, 9.0), direction=0.0, length=1.0, diameter=0.01)
    floor = Floor(cables=(laid,), slope=(0.01, 0.0), climbing=False)
    cable = Cable(center=(0.1, 0.2), direction=0.3, length=2.0, diameter=0.008)
    patch = Patch(center=(1.0, 2.0), size=(0.5, 0.4), angle=0.6, friction=0.25, relative=True)
    expected = Floor(cables=(laid, cable), patches=(patch,), slope=(0.03, -0.01), climbing=False)
    assert floor_of(robot, floor) == expected
    assert RobotWorld(robot, floor).floor == expected
    sensed = SensedRobot(robot, floor)
    assert sensed.world.floor == expected
    sensed.reset(np.random.default_rng(0), np.zeros(3))
    assert sensed.world.floor == expected
    with pytest.raises(InputError, match="too thick"):
        RobotWorld(ASOC.with_effects(Bump(x=0.0, y=0.0, direction=0.0, value=0.05)))


@pytest.mark.parametrize("stepper", ["compiled", "reference"])
@pytest.mark.parametrize("below", [(), (0.04,), (0.04, 1.5)])
def test_a_slippery_place_has_its_part_of_the_friction_that_it_lies_on(below, stepper):
    """On wet soap a place with half the friction is twice as slippery, not ten times as rough."""
    wide = {"center": (0.0, 0.0), "size": (100.0, 100.0)}
    floor = Floor(patches=tuple(Patch(**wide, friction=friction) for friction in below))
    effects = [FrictionPatch(x=0.0, y=0.0, length=2.0, width=2.0, value=value) for value in (0.5, 0.2)]
    for x, share in ((0.0, 0.4), (5.0, 1.0)):
        worlds = [
            RobotWorld(vehicle, floor, pose=(x, 0, 0), stepper=stepper)
            for vehicle in (ASOC, ASOC.with_effects(*effects))
        ]
        for world in worlds:
            world.advance(np.zeros(6))
        plain, worn = (world.wheels["limit"] for world in worlds)
        np.testing.assert_allclose(plain, (below[-1] if below else ASOC.contact.friction) * worlds[0].wheels["load"])
        np.testing.assert_allclose(worn, share * plain)


def test_slippery_floors_are_read_and_written_with_what_they_lie_on():
    patches = [Patch(center=(0.0, 1.0), size=(1.0, 1.0), friction=0.5, relative=relative) for relative in (False, True)]
    floor = Floor(patches=tuple(patches))
    written = floor.to_dict()
    assert [("relative" in patch) for patch in written["patches"]] == [False, True]
    assert Floor.from_dict(written) == floor


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_patch_is_where_physics_has_less_friction(angle):
    """The places that the prediction marks are those at which contacts have a tenth of their friction."""
    robot = dataclasses.replace(ASOC, sample_period=0.01)
    effect = FrictionPatch(x=0.25, y=0.1, length=0.3, width=0.2, angle=angle, value=0.9)
    world = RobotWorld(robot.with_effects(effect), twist=(0.3, 0.0, 0.0))
    rows, slippery = [(0.0, world.pose, world.wheel_angles, world.castor_angles)], []
    for _ in range(200):
        world.advance(np.full(6, 0.3 / 0.0381))
        rows.append((world.time, world.pose, world.wheel_angles, world.castor_angles))
        slippery.append(world.wheels["limit"] < 0.5 * world.wheels["load"])
    motion = Motion(*(np.array(column) for column in zip(*rows, strict=True)))
    inside, slippery = effect.inside(ContactMotion(robot, motion)), np.array(slippery)
    assert np.any(inside)
    assert not np.all(inside.any(axis=0))
    changes = np.diff(slippery.astype(int), axis=0, prepend=0) != 0
    np.testing.assert_array_equal(inside[~changes], slippery[~changes])
    slip = slip_of(ContactMotion(robot.with_effects(effect), motion)).rolling
    np.testing.assert_array_equal(slip != 0, inside)
    np.testing.assert_allclose(slip[inside], -0.9 * np.diff(motion.pose[:, 0]).mean(), rtol=0.02)


def test_wheels_slide_in_a_patch_and_nowhere_else():
    """Starting hard from a patch all wheels spin; beyond it they roll."""
    robot = dataclasses.replace(ASOC, sample_period=0.01)
    effect = FrictionPatch(x=0.0, y=0.0, length=1.2, width=2.0, value=0.97)
    worlds = [RobotWorld(vehicle) for vehicle in (robot.with_effects(effect), robot)]
    slid = []
    for world in worlds:
        angle, path = world.wheel_angles, world.pose[0]
        lost = []
        for _ in range(400):
            world.advance(np.full(6, 0.4 / 0.0381))
            angles, way = world.wheel_angles, world.pose[0]
            lost.append((way, np.mean(0.0381 * (angles - angle)) - (way - path)))
            angle, path = angles, way
        slid.append(np.array(lost))
    within = slid[0][:, 0] < 0.3  # the front wheels leave it at 0.43
    assert slid[0][within, 1].sum() > 0.02
    out = slid[0][:, 0] > 0.85
    assert np.abs(slid[0][out, 1]).sum() < 1e-4
    assert slid[1][:, 1].sum() < 2e-3


def test_radii_shrink_with_the_load_that_stands_on_them():
    """A chassis of 18 kg at a third of the way to the front pivot, 1.5 kg castors: levers by hand."""
    robot = dataclasses.replace(ASOC, center_of_mass=(0.08, 0.0))
    built = robot.with_effects(LoadRadius(value=2e-5)).as_built()
    front = 18.0 * (0.08 + 0.12) / 0.36
    loads = [G / 2 * (part + 1.5) for part in (front, (18.0 - front) / 2, (18.0 - front) / 2)]
    for wheel, castor in zip(built.wheels, built.wheel_castors, strict=True):
        assert wheel.radius == pytest.approx(0.0381 - 2e-5 * (loads[castor] - 22.5 * G / 6))
    assert [effect.value for effect in catalogue(robot) if effect.name == "load_radius"] == [LoadRadius.step]
    assert "load_radius" in {effect.name for effect in catalogue(ASOC)}
    assert "load_radius" not in {effect.name for effect in catalogue(DIFFERENTIAL)}
    tipped = dataclasses.replace(ASOC, center_of_mass=(0.5, 0.0))
    assert "load_radius" not in {effect.name for effect in catalogue(tipped)}


def test_soft_tyres_roll_less_where_the_castors_put_the_weight():
    """Straight on, all castors trail backward: levers by hand say what stands on the front wheels and on the others."""
    soft = 5e-5
    world = RobotWorld(dataclasses.replace(ASOC, sample_period=0.01).with_effects(LoadRadius(value=soft)))
    front = 18.0 * (0.12 + 0.072) / 0.36
    loads = [G / 2 * (part + 1.5) for part in (front, (18.0 - front) / 2, (18.0 - front) / 2)]
    for _ in range(300):
        world.advance(np.full(6, 8.0))
    before, path = world.wheel_angles, world.pose[0]
    for _ in range(100):
        world.advance(np.full(6, 8.0))
    turned = world.wheel_angles - before
    rolled = (0.0381 - soft * (np.repeat(loads, 2) - 22.5 * G / 6)) * turned
    assert np.ptp(rolled) > 0.01 * np.mean(rolled)
    slip = (world.pose[0] - path) / rolled - 1  # wheels that turn alike on unlike radii creep until forces balance
    assert np.mean(slip) == pytest.approx(0.0, abs=2e-4)
    assert np.max(np.abs(slip)) < np.ptp(rolled) / np.mean(rolled)


POSE = np.column_stack([np.sin(np.arange(40) / 7), np.arange(40) / 30, np.arange(40) / 9 - 1])
T = 0.05 * np.arange(40)


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), yaw=st.floats(-3, 3))
def test_the_reference_shows_another_point_and_other_axes(x, y, yaw):
    robot = ASOC.with_effects(ReferenceLeverX(value=x), ReferenceLeverY(value=y), ReferenceYaw(value=yaw))
    np.testing.assert_allclose(reference(robot, T, POSE), compose(POSE, [x, y, yaw]), atol=1e-12)
    turned = ASOC.with_effects(ReferenceYaw(value=yaw), ReferenceLeverX(value=x))
    np.testing.assert_allclose(reference(turned, T, POSE), compose(compose(POSE, [0, 0, yaw]), [x, 0, 0]), atol=1e-12)


def test_a_lever_goes_with_a_clock():
    lever, clock = ReferenceLeverX(value=0.3), ClockOffset(value=0.1)
    lever_first, clock_first = (
        reference(ASOC.with_effects(*order), T, POSE) for order in ((lever, clock), (clock, lever))
    )
    np.testing.assert_array_equal(lever_first, clock_first)
    np.testing.assert_allclose(lever_first[:-2], compose(POSE, [0.3, 0, 0])[2:], atol=1e-12)
    assert np.all(np.isnan(lever_first[-1]))


def changed_pivots(move):
    castors = tuple(dataclasses.replace(castor, pivot=tuple(move(np.array(castor.pivot)))) for castor in ASOC.castors)
    return dataclasses.replace(ASOC, castors=castors)


def test_a_lever_arm_is_all_pivots_shifted_the_other_way():
    """What is tracked moves alike: the wheels of a robot with shifted pivots roll as those of one with a lever."""
    castor = np.column_stack([np.sin(T), np.cos(3 * T), T])
    levers = ReferenceLeverX(value=0.02), ReferenceLeverY(value=-0.03)
    body = Motion(T, POSE, np.zeros((40, 6)), castor)
    tracked = dataclasses.replace(body, pose=reference(ASOC.with_effects(*levers), T, POSE))
    shifted = changed_pivots(lambda pivot: pivot - [0.02, -0.03])
    # A step's chord is taken for an arc: both differ by third order of a step's turn, 1e-4 of it here.
    np.testing.assert_allclose(contact_paths(shifted, tracked), contact_paths(ASOC, body), atol=2e-4)
    assert np.max(np.abs(contact_paths(ASOC, tracked) - contact_paths(ASOC, body))) > 2e-3


def test_turned_axes_are_biases_of_all_pivots_and_pivots_turned():
    yaw, castor = 0.3, np.column_stack([np.sin(T), np.cos(3 * T), T])
    body = Motion(T, POSE, np.zeros((40, 6)), castor)
    tracked = dataclasses.replace(body, pose=reference(ASOC.with_effects(ReferenceYaw(value=yaw)), T, POSE))
    biased = dataclasses.replace(tracked, castor_angle=castor - yaw)
    c, s = math.cos(yaw), math.sin(yaw)
    turned = changed_pivots(lambda pivot: np.array([[c, s], [-s, c]]) @ pivot)
    np.testing.assert_allclose(contact_paths(turned, biased), contact_paths(ASOC, body), atol=1e-12)
    # A robot whose pivots all read `yaw` too much is believed to stand so.
    read = ASOC.with_effects(*(PivotBias(castor=i, value=yaw) for i in (1, 2, 3))).as_built()
    assert [castor.pivot_zero for castor in read.castors] == pytest.approx([yaw] * 3)


def seen(effect, t, angle):
    """Return what the encoder of the first castor's first wheel sees of a motion (K,) of all wheels."""
    wheels = np.tile(angle[:, None], 6)
    return readings(ASOC.with_effects(effect), t, wheels, np.zeros((len(t), 3)))


@given(
    period=st.floats(0.3, 3.0),
    share=st.floats(0.05, 0.95),
    start=st.floats(0.0, 2.0),
    speed=st.floats(-20, 20),
    value=st.floats(0.0, 1.0),
)
def test_bursts_lose_their_share_of_the_time_they_last(period, share, start, speed, value):
    t = 0.05 * np.arange(200)
    effect = TickLossBursts(castor=1, wheel=1, value=value, period=period, width=share * period, start=start)
    wheel, _ = seen(effect, t, speed * t)
    since = np.maximum(t - start, 0.0)
    lasted = share * period * (since // period) + np.minimum(since % period, share * period)
    np.testing.assert_allclose(speed * t - wheel[:, 0], value * speed * lasted, atol=1e-9)
    np.testing.assert_array_equal(wheel[:, 1], speed * t)


def test_drawn_bursts_come_as_often_as_they_say_and_anew_with_every_seed():
    t = 0.05 * np.arange(40_000)
    lost = []
    for seed in (1, 2, 1):
        effect = TickLossBursts(castor=1, wheel=1, value=1.0, period=1.0, width=0.01, seed=seed)
        lost.append(t - seen(effect, t, t)[0][:, 0])
    # 2000 bursts of 10 ms; one is cut short where the next comes within 10 ms, once in 200. Distances: 1 +- 0.58 s.
    assert lost[0][-1] == pytest.approx(20.0, rel=0.05)
    np.testing.assert_array_equal(lost[0], lost[2])
    assert np.max(np.abs(lost[0] - lost[1])) > 0.05


@pytest.mark.parametrize("seed", [None, 3])
def test_bursts_of_a_log_that_begins_late_are_those_of_one_from_the_start(seed):
    """A million bursts before the first row cost no more than their begins."""
    effect = TickLossBursts(castor=1, wheel=1, value=0.5, period=0.25, width=0.1, seed=seed)
    began = 25.0 if seed else 250_000.0
    t = began + 0.05 * np.arange(200)
    late = t - seen(effect, t, t)[0][:, 0]
    if seed is None:
        early = t - began - seen(effect, t - began, t - began)[0][:, 0]
    else:
        whole = 0.05 * np.arange(700)
        early = (whole - seen(effect, whole, whole)[0][:, 0])[500:]
        early = early - early[0]
    np.testing.assert_allclose(late, early, atol=1e-7)
    assert late[-1] > 1.0


@pytest.mark.parametrize("name", preset_names())
def test_soft_tyres_leave_the_mean_radius_of_wheels_with_encoders(name):
    """By the others nothing is counted: they may be loaded more or less, as a tricycle's driven wheel is."""
    robot = preset(name)
    if name == "tricycle":
        robot = dataclasses.replace(robot, center_of_mass=(0.5 * robot.castors[0].pivot[0], 0.0))
    built = robot.with_effects(LoadRadius(value=1e-6)).as_built()
    change = np.array([wheel.radius for wheel in built.wheels]) - [wheel.radius for wheel in robot.wheels]
    assert np.mean(change[list(robot.driven_wheels)]) == pytest.approx(0.0, abs=1e-12)
    if len(robot.driven_wheels) < len(robot.wheels) and name == "tricycle":
        assert abs(np.mean(change)) > 1e-6


def test_radii_in_a_sample_are_those_of_its_middle():
    """Castors that a motor turns all the way shift the loads as they do: half a sample early would show."""
    robot = preset("powered-caster").with_effects(LoadRadius(value=2e-5))
    world, radii, before = RobotWorld(robot), radii_of(robot), np.zeros(len(robot.castors))
    assert radii is not None
    for _ in range(20):
        before = world.castor_angles
        world.advance(np.full(len(robot.driven_wheels), 2.0), np.full(len(robot.driven_castors), 4.0))
    after = world.castor_angles
    begin, middle, end = radii(np.stack([before, (before + after) / 2, after]))
    assert np.max(np.abs(world.wheels["radius"] - middle)) < 0.02 * np.max(np.abs(begin - end))
