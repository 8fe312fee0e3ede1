"""Robots that an algorithm cannot serve are refused, in one line that says why."""

import dataclasses
from typing import Any, cast

import numpy as np
import pytest

from castor_envs.errors import Declined, InputError
from castor_envs.vehicles.presets import differential, n_castor, omnimate, preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from estimators import CAST, IPEC, CASTArc, DeadReckoning, Estimator


def with_castor_two(**changes):
    robot = n_castor(3)
    castors = list(robot.castors)
    castors[1] = dataclasses.replace(castors[1], **changes)
    return dataclasses.replace(robot, castors=tuple(castors))


def wheel(lateral, **fields):
    return Wheel(lateral=lateral, radius=0.04, **fields)


NO_ENCODER = with_castor_two(pivot_counts_per_rev=None)
ONE_WHEEL = with_castor_two(wheels=(wheel(0.0),))
IDLE = with_castor_two(wheels=(wheel(0.1), wheel(-0.1, counts_per_rev=None)))
THREE = with_castor_two(wheels=(wheel(0.1), wheel(0.0), wheel(-0.1)))
OMNI = with_castor_two(wheels=(wheel(0.1, grip="omni"), wheel(-0.1, grip="omni")))
ONE_PLACE = dataclasses.replace(omnimate(), castors=(omnimate().castors[0],) * 2)


@pytest.mark.parametrize(
    ("estimator", "robot", "message"),
    [
        (CAST(), NO_ENCODER, "needs a pivot encoder on castor 2"),
        (CAST(), ONE_WHEEL, "needs two driven wheels on castor 2; there is 1"),
        (CASTArc(), IDLE, "needs two driven wheels on castor 2; there is 1"),
        (IPEC(1), THREE, "needs two driven wheels on castor 2; there are 3"),
        (CAST(3), OMNI, "grip 'standard' on castor 2"),
        (DeadReckoning(2), NO_ENCODER, "needs a pivot encoder on castor 2"),
        (DeadReckoning(4), n_castor(3), "there is no castor 4; the robot has 3"),
        (DeadReckoning(0), n_castor(3), "there is no castor 0"),
        (DeadReckoning(), preset("tricycle"), "needs two driven wheels on castor 1"),
        (CAST(), differential(), "needs at least two castors; the robot has 1"),
        (CAST(1), n_castor(2), "needs at least two castors; the robot without castor 1 has 1"),
        (CAST(4), n_castor(3), "there is no castor 4 to leave out; the robot has 3"),
        (CAST(-1), n_castor(3), "there is no castor -1 to leave out"),
        (IPEC(), n_castor(3), "uses two castors, and 3 are given: leave out one"),
        (IPEC(1), n_castor(4), "uses two castors, and 3 are given"),
        (IPEC(), ONE_PLACE, "pivots stand apart"),
        (CASTArc(), ONE_PLACE, "pivots stand apart"),
    ],
)
def test_unsuitable_robot_is_declined(estimator, robot, message):
    with pytest.raises(Declined, match=message):
        estimator.reset(robot, np.zeros(3))


def test_an_unknown_step_is_a_mistake_and_no_refusal():
    with pytest.raises(InputError, match="unknown step 'runge'") as raised:
        CAST(step=cast(Any, "runge")).reset(n_castor(3), np.zeros(3))
    assert not isinstance(raised.value, Declined)


@pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")
@pytest.mark.parametrize("robot", [NO_ENCODER, ONE_WHEEL, IDLE, THREE, OMNI])
@pytest.mark.parametrize("estimator", [DeadReckoning(1), IPEC(2), CAST(2), CASTArc(2)])
def test_castors_left_out_need_not_suit(estimator, robot, drive):
    """What castor 2 is and reads does not matter to those that leave it out, though it shifts columns."""
    w, p = len(robot.driven_wheels), len(robot.pivot_encoders)
    names = [robot.wheel_names[k] for k in robot.driven_wheels]
    wheel = np.array([7.0 if name in ("1l", "3l") else 4.0 if name in ("1r", "3r") else 1e3 for name in names])
    start = {"wheel": np.zeros(w), "pivot": np.where(np.array(robot.pivot_encoders) == 1, 9.0, 100.0)}
    path = drive(estimator, robot, [start, {**start, "wheel": wheel}])
    plain = n_castor(3)
    seen = {"wheel": np.zeros(6), "pivot": np.full(3, 100.0)}
    expected = drive(estimator, plain, [seen, {**seen, "wheel": np.array([7.0, 4.0, 0.0, 0.0, 7.0, 4.0])}])
    assert p in (2, 3)
    np.testing.assert_array_equal(path, expected)


def test_fixed_castors_take_part_without_an_encoder(drive):
    """A fixed castor's angle is known. It rolls straight, a free castor beside it too: the body goes straight."""
    wheels = tuple(Wheel(lateral=side, radius=0.05, counts_per_rev=1000.0) for side in (0.1, -0.1))
    fixed = Castor(pivot=(0.3, 0.0), steering="fixed", angle=0.5, wheels=wheels)
    free = Castor(pivot=(-0.3, 0.0), offset=0.05, pivot_counts_per_rev=1000, pivot_zero=-0.5, wheels=wheels)
    robot = RobotDescription(name="fixed and free", castors=(fixed, free))
    seen = {"wheel": np.zeros(4), "pivot": np.zeros(1)}
    ahead = np.pi * 0.1 / 10 * np.exp(0.5j)
    for estimator in (IPEC(), CAST(), CASTArc(), DeadReckoning(1), DeadReckoning(2)):
        path = drive(estimator, robot, [seen, {**seen, "wheel": np.full(4, 100.0)}])
        np.testing.assert_allclose(path[-1], [ahead.real, ahead.imag, 0.0], atol=1e-12)


@pytest.mark.parametrize("kind", [DeadReckoning, IPEC, CAST, CASTArc])
def test_builtins_are_estimators(kind):
    assert isinstance(kind(), Estimator)
    assert kind.batched is True


@pytest.mark.parametrize(
    ("wheels", "pivots", "message"),
    [
        (5, 3, "the observation has 5 counts of wheels and 3 of pivots; this robot gives 6 and 3"),
        (6, 2, "the observation has 6 counts of wheels and 2 of pivots; this robot gives 6 and 3"),
    ],
)
def test_observations_of_another_robot_are_refused(wheels, pivots, message):
    estimator = CAST()
    estimator.reset(n_castor(3), np.zeros(3))
    with pytest.raises(InputError, match=message):
        estimator.update({"wheel": np.zeros(wheels), "pivot": np.zeros(pivots), "time": np.zeros(1)})
