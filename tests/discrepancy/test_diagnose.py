"""The whole way: gross mistakes undone, effects named beside them, the gap by re-simulation, and the files."""

import dataclasses
import re
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.effects.catalogue import readings
from castor_envs.effects.clocks import AllLatency, EncoderLatency
from castor_envs.effects.wiring import EncodersSwapped
from castor_envs.errors import InputError
from castor_envs.geometry.se2 import compose
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy import cli
from discrepancy.commands import find
from discrepancy.diagnose import examine
from discrepancy.posterior.finder import diagnose
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.maximum_likelihood.calibrate import calibrate

ROBOT = preset("asoc-prototype")
LATE, SWAPPED = EncoderLatency(castor=3, value=0.006), EncodersSwapped(castor=1)


def rolled(robot, seed, duration=12.0, reference=True):
    """A log of perfect rolling, by hand, of a robot with its effects."""
    true = robot.as_built()
    motion = roll(true, wander(np.random.default_rng([seed, 1]), duration=duration), [0.3, 2.0, -1.5])
    encoders = Encoders(Geometry.of(true), np.full(6, 0.4))
    wheel, castor = readings(robot, motion.t, motion.wheel_angle, motion.castor_angle)
    pose = motion.pose + np.random.default_rng([seed, 3]).normal(size=motion.pose.shape) * 1e-3
    pose[np.arange(len(pose)) % 20 > 0] = np.nan
    return Log(motion.t, encoders.wheel(wheel), encoders.pivot(castor), reference=pose if reference else None)


@pytest.mark.slow
def test_an_effect_is_found_behind_wrong_wiring():
    """Encoders are exchanged after all else that they do, so wiring stands last in the file; clean logs are without."""
    robot = ROBOT.with_effects(LATE, SWAPPED)
    examined = examine(
        ROBOT, {"a": rolled(robot, 1, 20.0)}, {"b": rolled(robot, 2, 20.0)}, {"c": rolled(ROBOT, 3, 20.0)}
    )
    assert examined.data["verdict"] == "named", examined.data["answers"]
    assert examined.found is not None
    late, swapped = examined.found.effects
    assert swapped == SWAPPED
    assert dataclasses.replace(late, value=LATE.value) == LATE
    assert late.value == pytest.approx(LATE.value, rel=0.05)
    assert "swapped" in examined.data["preflight"][0]
    before, after = examined.data["replay"]["before"], examined.data["replay"]["after"]
    assert after["pivots_rms_mrad"] < 0.5 * before["pivots_rms_mrad"]


def test_the_mount_of_a_tracker_is_no_effect_of_the_robot():
    log = rolled(ROBOT, 1)
    assert log.reference is not None
    turned = dataclasses.replace(log, reference=log.reference + np.array([0.0, 0.0, 0.02]))
    found = diagnose(ROBOT, [turned])
    assert not found.found.effects
    assert found.verdict in ("no discrepancy", "negligible")
    assert found.before.state.mount[2] == pytest.approx(0.02, abs=1e-3)


@pytest.mark.slow
def test_a_reference_that_is_early_is_told_and_is_no_effect_of_the_robot():
    """Encoders that are all late look the same. That of a log in good order is early by less than half a sample."""
    late = AllLatency(value=0.08)
    examined = examine(ROBOT, {"a": rolled(ROBOT.with_effects(late), 1), "b": rolled(ROBOT, 2)}, {}, {})
    (remark,) = (line for line in examined.data["preflight"] if "the reference is" in line)
    assert remark.startswith("a: the reference is ")
    assert " ms early, or all encoders are late by as much" in remark
    assert float(remark.split()[4]) == pytest.approx(80, abs=1)
    assert remark in examined.page()
    assert not examined.data["effects"]


@pytest.mark.slow
def test_without_a_reference_encoders_suffice():
    examined = examine(ROBOT, {"a": rolled(ROBOT.with_effects(LATE), 1, reference=False)}, {}, {})
    assert examined.found is not None
    assert examined.found.effects[0].name == "encoder_latency"
    assert examined.data["gap"] is None
    assert any("scale" in line for line in examined.data["preflight"])
    assert "nothing that was measured" not in examined.page()


@pytest.fixture
def folder(tmp_path):
    ROBOT.save(tmp_path / "robot.json")
    write_log(tmp_path / "a.csv", rolled(ROBOT.with_effects(LATE), 1), ROBOT)
    return tmp_path


def call(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, list(map(str, arguments)))
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def test_options_take_several_logs(folder, capsys, monkeypatch):
    """What follows --holdout is held out, up to the next option."""
    given = []

    def taken(robot, logs, held_out, clean, material):
        given.append([[Path(path).stem for path in some] for some in (logs, held_out, clean)])
        raise InputError("seen")

    monkeypatch.setattr(find, "examine", taken)
    for name in ("b", "c", "d"):
        shutil.copy(folder / "a.csv", folder / f"{name}.csv")
    a, b, c, d, e = (folder / f"{name}.csv" for name in "abcde")
    assert call(capsys, a, "--holdout", b, c, "--clean", d)[0] == 2
    assert given == [[["a"], ["b", "c"], ["d"]]]
    code, _, err = call(capsys, a, "--holdout", b, e)
    assert code == 2
    assert "e.csv: cannot be read" in err


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
def test_bad_logs_are_refused_in_one_line_and_leave_no_files(folder, capsys, spoil, said):
    lines = (folder / "a.csv").read_text().splitlines()
    (folder / "a.csv").write_text("\n".join(spoil(lines)) + "\n")
    code, text, err = call(capsys, folder / "a.csv", "--out", folder / "found")
    assert code == 2, text
    assert text == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert said in err
    assert not (folder / "found").exists()


@cache
def not_turned(name):
    """Return a robot, a log of it, its calibration and its diagnosis, with a tracker that is not turned.

    Its wheels slip by more than what calibration takes for rolling (0.03 mm after 1 m), near which creep is fitted or
    left out."""
    robot = preset(name)
    log = drive(robot, wander(np.random.default_rng([1, 3]), duration=16.0), 3, duration=16.0)
    return robot, log, calibrate(robot, [log]), examine(robot, {"a": log}, {}, {}).data


@pytest.mark.parametrize(
    ("name", "turn"),
    [("asoc-prototype", 1.5), ("asoc-prototype", -2.2), ("differential", 0.6), ("differential", 3.1)],
)
def test_a_tracker_may_be_turned_by_any_angle(name, turn):
    """Calibration and diagnosis say what they say of the same log with a tracker that is not turned."""
    robot, log, plain, straight = not_turned(name)
    assert log.reference is not None
    mount = np.array([0.1, 0.05, turn])
    seen = dataclasses.replace(log, reference=compose([5.0, -3.0, 2.5], compose(log.reference, mount)))
    turned, found = calibrate(robot, [seen]), examine(robot, {"a": seen}, {}, {}).data
    np.testing.assert_allclose(turned.mount, plain.mount + mount, atol=2e-3)
    assert np.all(np.abs(turned.after - plain.after) < 0.5 * plain.standard_errors + 1e-12)
    assert (straight["verdict"], found["verdict"]) == ("no discrepancy", "no discrepancy")
    # A point 0.11 m off the body's origin is seen to move as its heading is noisy: 0.1 mm of 1.3 mm.
    assert found["gap"][0] == pytest.approx(straight["gap"][0], rel=0.1)
    side = "left" if turn > 0 else "right"
    told = re.search(rf"points (\d+) degrees to the {side}", found["preflight"][0])
    assert told is not None
    assert float(told[1]) == pytest.approx(abs(np.degrees(turn)), abs=1.5)  # the pre-flight tells whole degrees
    assert not found["mistakes"]
