"""Cables on the floor, whose places are found in logs."""

# pyright: reportOptionalIterable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportOptionalOperand=false

import math
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.floor import Bump
from castor_envs.floor import cable_extra_roll
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.physics.contact_motion import ContactMotion
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.cables import _rolls_more, bumps_of, same_line
from discrepancy.hypotheses.wheel_tracks import steps_of
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.pymunk_generator import drive

pytestmark = pytest.mark.slow

ROBOT = preset("asoc-prototype")
CABLE = Bump(x=-0.3, y=-0.4, direction=0.7, value=0.004)


@cache
def driven(effect, seed, duration=30.0):
    """A log of the base with an effect, driven at random in physics."""
    robot = ROBOT if effect is None else ROBOT.with_effects(effect)
    return drive(robot, wander(np.random.default_rng([seed, 1]), duration=duration), seed, duration=duration)


@cache
def rolled():
    """A minute of perfect rolling at random."""
    run = roll(ROBOT, wander(np.random.default_rng([5, 1]), duration=60.0), [0.3, 2.0, -1.5])
    return Motion(run.t, run.pose, run.wheel_angle, run.castor_angle)


def noisy(slip, size=2e-5, seed=0):
    """Slips with independent errors."""
    return slip + size * np.random.default_rng(seed).normal(size=slip.shape)


def off(line, cable):
    """How far a line lies from a cable at the point by which it is given, m, and how it is turned, rad."""
    across = (line.y - cable.y) * math.cos(cable.direction) - (line.x - cable.x) * math.sin(cable.direction)
    return abs(across), abs((line.direction - cable.direction + math.pi / 2) % math.pi - math.pi / 2)


@pytest.mark.parametrize("diameter", [0.002, 0.008])
@pytest.mark.parametrize("direction", [0.3, 2.9])
def test_the_scan_finds_the_line_on_which_wheels_roll_more(direction, diameter):
    cable = Bump(x=0.2, y=0.1, direction=direction, value=diameter)
    slip = noisy(cable.slip(ContactMotion(ROBOT, rolled())).rolling)
    (found,) = (candidate.kinds[0] for candidate in bumps_of(ROBOT, [rolled()], [slip]))
    away, turned = off(found, cable)
    assert away < 0.005
    assert turned < math.radians(0.5)
    assert found.value == pytest.approx(diameter, rel=0.15)
    assert found.length == 100.0


def test_two_cables_are_two_candidates():
    cables = Bump(x=0.2, y=0.1, direction=0.3, value=0.004), Bump(x=-0.2, y=-0.3, direction=1.8, value=0.004)
    slip = noisy(sum(cable.slip(ContactMotion(ROBOT, rolled())).rolling for cable in cables))
    found = [candidate.kinds[0] for candidate in bumps_of(ROBOT, [rolled()], [slip])]
    assert len(found) == 2
    assert all(any(same_line(line, cable) for line in found) for cable in cables)


def test_a_squarely_crossed_cable_costs_its_closed_form():
    """The shape that lines are refined with, over whole crossings of all six wheels."""
    t, way = np.arange(121) * 0.05, np.linspace(-0.5, 0.7, 121)
    pose = np.column_stack([way, 0 * way, 0 * way])
    castor, wheel = np.zeros((121, 3)), np.tile(way[:, None] / 0.0381, 6)
    motion = Motion(t, pose, wheel, castor)
    steps = steps_of(ROBOT, [motion], [np.zeros((120, 6))])
    for diameter in (0.002, 0.008):
        excess = _rolls_more(steps, 0.05, 0.0, math.pi / 2, diameter)
        by_wheel = np.bincount(steps.track, excess)
        np.testing.assert_allclose(by_wheel, cable_extra_roll(0.0381, diameter), rtol=0.03)


def test_jumps_of_single_channels_are_no_line():
    random = np.random.default_rng(3)
    slip = noisy(np.zeros((len(rolled().t) - 1, 6)))
    slip[random.integers(len(slip), size=12), random.integers(6, size=12)] -= 2e-3
    assert bumps_of(ROBOT, [rolled()], [slip]) == []


def test_unknown_steps_do_not_count():
    slip = noisy(CABLE.slip(ContactMotion(ROBOT, rolled())).rolling)
    shape = CABLE.slip(ContactMotion(ROBOT, rolled())).rolling
    assert bumps_of(ROBOT, [rolled()], [slip]) != []
    assert bumps_of(ROBOT, [rolled()], [np.where(shape != 0, np.nan, slip)]) == []
    assert bumps_of(ROBOT, [rolled()], [np.full_like(slip, np.nan)]) == []


def test_logs_of_an_even_floor_show_no_line():
    assert not [candidate for candidate in linearise(ROBOT, [driven(None, 1, 60.0)]).candidates if candidate.at_a_place]


def test_logs_without_reference_poses_show_no_place():
    log = driven(CABLE, 1)
    lines = [candidate.kinds[0] for candidate in linearise(ROBOT, [log]).candidates if candidate.at_a_place]
    assert any(same_line(line, CABLE) for line in lines)
    blind = Log(log.t, log.wheel, log.pivot, log.command)
    assert not [candidate for candidate in linearise(ROBOT, [blind]).candidates if candidate.at_a_place]


def test_a_cable_is_named_with_its_place():
    found = diagnose(ROBOT, [driven(CABLE, 1)])
    (answer,) = (answer for answer in found.answers if answer.verdict == "named")
    cable = answer.effect
    assert isinstance(cable, Bump)
    away, turned = off(cable, CABLE)
    assert away < 0.03
    assert turned < math.radians(3.0)
    assert cable.value == pytest.approx(CABLE.value, rel=0.1)
    assert f"x {cable.x:.2f}, y {cable.y:.2f} m" in answer.candidate.what
