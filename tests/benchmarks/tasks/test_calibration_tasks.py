"""Calibration methods on the leaderboard: the truth scores zero, the yardstick is plain odometry, faults stay alone."""

# pyright: reportOptionalMemberAccess=false, reportCallIssue=false, reportArgumentType=false

import dataclasses
import importlib
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.commands import results
from benchmarks.commands import run as run_command
from benchmarks.leaderboard.board import build
from benchmarks.leaderboard.views import as_json, as_markdown
from benchmarks.progress import SilentProgress
from benchmarks.results import episodes
from benchmarks.results.episodes import EpisodeStore, write_episode
from benchmarks.results.rescore import rescore
from benchmarks.results.rows import ResultsStore
from benchmarks.run import choose
from benchmarks.run.plan import Assignment, run
from benchmarks.run.worker_calibrate import observed_calibration
from benchmarks.run.worker_estimate import estimate_singly, observed_runs
from benchmarks.scoring.parameter_errors import parameter_errors
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks import official_tasks
from benchmarks.tasks.calibration import SLIP, MeasuredCalibration, SquaresCalibration, TurnsCalibration
from benchmarks.tasks.task import Episode, odometry_of
from castor_envs.cli import command_line
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.registry import load_calibration, load_estimator

ERRORS = ("offset_error", "radius_error", "half_track_error", "pivot_zero_error")
FAULTY = {
    "Raises": "raised RuntimeError: no idea in calibrate",
    "Refuses": "declined: needs six legs",
    "ReturnsText": "returned str instead of a RobotDescription",
    "OtherRobot": "returned a robot of another layout: wheels of its castors [2, 2, 2] instead of [2]",
    "OtherEncoders": "returned a robot of another layout: counts_per_rev of wheel 1 is 7.0 instead of 2000.0",
    "Impossible": "returned a robot that cannot be: ",
    "Hangs": "took over 3 s",
    "Dies": "ended its process (exit code 0)",
    "CannotBeMade": "raised RuntimeError: no when constructed",
}


@pytest.fixture(scope="module")
def by_arcs(fake_tasks):
    return importlib.import_module("fake_calibrations").CalibrationByArcs()


def rows_of(results, task):
    return {(row.estimator, row.case): row for row in ResultsStore(results).rows(task.name, task.version)}


class Heard(SilentProgress):
    def __init__(self):
        self.stages = {}

    def start(self, stage, total):
        self.stages[stage] = total


def calibration_tasks():
    return [task for task in official_tasks(None) if odometry_of(task) is not None]


def test_official_calibration_tasks_name_their_odometry():
    assert {task.name: odometry_of(task) for task in calibration_tasks()} == {
        "calibration-pivoting": "cast-0",
        "calibration-umbmark": "dead-reckoning-1",
        "calibration-physics": "cast-0",
        "calibration-measured": "dead-reckoning-1",
    }


SLOW = {"calibration-pivoting", "calibration-physics"}
"""Tasks that take seconds to record; that of squares is quicker."""


@pytest.mark.parametrize(
    "task",
    [
        pytest.param(task, id=task.name, marks=[pytest.mark.slow] * (task.name in SLOW))
        for task in calibration_tasks()
        if task.missing is None
    ],
)
def test_a_case_repeats_and_another_differs_in_recordings_too(task, tmp_path, recorded):
    first, second = (recorded(task, case) for case in task.cases(2))
    assert task.record(0).digest == first.digest != second.digest
    for first_recording, second_recording in zip(
        first.calibration.recordings, second.calibration.recordings, strict=True
    ):
        assert not np.array_equal(first_recording.log.wheel, second_recording.log.wheel)
    store = EpisodeStore(tmp_path)
    store.save(task, 0, first)
    again = store.load(task.name, task.version, 0)
    assert again.digest == first.digest == store.digest(task.name, task.version, 0)
    assert again.calibration.true_robot == first.calibration.true_robot
    for first_recording, second_recording in zip(
        again.calibration.recordings, first.calibration.recordings, strict=True
    ):
        assert (first_recording.held, first_recording.side) == (second_recording.held, second_recording.side)
        np.testing.assert_array_equal(first_recording.log.pivot, second_recording.log.pivot)


def test_no_recording_of_turns_has_a_reference_and_squares_have_their_ends_alone(recorded):
    turns = recorded(TurnsCalibration(), 0).calibration
    assert [recording.held for recording in turns.recordings] == [1, 1, 2, 2, 3, 3]
    assert all(recording.log.reference is None for recording in turns.recordings)
    for recording in recorded(SquaresCalibration(), 0).calibration.recordings:
        assert recording.side == 2.0
        np.testing.assert_array_equal(
            np.flatnonzero(np.isfinite(recording.log.reference).all(axis=1)), [0, len(recording.log) - 1]
        )


def test_the_squares_slip_as_much_as_stated(recorded):
    """Five recordings of one square differ by slip and phase alone: the variance grows with the rolled distance.

    Over six cases, both ways and two wheels there are 96 degrees of freedom: 15 % is two standard errors.
    """
    last = [
        [recording.log.wheel[-1] for recording in recorded(SquaresCalibration(), case).calibration.recordings]
        for case in range(6)
    ]
    wheel = np.reshape(last, (6, 2, 5, 2)) * 2 * np.pi / 2000 * 0.075
    rolled = 8.0 + 2 * np.pi * 0.17
    slip = np.sqrt(np.mean(np.var(wheel, axis=2, ddof=1)))
    assert slip == pytest.approx(SLIP * np.sqrt(rolled), rel=0.15)


def test_the_digest_covers_what_a_method_sees(by_arcs):
    episode = by_arcs.record(0)
    known = episode.calibration
    first_recording, second_recording = known.recordings
    changed = [
        dataclasses.replace(known, odometry="cast-0"),
        dataclasses.replace(known, odometry_source="0" * 16),
        dataclasses.replace(known, true_robot=None),
        dataclasses.replace(known, recordings=(first_recording,)),
        dataclasses.replace(known, recordings=(dataclasses.replace(first_recording, held=2), second_recording)),
        dataclasses.replace(known, recordings=(dataclasses.replace(first_recording, side=2.0), second_recording)),
        dataclasses.replace(
            known,
            recordings=(
                dataclasses.replace(
                    first_recording, log=dataclasses.replace(first_recording.log, wheel=-first_recording.log.wheel)
                ),
                second_recording,
            ),
        ),
    ]
    digests = {Episode(episode.robot, episode.runs, calibration).digest for calibration in (None, known, *changed)}
    assert len(digests) == len(changed) + 2


def test_an_episode_for_another_odometry_source_is_recorded_again(by_arcs, tmp_path, monkeypatch):
    store = EpisodeStore(tmp_path)
    store.save(by_arcs, 0, by_arcs.record(0))
    monkeypatch.setattr(episodes, "_source_now", lambda odometry: "edited")
    assert store.digest(by_arcs.name, 1, 0) is None


@pytest.fixture(scope="module")
def turns(tmp_path_factory, plugin, recorded, prepared):
    """Return the task of turns, its case 0, and the rows of the truth, the yardstick and pivoting."""
    task, folder = TurnsCalibration(), tmp_path_factory.mktemp("turns")
    episode = recorded(task, 0)
    episode.calibration.true_robot.save(folder / "true.json")
    prepared(folder / "results", task, 0)
    entries = tuple(map(load_calibration, (plugin("calibrators:Truth"), "uncalibrated", "pivoting")))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRUE_ROBOT", str(folder / "true.json"))
        run([Assignment(task, (0,), entries)], folder / "results", processes=2)
    return task, episode, rows_of(folder / "results", task)


def test_the_truth_has_no_parameter_error_and_rounding_alone_is_left(turns):
    _, episode, rows = turns
    row = rows["calibrators:Truth", 0]
    assert row.failure is None
    assert row.calibrated == episode.calibration.true_robot
    assert [row.scores[name] for name in ERRORS] == [0.0] * 4
    assert row.scores["E_max_syst"] < 0.003


def test_uncalibrated_is_plain_odometry(turns):
    task, episode, rows = turns
    row, cast = rows["uncalibrated", 0], load_estimator(odometry_of(task))
    poses = estimate_singly(cast.spec, cast.source_hash, observed_runs(episode))
    assert isinstance(poses, list)
    plain = score(episode, [estimate.poses for estimate in poses])
    assert row.calibrated == episode.robot
    for name, value in plain.items():
        assert row.scores[name] == pytest.approx(value, abs=1e-12)
    assert set(row.scores) - set(plain) == set(ERRORS)


def test_pivoting_beats_uncalibrated_by_far(turns):
    _, _, rows = turns
    found, before = rows["pivoting", 0].scores, rows["uncalibrated", 0].scores
    assert found["E_max_syst"] < before["E_max_syst"] / 20
    assert found["radius_error"] < before["radius_error"] / 50
    assert found["half_track_error"] < before["half_track_error"] / 10
    assert found["pivot_zero_error"] < before["pivot_zero_error"] / 100


def test_parameter_errors_by_hand():
    true = preset("asoc-prototype")
    first, *remaining = true.castors
    left, right = first.wheels
    wrong = dataclasses.replace(
        first,
        offset=first.offset * 1.03,
        pivot_zero=-0.3 + 2 * np.pi,
        wheels=(
            dataclasses.replace(left, radius=left.radius * 0.94),
            dataclasses.replace(right, lateral=-0.058 * 1.12),
        ),
    )
    errors = parameter_errors(dataclasses.replace(true, castors=(wrong, *remaining)), true)
    assert errors == pytest.approx(dict(zip(ERRORS, (0.01, 0.01, 0.02, 0.1), strict=True)))
    assert set(errors) <= set(BOARD_METRICS)


def test_parameters_that_a_robot_has_not_are_no_score():
    robot = preset("differential")
    assert set(parameter_errors(robot, robot)) == {"radius_error", "half_track_error"}


@pytest.fixture(scope="module")
def all_sorts(tmp_path_factory, by_arcs, plugin, prepared, one_owner):
    """Return the results folder and rows of good and faulty methods on two cases."""
    results = tmp_path_factory.mktemp("results")
    names = [plugin(f"calibrators:{kind}") for kind in ("Truth", "LooksForTruth", *FAULTY)]
    entries = tuple(load_calibration(name) for name in (*names, "uncalibrated"))
    prepared(results, by_arcs, 0, 1)
    with one_owner():
        run([Assignment(by_arcs, (0, 1), entries)], results, processes=2, timeout=3.0)
    return results, rows_of(results, by_arcs), entries


@pytest.mark.parametrize("kind", FAULTY)
def test_a_fault_costs_its_own_rows_and_says_why(all_sorts, kind):
    _, rows, _ = all_sorts
    for case in (0, 1):
        row = rows[f"calibrators:{kind}", case]
        assert row.failure.startswith(FAULTY[kind])
        assert (row.scores, row.calibrated, row.estimates) == ({}, None, ())


def test_a_method_that_works_is_not_troubled(all_sorts):
    _, rows, _ = all_sorts
    for case in (0, 1):
        truth, plain = rows["calibrators:Truth", case].scores, rows["uncalibrated", case].scores
        assert truth["radius_error"] == 0.0
        assert plain["radius_error"] == pytest.approx(1e-3 * (1 + case))
        assert plain["E_max_syst"] > truth["E_max_syst"]
        assert "offset_error" not in plain


def test_the_truth_is_nowhere_in_the_process_of_a_method(all_sorts):
    _, rows, _ = all_sorts
    assert rows["calibrators:LooksForTruth", 0].failure is None


def test_what_a_worker_gets_holds_no_truth(by_arcs):
    seen = observed_calibration(by_arcs.record(0))
    assert vars(seen).keys() == {"robot", "recordings", "runs", "odometry", "odometry_source"}
    for seen_run in seen.runs:
        assert vars(seen_run).keys() == {"robot", "start", "start_covariance", "observations", "samples"}


def test_scores_follow_from_the_stored_files_and_nothing_is_run_twice(all_sorts, by_arcs):
    results, rows, entries = all_sorts
    again = {(found.row.estimator, found.row.case): found.row.scores for found in rescore(results, by_arcs.name, 1)}
    assert again == {key: row.scores for key, row in rows.items()}
    heard = Heard()
    run([Assignment(by_arcs, (0, 1), entries)], results, timeout=3.0, progress=heard)
    assert heard.stages == {"recording episodes": 0, "running estimators": 0, "timing updates": 0}


def test_the_board_ranks_methods(all_sorts, by_arcs):
    results, _, _ = all_sorts
    leaderboard = build([by_arcs], results)
    (board,) = leaderboard.boards
    assert board.odometry == "dead-reckoning-1"
    assert [refusal.estimator for refusal in board.declined] == ["calibrators:Refuses"]
    assert [entry.estimator for entry in board.entries][:1] == ["calibrators:Truth"]
    (data,) = json.loads(json.dumps(as_json(leaderboard)))["tasks"]
    assert data["odometry"] == "dead-reckoning-1"
    assert data["entries"][0]["scores"]["radius_error"]["mean"] == 0.0
    text = as_markdown(leaderboard)
    assert "| rank | method | E_max,syst, mm |" in text
    assert "update, µs" not in text
    assert "odometry with the calibrated robot: dead-reckoning-1" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in lines}) == 1


def test_estimators_and_methods_are_not_mixed_up(by_arcs, fake_tasks):
    with pytest.raises(ValueError, match=r"judges calibration methods, and 'cast-0' is none"):
        Assignment(by_arcs, (0,), (load_estimator("cast-0"),))
    with pytest.raises(ValueError, match=r"judges estimators, and 'pivoting' is none"):
        Assignment(fake_tasks.Arcs(), (0,), (load_calibration("pivoting"),))


def test_exported_recordings_are_what_methods_get(by_arcs, tmp_path):
    episode = by_arcs.record(1)
    write_episode(tmp_path, episode)
    known = json.loads((tmp_path / "recordings.json").read_text())
    assert known["odometry"] == "dead-reckoning-1"
    assert known["recording-01.csv"] == {"held": None, "side_m": 1.0}
    assert known["recording-02.csv"] == {"held": 1, "side_m": None}
    log = read_log(tmp_path / "recording-02.csv", episode.robot)
    np.testing.assert_array_equal(log.wheel, episode.calibration.recordings[1].log.wheel)
    assert RobotDescription.load(tmp_path / "true-robot.json") == episode.calibration.true_robot


def test_the_documented_method_beats_the_first_order_correction(tmp_path, prepared, jobs_here):
    text = (Path(__file__).parents[3] / "docs" / "benchmark.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(# headings\.py\n.*?)```", text, flags=re.S)
    (tmp_path / "headings.py").write_text(code)
    task = SquaresCalibration()
    entries = tuple(map(load_calibration, (str(tmp_path / "headings.py"), "umbmark-correction")))
    prepared(tmp_path / "results", task, 0, 1)
    run([Assignment(task, (0, 1), entries)], tmp_path / "results")
    rows = rows_of(tmp_path / "results", task)
    for case in (0, 1):
        headings_scores, umbmark_scores = (
            rows["headings:Headings", case].scores,
            rows["umbmark-correction", case].scores,
        )
        assert headings_scores["E_max_syst"] < umbmark_scores["E_max_syst"] / 3


@pytest.mark.skipif("CASTOR_DATA" not in os.environ, reason="measured data are not here")
def test_measured_squares_are_held_out():
    task = MeasuredCalibration(Path(os.environ["CASTOR_DATA"]))
    for case in task.cases():
        episode = task.record(case)
        used = [recording.log for recording in episode.calibration.recordings]
        assert (len(used), [run.direction for run in episode.runs]) == (4, ["cw", "ccw"])
        assert not {id(run.log) for run in episode.runs} & {id(log) for log in used}
        assert episode.calibration.true_robot is None


@pytest.fixture
def castor_bench(monkeypatch, capsys, tmp_path, fake_tasks, by_arcs, jobs_here):
    """Return a function that runs the command on one task of each kind, in an empty folder."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.delenv("CASTOR_DATA", raising=False)
    for module in (results, choose):
        monkeypatch.setattr(module, "official_tasks", lambda measured=None: (fake_tasks.Arcs(), by_arcs))

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, [str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return leaving.value.code, out, err

    return call


def test_a_method_from_a_file_runs_on_its_tasks_alone(castor_bench, plugin):
    code, out, err = castor_bench("run", "--cases", 1, "--jobs", 1, "--method", plugin("calibrators:Truth"))
    assert code == 0, err
    assert "Calibration by arcs" in out
    assert "calibrators:Truth" in out
    assert "r_w, %" in out
    assert not Path("castor-results/rows/arcs@1").exists()


def test_an_estimator_alone_does_not_drag_calibration_along(castor_bench, plugin):
    code, out, err = castor_bench("run", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    assert code == 0, err
    assert "Calibration by arcs" not in out
    assert [path.name for path in Path("castor-results/rows").iterdir()] == ["arcs@1"]


def test_both_kinds_may_be_named_and_all_run_without_names(castor_bench, plugin, monkeypatch):
    heard = {}

    def plan_only(plan, *_):
        heard.update({a.task.name: [entry.name for entry in a.estimators] for a in plan})
        return {}

    monkeypatch.setattr(run_command, "run_plan", plan_only)
    castor_bench("run", "--estimator", "dead-reckoning-1", "--method", "pivoting")
    assert heard == {"arcs": ["dead-reckoning-1"], "calibration-by-arcs": ["pivoting"]}
    castor_bench("run")
    assert heard["arcs"] == ["dead-reckoning-1", "filter", "holmberg-khatib", "tidybot", "wheel-odometry"]
    assert heard["calibration-by-arcs"] == ["maximum-likelihood", "pivoting", "umbmark-correction", "uncalibrated"]


def test_a_method_that_serves_nothing_is_no_success(castor_bench):
    code, out, _ = castor_bench("run", "--cases", 1, "--jobs", 1, "--method", "pivoting")
    assert code == 1
    assert "pivoting declines this task: robot" in out


def test_methods_are_listed(castor_bench):
    _, out, _ = castor_bench("list")
    assert "calibration methods:\n  maximum-likelihood\n  pivoting\n  umbmark-correction\n  uncalibrated\n" in out


MISTAKES = {
    "name": (("--method", "pivotting"), "unknown calibration method 'pivotting'; did you mean 'pivoting'?"),
    "number": (("--method", "pivoting-2"), "unknown calibration method 'pivoting-2'"),
    "file without its ending": (("--method", "half"), "did you mean the file 'half.py'?"),
    "no calibrate": (("--method", "half.py"), "class Half has no method calibrate"),
    "no file": (("--method", "nowhere.py"), "nowhere.py"),
    "no module": (("--method", "nowhere:Mine"), "calibration method 'nowhere:Mine': cannot be imported"),
    "estimator's task": (
        ("--method", "pivoting", "--task", "arcs"),
        "task 'arcs' judges estimators; name them with --estimator",
    ),
    "method's task": (
        ("--estimator", "dead-reckoning-1", "--task", "calibration-by-arcs"),
        "task 'calibration-by-arcs' judges calibration methods; name them with --method",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_writes_nothing(castor_bench, mistake):
    arguments, said = MISTAKES[mistake]
    Path("half.py").write_text("class Half:\n    def reset(self, robot, pose): ...\n    update = reset\n")
    code, out, err = castor_bench("run", *arguments)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert said in err
    assert [path.name for path in Path().iterdir()] == ["half.py"]
