"""Tasks of driven trains: repeatable, of trains that nobody knows, disturbed as said, with a ceiling that is one."""

import dataclasses
from itertools import product

import numpy as np
import pytest
from scipy.stats import t

from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.registry import score
from benchmarks.tasks import official_tasks
from benchmarks.tasks.driving import trains as driving
from benchmarks.tasks.driving.train_drive import TrainDrive, recorded_train
from benchmarks.tasks.driving.trains import AXLES, FAULTS, KINDS, TOLERANCES, DrivenTrue, failing_posture, winding
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription
from estimators import load_estimator

TASKS = {task.name: task for task in official_tasks()}
OTHERS = 800_001  # in sampling, one at 20 Hz


@pytest.fixture(autouse=True)
def shorter(monkeypatch):
    """Drives are the same of whatever length."""
    monkeypatch.setattr(driving, "WAY", 4.0)
    monkeypatch.setattr(driving, "LONG_WAY", 4.0)


def driven(kind: str, axles: int, case: int) -> DrivenTrue:
    """What happened in a case, by the recipe of its kind, and other numbers than those of the task."""
    (recipe,) = (of.recipe for of in KINDS if of.name == kind)
    described = TASKS[f"{kind}-train-{axles}"].robot
    assert isinstance(described, TrainDescription)
    return recipe(described, np.random.default_rng(case), case)


def standing(axles: int, samples: int = 4000) -> TrainDrive:
    """A made-up drive in which frames are straight and wheels stand."""
    train, rows = cfmmr(axles), np.zeros
    joints = tuple(rows((samples, frame.links)) for frame in train.frames)
    t = np.arange(samples) * np.float64(0.05)
    return TrainDrive(t, rows((samples, 3 * axles)), rows((samples, 2 * axles)), joints, rows((samples, 2 * axles)))


def test_every_kind_is_driven_by_every_train_and_by_name_alone():
    for kind in KINDS:
        for axles in AXLES:
            task = TASKS[f"{kind.name}-train-{axles}"]
            assert (task.group, task.standard, task.metric) == (kind.name, False, "mean_axle_position")


@pytest.mark.parametrize("kind", [kind.name for kind in KINDS])
def test_a_case_is_the_same_every_time(kind):
    task = TASKS[f"{kind}-train-3"]
    assert task.record(OTHERS).digest == task.record(OTHERS).digest


def test_no_case_is_another():
    cases = [driven("manoeuvres", 3, case).log.wheel[-1].tolist() for case in range(4)]
    assert len({tuple(counts) for counts in cases}) == 4


def test_train_files_state_tolerances_and_not_the_true_train():
    described = TASKS["manoeuvres-train-5"].record(OTHERS).robot
    assert isinstance(described, TrainDescription)
    modules = [dataclasses.replace(module, tolerances=None) for module in described.modules]
    assert dataclasses.replace(described, modules=tuple(modules)) == cfmmr(5)
    true = np.array([[w.radius for w in m.wheels] for m in driving.drawn(described, np.random.default_rng(0)).modules])
    file = np.array([[w.radius for w in m.wheels] for m in described.modules])
    off = true / file - 1
    assert (off != 0).all()
    assert np.abs(off).max() <= 3 * TOLERANCES.radius + 1e-15


@pytest.mark.parametrize("seed", range(20))
def test_ways_end_far_from_their_start_and_stop_on_the_way(seed):
    path = winding(np.random.default_rng(seed), 15.0)
    assert np.hypot(*path.at(path.length)[0][:2]) > 2.0
    covered, speed = path.progress(np.linspace(0.0, path.duration, 20_000))
    stood = covered[np.flatnonzero((speed[1:-1] < speed[:-2]) & (speed[1:-1] <= speed[2:])) + 1]
    assert len(stood) == len(path.stops) >= 3
    np.testing.assert_allclose(stood, path.stops, atol=1e-3)


def test_a_drive_follows_its_way_and_wheels_roll_as_far_as_axles_move():
    of = driven("manoeuvres", 3, OTHERS)
    pose = of.true.pose.reshape(-1, 3, 3)
    moved = np.hypot(*np.diff(pose[..., :2], axis=0).transpose(2, 0, 1)).sum(axis=0)
    radius = np.array([[wheel.radius for wheel in module.wheels] for module in of.train.modules])
    rolled = (of.true.wheel[-1].reshape(3, 2) * radius).mean(axis=1)
    np.testing.assert_allclose(rolled, moved, rtol=0.01)
    assert 3.0 < moved[0] < 4.1


def test_slipping_wheels_are_read_wrong_and_nothing_else():
    of = driven("bursts", 3, OTHERS)
    counts = [wheel.counts_per_rev or 0.0 for module in of.train.modules for wheel in module.wheels]
    off = of.log.wheel - of.true.wheel * np.array(counts) / (2 * np.pi)
    steps = np.abs(np.diff(off, axis=0))
    true_step = np.abs(np.diff(of.true.wheel, axis=0)) * np.array(counts) / (2 * np.pi)
    slips = steps > 1.0 + 1e-9  # beyond the rounding of a count
    assert 0 < slips.any(axis=0).sum() < 6
    assert (steps <= 0.55 * true_step + 1.0 + 1e-9).all()
    np.testing.assert_array_equal(of.log.reference, of.true.pose)


@pytest.mark.parametrize("fault", FAULTS[:3])
def test_one_wheel_encoder_fails_and_stays_so(fault):
    of = driven("faults", 3, 6 * 100 + FAULTS.index(fault))
    counts = np.array([wheel.counts_per_rev or 0.0 for module in of.train.modules for wheel in module.wheels])
    off = np.abs(of.log.wheel - of.true.wheel * counts / (2 * np.pi))
    (failed,) = np.flatnonzero(off.max(axis=0) > 2.0)
    first = np.flatnonzero(off[:, failed] > 2.0)[0]
    assert first > 0.2 * len(of.true.t)
    if fault == "dead wheel":
        assert np.ptp(of.log.wheel[first:, failed]) == 0


@pytest.mark.parametrize("fault", FAULTS[3:])
def test_one_relative_posture_sensor_fails_and_stays_so(fault):
    t = 0.05 * np.arange(1200)
    ramp = np.tile(t[:, None], (1, 9))  # readings that tell the time when they were taken
    log = Log(t=t, wheel=np.zeros((1200, 8)), pivot=np.zeros((1200, 0)), rps=ramp)
    failed = t > 20.0
    read = failing_posture(log, fault, failed, np.random.default_rng(1))
    assert read.rps is not None
    changed = ~np.isclose(read.rps, ramp, atol=0.0, rtol=0.0)
    assert changed[failed].sum() == 3 * failed.sum()
    assert not changed[~failed].any()
    (frame,) = np.unique(np.flatnonzero(changed.any(axis=0)) // 3)
    off = ramp[failed, 3 * frame] - read.rps[failed, 3 * frame]
    if fault == "dead posture":
        assert np.isnan(off).all()
    elif fault == "frozen posture":
        np.testing.assert_allclose(read.rps[failed, 3 * frame], 20.0)
    else:
        assert np.ptp(off) < 1e-9
        assert 0.05 <= off[0] <= 0.4


def test_gauges_have_noise_and_an_offset_that_stays():
    """Of straight frames phi is the integral of the polynomial fitted to the gauges' errors: by numpy's own fit."""
    train = cfmmr(3)
    log = recorded_train(train, standing(3), np.random.default_rng(2))
    assert log.rps is not None
    frame, places = train.frames[0], np.array(train.frames[0].gauge_positions)
    by_gauge = [np.polyval(np.polyint(np.polyfit(places, unit, 2)), frame.length) for unit in np.eye(len(places))]
    phi = log.rps[:, 2::3]
    np.testing.assert_allclose(phi.std(axis=0), frame.gauge_noise * np.linalg.norm(by_gauge), rtol=0.05)
    assert (np.abs(phi.mean(axis=0)) < 4 * frame.gauge_offset * np.linalg.norm(by_gauge)).all()
    assert np.ptp(phi.mean(axis=0)) > 0
    assert (np.ptp(log.wheel, axis=0) == 0).all()


def test_sampling_has_three_rates_jitter_and_lost_samples():
    for case, period in enumerate((0.05, 0.02, 0.004)):
        of = driven("sampling", 3, case)
        steps = np.diff(of.log.t)
        assert of.train.sample_period == period
        assert np.median(steps) == pytest.approx(period, rel=0.05)
        assert steps.min() > 0
        assert np.mean(steps > 1.5 * period) == pytest.approx(0.02, abs=0.01)


def test_the_oracle_is_better_than_the_filter_by_a_paired_interval():
    """It is a ceiling: of the ratio of both errors the 95 % interval is below 1, and by far."""
    ratio, source = [], load_estimator("train-filter").source_hash
    for kind, case in product(("manoeuvres", "bursts"), range(OTHERS, OTHERS + 4)):
        episode = TASKS[f"{kind}-train-3"].record(case)
        estimates = estimate_singly("train-filter", source, observed_runs(episode))
        assert not isinstance(estimates, Failure)
        (run,) = episode.runs
        assert run.oracle is not None
        told, untold = (score(episode, [of])["mean_axle_position"] for of in (run.oracle, estimates[0].poses))
        ratio.append(np.log(told / untold))
    half = t.ppf(0.975, len(ratio) - 1) * np.std(ratio, ddof=1) / len(ratio) ** 0.5
    assert np.mean(ratio) + half < 0.0
