"""Trains in the benchmark: snapshots recomputed with complex numbers, stored, exported, and run by plug-ins."""

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.rescore import rescore
from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from benchmarks.run.worker_estimate import Timed, estimate_singly, observed_runs, time_updates, update_cost
from benchmarks.scoring.path_metrics import STANDING_STILL
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks import snapshots
from benchmarks.tasks.static_tests import STATIC_TESTS
from benchmarks.tasks.task import Episode, Run
from castor_envs.cli import command_line
from castor_envs.logs.csv import read_log
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr, preset
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.registry import load_estimator
from estimators.trains.grpec import GRPECXY
from estimators.trains.odometry import TrainOdometry

TASKS = {task.name: task for task in snapshots.tasks(None)}
RANDOM = [name for name, task in TASKS.items() if isinstance(task, snapshots.DeviantAxles)]


def belief_of(run):
    """Return the belief (N, 3) of a snapshot."""
    assert run.belief is not None
    return run.belief


def readings_of(run):
    """Return the relative poses (K, F, 3) of a train's log, and their ages (K, F)."""
    assert run.log.rps is not None
    assert run.log.rps_age is not None
    return run.log.rps.reshape(len(run.log), -1, 3), run.log.rps_age


def complex_poses(poses):
    """Return places (..., N) as complex numbers, and headings (..., N)."""
    return poses[..., 0] + 1j * poses[..., 1], poses[..., 2]


def estimates_of(estimator, episode):
    """Return what an estimator believes at the end of every snapshot, (N, 1, 3) each."""
    found = []
    for observed in observed_runs(episode):
        estimator.reset(observed.robot, observed.start)
        answers = [estimator.update(observed.observations.at(k)) for k in range(len(observed.observations))]
        found.append(answers[-1][:, None])
    return found


def attached(relative, pose, axle):
    """Return places and headings of all axles (axle from 0), by complex numbers: front = rear + seen * e^(i psi)."""
    n = len(relative) + 1
    z, psi = np.zeros(n, complex), np.zeros(n)
    z[axle], psi[axle] = pose[0] + 1j * pose[1], pose[2]
    for i in range(axle, 0, -1):
        x, y, phi = relative[i - 1]
        z[i - 1], psi[i - 1] = z[i] + (x + 1j * y) * np.exp(1j * psi[i]), psi[i] + phi
    for i in range(axle, n - 1):
        x, y, phi = relative[i]
        psi[i + 1] = psi[i] - phi
        z[i + 1] = z[i] - (x + 1j * y) * np.exp(1j * psi[i + 1])
    return z, psi


# The recorded snapshots


@pytest.mark.parametrize("name", RANDOM)
def test_random_snapshots_are_what_they_say(name):
    """The true frames are arcs; odometry and sensors are off by the stated noise, deviant axles by the stated range."""
    task = TASKS[name]
    assert isinstance(task, snapshots.DeviantAxles)
    noise, readings, distances, turns = [], [], [], []
    for case in task.cases():
        for recorded in task.record(case).runs:
            z, psi = complex_poses(recorded.truth[:, -1])
            angle = psi[:-1] - psi[1:]
            seen = (z[:-1] - z[1:]) * np.exp(-1j * psi[1:])
            assert np.abs(angle).max() <= np.radians(60)
            np.testing.assert_allclose(seen, 0.35 * (np.exp(1j * angle) - 1) / (1j * angle), atol=1e-9)
            (first, last), ages = readings_of(recorded)
            np.testing.assert_array_equal(first, last)
            assert not recorded.log.wheel.any()
            assert not ages.any()
            np.testing.assert_array_equal(recorded.log.t, [0, 10])
            readings.append(last - np.stack([seen.real, seen.imag, angle], axis=-1))
            off = belief_of(recorded) - recorded.truth[:, -1]
            sound = np.isin(np.arange(task.axles) + 1, recorded.sound)
            assert sound.sum() == task.axles - task.deviant
            noise.append(off[sound])
            distances.append(np.hypot(*off[~sound, :2].T))
            turns.append(off[~sound, 2])
    noise, readings = np.concatenate(noise), np.concatenate(readings)
    distances, turns = np.concatenate(distances), np.concatenate(turns)
    assert len(readings) == 20 * 25 * (task.axles - 1)
    within = 4 / np.sqrt(2 * len(noise))
    np.testing.assert_allclose(noise.std(axis=0), [0.01, 0.01, np.radians(1)], rtol=within)
    np.testing.assert_allclose(readings.std(axis=0), [0.02, 0.02, np.radians(2)], rtol=4 / np.sqrt(2 * len(readings)))
    low, high = (0.03, 0.08) if name == "configuration-small" else (0.10, 0.40)
    assert low - 0.05 < distances.min() < low + 0.02
    assert high - 0.03 < distances.max() < high + 0.05
    largest = np.radians(10 if name == "configuration-small" else 60)
    assert turns.min() == pytest.approx(-largest, abs=0.06)
    assert turns.max() == pytest.approx(largest, abs=0.06)


def test_every_axle_is_deviant_as_often():
    task = TASKS["configuration-two-of-five"]
    sound = [axle for case in task.cases() for recorded in task.record(case).runs for axle in recorded.sound]
    expected = 500 * 3 / 5
    np.testing.assert_allclose(np.bincount(sound)[1:], expected, atol=4 * np.sqrt(500 * 0.6 * 0.4))


def test_opposite_bends_sweep_the_ratio_about_axle_two():
    task = TASKS["configuration-opposite-bends"]
    assert isinstance(task, snapshots.OppositeBends)
    ratios = []
    for case in task.cases():
        for recorded in task.record(case).runs:
            z, psi = complex_poses(recorded.truth[:, -1])
            a, b = psi[0] - psi[1], psi[1] - psi[2]
            ratios.append(-a / b)
            assert b == pytest.approx(-np.radians(60.8))
            np.testing.assert_allclose(belief_of(recorded)[:, 2], 0, atol=np.radians(1))
            np.testing.assert_allclose(belief_of(recorded)[:, :2], [[0.7, 0], [0.35, 0], [0, 0]], atol=0.012)
            assert recorded.sound == (2,)
            assert np.abs(belief_of(recorded)[1] - recorded.truth[1, -1]).max() < 0.015
            assert abs(z[1] - 0.35) < 1e-12
    np.testing.assert_allclose(ratios, np.repeat(np.linspace(0.40, 0.95, 20), 25))
    assert task.record(20).digest != task.record(0).digest
    assert task.ratio(20) == task.ratio(0)


def test_the_static_tests_are_the_papers():
    task = TASKS["configuration-static"]
    assert task.cases() == ["test-1", "test-2", "test-3", "test-4"]
    for case, test in zip(task.cases(), STATIC_TESTS, strict=True):
        (recorded,) = task.record(case).runs
        np.testing.assert_array_equal(recorded.belief, test.odometry)
        np.testing.assert_array_equal(recorded.log.rps, [test.relative.ravel()] * 2)
        z, psi = attached(test.relative, test.odometry[test.true_axle - 1], test.true_axle - 1)
        found_z, found_psi = complex_poses(recorded.truth[:, -1])
        np.testing.assert_allclose(found_z, z, atol=1e-12)
        np.testing.assert_allclose(found_psi, psi, atol=1e-12)
        np.testing.assert_allclose(recorded.truth[:, -1], test.truth, atol=1e-12)
        assert test.true_axle in recorded.sound
    # In tests 1 and 4 a frame is straight, as odometry says of its two axles; in 2 and 3 no frame is.
    assert [task.record(case).runs[0].sound for case in task.cases()] == [(2, 3), (2,), (2,), (2, 3)]


# Scores


@pytest.mark.parametrize("name", TASKS)
def test_odometry_alone_scores_what_was_put_in_and_the_truth_nothing(name):
    task = TASKS[name]
    episode = task.record(task.cases()[0])
    put_in = np.mean(
        [np.abs(np.subtract(*(complex_poses(p)[0] for p in (r.belief, r.truth[:, -1])))) for r in episode.runs]
    )
    scores = score(episode, estimates_of(TrainOdometry(), episode))
    assert scores[task.metric] == pytest.approx(put_in, rel=1e-12)
    assert "sound_axle_chosen" not in scores
    assert STANDING_STILL not in scores
    perfect = score(episode, [r.truth for r in episode.runs])
    assert perfect[task.metric] == perfect["final_axle_heading"] == 0.0
    assert perfect["share_within_5cm"] == 1.0


def test_scores_of_grpec_agree_with_complex_numbers():
    """Attach to every axle, take the one whose places differ least from odometry's (Vogt, eqs. 2, 3 and 5)."""
    episode = TASKS["configuration-two-of-five"].record(3)
    errors, chosen = [], []
    for recorded in episode.runs:
        relative, belief = readings_of(recorded)[0][-1], belief_of(recorded)
        od, _ = complex_poses(belief)
        candidates = [attached(relative, belief[axle], axle)[0] for axle in range(5)]
        best = min(range(5), key=lambda axle: np.abs(candidates[axle] - od).sum())
        errors.append(np.abs(candidates[best] - complex_poses(recorded.truth[:, -1])[0]).mean())
        chosen.append(best + 1 in recorded.sound)
    scores = score(episode, estimates_of(GRPECXY(), episode))
    assert scores["mean_axle_position"] == pytest.approx(np.mean(errors), abs=1e-12)
    assert scores["share_within_5cm"] == np.mean(np.array(errors) < 0.05)
    assert scores["sound_axle_chosen"] == np.mean(chosen)
    assert scores["contradiction"] == pytest.approx(0, abs=1e-12)


# What is stored and what estimators see


def test_a_belief_fits_its_train():
    log = Log(np.arange(2.0), np.zeros((2, 6)), np.empty((2, 0)), reference=np.zeros((2, 9)))
    for wrong in (np.zeros((2, 3)), np.zeros(3), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="belief"):
            Run(log, belief=wrong)
    with pytest.raises(ValueError, match="sound"):
        Run(log, belief=np.zeros((3, 3)), sound=(4,))
    robot = Log(np.arange(2.0), np.zeros((2, 2)), np.empty((2, 0)), reference=np.zeros((2, 3)))
    with pytest.raises(ValueError, match="belief"):
        Run(robot, belief=np.zeros((1, 3)))


def test_workers_see_a_trains_observations_and_the_belief():
    episode = TASKS["configuration-one-of-three"].record(0)
    (seen, *_), (recorded, *_) = observed_runs(episode), episode.runs
    np.testing.assert_array_equal(seen.start, recorded.belief)
    for k, expected in enumerate(recorded.log.observations()):
        got = seen.observations.at(k)
        assert got.keys() == expected.keys() == {"wheel", "time", "rps", "rps_age"}
        for key in expected:
            np.testing.assert_array_equal(got[key], expected[key])
    # No number of the truth is in what a worker gets.
    held = np.concatenate([np.ravel(part) for part in vars(seen.observations).values() if part is not None])
    assert not np.isin(recorded.truth, [*held, *seen.start.ravel()]).any()


def test_a_driving_train_starts_from_the_truth_and_is_followed(fake_trains):
    episode = fake_trains.moving_train()
    (observed,) = observed_runs(episode)
    np.testing.assert_array_equal(observed.start, [[0.7, 0, 0], [0.35, 0, 0], [0, 0, 0]])
    assert episode.runs[0].truth.shape == (3, 5, 3)
    np.testing.assert_allclose(episode.runs[0].truth[0, :, 0], 0.7 + 0.4 * np.array([0, 0.5, 1, 1.5, 2]))
    entry = load_estimator("estimators.trains.odometry:TrainOdometry")
    answer = estimate_singly(entry.spec, entry.source_hash, [observed])
    assert isinstance(answer, list)
    estimate = answer[0].poses
    np.testing.assert_allclose(estimate, episode.runs[0].truth, atol=1e-12)
    scores = score(episode, [estimate])
    assert scores["mean_axle_position"] < 1e-12
    assert scores[STANDING_STILL] == pytest.approx(0.4 * np.sqrt(np.mean(np.array([0, 0.5, 1, 1.5, 2]) ** 2)))
    assert scores["ate"] < 1e-12
    assert scores["contradiction"] < 1e-12
    timed = time_updates(entry.spec, entry.source_hash, [observed])
    assert isinstance(timed, Timed)
    cost = update_cost([timed])
    assert 0 < cost.mean <= cost.worst


def test_without_any_reading_odometry_continues_silently(fake_trains):
    (drive,) = fake_trains.moving_train().runs
    blind = Run(dataclasses.replace(drive.log, rps=np.full((len(drive.log), 6), np.nan)))
    entry = load_estimator("estimators.trains.grpec:GRPECXY")
    answer = estimate_singly(entry.spec, entry.source_hash, observed_runs(Episode(cfmmr(3), (blind,))))
    assert isinstance(answer, list)
    np.testing.assert_allclose(answer[0].poses, drive.truth, atol=1e-12)


def test_what_rounding_leaves_is_shown_as_nothing():
    metric = BOARD_METRICS["mean_axle_position"]
    assert [metric.shown(value) for value in (3e-17, -3e-17, 2e-9, 0.01234567, None)] == [
        *("0.000", "0.000", "2.000e-06", "12.35", "–")
    ]


def test_a_stored_train_episode_comes_back_bit_for_bit(tmp_path):
    task = TASKS["configuration-two-of-five"]
    episode = task.record(1)
    assert episode.digest == task.record(1).digest
    store = EpisodeStore(tmp_path)
    store.save(task, 1, episode)
    again = store.load(task.name, task.version, 1)
    assert again.robot == episode.robot
    assert again.digest == episode.digest
    for loaded, before in zip(again.runs, episode.runs, strict=True):
        assert loaded.sound == before.sound
        np.testing.assert_array_equal(loaded.belief, before.belief)
        np.testing.assert_array_equal(loaded.log.rps, before.log.rps)
        np.testing.assert_array_equal(loaded.log.rps_age, before.log.rps_age)


def test_the_digest_covers_what_a_trains_scores_depend_on():
    (recorded,) = TASKS["configuration-static"].record("test-2").runs
    log, train, belief = recorded.log, cfmmr(3), belief_of(recorded)
    rps, age = np.array(log.rps), np.array(log.rps_age)
    changed = [
        recorded,
        dataclasses.replace(recorded, belief=belief + 1e-12),
        dataclasses.replace(recorded, belief_covariance=None),
        dataclasses.replace(recorded, belief=None, belief_covariance=None, oracle=None, sound=()),
        dataclasses.replace(recorded, sound=(1,)),
        dataclasses.replace(recorded, log=dataclasses.replace(log, rps=rps + 1e-12)),
        dataclasses.replace(recorded, log=dataclasses.replace(log, rps_age=age + 1)),
        dataclasses.replace(recorded, log=dataclasses.replace(log, rps=None, rps_age=None)),
    ]
    assert len({Episode(train, (changed_run,)).digest for changed_run in changed}) == len(changed)


def test_digests_of_robots_are_as_before_there_were_trains():
    """sha256 of the robot's hash, then of each run: direction, baseline, and five arrays, their lengths before them."""
    log = Log(np.arange(3.0), np.ones((3, 2)), np.empty((3, 0)), reference=np.zeros((3, 3)), gyro=np.ones(3))
    episode = Episode(preset("differential"), (Run(log, "cw"),))
    text = episode.robot.hash().encode() + b"cw False"
    for array in map(np.asarray, (log.t, log.wheel, log.pivot, log.gyro, log.reference)):
        text += (8 * array.size).to_bytes(8, "little") + array.tobytes()
    assert episode.digest == hashlib.sha256(text).hexdigest()[:16]


# Runs


ATTACHES = """
import numpy as np

class Attaches:
    '''Attaches the relative poses to the second axle.'''

    batched = True  # of robots; a train always comes alone

    def reset(self, train, poses):
        self.poses = np.array(poses)
        assert self.poses.shape == (len(train.modules), 3)

    def update(self, seen):
        if seen["time"][0] > 5:
            z, psi = self.poses[:, 0] + 1j * self.poses[:, 1], self.poses[:, 2]
            (x, y, a), (u, v, b) = seen["rps"].reshape(2, 3)
            z[0], psi[0] = z[1] + (x + 1j * y) * np.exp(1j * psi[1]), psi[1] + a
            psi[2] = psi[1] - b
            z[2] = z[1] - (u + 1j * v) * np.exp(1j * psi[2])
            self.poses = np.stack([z.real, z.imag, psi], axis=-1)
        return self.poses.copy()

class Loses(Attaches):
    def update(self, seen):
        poses = super().update(seen)
        return poses * np.nan if seen["time"][0] > 5 else poses

class OneAxle(Attaches):
    def update(self, seen):
        return super().update(seen)[0]

class OfRobots:
    def reset(self, robot, pose):
        self.castors = robot.castors

    def update(self, seen):
        return np.zeros(3)
"""


@pytest.fixture
def castor_bench(monkeypatch, capsys, tmp_path, jobs_here):
    """Return a function that runs the command in an empty folder; it returns code, out and err."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CASTOR_DATA", raising=False)
    Path("mine.py").write_text(ATTACHES)

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, [str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return leaving.value.code, out, err

    return call


def test_a_plug_in_runs_on_a_trains_task(castor_bench):
    """Attaching to axle 2 is right in tests 2 to 4 exactly, and in test 1 nearly: axle 3 is the true one there."""
    arguments = ("--task", "configuration-static", "--jobs", 1)
    code, out, err = castor_bench("run", *arguments, "--estimator", "mine.py:Attaches", "--estimator", "mine.py:Loses")
    assert code == 1, err  # Loses fails everywhere
    assert "axles, mm" in out
    assert "sound, %" in out
    assert "mine:Loses failed 4 of 4 cases (test-1, test-2, test-3, ...): returned NaN or infinity at sample 1" in out
    rows = {
        row.case: row for row in ResultsStore(Path("castor-results")).rows("configuration-static", 1) if not row.failure
    }
    assert set(rows) == {"test-1", "test-2", "test-3", "test-4"}
    errors = [rows[f"test-{k}"].scores["mean_axle_position"] for k in (1, 2, 3, 4)]
    assert 1e-4 < errors[0] < 5e-3
    assert max(errors[1:]) < 1e-12
    assert all(row.scores["sound_axle_chosen"] == 1.0 for row in rows.values())
    assert {
        again.row.case: again.row.scores
        for again in rescore(Path("castor-results"), "configuration-static", 1)
        if not again.row.failure
    } == {case: row.scores for case, row in rows.items()}
    code, out, _ = castor_bench("leaderboard", "--json", "--task", "configuration-static")
    (board,) = json.loads(out)["tasks"]
    assert code == 0
    (entry,) = [board_entry for board_entry in board["entries"] if board_entry["estimator"] == "mine:Attaches"]
    assert entry["rank"] == 1
    assert not entry["stands_still"]
    assert entry["scores"]["share_within_5cm"]["mean"] == 1.0
    assert 0 < entry["mean_update_us"] <= entry["worst_update_us"]


def test_who_stays_put_in_a_snapshot_is_ranked_all_the_same(castor_bench):
    Path("still.py").write_text(
        "class Still:\n def reset(self, train, poses): self.poses = poses\n def update(self, seen): return self.poses\n"
    )
    code, out, err = castor_bench(
        "run", "--task", "configuration-small", "--cases", 2, "--jobs", 1, "--estimator", "still.py"
    )
    assert code == 0, err
    assert "│    1 │ still:Still" in out
    assert "not ranked" not in out


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("OneAxle", 1, "mine:OneAxle failed 1 of 1 cases (test-1): returned shape (3,) instead of (3, 3) in update"),
        ("OfRobots", 1, "mine:OfRobots declined every task: is written for robots: it asks for 'castors'"),
    ],
)
def test_a_plug_in_that_is_not_for_trains_is_distinguished(castor_bench, name, code, said):
    arguments = ("run", "--task", "configuration-static", "--cases", 1, "--jobs", 1, "--estimator")
    exited, out, err = castor_bench(*arguments, f"mine.py:{name}")
    assert exited == code
    assert said in out + err


def test_robots_and_trains_estimators_decline_each_other(castor_bench):
    Path("drives.py").write_text(
        "from estimators.robots.dead_reckoning import DeadReckoning\nclass Drives(DeadReckoning):\n    pass\n"
    )
    Path("rolls.py").write_text(
        "from estimators.trains.odometry import TrainOdometry\nclass Rolls(TrainOdometry):\n    pass\n"
    )
    code, out, _ = castor_bench(
        *("run", "--cases", 1, "--jobs", 1, "--task", "configuration-static", "--task", "umbmark-kinematic-calibrated"),
        *("--estimator", "drives.py", "--estimator", "rolls.py"),
    )
    assert code == 0
    assert "drives:Drives declines this robot: serves a single robot, and 'CFMMR, 3 axles' is a train" in out
    assert "rolls:Rolls declines this robot: serves trains, and this is a robot" in out
    assert "failed" not in out


def test_an_exported_snapshot_reads_back(castor_bench):
    code, _, err = castor_bench("export", "configuration-two-of-five", "--cases", 2, "--out", "out")
    assert code == 0, err
    episode = TASKS["configuration-two-of-five"].record(1)
    folder = Path("out/case-1")
    train = TrainDescription.load(folder / "train.json")
    assert train == episode.robot
    beliefs = json.loads((folder / "beliefs.json").read_text())
    assert beliefs.pop("format") == "castor-beliefs/1"
    assert sorted(path.name for path in folder.glob("*.csv")) == sorted(beliefs)
    assert len(beliefs) == 25
    for k, recorded in enumerate(episode.runs, start=1):
        log = read_log(folder / f"run-{k:02d}.csv", train)
        np.testing.assert_array_equal(log.reference, recorded.log.reference)
        np.testing.assert_array_equal(log.rps, recorded.log.rps)
        np.testing.assert_array_equal(beliefs[f"run-{k:02d}.csv"], recorded.belief)


def test_a_metric_of_which_more_is_better_ranks_nothing(tmp_path, fake_trains):
    for name in ("share_within_5cm", "sound_axle_chosen"):
        with pytest.raises(ValueError, match="larger"):
            run([Assignment(fake_trains.Ahead(metric=name), (0,), ())], tmp_path)
    unranked = [name for name, metric in BOARD_METRICS.items() if not metric.ranks]
    assert {"share_within_5cm", "sound_axle_chosen", "nees", "inside_95"} <= set(unranked)


def test_a_driving_train_passes_a_whole_run(tmp_path, fake_trains, jobs_here):
    (tmp_path / "mine.py").write_text("from estimators.trains.grpec import GRPECXY\nclass Mine(GRPECXY):\n    pass\n")
    run([Assignment(fake_trains.Ahead(), (0,), (load_estimator(str(tmp_path / "mine.py")),))], tmp_path / "results")
    (row,) = ResultsStore(tmp_path / "results").rows("ahead", 1)
    assert row.failure is None
    assert row.scores["mean_axle_position"] < 1e-12
    assert row.estimates[0].shape == (3, 5, 3)
