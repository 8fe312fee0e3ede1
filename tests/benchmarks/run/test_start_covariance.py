"""The covariance of the start reaches estimators that want it: 0 where the start is true, odometry's in snapshots."""

import numpy as np
import pytest

from benchmarks.results.episodes import EpisodeStore
from benchmarks.run.worker_estimate import estimate_singly, observed_runs
from benchmarks.tasks import official_tasks
from castor_envs.vehicles.load import load_vehicle
from estimators import load_estimator
from estimators.plugins.conformance.check import check

TASKS = {task.name: task for task in official_tasks()}


@pytest.mark.parametrize(
    ("task", "case", "expected"),
    [
        ("configuration-small", 0, np.diag([0.01, 0.01, np.radians(1.0)]) ** 2),
        ("configuration-static", "test-1", np.diag([0.01, 0.01, np.radians(1.0)]) ** 2),
        ("train-2-cables", 0, np.zeros((3, 3))),
        ("umbmark-kinematic-calibrated", 0, np.zeros((3, 3))),
    ],
)
def test_a_belief_can_be_told_from_a_true_start(task, case, expected, plugin, tmp_path):
    episode, store = TASKS[task].record(case), EpisodeStore(tmp_path)
    store.save(TASKS[task], case, episode)
    stored = store.load(task, TASKS[task].version, case)
    assert stored.digest == episode.digest
    entry = load_estimator(plugin("started:Started"))
    estimates = estimate_singly(entry.spec, entry.source_hash, observed_runs(stored)[:1])
    assert isinstance(estimates, list)
    covariance = estimates[0].covariance
    assert covariance is not None
    np.testing.assert_array_equal(covariance, np.broadcast_to(expected, covariance.shape))


def test_how_sure_the_belief_is_said_to_be_is_how_it_was_drawn():
    """Of the axles that did not slip: the mean of squared errors over the variances is 1."""
    runs = [run for case in range(4) for run in TASKS["configuration-small"].record(case).runs]
    ratios = []
    for run in runs:
        assert run.belief is not None
        assert run.belief_covariance is not None
        variance = np.diagonal(run.belief_covariance, axis1=-2, axis2=-1)
        sound = np.array(run.sound) - 1
        ratios.append(((run.belief - run.truth[:, 0]) ** 2 / variance)[sound])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("name", "said"), [("Started", ""), ("Demanding", "covariance"), ("Divides", "Singular matrix")]
)
@pytest.mark.parametrize("vehicle", ["differential", "cfmmr-3"])
def test_check_starts_surely_and_unsurely(name, said, vehicle, plugin):
    """And not at all: environments do not tell the covariance, so that it needs a default."""
    findings = check(load_estimator(plugin(f"started:{name}")), load_vehicle(vehicle))
    problems = [finding.message for finding in findings if not finding.passed]
    assert bool(problems) == bool(said)
    assert all(said in problem for problem in problems)
