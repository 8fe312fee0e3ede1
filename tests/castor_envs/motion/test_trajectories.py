# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportOptionalSubscript=false

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from castor_envs.errors import InputError
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory, figure_eight, moved, pivoting, umbmark, wander
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, Wheel

UNTURNED = Castor(pivot=(0.0, 0.0), offset=0.1, wheels=(Wheel(radius=0.05, grip="omni"),))

TRAJECTORIES = [
    *(umbmark(direction, corners) for direction in ("cw", "ccw") for corners in ("turn", "fixed", "rounded")),
    pivoting((0.2, -0.1)),
    figure_eight(),
    wander(np.random.default_rng(3), duration=20),
]
ids = [trajectory.name for trajectory in TRAJECTORIES]


@pytest.mark.parametrize("trajectory", TRAJECTORIES, ids=ids)
def test_the_pose_is_the_integral_of_the_twist(trajectory):
    def rates(t, pose):
        v_x, v_y, omega = trajectory.at(t)[1]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        return [c * v_x - s * v_y, s * v_x + c * v_y, omega]

    times = trajectory.breakpoints()
    pose = np.zeros(3)
    for start, end in pairwise(times):
        inside = (np.nextafter(start, end), np.nextafter(end, start))
        pose = solve_ivp(rates, inside, pose, rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(trajectory.at(end)[0], pose, atol=1e-7)
    np.testing.assert_allclose(trajectory.at(trajectory.duration)[1], 0.0, atol=1e-12)
    np.testing.assert_array_equal(trajectory.at(trajectory.duration + 1)[0], trajectory.at(trajectory.duration)[0])


@pytest.mark.parametrize("corners", ["turn", "fixed", "rounded"])
@pytest.mark.parametrize("direction", ["cw", "ccw"])
def test_squares_close(direction, corners):
    square = umbmark(direction, corners)
    x, y, psi = square.at(square.duration)[0]
    turns = 0.0 if corners == "fixed" else 2 * math.pi * (1 if direction == "ccw" else -1)
    np.testing.assert_allclose([x, y, psi], [0.0, 0.0, turns], atol=1e-12)
    assert square.path_length == pytest.approx(5.727 if corners == "rounded" else 6.0, abs=1e-3)


@pytest.mark.parametrize("corners", ["turn", "fixed", "rounded"])
def test_clockwise_is_the_mirror_image(corners):
    t = np.linspace(0, umbmark().duration, 500)
    left, right = umbmark("ccw", corners).at(t)[0], umbmark("cw", corners).at(t)[0]
    np.testing.assert_allclose(left * [1, -1, -1], right, atol=1e-12)


def test_a_known_square_takes_a_known_time():
    """Sides: 1.5 / 0.25 + 0.25 / 0.5 = 6.5 s; turns: 90 / 45 + 45 / 90 = 2.5 s."""
    assert umbmark().duration == pytest.approx(4 * (6.5 + 2.5))


def test_pivoting_holds_the_pivot():
    pivot = (0.2, -0.1)
    pose = pivoting(pivot).at(np.linspace(0, 10, 100))[0]
    at = moved(pose, np.array([*pivot, 0.0]))
    np.testing.assert_allclose(at[:, :2], np.tile(pivot, (100, 1)), atol=1e-12)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), holonomic=st.booleans())
def test_wandering_stays_in_the_arena_and_repeats(seed, holonomic):
    trajectory = wander(np.random.default_rng(seed), duration=30, holonomic=holonomic)
    assert trajectory == wander(np.random.default_rng(seed), duration=30, holonomic=holonomic)
    pose, twist = trajectory.at(np.linspace(0, trajectory.duration, 400))
    assert np.max(np.hypot(pose[:, 0], pose[:, 1])) <= 2.05
    assert trajectory.duration >= 30
    if not holonomic:
        assert np.all(twist[:, 1] == 0.0)


def test_impossible_squares_are_refused():
    for wrong in ({"corners": "round"}, {"direction": "left"}, {"corners": "rounded", "corner_radius": 1.0}):
        with pytest.raises(InputError):
            umbmark(**wrong)


def test_rolling_castors_solve_the_tractrix():
    """A castor pulled straight: tan(theta / 2) falls as exp(-s / offset), the closed form of the tractrix."""
    robot = preset("asoc-prototype")
    rolled = roll(robot, umbmark("ccw", "fixed"), castor_angle=[1.0, -0.5, 2.5])
    first = rolled.t < 6.4
    s = rolled.pose[first, 0]
    for i, start in enumerate([1.0, -0.5, 2.5]):
        expected = 2 * np.arctan(np.tan(start / 2) * np.exp(-s / robot.castors[i].offset))
        np.testing.assert_allclose(rolled.castor_angle[first, i], expected, atol=1e-8)


def test_rolling_wheels_roll_their_paths():
    """Wheel angle times radius is the contact point's path along the castor, found from positions alone."""
    robot = preset("asoc-prototype")
    rolled = roll(robot, umbmark("ccw", "rounded"))
    k = 3
    castor, wheel = robot.castors[1], robot.wheels[k]
    x, y, psi = rolled.pose.T
    heading = psi + rolled.castor_angle[:, 1]
    point = x + 1j * y + np.exp(1j * psi) * complex(*castor.pivot)
    point += np.exp(1j * heading) * complex(-castor.offset, wheel.lateral)
    along = np.diff(point) * np.exp(-0.5j * (heading[1:] + heading[:-1]))
    assert np.max(np.abs(along.imag)) < 2e-4
    assert rolled.wheel_angle[-1, k] * wheel.radius == pytest.approx(np.sum(along.real), rel=2e-4)


@pytest.mark.parametrize("way", ["ccw", "cw"])
def test_a_tricycle_steers_ahead_and_across(way):
    """Round the square its front wheel rolls the sides, and a quarter circle about the rear axle at each corner."""
    robot = preset("tricycle")
    base, radius = robot.castors[0].pivot[0], robot.castors[0].wheels[0].radius
    rolled = roll(robot, umbmark(way))
    assert np.abs(np.diff(rolled.wheel_angle[:, 0])).sum() * radius == pytest.approx(4 * 1.5 + 4 * base * np.pi / 2)
    steering = np.abs(rolled.castor_angle[:, 0])
    assert np.all(np.isclose(steering, 0) | np.isclose(steering, np.pi / 2))


def test_swerve_modules_point_along_their_pivots_paths():
    robot, turn = preset("swerve"), 2.0
    rolled = roll(robot, pivoting((0.5, 0.0), angle=turn))
    for i, castor in enumerate(robot.castors):
        arm = np.hypot(castor.pivot[0] - 0.5, castor.pivot[1])
        wheel = sum(len(castor.wheels) for castor in robot.castors[:i])
        assert abs(rolled.wheel_angle[-1, wheel]) * castor.wheels[0].radius == pytest.approx(arm * turn)


def test_what_nothing_turns_and_fixed_wheels_that_would_slip_are_refused():
    with pytest.raises(InputError, match="nothing turns castor 1"):
        roll(dataclasses.replace(preset("swerve"), castors=(UNTURNED,)), umbmark())
    with pytest.raises(InputError, match="slip sideways"):
        roll(preset("differential"), umbmark("ccw", "fixed"))


@given(seed=st.integers(0, 2**32 - 1))
def test_encoders_never_lose_a_remainder(seed):
    random = np.random.default_rng(seed)
    geometry = Geometry.of(preset("asoc-prototype"))
    phase = Encoders.random_phase(geometry, random)
    angle = np.cumsum(random.normal(0, 0.01, (200, 6)), axis=0)
    counts = Encoders(geometry, phase).wheel(angle)
    exact = angle * 1200 / (2 * np.pi) + phase
    assert np.max(np.abs(counts - exact)) <= 0.5
    theta = random.uniform(-20, 20, (50, 3))
    believed = castor_angles(geometry, Encoders(geometry, phase).pivot(theta))
    error = np.angle(np.exp(1j * (believed - theta)))
    assert np.max(np.abs(error)) <= np.pi / 5143 * (1 + 1e-9)


AHEAD = Leg((1.0, 0.0, 0.0), 1.0)


@pytest.mark.parametrize(
    "made",
    [
        lambda: Leg((1.0, 0.0), 1.0),
        lambda: Leg((1.0, 0.0, math.nan), 1.0),
        lambda: Leg((1.0, 0.0, 0.0), -1.0),
        lambda: Leg((1.0, 0.0, 0.0), math.inf),
        lambda: Leg((1.0, 0.0, "0"), 1.0),
        lambda: Run((), 0.2, 0.5),
        lambda: Run((Leg((1.0, 0.0, 0.0), 0.0),), 0.2, 0.5),
        lambda: Run(((1.0, 0.0, 0.0),), 0.2, 0.5),
        lambda: Run((AHEAD,), -0.2, 0.5),
        lambda: Run((AHEAD,), 0.2, 0.0),
        lambda: Run((AHEAD,), math.nan, 0.5),
        lambda: Trajectory("none", ()),
        lambda: Trajectory("no runs", (AHEAD,)),
        lambda: Trajectory("nowhere", (Run((AHEAD,), 0.2, 0.5),), (0.0, math.nan, 0.0)),
        lambda: Trajectory("flat", (Run((AHEAD,), 0.2, 0.5),), (0.0, 0.0)),
    ],
)
def test_what_nobody_can_drive_is_refused_where_it_is_made(made):
    with pytest.raises(InputError, match=r"needs|must be|start is"):
        made()
