"""Tasks of driven robots: repeatable, of robots that nobody knows, with a ceiling that is one."""

import dataclasses

import numpy as np
import pytest

from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.path_metrics import drift
from benchmarks.scoring.registry import score
from benchmarks.tasks import official_tasks
from benchmarks.tasks.driving import task as driving
from benchmarks.tasks.driving.fixes import with_fixes
from benchmarks.tasks.driving.task import KINDS, ROBOTS
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from estimators import load_estimator

TASKS = {task.name: task for task in official_tasks()}
OTHERS = 800_000


def ate(episode, poses):
    return score(episode, [poses])["ate"]


def test_every_kind_is_driven_by_every_robot_and_by_name_alone():
    for kind in KINDS:
        for robot in ROBOTS:
            task = TASKS[f"{kind.name}-{robot}"]
            assert task.group == kind.name
            assert not task.standard


@pytest.mark.parametrize("kind", [kind.name for kind in KINDS])
def test_a_case_is_the_same_every_time_and_none_is_another(kind, monkeypatch):
    """Of whatever length: here they are shorter."""
    monkeypatch.setattr(driving, "WAY", 20.0)
    monkeypatch.setattr(driving, "MINUTE", 20.0)
    task = TASKS[f"{kind}-differential"]
    first = task.record(OTHERS).digest
    assert first == task.record(OTHERS).digest
    assert first != task.record(OTHERS + 1).digest


@pytest.mark.parametrize("robot", ROBOTS)
def test_robot_files_state_tolerances_and_not_the_true_robot(robot):
    for kind in ("manoeuvres", "drawings"):
        described = TASKS[f"{kind}-{robot}"].record(OTHERS).robot
        assert isinstance(described, RobotDescription)
        assert described.tolerances is not None
        assert dataclasses.replace(described, tolerances=None) == preset(ROBOTS[robot])


@pytest.mark.parametrize("robot", ["prototype", "swerve", "tricycle"])
def test_the_oracle_beats_odometry(robot):
    ratio = []
    for case in range(OTHERS, OTHERS + 4):
        episode = TASKS[f"bursts-{robot}"].record(case)
        estimates = estimate_singly(
            "wheel-odometry", load_estimator("wheel-odometry").source_hash, observed_runs(episode)
        )
        assert not isinstance(estimates, Failure)
        (run,) = episode.runs
        assert run.oracle is not None
        ratio.append(ate(episode, run.oracle) / ate(episode, estimates[0].poses))
    assert np.median(ratio) < 0.5


def test_a_gyro_is_seen_and_its_bias_is_not():
    episode = TASKS["gyro-differential"].record(OTHERS)
    assert isinstance(episode.robot, RobotDescription)
    assert episode.robot.gyro is not None
    assert episode.robot.gyro.bias == 0.0
    (run,) = episode.runs
    assert run.log.gyro is not None
    assert run.log.reference is not None
    turned = np.diff(run.log.reference[:, 2]) / np.diff(run.log.t)
    assert abs(np.mean(run.log.gyro[1:] - turned)) > 1e-4


def test_fixes_are_sparse_late_and_some_wrong_and_the_oracle_gets_the_right_ones():
    errors, ages, gaps = [], [], []
    for case in range(12):
        true = np.stack([np.linspace(0.0, 9.0, 1201), np.zeros(1201), np.linspace(0.0, 3.0, 1201)], axis=-1)
        wheel = np.zeros((1201, 2))
        log = Log(t=0.05 * np.arange(1201), wheel=wheel, pivot=np.zeros((1201, 0)), reference=true)
        seen, right = with_fixes(log, np.random.default_rng(case))
        assert seen.fix is not None
        assert seen.fix_age is not None
        assert right.fix is not None
        came = np.flatnonzero(~np.isnan(seen.fix).any(axis=1))
        then = np.stack([np.interp(log.t - seen.fix_age, log.t, column)[came] for column in true.T], axis=-1)
        error = seen.fix[came] - then
        wrong = np.isnan(right.fix[came, 0])
        assert (np.abs(error[~wrong]) < 0.06).all()
        errors += [np.append(row, is_wrong) for row, is_wrong in zip(error, wrong, strict=True)]
        ages += seen.fix_age[came].tolist()
        gaps += np.diff(log.t[came]).tolist()
    errors = np.array(errors)
    wrong = errors[:, 3] == 1
    assert np.mean(gaps) == pytest.approx(5.0, rel=0.2)
    assert 0.0 <= min(ages) < 0.15 < 0.45 < max(ages) < 0.5
    assert 0.005 < np.mean(wrong) < 0.12
    np.testing.assert_allclose(np.std(errors[~wrong, :3], axis=0), 0.01, rtol=0.2)
    assert np.median(np.hypot(*errors[wrong, :2].T)) > 0.3


def test_one_fix_of_twenty_is_wrong():
    """Of some 20,000 fixes, within three standard errors."""
    t = 0.5 * np.arange(200_001)
    log = Log(t=t, wheel=np.zeros((len(t), 2)), pivot=np.zeros((len(t), 0)), reference=np.zeros((len(t), 3)))
    seen, right = with_fixes(log, np.random.default_rng(1))
    assert seen.fix is not None
    assert right.fix is not None
    came = ~np.isnan(seen.fix[:, 0])
    assert np.mean(np.isnan(right.fix[came, 0])) == pytest.approx(1 / 20, abs=3 * np.sqrt(0.05 * 0.95 / came.sum()))


@pytest.mark.parametrize("robot", ["omni", "differential"])
def test_the_filter_makes_use_of_fixes(robot):
    """Some are late and some are wrong; where no wheel is redundant, slip is seen by them alone."""
    ratio = []
    for case in range(OTHERS, OTHERS + 3):
        episode = TASKS[f"fixes-{robot}"].record(case)
        blind = dataclasses.replace(episode, robot=dataclasses.replace(episode.robot, fixes=None))
        with_them, without = (
            estimate_singly("filter", load_estimator("filter").source_hash, observed_runs(of))
            for of in (episode, blind)
        )
        assert not isinstance(with_them, Failure)
        assert not isinstance(without, Failure)
        ratio.append(ate(episode, with_them[0].poses) / ate(episode, without[0].poses))
    assert np.mean(ratio) < 0.5


def test_sampling_has_three_rates_jitter_and_lost_samples():
    for case, period in enumerate((0.05, 0.02, 0.004)):
        episode = TASKS["sampling-omni"].record(case)
        steps = np.diff(episode.runs[0].log.t)
        assert episode.robot.sample_period == period
        assert np.median(steps) == pytest.approx(period, rel=0.05)
        assert steps.min() > 0
        assert np.mean(steps > 1.5 * period) == pytest.approx(0.02, abs=0.01)


def test_a_wrong_scale_drifts_by_itself():
    true = np.stack([np.linspace(0.0, 60.0, 601), np.zeros(601), np.zeros(601)], axis=-1)
    assert drift(true, true * [1.003, 1.0, 1.0]) == pytest.approx(0.003)
    assert drift(true[:50], true[:50]) is None
