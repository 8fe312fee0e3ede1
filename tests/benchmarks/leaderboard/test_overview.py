"""The overview: laws of places, mean ranks and multiples; what stands in which table; how it is shown."""

import csv
import io
import json
from html.parser import HTMLParser
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from rich.console import Console
from scipy.stats import rankdata

from benchmarks.leaderboard.board import Entry, FailedCases, Leaderboard, TaskBoard
from benchmarks.leaderboard.overview import LEAST, overviews
from benchmarks.leaderboard.overview_views import overviews_json, overviews_markdown, print_overviews
from benchmarks.leaderboard.ranking import Interval, places
from benchmarks.leaderboard.views import as_csv, as_json, as_markdown
from benchmarks.results.rows import UpdateCost
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.site.pages import single_page
from castor_envs.rendering.pages.page import SCRIPTS

METRIC = BOARD_METRICS["ate"]
CASES = tuple(range(20))


def entry(name, score, rank=None, failed=(), lacking=(), stands_still=False):
    """Return an entry of a board; failed: the cases that it failed."""
    failures = (FailedCases("lost", tuple(failed)),) if failed else ()
    done = len(CASES) - len(failed) - len(lacking)
    scores = {METRIC.name: Interval(score, 0.9 * score, 1.2 * score)}
    return Entry(rank, name, "0" * 16, scores, UpdateCost(12.5, 25.0), done, failures, tuple(lacking), stands_still)


def board(task, scores, group="squares", unranked=(), **changes):
    """Return a board on which every difference of scores (m) is significant; unranked: who failed a case."""
    order = sorted(value for name, value in scores.items() if name not in unranked)
    entries = tuple(
        entry(name, value, None, failed=(3,)) if name in unranked else entry(name, value, 1 + order.index(value))
        for name, value in scores.items()
    )
    values = dict(
        task=task,
        group=group,
        of_train=False,
        version=1,
        title=task,
        description="",
        metric=METRIC,
        cases=CASES,
        entries=entries,
        declined=(),
        missing=None,
        superseded=(),
    )
    return TaskBoard(**{**values, **changes})


def only(boards):
    """Return the single overview of boards, and its entries by name."""
    (table,) = overviews(boards)
    return table, {one.estimator: one for one in table.entries}


def multiple(row, group):
    """Return an estimator's multiple of the best score in a group in which it is ranked everywhere."""
    ratio = row.groups[group].ratio
    assert ratio is not None
    return ratio


def names(boards):
    return [one.estimator for one in only(boards)[0].entries]


RANKS = st.dictionaries(st.text("abcdefgh", min_size=1), st.none() | st.integers(1, 6), min_size=1)
SCORES = st.integers(1, 9).map(lambda k: k * 1e-2)
TABLES = st.lists(st.fixed_dictionaries(dict.fromkeys("abcd", SCORES)), min_size=1, max_size=5)
"""For each task, the scores (m) of four estimators; equal ones share a rank."""


def boards_of(tables, groups=2, **arguments):
    return [board(f"task-{k}", scores, f"group-{k % groups}", **arguments) for k, scores in enumerate(tables)]


@given(RANKS)
def test_places_are_average_ranks(ranks):
    order = [99 if rank is None else rank for rank in ranks.values()]
    assert list(places(ranks).values()) == list(rankdata(order, method="average"))
    assert sum(places(ranks).values()) == len(ranks) * (len(ranks) + 1) / 2


def test_three_who_share_the_first_rank_have_not_won_as_one_alone_has():
    shared = places({"a": 1, "b": 1, "c": 1, "d": 4})
    assert shared == {"a": 2, "b": 2, "c": 2, "d": 4}
    assert shared["a"] > places({"a": 1, "b": 2, "c": 2, "d": 4})["a"]


@given(TABLES, st.randoms())
def test_the_order_of_tasks_does_not_matter(tables, random):
    boards = boards_of(tables)
    shuffled = random.sample(boards, len(boards))
    (one,), (other,) = overviews(boards), overviews(shuffled)
    assert [row.estimator for row in one.entries] == [row.estimator for row in other.entries]
    for row, same in zip(one.entries, other.entries, strict=True):
        assert row.mean_rank == pytest.approx(same.mean_rank, rel=1e-12)
        assert {name: score.ratio for name, score in row.groups.items()} == pytest.approx(
            {name: score.ratio for name, score in same.groups.items()}, rel=1e-12
        )


@given(TABLES)
def test_an_estimator_that_is_worst_changes_nothing_for_the_others(tables):
    _, before = only(boards_of(tables))
    with_worst = boards_of([{**scores, "worst": 1.0} for scores in tables])
    table, after = only(with_worst)
    assert table.entries[-1].estimator == "worst"
    del after["worst"]
    assert after == before
    assert list(after) == list(before)


@given(st.lists(SCORES, min_size=1, max_size=5))
def test_who_are_tied_everywhere_have_equal_means(scores):
    table, _ = only(boards_of([dict.fromkeys("abcd", score) for score in scores]))
    assert {row.mean_rank for row in table.entries} == {2.5}
    assert {score.ratio for row in table.entries for score in row.groups.values()} == {1.0}


@given(TABLES, st.data())
def test_failing_never_helps(tables, data):
    """Whoever is ahead of an estimator stays ahead when it fails somewhere, and its mean rank is no better."""
    who, task = data.draw(st.sampled_from("abcd")), data.draw(st.integers(0, len(tables) - 1))
    before, rows = only(boards_of(tables))
    boards = boards_of(tables)
    boards[task] = board(f"task-{task}", tables[task], boards[task].group, unranked=(who,))
    after, failed = only(boards)
    ahead = [row.estimator for row in before.entries]
    now = [row.estimator for row in after.entries]
    assert set(ahead[: ahead.index(who)]) <= set(now[: now.index(who)])
    assert now[-1] == who
    assert failed[who].mean_rank >= rows[who].mean_rank
    score = failed[who].groups[boards[task].group]
    assert score.ratio is None
    assert [one.task for one in score.unranked] == [f"task-{task}"]
    assert failed[who].ranked == len(tables) - 1


@given(TABLES, st.floats(1e-3, 9e-3))
def test_multiples_compare_two_whoever_is_best(tables, best):
    """The quotient of two estimators' multiples stays when a better one comes."""
    _, before = only(boards_of(tables))
    _, after = only(boards_of([{**scores, "better": best} for scores in tables]))
    assert {score.ratio for score in after["better"].groups.values()} == {1.0}
    for group in before["a"].groups:
        old, new = (multiple(rows["a"], group) / multiple(rows["b"], group) for rows in (before, after))
        assert new == pytest.approx(old, rel=1e-9)


@given(TABLES)
def test_multiples_do_not_depend_on_a_tasks_size(tables):
    _, before = only(boards_of(tables))
    _, after = only(boards_of([{name: 7 * score for name, score in scores.items()} for scores in tables]))
    for name, row in before.items():
        for group in row.groups:
            assert 1 <= multiple(row, group) == pytest.approx(multiple(after[name], group), rel=1e-9)


def test_an_example_by_hand():
    """Two tasks: a is twice and eight times the best, so four times; b is the best of one and has half of a's rest."""
    boards = [board("one", {"a": 0.02, "b": 0.01, "c": 0.04}), board("two", {"a": 0.08, "b": 0.02, "c": 0.01})]
    table, rows = only(boards)
    assert names(boards) == ["b", "c", "a"]
    assert {name: row.groups["squares"].ratio for name, row in rows.items()} == pytest.approx(
        {"a": 4, "b": 2**0.5, "c": 2}
    )
    assert {name: row.mean_rank for name, row in rows.items()} == {"a": 2.5, "b": 1.5, "c": 2.0}
    assert (table.groups, table.tasks) == ({"squares": ("one", "two")}, 2)


def test_an_error_of_nothing_makes_nobody_infinitely_bad():
    _, rows = only([board("one", {"exact": 1e-17, "good": LEAST / METRIC.factor, "bad": 10 * LEAST / METRIC.factor})])
    assert [rows[name].groups["squares"].ratio for name in ("exact", "good", "bad")] == pytest.approx([1, 1, 10])


def test_a_tenth_of_a_millimetre_is_as_good_as_nothing():
    """As docs/benchmark.md says: scores below 0.1 mm count as that."""
    assert METRIC.shown_unit == "mm"
    _, rows = only([board("one", {"a": 0.01e-3, "b": 0.1e-3, "c": 0.2e-3})])
    assert [rows[name].groups["squares"].ratio for name in "abc"] == pytest.approx([1, 1, 2])


def test_who_serves_fewer_tasks_stands_behind_and_is_not_judged_by_the_rest():
    boards = [board("one", {"all": 0.03, "some": 0.01}), board("two", {"all": 0.02}, "turns")]
    table, rows = only(boards)
    assert names(boards) == ["all", "some"]
    assert "turns" not in rows["some"].groups
    assert (rows["some"].mean_rank, rows["some"].ranked, table.tasks) == (1.0, 1, 2)


def test_groups_count_alike_however_many_tasks_they_have():
    boards = [
        *(board(f"many-{k}", {"a": 0.01, "b": 0.02}, "many") for k in range(3)),
        board("few", {"a": 0.02, "b": 0.01}, "few"),
    ]
    _, rows = only(boards)
    assert rows["a"].mean_rank == rows["b"].mean_rank == 1.5


def test_robots_trains_and_methods_and_other_robots_have_tables_of_their_own():
    scores = {"mine": 0.01}
    boards = [
        board("calibration-a", scores, odometry="dead-reckoning-1"),
        board("square[my_robot@0123]", scores),
        board("train-a", scores, of_train=True),
        board("square", scores),
        board("nothing", {}),
    ]
    found = [(table.kind, table.robot, table.groups) for table in overviews(boards)]
    assert found == [
        ("robots", None, {"squares": ("square",)}),
        ("trains", None, {"squares": ("train-a",)}),
        ("calibration", None, {"squares": ("calibration-a",)}),
        ("robots", "my_robot@0123", {"squares": ("square[my_robot@0123]",)}),
    ]


HOSTILE = """<script>alert("1")</script>&amp;'"><img src=x onerror=alert(1)>, {{ 7 * 7 }} [red]no[/red]"""


def leaderboard(*boards, **changes):
    values = dict(boards=boards, other_versions=(), refused=(), refused_episodes=(), older_formats=(), folder="results")
    return Leaderboard(**{**values, **changes})


@pytest.fixture
def hostile():
    good = board("one", {HOSTILE: 0.01, "good": 0.02})
    bad = board("two", {HOSTILE: 0.01, "good": 0.02}, unranked=(HOSTILE,), title=HOSTILE)
    absent = board("absent", {}, missing=f"{HOSTILE} is not there")
    return leaderboard(good, bad, absent, older_formats=(HOSTILE,))


class Page(HTMLParser):
    """The tags, attributes and text of a page; of scripts and styles, which are the project's own, the number alone."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.text, self.inside = [], set(), [], None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        self.inside = tag

    def handle_data(self, data):
        if self.inside not in ("script", "style"):
            self.text.append(data.strip())


def test_hostile_names_are_text_in_the_page_and_nothing_is_fetched(hostile):
    page, harmless = Page(single_page(hostile)), Page(single_page(leaderboard()))
    assert not set(page.tags) & {"img", "link", "iframe", "object"}
    assert page.tags.count("script") == harmless.tags.count("script") == len(SCRIPTS)
    assert not page.attributes & {"src", "onerror", "onload", "style"}
    assert page.text.count(HOSTILE) == 1 + 2 + 1  # overview, two boards, a title
    assert any(text.startswith(f"{HOSTILE} failed 1 of 20 cases") for text in page.text)
    assert f"not run: absent: {HOSTILE} is not there" in page.text


def test_hostile_names_are_text_in_markdown():
    """A file may be named <b>x.py or a|b.py."""
    names = [HOSTILE, "a|b:Mine", "<b>x:Mine", "`c`*d*:Mine", "[e](f):Mine", "back\\slash:Mine"]
    boards = leaderboard(
        board("one", {name: 0.01 * (k + 1) for k, name in enumerate(names)}, title=HOSTILE),
        board("two", dict.fromkeys(names, 0.01), unranked=(HOSTILE,)),
        board("absent", {}, missing=f"{HOSTILE} is not there"),
    )
    for text, tables in ((as_markdown(boards), 2), (overviews_markdown(overviews(boards.boards)), 1)):
        page = Page(MarkdownIt("commonmark").enable("table").render(text))
        assert set(page.tags) <= {"h2", "p", "code", "table", "thead", "tbody", "tr", "th", "td", "ul", "li"}
        assert page.tags.count("td") == page.tags.count("th") * len(names)
        assert page.tags.count("table") == tables
        assert set(names) <= set(page.text)


def test_the_page_holds_every_number_of_the_boards(hostile):
    text = Page(single_page(hostile)).text
    assert [text.count(cell) for cell in ("10.00", "9.000 to 12.00", "20.00", "18.00 to 24.00")] == [2, 2, 2, 2]
    assert [text.count(cell) for cell in ("2/2", "1/2", "1.5 · 1.41×", "1.5 · – 1/2")] == [1, 1, 1, 1]


def test_csv_has_a_row_for_each_task_and_estimator_in_si(hostile):
    rows = list(csv.DictReader(io.StringIO(as_csv(hostile))))
    assert [(row["task"], row["estimator"]) for row in rows] == [
        (board.task, one.estimator) for board in hostile.boards for one in board.entries
    ]
    good, failed = rows[1], rows[2]
    assert (good["rank"], good["metric"], good["unit"]) == ("2", "ate_m", "m")
    assert [float(good[name]) for name in ("mean", "low", "high")] == pytest.approx([0.02, 0.018, 0.024])
    assert (failed["rank"], failed["cases"], failed["cases_done"], failed["cases_failed"]) == ("", "20", "19", "1")


def test_json_has_the_overview(hostile):
    data = json.loads(json.dumps(as_json(hostile), allow_nan=False))
    (table,) = data["overview"]
    assert (table["of"], table["groups"]) == ("robots", [{"group": "squares", "tasks": ["one", "two"]}])
    good, bad = table["entries"]
    assert (good["estimator"], good["tasks_ranked"], good["groups"]["squares"]["mean_rank"]) == ("good", 2, 1.5)
    score = bad["groups"]["squares"]
    assert (score["ratio_to_best"], score["tasks_ranked"]) == (None, 1)
    assert score["unranked"] == [{"task": "two", "reason": "failed 1 of 20 cases"}]
    assert [task["group"] for task in data["tasks"]] == ["squares"] * 3


def test_people_see_failures_and_what_was_not_run(hostile, capsys):
    print_overviews(hostile, Console(width=400))
    out = capsys.readouterr().out
    assert f"{HOSTILE} is not ranked in two (failed 1 of 20 cases)" in out
    assert f"not run: absent: {HOSTILE} is not there" in out
    assert "1.5 · – 1/2" in out


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("has not run 3 of 20 cases", {"lacking": (1, 2, 3)}),
        ("is no better than standing still", {"stands_still": True}),
        ("failed 2 of 20 cases", {"failed": (0, 1)}),
    ],
)
def test_the_reason_is_given(reason, changes):
    entries = (entry("whole", 0.01, 1), entry("half", 0.005, None, **changes))
    _, rows = only([board("one", {}, entries=entries)])
    assert [(one.task, one.reason) for one in rows["half"].unranked] == [("one", reason)]
    assert rows["whole"].groups["squares"].ratio == 1.0


def test_a_mean_over_some_of_the_cases_says_so():
    assert entry("half", 0.005, None, failed=(0, 1), lacking=(2, 3, 4)).shown == "half (15 of 20 cases)"
    assert entry("whole", 0.01, 1).shown == "whole"


@pytest.mark.parametrize("width", [40, 80, 120, 300])
def test_a_narrow_terminal_shows_every_group(capsys, width):
    groups = [f"group-{k}-of-eight" for k in range(8)]
    boards = [board(group, {"a": 0.01, "b": 0.02}, group) for group in groups]
    print_overviews(leaderboard(*boards), Console(width=width))
    out = capsys.readouterr().out
    lines = [line for line in out.splitlines() if line.startswith(("┃", "│"))]
    assert all(len(line) <= width for line in lines)
    headings = [cell.strip() for line in lines if line.startswith("┃") for cell in line.strip("┃").split("┃")]
    assert [heading for heading in headings if heading in groups] == groups
    assert "…" not in out


def test_a_folder_without_results_of_these_tasks_says_so(capsys):
    print_overviews(leaderboard(board("one", {})), Console(width=80))
    assert capsys.readouterr().out == "no results\n"


def test_markdown_rows_are_whole():
    boards = [board("one", {"a": 0.01, "b": 0.02}), board("two", {"a": 0.01}, "turns")]
    lines = [line for line in overviews_markdown(overviews(boards)).splitlines() if line.startswith("|")]
    assert len(lines) == 4
    assert all(one.count("|") == other.count("|") for one, other in pairwise(lines))
    assert lines[-1] == "| b | 2.00 | 1/2 | 2.0 · 2.00× | – |"
    (data,) = overviews_json(overviews(boards))
    assert [row["estimator"] for row in data["entries"]] == ["a", "b"]


def test_robots_and_trains_of_one_group_stand_in_tables_of_their_own():
    """Drives of both are in the groups `bursts` and so on; an estimator is compared with its kind alone."""
    robots = board("bursts-swerve", {"filter": 0.1, "wheel-odometry": 0.2}, group="bursts")
    trains = board("bursts-train-3", {"train-filter": 0.3, "grpec-xy": 0.4}, group="bursts", of_train=True)
    first, second = overviews([trains, robots])
    assert [one.estimator for one in first.entries] == ["filter", "wheel-odometry"]
    assert [one.estimator for one in second.entries] == ["train-filter", "grpec-xy"]
    assert [first.groups, second.groups] == [{"bursts": ("bursts-swerve",)}, {"bursts": ("bursts-train-3",)}]
