"""Effects that are hidden in simulated and measured logs, and what castor-diagnose find says of them."""

# pyright: reportOptionalMemberAccess=false, reportOptionalOperand=false, reportArgumentType=false
# pyright: reportOptionalIterable=false, reportOptionalSubscript=false, reportGeneralTypeIssues=false
# pyright: reportOperatorIssue=false, reportAttributeAccessIssue=false

import dataclasses
import json
import os
from functools import cache
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from castor_envs import command_line
from castor_envs.effects.catalogue import readings
from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.dimensions import AllWheelRadius, PivotOffset, WheelRadius
from castor_envs.effects.encoders import PivotBacklash, PivotEccentricity, TickLoss
from castor_envs.errors import InputError
from castor_envs.floor import Floor, Patch
from castor_envs.logs.csv import write_log
from castor_envs.logs.importers.optiodom import find_sessions, read_session
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy import cli
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.inference.forward_selection import diagnose
from discrepancy.trials.pymunk_generator import drive
from discrepancy.validation.cost import cost_of
from discrepancy.validation.discriminating_drive import separating_drive

pytestmark = pytest.mark.slow

ROBOT = preset("asoc-prototype")


def test_the_finder_uses_one_thread_of_linear_algebra(monkeypatch):
    """Its matrices are small: beside other work on the machine, more threads took 15 times as long as one."""
    used = []

    def looked(*_):
        used.extend(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")
        raise InputError("seen")

    monkeypatch.setattr("discrepancy.inference.forward_selection.of_time", looked)
    with threadpool_limits(2), pytest.raises(InputError, match="seen"):
        diagnose(ROBOT, [driven(None, 3)])
    assert used
    assert set(used) == {1}


def log_at_random(robot, seed, duration=26.0, floor=None):
    """A log of a robot that drives at random in physics."""
    motion = wander(np.random.default_rng([seed, 1]), duration=duration)
    return drive(robot, motion, seed, duration=duration, floor=floor)


@cache
def driven(effect, seed):
    """A log of the base with an effect, driven at random in physics."""
    return log_at_random(ROBOT if effect is None else ROBOT.with_effects(effect), seed)


def rolled(effect, seed):
    """The same without physics: perfect rolling, so that nothing but the effect is there to find."""
    robot = ROBOT.with_effects(effect)
    true = robot.as_built()
    motion = roll(true, wander(np.random.default_rng([seed, 1]), duration=26.0), [0.3, 2.0, -1.5])
    encoders = Encoders(Geometry.of(true), np.full(6, 0.4))
    wheel, castor = readings(robot, motion.t, motion.wheel_angle, motion.castor_angle)
    reference = motion.pose + np.random.default_rng([seed, 3]).normal(size=motion.pose.shape) * 1e-3
    reference[np.arange(len(reference)) % 20 > 0] = np.nan
    return Log(motion.t, encoders.wheel(wheel), encoders.pivot(castor), reference=reference)


def test_a_robot_in_good_order_has_no_discrepancy():
    found = diagnose(ROBOT, [driven(None, 1)])
    assert found.verdict == "no discrepancy"
    assert found.findings == ()
    assert found.found is None


@pytest.mark.parametrize(
    "effect",
    [
        WheelRadius(castor=2, wheel=1, value=0.004),
        EncoderLatency(castor=3, value=0.004),
        PivotOffset(castor=1, value=8e-4),
        PivotBacklash(castor=2, value=0.008),
    ],
    ids=lambda effect: effect.name,
)
def test_hidden_effects_are_named_and_the_gap_shrinks(effect):
    """Driven wheels that disagree creep until they agree; how much of the effect that hides is found beside it."""
    found = diagnose(ROBOT, [driven(effect, 1)], [driven(effect, 2)])
    assert found.verdict == "named", found.reason
    (named,) = found.effects
    assert dataclasses.replace(named, value=effect.value) == effect
    assert 0.85 < named.value / effect.value < 1.2
    before, after = (one.noise for one in found.held_out)
    assert after.along + after.across < 0.8 * (before.along + before.across)


@pytest.mark.parametrize(
    "effect",
    [WheelRadius(castor=2, wheel=1, value=0.003), EncoderLatency(castor=1, wheel=2, value=0.005)],
    ids=lambda effect: effect.name,
)
def test_in_perfect_rolling_the_amplitude_is_right(effect):
    found = diagnose(ROBOT, [rolled(effect, 3)])
    assert found.verdict == "named", found.reason
    ((named, error),) = [(one.effect, one.error) for one in found.findings]
    assert dataclasses.replace(named, value=effect.value) == effect
    assert abs(named.value - effect.value) < 4 * error
    assert error < 0.1 * effect.value


def test_an_eccentric_encoder_is_found_at_any_phase():
    effect = PivotEccentricity(castor=1, value=0.004, phase=2.4)
    (named,) = diagnose(ROBOT, [rolled(effect, 3)]).effects
    assert (named.name, named.castor) == ("pivot_eccentricity", 1)
    assert named.value == pytest.approx(0.004, rel=0.1)
    assert named.phase == pytest.approx(2.4, abs=0.1)


def test_two_effects_are_found_one_after_another():
    effects = EncoderLatency(castor=2, value=0.005), PivotOffset(castor=1, value=1e-3)
    robot = ROBOT.with_effects(*effects)
    found = diagnose(ROBOT, [log_at_random(robot, 1)], [log_at_random(robot, 2)])
    assert found.verdict == "named", found.reason
    assert {(one.name, one.castor) for one in found.effects} == {(one.name, one.castor) for one in effects}
    assert found.found.effects == found.effects


def test_a_motion_that_does_not_show_it_cannot_bear_it_out():
    """Counts are lost above 5 rad/s; the held-out log stands still."""
    effect = TickLoss(castor=1, wheel=2, value=0.02, above=5.0)
    log = driven(effect, 1)
    still = Log(log.t, np.zeros_like(log.wheel), np.tile(log.pivot[:1], (len(log), 1)), reference=log.reference * 0)
    found = diagnose(ROBOT, [log], [still])
    assert found.verdict == "unconfirmed"
    assert found.effects == ()


@pytest.mark.xfail(strict=True, reason="told as the castor's other wheel since creep stays within the friction circle")
def test_what_has_no_name_is_unexplained():
    """One wheel's encoder loses 60 counts at once."""
    log = driven(None, 1)
    wheel = log.wheel.copy()
    wheel[len(log) // 2 :, 3] -= 60
    found = diagnose(ROBOT, [dataclasses.replace(log, wheel=wheel)])
    assert found.verdict == "unexplained", found.reason
    assert "wheel_2r jumps" in found.reason


def test_sliding_in_one_place_is_no_effect_of_the_robot():
    """Friction of 0.03 on a patch of the floor: the wheels slide while they cross it."""
    floor = Floor(patches=(Patch(center=(0.0, 0.0), size=(0.5, 0.5), friction=0.02),))
    found = diagnose(ROBOT, [log_at_random(ROBOT, 1, floor=floor)])
    assert found.verdict == "unexplained", found.reason
    assert "look at the floor" in found.reason


def test_clean_logs_set_what_is_background():
    effect = WheelRadius(castor=2, wheel=1, value=0.004)
    blunt = diagnose(ROBOT, [driven(effect, 1)])
    found = diagnose(ROBOT, [driven(effect, 1)], clean=[driven(effect, 2)])
    assert found.ranks[0].gain < 0.25 * blunt.ranks[0].gain


def test_encoders_that_cannot_contradict_each_other_are_told():
    robot = preset("differential")
    with pytest.raises(InputError, match="give logs with ref_x"):
        diagnose(robot, [Log(np.arange(3.0), np.arange(6.0).reshape(3, 2), np.empty((3, 0)))])


def call(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, list(map(str, arguments)))
    out, err = capsys.readouterr()
    return ended.value.code, out, err


def test_the_command_writes_a_robot_that_drives_with_what_was_found(tmp_path, capsys):
    effect = PivotBacklash(castor=2, value=0.008)
    ROBOT.save(tmp_path / "robot.json")
    write_log(tmp_path / "log.csv", driven(effect, 1), ROBOT)
    out = tmp_path / "found"
    code, text, err = call(capsys, tmp_path / "log.csv", "--out", out, "--json", "--finder", "selection")
    assert code == 0, err
    data = json.loads(text)
    assert data == json.loads((out / "diagnosis.json").read_text())
    assert (data["format"], data["verdict"]) == ("castor-diagnosis/1", "named")
    robot = RobotDescription.load(out / "robot.json")
    assert (robot.effects[0].name, robot.effects[0].castor) == ("pivot_backlash", 2)
    env = gym.make("castor_envs:castor/ASOC-v0", robot=str(out / "robot.json"))
    env.reset(seed=0)
    env.step(np.full(6, 0.2, dtype=np.float32))
    env.close()
    code, _, err = call(capsys, "find", tmp_path / "log.csv", "--out", out)
    assert code == 2
    assert "is there already" in err


def test_options_take_several_logs(tmp_path, capsys):
    ROBOT.save(tmp_path / "robot.json")
    log = driven(None, 1)
    short = Log(log.t[:200], log.wheel[:200], log.pivot[:200], reference=log.reference[:200])
    for name in ("a", "b", "c"):
        write_log(tmp_path / f"{name}.csv", short, ROBOT)
    a, b, c = (tmp_path / f"{name}.csv" for name in ("a", "b", "c"))
    code, text, err = call(capsys, a, "--holdout", b, c, "--json")
    assert code == 0, err
    assert json.loads(text)["logs"] == [str(a)]
    code, _, err = call(capsys, a, "--holdout", b, tmp_path / "d.csv")
    assert code == 2
    assert "d.csv: cannot be read" in err


def test_what_an_effect_costs_is_what_odometry_is_off():
    """A straight drive with all wheels 1 % too large: 10 cm in 10 m; nothing for a clean one."""
    t = np.linspace(0, 20, 401)
    counts = np.tile((t * 0.5 / ROBOT.wheels[0].radius * ROBOT.wheels[0].counts_per_rev / (2 * np.pi))[:, None], (1, 6))
    log = Log(t, counts, np.zeros((401, 3)))
    assert cost_of(ROBOT, AllWheelRadius(value=0.01), [log]) == pytest.approx(0.1, rel=1e-3)
    assert cost_of(ROBOT, AllWheelRadius(value=0.0), [log]) == 0.0
    assert cost_of(ROBOT, AllWheelRadius(value=0.01), [Log(t, counts * 0, np.zeros((401, 3)))]) is None


def test_the_drive_that_separates_is_one_that_does():
    """Straight on, a wheel's radius looks like the other castors' in the opposite; turns tell them apart."""
    candidates = {one.what: one for one in candidates_of(ROBOT)}
    pair = [
        (candidates["wheel radius, castor 1, wheel 1"], np.array([0.003])),
        (candidates["track (distance between the wheels), castor 1"], np.array([0.01])),
    ]
    told = separating_drive(ROBOT, pair, "all")
    assert told is not None
    same = [pair[0], (dataclasses.replace(pair[0][0]), np.array([0.003]))]
    assert separating_drive(ROBOT, same, "all") is None


def test_people_read_verdict_value_and_what_to_check(tmp_path, capsys):
    ROBOT.save(tmp_path / "robot.json")
    write_log(tmp_path / "log.csv", driven(EncoderLatency(castor=3, value=0.004), 1), ROBOT)
    code, text, err = call(capsys, "find", tmp_path / "log.csv", "--finder", "selection")
    assert code == 0, err
    assert "named" in text
    assert "latency of one encoder, castor 3" in text
    assert "to check: " in text
    assert "odometry differs from the reference" in text


def test_a_measured_base_that_was_told_too_large_is_named():
    root = Path(os.environ.get("CASTOR_DATA", ""))
    if not os.environ.get("CASTOR_DATA") or not (root / "optiodom").is_dir():
        pytest.skip("the measured data are absent: CASTOR_DATA names no folder that holds optiodom/")
    session = read_session(find_sessions(root)["230620202144"])
    found = diagnose(session.robot, [session.runs[k] for k in (0, 2, 3, 5)], [session.runs[k] for k in (1, 4)])
    assert found.verdict == "named", found.reason
    assert found.effects[0].name == "track"
    assert 0.205 * (1 + found.effects[0].value) == pytest.approx(0.2013, abs=0.001)
    before, after = found.held_out
    assert after.position < before.position / 2
