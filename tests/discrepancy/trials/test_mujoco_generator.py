"""The foreign simulator obeys rolling, contact and reading laws that are written out here, in closed form."""

import dataclasses
import math

import numpy as np
import pytest

pytest.importorskip("mujoco")

from castor_envs.effects.catalogue import catalogue, readings, reference
from castor_envs.effects.clocks import AllLatency, EncoderLatency, SampleJitter
from castor_envs.effects.contact import ContactCreep, SlipStiffness, SlipStiffnessLateral
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
from castor_envs.effects.encoders import TickLossBursts
from castor_envs.effects.floor import Bump, FloorSlope
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.geometry.steps import Motion
from castor_envs.motion.trajectories import Leg, Trajectory, wander
from castor_envs.motion.trajectories import Run as Drive
from castor_envs.physics.contact_motion import ContactMotion
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from castor_envs.vehicles.weight import swung_loads
from discrepancy.trials.foreign.run import Run, read
from discrepancy.trials.mujoco import outside
from discrepancy.trials.mujoco.world import SIMULATOR, STEP, World, drive, simulate
from discrepancy.trials.reading import Noise

ASOC = preset("asoc-prototype")
DIFFERENTIAL = preset("differential")
SILENT = Noise(0.0, 0.0)
CREEP = 1e-4  # m for each m rolled, along and across: the median of what contacts slip in a sample


def along(*motion: float, length: float = 0.5) -> Trajectory:
    return Trajectory("leg", (Drive((Leg((motion[0], motion[1], motion[2]), length),), 0.25, 0.5),))


AHEAD, SPIN = along(1.0, 0.0, 0.0), along(0.0, 0.0, 1.0, length=1.0)
REST = along(1.0, 0.0, 0.0, length=1e-9)


@pytest.fixture(scope="module")
def clean() -> Run:
    return simulate(ASOC, wander(np.random.default_rng(1), duration=10.0), 1, duration=10.0)


def heights(run: Run) -> np.ndarray:
    """Of the wheels' centres over the floor at all times (N + 1, w), m, of robots whose wheels are all driven."""
    w = len(run.phase)
    return run.state[:, -2 * w : -w]


def loads(run: Run) -> np.ndarray:
    """Loads of the wheels on the floor at all times (N + 1, w), N."""
    return run.state[:, -len(run.phase) :]


def slips(run: Run, robot: RobotDescription) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slip of each wheel's contact in each sample, along and across (w, K - 1), and what it rolled; m."""
    w, every = len(robot.wheels), run.every
    parts = []
    for k, i in enumerate(robot.wheel_castors):
        castor, wheel = robot.castors[i], robot.wheels[k]
        turned = run.angle[:, k]
        heading, direction = run.pose[:, 2], run.pose[:, 2] + run.angle[:, w + i]
        pivot = castor.pivot[0] + 1j * castor.pivot[1]
        axle = (-castor.offset + 1j * wheel.lateral) * np.exp(1j * direction)
        contact = run.pose[:, 0] + 1j * run.pose[:, 1] + pivot * np.exp(1j * heading) + axle
        step = np.diff(contact) * np.exp(-0.5j * (direction[1:] + direction[:-1]))
        step = np.array([step.real - wheel.radius * np.diff(turned), step.imag, wheel.radius * np.diff(turned)])
        parts.append(step[:, : len(step[0]) // every * every].reshape(3, -1, every).sum(axis=2))
    whole = np.array(parts)
    return whole[:, 0], whole[:, 1], whole[:, 2]


def median_slip(run: Run, robot: RobotDescription) -> tuple[float, float]:
    """Median slip of samples, along and across, in parts of what was rolled, where wheels roll at all."""
    ahead, aside, rolled = slips(run, robot)
    rolls = np.abs(rolled) > 0.2 * np.abs(rolled).max()
    return tuple(float(np.median(np.abs(slip[rolls] / rolled[rolls]))) for slip in (ahead, aside))  # type: ignore[return-value]


# Rolling


def test_a_straight_drive_is_as_long_as_its_wheels_roll():
    run = simulate(DIFFERENTIAL, AHEAD, 0, duration=4.0)
    rolled = DIFFERENTIAL.wheels[0].radius * run.angle[-1, :2].mean()
    assert run.pose[-1, 0] == pytest.approx(rolled, rel=CREEP)
    assert rolled == pytest.approx(0.5, rel=0.02)
    assert run.pose[-1, 1:] == pytest.approx([0, 0], abs=1e-6)


def test_a_differential_robot_turns_by_its_wheels_difference_over_the_track():
    run = simulate(DIFFERENTIAL, SPIN, 0, duration=6.0)
    left, right = DIFFERENTIAL.wheels
    turned = (right.radius * run.angle[-1, 1] - left.radius * run.angle[-1, 0]) / (left.lateral - right.lateral)
    assert run.pose[-1, 2] == pytest.approx(turned, rel=CREEP)
    assert abs(turned) > 0.9


def with_idle_castor() -> RobotDescription:
    idle = Castor(
        pivot=(0.3, 0.0), offset=0.1, pivot_counts_per_rev=4096, wheels=(Wheel(radius=0.05, counts_per_rev=None),)
    )
    return dataclasses.replace(DIFFERENTIAL, castors=(*DIFFERENTIAL.castors, idle))


def test_a_free_castor_trails_as_the_distance_over_its_offset():
    robot = with_idle_castor()
    run = simulate(robot, AHEAD, 3, duration=4.0)
    theta = run.angle[:, -1]
    law = 2 * np.arctan(math.tan(theta[0] / 2) * np.exp(-run.pose[:, 0] / robot.castors[1].offset))
    assert abs(theta[0]) > 0.1
    assert np.abs(theta - law).max() < 2e-3 * abs(theta[0])


def test_wheels_of_a_clean_run_hardly_slip(clean: Run):
    along, across = median_slip(clean, ASOC)
    assert along < CREEP
    assert across < CREEP
    ahead, aside, rolled = slips(clean, ASOC)
    distance = np.abs(rolled).sum(axis=1)
    assert np.all(np.abs(ahead).sum(axis=1) < 5e-4 * distance)
    assert np.all(np.abs(aside).sum(axis=1) < 5e-4 * distance)


@pytest.mark.parametrize("name", ["omnimate", "tricycle", "powered-caster", "swerve"])
def test_other_robots_roll_too(name: str):
    robot = preset(name)
    motion = wander(np.random.default_rng(2), duration=4.0, holonomic=name != "tricycle")
    assert max(median_slip(simulate(robot, motion, 2, duration=4.0), robot)) < 3 * CREEP


def test_half_the_step_makes_the_same_path():
    motion = wander(np.random.default_rng(1), duration=3.0)
    finer = dataclasses.replace(SIMULATOR, longest=SIMULATOR.longest / 2)
    runs = [simulator.simulate(ASOC, motion, 1, duration=3.0) for simulator in (SIMULATOR, finer)]
    assert runs[0].every * 2 == runs[1].every
    assert np.abs(runs[0].pose - runs[1].pose[::2]).max() < 5e-5
    assert np.abs(runs[0].angle - runs[1].angle[::2])[:, :6].max() < 2e-3


def test_turns_follow_the_twist_asked_for(clean: Run):
    motion = wander(np.random.default_rng(1), duration=10.0)
    assert clean.pose[-1] == pytest.approx(motion.at(10.0)[0], abs=0.02)


@pytest.mark.parametrize(
    "effect",
    [
        WheelRadius(castor=1, wheel=2, value=0.02),
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
    run = simulate(robot, wander(np.random.default_rng(1), duration=4.0), 1, duration=4.0)
    assert max(median_slip(run, robot.as_built())) < 2 * CREEP
    apart = [np.abs(np.array(slips(run, one)[:2])).sum() for one in (robot.as_described(), robot.as_built())]
    assert apart[0] > 5 * apart[1]


@pytest.mark.parametrize("effect", [AllWheelRadius(value=-0.11), WheelRadius(castor=1, wheel=2, value=0.09)])
def test_robots_stand_on_wheels_of_any_radius(effect: Effect):
    """And not on their skids, or on the wheels that are larger."""
    robot = preset("differential").with_effects(effect)
    run = simulate(robot, wander(np.random.default_rng(1), duration=4.0, holonomic=False), 1, duration=4.0)
    assert max(median_slip(run, robot.as_built())) < 2 * CREEP


# Contact, load and floor


def test_a_wheel_rises_by_the_height_of_what_it_rolls_over_and_no_wheel_leaves_the_floor():
    height = 0.004
    floor = Floor(cables=(Cable(center=(0.25, 0.25), direction=math.pi / 2, length=0.3, diameter=height),))
    run = simulate(ASOC, AHEAD, 1, duration=4.0, floor=floor)
    rise = (heights(run) - [wheel.radius for wheel in ASOC.wheels]).max(axis=0)
    over = rise > height / 2
    assert 0 < over.sum() < 6
    assert rise[over] == pytest.approx(height, abs=1e-4)
    assert loads(run).min() > 0.1 * loads(run).mean()


def test_a_wheel_over_a_cable_rolls_the_longer_way():
    """A centre follows an arc about the cable's axis, 2 R (phi - sin phi) longer than its way in plan."""
    height, radius = 0.004, DIFFERENTIAL.wheels[0].radius
    reach = radius + height / 2
    angle = math.acos((radius - height / 2) / reach)
    floor = Floor(cables=(Cable(center=(0.25, 0.0), direction=math.pi / 2, length=0.4, diameter=height),))
    run = simulate(DIFFERENTIAL, AHEAD, 0, duration=3.5, floor=floor)
    extra = radius * run.angle[-1, :2].mean() - run.pose[-1, 0]
    assert extra == pytest.approx(2 * reach * (angle - math.sin(angle)), rel=0.1)


def test_wheels_carry_the_robot():
    run = simulate(ASOC, REST, 0, duration=0.5)
    weight = (ASOC.mass + sum(castor.mass for castor in ASOC.castors)) * Floor().normal_gravity
    assert loads(run)[-1].sum() == pytest.approx(weight, rel=1e-4)


def test_contacts_hold_a_robot_on_a_slope():
    slope = Floor(slope=(0.05, 0.0))
    run = simulate(ASOC, REST, 0, duration=2.0, floor=slope)
    ahead, aside, _ = slips(run, ASOC)
    assert np.abs(ahead.sum(axis=1)).max() < 2e-5
    assert np.abs(aside.sum(axis=1)).max() < 2e-5


def test_effects_of_the_floor_are_in_it():
    slope, cable = FloorSlope(direction="x", value=0.03), Bump(x=0.1, y=0.0, direction=1.5, value=0.003)
    floor = Floor(
        slope=(0.03, 0.0), cables=(Cable(center=(0.1, 0.0), direction=1.5, length=cable.length, diameter=0.003),)
    )
    hidden = simulate(DIFFERENTIAL.with_effects(slope, cable), AHEAD, 0, duration=1.0)
    assert np.array_equal(hidden.pose, simulate(DIFFERENTIAL, AHEAD, 0, duration=1.0, floor=floor).pose)


def test_contact_creep_is_as_fast_as_the_force_asks():
    value, slope = 2e-5, 0.05
    robot = dataclasses.replace(DIFFERENTIAL, max_wheel_torque=1e3)  # a stiff servo: wheels stand
    creeping = robot.with_effects(ContactCreep(value=value))
    floor = Floor(slope=(slope, 0.0))
    runs = [simulate(one, REST, 0, duration=2.0, floor=floor) for one in (robot, creeping)]
    rest = [slips(run, robot)[0][:, 20:].sum(axis=1).mean() for run in runs]
    force = (robot.mass + robot.castors[0].mass) * Floor(slope=(slope, 0.0)).normal_gravity * slope / 2
    assert rest[1] - rest[0] == pytest.approx(-value * force * 1.0, rel=0.1)


def test_tyres_slip_as_their_stiffness_and_the_force_ask():
    """Driving up a slope at a steady speed: slip in parts of the way is force over load and stiffness."""
    slope, softer = Floor(slope=(0.05, 0.0)), SlipStiffness(value=-0.5)
    robot, motion = DIFFERENTIAL, along(1.0, 0.0, 0.0, length=1.0)
    runs = [simulate(one, motion, 0, duration=2.0, floor=slope) for one in (robot, robot.with_effects(softer))]
    slip = [slips(run, robot)[0][:, 20:40].sum() / slips(run, robot)[2][:, 20:40].sum() for run in runs]
    weight = (robot.mass + robot.castors[0].mass) * slope.normal_gravity
    stiffness = robot.contact.slip_stiffness_long
    asked = -(weight * 0.05) / loads(runs[0])[len(runs[0].t) // 2].sum() * (1 / (0.5 * stiffness) - 1 / stiffness)
    assert slip[1] - slip[0] == pytest.approx(asked, rel=0.1)


def test_tyres_slip_in_acceleration_as_the_law_says():
    """A wheel that shrinks under its force stays on the floor: else it spins, and slips five times as much."""
    softer, motion = SlipStiffness(value=-0.6), wander(np.random.default_rng(1), duration=10.0)
    runs = [simulate(robot, motion, 1, duration=10.0) for robot in (ASOC.with_effects(softer), ASOC)]
    slip, clean = (slips(run, ASOC)[0].T for run in runs)
    t, pose, angle = (of[:: runs[0].every] for of in (runs[0].t, runs[0].pose, runs[0].angle))
    law = softer.slip(ContactMotion(ASOC, Motion(t, pose, angle[:, :6], angle[:, 6:], True, 0.0)))
    assert law is not None
    assert np.sum((slip - clean) * law.rolling) / np.sum(law.rolling**2) == pytest.approx(1.0, abs=0.25)


def test_side_slip_is_as_large_as_stiffness_and_force_ask():
    """Driving across a slope: contacts drift down by side force over load and stiffness, in parts of the way."""
    slope, softer = Floor(slope=(0.0, 0.05)), SlipStiffnessLateral(value=-0.5)
    robot, motion = DIFFERENTIAL, along(1.0, 0.0, 0.0, length=1.0)
    runs = [simulate(one, motion, 0, duration=2.0, floor=slope) for one in (robot, robot.with_effects(softer))]
    slip = [slips(run, robot)[1][:, 20:40].sum() / slips(run, robot)[2][:, 20:40].sum() for run in runs]
    weight = (robot.mass + robot.castors[0].mass) * slope.normal_gravity
    stiffness = robot.contact.slip_stiffness_lat
    asked = -(weight * 0.05) / loads(runs[0])[len(runs[0].t) // 2].sum() * (1 / (0.5 * stiffness) - 1 / stiffness)
    assert slip[1] - slip[0] == pytest.approx(asked, rel=0.1)


def test_wheels_slide_on_ice(clean: Run):
    ice = Floor(patches=(Patch(center=(0.0, 0.0), size=(0.6, 0.6), friction=0.001),))
    run = simulate(ASOC, wander(np.random.default_rng(1), duration=10.0), 1, duration=3.0, floor=ice)
    slid = [sum(np.abs(part[:, :60]).max() for part in slips(one, ASOC)[:2]) for one in (run, clean)]
    assert slid[0] > 10 * slid[1]


# Reading


def smooth_run(robot: RobotDescription, seed: int = 0) -> Run:
    """A made-up run: angles that go on in straight lines between samples, at fine times."""
    random, samples, every = np.random.default_rng(seed), 60, 10
    channels = len(robot.wheels) + len(robot.castors)
    rate = np.array([6.0] * len(robot.wheels) + [2.0] * len(robot.castors))
    corner = np.cumsum(random.normal(size=(samples + 1, channels)) * rate * robot.sample_period, axis=0)
    corner[:, : len(robot.wheels)] -= corner[0, : len(robot.wheels)]
    fine = np.arange(samples * every + 1) / every
    t = fine * robot.sample_period
    pose = np.column_stack([0.2 * t, -0.1 * t, 0.5 * t])
    angle = np.column_stack([np.interp(fine, np.arange(samples + 1), own) for own in corner.T])
    blank = np.zeros((len(t), len(robot.wheels)))
    command = np.zeros((samples + 1, len(robot.driven_wheels)))
    phase = random.uniform(size=len(robot.driven_wheels))
    return Run(
        t=t,
        angle=angle,
        pose=pose,
        state=blank,
        command=command,
        steering=command[:, :0],
        phase=phase,
        every=every,
        seed=seed,
    )


def counts(robot: RobotDescription, wheel: np.ndarray, castor: np.ndarray, phase: np.ndarray) -> np.ndarray:
    per_rev = np.array([wheel.counts_per_rev for wheel in robot.wheels], dtype=float)
    turn = np.array([castor.pivot_counts_per_rev for castor in robot.castors], dtype=float)
    zero = np.array([castor.pivot_zero for castor in robot.castors])
    pivot = np.mod((castor + zero) * turn / (2 * np.pi), turn)
    return np.column_stack([wheel * per_rev / (2 * np.pi) + phase, pivot])


BURSTS = [
    TickLossBursts(castor=2, wheel=1, value=0.3, period=0.4, width=0.15, start=0.2, seed=seed) for seed in (None, 5)
]
SENSED = [one for one in catalogue(ASOC) if one.name not in ("sample_jitter",)] + BURSTS
EARLY = [EncoderLatency(castor=1, value=-0.013), AllLatency(value=-0.02)]


@pytest.mark.parametrize("effect", SENSED + EARLY, ids=repr)
def test_effects_mean_what_the_catalogue_says(effect: Effect):
    """Where angles go straight between samples, reading in fine time and sample by sample are the same."""
    robot, run = ASOC.with_effects(effect), smooth_run(ASOC)
    log = read(run, robot, rounded=False, noise=SILENT)
    t, true = run.t[:: run.every], run.angle[:: run.every]
    expected = counts(robot.as_built(), *readings(robot, t, true[:, :6], true[:, 6:]), run.phase)
    turn = ASOC.castors[0].pivot_counts_per_rev
    assert turn is not None
    assert np.abs(log.wheel - expected[:, :6]).max() < (5.0 if effect in BURSTS else 1e-6)
    apart = np.mod(log.pivot - expected[:, 6:] + turn / 2, turn) - turn / 2
    assert np.abs(apart).max() < 1e-6
    shown = reference(robot, t, run.pose[:: run.every])
    seen = ~np.isnan(log.reference[:, 0]) if log.reference is not None else np.zeros(0, dtype=bool)
    assert log.reference is not None
    assert log.reference[seen] == pytest.approx(shown[seen], abs=1e-9)


def test_latency_shifts_a_ramp_by_rate_times_latency():
    run, rate, latency = smooth_run(ASOC), 3.0, 0.0123
    run = dataclasses.replace(run, angle=np.outer(run.t, np.full(9, rate)))
    late = read(run, ASOC.with_effects(EncoderLatency(castor=2, wheel=1, value=latency)), rounded=False)
    behind = read(run, ASOC, rounded=False).wheel - late.wheel
    assert behind[5:, 2] == pytest.approx(rate * latency * 1200 / (2 * math.pi))
    assert np.delete(behind, 2, axis=1) == pytest.approx(0.0)


def test_jitter_moves_readings_by_rate_times_a_time_of_its_spread():
    run, rate, spread = smooth_run(ASOC), 3.0, 0.002
    run = dataclasses.replace(run, angle=np.outer(run.t, np.full(9, rate)))
    log = read(run, ASOC.with_effects(SampleJitter(value=spread, seed=4)), rounded=False)
    moved = (log.wheel - read(run, ASOC, rounded=False).wheel) * 2 * math.pi / 1200 / rate
    assert moved[:, 1:] == pytest.approx(np.repeat(moved[:, :1], 5, axis=1), abs=1e-9)  # all together
    assert moved[1:, 0] == pytest.approx(spread * np.random.default_rng(4).standard_normal(len(log))[1:], abs=1e-9)


def test_counts_are_whole_and_pivots_within_a_turn(clean: Run):
    log, exact = read(clean, ASOC), read(clean, ASOC, rounded=False)
    assert np.array_equal(log.wheel, np.round(log.wheel))
    assert np.abs(log.wheel - exact.wheel).max() <= 0.5
    assert log.pivot.min() >= 0
    assert log.pivot.max() < 5143


def test_one_run_can_be_read_with_and_without_an_effect(clean: Run):
    bias = read(clean, ASOC.with_effects(PivotBias(castor=2, value=0.01)), rounded=False)
    plain = read(clean, ASOC, rounded=False)
    shift = np.mod(bias.pivot - plain.pivot + 2571.5, 5143) - 2571.5
    assert shift[:, 1] == pytest.approx(0.01 * 5143 / (2 * math.pi))
    assert np.array_equal(bias.wheel, plain.wheel)
    assert np.array_equal(bias.reference, plain.reference, equal_nan=True)  # type: ignore[arg-type]


def test_logs_repeat_and_differ_only_by_what_is_hidden():
    motion = wander(np.random.default_rng(1), duration=3.0)
    logs = [drive(ASOC, motion, seed, duration=3.0) for seed in (7, 7, 8)]
    hidden = drive(ASOC.with_effects(PivotBias(castor=1, value=0.02)), motion, 7, duration=3.0)
    for part in ("t", "wheel", "pivot", "command", "reference"):
        assert np.array_equal(getattr(logs[0], part), getattr(logs[1], part), equal_nan=True)
    assert not np.array_equal(logs[0].wheel, logs[2].wheel)
    assert not np.array_equal(logs[0].wheel, hidden.wheel)
    assert np.array_equal(logs[0].wheel[0], hidden.wheel[0])
    assert np.array_equal(logs[0].reference[0], hidden.reference[0])  # type: ignore[index]
    assert np.array_equal(logs[0].pivot[0, 1:], hidden.pivot[0, 1:])
    assert np.flatnonzero(np.isfinite(logs[0].reference[:, 0])).tolist() == [0, 20, 40, 60]  # type: ignore[index]


def test_a_biased_pivot_misleads_the_controller():
    """The robot steers by what it reads: with all pivots off by one angle, it goes off by that angle."""
    off = 0.1
    biases = [PivotBias(castor=i, value=off) for i in (1, 2, 3)]
    run = simulate(ASOC.with_effects(*biases), AHEAD, 1, duration=4.0)
    assert math.atan2(run.pose[-1, 1], run.pose[-1, 0]) == pytest.approx(-off, abs=0.02)


# Outside the catalogue


def test_a_warming_wheel_grows():
    hidden = outside.WarmingWheel(1, 1, 0.2)
    run = simulate(DIFFERENTIAL, along(1.0, 0.0, 0.0, length=1.0), 0, duration=4.0, outside=hidden)
    radius = DIFFERENTIAL.wheels[0].radius * (1 + 0.2 * (1 - np.exp(-run.t / hidden.WARMING)))
    assert heights(run)[:, 0] == pytest.approx(radius, abs=1e-5)


def test_a_flat_spot_lowers_the_wheel_once_a_turn():
    hidden = outside.FlatSpot(1, 2, 1e-3, seed=1)
    run = simulate(DIFFERENTIAL, along(1.0, 0.0, 0.0, length=1.0), 0, duration=5.0, outside=hidden)
    low = DIFFERENTIAL.wheels[0].radius - heights(run)[:, 1]
    away = np.remainder(run.angle[:, 1] - hidden.phase + np.pi, 2 * np.pi) - np.pi
    inside = np.abs(away) < hidden.WIDTH / 2
    law = np.where(inside, hidden.value * np.cos(np.pi * away / hidden.WIDTH) ** 2, 0.0)
    assert np.median(np.abs(low - law)[inside]) < 2e-5
    assert np.abs(low - law).max() < 2e-4  # where the wheel falls, its contact may open for a step
    assert np.abs(heights(run)[:, 0] - DIFFERENTIAL.wheels[0].radius).max() < 2e-5


def test_a_wobbling_wheel_moves_its_contact_along_the_axle():
    """On a robot that spins, rolled distance over turn is how far apart the contacts are: it swings by the size."""
    size = 0.01
    run = simulate(
        DIFFERENTIAL, along(0.0, 0.0, 1.0, length=4.0), 0, duration=8.0, outside=outside.WobblingWheel(1, 2, size)
    )
    steady = (run.t > 1.0) & (run.t < 7.0)
    rolled = DIFFERENTIAL.wheels[0].radius * np.gradient(run.angle[steady, 1] - run.angle[steady, 0])
    apart = rolled / np.gradient(run.pose[steady, 2])
    angle = run.angle[steady, 1]
    rows = np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    mean, *swing = np.linalg.lstsq(rows, apart, rcond=None)[0]
    assert np.hypot(*swing) == pytest.approx(size, rel=0.1)
    assert mean == pytest.approx(0.34, rel=0.01)


def test_soft_tyres_sink_as_far_as_the_load_of_the_moment_presses():
    soft = 1e-5
    run = simulate(ASOC.with_effects(LoadRadius(value=soft)), along(1.0, 0.0, 0.0, length=3.0), 1, duration=4.0)
    load = loads(run)[-1]
    assert np.ptp(load) > 0.5 * load.mean()
    assert heights(run)[-1] == pytest.approx(0.0381 - soft * (load - 22.5 * Floor().normal_gravity / 6), abs=1e-6)


def test_soft_tyres_are_on_average_as_large_as_described_at_rest():
    run = simulate(ASOC.with_effects(LoadRadius(value=1e-5)), REST, 0, duration=1.0)
    assert heights(run)[-1].mean() == pytest.approx(0.0381, abs=2e-6)


def test_loads_shift_as_castors_trail():
    """The project's statics, which leave out what accelerating shifts, against springs under each wheel."""
    run = simulate(ASOC, wander(np.random.default_rng(1), duration=10.0), 1, duration=10.0)
    expected = swung_loads(ASOC, Floor().normal_gravity, run.angle[:, 6:])
    load = loads(run) * (expected.sum() / loads(run).sum())
    assert np.all(np.std(expected, axis=0) > 0.15 * expected.mean())
    assert np.all(np.std(load - expected, axis=0) < 0.2 * np.std(expected, axis=0))


def test_a_pivot_with_play_lets_its_castor_wander_no_further_than_that():
    size = 2e-3
    motion = wander(np.random.default_rng(1), duration=5.0)
    run = simulate(ASOC, motion, 1, duration=5.0, outside=outside.PivotPlay(2, None, size))
    even = simulate(ASOC, motion, 1, duration=5.0)
    drift = [np.abs(np.cumsum(slips(one, ASOC)[1], axis=1)).max(axis=1) for one in (run, even)]
    assert 0.2 * size < drift[0][2] < 2 * size
    assert drift[1][2] < 0.1 * size


@pytest.mark.parametrize(("stick", "holds"), [(50.0, True), (1e-3, False)])
def test_a_sticky_pivot_holds_its_castor_against_what_the_floor_can_give(stick: float, holds: bool):
    """An idle castor's tyre can turn its fork by friction * load * offset, less than 50 N m here."""
    robot, hidden = with_idle_castor(), outside.StickyPivot(2, None, stick)
    run = simulate(robot, along(1.0, 0.0, 0.0, length=0.3), 3, duration=2.0, outside=hidden)
    turned = abs(run.angle[-1, -1] - run.angle[0, -1])
    assert turned < 5e-3 if holds else turned > 0.1


def test_a_loose_mast_swings_at_its_frequency():
    frequency, short = 2.0, along(1.0, 0.0, 0.0, length=0.1)
    run = simulate(DIFFERENTIAL, short, 0, duration=6.0, outside=outside.LooseMast(1, None, frequency))
    body = DIFFERENTIAL.wheels[0].radius * run.angle[:, :2].mean(axis=1)
    swing = (run.pose[:, 0] - body)[run.t > 2.0]
    crossings = np.flatnonzero((swing[1:] > 0) & (swing[:-1] <= 0))
    period = np.diff(crossings).mean() * (run.t[1] - run.t[0])
    assert 1 / period == pytest.approx(frequency, rel=0.02)
    assert swing.max() > 1e-4


def test_count_glitches_stay_on_their_channel(clean: Run):
    hidden = outside.CountGlitches(2, 1, 5 * 2 * math.pi / 1200)
    jumps = np.diff((read(clean, ASOC, outside=hidden).wheel - read(clean, ASOC).wheel), axis=0)
    assert np.all(np.delete(jumps, 2, axis=1) == 0)
    assert set(np.abs(jumps[:, 2])) == {0, 5}


# What it has not


def test_what_cannot_be_built_is_refused():
    with pytest.raises(InputError, match="omni"):
        simulate(preset("omni3"), AHEAD, 0, duration=1.0)
    with pytest.raises(InputError, match="no castor 4"):
        simulate(ASOC.with_effects(PivotBias(castor=4, value=0.1)), AHEAD, 0, duration=1.0)
    blind = dataclasses.replace(ASOC.castors[0], pivot_counts_per_rev=None)
    with pytest.raises(InputError, match="no pivot encoder"):
        simulate(dataclasses.replace(ASOC, castors=(blind, *ASOC.castors[1:])), AHEAD, 0, duration=1.0)
    with pytest.raises(InputError, match="hold better than described"):
        simulate(ASOC.with_effects(SlipStiffness(value=0.1)), AHEAD, 0, duration=1.0)


def test_a_simulation_that_becomes_unstable_is_told(tmp_path, monkeypatch):
    """MuJoCo begins anew, and the run would go on from there. It writes a file of its warnings where it runs."""
    monkeypatch.chdir(tmp_path)
    world = World(ASOC, Floor(), STEP)
    still = np.zeros(len(ASOC.driven_wheels))
    world.step(0.0, still, still[:0])
    world.data.qvel[0] = 1e12
    with pytest.raises(ArithmeticError, match=r"became unstable at 0\.001 s"):
        world.step(STEP, still, still[:0])
