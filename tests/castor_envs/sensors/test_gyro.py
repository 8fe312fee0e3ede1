"""What a gyro reads: laws of its noise, bias and scale."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.reference import GyroScale
from castor_envs.sensors.gyro import GyroSensor
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro

T = np.arange(4001) * np.float64(0.05)


def readings(rate, *effects, **gyro):
    robot = dataclasses.replace(preset("differential"), gyro=Gyro(**gyro)).with_effects(*effects)
    sensor = GyroSensor.of(robot, np.random.default_rng(3))
    assert sensor is not None
    return sensor.readings(T, rate)


def test_an_ideal_gyro_reads_the_rate():
    rate = np.sin(T)
    assert np.array_equal(readings(rate), rate)
    assert GyroSensor.of(preset("differential"), np.random.default_rng(0)) is None


def test_its_scale_multiplies_the_rate_and_not_the_bias():
    rate = np.sin(T)
    assert readings(rate, GyroScale(value=0.1), bias=0.3) == pytest.approx(1.1 * rate + 0.3)


def test_its_bias_walks_by_the_root_of_the_time():
    walked = readings(0 * T, bias=0.2, bias_walk=0.01) - 0.2
    assert walked[0] == 0
    for steps in (1, 16):
        expected = 0.01 * np.sqrt(0.05 * steps)
        assert np.std(walked[::steps][1:] - walked[::steps][:-1]) == pytest.approx(expected, rel=0.2)
