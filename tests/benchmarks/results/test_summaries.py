"""Boards and plans open the file of a row or an episode once: summaries hold as long as it is unchanged."""

import os

import numpy as np
import pytest

from benchmarks.results import episodes as episodes_module
from benchmarks.results import rows as rows_module
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.kept import SUMMARY
from benchmarks.results.rows import ResultsStore, Row

CASES = range(5)


def a_row(case, score=0.1):
    scored = {"scores": {"ate": score}, "estimates": (np.zeros((2, 3)),)}
    return Row("arcs", 1, "follower", "0" * 16, case, "1" * 16, "2" * 16, **scored)


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """The stored rows, and a list of the files that are opened."""
    store, files, read = ResultsStore(tmp_path), [], rows_module.read_archive
    for case in CASES:
        store.save(a_row(case))

    def counted(path, *others):
        files.append(path.name)
        return read(path, *others)

    monkeypatch.setattr(rows_module, "read_archive", counted)
    return tmp_path, files


def scores(results):
    return {row.case: row.scores["ate"] for row in ResultsStore(results).summaries("arcs", 1)}


def test_a_file_is_opened_once(opened):
    results, files = opened
    assert scores(results) == dict.fromkeys(CASES, 0.1)
    assert len(files) == len(CASES)
    assert scores(results) == dict.fromkeys(CASES, 0.1)
    assert len(files) == len(CASES)


def test_a_summary_is_that_of_its_row(opened):
    results, _ = opened
    for _ in range(2):
        for row, summary in zip(
            ResultsStore(results).rows("arcs", 1), ResultsStore(results).summaries("arcs", 1), strict=True
        ):
            assert vars(summary) == {name: getattr(row, name) for name in vars(summary)}


def test_changed_new_and_removed_rows_are_seen(opened):
    results, files = opened
    scores(results)
    del files[:]
    store = ResultsStore(results)
    store.save(a_row(0, 0.25))
    store.save(a_row(9, 0.5))
    store.path("arcs", 1, "follower", "0" * 16, 1).unlink()
    assert scores(results) == {0: 0.25, 2: 0.1, 3: 0.1, 4: 0.1, 9: 0.5}
    assert sorted(files) == ["0.npz", "9.npz"]


def test_a_damaged_row_is_named_each_time_and_a_damaged_summary_made_anew(opened):
    results, files = opened
    path = ResultsStore(results).path("arcs", 1, "follower", "0" * 16, 3)
    path.write_bytes(b"damaged")
    for _ in range(2):
        store = ResultsStore(results)
        assert len(store.summaries("arcs", 1)) == len(CASES) - 1
        assert [error.path for error in store.corrupt] == [path]
    of = f'{{"format": "{rows_module.SUMMARY_FORMAT}", "files": %s}}'
    texts = ("", "[]", '{"format": "castor-summary/0", "files": {}}')
    for text in (*texts, *(of % files_ for files_ in ("[]", "null", '"all"', '{"a/0.npz": 5}', '{"a/0.npz": []}'))):
        (results / "rows" / "arcs@1" / SUMMARY).write_text(text)
        del files[:]
        assert len(scores(results)) == len(CASES) - 1
        assert len(files) == len(CASES)


@pytest.mark.skipif(os.name == "nt" or os.getuid() == 0, reason="an administrator may write anywhere")
def test_a_folder_that_may_only_be_read_is_read(opened):
    results, _ = opened
    folder = results / "rows" / "arcs@1"
    folder.chmod(0o500)
    assert len(scores(results)) == len(CASES)
    folder.chmod(0o700)


def test_episodes_are_opened_once_and_seen_when_they_change(tmp_path, monkeypatch, fake_tasks):
    task = fake_tasks.Arcs()
    opened, read = [], episodes_module.read_metadata
    for case in (1, 2):
        EpisodeStore(tmp_path).save(task, case, task.record(case))
    monkeypatch.setattr(
        episodes_module, "read_metadata", lambda path, *others: opened.append(path.name) or read(path, *others)
    )

    def digests():
        store = EpisodeStore(tmp_path)
        return {case: store.digest(task.name, task.version, case) for case in (1, 2, 3)}

    first = digests()
    assert first == {1: task.record(1).digest, 2: task.record(2).digest, 3: None} == digests()
    assert sorted(opened) == ["1.npz", "2.npz"]
    store = EpisodeStore(tmp_path)
    assert store.digest(task.name, task.version, 1) == first[1]
    store.save(task, 2, task.record(5))
    store.save(task, 3, task.record(3))
    changed = {case: store.digest(task.name, task.version, case) for case in (1, 2, 3)}
    assert changed[1] == first[1] != changed[2] != first[2]
    assert digests() == changed
