"""The site: names of others are text and make safe files, all links lead somewhere, commands are commands."""

import re
import shlex
from html import unescape
from html.parser import HTMLParser

import pytest

from benchmarks.cli import app
from benchmarks.leaderboard.board import build
from benchmarks.results.asked import Asked, keep_asked
from benchmarks.results.provenance import provenance
from benchmarks.site.pages import write_site
from castor_envs.cli.commands import imported
from castor_envs.errors import InputError
from castor_envs.rendering.pages.page import FOLDER, LICENCE


@pytest.fixture(scope="module")
def site(results, stored_results, tmp_path_factory):
    out = tmp_path_factory.mktemp("site") / "site"
    pages = write_site(build([results.task], results.folder), results.folder, out)
    assert pages == len(list(out.rglob("*.html"))) == 2 + len(stored_results.NAMES)
    return out


class Links(HTMLParser):
    """What a page leads to and loads, and its text."""

    def __init__(self, path):
        super().__init__()
        self.to, self.text, self.tags, self.inside = [], [], [], None
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.inside = tag
        self.to += [value for name, value in attrs if name in ("href", "src")]

    def handle_data(self, data):
        if self.inside not in ("script", "style"):
            self.text.append(data.strip())


def row_page(site, name):
    """Return the page of an estimator."""
    (path,) = (path for path in (site / "tasks" / "arcs").glob("*.html") if name in Links(path).text)
    return path


def test_all_links_lead_to_files_of_the_site(site):
    linked = set()
    for path in site.rglob("*.html"):
        for to in Links(path).to:
            if not to.startswith("#"):
                assert not re.match(r"[a-z]+:|//", to), to
                target = (path.parent / to).resolve()
                assert target.is_relative_to(site.resolve())
                assert target.is_file(), to
                linked.add(target)
    pages = {path.resolve() for path in site.rglob("*.html")}
    assert pages <= linked


def test_names_of_others_are_text_and_make_safe_files(site, stored_results):
    board = Links(site / "tasks" / "arcs.html")
    for name in stored_results.NAMES:
        assert board.text.count(name) >= 1
        assert row_page(site, name).is_file()
    for path in site.rglob("*.html"):
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", path.name)
        assert Links(path).tags.count("script") <= 3 + 5  # the project's own and data of charts
        assert "<script>alert" not in path.read_text(encoding="utf-8")
    assert "lost <b>its</b> way" in Links(row_page(site, "failing")).text


def test_a_row_has_all_that_a_reader_may_ask_for(site, stored_results):
    page = row_page(site, "worse").read_text(encoding="utf-8")
    for heading in ("Trajectories", "Error over distance", "Cases", "Repeat it", "Provenance"):
        assert re.search(rf"<h2>[^<]*{heading}", page), heading
    assert [f"{word} case: {case}" in page for word, case in (("Best", 0), ("Median", 3), ("Worst", 7))] == 3 * [True]
    assert page.count('class="point s1"') == page.count('class="point s5"') == len(stored_results.HARD)
    for case, error in enumerate(stored_results.HARD):
        x = 1e3 * (error + [1, 2, 3, 4, 5, 6, 7, 40][case] / 1e3)
        assert f"case {case}, run 1, cw: {x:.3g}, 0 mm" in page
    assert "updates timed on" in page
    assert page.count(str(provenance().machine)) == 2  # of the rows and of the times


def test_commands_that_a_page_names_are_commands(site, stored_results):
    commands = imported(app)
    lines = [
        unescape(line)
        for path in site.rglob("*.html")
        for block in re.findall(r"<pre>(.*?)</pre>", path.read_text(encoding="utf-8"), flags=re.S)
        for line in block.splitlines()
    ]
    assert len(lines) > 2 * len(stored_results.NAMES)
    for line in lines:
        script, command, *arguments = shlex.split(line)
        assert script == "castor-bench"
        commands[command].make_context(command, arguments).close()


def test_a_row_is_repeated_by_what_was_asked_for(fake_tasks, stored_results, tmp_path):
    """With the folder of a file as it was named; where that is not known, the page says so."""
    results, specs = stored_results.Results(tmp_path / "results", fake_tasks.Arcs()), {}
    for name, spec in (("e:Mine", "f2/e.py"), ("pkg.rel:Mine", "pkg.rel:Mine"), ("old:Mine", None)):
        results.put(name, stored_results.HARD)
        specs[name] = Asked("a" * 16, spec)
    keep_asked(results.store.of_task("arcs", 1), specs)
    write_site(build([results.task], results.folder), results.folder, tmp_path / "site")
    for name, shown, said in (
        ("e:Mine", "f2/e.py", "Files are named from the folder in which the run was made."),
        ("pkg.rel:Mine", "pkg.rel:Mine", None),
        ("old:Mine", "old.py:Mine", "In which folder this file was when the run was made is not stored"),
    ):
        page = row_page(tmp_path / "site", name).read_text(encoding="utf-8")
        lines = re.findall(r"castor-bench .*", page)
        assert len(lines) == 5
        assert all(re.search(rf"--estimator {re.escape(shown)}(?!\S)", line.split("<")[0]) for line in lines)
        sentences = [text for text in ("Files are named", "In which folder") if text in page]
        assert sentences == ([] if said is None else [" ".join(said.split()[:3])])


def test_the_library_that_draws_is_named_with_its_licence(site):
    licence = (FOLDER / LICENCE).read_text(encoding="utf-8")
    assert "MIT License" in licence
    assert (site / "assets" / "uPlot.LICENSE.txt").read_text(encoding="utf-8") == licence
    assert "Leon Sorokin" in (site / "assets" / "uPlot.iife.min.js").read_text(encoding="utf-8")
    assert any("uPlot (MIT licence)" in text for text in Links(site / "index.html").text)


def test_a_site_is_whole_or_not_there(site, results, tmp_path, monkeypatch):
    board = build([results.task], results.folder)
    with pytest.raises(InputError, match="is there already"):
        write_site(board, results.folder, site)
    monkeypatch.setattr("benchmarks.site.pages.row_page", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_site(board, results.folder, tmp_path / "new")
    assert not list(tmp_path.iterdir())


def test_rows_without_their_episodes_have_pages_without_paths(results, tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.site.cases._episode", lambda *_: None)
    write_site(build([results.task], results.folder), results.folder, tmp_path / "site")
    page = row_page(tmp_path / "site", "good").read_text(encoding="utf-8")
    assert "are not in the results folder" in page
    assert "Trajectories" not in page
