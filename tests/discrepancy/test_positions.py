"""Diagnosis from positions without headings: effects are named, good order is none, and what stays open is said."""

import dataclasses
import json
from functools import cache

import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.geometry.se2 import compose
from castor_envs.logs.csv import write_log
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy import cli
from discrepancy.diagnose import examine
from discrepancy.inspect import inspect_log
from discrepancy.posterior.linearise import linearise
from discrepancy.preflight.checks import remarks
from discrepancy.trials.pymunk_generator import drive

POINT, WORLD = (0.1, 0.05, 0.0), (3.0, -2.0, 1.0)
"""m, m, rad: the tracked point, and where the body begins in the reference's world."""

HIDDEN = {
    "asoc-prototype": EncoderLatency(castor=3, value=0.006),
    "differential": WheelRadius(castor=1, wheel=1, value=0.01),
}
SECONDS = 24.0


@cache
def with_headings(name, seed, hidden=False):
    """A log of a robot in physics, with a pose a second, of 2 mm and 3 mrad of noise, of a point off its origin."""
    robot = preset(name)
    path = wander(np.random.default_rng([seed, 3]), duration=SECONDS, holonomic=name != "differential")
    log = drive(robot.with_effects(HIDDEN[name]) if hidden else robot, path, seed, duration=SECONDS)
    assert log.reference is not None
    noise = np.random.default_rng(seed).normal(size=log.reference.shape) * [0.002, 0.002, 0.003]
    reference = compose(WORLD, compose(log.reference, POINT)) + noise
    reference[np.arange(len(log)) % 20 > 0] = np.nan
    return dataclasses.replace(log, reference=reference)


def headless(log):
    return dataclasses.replace(log, reference=log.reference * [1.0, 1.0, np.nan])


def positions(name, seed, hidden=False):
    return headless(with_headings(name, seed, hidden))


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_an_effect_is_named_from_positions_alone(name):
    logs = {"a": positions(name, 1, True), "b": positions(name, 2, True)}
    examined = examine(preset(name), logs, {"c": positions(name, 3, True)}, {})
    assert examined.data["verdict"] == "named", examined.data["answers"]
    assert examined.found is not None
    (found,) = examined.found.effects
    assert dataclasses.replace(found, value=HIDDEN[name].value) == HIDDEN[name]
    assert found.value == pytest.approx(HIDDEN[name].value, rel=0.15)
    before, after = examined.data["held_out_gap"]
    assert after[0] < before[0]
    assert (before[1], after[1], examined.data["noise"]["heading_rad"]) == (None, None, None)
    replayed = examined.data["replay"]["after"]
    assert replayed["heading_rms_mrad"] is None
    assert 0 < replayed["position_rms_mm"] < 6  # of 2 mm along each axis at either end, and a heading of as much
    assert any("likely path" in note for note in replayed["notes"])
    page = examined.page()
    assert "It has no headings" in page
    assert "heading, mrad" not in page


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_a_robot_in_good_order_raises_no_alarm(name):
    data = examine(preset(name), {"a": positions(name, 1), "b": positions(name, 2)}, {}, {}).data
    assert data["verdict"] in ("no discrepancy", "negligible")
    assert data["gap"][0][0] < 0.004
    assert sum("has no headings" in line for line in data["preflight"]) == 2
    assert not data["mistakes"]


def test_the_gap_of_positions_is_that_of_poses_without_their_headings():
    robot, log = preset("asoc-prototype"), with_headings("asoc-prototype", 1)
    whole, alone = (linearise(robot, [each], among=()).gap for each in (log, headless(log)))
    assert whole is not None
    assert alone is not None
    assert alone[0] == pytest.approx(whole[0], rel=0.1)
    assert alone[0] <= whole[0] + 1e-4  # aligned by positions alone they are nearer
    assert np.isnan(alone[1])


def test_evidence_does_not_depend_on_the_world_of_the_reference():
    robot, log = preset("asoc-prototype"), positions("asoc-prototype", 1)
    assert log.reference is not None
    moved = dataclasses.replace(log, reference=compose([5.0, 4.0, -2.0], log.reference) * [1.0, 1.0, np.nan])
    noise = linearise(robot, [log], among=()).noise
    here, there = (linearise(robot, [each], among=()).at_noise(noise).log_evidence for each in (log, moved))
    assert there == pytest.approx(here, abs=0.5)


def test_what_is_open_is_said_in_one_line():
    log = with_headings("asoc-prototype", 1)
    (said,) = (line for line in remarks(preset("asoc-prototype"), headless(log)) if "heading" in line)
    assert said == (
        "the reference has no headings: odometry is turned as its positions show, and compared with these alone"
    )
    assert not [line for line in remarks(preset("asoc-prototype"), log) if "heading" in line]
    assert log.reference is not None
    some = log.reference.copy()
    some[:400, 2] = np.nan
    (said,) = remarks(preset("asoc-prototype"), dataclasses.replace(log, reference=some))
    assert "has no heading in 20 of 25 rows" in said


def test_inspection_shows_the_positions():
    entry = inspect_log(preset("asoc-prototype"), positions("asoc-prototype", 1))
    assert entry["reference_rows"] == 25
    assert [channel["name"] for channel in entry["reference"]] == ["ref_x", "ref_y"]


def test_commands_take_positions(tmp_path, capsys):
    robot = preset("differential")
    robot.save(tmp_path / "robot.json")
    write_log(tmp_path / "a.csv", positions("differential", 1, True), robot)
    lines = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    psi = lines[0].index("ref_psi")
    rows = [",".join(cell for k, cell in enumerate(line) if k != psi) for line in lines]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
    given = [str(tmp_path / "a.csv"), "--robot", str(tmp_path / "robot.json")]
    for arguments in (["inspect", *given], [*given, "--json"]):
        with pytest.raises(SystemExit) as ended:
            command_line.run(cli.app, arguments)
        out, err = capsys.readouterr()
        assert ended.value.code == 0, err
        if "inspect" in arguments:
            assert "positions without headings" in out
        else:
            data = json.loads(out)
            assert data["gap"][0][1] is None
            assert data["answers"][0]["what"].startswith("wheel radius")
