"""The whole way: gross mistakes undone, effects named beside them, the gap by re-simulation, and the files."""

import dataclasses
import json

import numpy as np
import pytest

from castor_envs import command_line
from castor_envs.effects.catalogue import readings
from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.wiring import EncodersSwapped
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy import cli
from discrepancy.diagnose import examine
from discrepancy.report.text import as_lines

ROBOT = preset("asoc-prototype")
LATE, SWAPPED = EncoderLatency(castor=3, value=0.006), EncodersSwapped(castor=1)


def rolled(robot, seed, duration=30.0, reference=True):
    """A log of perfect rolling, by hand, of a robot with its effects."""
    true = robot.as_built()
    motion = roll(true, wander(np.random.default_rng([seed, 1]), duration=duration), [0.3, 2.0, -1.5])
    encoders = Encoders(Geometry.of(true), np.full(6, 0.4))
    wheel, castor = readings(robot, motion.t, motion.wheel_angle, motion.castor_angle)
    pose = motion.pose + np.random.default_rng([seed, 3]).normal(size=motion.pose.shape) * 1e-3
    pose[np.arange(len(pose)) % 20 > 0] = np.nan
    return Log(motion.t, encoders.wheel(wheel), encoders.pivot(castor), reference=pose if reference else None)


def test_an_effect_is_found_behind_wrong_wiring():
    """Encoders are exchanged after all else that they do, so wiring comes last in the file."""
    robot = ROBOT.with_effects(LATE, SWAPPED)
    examined = examine(ROBOT, {"a": rolled(robot, 1)}, {"b": rolled(robot, 2)}, {})
    assert examined.data["verdict"] == "named", examined.data["reason"]
    assert examined.found is not None
    late, swapped = examined.found.effects
    assert swapped == SWAPPED
    assert dataclasses.replace(late, value=LATE.value) == LATE
    assert late.value == pytest.approx(LATE.value, rel=0.05)
    assert "swapped" in examined.data["preflight"][0]
    before, after = examined.data["replay"]["before"], examined.data["replay"]["after"]
    assert after["pivots_rms_mrad"] < 0.5 * before["pivots_rms_mrad"]


def test_clean_logs_are_of_before_the_encoders_were_swapped():
    """They come as they should be, and are left so: nothing remains but the swap, and what there is beside it."""
    robot = ROBOT.with_effects(LATE, SWAPPED)
    clean = {name: rolled(ROBOT, seed, 20.0) for name, seed in (("c", 3), ("d", 4))}
    for faulty, others in ((ROBOT.with_effects(SWAPPED), ()), (robot, (LATE,))):
        examined = examine(ROBOT, {"a": rolled(faulty, 1)}, {"b": rolled(faulty, 2)}, clean, replayed=False)
        assert examined.data["verdict"] == "named", examined.data["reason"]
        assert examined.found is not None
        *rest, swapped = examined.found.effects
        assert swapped == SWAPPED
        assert [dataclasses.replace(one, value=LATE.value) for one in rest] == list(others)


def test_alignment_is_told_beside_that_of_clean_logs():
    """How a tracker is mounted is no effect of the robot: a change of it since the clean logs is seen, not named."""
    log = rolled(ROBOT, 1, 20.0)
    assert log.reference is not None
    turned = dataclasses.replace(log, reference=log.reference + np.array([0.0, 0.0, 0.02]))
    examined = examine(ROBOT, {"a": turned}, {}, {"c": rolled(ROBOT, 3, 20.0)}, replayed=False)
    assert examined.data["verdict"] == "no discrepancy"
    now, clean = examined.data["reference"], examined.data["reference"]["clean"]
    assert now["mount"]["psi_rad"] == pytest.approx(0.02, abs=1e-3)
    assert clean["mount"]["psi_rad"] == pytest.approx(0.0, abs=1e-3)
    lines = "\n".join(as_lines(examined.data))
    assert "turned by 1.1" in lines.partition("in the clean logs")[0]
    assert "turned by 0.0" in lines.partition("in the clean logs")[2]
    assert len(clean["clocks"]) == 1
    assert "in the clean logs" in examined.page()


def test_without_a_reference_encoders_alone_tell():
    examined = examine(ROBOT, {"a": rolled(ROBOT.with_effects(LATE), 1, reference=False)}, {}, {})
    assert examined.found is not None
    assert examined.found.effects[0].name == "encoder_latency"
    assert examined.data["reference"] is None
    assert any("scale" in line for line in examined.data["preflight"])


@pytest.fixture
def folder(tmp_path):
    ROBOT.save(tmp_path / "robot.json")
    write_log(tmp_path / "a.csv", rolled(ROBOT.with_effects(LATE), 1, 20.0), ROBOT)
    return tmp_path


def call(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, list(map(str, arguments)))
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def test_the_folder_holds_page_data_and_robot(folder, capsys):
    out = folder / "found"
    code, text, err = call(capsys, folder / "a.csv", "--out", out, "--finder", "selection")
    assert code == 0, err
    assert sorted(path.name for path in out.iterdir()) == ["diagnosis.json", "report.html", "robot.json"]
    page, data = (out / "report.html").read_text(), json.loads((out / "diagnosis.json").read_text())
    assert page.count("<svg") >= 5
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert data["robot_file"] == str(out / "robot.json")
    assert [one["name"] for one in data["effects"]] == ["encoder_latency"]
    assert data["findings"][0]["effect"] == data["effects"][0]
    assert RobotDescription.load(out / "robot.json").effects[0].name == "encoder_latency"
    assert "latency of one encoder, castor 3" in text


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda lines: [lines[0], *(f"{line.split(',')[0]}," + "0," * line.count(",") for line in lines[1:])], "a.csv"),
        (lambda lines: lines[:1] + lines[5:3:-1], "a.csv:3"),
        (lambda lines: lines[:2], "a.csv"),
        (lambda lines: [*lines[:9], lines[9].replace(",", ",x", 1), *lines[10:]], "a.csv:10"),
        (lambda lines: [lines[0].replace("wheel_1l", "wheel_9l"), *lines[1:]], "wheel_9l"),
    ],
    ids=["constant", "backward", "short", "not a number", "another robot's"],
)
def test_bad_logs_are_one_line_and_leave_nothing(folder, capsys, spoil, said):
    lines = (folder / "a.csv").read_text().splitlines()
    (folder / "a.csv").write_text("\n".join(spoil(lines)) + "\n")
    code, text, err = call(capsys, folder / "a.csv", "--out", folder / "found")
    assert code == 2, text
    assert text == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert said in err
    assert not (folder / "found").exists()
