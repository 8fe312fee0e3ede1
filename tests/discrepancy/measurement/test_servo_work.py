"""What commands tell of a slope: against commands made by Newton's law, and against physics."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from castor_envs.effects.floor import FloorSlope
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.measurement.servo_work import pull_of
from discrepancy.posterior.calibrated import SIGNATURE
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("differential")
SLOPES = [candidate for candidate in candidates_of(ROBOT) if isinstance(candidate.kinds[0], FloorSlope)]
GRAVITY, GAIN = 9.81, {False: 4.0, True: 40.0}
"""m/s2; and the gain of servos, N m for each rad/s or, if they integrate, for each rad."""


@cache
def rolled():
    return roll(ROBOT, wander(np.random.default_rng(0), duration=40.0, holonomic=False))


def commanded(slope, *, integrates, backward=False):
    """Return the log of servos that carry the torques of Newton's law on a slope (2,), and the motion; backward: with
    the robot turned by half a turn, so that it drives the same way backward."""
    run, (wheel, _), castor = rolled(), ROBOT.wheels, ROBOT.castors[0]
    forth, turn = (-1, np.pi) if backward else (1, 0.0)
    angle = forth * (run.wheel_angle[:, ::forth] - run.wheel_angle[0, ::forth])
    pose = run.pose + np.array([0.0, 0.0, turn])

    def rate(of):
        return np.gradient(of, run.t, axis=0)

    along = np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    force = (ROBOT.mass + castor.mass) * np.sum((rate(rate(pose[:, :2])) + GRAVITY * np.array(slope)) * along, axis=1)
    moment = (ROBOT.inertia + castor.inertia) * rate(rate(pose[:, 2])) / (2 * wheel.lateral)
    torque = wheel.radius * np.column_stack([force / 2 - moment, force / 2 + moment]) + wheel.inertia * rate(
        rate(angle)
    )
    period = np.diff(run.t)[:, None]
    behind = np.diff(torque, axis=0) / period if integrates else (torque[1:] + torque[:-1]) / 2
    command = np.diff(angle, axis=0) / period + behind / GAIN[integrates]
    log = Log(run.t, angle, np.zeros((len(angle), 0)), np.vstack([command, command[-1:]]))
    return log, Motion(run.t, pose, angle, run.castor_angle)


def estimate(log, moved):
    pull = pull_of(ROBOT, log, moved, SLOPES)
    return np.linalg.solve(pull.information, pull.score)


@pytest.mark.parametrize("integrates", [False, True])
@pytest.mark.parametrize("slope", [(0.01, 0.0), (0.0, 0.01), (0.002, -0.03)])
def test_slope_is_that_of_newtons_law(integrates, slope):
    assert estimate(*commanded(slope, integrates=integrates)) == pytest.approx(slope, abs=SIGNATURE * np.hypot(*slope))


@pytest.mark.parametrize("integrates", [False, True])
def test_estimate_has_the_sign_of_the_slope_whether_the_robot_drives_forward_or_backward(integrates):
    up, down = (estimate(*commanded((sign * 0.01, 0.0), integrates=integrates)) for sign in (1, -1))
    backward = estimate(*commanded((0.01, 0.0), integrates=integrates, backward=True))
    assert up == pytest.approx(-down, abs=SIGNATURE * 0.01)
    assert backward == pytest.approx(up, rel=1e-6)


@pytest.mark.parametrize("integrates", [False, True])
def test_friction_and_constant_errors_are_no_slope(integrates):
    log, moved = commanded((0.01, 0.0), integrates=integrates)
    errors = 0.05 * np.sign(np.diff(log.wheel, axis=0)) + [0.02, -0.03]  # of what wheels are behind
    if integrates:
        errors = np.diff(errors, axis=0, prepend=0.0) / np.diff(log.t)[:, None]
    assert log.command is not None
    disturbed = replace(log, command=log.command + np.vstack([errors, errors[-1:]]))
    assert estimate(disturbed, moved) == pytest.approx([0.01, 0.0], abs=5e-4)


@pytest.mark.parametrize("integrates", [False, True])
@pytest.mark.parametrize("blank", ["at random", "for a second", "for five seconds"])
def test_blank_commands_say_nothing(integrates, blank):
    log, moved = commanded((0.01, 0.0), integrates=integrates)
    rows = {
        "at random": np.random.default_rng(1).choice(len(log), len(log) // 20, replace=False),
        "for a second": np.arange(300, 320),
        "for five seconds": np.arange(300, 400),
    }[blank]
    assert log.command is not None
    command = log.command.copy()
    command[rows, 0] = np.nan
    assert estimate(replace(log, command=command), moved) == pytest.approx([0.01, 0.0], abs=5e-4)


@pytest.mark.parametrize("integrates", [False, True])
@pytest.mark.parametrize("missing", [5, 20, 100])
def test_gaps_of_a_log_say_nothing(integrates, missing):
    log, moved = commanded((0.01, 0.0), integrates=integrates)
    kept = np.delete(np.arange(len(log)), np.arange(300, 300 + missing))
    assert log.command is not None
    shorter = Log(log.t[kept], log.wheel[kept], log.pivot[kept], log.command[kept])
    pose, wheel, castor = (of[kept] for of in (moved.pose, moved.wheel_angle, moved.castor_angle))
    assert estimate(shorter, Motion(moved.t[kept], pose, wheel, castor)) == pytest.approx([0.01, 0.0], abs=5e-4)


@pytest.mark.parametrize("slope", [0.0, 0.03])
def test_errors_are_as_large_as_stated(slope):
    """Noise of 0.5 rad/s in the commands of a proportional servo leaves its compliance uncertain by a tenth."""
    log, moved = commanded((slope, 0.0), integrates=False)
    random, squares = np.random.default_rng(0), []
    for _ in range(20):
        assert log.command is not None
        noisy = replace(log, command=log.command + random.normal(0.0, 0.5, log.command.shape))
        pull = pull_of(ROBOT, noisy, moved, SLOPES)
        off = np.linalg.solve(pull.information, pull.score) - [slope, 0.0]
        squares.append(off @ pull.information @ off)
    assert chi2.ppf(0.005, 40) < np.sum(squares) < chi2.ppf(0.995, 40)


def test_nothing_is_said_without_commands_or_where_wheels_do_as_commanded():
    log, moved = commanded((0.01, 0.0), integrates=False)
    silent = pull_of(ROBOT, replace(log, command=None), moved, SLOPES)
    assert not silent.information.any()
    assert not silent.score.any()
    count = 2 * np.pi / 2000
    moved = replace(moved, wheel_angle=count * np.round(log.wheel / count))
    exact = np.diff(log.wheel, axis=0) / np.diff(log.t)[:, None]
    pull = pull_of(ROBOT, replace(log, command=np.vstack([exact, exact[-1:]])), moved, SLOPES)
    assert 0.01**2 * np.linalg.eigvalsh(pull.information).max() < 1


@cache
def driven(name, slope=0.0, seed=1):
    robot = preset(name)
    course = motion(robot, "wander", seed, 40.0)
    return robot, drive(robot.with_effects(FloorSlope(direction="x", value=slope)), course, seed, duration=40.0)


@pytest.mark.parametrize("name", ["differential", "asoc-prototype", "tricycle"])
def test_a_slope_is_as_steep_as_commands_say_to_within_the_error(name):
    """Commands step at each sample, and wheels follow within it: 7 % too steep with the mean of a sample's ends."""
    robot, log = driven(name, 0.09)
    (seen,) = linearise(robot.with_effects(FloorSlope(direction="x", value=0.09)), [log]).pulls
    slopes = np.flatnonzero(np.diag(seen.information))
    off = np.linalg.solve(seen.information[np.ix_(slopes, slopes)], seen.score[slopes])
    error = np.sqrt(np.diag(np.linalg.inv(seen.information[np.ix_(slopes, slopes)])))
    assert np.all(np.abs(off) < 2.5 * error)
    assert np.all(error < 0.03 * 0.09)


def test_commands_name_a_slope_that_is_unseen_without_them():
    slope = -0.01
    robot, log = driven("differential", slope)
    (answer,) = diagnose(robot, [log]).answers
    assert (answer.verdict, answer.credible) == ("named", ("floor_slope x",))
    assert answer.size == pytest.approx(slope, rel=0.15)
    assert not diagnose(robot, [replace(log, command=None)]).answers


@pytest.mark.parametrize("name", ["differential", "omnimate", "asoc-prototype", "tricycle", "swerve"])
def test_commands_of_robots_in_good_order_on_an_even_floor_show_no_slope(name):
    robot, log = driven(name)
    (pull,) = linearise(robot, [log], among=()).pulls
    assert -2 * pull.log_likelihood < chi2.ppf(0.99, 2)
    answers = diagnose(robot, [log]).answers
    assert not any(name.startswith("floor_slope") for answer in answers for name in answer.credible)
