"""Ceiling and floor of a board: shown, never ranked, and what estimators attain between them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.leaderboard.board import build
from benchmarks.leaderboard.overview import overviews
from benchmarks.leaderboard.views import as_csv, as_json, as_markdown
from benchmarks.results.references import CEILING, FLOOR, reference_store, save_references
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.scoring.path_metrics import ATTAINED, attained
from benchmarks.scoring.registry import score
from benchmarks.tasks import official_tasks

ERRORS = st.floats(1e-6, 1e3)
(TASK,) = (task for task in official_tasks() if task.name == "configuration-one-of-three")


@given(ERRORS, ERRORS, ERRORS)
def test_attained_is_a_part_of_a_way_by_logarithms(oracle, between, factor):
    """0 and 1 at its ends, half at the geometric mean, the same in all units, and never more than the whole."""
    still = oracle * (1.5 + factor)
    assert attained(still, still, oracle) == 0.0
    assert attained(oracle, still, oracle) == 1.0
    assert attained((still * oracle) ** 0.5, still, oracle) == pytest.approx(0.5)
    part = attained(between, still, oracle)
    assert 0.0 <= part <= 1.0
    assert attained(1e3 * between, 1e3 * still, 1e3 * oracle) == pytest.approx(part)


def test_nothing_is_attained_where_the_oracle_stands_still():
    assert np.isnan(attained(1.0, 2.0, 2.0))
    assert attained(0.0, 2.0, 1.0) == 1.0


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Two cases, their references, and an estimator half-way between them."""
    folder = tmp_path_factory.mktemp("references")
    store, references = ResultsStore(folder), reference_store(folder)
    for case in range(2):
        episode = TASK.record(case)
        save_references(references, TASK, case, episode)
        ends = [
            {row.estimator: row.scores for row in references.rows(TASK.name, TASK.version) if row.case == case}[name]
            for name in (CEILING, FLOOR)
        ]
        half = float(np.sqrt(ends[0][TASK.metric] * ends[1][TASK.metric]))
        row = Row(TASK.name, TASK.version, "half", "0" * 16, case, episode.digest, "d" * 16)
        store.save(dataclasses.replace(row, scores={TASK.metric: half}))
    return folder


def test_references_are_shown_below_and_have_no_rank(results):
    leaderboard = build([TASK], results)
    (board,) = leaderboard.boards
    assert [entry.estimator for entry in board.entries] == ["half"]
    assert [(row.estimator, row.rank) for row in board.rows] == [("half", 1), (CEILING, None), (FLOOR, None)]
    assert board.entries[0].scores[ATTAINED].mean == pytest.approx(0.5)
    (table,) = overviews(leaderboard.boards)
    assert [entry.estimator for entry in table.entries] == ["half"]
    text, data = as_markdown(leaderboard), as_json(leaderboard)["tasks"][0]
    assert text.index("half") < text.index(CEILING) < text.index(FLOOR)
    assert (data["ceiling"]["rank"], data["floor"]["estimator"]) == (None, FLOOR)
    assert CEILING not in as_csv(leaderboard)


def test_references_of_another_episode_are_not_shown(results, tmp_path):
    for store, other in ((ResultsStore(results), ResultsStore(tmp_path)), map(reference_store, (results, tmp_path))):
        for row in store.rows(TASK.name, TASK.version):
            stale = row.estimator == CEILING and row.case == 0
            other.save(dataclasses.replace(row, episode="f" * 16) if stale else row)
    (board,) = build([TASK], tmp_path).boards
    assert board.ceiling is None
    assert board.floor is not None
    assert ATTAINED not in board.entries[0].scores


def test_an_oracle_changes_no_episode_that_estimators_get():
    episode = TASK.record(0)
    runs = tuple(dataclasses.replace(run, oracle=None) for run in episode.runs)
    assert dataclasses.replace(episode, runs=runs).digest == episode.digest


def test_told_which_axles_are_right_beats_standing_still_everywhere():
    episode = TASK.record(3)
    told = [run.oracle for run in episode.runs if run.oracle is not None]
    still = [run.start[:, None] for run in episode.runs]
    assert score(episode, told)[TASK.metric] < 0.5 * score(episode, still)[TASK.metric]
