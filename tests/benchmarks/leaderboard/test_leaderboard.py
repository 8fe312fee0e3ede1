"""Who is on the board, at which rank, and what is said of the others."""

import dataclasses
import json
from datetime import UTC, datetime

import numpy as np
import pytest
from rich.console import Console

from benchmarks.leaderboard.board import build
from benchmarks.leaderboard.markdown import escaped
from benchmarks.leaderboard.notes import board_notes
from benchmarks.leaderboard.views import as_json, as_markdown, print_leaderboard
from benchmarks.results.asked import ASKED, Asked, keep_asked
from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import Machine, provenance
from benchmarks.results.rows import ResultsStore, Row, UpdateCost
from benchmarks.scoring.registry import score

CASES = range(8)


class Board:
    """A results folder that rows are put into by hand."""

    def __init__(self, results, task):
        self.results, self.task, self.store = results, task, ResultsStore(results)

    def put(self, estimator, errors, source_hash="0" * 16, created=2020, failures=None, cases=CASES, **changes):
        for case, error in zip(cases, errors, strict=True):
            reason = (failures or {}).get(case)
            row = Row(
                task=self.task.name,
                version=self.task.version,
                estimator=estimator,
                source_hash=source_hash,
                case=case,
                episode="e" * 16,
                robot_hash="d" * 16,
                failure=reason,
                scores={} if reason else {"E_max_syst": error, "ate": error / 2},
                origin=dataclasses.replace(provenance(), created=datetime(created, 1, 1, tzinfo=UTC)),
            )
            self.store.save(dataclasses.replace(row, **changes))

    def entries(self, **arguments):
        (board,) = build([self.task], self.results, **arguments).boards
        return {entry.estimator: entry for entry in board.entries}


@pytest.fixture
def board(tmp_path, fake_tasks):
    return Board(tmp_path, fake_tasks.Arcs())


HARD = np.linspace(0.01, 0.08, 8)


def test_better_is_first_and_equals_share(board):
    board.put("worse", HARD + 0.002)
    board.put("good", HARD)
    board.put("equal", HARD * (1 + 1e-14))
    assert {name: entry.rank for name, entry in board.entries().items()} == {"good": 1, "equal": 1, "worse": 3}


def test_failing_on_the_hard_cases_does_not_help(board):
    board.put("honest", HARD)
    board.put("picky", HARD / 2, failures={6: "lost", 7: "lost"})
    entries = board.entries()
    assert entries["honest"].rank == 1
    assert entries["picky"].rank is None
    assert entries["picky"].failed[0].reason == "lost"
    assert entries["picky"].failed[0].cases == (6, 7)
    assert list(entries) == ["honest", "picky"]


def test_who_has_not_run_all_cases_is_not_ranked(board):
    board.put("whole", HARD)
    board.put("begun", HARD[:3] / 9, cases=range(3))
    entries = board.entries()
    assert entries["begun"].rank is None
    assert entries["begun"].lacking == (3, 4, 5, 6, 7)
    assert {name: entry.rank for name, entry in board.entries(cases=3).items()} == {"begun": 1, "whole": 1}


def test_edited_sources_are_not_mixed(board):
    board.put("mine", HARD[:5], "a" * 16, created=2021, cases=range(5))
    board.put("mine", HARD, "b" * 16, created=2022)
    (shown,) = build([board.task], board.results).boards
    assert [(entry.source_hash, entry.done) for entry in shown.entries] == [("b" * 16, 8)]
    assert shown.superseded == (("mine", "a" * 16, 5),)


def test_the_version_that_was_asked_for_last_is_shown(board):
    """Not the one with the newest rows: a run that finds all its rows computes none."""
    board.put("mine", HARD, "a" * 16, created=2021)
    board.put("mine", HARD[:5], "b" * 16, created=2022, cases=range(5))
    folder = board.store.of_task("arcs", 1)
    assert board.entries()["mine"].spec is None
    for source, done in (("a" * 16, 8), ("b" * 16, 5), ("a" * 16, 8)):
        keep_asked(folder, {"mine": Asked(source, "f/mine.py"), "another": Asked("c" * 16)})
        assert (board.entries()["mine"].done, board.entries()["mine"].spec) == (done, "f/mine.py")
    keep_asked(folder, {"mine": Asked("c" * 16, "mine.py")})  # which has no rows yet
    assert (board.entries()["mine"].done, board.entries()["mine"].spec) == (5, None)
    for text in ("", "[]", '{"format": "castor-asked/1"}', '{"format": "castor-asked/1", "estimators": {"mine": 1}}'):
        (folder / ASKED).write_text(text)
        assert board.entries()["mine"].done == 5


def test_rows_of_another_recording_or_version_are_not_mixed(board, fake_tasks):
    board.put("mine", HARD)
    board.put("mine", [0.5], cases=[8], version=2)
    arcs_board = build([board.task], board.results)
    assert arcs_board.other_versions == (("arcs", 2),)
    assert len(arcs_board.boards[0].cases) == 8
    EpisodeStore(board.results).save(board.task, 3, board.task.record(3))
    assert 3 not in build([board.task], board.results).boards[0].cases


def test_a_task_without_rows_says_why(board):
    absent = dataclasses.replace(board.task, missing="the data are on the moon")
    (shown,) = build([absent], board.results).boards
    assert (shown.missing, shown.entries) == ("the data are on the moon", ())
    (shown,) = build([board.task], board.results, missing={"arcs": "line 3 is no number"}).boards
    assert shown.missing == "line 3 is no number"


def test_damaged_rows_are_named(board):
    board.put("mine", HARD)
    path = next(board.results.glob("rows/*/*/4.npz"))
    path.write_bytes(b"")
    leaderboard = build([board.task], board.results)
    assert [error.path for error in leaderboard.refused] == [path]


def test_files_that_a_kill_left_half_written_are_no_rows(board):
    board.put("mine", HARD)
    folder = next(board.results.glob("rows/*/*"))
    (folder / ".5.npz.x8d.tmp").write_bytes(b"half")
    (folder / ".5.npz").write_bytes(b"half")
    leaderboard = build([board.task], board.results)
    assert not leaderboard.refused
    assert len(leaderboard.boards[0].cases) == 8


@pytest.fixture
def shown(board):
    board.put("good", HARD)
    board.put("bad", HARD * 3, failures={0: "raised ValueError: [red]no[/red] | idea"})
    return build([board.task], board.results)


def test_json_is_si_with_units_in_its_keys(shown):
    data = json.loads(json.dumps(as_json(shown), allow_nan=False))
    assert data["format"] == "castor-leaderboard/2"
    (task,) = data["tasks"]
    assert (task["task"], task["version"], task["cases"]) == ("arcs", 1, 8)
    assert (task["primary_metric"], task["unit"]) == ("E_max_syst_m", "m")
    good, bad = task["entries"]
    assert good["rank"] == 1
    assert good["scores"]["E_max_syst_m"]["mean"] == pytest.approx(HARD.mean())
    assert good["scores"]["E_max_syst_m"]["low"] < HARD.mean() < good["scores"]["E_max_syst_m"]["high"]
    assert bad["rank"] is None
    assert bad["failed"] == [{"reason": "raised ValueError: [red]no[/red] | idea", "cases": [0]}]


def test_people_read_millimetres_and_reasons(shown, capsys):
    print_leaderboard(shown, Console(width=160))
    text = capsys.readouterr().out
    assert "E_max, mm" in text
    assert "45.00" in text
    assert "95 %" in text
    assert "bad failed 1 of 8 cases (0): raised ValueError: [red]no[/red] | idea" in text


def test_markdown_tables_are_whole(shown):
    lines = [line for line in as_markdown(shown).splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in lines}) == 1
    assert len(lines) == 4


def test_few_cases_have_no_interval(board):
    board.put("mine", HARD[:2], cases=range(2))
    score = board.entries()["mine"].scores["E_max_syst"]
    assert (score.low, score.high) == (None, None)
    json.dumps(as_json(build([board.task], board.results)), allow_nan=False)


def test_whoever_stands_still_is_not_ranked(tmp_path, fake_tasks, plugin):
    """On a closed path an estimator that never moves has no error at the end: its path gives it away."""

    @dataclasses.dataclass(frozen=True)
    class Closed(fake_tasks.Arcs):
        samples: int = 315  # a whole circle

    task = Closed()
    episode = task.record(0)
    EpisodeStore(tmp_path).save(task, 0, episode)
    store = ResultsStore(tmp_path)
    for name, estimates in (
        ("still", [np.tile(run.truth[0], (len(run.truth), 1)) for run in episode.runs]),
        ("follower", [run.truth + np.array([0.05, 0.0, 0.0]) for run in episode.runs]),
    ):
        scores = score(episode, estimates)
        store.save(
            Row(task.name, 1, name, "f" * 16, 0, episode.digest, "0" * 16, scores=scores, estimates=tuple(estimates))
        )
    (board,) = build([task], tmp_path).boards
    by_name = {entry.estimator: entry for entry in board.entries}
    assert by_name["follower"].rank == 1
    assert not by_name["follower"].stands_still
    assert by_name["still"].rank is None
    assert by_name["still"].stands_still
    assert "not ranked" in as_markdown(build([task], tmp_path))


@pytest.fixture
def wide(board):
    """A board whose table takes over 100 columns."""
    for k, name in enumerate(("dead-reckoning-1", "cast-arc-0", "a_plug_in_of_mine:WithALongName")):
        board.put(name, HARD * (1.2345 + k), source_hash=str(k) * 16)
        board.store.save_time("arcs", 1, name, str(k) * 16, UpdateCost(123.4, 234.5), provenance())
        for case in CASES:
            row = board.store.load("arcs", 1, name, str(k) * 16, case)
            extra_scores = {"end_point_position": 0.1234, "end_point_heading": 0.01234, "rpe_translation": 0.01234}
            board.store.save(dataclasses.replace(row, scores={**row.scores, **extra_scores}))
    return build([board.task], board.results)


SCORES = ["rank", "estimator", "E_max, mm", "95 %"]


@pytest.mark.parametrize(
    ("width", "headings"),
    [
        (160, [*SCORES, "end, mm", "end, °", "ATE, mm", "RPE, mm/m", "update, µs", "worst, µs"]),
        (100, [*SCORES, "end, mm", "ATE, mm", "RPE, mm/m"]),
        (80, [*SCORES, "ATE, mm"]),
    ],
)
def test_a_narrow_terminal_drops_columns_and_cuts_none(wide, capsys, width, headings):
    print_leaderboard(wide, Console(width=width))
    out = capsys.readouterr().out
    table = [line for line in out.splitlines() if line.startswith(("┃", "│"))]
    assert [cell.strip() for cell in table[0].strip("┃").split("┃")] == headings
    assert len(table) == 1 + 3
    assert all(len(line) <= width for line in table)
    assert "…" not in out
    (score,) = [entry.scores["E_max_syst"] for entry in wide.boards[0].entries if entry.rank == 1]
    first = [cell.strip() for cell in table[1].strip("│").split("│")]
    assert first[:4] == ["1", "dead-reckoning-1", "55.55", f"{1e3 * score.low:.2f}–{1e3 * score.high:.2f}"]
    said = "narrow terminal: castor-bench leaderboard --markdown shows every score" in out
    assert said == (width < 160)


def test_numbers_stay_whole_in_the_narrowest_terminal(wide, capsys):
    print_leaderboard(wide, Console(width=40))
    out = capsys.readouterr().out
    assert "…" not in out
    assert "55.55" in out
    assert "E_max, mm" in out


def test_who_declines_the_robot_is_no_row(board):
    """All of its rows are refusals: it did not fail, and its cases are not the board's."""
    board.put("good", HARD)
    reason = "needs six legs | or [b]eight[/b]"
    board.put("choosy", [0.0] * 10, cases=range(10), failures=dict.fromkeys(range(10), f"declined: {reason}"))
    board.put("half", HARD, failures={0: "declined: not this one"})
    leaderboard = build([board.task], board.results)
    (shown,) = leaderboard.boards
    assert [entry.estimator for entry in shown.entries] == ["good", "half"]
    assert len(shown.cases) == 8
    assert not shown.entries[0].lacking
    (task,) = as_json(leaderboard)["tasks"]
    assert task["declined"] == [{"estimator": "choosy", "reason": reason}]
    text = as_markdown(leaderboard)
    assert f"- choosy declines this robot: {escaped(reason)}\n" in text
    assert "choosy failed" not in text
    assert "half declined 1 of 8 cases (0): not this one" in text


def test_a_board_of_refusals_alone_says_so(board, capsys):
    board.put("choosy", HARD, failures=dict.fromkeys(CASES, "declined: needs six legs"))
    print_leaderboard(build([board.task], board.results), Console(width=80))
    out = capsys.readouterr().out
    assert "choosy declines this robot: needs six legs" in out
    assert "mean over" not in out


def test_ranks_are_explained_where_there_are_any(board):
    explained = "who does not differ significantly (paired, 5 % family-wise) from the best of a rank shares it"
    board.put("picky", HARD, failures={6: "lost"})
    assert explained not in as_markdown(build([board.task], board.results))
    board.put("whole", HARD)
    assert explained in as_markdown(build([board.task], board.results))


@pytest.mark.parametrize(
    ("cases", "said", "beyond"),
    [
        (range(8), "mean over 8 cases; ", 0),
        (range(6), "mean over 6 cases (of the task's 8); ", 0),
        (range(10), "mean over 10 cases (the task's 8 and 2 more); ", 2),
        (range(2, 10), "mean over 8 cases (6 of the task's 8, and 2 more); ", 2),
    ],
)
def test_a_board_of_other_cases_than_the_tasks_own_says_so(board, cases, said, beyond):
    board.put("good", np.linspace(0.01, 0.08, len(cases)), cases=cases)
    shown = build([board.task], board.results)
    assert said in as_markdown(shown)
    (task,) = as_json(shown)["tasks"]
    assert (task["cases"], task["cases_of_task"], task["cases_beyond"]) == (len(cases), 8, beyond)


def test_times_of_several_machines_are_told_apart(board):
    here = provenance()
    there = dataclasses.replace(here, machine=Machine(platform="Linux-armv7l", cpu_count=4))
    sources = {"good": "9" * 16, "bad": "b" * 16, "worse": "c" * 16}
    for name, source in sources.items():
        board.put(name, HARD, source_hash=source)
    said = "updates were timed on several machines, and compare within one alone: "
    for name in ("good", "bad"):
        board.store.save_time("arcs", 1, name, sources[name], UpdateCost(2.0, 3.0), here)
    assert said not in as_markdown(build([board.task], board.results))
    board.store.save_time("arcs", 1, "bad", sources["bad"], UpdateCost(80.0, 90.0), there)
    shown = build([board.task], board.results)
    (note,) = [line for line in board_notes(shown.boards[0], None) if line.startswith(said)]
    assert f"on {here.machine} good" in note
    assert "on Linux-armv7l, 4 processors bad" in note
    timed_on = {entry["estimator"]: entry["updates_timed_on"] for entry in as_json(shown)["tasks"][0]["entries"]}
    assert timed_on == {"good": str(here.machine), "bad": "Linux-armv7l, 4 processors", "worse": None}
