"""What the command prints of a diagnosis by posterior, and what it refuses."""

import json

import numpy as np
import pytest

from castor_envs import command_line
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.logs.csv import write_log
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy import cli
from discrepancy.posterior import told
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("differential")


def command(*words):
    with pytest.raises(SystemExit) as end:
        command_line.run(cli.app, ["find", *map(str, words), "--finder", "posterior"])
    return end.value.code


def test_json_and_words_say_the_same(tmp_path, capsys):
    motion = wander(np.random.default_rng([1, 1]), duration=20.0, holonomic=False)
    real = ROBOT.with_effects(WheelRadius(castor=1, wheel=2, value=0.01))
    write_log(tmp_path / "log.csv", drive(real, motion, 1, duration=20.0), ROBOT)
    assert not command(tmp_path / "log.csv", "--robot", "differential", "--json")
    data = json.loads(capsys.readouterr().out)
    assert (data["format"], data["verdict"]) == ("castor-diagnosis/2", "named")
    (answer,) = (answer for answer in data["answers"] if answer["verdict"] == "named")
    assert answer["credible_set"] == ["wheel_radius 1 2"]
    low, high = answer["interval"]
    assert low < 0.01 < high
    assert answer["effect"]["name"] == "wheel_radius"
    lines = told.as_lines(data)
    assert lines[0] == "verdict: named"
    assert any("wheel radius, castor 1, wheel 2" in line for line in lines)
    assert len(lines) <= 10


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "found"], "--out is not written by --finder posterior yet"),
        (["--finder", "guess"], "--finder guess"),
    ],
)
def test_what_it_cannot_do_is_one_line(tmp_path, capsys, words, said):
    path = tmp_path / "log.csv"
    path.write_text("t\n0\n")
    with pytest.raises(SystemExit) as end:
        command_line.run(cli.app, ["find", str(path), "--robot", "differential", "--finder", "posterior", *words])
    assert end.value.code == 2
    assert said in capsys.readouterr().err
