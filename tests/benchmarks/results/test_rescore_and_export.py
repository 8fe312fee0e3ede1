"""Scores computed again from stored files, and episodes as text for other programs."""

import dataclasses

import numpy as np
import pytest

from benchmarks.export.cases import export_cases, export_form
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.references import CEILING, FLOOR, reference_store, save_references
from benchmarks.results.rescore import rescore, rescore_task
from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from benchmarks.scoring.registry import score
from benchmarks.tasks.task import Episode, Run
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr
from estimators.plugins.registry import load_estimator


@pytest.fixture(scope="module")
def followed(tmp_path_factory, fake_tasks, plugin):
    """Return a results folder with two cases, and the task."""
    results, task = tmp_path_factory.mktemp("followed"), fake_tasks.Arcs()
    run([Assignment(task, (0, 1), (load_estimator("dead-reckoning-1"),))], results)
    return results, task


@pytest.fixture
def stored(followed, tmp_path):
    """Return the same in a folder of its own, to be changed."""
    results, task = followed
    for store, again in ((ResultsStore(results), ResultsStore(tmp_path)),):
        for row in store.rows(task.name, task.version):
            again.save(row)
    for case in (0, 1):
        EpisodeStore(tmp_path).save(task, case, EpisodeStore(results).load(task.name, task.version, case))
    return tmp_path, task


def test_scores_of_stored_rows_are_what_they_were(stored):
    results, task = stored
    report = rescore_task(results, task, write=True)
    assert (report.rows, report.changed, report.metrics, report.problems) == (2, 0, {}, ())


def test_scores_that_differ_are_stored_again_unless_it_is_a_dry_run(stored):
    results, task = stored
    store = ResultsStore(results)
    before = {row.case: row for row in store.rows(task.name, task.version)}
    wrong = {name: value for name, value in before[1].scores.items() if name != "ate"} | {"E_max_syst": 9.0}
    store.save(dataclasses.replace(before[1], scores=wrong))
    for write, left in ((False, 9.0), (True, before[1].scores["E_max_syst"])):
        report = rescore_task(results, task, write=write)
        assert report.changed == 1
        assert report.metrics == {("dead-reckoning-1", "E_max_syst"): 1, ("dead-reckoning-1", "ate"): 1}
        rescored = {row.case: row for row in store.rows(task.name, task.version)}
        assert rescored[1].scores["E_max_syst"] == left
    assert rescored[1].scores == before[1].scores
    assert rescored[1].origin.created == before[1].origin.created
    assert rescored[1].origin.rescored is not None
    assert rescored[1].origin.rescored >= rescored[1].origin.created
    assert rescored[0].origin == before[0].origin


def test_scores_that_differ_by_rounding_are_no_others(stored):
    results, task = stored
    store = ResultsStore(results)
    row = next(iter(store.rows(task.name, task.version)))
    store.save(dataclasses.replace(row, scores={name: np.nextafter(value, 1) for name, value in row.scores.items()}))
    assert rescore_task(results, task, write=False).metrics == {}


def test_the_order_of_poses_in_memory_rounds_no_score():
    """An oracle of trains has its samples first in memory, and a stored one its axles, by which sums once rounded."""
    n, random = 1001, np.random.default_rng(0)
    log = Log(0.5 * np.arange(n), np.zeros((n, 6)), np.empty((n, 0)), reference=random.normal(size=(n, 9)))
    episode = Episode(cfmmr(3), (Run(log),))
    for _ in range(20):
        estimate = random.normal(size=(len(episode.runs[0].samples), 3, 3)).swapaxes(0, 1)
        assert score(episode, [estimate]) == score(episode, [estimate.copy()])


def test_oracle_and_standing_still_are_scored_again_too(stored):
    """What an estimator attains is its part of the way between them, and would be of other scores."""
    results, task = stored
    store = reference_store(results)
    told = dataclasses.replace(task.record(0), runs=tuple(with_oracle(run_) for run_ in task.record(0).runs))
    save_references(store, task, 0, told)
    before = {row.estimator: row for row in store.rows(task.name, task.version)}
    assert set(before) == {CEILING, FLOOR}
    for row in before.values():
        scores = {name: value for name, value in row.scores.items() if name != "end_point_position"}
        store.save(dataclasses.replace(row, scores=scores | {"ate": 9.0}))
    report = rescore_task(results, task, write=True)
    assert (report.rows, report.changed, report.problems) == (2, 0, ())
    assert {name for name, _ in report.metrics} == {CEILING, FLOOR}
    after = {row.estimator: row for row in store.rows(task.name, task.version)}
    assert {name: row.scores for name, row in after.items()} == {name: row.scores for name, row in before.items()}
    assert {row.estimator for row in ResultsStore(results).rows(task.name, task.version)} == {"dead-reckoning-1"}


def with_oracle(run_):
    """Return a run with an oracle that is 1 mm off."""
    return dataclasses.replace(run_, oracle=run_.truth + np.array([1e-3, 0, 0]))


def test_rows_of_another_recording_are_kept_as_they_are(stored):
    results, task = stored
    EpisodeStore(results).path(task.name, task.version, 0).unlink()
    EpisodeStore(results).save(task, 1, task.record(5))
    problems = [found.problem for found in rescore(results, task.name, task.version)]
    assert problems == [
        "case 0: its episode is not stored; run again",
        "case 1: its episode was recorded again; run again",
    ]


@pytest.mark.parametrize("form", ["tum", "kitti"])
def test_exported_poses_give_the_stored_score(followed, tmp_path, form):
    """The ATE of the texts is that of the row: all runs' truth and estimates, at the scored samples."""
    results, task = followed
    export_cases(task, (1,), tmp_path / "out", export_form(form), results)
    (row,) = [row for row in ResultsStore(results).rows(task.name, task.version) if row.case == 1]
    folder = tmp_path / "out" / "case-1"
    errors = []
    for name in ("run-01-cw", "run-02-ccw"):
        truth = np.loadtxt(folder / f"{name}.{form}")
        estimate = np.loadtxt(folder / f"{name}-dead-reckoning-1-{row.source_hash}.{form}")
        columns = [1, 2] if form == "tum" else [3, 7]
        if form == "tum":
            np.testing.assert_array_equal(truth[:, 0], estimate[:, 0])
        errors.append(np.sqrt(np.mean(np.sum((truth - estimate)[:, columns] ** 2, axis=1))))
    assert np.mean(errors) == pytest.approx(row.scores["ate"], rel=1e-12)
    assert len(list(folder.iterdir())) == 4


def test_a_train_is_exported_axle_by_axle(tmp_path, fake_trains):
    task = fake_trains.Ahead()
    export_cases(task, (0,), tmp_path / "out", "tum")
    (run_,) = task.record(0).runs
    names = sorted(path.name for path in (tmp_path / "out" / "case-0").iterdir())
    assert names == [f"run-01-axle-{k}.tum" for k in range(1, run_.axles + 1)]
    text = np.loadtxt(tmp_path / "out" / "case-0" / "run-01-axle-2.tum", ndmin=2)
    np.testing.assert_allclose(text[:, 1:3], run_.truth[1, :, :2])


def test_floors_are_stored_and_exported_but_change_no_digest(tmp_path, fake_tasks):
    floor = Floor(cables=(Cable(center=(1.0, 0.5), direction=0.3, length=0.1, diameter=0.01),), slope=(0.01, 0.0))

    @dataclasses.dataclass(frozen=True)
    class OnCable(fake_tasks.Arcs):
        def record(self, case):
            plain = super().record(case)
            first, second = plain.runs
            return dataclasses.replace(plain, runs=(dataclasses.replace(first, floor=floor), second))

    task = OnCable()
    EpisodeStore(tmp_path).save(task, 0, task.record(0))
    kept = EpisodeStore(tmp_path).load(task.name, task.version, 0)
    assert [run_.floor for run_ in kept.runs] == [floor, None]
    assert kept.digest == fake_tasks.Arcs().record(0).digest
    export_cases(task, (0,), tmp_path / "out", "csv")
    assert [path.name for path in (tmp_path / "out" / "case-0").glob("*floor*")] == ["run-01-cw-floor.json"]
    assert Floor.load(tmp_path / "out" / "case-0" / "run-01-cw-floor.json") == floor


def test_mistakes_of_export_are_named(followed, tmp_path):
    results, task = followed
    with pytest.raises(InputError, match="'tumm' is not known; did you mean 'tum'"):
        export_form("tumm")
    with pytest.raises(InputError, match="--format tum"):
        export_cases(task, (0,), tmp_path / "out", "csv", results)
    assert not (tmp_path / "out").exists()
