"""Drives of measured robots: on sessions made here and, where they are, on the measured ones."""

import contextlib
import dataclasses
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.results.episodes import EpisodeStore
from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.registry import score
from benchmarks.tasks import measured_runs, official_tasks
from benchmarks.tasks.measured_runs.body_reference import on_own_clock
from benchmarks.tasks.measured_runs.splits import divided, path_length
from benchmarks.tasks.measured_runs.task import MeasuredDrives, _calibrated
from benchmarks.tasks.task import source_of
from castor_envs.errors import Declined, InputError
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.logs.importers.optiodom import REFERENCE_NOISE, find_sessions, read_session
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.registry import load_estimator

BASE, RADIUS, COUNTS = 0.2, 0.042, 43.7 * 64
DESCRIBED_BASE = 0.204
LATE, TURNED = 0.2, np.radians(1.0)
"""s and rad: what is wrong with the tracker: its clock and its axes."""


def drive(way, seconds=90.0, period=0.05):
    """Return times (K,), body poses (K, 3) and cumulative counts (K, 2), right wheel first, of a winding drive."""
    t = np.arange(0, seconds, period)
    fine = np.arange(0, seconds, period / 20)
    speed = 0.1 * np.minimum(1.0, np.minimum(fine, seconds - fine))
    turning = speed * way * (2.0 + 3.0 * np.sin(0.3 * fine))
    psi = np.concatenate([[0.0], np.cumsum(turning[:-1] * period / 20)])
    steps = speed[:-1] * period / 20 * np.exp(1j * (psi[1:] + psi[:-1]) / 2)
    place = np.array([0.0, *np.cumsum(steps)], dtype=complex)
    went = np.concatenate([[0.0], np.cumsum(speed[:-1] * period / 20)])
    wheels = np.column_stack([went + BASE / 2 * psi, went - BASE / 2 * psi]) * COUNTS / (2 * np.pi * RADIUS)
    poses = np.column_stack([np.real(place), np.imag(place), psi])
    return t, poses[::20][: len(t)], np.round(wheels[::20][: len(t)])


def tracked(t, poses):
    """Return what a tracker writes down at t: the poses of `LATE` before, turned."""
    late = np.column_stack([np.interp(t - LATE, t, column) for column in poses.T])
    return compose(late, [0.0, 0.0, TURNED])


def write_session(root, name, ways, kind="diff"):
    folder = root / "optiodom" / kind / "somewhere" / name
    folder.mkdir(parents=True)
    lines = {"type": kind, "ngear": 43.7, "encRes": 64, "Li": DESCRIBED_BASE, "Di": f"{2 * RADIUS},{2 * RADIUS}"}
    lines |= {"Thi": "", "N": len(ways), "L": ""}
    (folder / f"{name}_metadata.csv").write_text("".join(f"{key},{value}\n" for key, value in lines.items()))
    for k, way in enumerate(ways, start=1):
        t, poses, counts = drive(way)
        rows = np.column_stack([t, tracked(t, poses), np.diff(counts, axis=0, prepend=counts[:1])])
        np.savetxt(folder / f"{name}_run-{k:02d}.csv", rows, delimiter=",", fmt="%.9g")
    return folder


def task_named(name, data):
    (task,) = (task for task in measured_runs.tasks(data) if task.name == name)
    return task


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder with two sessions that nobody has heard of, and one of a robot that cannot be read."""
    root = tmp_path_factory.mktemp("data")
    write_session(root, "last-tuesday", (1, 1, -1, -1))
    write_session(root, "alone", (1,))
    write_session(root, "mecanum", (1,), kind="omni4")
    return root


def rpe(episode, estimator="wheel-odometry"):
    estimates = estimate_singly(estimator, load_estimator(estimator).source_hash, observed_runs(episode))
    assert not isinstance(estimates, Failure)
    return score(episode, [estimate.poses for estimate in estimates])["rpe_translation"]


def test_every_session_of_a_folder_is_a_case(data):
    task = task_named("measured-differential-nominal", data)
    assert task.missing is None
    assert list(task.cases()) == ["alone", "last-tuesday"]
    assert list(task.cases(1)) == ["alone"]


def test_what_a_folder_lacks_is_said(data, tmp_path):
    for name, place, words in (
        ("measured-differential-nominal", None, "pass --measured DIR or set CASTOR_DATA .*sousarbarb/optiodom"),
        ("measured-robotino-nominal", None, "BrOleg5/research-wheel-slippage as robotino/"),
        ("measured-differential-nominal", tmp_path, "no such folder"),
        ("measured-tricycle-nominal", data, "holds no session for measured-tricycle-nominal"),
    ):
        task = task_named(name, place)
        assert list(task.cases()) == []
        with pytest.raises(ValueError, match=words):
            raise ValueError(task.missing)


def test_a_hash_of_a_sessions_files_tells_other_data_under_its_name(data, tmp_path):
    task = task_named("measured-differential-nominal", data)
    shutil.copytree(data / "optiodom", tmp_path / "same" / "optiodom")
    shutil.copytree(data / "optiodom", tmp_path / "other" / "optiodom")
    (changed,) = (tmp_path / "other").rglob("alone_run-01.csv")
    changed.write_text(changed.read_text().replace("\n0.05,", "\n0.051,"))
    same, other = (task_named(task.name, tmp_path / name) for name in ("same", "other"))
    for case, differs in (("alone", True), ("last-tuesday", False)):
        assert source_of(same, case) == source_of(task, case) is not None
        assert (source_of(other, case) != source_of(task, case)) == differs
    assert isinstance(task, MeasuredDrives)
    together, changed = (dataclasses.replace(task, data=at, one_robot=True) for at in (data, tmp_path / "other"))
    assert source_of(together, "last-tuesday") != source_of(changed, "last-tuesday")  # others calibrate for it
    assert source_of(task_named(task.name, None), "alone") is None


@pytest.mark.parametrize("case", ["alone", "last-tuesday"])
def test_both_boards_have_the_bodys_own_poses_and_differ_in_the_robot_file(data, case):
    nominal, calibrated = (
        task_named(f"measured-differential-{which}", data).record(case) for which in ("nominal", "calibrated")
    )
    assert nominal.robot != calibrated.robot
    assert isinstance(calibrated.robot, RobotDescription)
    for one, other in zip(nominal.runs, calibrated.runs, strict=True):
        np.testing.assert_array_equal(reference(one.log), reference(other.log))
        np.testing.assert_array_equal(one.log.wheel, other.log.wheel)
    left, right = calibrated.robot.castors[0].wheels
    assert left.lateral - right.lateral == pytest.approx(BASE, rel=2e-3)
    assert rpe(calibrated) < 2e-3 < 5e-3 < rpe(nominal)
    for run in nominal.runs:  # against the path that was driven, which no clock or tracker has seen
        t, poses, _ = drive(1 if reference(run.log)[-1, 2] > reference(run.log)[0, 2] else -1)
        true = poses[np.searchsorted(t, run.log.t - 1e-6)]
        off = relative_pose(true[0], true) - relative_pose(reference(run.log)[0], reference(run.log))
        assert np.abs(off[:, :2]).max() < 3e-3
        assert np.abs(off[:, 2]).max() < 2e-3


def test_the_trackers_noise_is_stated_stored_and_part_of_the_digest(data, tmp_path):
    task, store = task_named("measured-differential-nominal", data), EpisodeStore(tmp_path)
    episode = task.record("alone")
    assert [run.reference_noise for run in episode.runs] == [REFERENCE_NOISE] * len(episode.runs)
    store.save(task, "alone", episode)
    stored = store.load(task.name, task.version, "alone")
    assert [run.reference_noise for run in stored.runs] == [REFERENCE_NOISE] * len(episode.runs)
    exact = dataclasses.replace(episode, runs=tuple(dataclasses.replace(r, reference_noise=None) for r in episode.runs))
    assert exact.digest != episode.digest == stored.digest


@pytest.mark.skipif("CASTOR_DATA" not in os.environ, reason="CASTOR_DATA names no folder with measured data")
def test_measured_poses_scatter_as_is_stated():
    """Third differences of what moves steadily are noise, of 20 times its variance."""
    scatter = []
    for folder in find_sessions(os.environ["CASTOR_DATA"]).values():
        with contextlib.suppress(Declined):
            for log in read_session(folder).runs:
                thirds = np.abs(np.diff(reference(log), 3, axis=0))
                scatter.append(np.median(thirds, axis=0) / norm.ppf(0.75) / np.sqrt(20))
    middle = np.median(scatter, axis=0)
    np.testing.assert_allclose(middle[:2], REFERENCE_NOISE.position, rtol=0.25)
    np.testing.assert_allclose(middle[2], REFERENCE_NOISE.heading, rtol=0.25)


def test_an_episode_repeats_bit_for_bit(data):
    task = task_named("measured-differential-calibrated", data)
    first = task.record("alone").digest
    _calibrated.cache_clear()
    assert task.record("alone").digest == first != task.record("last-tuesday").digest


def test_a_garbled_session_is_named(data, tmp_path):
    folder = write_session(tmp_path, "broken", (1, 1))
    (folder / "broken_run-02.csv").write_text("0,0,0\n1,1,1\n")
    assert "broken_run-02.csv:1" in (task_named("measured-differential-nominal", tmp_path).missing or "")


def reference(log):
    assert log.reference is not None
    return log.reference


def straight(seconds=60.0, turn=0.1, speed=0.1):
    t = np.arange(0, seconds, 0.05)
    reference = np.column_stack([speed * t, 0 * t, turn * t])
    return Log(t, np.column_stack([t, t]), np.empty((len(t), 0)), reference=reference)


def test_test_runs_share_no_sample_with_calibration_and_ways_are_on_both_sides():
    left, right, short = straight(), straight(turn=-0.1), straight(seconds=5.0)
    recordings, tests = divided((left, left, right, right, left, left), 1.2)
    for logs in (recordings, tests):
        assert {reference(log)[-1, 2] > 0 for log in logs} == {True, False}
    assert (len(recordings), len(tests)) == (3, 3)
    (first,), (second,) = divided((left,), 1.2)
    assert first.t[-1] < second.t[0]
    assert len(first) + len(second) == len(left)
    recordings, tests = divided((left, short), 1.2)
    assert len(recordings) == 1
    assert tests == ()
    assert divided((Log(left.t, left.wheel, left.pivot),), 1.2) == ((), ())


def test_the_length_of_a_path_is_not_that_of_its_noise():
    log = straight()
    reference(log)[:, :2] += np.random.default_rng(0).normal(scale=1e-3, size=(len(log), 2))
    assert path_length(log) == pytest.approx(6.0, rel=0.02)


def test_a_reference_on_another_clock_is_read_at_the_logs_own_times():
    log, clock = straight(), np.array([0.3, -0.01])
    taken = log.t + clock[0] + clock[1] * log.t
    seen = np.column_stack([np.interp(taken, log.t, c, right=np.nan) for c in reference(log).T])
    found = on_own_clock(Log(log.t, log.wheel, log.pivot, reference=seen), clock)
    assert found is not None
    assert found.t[0] == pytest.approx(0.3)  # nothing before was seen
    np.testing.assert_allclose(
        reference(found), reference(straight())[np.searchsorted(log.t, found.t - 1e-9)], atol=1e-9
    )
    assert on_own_clock(log, np.array([1000.0, 0.0])) is None


def test_no_pose_is_made_up_in_a_gap():
    log = straight()
    reference(log)[100:200] = np.nan
    found = on_own_clock(log, np.array([0.01, 0.0]))
    assert found is not None
    assert np.isnan(reference(found)[(found.t > 5.1) & (found.t < 9.9)]).all()


DATA = Path(os.environ["CASTOR_DATA"]) if "CASTOR_DATA" in os.environ else None
PAIRS = [
    name.removesuffix("-nominal") for name in (task.name for task in measured_runs.tasks(DATA)) if "nominal" in name
]


@pytest.mark.skipif(DATA is None, reason="measured data are not here")
@pytest.mark.parametrize("robot", PAIRS)
def test_calibration_helps_runs_that_it_has_not_seen(robot):
    nominal, calibrated = (task_named(f"{robot}-{which}", DATA) for which in ("nominal", "calibrated"))
    if nominal.missing is not None:
        pytest.skip(nominal.missing)
    cases = nominal.cases()[:4]
    found = {task.name: np.mean([_metric(task, case) for case in cases]) for task in (nominal, calibrated)}
    assert found[calibrated.name] < 0.8 * found[nominal.name]


def _metric(task, case):
    episode = task.record(case)
    estimates = estimate_singly("filter", load_estimator("filter").source_hash, observed_runs(episode))
    assert not isinstance(estimates, Failure)
    return score(episode, [estimate.poses for estimate in estimates])[task.metric]


def test_official_tasks_have_the_boards():
    names = {task.name for task in official_tasks(None)}
    assert {task.name for task in measured_runs.tasks(None)} <= names


def test_a_case_without_data_is_refused():
    with pytest.raises(ValueError, match="pass --measured DIR"):
        task_named("measured-omni-nominal", None).record("any")
    assert issubclass(InputError, ValueError)
