"""With exact encoders, estimates converge to the true pose as samples come faster, at the order theory gives."""

import numpy as np
import pytest

from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.vehicles.presets import differential, preset, preset_names
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from estimators import CAST, IPEC, CASTArc, DeadReckoning, HolmbergKhatib, TidyBot, WheelOdometry
from estimators.steps.castor_odometry import CastorSteps, Step, castor_records, castor_steps

pytestmark = pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")


def moved(records, observation, step: Step = "arc"):
    """Return the steps of a robot's castors, each part (n,)."""
    steps = castor_steps(records[None], observation["wheel"][None], observation["pivot"][None], step)
    return CastorSteps(*(part[0] for part in steps))


def order(estimator, motion, drive):
    """Return the order of convergence of the end pose in position and heading, from 200, 400 and 800 steps."""
    errors = []
    for steps in (200, 400, 800):
        true, observations = motion.sampled(steps)
        error = drive(estimator, motion.robot, observations, true[0])[-1] - true[-1]
        errors.append([np.hypot(*error[:2]), abs(error[2])])
    (coarse, middle, fine) = np.maximum(errors, 1e-13)
    assert np.all(fine < 0.01)
    return np.log2(middle / fine), np.log2(coarse / middle)


@pytest.fixture(scope="module", name="motions")
def _motions():
    return {}


@pytest.fixture(name="motion_of")
def _motion_of(motions, odd_robot, exact_motion, winding):
    def motion_of(centred):
        if centred not in motions:
            motions[centred] = exact_motion(odd_robot(3, centred), winding, 4.0, pose=(1.0, -2.0, 0.5))
        return motions[centred]

    return motion_of


@pytest.mark.parametrize(
    ("estimator", "centred"),
    [
        (DeadReckoning(1), False),
        (DeadReckoning(3), False),
        (IPEC(1), False),
        (IPEC(2), False),
        (CAST(0), True),
        (CASTArc(0), False),
        (CASTArc(3), False),
        (CASTArc(0, step="midpoint"), True),
        (CAST(0, step="midpoint"), True),
        (HolmbergKhatib(), False),
    ],
    ids=lambda value: f"{type(value).__name__}-{vars(value)}" if hasattr(value, "step") else "",
)
def test_second_order(estimator, centred, motion_of, drive):
    for slopes in order(estimator, motion_of(centred), drive):
        np.testing.assert_allclose(slopes[0], 2.0, atol=0.25)


def test_of_castors_that_the_floor_turns_the_third_order_is_left(motion_of, drive):
    """They follow a tractrix, whose direction turns as much as it did in the sample before."""
    for slopes in order(WheelOdometry(), motion_of(False), drive):
        np.testing.assert_allclose(slopes[0], 3.0, atol=0.25)


@pytest.mark.parametrize(
    ("estimator", "centred"),
    [
        (CAST(0), False),
        (CAST(1), True),
        (CAST(0, step="euler"), True),
        (CAST(0, step="euler-axle"), True),
        (CASTArc(0, step="euler"), True),
        (IPEC(1, step="euler"), True),
        (DeadReckoning(2, step="euler"), True),
        (TidyBot(), False),
    ],
    ids=lambda value: f"{type(value).__name__}-{vars(value)}" if hasattr(value, "step") else "",
)
def test_first_order(estimator, centred, motion_of, drive):
    """A body origin off the centroid of the pivots costs CAST an order (its small angle); so does Euler's step."""
    for slopes in order(estimator, motion_of(centred), drive):
        np.testing.assert_allclose(slopes[0], 1.0, atol=0.25)


def test_heading_of_a_single_castor_is_exact_at_any_period(odd_robot, exact_motion, winding, drive):
    """It is a sum of changes that the encoders give exactly."""
    motion = exact_motion(odd_robot(3), winding, 10.0)
    true, observations = motion.sampled(40)
    np.testing.assert_allclose(drive(DeadReckoning(2), motion.robot, observations)[:, 2], true[:, 2], atol=1e-9)


def forward(t):
    """A smooth twist without sideways speed, that never lets a pivot stand."""
    return 0.5 + 0.1 * np.sin(0.7 * t), 0.0, 0.3 * np.sin(1.1 * t + 0.4)


def askew(t):
    """A smooth twist with all three components."""
    return 0.5 + 0.1 * np.sin(0.7 * t), 0.2 * np.cos(0.9 * t), 0.3 * np.sin(1.1 * t + 0.4)


@pytest.mark.parametrize("estimator", [WheelOdometry(), HolmbergKhatib()], ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("name", preset_names())
def test_wheel_odometry_follows_every_robot_to_second_order(name, estimator, exact_motion, drive):
    """To a higher one where the floor turns castors and it follows their tractrices."""
    robot = preset(name)
    motion = exact_motion(robot, askew if moves_sideways(robot) else forward, 4.0, pose=(1.0, -2.0, 0.5))
    errors = []
    for steps in (50, 100, 200):
        true, observations = motion.sampled(steps)
        errors.append(np.abs(drive(estimator, robot, observations, true[0]) - true)[:, :2].max())
    assert errors[2] < 1e-3
    if errors[0] > 1e-9:  # constant wheel speeds are followed exactly at any period
        geometry = Geometry.of(robot)
        if type(estimator) is WheelOdometry and (geometry.trailing & ~geometry.driven & ~geometry.fixed).any():
            assert np.log2(errors[0] / errors[2]) / 2 > 2.5
        else:
            assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize("name", ["swerve", "powered-caster", "tricycle", "omni3", "differential"])
def test_a_circle_is_followed_exactly_at_any_period(name, exact_motion, drive):
    """All pivots run on circles, steered castors do not turn against the body, half a radian of turn a sample."""
    robot, twist = preset(name), (0.4, 0.0, 0.6)
    trailing = zip(robot.castors, steady(robot, twist), strict=True)
    theta = [castor.angle if castor.steering == "fixed" else angle for castor, angle in trailing]
    motion = exact_motion(robot, lambda t: twist, 5.0, theta=theta, pose=(1.0, 1.0, 1.0))
    true, observations = motion.sampled(6)
    np.testing.assert_allclose(drive(WheelOdometry(), robot, observations, true[0]), true, atol=1e-9)


def steady(robot, twist):
    """Return the angles of castors that have long trailed at a constant twist: their sideways speed is omega offset."""
    angles = []
    for castor in robot.castors:
        u = complex(twist[0], twist[1]) + 1j * twist[2] * complex(*castor.pivot)
        angles.append(np.angle(u) - np.arcsin(twist[2] * castor.offset / abs(u)))
    return angles


@pytest.mark.parametrize("twist", [(0.3, 0.0, 0.0), (0.3, -0.2, 0.8), (0.0, 0.25, -1.0), (-0.4, 0.1, 0.5)])
@pytest.mark.parametrize("estimator", [CASTArc(), CASTArc(2), IPEC(3), DeadReckoning(1), WheelOdometry()])
def test_constant_twist_in_steady_trailing_is_followed_exactly(twist, estimator, odd_robot, exact_motion, drive):
    """All pivots then run on circles at constant rates: no matter that the body turns half a radian a sample."""
    robot = odd_robot(3, centred=False)
    motion = exact_motion(robot, lambda t: twist, 5.0, theta=steady(robot, twist), pose=(1.0, 1.0, 1.0))
    true, observations = motion.sampled(10)
    np.testing.assert_allclose(drive(estimator, robot, observations, true[0]), true, atol=1e-9)


@pytest.mark.parametrize("turn", [0.02, 0.3, 0.9])
def test_small_angle_assumption_makes_cast_turn_by_the_sine(turn, exact_motion, drive):
    """sum q x (Rot(turn) q - q) / sum q^2 = sin(turn): what eqs. 13-14 leave out, and all they leave out, in psi."""
    robot = preset("asoc-prototype")
    twist = (0.3, 0.1, turn)
    motion = exact_motion(robot, lambda t: twist, 1.0, theta=steady(robot, twist))
    true, observations = motion.sampled(1)
    estimate = drive(CAST(), robot, observations)[-1]
    np.testing.assert_allclose(estimate[2], np.sin(turn), atol=1e-9)
    np.testing.assert_allclose(estimate[:2], true[-1, :2], atol=1e-9)


@pytest.mark.parametrize("estimator", [DeadReckoning(), IPEC(1), CAST(), CASTArc(), WheelOdometry()])
def test_heading_is_unwrapped_over_many_turns(estimator, exact_motion, drive):
    robot = preset("asoc-prototype")
    motion = exact_motion(robot, lambda t: (0.2, 0.1, 2.0), 20.0)
    true, observations = motion.sampled(2000)
    estimate = drive(estimator, robot, observations, (0.0, 0.0, 3.0))
    np.testing.assert_allclose(estimate[:, 2], true[:, 2] + 3.0, atol=5e-3)


def test_differential_drive_with_its_axle_behind_and_askew_converges(exact_motion, drive):
    """A fixed castor anywhere: dead reckoning reports the body's origin, not the axle's middle."""
    angle, offset = 0.4, 0.1
    pivot = complex(0.2, -0.3)
    castor = Castor(
        pivot=(pivot.real, pivot.imag),
        steering="fixed",
        angle=angle,
        offset=offset,
        wheels=(Wheel(lateral=0.2, radius=0.05), Wheel(lateral=-0.15, radius=0.06)),
    )
    robot = RobotDescription(name="askew", castors=(castor,))
    foot = pivot - offset * np.exp(1j * angle)

    def twist(t):
        omega = 0.8 * np.sin(t)
        velocity = (0.3 + 0.1 * np.cos(t)) * np.exp(1j * angle) - 1j * omega * foot
        return velocity.real, velocity.imag, omega

    motion = exact_motion(robot, twist, 4.0)
    for slopes in order(DeadReckoning(), motion, drive):
        np.testing.assert_allclose(slopes[0], 2.0, atol=0.25)


def test_dead_reckoning_of_a_differential_drive_is_the_textbook_arc(noise, drive):
    """Centre of the wheels on a circle of radius (s_l + s_r) / 2 / turn about a point on the axle's line."""
    robot = differential(radius=0.1, track=0.4, counts_per_rev=1000.0)
    observations = noise(robot, steps=50, counts=200)
    x, y, psi = 0.3, 0.4, 0.5
    expected = []
    for observation in observations:
        left, right = observation["wheel"] / 1000.0 * 2 * np.pi * 0.1
        turn, ahead = (right - left) / 0.4, (right + left) / 2
        if turn == 0:
            x, y = x + ahead * np.cos(psi), y + ahead * np.sin(psi)
        else:
            radius = ahead / turn
            x += radius * (np.sin(psi + turn) - np.sin(psi))
            y -= radius * (np.cos(psi + turn) - np.cos(psi))
        psi += turn
        expected.append((x, y, psi))
    np.testing.assert_allclose(drive(DeadReckoning(), robot, observations, (0.3, 0.4, 0.5)), expected, atol=1e-10)


@pytest.mark.parametrize(("step", "at"), [("midpoint", 0.5), ("euler", 1.0)])
def test_straight_steps_go_along_the_heading_they_are_named_for(step, at, noise, drive):
    robot = differential(radius=0.1, track=0.4, counts_per_rev=1000.0)
    observations = noise(robot, steps=2, counts=200)
    left, right = observations[1]["wheel"] / 1000.0 * 2 * np.pi * 0.1
    turn, ahead = (right - left) / 0.4, (right + left) / 2
    direction = 0.5 + at * turn
    expected = [ahead * np.cos(direction), ahead * np.sin(direction), 0.5 + turn]
    estimate = drive(DeadReckoning(step=step), robot, observations, (0.0, 0.0, 0.5))[-1]
    np.testing.assert_allclose(estimate, expected, atol=1e-12)


@pytest.mark.parametrize("step", ["euler", "euler-axle"])
def test_a_pivot_ahead_of_its_axle_swings_across_the_end_heading_or_exactly(step, noise):
    """From heading theta the axle rolls s along the heading after a turn; the offset goes from one to the other."""
    robot = preset("asoc-prototype")
    still, moving = noise(robot, steps=2, counts=100)
    records = castor_records(Geometry.of(robot), (0, 1, 2))
    moved(records, still)
    found = moved(records, moving, step)
    left, right = (moving["wheel"] / 1200 * 2 * np.pi * 0.0381).reshape(3, 2).T
    turn, ahead = (right - left) / 0.116, (right + left) / 2
    before = np.exp(1j * still["pivot"] / 5143 * 2 * np.pi)
    after = before * np.exp(1j * turn)
    swing = {"euler": 1j * after * turn, "euler-axle": after - before}[step]
    np.testing.assert_allclose(found.x + 1j * found.y, ahead * after + 0.072 * swing, atol=1e-14)
