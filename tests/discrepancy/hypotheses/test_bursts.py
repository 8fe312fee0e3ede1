"""Counts lost in bursts: taken off by hand from a robot that rolls perfectly, and found with wheel, part and times."""

from functools import cache

import numpy as np
import pytest

from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.bursts import losing

ROBOT = preset("asoc-prototype")


@cache
def rolled():
    """Times, angles of wheels and of castors of a minute of perfect rolling."""
    run = roll(ROBOT, wander(np.random.default_rng([5, 1]), duration=60.0), [0.3, 2.0, -1.5])
    return run.t, run.wheel_angle, run.castor_angle


def read(turned):
    """The log of encoders on wheels that turned so far (K, w)."""
    t, _, castors = rolled()
    encoders = Encoders(Geometry.of(ROBOT), np.full(6, 0.4))
    return Log(t, encoders.wheel(turned), encoders.pivot(castors))


def less(wheel, part):
    """Angles of the wheels, one of which loses a part (K - 1,) of what it turns in every step."""
    _, turned, _ = rolled()
    steps = np.diff(turned, axis=0)
    steps[:, wheel] *= 1 - part
    return turned[0] + np.pad(np.cumsum(steps, axis=0), ((1, 0), (0, 0)))


def when(starts, width):
    """Which steps lie between each start and a time later."""
    middle = (rolled()[0][1:] + rolled()[0][:-1]) / 2
    return np.any([(middle > start) & (middle < start + width) for start in starts], axis=0)


@pytest.mark.parametrize(("wheel", "part"), [(0, 0.2), (3, 0.2), (4, 1.0)])
def test_a_steady_beat_is_found_with_its_wheel_part_and_times(wheel, part):
    found = losing(ROBOT, [read(less(wheel, part * when(np.arange(1.0, 60.0, 4.0), 0.4)))])
    assert found is not None
    assert found.steady
    effect = found.effect
    assert (effect.castor, effect.wheel) == (wheel // 2 + 1, wheel % 2 + 1)
    assert effect.value == pytest.approx(part, rel=0.05)
    assert abs(effect.value - part) <= 4 * found.error
    assert (effect.period, effect.width, effect.start) == (
        pytest.approx(4.0, abs=0.05),
        pytest.approx(0.4, abs=0.06),
        pytest.approx(1.0, abs=0.15),
    )
    assert effect.seed is None


def test_bursts_at_random_are_found_without_a_beat():
    starts = np.cumsum(np.random.default_rng(2).uniform(0.5, 8.0, size=14))
    found = losing(ROBOT, [read(less(5, 0.1 * when(starts, 0.5)))])
    assert found is not None
    assert not found.steady
    assert found.effect.seed is not None
    assert (found.effect.castor, found.effect.wheel) == (3, 2)
    assert found.effect.value == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("kind", ["nothing", "always", "fast", "up and down"])
def test_what_else_wheels_lose_is_no_burst(kind):
    """All the time, whenever it is fast, or as many counts too much as too few: these are others' business."""
    _, turned, _ = rolled()
    speed = np.abs(np.diff(turned[:, 2]) / np.diff(rolled()[0]))
    part = {
        "nothing": 0 * speed,
        "always": 0.01 + 0 * speed,
        "fast": 0.1 * (speed > 0.6 * speed.max()),
        "up and down": 0.2 * (when(np.arange(1.0, 60.0, 8.0), 0.4) * 1.0 - when(np.arange(5.0, 60.0, 8.0), 0.4)),
    }[kind]
    assert losing(ROBOT, [read(less(2, part))]) is None


def test_encoders_that_cannot_contradict_each_other_tell_nothing():
    t, turned, _ = rolled()
    log = Log(t, np.round(600 * turned[:, :2]), np.zeros((len(t), 0)))
    assert losing(preset("differential"), [log]) is None


@pytest.mark.parametrize(("starts", "there"), [((5.0, 20.0, 40.0), True), ((5.0, 20.0), False)])
def test_three_bursts_are_enough_where_every_step_loses_the_same_part(starts, there):
    found = losing(ROBOT, [read(less(3, 0.3 * when(starts, 0.6)))])
    assert (found is not None) == there
    if found is not None:
        assert found.effect.value == pytest.approx(0.3, rel=0.05)


def test_three_bursts_that_lose_different_parts_are_not():
    part = 0.15 * when((5.0,), 0.6) + 0.3 * when((20.0,), 0.6) + 0.6 * when((40.0,), 0.6)
    assert losing(ROBOT, [read(less(3, part))]) is None
