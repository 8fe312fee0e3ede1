"""A small trial with each generator, from cases to scores."""

import json
import sys

import pytest

from castor_envs import command_line
from castor_envs.errors import InputError
from discrepancy import cli
from discrepancy.trials import run, scores
from discrepancy.trials.generators import generator


def test_the_command_makes_judges_and_scores(capsys):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, ["trial", "--cases", "2", "--seed", "12", "--duration", "25", "--json"])
    assert ended.value.code == 0
    scored = json.loads(capsys.readouterr().out)
    assert (scored["format"], scored["judged"]) == ("castor-trial/2", 2)
    assert scored["plan"]["generator"] == "pymunk"
    clean = next(one for one in scored["rates"] if one["what"].startswith("clean"))
    assert (clean["count"], clean["total"]) == (0, 1)
    broken = next(one for one in scored["rates"] if one["what"].startswith("the finder broke"))
    assert broken["count"] == 0


def test_a_foreign_simulator_is_found_out_too(tmp_path):
    """Case 1 hides one effect; logs of the same simulator in good order set what is background."""
    pytest.importorskip("mujoco")
    run.make(1, 2, "mujoco", tmp_path / "trial", duration=25.0)
    run.judge(tmp_path / "trial")
    run.resimulate(tmp_path / "trial")
    (trial,) = scores.trials_of(tmp_path / "trial")
    assert trial.outcome["verdict"] not in ("broken", "refused"), trial.outcome["reason"]
    assert not set(trial.named) - set(trial.truth)


def test_an_unknown_generator_is_told(capsys):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, ["trial", "--generator", "gazebo"])
    assert ended.value.code == 2
    assert "pymunk" in capsys.readouterr().err


def test_a_generator_that_is_not_installed_says_how_it_is(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(InputError, match=r"install castor-envs\[bullet\]"):
        generator("bullet")
