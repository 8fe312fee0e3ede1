"""The official tasks, against an implementation of the square, the encoders and the estimators that shares no code."""

# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportOptionalSubscript=false

import cmath
import math
import re

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks import official_tasks
from benchmarks.tasks.driving.task import DrivenRobot
from benchmarks.tasks.driving.trains import DrivenTrain
from benchmarks.tasks.kinematic import CALIBRATED, UNCALIBRATED, tasks
from benchmarks.tasks.task import Task, odometry_of
from castor_envs.vehicles.presets import preset
from estimators.robots.cast import CAST
from estimators.robots.ipec import IPEC

UNCALIBRATED_TASK, CALIBRATED_TASK = tasks(None)


def square_twist(t, sense):
    """Body twist at time t: 6.5 s a side (0.25 m/s, 0.5 m/s2), 2.5 s a turn (45 deg/s, 90 deg/s2)."""
    t = t % 9.0
    if t < 6.5:
        return min(0.25, 0.5 * t, 0.5 * (6.5 - t)), 0.0
    t -= 6.5
    return 0.0, sense * math.radians(min(45.0, 90.0 * t, 90.0 * (2.5 - t)))


def roll_square(robot, sense, steps_a_second=2000):
    """Roll the square with fixed-step midpoint integration; return castor and wheel angles every 50 ms."""
    pivots = [complex(*castor.pivot) for castor in robot.castors]
    theta = [0.0] * 3
    wheel = [0.0] * 6
    samples = [([*theta], [*wheel])]
    h = 1 / steps_a_second

    def castor_rate(i, angle, v, omega):
        u = v + omega * 1j * pivots[i]
        local = u * cmath.exp(-1j * angle)
        turning = local.imag / robot.castors[i].offset
        return turning - omega, local.real, turning

    for k in range(36 * steps_a_second):
        v, omega = square_twist((k + 0.5) * h, sense)
        for i, castor in enumerate(robot.castors):
            rate, _, _ = castor_rate(i, theta[i], v, omega)
            rate, along, turning = castor_rate(i, theta[i] + 0.5 * h * rate, v, omega)
            theta[i] += h * rate
            for j, w in enumerate(castor.wheels):
                wheel[2 * i + j] += h * (along - turning * w.lateral) / w.radius
        if (k + 1) % (steps_a_second // 20) == 0:
            samples.append(([*theta], [*wheel]))
    return np.array([s[0] for s in samples]), np.array([s[1] for s in samples])


def castor_steps(robot, counts, pivots, k, psi, chosen):
    """Pivot displacements of the chosen castors from sample k - 1 to k, as complex numbers in N."""
    for i in chosen:
        left, right = robot.castors[i].wheels
        s = [
            (counts[k, 2 * i + j] - counts[k - 1, 2 * i + j]) * 2 * math.pi / 1200 * w.radius
            for j, w in enumerate((left, right))
        ]
        turn = (s[1] - s[0]) / (left.lateral - right.lateral)
        ahead = s[0] + turn * left.lateral
        heading = psi + pivots[k - 1, i] * 2 * math.pi / 5143
        start, end = cmath.exp(1j * heading), cmath.exp(1j * (heading + turn))
        arc = ahead * start if abs(turn) < 1e-12 else ahead * (end - start) / (1j * turn)
        yield i, arc + robot.castors[i].offset * (end - start)


def least_squares_odometry(robot, counts, pivots, chosen):
    """Doebbler eqs. 13-17, solved by a general least-squares routine."""
    x, y, psi = 0.0, 0.0, 0.0
    for k in range(1, len(counts)):
        rows, right = [], []
        for i, step in castor_steps(robot, counts, pivots, k, psi, chosen):
            arm = complex(*robot.castors[i].pivot) * cmath.exp(1j * psi)
            rows += [[1.0, 0.0, -arm.imag], [0.0, 1.0, arm.real]]
            right += [step.real, step.imag]
        dx, dy, turn = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]
        x, y, psi = x + dx, y + dy, psi + turn
    return np.array([x, y, psi])


def two_castor_odometry(robot, counts, pivots, chosen):
    """IPEC: the heading is the bearing from one pivot to the other (Doebbler eq. 10)."""
    first, second = (complex(*robot.castors[i].pivot) for i in chosen)
    at, psi = first, 0.0
    for k in range(1, len(counts)):
        (_, first_step), (_, second_step) = castor_steps(robot, counts, pivots, k, psi, chosen)
        baseline = (second - first) * cmath.exp(1j * psi) + second_step - first_step
        psi += cmath.phase(baseline / (second - first) * cmath.exp(-1j * psi))
        at += first_step
    centre = at - first * cmath.exp(1j * psi)
    return np.array([centre.real, centre.imag, psi])


def run(estimator, robot, log):
    estimator.reset(robot, np.zeros(3))
    for observation in log.observations():
        pose = estimator.update(observation)
    return pose


@pytest.fixture(scope="module", params=["cw", "ccw"])
def rolled(request):
    return request.param, *roll_square(preset("asoc-prototype"), 1.0 if request.param == "ccw" else -1.0)


def test_the_encoders_count_what_an_independent_roll_turns(rolled, recorded):
    direction, theta, wheel = rolled
    for case in (0, 1):
        for square in recorded(CALIBRATED_TASK, case).runs:
            if square.direction != direction:
                continue
            log = square.log
            exact = wheel * 1200 / (2 * math.pi)
            phase = log.wheel - exact
            # One phase in [0, 1) explains every count of a channel: round(exact + phase).
            assert np.all(phase.max(axis=0) - phase.min(axis=0) < 1.0 + 1e-3)
            assert np.all(phase > -0.5 - 1e-3)
            assert np.all(phase < 1.5 + 1e-3)
            turned = np.exp(1j * (log.pivot * 2 * math.pi / 5143 - theta))
            assert np.max(np.abs(np.angle(turned))) < math.pi / 5143 * 1.01


@pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")
@pytest.mark.parametrize("task", [UNCALIBRATED_TASK, CALIBRATED_TASK], ids=lambda task: task.name)
def test_estimators_agree_with_an_independent_implementation(task, recorded):
    for case in range(2):
        episode = recorded(task, case)
        for square in (episode.runs[0], episode.runs[-1]):
            log, robot = square.log, episode.robot
            zeros = np.array([castor.pivot_zero for castor in robot.castors]) * 5143 / (2 * math.pi)
            pivots = log.pivot - zeros
            for estimator, expected in (
                (CAST(left_out=0), least_squares_odometry(robot, log.wheel, pivots, [0, 1, 2])),
                (CAST(left_out=1), least_squares_odometry(robot, log.wheel, pivots, [1, 2])),
                (IPEC(left_out=1), two_castor_odometry(robot, log.wheel, pivots, [1, 2])),
            ):
                np.testing.assert_allclose(run(estimator, robot, log), expected, atol=1e-9)


def test_parameter_errors_have_table_ones_means():
    """Doebbler, Table I, in per cent: r_c 0.21 and 0.09, r_w 2.07 and 0.04, d 0.89 and 0.04; beta 0 and 0.01 deg."""
    robot = preset("asoc-prototype")
    for errors, expected in (
        (UNCALIBRATED, (0.21, 2.07, 0.89, 0.0)),
        (CALIBRATED, (0.09, 0.04, 0.04, 0.01)),
    ):
        described = [errors.applied(robot, np.random.default_rng(seed)) for seed in range(400)]
        castors = [castor for robot in described for castor in robot.castors]
        wheels = [wheel for castor in castors for wheel in castor.wheels]
        means = (
            np.mean([abs(castor.offset / 0.072 - 1) for castor in castors]) * 100,
            np.mean([abs(wheel.radius / 0.0381 - 1) for wheel in wheels]) * 100,
            np.mean([abs(abs(wheel.lateral) / 0.058 - 1) for wheel in wheels]) * 100,
            np.degrees(np.mean([abs(castor.pivot_zero) for castor in castors])),
        )
        np.testing.assert_allclose(means, expected, rtol=0.06)


def test_official_tasks_are_named_apart_and_scored_by_a_known_metric():
    tasks = official_tasks(None)
    assert len({task.name for task in tasks}) == len(tasks) >= 7
    for task in tasks:
        assert isinstance(task, Task)
        assert re.fullmatch("[a-z0-9]+(-[a-z0-9]+)*", task.group)
        assert task.metric in BOARD_METRICS
        assert (task.missing is not None) == ("measured" in task.name)


SLOW = {"umbmark-physics-cables", "umbmark-physics-slippery"}
"""Tasks that take the longest to record, each of a kind with a quicker one."""

ALIKE = {"train-3-patch", "train-5-patch", "train-5-cables"}
"""Tasks with more axles, which are recorded by the code of train-2-patch, train-2-cables and train-3-cables."""


@pytest.mark.parametrize(
    "task",
    [
        pytest.param(task, id=task.name, marks=[pytest.mark.slow] * (task.name in SLOW))
        for task in official_tasks(None)
        if task.missing is None and odometry_of(task) is None and task.name not in ALIKE
        if not isinstance(task, DrivenRobot | DrivenTrain)
    ],
)
def test_an_episode_repeats_bit_for_bit(task, recorded):
    """Those of calibration tasks: tests/benchmarks/tasks/test_calibration_tasks.py, of drives: driving/."""
    first, second = task.cases(2)
    assert task.record(first).digest == recorded(task, first).digest != recorded(task, second).digest


def test_a_recorded_square_is_what_the_environment_gives_an_agent(recorded):
    """The benchmark's logs and a hand-written loop over the environment lead an estimator to the same estimate."""
    task = next(task for task in official_tasks(None) if task.name == "umbmark-physics-clean")
    episode = recorded(task, 0)
    env = gym.make("castor/UMBmark-v0", direction="cw")
    seed = int(np.random.SeedSequence([0, 2, 0, 0]).generate_state(1)[0])
    observation, info = env.reset(seed=seed)
    agent, done = CAST(left_out=0), False
    agent.reset(episode.robot, info["pose"])
    while not done:
        estimate = agent.update(observation)
        observation, _, done, _, info = env.step(estimate)
    np.testing.assert_array_equal(estimate, run(CAST(left_out=0), episode.robot, episode.runs[0].log))
    np.testing.assert_array_equal(info["pose"], episode.runs[0].log.reference[-1])
