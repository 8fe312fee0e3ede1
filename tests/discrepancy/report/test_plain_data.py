"""What the command writes and prints of a diagnosis by posterior."""

import html
import json
import math

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.effects.dimensions import Track, WheelRadius
from castor_envs.effects.encoders import LearnedTerm
from castor_envs.effects.wiring import EncoderReversed
from castor_envs.logs.csv import read_log, write_log
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy import cli
from discrepancy.diagnose import diagnosed
from discrepancy.hypotheses.candidates import Candidate, described
from discrepancy.posterior.answers import Learned
from discrepancy.posterior.model.dimensions import Dimension
from discrepancy.posterior.model.refit import Sized
from discrepancy.posterior.variances.learned import answer_of
from discrepancy.preflight.undo import Undone
from discrepancy.report import sentences
from discrepancy.report.plain_data import answer_data, dimension_data
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import USUAL
from estimators.calibration.identifiability import COVERAGE

ROBOT = preset("differential")
REAL = ROBOT.with_effects(WheelRadius(castor=1, wheel=2, value=0.01))


def command(capsys, *words):
    with pytest.raises(SystemExit) as end:
        command_line.run(cli.app, ["find", *map(str, words), "--robot", "differential"])
    return end.value.code, *capsys.readouterr()


def write(path, robot, seed=1):
    motion = wander(np.random.default_rng([seed, 1]), duration=20.0, holonomic=False)
    write_log(path, drive(robot, motion, seed, duration=20.0), ROBOT)
    return path


def test_a_learned_curve_has_its_band_and_its_nearest_effect():
    term = LearnedTerm(castor=1, wheel=1, value=2.0, of="speed", knots=(-1.0, 1.0), values=(-0.1, 0.2))
    curve = answer_data(answer_of(ROBOT, Learned(term, (0.01, 0.02), 9.0, ("slope of the floor", 0.2)), []))["curve"]
    assert curve["values"] == pytest.approx([-0.2, 0.4])
    assert curve["high"] == pytest.approx([-0.2 + 1.96 * 0.02, 0.4 + 1.96 * 0.04], abs=1e-3)
    assert (np.array(curve["high"]) + curve["low"]).tolist() == pytest.approx([-0.4, 0.8])
    assert (curve["of"], curve["unit"], curve["knots"]) == ("speed", "rad/s", [-1.0, 1.0])
    assert curve["nearest"] == {"what": "slope of the floor", "cosine": 0.2}


def test_dimensions_that_are_guessed_together_are_told_with_their_intervals():
    sizes = (WheelRadius(castor=1, wheel=1, value=0.002), 0.001), (Track(castor=1, value=-0.01), 0.004)
    guessed = [
        Dimension(Sized(Candidate(described(kind), (kind,)), np.array([kind.value])), np.array([error / COVERAGE]))
        for kind, error in sizes
    ]
    data = {"dimensions": [dimension_data(dimension) for dimension in guessed], "file": "robot.json"}
    assert sentences.together(data) == (
        "Held-out logs confirm dimensions guessed together, which need not be sure one by one; robot.json has them: "
        "wheel radius, castor 1, wheel 1 +0.200 % (+0.100 to +0.300); "
        "track (distance between the wheels), castor 1 −1.00 % (−1.40 to −0.60)."
    )


def numbers(data):
    if isinstance(data, dict | list):
        for value in data.values() if isinstance(data, dict) else data:
            yield from numbers(value)
    elif isinstance(data, float):
        yield data


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("worn") / "log.csv", REAL)


def test_the_folder_holds_page_data_and_the_robot_with_the_reported_gap(log, tmp_path, capsys):
    out = tmp_path / "found"
    code, text, err = command(capsys, log, "--out", out)
    assert code == 0, err
    assert sorted(path.name for path in out.iterdir()) == ["diagnosis.json", "report.html", "robot.json"]
    data, page = json.loads((out / "diagnosis.json").read_text()), (out / "report.html").read_text()
    assert (data["format"], data["verdict"]) == ("castor-diagnosis/2", "named")
    assert all(math.isfinite(number) for number in numbers(data))
    (answer,) = (answer for answer in data["answers"] if answer["verdict"] == "named")
    assert answer["credible_set"] == ["wheel_radius 1 2"]
    assert all(0 <= part <= 1 for part in [answer["probability"], *answer["probabilities"].values()])
    low, high = answer["interval"]
    assert low < 0.01 < high
    assert (data["robot_hash"], data["logs"], data["robot_file"]) == (ROBOT.hash(), [str(log)], str(out / "robot.json"))
    written = RobotDescription.load(out / "robot.json")
    assert written.to_dict()["effects"] == data["effects"]
    env = gym.make("castor_envs:castor/ASOC-v1", robot=str(out / "robot.json"))
    env.reset(seed=0)
    env.step(np.full(2, 0.2, dtype=np.float32))
    env.close()
    before, after = data["gap"]
    assert 4 * after[0] < before[0]
    assert after[0] < np.sqrt(2) * USUAL.position  # the reference's noise along two axes, and nothing else
    assert data["replay"]["after"]["position_rms_mm"] < 0.5 * data["replay"]["before"]["position_rms_mm"]
    again = diagnosed(Undone(written, {"log": read_log(log, written)}, {}, {}))
    assert again.before.gap == tuple(after)
    lines = text.splitlines()
    assert len(lines) <= 11
    assert f"with robot.json {1e3 * after[0]:.3g} mm and {1e3 * after[1]:.3g} mrad" in text
    assert "wheel radius, castor 1, wheel 2, over 99.9 % sure: +1.0" in text
    assert sentences.sentence(data) in html.unescape(page)
    assert page.count("<img") >= 2
    assert f"these logs, {1e3 * before[0]:.2f} mm and {1e3 * after[0]:.2f} mm rms" in page  # the picture is of the gap
    assert "The gap.</b> Odometry with predicted creep is off the reference by" in page
    assert "Where slip is left" not in page
    assert command(capsys, log, "--out", out)[0] == 2


def test_undone_wiring_is_in_robot_and_verdict(tmp_path, capsys):
    log = write(tmp_path / "log.csv", ROBOT.with_effects(EncoderReversed(castor=1, wheel=2)))
    code, text, err = command(capsys, log, "--out", tmp_path / "found")
    assert code == 0, err
    data = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    assert (data["verdict"], data["gap"][1]) == ("named", None)
    assert [effect.name for effect in RobotDescription.load(tmp_path / "found" / "robot.json").effects] == [
        "encoder_reversed"
    ]
    assert "pre-flight: " in text
    assert sentences.sentence(data) == "Gross mistake: wheel_1r counts backwards. Nothing else that matters is missing."


def test_the_unconfirmed_is_not_written_and_slip_is_shown(log, tmp_path, capsys):
    (tmp_path / "good").mkdir()
    held_out = write(tmp_path / "good" / "log.csv", ROBOT, seed=2)
    code, text, err = command(capsys, log, "--holdout", held_out, "--out", tmp_path / "found")
    assert code == 0, err
    assert not (tmp_path / "found" / "robot.json").exists()
    data, page = json.loads((tmp_path / "found" / "diagnosis.json").read_text()), tmp_path / "found" / "report.html"
    assert (data["verdict"], data["effects"], data["robot_file"]) == ("unconfirmed", [], None)
    assert data["held_out_gap"][1] is None
    assert "with robot.json" not in text
    assert "Where slip is left" in page.read_text()
    assert f"{log.parent.name}/log.csv, held out: good/log.csv" in page.read_text()
