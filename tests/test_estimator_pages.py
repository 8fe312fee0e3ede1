"""Every built-in estimator has a page, whose tests exist, whose figures are not stale, and whose failure is shown."""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.tasks import official_tasks
from estimators import load_estimator
from estimators.plugins.registry import ESTIMATOR

ROOT = Path(__file__).parents[1]
PAGES = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "estimators").glob("*.md")}


@pytest.fixture(scope="module")
def pictures(script_called):
    return script_called("make_estimator_pictures")


def test_every_estimator_is_named_in_the_title_of_one_page():
    titles = [name for text in PAGES.values() for name in text.splitlines()[0].removeprefix("# ").split(", ")]
    assert sorted(titles) == sorted(ESTIMATOR.built_in)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_all_parts_and_is_linked_from_the_overview_and_the_site(page):
    headings = [line for line in PAGES[page].splitlines() if line.startswith("## ")]
    assert headings == ["## Equations", "## When to use it", "## When it fails", "## Source"]
    assert f"pictures/{page}.svg" in PAGES[page]
    assert (ROOT / "docs" / "estimators" / "pictures" / f"{page}.svg").exists()
    assert f"(estimators/{page}.md)" in (ROOT / "docs" / "estimators.md").read_text(encoding="utf-8")
    assert f"- estimators/{page}.md\n" in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_the_failure_that_a_page_tells_is_shown_by_a_test_that_exists(page):
    text = PAGES[page].split("## When it fails")[1].split("## Source")[0]
    named = re.findall(r"`pytest (tests/[\w/]+\.py)::(\w+)`", text)
    assert named
    for file, test in named:
        assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), test
    for path in re.findall(r"`(estimators/[\w/]+\.py)`", PAGES[page]):
        assert (ROOT / path).exists(), path


def test_figures_of_pages_are_those_of_their_estimators(pictures):
    """If this fails, an estimator has changed: run scripts/pictures/make_estimator_pictures.py."""
    assert set(pictures.PICTURES) == set(PAGES)
    for page in PAGES:
        assert f"\n{pictures.sentence(page)}\n" in PAGES[page], page


@pytest.mark.parametrize(
    ("name", "wheel"),
    [("dead-reckoning-1", 0), ("ipec-1", 2), ("cast-0", 0), ("cast-arc-0", 0), ("wheel-odometry", 0)],
)
def test_slip_moves_all_that_do_not_doubt(name, wheel):
    """One wheel reads 20 % too far for two seconds: the filter is moved by less than a third of what others are."""
    (task,) = (task for task in official_tasks() if task.name == "umbmark-kinematic-calibrated")
    run = task.record(800_000).runs[0]

    def moved(spec):
        ends = []
        for factor in (1.0, 1.2):
            estimator = load_estimator(spec).factory()
            estimator.reset(task.robot, run.start)
            pose = run.start
            for k, seen in enumerate(run.log.observations()):
                slipped = np.array(seen["wheel"], dtype=float)
                slipped[wheel] *= factor if 40 <= k < 80 else 1.0
                pose = estimator.update({**seen, "wheel": slipped})
                if k == 120:
                    break
            ends.append(pose)
        return np.hypot(*(ends[1] - ends[0])[:2]) + abs(ends[1][2] - ends[0][2])

    assert moved("filter") < moved(name) / 3
