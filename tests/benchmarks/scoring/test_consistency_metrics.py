"""NEES and the 95 % ellipsoid: their distributions under the covariance that is claimed, and how runs bring them."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.results.archives import CorruptFileError
from benchmarks.results.rescore import rescore
from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from benchmarks.scoring.consistency_metrics import WITHIN_95, normalised_error_squared
from benchmarks.scoring.registry import score
from benchmarks.tasks.task import Episode, Run
from castor_envs.geometry import se2
from castor_envs.logs.log import Log
from castor_envs.logs.reference import ReferenceNoise
from castor_envs.vehicles.presets import cfmmr, differential
from estimators.plugins.registry import load_estimator


def test_the_bound_is_that_of_chi_square():
    assert pytest.approx(chi2.ppf(0.95, 3), rel=1e-12) == WITHIN_95


def drawn(samples, axles=None, seed=0):
    """Return an episode, estimates with normal errors, and the covariance that these are drawn from."""
    random = np.random.default_rng(seed)
    shape = (samples,) if axles is None else (axles, samples)
    true = random.normal(size=(*shape, 3)) * [5.0, 5.0, 50.0]
    root = random.normal(size=(*shape, 3, 3)) * np.array([0.02, 0.03, 0.001])[:, None]
    error = (root @ random.normal(size=(*shape, 3, 1)))[..., 0]
    reference = true if axles is None else true.swapaxes(0, 1).reshape(samples, -1)
    t = np.arange(float(samples))
    log = Log(t, np.zeros((samples, 2)), np.empty((samples, 0)), reference=reference)
    vehicle = differential() if axles is None else cfmmr(axles)
    return Episode(vehicle, (Run(log),)), true + error, root @ root.swapaxes(-1, -2)


@pytest.mark.parametrize("axles", [None, 3])
def test_errors_as_claimed_give_one_and_ninety_five_per_cent(axles):
    episodes, estimates, covariances = zip(*(drawn(900, axles, seed) for seed in range(9)), strict=True)
    together = Episode(episodes[0].robot, tuple(episode.runs[0] for episode in episodes))
    scores = score(together, estimates, None, covariances)
    assert scores["nees"] == pytest.approx(1.0, abs=0.05)
    assert scores["inside_95"] == pytest.approx(0.95, abs=0.01)


def test_claiming_half_the_standard_deviation_gives_four():
    episode, estimate, covariance = drawn(300)
    honest = score(episode, [estimate], None, [covariance])["nees"]
    assert score(episode, [estimate], None, [covariance / 4])["nees"] == pytest.approx(4 * honest, rel=1e-6)


def test_a_noisy_reference_is_not_laid_to_the_estimator():
    """Of exact motion from a start that the tracker read, errors are the tracker's alone, twice; and if its noise is
    not stated, they count as the estimator's."""
    random, noise = np.random.default_rng(5), ReferenceNoise(2e-3, 5e-3)
    deviation = [noise.position, noise.position, noise.heading]
    t = np.arange(20.0)
    body = np.column_stack([np.cumsum(0.1 * np.cos(0.3 * t)), np.cumsum(0.1 * np.sin(0.3 * t)), 0.3 * t])
    runs, estimates = [], []
    for _ in range(300):
        read = body + random.normal(size=body.shape) * deviation
        log = Log(t, np.zeros((len(t), 2)), np.empty((len(t), 0)), reference=read)
        runs.append(Run(log, reference_noise=noise))
        estimates.append(se2.compose(read[0], se2.relative_pose(body[0], body)))
    exact = [np.zeros((len(t), 3, 3))] * len(runs)
    scores = score(Episode(differential(), tuple(runs)), estimates, None, exact)
    assert scores["nees"] == pytest.approx(1.0, abs=0.1)  # 300 starts, which errors of one run share
    assert scores["inside_95"] == pytest.approx(0.95, abs=0.02)
    silent = Episode(differential(), tuple(dataclasses.replace(run, reference_noise=None) for run in runs))
    assert score(silent, estimates, None, exact)["nees"] > 1e6


def test_whole_turns_of_the_heading_do_not_count():
    error = normalised_error_squared(np.zeros(3), [0.0, 0.0, 2 * np.pi + 0.1], np.diag([1.0, 1.0, 0.01]))
    assert error == pytest.approx(1.0)


def test_the_start_which_is_given_does_not_count():
    episode, estimate, covariance = drawn(50)
    moved = estimate.copy()
    moved[0] += 100.0
    assert score(episode, [moved], None, [covariance])["nees"] == score(episode, [estimate], None, [covariance])["nees"]


def test_without_a_covariance_there_is_nothing_to_score():
    episode, estimate, _ = drawn(50)
    for scores in (score(episode, [estimate]), score(episode, [estimate], None, [None], [None])):
        assert not {"nees", "inside_95", "status_share"} & scores.keys()


@pytest.fixture
def row_of(tmp_path, fake_tasks, plugin, jobs_here):
    """Return a function that runs a plug-in on a case of arcs and gives its row."""

    def row(name):
        entry, task = load_estimator(plugin(f"unsure:{name}")), dataclasses.replace(fake_tasks.Arcs(), metric="ate")
        run([Assignment(task, (0,), (entry,))], tmp_path)
        return ResultsStore(tmp_path).load(task.name, task.version, entry.name, entry.source_hash, 0)

    return row


def test_rows_hold_covariance_and_status(tmp_path, row_of):
    row = row_of("Unsure")
    assert row.failure is None
    for estimate, covariance, stated in zip(row.estimates, row.covariances, row.stated, strict=True):
        np.testing.assert_array_equal(covariance, np.tile(np.diag([0.04] * 3), (len(estimate), 1, 1)))
        np.testing.assert_array_equal(stated, np.arange(len(estimate)) > 0)
    samples = [len(one) for one in row.stated]
    assert row.scores["status_share"] == pytest.approx(1 - len(samples) / sum(samples))
    assert row.scores["nees"] > 1
    assert 0 < row.scores["inside_95"] < 1
    (again,) = rescore(tmp_path, "arcs", 1)
    assert not again.changed


def test_rows_of_others_hold_neither(tmp_path, fake_tasks, plugin, jobs_here):
    entry = load_estimator(plugin("followers:Follower"))
    run([Assignment(fake_tasks.Arcs(), (0,), (entry,))], tmp_path)
    row = ResultsStore(tmp_path).load("arcs", 1, entry.name, entry.source_hash, 0)
    assert row is not None
    assert all(one is None for one in (*row.covariances, *row.stated))
    assert "nees" not in row.scores


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("OfOneNumber", "covariance has shape () instead of (3, 3) at sample 0 of run 1"),
        ("OfComplexNumbers", "covariance has complex numbers instead of (3, 3) real ones at sample 0 of run 1"),
        ("Negative", "covariance is not positive semidefinite: a variance is negative at sample 0 of run 1"),
        ("OverCorrelated", "covariance is not positive semidefinite at sample 0 of run 1"),
        ("Infinite", "covariance is not finite at sample 0 of run 1"),
        ("Lopsided", "covariance is not symmetric at sample 0 of run 1"),
        ("Sometimes", "has a covariance at some samples, and none at sample 10 of run 1"),
        ("StatesNumbers", "status is of type int: None or a text at sample 0 of run 1"),
    ],
)
def test_what_is_no_covariance_fails_the_case(row_of, name, reason):
    assert row_of(name).failure == reason


def test_a_stored_covariance_of_another_shape_is_refused(tmp_path, row_of):
    row, store = row_of("Unsure"), ResultsStore(tmp_path)
    store.save(dataclasses.replace(row, covariances=tuple(one[1:] for one in row.covariances)))
    assert list(store.rows(row.task, row.version)) == []
    (refused,) = store.corrupt
    assert isinstance(refused, CorruptFileError)
    assert "covariances" in str(refused)
