"""The run on small fake tasks: rows are right, faults cost their own rows, and nothing is computed twice."""

import contextlib
import dataclasses
import importlib
import os
import shutil

import numpy as np
import pytest

from benchmarks.leaderboard.board import build
from benchmarks.leaderboard.views import as_json, as_markdown
from benchmarks.progress import SilentProgress
from benchmarks.results import episodes
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import provenance
from benchmarks.results.rescore import rescore
from benchmarks.results.rows import ResultsStore
from benchmarks.run import evaluate as estimating
from benchmarks.run import worker_estimate
from benchmarks.run.evaluate import KILLED
from benchmarks.run.plan import Assignment, run
from benchmarks.run.worker_estimate import (
    Failure,
    Timed,
    estimate_singly,
    estimate_stacked,
    observed_runs,
    time_updates,
    update_cost,
)
from benchmarks.tasks.task import Case, Episode
from castor_envs.errors import InputError
from castor_envs.processes import MOST_MEMORY
from estimators.plugins.registry import load_estimator

GIB = MOST_MEMORY / 2**30
FAULTY = (
    *("Raises", "ReturnsNaN", "WrongShape", "ReturnsText", "Overflows", "Exits", "Dies", "Hangs", "Refuses"),
    *("CannotBeMade", "LooksForTruth", "RaisesInReset", "TakesMemory", "Prints", "Forks"),
    *("ReturnsComplex", "ReturnsDigits", "ReturnsNothing", "Interrupts"),
)


class Heard(SilentProgress):
    def __init__(self):
        self.stages, self.warnings, self.steps = {}, [], 0

    def start(self, stage, total):
        self.stages[stage] = total

    def advance(self, steps=1):
        self.steps += steps

    def warn(self, message):
        self.warnings.append(message)


def rows_of(results, task):
    return {(row.estimator, row.case): row for row in ResultsStore(results).rows(task.name, task.version)}


@pytest.fixture(scope="module")
def all_sorts(tmp_path_factory, fake_tasks, plugin, one_owner):
    """Return the rows of good and faulty estimators on two cases, and what was said during the run."""
    results, task, heard = tmp_path_factory.mktemp("results"), fake_tasks.Arcs(), Heard()
    names = ["followers:Follower", "followers:Single", "followers:Pretends", "fails_on_some:FailsOnSome"]
    names += [f"faulty:{kind}" for kind in FAULTY]
    estimators = tuple(load_estimator(plugin(name)) for name in names)
    with one_owner():
        run([Assignment(task, (2, 3), estimators)], results, processes=2, timeout=3.0, progress=heard)
    return results, task, rows_of(results, task), heard


def test_every_estimator_has_a_row_for_every_case(all_sorts):
    _, _, rows, heard = all_sorts
    assert len(rows) == 23 * 2
    assert heard.stages["recording episodes"] == 2
    assert heard.stages["running estimators"] == 23 * 2


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("Raises", "raised ValueError: no idea where I am in update at sample 7 of run 1"),
        ("ReturnsNaN", "returned NaN or infinity at sample 7 of run 1"),
        ("WrongShape", "returned shape (2,) instead of (3,) in update at sample 7 of run 1"),
        ("ReturnsNothing", "returned NoneType instead of (3,) numbers in update at sample 7 of run 1"),
        ("ReturnsText", "returned str instead of (3,) numbers in update at sample 7 of run 1"),
        ("ReturnsComplex", "returned complex numbers instead of (3,) real ones in update at sample 7 of run 1"),
        ("ReturnsDigits", "returned ndarray instead of (3,) numbers in update at sample 7 of run 1"),
        ("Interrupts", "raised KeyboardInterrupt in update at sample 7 of run 1"),
        ("Overflows", "returned poses too large to be scored"),
        ("Exits", "raised SystemExit: 0 in update at sample 7 of run 1"),
        ("Dies", "ended its process (exit code 0)"),
        ("Hangs", "took over 3 s"),
        ("Refuses", "declined: needs six legs"),
        ("CannotBeMade", "raised RuntimeError: no when constructed"),
        (
            "RaisesInReset",
            "raised ValueError: operands could not be broadcast together with shapes (2,2) (3,) in reset",
        ),
        ("TakesMemory", f"raised MemoryError (a worker process may take {GIB:.1f} GiB) in update at sample 7 of run 1"),
        ("Prints", "printed over 100 kB to stderr"),
    ],
)
def test_a_fault_costs_its_own_rows_and_says_why(all_sorts, kind, reason):
    _, _, rows, _ = all_sorts
    for case in (2, 3):
        row = rows[f"faulty:{kind}", case]
        assert row.failure == reason
        assert not row.scores


def test_an_estimator_that_forks_has_its_own_rows_once(all_sorts):
    """They are those of the start pose, as of one that does not fork."""
    _, _, rows, _ = all_sorts
    for case in (2, 3):
        row = rows["faulty:Forks", case]
        assert row.failure is None
        assert row.scores["ate"] == row.scores["ate_standing_still"]


def test_an_estimator_that_works_is_not_troubled(all_sorts, fake_tasks):
    """Wheels taken 1 + k mm/m too large: the arc is that much too long. The fake's midpoint rule costs 25 um."""
    _, _, rows, _ = all_sorts
    for case in (2, 3):
        scores = rows["followers:Follower", case].scores
        for sign, name, samples in ((-1, "r_cw", 61), (1, "r_ccw", 51)):
            duration = (samples - 1) * fake_tasks.PERIOD
            true, found = (
                np.array([np.sin(0.4 * f * duration), sign * (1 - np.cos(0.4 * f * duration))]) * 0.5 / 0.4
                for f in (1.0, 1 + 1e-3 * (1 + case))
            )
            assert scores[name] == pytest.approx(np.linalg.norm(true - found), abs=3e-5)
        assert scores["end_point_heading"] == pytest.approx(0.4e-3 * (1 + case) * (3.0 + 2.5) / 2)


def test_the_truth_is_nowhere_in_the_process_of_an_estimator(all_sorts):
    _, _, rows, _ = all_sorts
    assert rows["faulty:LooksForTruth", 2].failure is None


def test_stacked_and_single_runs_give_the_same(all_sorts):
    _, _, rows, _ = all_sorts
    for case in (2, 3):
        for together, alone in zip(
            rows["followers:Follower", case].estimates, rows["followers:Single", case].estimates, strict=True
        ):
            np.testing.assert_allclose(together, alone, atol=1e-13)


def test_who_cannot_take_stacks_is_run_case_by_case(all_sorts):
    _, _, rows, heard = all_sorts
    assert rows["followers:Pretends", 2].failure is None
    assert [warning for warning in heard.warnings if "followers:Pretends on stacked runs of arcs" in warning]


def test_one_lost_member_of_a_stack_is_lost_alone(all_sorts):
    _, _, rows, heard = all_sorts
    assert rows["fails_on_some:FailsOnSome", 2].failure is None
    assert rows["fails_on_some:FailsOnSome", 3].failure == "returned NaN or infinity at sample 7 of run 1"
    assert not [warning for warning in heard.warnings if "FailsOnSome" in warning]


def test_rows_say_where_they_come_from(all_sorts):
    _, task, rows, _ = all_sorts
    row = rows["followers:Follower", 2]
    assert row.origin.created.tzinfo is not None
    assert {"python", "numpy", "pymunk", "numba", "castor-envs"} <= set(row.origin.versions)
    assert row.origin.machine.platform
    assert row.robot_hash == task.record(2).robot.hash()
    assert row.episode == task.record(2).digest


def test_updates_are_timed_where_there_are_any(all_sorts, plugin):
    results, task, _, _ = all_sorts
    times = {}
    for name in ("followers:Follower", "faulty:Raises"):
        entry = load_estimator(plugin(name))
        times[name] = ResultsStore(results).load_time(task.name, task.version, entry.name, entry.source_hash)
    cost = times["followers:Follower"]
    assert 0 < cost.mean <= cost.worst
    assert times["faulty:Raises"] is None


def test_scores_follow_from_the_stored_files(all_sorts):
    results, task, rows, _ = all_sorts
    again = {
        (found.row.estimator, found.row.case): found.row.scores for found in rescore(results, task.name, task.version)
    }
    assert again == {key: row.scores for key, row in rows.items()}


def test_a_second_run_computes_nothing(all_sorts, plugin):
    results, task, rows, _ = all_sorts
    heard = Heard()
    plan = [Assignment(task, (2, 3), (load_estimator(plugin("followers:Follower")),))]
    run(plan, results, processes=1, progress=heard)
    assert heard.stages == {"recording episodes": 0, "running estimators": 0, "timing updates": 0}
    after = rows_of(results, task)
    assert {key: row.origin for key, row in after.items()} == {key: row.origin for key, row in rows.items()}


def test_more_cases_add_to_those_there_are(tmp_path, fake_tasks, plugin, jobs_here):
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("followers:Follower"))
    run([Assignment(task, (0, 1), (entry,))], tmp_path)
    first = rows_of(tmp_path, task)
    heard = Heard()
    run([Assignment(task, tuple(range(5)), (entry,))], tmp_path, progress=heard)
    assert heard.stages["running estimators"] == heard.stages["recording episodes"] == 3
    after = rows_of(tmp_path, task)
    assert len(after) == 5
    assert all(after[key].origin == row.origin for key, row in first.items())


def test_a_stack_may_take_as_long_as_its_episodes_one_by_one(tmp_path, fake_tasks, plugin):
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("followers:Follower"))
    recorded: dict[Case, Episode] = {case: task.record(case) for case in (0, 1, 2)}
    works = [estimating.Work(task, entry, recorded, True), estimating.Work(task, entry, {0: recorded[0]}, False)]
    jobs = estimating.Estimating(iter(works), ResultsStore(tmp_path), 60.0, SilentProgress())
    given = [job.timeout for _ in works if (job := jobs.next_job()) is not None]
    assert given == [180.0, 60.0]


def test_a_time_out_is_tried_again_with_more_time_only(tmp_path, fake_tasks, plugin, monkeypatch, prepared):
    monkeypatch.setattr(estimating, "MOST_TIMEOUTS", 1)
    plan = [Assignment(fake_tasks.Arcs(), (0, 1), (load_estimator(plugin("faulty:HangsInReset")),))]
    prepared(tmp_path, fake_tasks.Arcs(), 0, 1)
    run(plan, tmp_path, timeout=0.4)
    reasons = sorted(str(row.failure) for row in ResultsStore(tmp_path).rows("arcs", 1))
    assert reasons == ["not tried after 1 episodes took over 0.4 s each", "took over 0.4 s"]
    heard = Heard()
    run(plan, tmp_path, timeout=0.4, progress=heard)
    assert heard.stages["running estimators"] == 0
    run(plan, tmp_path, timeout=0.5, progress=heard)
    assert heard.stages["running estimators"] == 2


def test_damaged_files_are_named_and_computed_again(tmp_path, fake_tasks, plugin, jobs_here):
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("followers:Follower"))
    plan = [Assignment(task, (0, 1, 2), (entry,))]
    run(plan, tmp_path)
    before = rows_of(tmp_path, task)
    folder = ResultsStore(tmp_path).folder(task.name, task.version, entry.name, entry.source_hash)
    episode = EpisodeStore(tmp_path).path(task.name, task.version, 1)
    for path in (folder / "1.npz", folder / "time.json", episode):
        path.write_bytes(path.read_bytes()[:30])
    heard = Heard()
    run(plan, tmp_path, progress=heard)
    assert heard.stages == {"recording episodes": 1, "running estimators": 1, "timing updates": 1}
    for path in (folder / "1.npz", folder / "time.json", episode):
        assert any(str(path) in warning for warning in heard.warnings)
    after = rows_of(tmp_path, task)
    assert after.keys() == before.keys()
    for key, row in after.items():
        for computed, stored in zip(row.estimates, before[key].estimates, strict=True):
            np.testing.assert_array_equal(computed, stored)
        assert row.scores == before[key].scores


def test_another_version_of_a_task_starts_anew(tmp_path, fake_tasks, plugin, jobs_here):
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("followers:Follower"))
    newer = dataclasses.replace(task, version=2)
    run([Assignment(task, (0,), (entry,))], tmp_path)
    heard = Heard()
    run([Assignment(newer, (0,), (entry,))], tmp_path, progress=heard)
    assert heard.stages["running estimators"] == 1
    assert ResultsStore(tmp_path).versions() == [("arcs", 1), ("arcs", 2)]


def test_other_recordings_do_not_inherit_rows(tmp_path, fake_tasks, plugin, jobs_here):
    """As when a folder of measured data is exchanged: the digest of the episode shows it."""
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("followers:Follower"))
    run([Assignment(task, (0,), (entry,))], tmp_path)
    EpisodeStore(tmp_path).save(task, 0, task.record(5))
    heard = Heard()
    run([Assignment(task, (0,), (entry,))], tmp_path, progress=heard)
    assert heard.stages["running estimators"] == 1
    assert rows_of(tmp_path, task)[entry.name, 0].episode == task.record(5).digest


def test_an_edited_plug_in_gets_fresh_rows(tmp_path, fake_tasks, jobs_here):
    file, task, results = tmp_path / "mine.py", fake_tasks.Arcs(), tmp_path / "results"
    source = (
        "class Mine:\n def reset(self, robot, pose): self.pose = pose\n def update(self, seen): return self.pose{}\n"
    )
    found = []
    for edit in ("", " + 0.25"):
        file.write_text(source.format(edit))
        entry = load_estimator(str(file))
        run([Assignment(task, (0,), (entry,))], results)
        row = ResultsStore(results).load(task.name, task.version, entry.name, entry.source_hash, 0)
        assert row is not None
        found.append((entry.source_hash, row.estimates[0][0, 0]))
    assert found[0][0] != found[1][0]
    assert [start for _, start in found] == [0.0, 0.25]


def test_a_plug_in_edited_during_a_run_is_not_believed(tmp_path, fake_tasks, plugin):
    runs = observed_runs(fake_tasks.Arcs().record(0))
    outcome = estimate_singly(plugin("faulty:Good"), "0123456789abcdef", runs)
    assert outcome == Failure("its source changed while the benchmark ran; run again")


def test_a_task_without_its_data_is_left_out(tmp_path, fake_tasks, plugin, jobs_here):
    entry = load_estimator(plugin("followers:Follower"))
    absent = dataclasses.replace(fake_tasks.Arcs(), name="absent", missing="the data are on the moon")
    plan = [Assignment(task, (0, 1), (entry,)) for task in (absent, fake_tasks.BadInput(), fake_tasks.Arcs())]
    missing = run(plan, tmp_path, processes=2)
    assert missing == {"absent": "the data are on the moon", "bad-input": "run-01.csv, line 3: not a number"}
    assert ResultsStore(tmp_path).versions() == [("arcs", 1)]


def test_a_case_with_bad_input_costs_the_other_cases_nothing(tmp_path, fake_tasks, plugin, jobs_here):
    task, entry = fake_tasks.BadInput(bad=(1,)), load_estimator(plugin("followers:Follower"))
    missing = run([Assignment(task, (0, 1, 2), (entry,))], tmp_path)
    assert missing == {"bad-input": "1 of 3 cases: run-01.csv, line 3: not a number"}
    assert sorted(row.case for row in ResultsStore(tmp_path).rows(task.name, 1)) == [0, 2]
    (board,) = build([task], tmp_path, missing=missing).boards
    assert (board.missing, board.cases) == (missing["bad-input"], (0, 2))


def test_a_task_with_a_bug_is_distinguished_from_bad_input(tmp_path, fake_tasks, plugin, jobs_here):
    entry = load_estimator(plugin("followers:Follower"))
    with pytest.raises(RuntimeError, match=r"(?s)task broken, case 0.*ZeroDivisionError: a bug"):
        run([Assignment(fake_tasks.Broken(), (0,), (entry,))], tmp_path)


def test_an_unknown_metric_is_refused_before_anything_is_written(tmp_path, fake_tasks):
    task = dataclasses.replace(fake_tasks.Arcs(), metric="speed")
    with pytest.raises(ValueError, match="speed"):
        run([Assignment(task, (0,), ())], tmp_path / "results")
    assert not (tmp_path / "results").exists()


def test_a_results_folder_below_a_file_is_refused(tmp_path, fake_tasks):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        run([Assignment(fake_tasks.Arcs(), (0,), ())], tmp_path / "file" / "results")


def test_stacks_are_of_alike_runs(fake_tasks, plugin):
    """Episodes of different lengths and robots of different encoders in one job."""
    entry = load_estimator(plugin("followers:Follower"))
    coarse = dataclasses.replace(fake_tasks.Arcs(), samples=31)
    episodes = [observed_runs(task.record(case)) for task in (fake_tasks.Arcs(), coarse) for case in (0, 1)]
    together = estimate_stacked(entry.spec, entry.source_hash, episodes)
    assert isinstance(together, list)
    for runs, found in zip(episodes, together, strict=True):
        alone = estimate_singly(entry.spec, entry.source_hash, runs)
        assert isinstance(alone, list)
        assert isinstance(found, list)
        for single, stacked in zip(alone, found, strict=True):
            np.testing.assert_allclose(single.poses, stacked.poses, atol=1e-13)


def test_episodes_of_another_world_are_recorded_again(tmp_path, fake_tasks, plugin, monkeypatch, jobs_here):
    """Old episodes must not be mixed with edited physics: they are recorded anew, and only what differs is run."""
    plan = [Assignment(fake_tasks.Arcs(), (0, 1), (load_estimator(plugin("followers:Follower")),))]
    run(plan, tmp_path)
    again, heard_other_world = Heard(), Heard()
    run(plan, tmp_path, progress=again)
    assert again.stages["recording episodes"] == 0
    monkeypatch.setattr(episodes, "world_digest", lambda: "another world")
    run(plan, tmp_path, progress=heard_other_world)
    assert heard_other_world.stages["recording episodes"] == 2
    assert heard_other_world.stages["running estimators"] == 0  # this world records the same


def test_episodes_of_other_data_are_recorded_again(tmp_path, fake_tasks, plugin, jobs_here):
    """Data under the same name, replaced or in another folder, have rows of their own; the same data elsewhere not."""
    results, files = tmp_path / "results", [tmp_path / name for name in ("first", "same", "other")]
    for file, text in zip(files, ("1", "1", "2"), strict=True):
        file.write_text(text)
    first, same, other = (fake_tasks.OfData(data=file) for file in files)
    spec = plugin("followers:Follower")
    seen = []
    for task in (first, same, other, first):
        heard = Heard()
        run([Assignment(task, (0, 1), (load_estimator(spec),))], results, progress=heard)
        seen.append((heard.stages["recording episodes"], heard.stages["running estimators"]))
        episodes = {case: row.episode for (_, case), row in rows_of(results, task).items()}
        assert episodes == {case: task.record(case).digest for case in (0, 1)}
    assert seen == [(2, 2), (0, 0), (2, 2), (2, 2)]
    store = EpisodeStore(results)
    assert store.digest(first.name, 1, 0, "2") is None
    assert store.digest(first.name, 1, 0, "1") == store.digest(first.name, 1, 0) == first.record(0).digest
    (board,) = build([fake_tasks.OfData(missing="not given")], results).boards  # which can be shown without the data
    assert board.cases == (0, 1)


def test_a_refusal_declines_the_robot_and_a_value_error_does_not(tmp_path, fake_tasks, jobs_here):
    """On a stack too; there other errors may be of broadcasting, and single runs are tried."""
    file, task = tmp_path / "mine.py", fake_tasks.Arcs()
    file.write_text(
        "import numpy as np\n"
        "from estimators import Declined\n"
        "class Declines:\n"
        " def reset(self, robot, pose): raise Declined('needs\\n legs')\n"
        " def update(self, seen): return np.zeros(3)\n"
        "class Broadcasts(Declines):\n"
        " batched = True\n"
        "class Alone(Broadcasts):\n"
        " def reset(self, robot, pose): self.pose = pose + np.zeros(3) if pose.shape == (3,) else np.ones(2) + pose\n"
        " def update(self, seen): return self.pose\n"
    )
    names = ("Declines", "Broadcasts", "Alone")
    run([Assignment(task, (0, 1), tuple(load_estimator(f"{file}:{name}") for name in names))], tmp_path / "results")
    refusals = {key: row.refusal for key, row in rows_of(tmp_path / "results", task).items()}
    assert refusals == {
        (f"mine:{name}", case): None if name == "Alone" else "needs legs" for name in names for case in (0, 1)
    }


def test_what_killed_runs_left_is_removed_and_what_is_being_written_stays(tmp_path, fake_tasks):
    """A writer holds a lock on its temporary file as long as it lives."""
    fcntl = pytest.importorskip("fcntl")
    kept = [".5.npz.abcd_123.tmp", ".notes.tmp", ".5.npz.abc.tmp", "5.npz.abcd_123.tmp", ".5.npz"]
    folders = [tmp_path / "rows" / "arcs@1" / "mine-0", tmp_path / "episodes" / "arcs@1"]
    with contextlib.ExitStack() as writers:
        for folder in folders:
            folder.mkdir(parents=True)
            for name in (*kept, ".6.npz.abcd_123.tmp", ".time.json.abcd_123.tmp"):
                (folder / name).write_bytes(b"half")
            writer = writers.enter_context((folder / kept[0]).open("rb+"))
            fcntl.flock(writer, fcntl.LOCK_EX)
        run([Assignment(fake_tasks.Arcs(), (), ())], tmp_path)
        for folder in folders:
            assert sorted(path.name for path in folder.iterdir()) == sorted(kept)


def test_a_plug_in_cannot_change_the_scores_of_others(tmp_path, fake_tasks, plugin, prepared, in_this_process):
    """One worker process serves one plug-in only: what it does to its process ends with it."""
    task = fake_tasks.Arcs()
    honest = load_estimator("dead-reckoning")
    saboteurs = [load_estimator(plugin(f"saboteur:{kind}")) for kind in ("Saboteur", "Unspeakable", "Surrogate")]
    with in_this_process():
        run([Assignment(task, (0, 1), (honest,))], tmp_path / "alone")
    prepared(tmp_path / "together", task, 0, 1)
    run([Assignment(task, (0, 1), (*saboteurs, honest))], tmp_path / "together", processes=1)
    alone, together = rows_of(tmp_path / "alone", task), rows_of(tmp_path / "together", task)
    for case in (0, 1):
        assert together["dead-reckoning", case].scores == alone["dead-reckoning", case].scores
        assert (
            together["saboteur:Unspeakable", case].failure == "raised RudeError: its message cannot be shown in reset"
        )
        assert together["saboteur:Surrogate", case].failure == "raised RuntimeError: ? ?[31m in reset"


def test_a_copied_row_does_not_count_twice(tmp_path, fake_tasks, jobs_here):
    task = fake_tasks.Arcs()
    run([Assignment(task, (0, 1), (load_estimator("dead-reckoning"),))], tmp_path)
    (row,) = (tmp_path / "rows").rglob("0.npz")
    shutil.copy(row, row.with_name("0 (copy).npz"))
    shutil.copytree(row.parent, row.parent.with_name("copy"))
    assert len(list(ResultsStore(tmp_path).rows(task.name, task.version))) == 2


REPEATING = {"Single": True, "Remembers": False, "Guesses": False, "Rounds": True}


@pytest.mark.parametrize(("name", "repeats"), REPEATING.items())
def test_poses_that_two_passes_over_a_log_do_not_share_are_told_with_the_scores(
    tmp_path, fake_tasks, plugin, jobs_here, name, repeats
):
    """Such scores depend on what ran before in a process, and so on the number of processes."""
    task, entry = fake_tasks.Arcs(), load_estimator(plugin(f"followers:{name}"))
    run([Assignment(task, (0,), (entry,))], tmp_path)
    leaderboard = build([task], tmp_path)
    (shown,) = leaderboard.boards[0].entries
    assert shown.cost is not None
    assert shown.cost.repeats == repeats
    said = f"followers:{name}: poses differ between two passes over the same log (arcs)"
    assert (said in as_markdown(leaderboard)) == (not repeats)
    assert as_json(leaderboard)["tasks"][0]["entries"][0]["poses_repeat"] == repeats


def test_the_worst_update_is_the_one_that_costs_every_time(fake_tasks, plugin):
    """Every tenth update of this estimator costs a millisecond of CPU time; the mean hides it, the worst does not."""
    entry = load_estimator(plugin("followers:Pauses"))
    timed = time_updates(entry.spec, entry.source_hash, observed_runs(fake_tasks.Arcs().record(0)))
    assert isinstance(timed, Timed)
    cost = update_cost([timed])
    assert 1000 < cost.worst < 5000
    assert 100 < cost.mean < cost.worst / 5


@pytest.fixture
def fake_clock(monkeypatch):
    """Let updates be timed by a clock that goes on only as an estimator spends time."""
    clock = importlib.import_module("fake_clock")
    monkeypatch.setattr(worker_estimate, "time", clock)
    return clock


def timed_by(entry, episode, **afresh):
    timed = time_updates(entry.spec, entry.source_hash, observed_runs(episode), **afresh)
    assert isinstance(timed, Timed)
    return timed


@pytest.mark.parametrize("afresh", [False, True])
def test_what_happens_once_is_no_cost_of_an_update(fake_tasks, plugin, fake_clock, afresh):
    """Compilation in a first pass, and the observation of the start pose."""
    entry = load_estimator(plugin("costly:Compiles"))
    cost = update_cost([timed_by(entry, fake_tasks.Arcs().record(0), afresh=afresh)])
    assert (cost.mean, cost.worst) == (pytest.approx(7.0), 7.0)


def test_what_an_estimator_keeps_of_a_run_does_not_make_its_updates_cheap(fake_tasks, plugin, fake_clock):
    entry = load_estimator(plugin("costly:Keeps"))
    timed = timed_by(entry, fake_tasks.Arcs().record(0), afresh=True)
    assert set(timed.spent) == {2_000_000}


def test_of_two_processes_that_timed_the_same_the_cheaper_update_counts():
    cost = update_cost([Timed([1000, 5000, 2000], True), Timed([3000, 1000, 2000], False)])
    assert (cost.mean, cost.worst, cost.repeats) == (pytest.approx(4 / 3), 2.0, False)


def test_a_run_times_plug_ins_in_processes_that_have_followed_nothing(tmp_path, fake_tasks, plugin, prepared):
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("costly:KeepsReally"))
    prepared(tmp_path, task, 0)
    run([Assignment(task, (0,), (entry,))], tmp_path, processes=2)
    cost = ResultsStore(tmp_path).load_time(task.name, task.version, entry.name, entry.source_hash)
    assert cost is not None
    assert 2000 <= cost.mean <= cost.worst
    assert cost.machine == provenance().machine


KILLED_WHILE = """
import os, signal
from pathlib import Path
from followers import Single

class Victim(Single):
    def reset(self, robot, pose):
        if Path({flag!r}).exists():
            os.kill(os.getpid(), signal.SIGKILL)
        super().reset(robot, pose)
"""


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs signals")
def test_a_row_killed_from_outside_is_tried_again(tmp_path, fake_tasks, prepared):
    """As where memory runs out: that is none of the estimator's failures."""
    task, flag, file = fake_tasks.Arcs(), tmp_path / "full", tmp_path / "victim.py"
    file.write_text(KILLED_WHILE.format(flag=str(flag)))
    flag.write_text("")
    entry = load_estimator(str(file))
    prepared(tmp_path / "results", task, 0)
    plan = [Assignment(task, (0,), (entry,))]
    run(plan, tmp_path / "results")
    assert rows_of(tmp_path / "results", task)[entry.name, 0].failure == KILLED
    flag.unlink()
    run(plan, tmp_path / "results")
    assert rows_of(tmp_path / "results", task)[entry.name, 0].failure is None
