"""Stored files may hold anything: what cannot be used is refused by name in one line, and the rest is shown."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from benchmarks.leaderboard.board import build
from benchmarks.leaderboard.views import as_json, as_markdown, print_leaderboard
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import provenance
from benchmarks.results.rows import ResultsStore, Row, UpdateCost

MANY = 10**40
ESTIMATE = np.zeros((2, 3))


@pytest.fixture
def folder(tmp_path, fake_tasks):
    """A results folder with two rows of one estimator on stored episodes, its time, and a good row of another."""
    task, store = fake_tasks.Arcs(), ResultsStore(tmp_path)
    for case in (0, 1):
        episode = task.record(case)
        EpisodeStore(tmp_path).save(task, case, episode)
        for name in ("mine", "other"):
            scores = {"E_max_syst": 0.01 * (1 + case), "ate": 0.01}
            row = Row("arcs", 1, name, "a" * 16, case, episode.digest, "d" * 16, scores=scores, estimates=(ESTIMATE,))
            store.save(row)
    store.save_time("arcs", 1, "mine", "a" * 16, UpdateCost(12.0, 34.0), provenance())
    return tmp_path


def row_path(folder):
    return folder / "rows" / "arcs@1" / f"mine-{'a' * 16}" / "1.npz"


def rewrite(path, change, arrays=None):
    """Change the metadata of a stored file; `arrays` replaces what else it holds."""
    with np.load(path) as archive:
        stored = {name: archive[name] for name in archive.files}
    metadata = json.loads(str(stored.pop("metadata")))
    change(metadata)
    np.savez(path, metadata=np.array(json.dumps(metadata)), **(stored if arrays is None else arrays))


def put(*keys, value):
    def change(metadata):
        for key in keys[:-1]:
            metadata = metadata[key]
        metadata[keys[-1]] = value

    return change


def shown(folder, task):
    """Return the leaderboard, drawn in every way."""
    leaderboard = build([task], folder)
    json.dumps(as_json(leaderboard), allow_nan=False)
    print_leaderboard(leaderboard, Console(width=120, quiet=True))
    return leaderboard, as_markdown(leaderboard)


NESTED = {"a": [[[{"b": list(range(2000))}]] * 20] * 5}
BAD = [
    put("origin", "created", value=["2020"]),
    put("origin", "created", value="yesterday"),
    put("origin", "created", value="2020-01-01T00:00:00"),
    put("origin", "created", value=MANY),
    put("origin", "versions", value=["3"]),
    put("origin", "versions", "python", value=3),
    put("origin", "machine", value=None),
    put("origin", "machine", "cpu_count", value="two"),
    put("origin", value=NESTED),
    put("case", value="\x00"),
    put("case", value=MANY),
    put("case", value=1.0),
    put("case", value=True),
    put("case", value="1"),
    put("case", value=0),
    put("case", value=-1),
    put("failure", value=-1),
    put("failure", value="half a failure"),
    put("failure", value="\ud800"),
    put("status", value="failed"),
    put("timeout_s", value="60"),
    put("timeout_s", value=-1),
    put("scores", value=[]),
    put("scores", value={}),
    put("scores", value={"ate": 0.01}),
    put("scores", "E_max_syst", value="NaN"),
    put("scores", "E_max_syst", value=float("nan")),
    put("scores", "E_max_syst", value=-1.0),
    put("scores", "E_max_syst", value=10**400),
    put("scores", "E_max_syst", value=NESTED),
    put("scores", "x" * 100_000, value="NaN"),
    put("task", value="elsewhere"),
    put("task", value=None),
    put("task_version", value=MANY),
    put("estimator", value="../../mine"),
    put("estimator", value=""),
    put("source_hash", value="b" * 16),
    put("source_hash", value="a" * 10_000),
    put("episode", value=None),
    put("robot_hash", value=7),
    put("calibrated", value={"format": "castor-robot/1"}),
    put("calibrated", value=NESTED),
    put("format", value=["castor-row/2"]),
    put("format", value="castor-row/3"),
    put("surplus", value=1),
    lambda metadata: metadata.pop("origin"),
    lambda metadata: metadata.clear(),
]


@pytest.mark.parametrize("change", BAD)
def test_a_row_that_cannot_be_used_is_refused_by_name(folder, fake_tasks, change):
    path = row_path(folder)
    rewrite(path, change)
    leaderboard, text = shown(folder, fake_tasks.Arcs())
    assert [error.path for error in leaderboard.refused] == [path]
    (line,) = [line for line in text.splitlines() if line.startswith("rows refused: ")]
    assert str(path) in line
    assert len(line) < 600
    done = {entry.estimator: entry.done for entry in leaderboard.boards[0].entries}
    assert done == {"mine": 1, "other": 2}


@pytest.mark.parametrize(
    "arrays",
    [
        {"estimate_1": ESTIMATE},
        {"estimate_0": ESTIMATE, "other": ESTIMATE},
        {"estimate_0": ESTIMATE[:, :2]},
        {"estimate_0": np.array("text")},
        {"estimate_0": np.full((2, 3), np.nan)},
    ],
)
def test_estimates_that_are_no_poses_are_refused(folder, fake_tasks, arrays):
    rewrite(row_path(folder), lambda metadata: None, arrays)
    leaderboard, _ = shown(folder, fake_tasks.Arcs())
    assert [error.path for error in leaderboard.refused] == [row_path(folder)]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=True) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
KEYS = [
    ("task",), ("task_version",), ("estimator",), ("source_hash",), ("case",), ("episode",), ("robot_hash",),
    ("status",), ("failure",), ("timeout_s",), ("scores",), ("scores", "E_max_syst"), ("origin",),
    ("origin", "created"), ("origin", "machine"), ("calibrated",), ("format",),
]  # fmt: skip


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(keys=st.sampled_from(KEYS), value=JSON)
def test_whatever_stands_in_a_row_it_is_read_or_refused(folder, fake_tasks, keys, value):
    path = row_path(folder)
    before = path.read_bytes()
    try:
        rewrite(path, put(*keys, value=value))
        leaderboard = build([fake_tasks.Arcs()], folder)
        (board,) = leaderboard.boards
        read = sum(entry.done + sum(len(failed.cases) for failed in entry.failed) for entry in board.entries)
        other_recording = keys == ("episode",) and not leaderboard.refused
        assert read + len(leaderboard.refused) + other_recording == 4
    finally:
        path.write_bytes(before)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"format": "castor-time/4"}', "[" * 100_000, '{"format": 1e999}', "\x00"]
)
def test_a_time_that_cannot_be_read_is_refused(folder, fake_tasks, text):
    path = row_path(folder).with_name("time.json")
    path.write_text(text)
    leaderboard, _ = shown(folder, fake_tasks.Arcs())
    assert [error.path for error in leaderboard.refused] == [path]
    assert leaderboard.boards[0].entries[0].cost is None


@pytest.mark.parametrize(
    "change",
    [
        put("digest", value=["e"]),
        put("case", value=2),
        put("runs", value=[{"direction": "up", "baseline": False, "sound": []}]),
        put("robot", value=[]),
        put("origin", "world", value=None),
        put("calibration", value={"odometry": "plugin.py"}),
    ],
)
def test_an_episode_that_cannot_be_used_is_refused_by_name(folder, fake_tasks, change):
    path = EpisodeStore(folder).path("arcs", 1, 1)
    rewrite(path, change)
    leaderboard, text = shown(folder, fake_tasks.Arcs())
    assert [error.path for error in leaderboard.refused_episodes] == [path]
    assert text.count("episodes refused: ") == 1
    assert not leaderboard.refused
    with pytest.raises(CorruptFileError, match=r"1\.npz"):
        EpisodeStore(folder).load("arcs", 1, 1)


def test_rows_of_an_older_format_are_reported_in_a_line_and_not_mixed(folder, fake_tasks):
    for path in row_path(folder).parent.glob("*.npz"):
        rewrite(path, put("format", value="castor-row/1"))
    leaderboard, text = shown(folder, fake_tasks.Arcs())
    assert [entry.estimator for entry in leaderboard.boards[0].entries] == ["other"]
    assert not leaderboard.refused
    line = f"rows of an older format (castor-row/1) in {folder / 'rows'} are not shown; run the tasks again, or remove"
    assert text.count(line) == 1
    assert ResultsStore(folder).load("arcs", 1, "mine", "a" * 16, 1) is None
    rewrite(EpisodeStore(folder).path("arcs", 1, 1), put("format", value="castor-episode/1"))
    assert EpisodeStore(folder).digest("arcs", 1, 1) is None


def test_a_copy_under_another_name_is_refused(folder, fake_tasks):
    copy = row_path(folder).with_name("7.npz")
    shutil.copy(row_path(folder), copy)
    leaderboard, text = shown(folder, fake_tasks.Arcs())
    assert [error.path for error in leaderboard.refused] == [copy]
    assert "holds a row of arcs version 1, mine" in text
    assert leaderboard.boards[0].cases == (0, 1)


def test_a_message_that_no_file_can_hold_is_kept_as_far_as_it_can_be(folder):
    store = ResultsStore(folder)
    store.save(Row("arcs", 1, "mine", "a" * 16, 3, "e" * 16, "d" * 16, failure="lost \ud800 here"))
    row = store.load("arcs", 1, "mine", "a" * 16, 3)
    assert row is not None
    assert row.failure == "lost ? here"
