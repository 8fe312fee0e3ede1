"""Slippery patches of the floor: found where wheels slip, compared by replays, confirmed by logs that come there."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.dimensions import CountsPerRev, WheelRadius
from castor_envs.effects.floor import FrictionPatch
from castor_envs.geometry.steps import Motion
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.physics.contact_motion import ContactMotion
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.patches import patches_of
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.variances.events import Events
from discrepancy.posterior.variances.slippery import _Spread, confirmed_by, inside, slippery_in
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import EXACT, as_recorded

pytestmark = pytest.mark.slow

ROBOT = preset("asoc-prototype")
PATCH = FrictionPatch(x=-0.4, y=-0.6, length=0.5, width=0.5, angle=0.3, value=0.94)


@cache
def driven(effect, seed):
    """A log of a minute of the base with an effect, driven at random in physics."""
    robot = ROBOT if effect is None else ROBOT.with_effects(effect)
    return drive(robot, wander(np.random.default_rng([seed, 1]), duration=60.0), seed, duration=60.0)


@cache
def seen(effect, seed):
    return linearise(ROBOT, [driven(effect, seed)], among=())


@cache
def found():
    """The patch found in a log of it."""
    return slippery_in(ROBOT, [driven(PATCH, 7)], seen(PATCH, 7), 200)


@cache
def rolled():
    """A minute of perfect rolling at random."""
    run = roll(ROBOT, wander(np.random.default_rng([5, 1]), duration=60.0), [0.3, 2.0, -1.5])
    return Motion(run.t, run.pose, run.wheel_angle, run.castor_angle)


def overlap(one, other):
    """The common area of two patches as a part of what both cover together, on a fine grid."""
    x, y = np.meshgrid(np.arange(-2.0, 2.0, 0.01), np.arange(-2.0, 2.0, 0.01))

    def covered(patch):
        c, s = math.cos(patch.angle), math.sin(patch.angle)
        right, up = x + other.x - patch.x, y + other.y - patch.y
        along, across = np.abs(c * right + s * up), np.abs(c * up - s * right)
        return (along <= patch.length / 2) & (across <= patch.width / 2)

    a, b = covered(one), covered(other)
    return (a & b).sum() / (a | b).sum()


def test_the_rectangle_in_which_wheels_slip_is_found():
    patch = dataclasses.replace(PATCH, x=0.2, y=0.1)
    there = patch.inside(ContactMotion(ROBOT, rolled()))
    assert there.any()
    slip = np.random.default_rng(1).normal(size=there.shape) * np.where(there, 1e-3, 5e-5)
    assert overlap(patches_of(ROBOT, [rolled()], [slip])[0], patch) > 0.7
    assert patches_of(ROBOT, [rolled()], [np.full_like(slip, np.nan)]) == []


def drawn(windows, missing):
    """Errors (3, windows) of a multivariate t distribution of scales 1, 2 and 3 and 4 degrees of freedom, the last
    unknown in a part of the windows."""
    random = np.random.default_rng(2)
    errors = random.normal(size=(3, windows)) / np.sqrt(random.chisquare(4, windows) / 4) * [[1.0], [2.0], [3.0]]
    errors[2, random.uniform(size=windows) < missing] = np.nan
    return errors


@pytest.mark.parametrize("missing", [0.0, 0.7])
def test_the_spread_of_replays_is_that_of_their_errors_where_some_are_unknown(missing):
    spread = _Spread.of(drawn(20_000, missing))
    assert spread.scales == pytest.approx([1.0, 2.0, 3.0], rel=0.03)
    assert spread.freedom == pytest.approx(4.0, rel=0.06)


def test_a_kind_of_error_that_a_robot_does_not_have_counts_for_nothing():
    errors = drawn(400, 1.0)
    spread, without = _Spread.of(errors), _Spread.of(errors[:2])
    assert spread.scales[:2] == pytest.approx(without.scales, rel=1e-6)
    better = errors * np.linspace(0.8, 1.0, 400)
    gain = without.likelier(better[:2], errors[:2])
    assert spread.likelier(better, errors) == pytest.approx(gain, rel=1e-6)
    assert gain > 0


def test_a_patch_is_named_and_logs_that_reach_it_confirm_it():
    patch = found()
    assert patch is not None
    assert overlap(patch.effect, PATCH) > 0.3
    assert abs(patch.effect.value - PATCH.value) < 2 * patch.error
    assert confirmed_by(ROBOT, [driven(PATCH, 8)], seen(PATCH, 8), patch) > math.log(19)
    assert confirmed_by(ROBOT, [driven(None, 3)], seen(None, 3), patch) < 0


def test_an_even_floor_has_none_nor_have_logs_without_reference():
    assert slippery_in(ROBOT, [driven(None, 3)], seen(None, 3), 1) is None
    blind = dataclasses.replace(driven(PATCH, 7), reference=None)
    assert slippery_in(ROBOT, [blind], linearise(ROBOT, [blind], among=()), 1) is None


def test_castors_that_swing_round_as_the_base_drives_to_and_fro_are_no_patch():
    """Which way they swing depends on less than a count, so that replays are lost there by chance."""
    log = drive(ROBOT, motion(ROBOT, "to and fro", 71, 60.0), 71, duration=60.0)
    assert slippery_in(ROBOT, [log], linearise(ROBOT, [log], among=()), 1) is None


def test_where_wheels_fight_a_floor_that_seems_less_rough_everywhere_is_no_patch():
    """A wheel whose encoder gives 2.5 % fewer counts is taken for one that is larger, as counts show no difference.
    Replays do: they are likelier with less friction where the robot mostly is, and likelier still with less
    everywhere."""
    robot = preset("3-castor")
    real = robot.with_effects(CountsPerRev(castor=3, wheel=1, value=-0.024856358857834104))
    seed = 2 * (10_000 * 71001 + 35)
    exact = drive(real, motion(robot, "wander", seed, 40.0), seed, duration=40.0, rounded=False, noise=EXACT)
    log = as_recorded(real, exact, np.random.default_rng([seed, 4]))
    found = robot.with_effects(WheelRadius(castor=3, wheel=1, value=0.02549))
    assert slippery_in(found, [log], linearise(found, [log], among=()), 60) is None


def test_steps_of_wheels_on_a_patch_and_of_their_castors_are_released():
    patch = found()
    assert patch is not None
    (steps,) = Events(patch=patch).released(ROBOT, [driven(PATCH, 7)], seen(PATCH, 7))
    (there,) = inside(ROBOT, [driven(PATCH, 7)], seen(PATCH, 7), patch)
    np.testing.assert_array_equal(steps, there)
    wheels = len(ROBOT.wheels)
    np.testing.assert_array_equal(steps[:, wheels], steps[:, :2].any(axis=1))
    assert 0.01 < steps[:, :wheels].mean() < 0.5
