"""A small trial by the command, from cases to scores, in processes of its own."""

import json
import sys

import pytest

from castor_envs.cli import command_line
from castor_envs.errors import InputError
from discrepancy import cli
from discrepancy.trials import folder as trials
from discrepancy.trials import run
from discrepancy.trials.generators import generator


def trial(capsys, *options):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, ["trial", "--robot", "differential", "--duration", "10", "--jobs", "1", *options])
    return ended.value.code, capsys.readouterr()


def test_the_command_makes_judges_and_scores(capsys, tmp_path):
    asked = ("--cases", "1", "--out", str(tmp_path / "kept"))
    code, printed = trial(capsys, *asked, "--json")
    assert code == 0
    scored = json.loads(printed.out)
    assert (scored["format"], scored["finder"], scored["judged"]) == ("castor-trial/3", "posterior", 1)
    assert (scored["plan"]["generator"], scored["plan"]["robots"]) == ("pymunk", ["differential"])
    (broken,) = [one for one in scored["all"]["rates"] if one["what"] == "the finder broke down"]
    assert (broken["count"], broken["total"]) == (0, 1)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("case-*")}
    code, printed = trial(capsys, *asked)
    assert code == 0
    assert "1 of 1 cases, generator pymunk" in printed.out
    assert kept == {path: path.stat().st_mtime_ns for path in kept}


def test_a_foreign_simulator_makes_cases_too(tmp_path):
    pytest.importorskip("mujoco")
    plan = run.Plan(1, 2, "mujoco", ["differential"], 10.0)
    for part in ("cases", "labels"):
        (tmp_path / part).mkdir()
    trials._make_case(plan, 1, tmp_path)
    label = json.loads((tmp_path / "labels" / "case-0001.json").read_text(encoding="utf-8"))
    assert label["robot"] == "differential"
    assert (tmp_path / "cases" / "case-0001" / "log.csv").exists()


def test_a_generator_that_is_not_installed_says_how_it_is(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(InputError, match=r"pip install '\.\[bullet\]' in the project's folder"):
        generator("bullet")


def test_unknown_numbers_are_reported(capsys):
    for options, known in (
        (("--generator", "gazebo"), "pymunk"),
        (("--robot", "cfmmr-33"), "did you mean 'cfmmr-"),
    ):
        code, printed = trial(capsys, *options)
        assert code == 2
        assert known in printed.err
