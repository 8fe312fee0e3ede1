"""Comparisons: verdicts and intervals of known differences, the cases that differ most, and what is left out."""

import importlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ttest_rel

from benchmarks.results.episodes import EpisodeStore
from benchmarks.site.compare import Side, Verdict, compare, of_other_sources, rows_by_task, side_of
from benchmarks.site.compare_views import as_json, notes, signed, write_comparison
from castor_envs.errors import InputError
from estimators.plugins.registry import load_calibration


def test_a_program_gets_what_people_read(against, results):
    found = against("worse", "good")
    data = json.loads(json.dumps(as_json([found]), allow_nan=False))
    (told,) = data["tasks"]
    assert (data["format"], told["verdict"], told["compared"]) == ("castor-compare/1", "worse", ["worse", "good"])
    assert told["means"][0] - told["means"][1] == pytest.approx(told["difference"]["mean"])
    assert np.mean(list(told["by_case"].values())) == pytest.approx(told["difference"]["mean"])


@pytest.fixture
def against(results):
    """Return a function that compares two on the fake task."""

    def of(first, second, stored=None):
        rows = stored or rows_by_task([results.task], results.folder)
        a, b = (side_of(text, rows, results.folder, 60.0) for text in (first, second))
        (found,) = compare(a, b, rows, [results.task], results.folder)
        return found

    return of


def test_verdicts_have_a_direction(against):
    assert against("good", "worse").verdict is Verdict.BETTER
    assert against("worse", "good").verdict is Verdict.WORSE
    assert against("good", "equal").verdict is Verdict.ALIKE


def test_the_interval_is_that_of_paired_differences(against):
    """Of differences without skewness it is Student's."""
    found = against("equal", "good")
    off = np.array(list(found.by_case.values()))
    np.testing.assert_allclose(off, 1e-4 * np.array([1, -1, 1, -1, 1, -1, 1, -1]), atol=1e-12)
    student = ttest_rel(off + 1, np.ones(8)).confidence_interval(0.95)
    assert (found.difference.low, found.difference.high) == pytest.approx((student.low, student.high), rel=1e-6)
    assert found.difference.mean == pytest.approx(0.0, abs=1e-12)


def test_cases_that_differ_most_come_first(against):
    found = against("worse", "good")
    assert found.most == [7, 6, 5]
    assert [signed(found, found.by_case[case]) for case in found.most] == ["+40.00", "+7.000", "+6.000"]
    assert [signed(against("good", "worse"), -0.04), signed(found, 0.0)] == ["\N{MINUS SIGN}40.00", "0.000"]


def test_versions_of_one_estimator_are_told_apart(against):
    found = against(f"good@{'b' * 8}", f"good@{'a' * 16}")
    assert found.labels == (f"good@{'b' * 8}", f"good@{'a' * 8}")
    assert (found.verdict, found.difference.mean) == (Verdict.WORSE, pytest.approx(0.01))
    assert against("good", f"good@{'b' * 16}").labels[0] == f"good@{'a' * 8}"  # the newest


def test_failed_cases_are_left_out_for_both_and_told(against, stored_results):
    found = against("failing", "good")
    assert set(found.by_case) == {1, 2, 4, 5, 6, 7}
    assert found.means[1] == pytest.approx(np.mean(stored_results.HARD[[1, 2, 4, 5, 6, 7]]))
    assert "arcs: failing failed 2 of 8 cases, which are left out for both" in notes([found])


def test_few_cases_show_nothing(against, results):
    rows = rows_by_task([results.task], results.folder)
    few = {name: [row for row in of if row.case in range(4)] for name, of in rows.items()}
    found = against("worse", "good", few)
    assert (found.verdict, found.difference.low) == (Verdict.FEW, None)
    assert any("fewer than 6 cases cannot show a difference" in note for note in notes([found]))


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ("good", "good", "'good' is compared with itself; for two versions .* NAME@HASH; .* has aaaaaaaa, bbbbbbbb"),
        ("good", "good@aa", "'good' is compared with itself"),
        ("goood", "worse", "'goood' has no rows in .*; castor-bench run computes them; did you mean 'good'?"),
        ("good@cccc", "worse", "good has no rows of source cccc in .*, only of aaaaaaaa, bbbbbbbb"),
    ],
)
def test_mistakes_say_what_to_do(against, first, second, said):
    with pytest.raises(InputError, match=said.replace("?", r"\?")):
        against(first, second)


def test_pages_lead_to_the_cases_that_differ_most(against, results, tmp_path):
    found = against("worse", "good")
    write_comparison([found], results.folder, tmp_path / "out")
    index = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    links = re.findall(r'href="(cases/[^"]+)"', index)
    assert links == ["cases/arcs-7.html", "cases/arcs-6.html", "cases/arcs-5.html"]
    for link in links:
        page = (tmp_path / "out" / link).read_text(encoding="utf-8")
        assert "worse against good" in page
        assert page.count('class="estimate s1"') == page.count('class="estimate s2"') == 2  # both, on both runs
    with pytest.raises(InputError, match="is there already"):
        write_comparison([found], results.folder, tmp_path / "out")


def test_a_page_says_from_where_its_commands_name_files(against, results, tmp_path):
    found = replace(against("worse", "good"), specs=("mine/e.py:Worse", "cast-0"))
    write_comparison([found], results.folder, tmp_path / "out")
    index = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert index.count("Files are named from the folder in which the run was made.") == 1
    assert "In which folder" not in index


def test_a_version_is_one_source_in_all_tasks(tmp_path, fake_tasks, stored_results):
    """Where it was not run, the other version does not stand for it; what is left out is told."""
    tasks = [fake_tasks.Arcs(), fake_tasks.Arcs(name="other-arcs")]
    for task in tasks:
        of = stored_results.Results(tmp_path, task)
        of.put("mine", stored_results.HARD, "a" * 16, created=2020)
        of.put("other", stored_results.HARD * 2, "c" * 16, created=2020)
    stored_results.Results(tmp_path, tasks[0]).put("mine", stored_results.HARD + 0.01, "b" * 16, created=2021)
    rows = rows_by_task(tasks, tmp_path)
    sides = {text: side_of(text, rows, tmp_path, 60.0) for text in ("mine", "mine@a", "other")}
    for first, second, labels in (
        ("mine@a", "mine", ("mine@aaaaaaaa", "mine@bbbbbbbb")),
        ("mine", "other", ("mine", "other")),
    ):
        found = compare(sides[first], sides[second], rows, tasks, tmp_path)
        assert [(of.task.name, of.labels) for of in found] == [("arcs", labels)]
        left_out = of_other_sources((sides[first], sides[second]), rows)
        assert left_out == ["left out, as mine@bbbbbbbb has not been run on them: other-arcs"]
        assert as_json(found, left_out)["left_out"] == left_out
    assert len(compare(sides["mine@a"], sides["other"], rows, tasks, tmp_path)) == 2
    assert of_other_sources((sides["mine@a"], sides["other"]), rows) == []


def test_cases_of_other_episodes_are_not_compared(tmp_path, fake_tasks, stored_results):
    task = fake_tasks.Arcs()
    of = stored_results.Results(tmp_path, task)
    of.put("first", stored_results.HARD)
    EpisodeStore(tmp_path).save(task, 3, task.record(30))
    of.episodes[3] = task.record(30)
    of.put("second", stored_results.HARD * 2)
    rows = rows_by_task([task], tmp_path)
    first, second = (side_of(name, rows, tmp_path, 60.0) for name in ("first", "second"))
    (found,) = compare(first, second, rows, [task], tmp_path)
    assert set(found.by_case) == set(task.cases()) - {3}


def test_the_file_of_a_method_names_it_as_that_of_an_estimator_does(tmp_path, stored_results, plugin):
    task = importlib.import_module("fake_calibrations").CalibrationByArcs()
    of, spec = stored_results.Results(tmp_path, task), plugin("calibrators:Truth")
    entry = load_calibration(spec)
    of.put(entry.name, stored_results.HARD, entry.source_hash)
    of.put("umbmark-correction", stored_results.HARD * 2)
    rows = rows_by_task([task], tmp_path)
    assert side_of(spec, rows, tmp_path, 60.0) == Side(entry.name, entry.source_hash)
    with pytest.raises(InputError, match=r"'.*followers.py:Single' has no rows in"):
        side_of(plugin("followers:Single"), rows, tmp_path, 60.0)
    with pytest.raises(InputError, match="has no method"):
        side_of(plugin("fake_tasks:Arcs"), rows, tmp_path, 60.0)
