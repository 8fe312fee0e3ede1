"""A gyro against the wheels: what was put in of scale, bias, sign and unit comes out."""

import dataclasses

import numpy as np
import pytest

from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro
from discrepancy.inspect import inspect_log
from estimators.likelihood.measurements.gyro_check import gyro_against_wheels
from estimators.plugins.drives import straight, winding

ROBOT = dataclasses.replace(preset("differential"), gyro=Gyro())


def log_of(drive):
    wheel = np.cumsum([observation["wheel"] for observation in drive.observations], axis=0)
    read = np.array([[observation["time"][0], observation["gyro"][0]] for observation in drive.observations])
    return Log(t=read[:, 0], wheel=wheel, pivot=np.empty((len(read), 0)), gyro=read[:, 1])


@pytest.fixture(scope="module")
def driven():
    return log_of(winding(ROBOT))


@pytest.mark.parametrize(
    ("scale", "bias", "words"),
    [
        (1.0, 0.0, "agrees with the wheels"),
        (1.0, 0.3, "agrees with the wheels"),
        (-1.0, 0.02, "change its sign"),
        (180 / np.pi, 0.5, "is in deg/s: give rad/s"),
        (np.pi / 180, 1e-3, "was in rad/s and is multiplied by pi/180"),
        (1.2, 0.0, "turns 1.2 times as much"),
    ],
)
def test_scale_and_bias_are_found(driven, scale, bias, words):
    assert driven.gyro is not None
    log = dataclasses.replace(driven, gyro=scale * driven.gyro + bias)
    found = gyro_against_wheels(ROBOT, log)
    assert found is not None
    assert found.scale == pytest.approx(scale, rel=0.02)
    assert found.bias == pytest.approx(bias, abs=0.01 * abs(scale))
    assert words in found.verdict
    assert inspect_log(ROBOT, log)["gyro"]["verdict"] == found.verdict


@pytest.mark.parametrize(
    ("scale", "words"), [(1.0, "agrees with the wheels"), (180 / np.pi, "is in deg/s: give rad/s")]
)
def test_on_a_circle_a_bias_is_not_told_from_a_scale(driven, scale, words):
    """Wheels of one speed each, whose counts are rounded, and a gyro with noise, of the bias that its file says."""
    left, right = ROBOT.wheels
    assert left.counts_per_rev is not None
    wheel = np.outer(driven.t, [3000.0, 4000.0])
    rate = 2 * np.pi / left.counts_per_rev * left.radius * 1000.0 / (left.lateral - right.lateral)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(driven))
    robot = dataclasses.replace(ROBOT, gyro=Gyro(bias=0.02))
    log = dataclasses.replace(driven, wheel=wheel.round(), gyro=scale * (rate + noise) + 0.02)
    found = gyro_against_wheels(robot, log)
    assert found is not None
    assert found.verdict == words
    assert (found.scale, found.bias) == (pytest.approx(scale, rel=0.01), 0.02)


def test_another_axis_does_not_follow_the_wheels(driven):
    log = dataclasses.replace(driven, gyro=np.random.default_rng(1).standard_normal(len(driven)))
    found = gyro_against_wheels(ROBOT, log)
    assert found is not None
    assert "does not follow the wheels" in found.verdict


def test_nothing_is_said_without_a_gyro_or_without_turning(driven):
    assert gyro_against_wheels(ROBOT, dataclasses.replace(driven, gyro=None)) is None
    assert gyro_against_wheels(ROBOT, log_of(straight(ROBOT))) is None
    assert inspect_log(ROBOT, dataclasses.replace(driven, gyro=None))["gyro"] is None


def test_readings_that_are_missing_say_nothing(driven):
    """Of a gyro with the bias that the file states, in half of the drive and beside a single sample."""
    robot = dataclasses.replace(ROBOT, gyro=Gyro(bias=0.05))
    missing = (np.arange(len(driven)) % 2 == 0) & (driven.t < 3.0) | (driven.t > 9.0)
    log = dataclasses.replace(driven, gyro=np.where(missing, np.nan, driven.gyro + 0.05))
    found = gyro_against_wheels(robot, log)
    assert found is not None
    assert found.scale == pytest.approx(1.0, rel=0.02)
    assert found.bias == pytest.approx(0.05, abs=0.01)
    assert found.verdict == "agrees with the wheels"
