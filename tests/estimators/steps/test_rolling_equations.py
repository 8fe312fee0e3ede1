"""Castors that the floor turns, integrated here and in conftest, against the equations of a sample."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from castor_envs.motion.controllers import trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset
from estimators import CalibratingFilter, HolmbergKhatib, WheelOdometry
from estimators.plugins.drives import winding as winding_drive
from estimators.steps.rolling_equations import (
    G_X,
    G_Y,
    LEVER,
    NUMBERS,
    SWUNG,
    EquationsOfSamples,
    Rows,
    bent,
    equation,
    moved,
    solve,
)


def off_at_the_end(exact_motion, drive, steps):
    """How far odometry is off after a second of even driving that turns castors from where they do not trail, m."""
    motion = exact_motion(preset("asoc-prototype"), lambda t: (0.2, 0.1, 0.5), 1.0, theta=[1.2, -0.8, 0.4])
    true, observations = motion.sampled(steps)
    return np.hypot(*(drive(WheelOdometry(), motion.robot, observations, true[0]) - true)[-1, :2])


def test_of_an_evenly_moving_body_hardly_the_fourth_order_is_left(exact_motion, drive):
    """A castor follows a tractrix: without its third order in a sample, half the sample would quarter the error."""
    coarse, fine = (off_at_the_end(exact_motion, drive, steps) for steps in (20, 40))
    assert coarse / fine > 16.0
    assert coarse < 1e-6


@pytest.mark.parametrize("seed", range(8))
def test_no_side_slip_behind_a_circle_is_exact_however_long_the_sample(seed):
    """One castor whose pivot, in the body's origin, runs on a circle while the body turns evenly, integrated: a way of
    up to ten offsets, of which the sample before tells how much its direction turns against the body."""
    random = np.random.default_rng(seed)
    offset, way, before = random.uniform(0.02, 0.1), random.uniform(0.01, 0.3), random.uniform(0.01, 0.3)
    before = np.clip(before, 0.55 * way, 1.9 * way)
    turn, veered, phi, theta = random.uniform(-1.0, 1.0), random.uniform(-0.49, 0.49), *random.uniform(-3.0, 3.0, 2)

    def rates(s, state):
        direction = phi + (turn + veered) * s  # in N
        return [
            way * np.cos(direction),
            way * np.sin(direction),
            way / offset * np.sin(direction - state[2]),
        ]

    x, y, end = solve_ivp(rates, (0.0, 1.0), [0.0, 0.0, theta], rtol=1e-12, atol=1e-14).y[:, -1]
    swivel, half = end - theta - turn, (end + theta - turn) / 2  # against the body, and in its axes half-way
    along = (x + 1j * y) * np.exp(-0.5j * turn)
    last = before * np.exp(1j * (np.angle(along) - veered))
    castor = SimpleNamespace(
        cos=np.cos(half),
        sin=np.sin(half),
        half_cos=np.cos(swivel / 2),
        half_sin=np.sin(swivel / 2),
        swivel=swivel,
        way_x=last.real,
        way_y=last.imag,
    )
    row = SimpleNamespace(roller=np.nan, weight=1.0, bend=1 / (2 * offset))
    of, a = np.zeros((1, 1, NUMBERS)), 2 * np.sin(turn / 2)
    equation(of, 0, 0, castor, row, 0.0, 0.0, offset, 0.0, 1)
    left = of[0, 0, G_X] * along.real + of[0, 0, G_Y] * along.imag + of[0, 0, LEVER] * a
    off = left - of[0, 0, SWUNG] * np.cos(turn / 2)
    assert bent(of, 0, 0, along.real, along.imag, a, turn) == pytest.approx(off, abs=1e-9)


TURNING = {
    "circling": lambda t: (np.cos(0.6 * t), np.sin(0.6 * t), 0.05),
    "to and fro": lambda t: (np.cos(1.2 * np.sin(0.6 * t)), np.sin(1.2 * np.sin(0.6 * t)), 0.1 * np.sin(0.3 * t)),
    "winding": lambda t: (np.cos(1.2 * t), np.sin(1.2 * t), 0.8 * np.sin(1.7 * t)),
}
"""Twists of 1 m/s, by time, s, whose direction turns against the body."""


def off_and_straight(estimator, twist, exact_motion, drive):
    """How far an estimator is off in 10 s, and straight steps, which leave out the tractrix, m."""
    robot = preset("asoc-prototype")
    start = trailing_angles(Geometry.of(robot), np.array(twist(0.0)))
    true, observations = exact_motion(robot, twist, 10.0, theta=start).sampled(200)
    return [
        np.hypot(*(drive(one, robot, observations, true[0]) - true).T[:2]).max()
        for one in (estimator, HolmbergKhatib())
    ]


@pytest.mark.parametrize("twist", TURNING.values(), ids=TURNING)
def test_castors_that_settled_behind_a_turning_direction_turn_as_it_does(twist, exact_motion, drive):
    off, straight = off_and_straight(WheelOdometry(), twist, exact_motion, drive)
    assert off < 0.6 * straight


@pytest.mark.parametrize("twist", TURNING.values(), ids=TURNING)
def test_the_filter_follows_castors_behind_a_turning_direction(twist, exact_motion, drive):
    off, straight = off_and_straight(CalibratingFilter(), twist, exact_motion, drive)
    assert off < straight + 3e-4  # it also reckons with creep under forces, which these wheels do not do


def with_a_gap(drive, first, samples):
    """The observations of a drive (`estimators.plugins.drives`) from 5 samples before a gap to one behind it, and the
    true poses at its start and end."""
    counts = np.cumsum([seen["wheel"] for seen in drive.observations], axis=0)
    rows = np.r_[first - 5 : first, first + samples]
    steps = np.diff(counts[rows], axis=0, prepend=counts[rows[:1]])
    observations = [{**drive.observations[row], "wheel": step} for row, step in zip(rows, steps, strict=True)]
    return observations, drive.pose[rows[0]], drive.pose[rows[-1]]


@pytest.mark.parametrize("estimator", [WheelOdometry, CalibratingFilter])
@pytest.mark.parametrize("name", ["asoc-prototype", "omnimate", "1-castor", "swerve"])
@pytest.mark.parametrize("samples", [20, 40, 60])
def test_a_gap_costs_no_more_than_straight_steps_through_it(name, samples, estimator, drive):
    """One sample of 1 to 3 s, in which castors turn far, anywhere in a drive: more is lost at hardly any place."""
    robot = preset(name)
    whole = winding_drive(robot)
    off, straight = [], []
    for first in range(20, len(whole.pose) - samples - 1, 20):
        observations, start, end = with_a_gap(whole, first, samples)
        off.append(np.hypot(*(drive(estimator(), robot, observations, start)[-1] - end)[:2]))
        straight.append(np.hypot(*(drive(HolmbergKhatib(), robot, observations, start)[-1] - end)[:2]))
    assert np.median(off) < 1.1 * np.median(straight)
    assert max(off) < 2.0 * max(straight)  # at one place, of a castor that turned by more than half a turn


@pytest.mark.parametrize("name", ["asoc-prototype", "omnimate", "1-castor", "powered-caster"])
def test_no_body_moves_farther_than_wheels_roll(name):
    """Whatever castors and wheels say, contradicting, in samples of ways from a centimetre to metres."""
    robot, random, count = preset(name), np.random.default_rng(1), 2000
    geometry = Geometry.of(robot)
    rolled = 2 * np.pi * geometry.radius / geometry.counts_per_rev
    rolled, steps = rolled[np.isfinite(rolled)], geometry.pivot_counts_per_rev[geometry.sensed] / (2 * np.pi)
    estimator, angle = WheelOdometry(), random.uniform(-np.pi, np.pi, (count, len(steps)))
    estimator.reset(robot, np.zeros((count, 3)))
    pose = estimator.update({"wheel": np.zeros((count, len(rolled))), "pivot": angle * steps})
    for way in (0.0125, 0.0125, 0.05, 0.05, 0.2, 0.5, 1.0, 1.0, 3.0, 3.0):
        angle += random.uniform(-1, 1, angle.shape) * min(np.pi, 5 * way)
        counts = random.uniform(-way, way, (count, len(rolled))) / rolled
        before, pose = pose, estimator.update({"wheel": counts, "pivot": angle * steps})
        assert np.hypot(*(pose - before).T[:2]).max() < 1.5 * way


@pytest.mark.parametrize("name", ["asoc-prototype", "omnimate", "swerve", "powered-caster", "tricycle"])
def test_single_steps_are_those_of_wheel_odometry(name):
    """Of the equations that peers set up and solve sample by sample."""
    robot = preset(name)
    rows, odometry, pose = Rows.of(Geometry.of(robot)), WheelOdometry(), np.zeros(3)
    equations, weight = EquationsOfSamples(rows), 1.0 / rows.variances()
    odometry.reset(robot, pose)
    for seen in winding_drive(robot).observations:
        pose = moved(pose, solve(equations.read(seen), weight))
        np.testing.assert_allclose(pose, odometry.update(seen), atol=1e-10)
