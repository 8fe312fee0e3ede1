"""Parameters in a spec reach the class as its annotations say; what does not fit is answered with what does."""

import pickle
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.results.rows import ResultsStore
from castor_envs.errors import InputError
from estimators import CAST, GRPEC, load_estimator
from estimators.plugins.registry import CALIBRATION, load_calibration

TUNED = """
from __future__ import annotations

from typing import Literal


class Tuned:
    def __init__(
        self, gain: float = 0.5, steps: int = 3, robust: bool = False, kind: Literal["a", "b"] = "a", name: str = "x",
        limit: float | None = None, plain=2, weights: Anything = None,
    ):
        self.given = {"gain": gain, "steps": steps, "robust": robust, "kind": kind, "name": name, "limit": limit,
                      "plain": plain}

    def reset(self, robot, pose):
        self.pose = pose.copy()

    def update(self, observation):
        return self.pose.copy()


class Several(Tuned):
    def __init__(self, gains: tuple[float, ...] = (), names: list[str] | None = None, by: dict[str, int] | None = None):
        self.given = {"gains": gains, "names": names, "by": by}


class Needs(Tuned):
    def __init__(self, gain: float, *, other: "int" = 1):
        self.given = {"gain": gain, "other": other}
"""


@pytest.fixture(autouse=True)
def _in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    Path("tuned.py").write_text(TUNED.replace("weights: Anything = None,", ""))
    Path("odd.py").write_text(TUNED.replace("Anything", "object"))


DEFAULTS = {"gain": 0.5, "steps": 3, "robust": False, "kind": "a", "name": "x", "limit": None, "plain": 2}


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("gain=2", {"gain": 2.0}),
        ("steps=7&gain=1e-3", {"gain": 0.001, "steps": 7}),
        ("robust=true&kind=b", {"robust": True, "kind": "b"}),
        ("name=3&limit=4&plain=5", {"name": "3", "limit": 4.0, "plain": 5}),
        ("name=a=b", {"name": "a=b"}),
    ],
)
def test_text_becomes_what_the_annotation_says(text, changed):
    made: Any = load_estimator(f"tuned.py:Tuned?{text}").factory()
    assert made.given == DEFAULTS | changed
    assert all(type(made.given[name]) is type(value) for name, value in changed.items())


def test_annotations_may_be_texts_and_arguments_required():
    made: Any = load_estimator("tuned.py:Needs?other=4&gain=1").factory()
    assert made.given == {"gain": 1.0, "other": 4}


@pytest.mark.parametrize(
    ("text", "changed", "name"),
    [
        ("gains=[1,2]", {"gains": (1.0, 2.0)}, "gains=[1.0,2.0]"),
        ("gains=[ 1, 2 ]&names=[]", {"gains": (1.0, 2.0), "names": []}, "gains=[1.0,2.0]&names=[]"),
        ('names=["a","ü"]', {"names": ["a", "ü"]}, 'names=["a","ü"]'),
        ('by={"a": 1}', {"by": {"a": 1}}, 'by={"a":1}'),
    ],
)
def test_several_values_are_json_and_a_name_can_be_given_again(text, changed, name):
    entry = load_estimator(f"tuned.py:Several?{text}")
    made: Any = entry.factory()
    assert made.given == {"gains": (), "names": None, "by": None} | changed
    assert entry.name == f"tuned:Several?{name}"
    again = load_estimator(f"tuned.py:Several?{name}")
    assert (again.name, again.source_hash) == (entry.name, entry.source_hash)


def test_a_text_may_begin_as_a_list():
    made: Any = load_estimator("tuned.py:Tuned?name=[a]").factory()
    assert made.given == DEFAULTS | {"name": "[a]"}


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("cast-0?stp=euler", r"no parameter 'stp'; did you mean 'step'\? CAST takes step: .* = 'arc'"),
        ("cast-0?left_out=1", "no parameter 'left_out'"),
        ("cast?step=eule", "'step': Input should be 'arc', .*left_out: int = 0"),
        ("grpec-xy?interval=x", "'interval': Input should be a valid integer.*interval: int = 100"),
        ("grpec-xy?interval=0", "estimator 'grpec-xy.interval=0'.*got 0"),
        ("filter?x=1", "CalibratingFilter takes no parameters"),
        ("cast?step", "'step' after the question mark"),
        ("cast?", "after the question mark"),
        ("cast?step=arc&step=euler", "'step' is given twice"),
        ("tuned.py:Tuned?name=a|b", r"the value of 'name' has '\|' in it, which names may not have"),
        ("tuned.py:Tuned?name=a\x1b", "the value of 'name' has a character that cannot be printed in it"),
        ("tuned.py:Several?gains=1,2", r"'gains': .*got '1,2', several values as JSON .\[1,2\].; Several"),
        ("tuned.py:Several?gains=[1,x]", "'gains': "),
        ("odd.py:Tuned?weights=1", "no parameter|weights"),
        (f"tuned.py:Tuned?name={'x' * 200}", "too long"),
        ("nothing?step=arc", "unknown estimator 'nothing'"),
    ],
)
def test_what_does_not_fit_is_answered_with_what_does(spec, words):
    if spec.startswith("odd"):  # an object may be anything, text too
        assert load_estimator(spec).parameters == {"weights": "1"}
        return
    with pytest.raises(InputError, match=words):
        load_estimator(spec)


def test_each_combination_is_another_estimator_on_the_board(tmp_path):
    specs = ["cast-0", "cast-0?step=euler", "cast-0?step=arc", "cast?step=euler", "tuned.py:Tuned?gain=1"]
    entries = [load_estimator(spec) for spec in specs]
    assert [entry.name for entry in entries] == [*specs[:4], "tuned:Tuned?gain=1.0"]
    assert len({entry.source_hash for entry in entries}) == len(entries)
    store = ResultsStore(tmp_path)
    folders = {store.folder("task", 1, entry.name, entry.source_hash).name for entry in entries}
    assert len(folders) == len(entries)
    assert not any(set(folder) & set("?&=/:") for folder in folders)


def test_order_and_spelling_do_not_matter():
    one, other = (load_estimator(f"tuned.py:Tuned?{text}") for text in ("gain=1&steps=2", "steps=02&gain=1.0"))
    assert (one.name, one.source_hash) == (other.name, other.source_hash)


def test_another_process_makes_the_same():
    entry = pickle.loads(pickle.dumps(load_estimator("estimators.trains.grpec:GRPEC?metric=phi&interval=20")))
    made = entry.factory()
    assert isinstance(made, GRPEC)
    assert load_estimator("cast-2?step=euler").kind is CAST
    assert entry.parameters == {"metric": "phi", "interval": 20}


def test_methods_take_none():
    with pytest.raises(InputError, match="unknown calibration method"):
        load_calibration("pivoting?x=1")
    assert not CALIBRATION.numbered
