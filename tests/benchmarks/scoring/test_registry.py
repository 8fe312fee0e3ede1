"""Which poses are scored, what a worker sees, and that stored episodes come back as they were."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.results.archives import CorruptFileError
from benchmarks.results.episodes import EpisodeStore
from benchmarks.run.worker_estimate import observed_runs
from benchmarks.scoring.path_metrics import STANDING_STILL
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks.task import Episode, Run
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import differential, preset


def log_at(t, known=None):
    reference = np.column_stack([t, np.zeros((len(t), 2))])
    if known is not None:
        reference[~known] = np.nan
    return Log(t, np.zeros((len(t), 2)), np.empty((len(t), 0)), reference=reference)


def test_poses_are_scored_every_half_second_and_at_the_end():
    run = Run(log_at(np.arange(53) * 0.05))
    np.testing.assert_array_equal(run.samples, [0, 10, 20, 30, 40, 50, 52])
    np.testing.assert_array_equal(run.truth[:, 0], run.log.t[run.samples])


@given(st.integers(2, 60), st.integers(0, 99))
def test_scored_poses_have_a_reference_and_include_first_and_last(samples, seed):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.01, 0.4, samples))
    known = random.random(samples) < 0.5
    known[0] = True
    run = Run(log_at(t, known))
    assert np.isfinite(run.truth).all()
    assert (run.samples[0], run.samples[-1]) == (0, np.flatnonzero(known)[-1])
    assert (np.diff(run.samples) > 0).all()


@given(st.integers(2, 60), st.integers(0, 99))
def test_every_half_second_has_its_nearest_known_pose(samples, seed):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.01, 0.4, samples))
    run = Run(log_at(t))
    for wanted in np.arange(t[0], t[-1], 0.5):
        nearest = np.abs(t - wanted).min()
        assert np.abs(t[run.samples] - wanted).min() == pytest.approx(nearest)


def test_a_run_without_a_start_is_refused():
    with pytest.raises(ValueError, match="first row"):
        Run(log_at(np.arange(3.0), np.array([False, True, True])))
    with pytest.raises(ValueError, match="first row"):
        Run(Log(np.arange(3.0), np.zeros((3, 2)), np.empty((3, 0))))


def test_workers_see_the_observations_of_the_log_and_nothing_else():
    random = np.random.default_rng(0)
    log = Log(
        np.arange(20) * 0.05,
        random.normal(size=(20, 6)),
        random.normal(size=(20, 3)),
        reference=random.normal(size=(20, 3)),
        gyro=random.normal(size=20),
    )
    (run,) = observed_runs(Episode(preset("asoc-prototype"), (Run(log),)))
    np.testing.assert_array_equal(run.start, Run(log).truth[0])
    assert vars(run).keys() == {"robot", "start", "start_covariance", "observations", "samples"}
    for got, expected in zip(run.observations, log.observations(), strict=True):
        assert got.keys() == expected.keys() == {"wheel", "pivot", "time", "gyro"}
        for key in expected:
            np.testing.assert_array_equal(got[key], expected[key])


def square_episode(ends, direction_and_baseline):
    """Return an episode of runs that truly return to the start, and estimates that end at `ends`."""
    t = np.arange(0, 3, 0.5)
    reference = np.column_stack([np.minimum(t, 2.5 - t), np.zeros((len(t), 2))])
    log = Log(t, np.zeros((len(t), 2)), np.empty((len(t), 0)), reference=reference)
    runs = tuple(Run(log, direction, baseline) for direction, baseline in direction_and_baseline)
    estimates = []
    for end in ends:
        estimates.append(reference.copy())
        estimates[-1][-1] = end
    return Episode(differential(), runs), estimates


def test_scores_of_an_extended_umbmark_by_hand():
    """Baseline runs count for the systematic part of the orientation error alone."""
    kinds = [("cw", False), ("cw", False), ("ccw", False), ("cw", True), ("ccw", True)]
    ends = [(-0.1, 0, -0.3), (-0.1, 0.2, -0.5), (0, -0.2, 0.1), (9, 9, -0.1), (9, 9, 0.2)]
    episode, estimates = square_episode(ends, kinds)
    scores = score(episode, estimates)
    assert scores["r_cw"] == pytest.approx(np.hypot(0.1, 0.1))
    assert scores["r_ccw"] == scores["E_max_syst"] == pytest.approx(0.2)
    assert scores["orientation_error"] == pytest.approx((0.4 + 0.1) / 2)
    assert scores["nonsystematic_orientation_error"] == pytest.approx((0.3 + 0.1) / 2)
    assert scores["end_point_position"] == pytest.approx((0.1 + np.hypot(0.1, 0.2) + 0.2) / 3)
    assert scores["end_point_heading"] == pytest.approx(0.3)
    assert scores.keys() - BOARD_METRICS.keys() == {STANDING_STILL}


def test_other_paths_have_no_umbmark_scores():
    episode, estimates = square_episode([(0.3, 0.4, 0)], [(None, False)])
    scores = score(episode, estimates)
    assert "E_max_syst" not in scores
    assert scores["end_point_position"] == pytest.approx(0.5)


def straight_runs(*ways):
    """Return an episode of runs straight ahead at 0.5 m/s, of so many metres, and estimates that are 1 % too long."""
    logs = []
    for way in ways:
        t = np.arange(0, way / 0.5 + 1e-9, 0.05)
        reference = np.stack([0.5 * t, 0 * t, 0 * t], axis=-1)
        logs.append(Log(t, np.zeros((len(t), 2)), np.empty((len(t), 0)), reference=reference))
    episode = Episode(differential(), tuple(map(Run, logs)))
    return episode, [run.truth * [1.01, 1, 1] for run in episode.runs]


OF_SEGMENTS = ("rpe_translation", "rpe_rotation", "drift")


def test_runs_that_are_too_short_for_a_relative_error_leave_it_to_the_others():
    scores = score(*straight_runs(12.0, 0.5, 4.0))
    assert [scores[name] for name in OF_SEGMENTS] == pytest.approx([0.01, 0.0, 0.01])
    assert score(*straight_runs(0.5, 0.9)).keys().isdisjoint(OF_SEGMENTS)
    assert "rpe_translation" in score(*straight_runs(1.0))


def test_an_estimate_without_end_is_not_left_out_of_relative_errors():
    episode, (first, second) = straight_runs(12.0, 12.0)
    with np.errstate(all="ignore"):
        scores = score(episode, [first, second * [1e308, 1, 1]])
    assert not any(np.isfinite(scores[name]) for name in ("rpe_translation", "drift"))


def test_the_truth_scores_zero():
    episode, _ = square_episode([], [("cw", False), ("ccw", False), ("cw", True), ("ccw", True)])
    scores = score(episode, [run.truth for run in episode.runs])
    assert {value for name, value in scores.items() if name != STANDING_STILL} == {0.0}
    assert scores[STANDING_STILL] > 0


def test_an_episode_of_baselines_alone_is_refused():
    with pytest.raises(ValueError, match="not a baseline"):
        square_episode([(0, 0, 0)], [("cw", True)])


@pytest.fixture
def stored(tmp_path, fake_tasks):
    task = fake_tasks.Arcs()
    log = fake_tasks.arc(0.4, 30, task.robot, gyro=True)
    log = dataclasses.replace(
        log, wheel=np.rint(log.wheel), command=np.full((30, 2), np.nan), extra={"note": ["x"] * 30}
    )
    episode = Episode(task.robot, (Run(log, "cw"), Run(fake_tasks.arc(-0.4, 20, task.robot), "ccw", baseline=True)))
    store = EpisodeStore(tmp_path)
    store.save(task, 3, episode)
    return store, task, episode


def test_a_stored_episode_comes_back_bit_for_bit(stored):
    store, task, episode = stored
    again = store.load(task.name, task.version, 3)
    assert again.robot == episode.robot
    assert again.digest == episode.digest == store.digest(task.name, task.version, 3)
    for run, before in zip(again.runs, episode.runs, strict=True):
        assert (run.direction, run.baseline) == (before.direction, before.baseline)
        for part in ("t", "wheel", "pivot", "command", "steering_command", "reference", "gyro"):
            np.testing.assert_array_equal(getattr(run.log, part), getattr(before.log, part))


def test_the_digest_covers_what_scores_depend_on(stored, fake_tasks):
    _, _, episode = stored
    run, second_run = episode.runs
    changed = [
        Episode(fake_tasks.with_radius_error(episode.robot, 1e-12), episode.runs),
        Episode(episode.robot, (run,)),
        Episode(episode.robot, (dataclasses.replace(run, direction="ccw"), second_run)),
        Episode(episode.robot, (run, dataclasses.replace(second_run, baseline=False))),
        *(
            Episode(
                episode.robot, (dataclasses.replace(run, log=dataclasses.replace(run.log, **{part: value})), second_run)
            )
            for part, value in {
                "t": run.log.t * 1.5,
                "wheel": run.log.wheel + 1e-9,
                "gyro": None,
                "reference": -run.log.reference,
            }.items()
        ),
    ]
    assert len({episode.digest, *(changed_episode.digest for changed_episode in changed)}) == len(changed) + 1


@pytest.mark.parametrize("damage", ["cut", "flip", "foreign", "empty"])
def test_damaged_episodes_are_named(stored, damage):
    store, task, _ = stored
    path = store.path(task.name, task.version, 3)
    data = bytearray(path.read_bytes())
    if damage == "flip":
        for k in range(0, len(data), 50):
            data[k] ^= 255
    path.write_bytes({"cut": data[: len(data) // 2], "flip": data, "foreign": b"PK not", "empty": b""}[damage])
    with pytest.raises(CorruptFileError, match=r"3\.npz"):
        store.load(task.name, task.version, 3)


def test_case_names_stay_in_their_folder(tmp_path):
    with pytest.raises(ValueError, match="letters"):
        EpisodeStore(tmp_path).path("task", 1, "../elsewhere")


def test_what_estimators_see_changes_an_episodes_digest():
    """Commands too: rows of an estimator that uses them must not be taken for those on other commands."""
    t, told = np.arange(3.0), np.ones((3, 2))
    log = log_at(t)

    def digest(**parts):
        return Episode(differential(), (Run(dataclasses.replace(log, **parts)),)).digest

    digests = {digest(), digest(command=told), digest(command=2 * told), digest(steering_command=told)}
    assert len(digests) == 4
