"""Logs from Bullet obey laws of rolling, statics and motors that are written out here, in closed form."""

import dataclasses
import math

import numpy as np
import pytest

pytest.importorskip("pybullet")

from castor_envs.effects.clocks import ClockOffset
from castor_envs.effects.contact import ContactCreep, SlipStiffness
from castor_envs.effects.dimensions import (
    AllWheelRadius,
    LoadRadius,
    PivotBias,
    PivotOffset,
    PivotPositionX,
    PivotPositionY,
    Track,
    WheelRadius,
)
from castor_envs.effects.encoders import PivotGain
from castor_envs.effects.floor import Bump, FloorSlope
from castor_envs.effects.reference import ReferenceLeverX
from castor_envs.errors import InputError
from castor_envs.floor import Floor, Patch
from castor_envs.motion.controllers import trailing_angles
from castor_envs.motion.trajectories import Leg, Trajectory, wander
from castor_envs.motion.trajectories import Run as Drive
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from discrepancy.trials.bullet import outside
from discrepancy.trials.bullet.world import SIMULATOR, drive, simulate
from discrepancy.trials.foreign import run as foreign_run
from discrepancy.trials.foreign.run import Run, read
from discrepancy.trials.generators import generator
from discrepancy.trials.hidden import class_of, outsider
from discrepancy.trials.reading import EXACT

ASOC = preset("asoc-prototype")
DIFFERENTIAL = preset("differential")
SLIP = 2e-5  # m for each m rolled: what rigid contacts may lose to the solver and to the step


def along(*motion: float, length: float = 0.5, speed: float = 0.25) -> Trajectory:
    return Trajectory("leg", (Drive((Leg((motion[0], motion[1], motion[2]), length),), speed, 0.5),))


AHEAD = along(1.0, 0.0, 0.0)
REST = along(1.0, 0.0, 0.0, length=1e-9)


@pytest.fixture(scope="module")
def clean() -> Run:
    return simulate(ASOC, wander(np.random.default_rng(1), duration=6.0), 1, duration=6.0)


def contacts(run: Run, robot: RobotDescription) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far each wheel's contact moves in each sample along the wheel and to its left, and what it rolls; (w, K)."""
    w, every = len(robot.wheels), run.every
    parts = []
    for k, i in enumerate(robot.wheel_castors):
        castor, wheel = robot.castors[i], robot.wheels[k]
        direction = run.pose[:, 2] + run.angle[:, w + i]
        pivot = (castor.pivot[0] + 1j * castor.pivot[1]) * np.exp(1j * run.pose[:, 2])
        place = run.pose[:, 0] + 1j * run.pose[:, 1] + pivot
        place = place + (-castor.offset + 1j * wheel.lateral) * np.exp(1j * direction)
        step = np.diff(place) * np.exp(-0.5j * (direction[1:] + direction[:-1]))
        moves = np.array([step.real, step.imag, wheel.radius * np.diff(run.angle[:, k])])
        parts.append(moves.reshape(3, -1, every).sum(axis=2))
    whole = np.array(parts)
    return whole[:, 0], whole[:, 1], whole[:, 2]


def slip(run: Run, robot: RobotDescription) -> float:
    """The largest sum of slips of a wheel, along or across, in parts of the way that it rolls."""
    moved, aside, rolled = contacts(run, robot)
    way = np.abs(rolled).sum(axis=1)
    return float(max((np.abs(part).sum(axis=1) / way).max() for part in (moved - rolled, aside)))


# Rolling


def test_a_robot_in_good_order_ends_where_its_wheels_rolled():
    run = simulate(DIFFERENTIAL, along(1.0, 0.0, 0.0, length=2.0, speed=0.5), 0, duration=5.5)
    rolled = DIFFERENTIAL.wheels[0].radius * run.angle[-1, :2].mean()
    assert run.pose[-1, 0] == pytest.approx(rolled, rel=SLIP)
    assert rolled == pytest.approx(2.0, rel=0.01)
    assert run.pose[-1, 1:] == pytest.approx([0, 0], abs=1e-4)


def test_a_turn_on_the_spot_is_as_large_as_wheels_and_track_say():
    run = simulate(DIFFERENTIAL, along(0.0, 0.0, 1.0, length=1.0, speed=0.5), 0, duration=3.5)
    left, right = DIFFERENTIAL.wheels
    turned = (right.radius * run.angle[-1, 1] - left.radius * run.angle[-1, 0]) / (left.lateral - right.lateral)
    assert run.pose[-1, 2] == pytest.approx(turned, rel=SLIP)
    assert turned > 0.9


def test_wheels_of_a_clean_run_do_not_slip(clean: Run):
    assert slip(clean, ASOC) < SLIP
    assert np.abs(contacts(clean, ASOC)[2]).sum(axis=1).min() > 0.3


def test_counts_are_those_of_the_path(clean: Run):
    """Way over circumference, in counts: what a wheel's contact covers in plan, computed from poses and castors."""
    log, moved = read(clean, ASOC), contacts(clean, ASOC)[0]
    for k, wheel in enumerate(ASOC.wheels):
        assert wheel.counts_per_rev is not None
        counts = moved[k].cumsum() * wheel.counts_per_rev / (2 * math.pi * wheel.radius)
        assert np.abs(log.wheel[1:, k] - log.wheel[0, k] - counts).max() < 1.2  # two roundings, and slip


ROBOTS = {"asoc-full-scale": SLIP, "2-castor": 1e-4, "5-castor": SLIP, "omnimate": 1e-4, "tricycle": 1e-4}
STEERED = {"swerve": 3e-3, "powered-caster": 3e-3}  # wheels that steering motors set to disagree have to slip


@pytest.mark.parametrize(("name", "most"), (ROBOTS | STEERED).items())
def test_other_robots_roll_too(name: str, most: float):
    robot, seed = preset(name), 2
    motion = wander(np.random.default_rng(seed), duration=2.0, holonomic=name != "tricycle")
    run = simulate(robot, motion, seed, duration=2.0)
    assert slip(run, robot) < most
    assert run.pose[-1] == pytest.approx(motion.at(2.0)[0], abs=0.05)


def test_a_mirrored_motion_makes_the_mirrored_log(monkeypatch: pytest.MonkeyPatch):
    """The prototype's mirror image in the x axis is itself, with castors 2 and 3, and left and right, exchanged."""
    monkeypatch.setattr(foreign_run, "start_angles", lambda body, motion, _: trailing_angles(body, start(motion)))

    def start(motion: Trajectory) -> np.ndarray:
        return np.array(motion.runs[0].legs[0].motion)

    one, other = (simulate(ASOC, along(0.8, way * 0.6, way * 0.7), 0, duration=2.0) for way in (1.0, -1.0))
    assert other.pose * [1, -1, -1] == pytest.approx(one.pose, abs=1e-5)
    assert other.angle[:, [1, 0, 5, 4, 3, 2]] == pytest.approx(one.angle[:, :6], abs=1e-3)
    assert -other.angle[:, [6, 8, 7]] == pytest.approx(one.angle[:, 6:], abs=1e-4)


def test_a_free_castor_trails_as_the_distance_over_its_offset():
    """The tractrix: tan(theta / 2) falls by e in each offset of way."""
    idle = Castor(
        pivot=(0.3, 0.0), offset=0.1, pivot_counts_per_rev=4096, wheels=(Wheel(radius=0.05, counts_per_rev=None),)
    )
    robot = dataclasses.replace(DIFFERENTIAL, castors=(*DIFFERENTIAL.castors, idle))
    run = simulate(robot, AHEAD, 3, duration=2.5)
    theta = run.angle[:, -1]
    law = 2 * np.arctan(math.tan(theta[0] / 2) * np.exp(-run.pose[:, 0] / idle.offset))
    assert abs(theta[0]) > 0.1
    assert np.abs(theta - law).max() < 2e-3 * abs(theta[0])


def test_half_the_step_makes_contacts_slip_less(clean: Run):
    coarser = dataclasses.replace(SIMULATOR, longest=2 * SIMULATOR.longest)
    twice = coarser.simulate(ASOC, wander(np.random.default_rng(1), duration=6.0), 1, duration=6.0)
    assert clean.every > 1.9 * twice.every
    assert slip(clean, ASOC) < 0.7 * slip(twice, ASOC)
    assert np.abs(clean.pose[:: clean.every] - twice.pose[:: twice.every]).max() < 5e-3


# Forces


def test_free_wheels_roll_down_a_slope_as_fast_as_their_inertia_lets_them():
    slope = 0.05
    robot = dataclasses.replace(DIFFERENTIAL, max_wheel_torque=1e-9)
    run = simulate(robot.with_effects(FloorSlope(direction="x", value=slope)), REST, 0, duration=1.0)
    mass = robot.mass + robot.castors[0].mass
    spinning = sum(wheel.inertia / wheel.radius**2 for wheel in robot.wheels)
    fall = Floor(slope=(slope, 0.0)).normal_gravity * slope * mass / (mass + spinning)
    assert run.pose[-1, 0] == pytest.approx(-0.5 * fall * run.t[-1] ** 2, rel=0.01)


def test_motors_push_with_their_torque_at_most():
    torque = 0.2
    robot = dataclasses.replace(DIFFERENTIAL, max_wheel_torque=torque)
    motion = Trajectory("start", (Drive((Leg((1.0, 0.0, 0.0), 2.0),), 1.0, 20.0),))
    run = simulate(robot, motion, 0, duration=1.0)
    spinning = sum(wheel.inertia / wheel.radius**2 for wheel in robot.wheels)
    mass = robot.mass + robot.castors[0].mass + spinning
    rate = 2 * torque / DIFFERENTIAL.wheels[0].radius / mass
    assert run.pose[-1, 0] == pytest.approx(0.5 * rate * run.t[-1] ** 2, rel=0.01)


def test_wheels_slide_on_ice(clean: Run):
    ice = Floor(patches=(Patch(center=(0.0, 0.0), size=(0.8, 0.8), friction=0.001),))
    run = simulate(ASOC, wander(np.random.default_rng(1), duration=6.0), 1, duration=2.0, floor=ice)
    assert slip(run, ASOC) > 100 * SLIP


def test_soft_tyres_roll_less_where_they_carry_more():
    """With its centre of mass to the left, the left wheel's rolling radius is smaller by softness times load."""
    soft, aside = 1e-5, 0.05
    robot = dataclasses.replace(DIFFERENTIAL, center_of_mass=(0.0, aside))
    run = simulate(robot.with_effects(LoadRadius(value=soft)), along(1.0, 0.0, 0.0, length=1.0), 0, duration=3.0)
    moved, _, rolled = contacts(run, robot)
    ratio = moved.sum(axis=1) / rolled.sum(axis=1)
    apart = robot.mass * Floor().normal_gravity * aside / robot.wheels[0].lateral  # of loads, were there no skids
    shrunk = (ratio[1] - ratio[0]) * robot.wheels[0].radius
    assert 0.5 * soft * apart < shrunk < 1.01 * soft * apart


# Effects and reading


@pytest.mark.parametrize(
    "effect",
    [
        WheelRadius(castor=1, wheel=2, value=0.01),
        AllWheelRadius(value=0.02),
        Track(castor=2, value=0.05),
        PivotOffset(castor=3, value=0.005),
        PivotPositionX(castor=1, value=0.01),
        PivotPositionY(castor=2, value=-0.01),
    ],
    ids=lambda effect: effect.name,
)
def test_robots_are_built_with_their_effects(effect: Effect):
    robot = ASOC.with_effects(effect)
    run = simulate(robot, wander(np.random.default_rng(1), duration=2.5), 1, duration=2.5)
    assert slip(run, robot.as_built()) < 10 * SLIP
    assert slip(run, robot.as_described()) > 5 * slip(run, robot.as_built())


@pytest.mark.parametrize("effect", [AllWheelRadius(value=-0.11), WheelRadius(castor=1, wheel=2, value=0.09)])
def test_robots_stand_on_wheels_of_any_radius(effect: Effect):
    """And not on their skids, or on the wheels that are larger."""
    robot = DIFFERENTIAL.with_effects(effect)
    run = simulate(robot, wander(np.random.default_rng(1), duration=2.5, holonomic=False), 1, duration=2.5)
    assert slip(run, robot.as_built()) < 10 * SLIP


def test_one_run_can_be_read_with_and_without_an_effect(clean: Run):
    plain = read(clean, ASOC, rounded=False, noise=EXACT)
    bias = read(clean, ASOC.with_effects(PivotBias(castor=2, value=0.01)), rounded=False, noise=EXACT)
    lever = read(clean, ASOC.with_effects(ReferenceLeverX(value=0.02)), rounded=False, noise=EXACT)
    late = read(clean, ASOC.with_effects(ClockOffset(value=-0.1)), rounded=False, noise=EXACT)
    shift = np.mod(bias.pivot - plain.pivot + 2571.5, 5143) - 2571.5
    assert shift[:, 1] == pytest.approx(0.01 * 5143 / (2 * math.pi))
    assert np.array_equal(bias.wheel, plain.wheel)
    assert lever.reference is not None
    assert plain.reference is not None
    assert late.reference is not None
    heading = plain.reference[:, 2]
    moved = lever.reference - plain.reference
    assert moved[:, :2] == pytest.approx(0.02 * np.column_stack([np.cos(heading), np.sin(heading)]))
    assert late.reference[2:] == pytest.approx(plain.reference[:-2], abs=1e-9)


def test_logs_repeat_and_differ_only_by_what_is_hidden():
    motion = wander(np.random.default_rng(1), duration=1.5)
    logs = [drive(ASOC, motion, seed, duration=1.5) for seed in (7, 7, 8)]
    hidden = drive(ASOC.with_effects(PivotGain(castor=1, value=0.1)), motion, 7, duration=1.5)
    for part in ("t", "wheel", "pivot", "command", "reference"):
        assert np.array_equal(getattr(logs[0], part), getattr(logs[1], part), equal_nan=True)
    assert not np.array_equal(logs[0].wheel, logs[2].wheel)
    assert not np.array_equal(logs[0].wheel, hidden.wheel)
    assert np.array_equal(logs[0].wheel[0], hidden.wheel[0])
    assert np.array_equal(logs[0].pivot[0, 1:], hidden.pivot[0, 1:])
    assert np.array_equal(logs[0].wheel, np.round(logs[0].wheel))
    assert logs[0].reference is not None
    assert np.flatnonzero(np.isfinite(logs[0].reference[:, 0])).tolist() == [0, 20]


# Outside the catalogue


def test_a_sticking_counter_comes_back(clean: Run):
    hidden = outside.StickingCounter(2, 1, 0.5, seed=2)
    missing = (read(clean, ASOC, outside=hidden).wheel - read(clean, ASOC).wheel) * -1
    assert np.all(np.delete(missing, 2, axis=1) == 0)
    assert np.abs(missing[:, 2]).max() > 5
    back = (missing[:-1, 2] != 0) & (missing[1:, 2] == 0)
    assert back.sum() > 1


def test_a_conical_wheel_rolls_as_its_castor_points():
    hidden = outside.ConicalWheel(1, 2, 0.01, seed=1)
    run = simulate(ASOC, wander(np.random.default_rng(1), duration=3.0), 1, duration=3.0, outside=hidden)
    moved, aside, rolled = contacts(run, ASOC)
    theta = run.angle[:, 6]
    larger = hidden.value * np.cos((theta[:: run.every][1:] + theta[:: run.every][:-1]) / 2 - hidden.phase)
    assert moved[1] - rolled[1] == pytest.approx(larger * rolled[1], abs=2e-6)
    assert np.abs(larger * rolled[1]).max() > 4e-5
    assert np.abs(aside).sum(axis=1).max() < 1e-4


def test_a_fork_bends_by_its_give_times_the_side_force(clean: Run):
    """The axle then points elsewhere than its encoder says: in proportion, wheels seem to slip aside."""
    motion = wander(np.random.default_rng(1), duration=6.0)
    seen = []
    for give in (5e-4, 1e-3):
        run = simulate(ASOC, motion, 1, duration=3.0, outside=outside.FlexingFork(2, None, give))
        seen.append(np.abs(contacts(run, ASOC)[1]).sum(axis=1))
    assert seen[1][2] == pytest.approx(2 * seen[0][2], rel=0.15)
    assert seen[0][2] > 10 * np.abs(contacts(clean, ASOC)[1]).sum(axis=1)[2]
    assert seen[1][[0, 1, 4, 5]].max() < 0.1 * seen[1][2]


def test_a_loose_tyre_is_off_by_its_play_at_most():
    hidden = outside.LooseTyre(1, 1, 0.05)
    motion = Trajectory("to and fro", tuple(Drive((Leg((way, 0.0, 0.0), 0.2),), 0.4, 1.0) for way in (1.0, -1.0)))
    run = simulate(DIFFERENTIAL, motion, 0, duration=2.0, outside=hidden)
    moved, _, rolled = contacts(run, DIFFERENTIAL)
    off = np.cumsum(rolled - moved, axis=1)
    play = hidden.value * DIFFERENTIAL.wheels[0].radius
    assert np.ptp(off[0]) == pytest.approx(play, rel=0.03)
    assert np.ptp(off[1]) < 0.02 * play


def test_outsiders_are_drawn_at_places_of_the_robot():
    source, random = generator("bullet"), np.random.default_rng(0)
    drawn = [outsider(source.outsiders, ASOC, random) for _ in range(50)]
    assert source.foreign
    assert {class_of(hidden) for hidden in drawn} == {"StickingCounter", "ConicalWheel", "FlexingFork", "LooseTyre"}
    assert len({(hidden.castor, hidden.wheel) for hidden in drawn}) == 9


# What it has not


def test_what_cannot_be_built_is_refused():
    with pytest.raises(InputError, match="omni"):
        simulate(preset("omni3"), AHEAD, 0, duration=1.0)
    with pytest.raises(InputError, match="no castor 4"):
        simulate(ASOC.with_effects(PivotBias(castor=4, value=0.1)), AHEAD, 0, duration=1.0)
    blind = dataclasses.replace(ASOC.castors[0], pivot_counts_per_rev=None)
    with pytest.raises(InputError, match="no pivot encoder"):
        simulate(dataclasses.replace(ASOC, castors=(blind, *ASOC.castors[1:])), AHEAD, 0, duration=1.0)
    for effect in (SlipStiffness(value=0.1), ContactCreep(value=1e-5)):
        with pytest.raises(InputError, match="do not creep"):
            simulate(ASOC.with_effects(effect), AHEAD, 0, duration=1.0)
    with pytest.raises(InputError, match="cables"):
        simulate(ASOC.with_effects(Bump(x=0.1, y=0.0, direction=1.5, value=0.003)), AHEAD, 0, duration=1.0)
    with pytest.raises(InputError, match="does not turn"):
        simulate(DIFFERENTIAL, AHEAD, 0, duration=1.0, outside=outside.ConicalWheel(1, 1, 0.01))
    with pytest.raises(InputError, match="too stiff"):
        simulate(ASOC, AHEAD, 0, duration=1.0, outside=outside.FlexingFork(1, None, 1e-6))
    tricycle, idle = preset("tricycle"), outside.StickingCounter(2, 1, 0.1)
    with pytest.raises(InputError, match="no encoder"):
        drive(tricycle, AHEAD, 0, duration=0.1, outside=idle)
