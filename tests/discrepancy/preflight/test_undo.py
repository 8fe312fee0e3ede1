"""Wrong wiring undone in logs: that which the robot file knows of, and that which the pre-flight finds."""

from functools import cache

import numpy as np
import pytest

from castor_envs.effects.catalogue import readings
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import PivotGain
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.preflight.undo import Undone

ROBOT = preset("asoc-prototype")
SWAPPED, REVERSED, ORDER = EncodersSwapped(castor=2), EncoderReversed(castor=1), CastorOrder(castor=1, exchanged_with=3)
RADIUS = WheelRadius(castor=3, wheel=1, value=0.01)


@cache
def logged(*effects):
    """The log of a robot that was moved by hand, as encoders with effects read it."""
    rolled, encoders = roll(ROBOT, wander(np.random.default_rng(7), duration=12.0)), Encoders(Geometry.of(ROBOT), 0.4)
    wheel, pivot = readings(ROBOT.with_effects(*effects), rolled.t, rolled.wheel_angle, rolled.castor_angle)
    return Log(rolled.t, encoders.wheel(wheel), encoders.pivot(pivot), reference=rolled.pose)


def test_wiring_that_the_robot_file_knows_of_is_no_mistake():
    described = ROBOT.with_effects(SWAPPED, RADIUS)
    undone = Undone(described, {"log": logged(SWAPPED)}, {"held out": logged(SWAPPED)}, {"clean": logged(SWAPPED)})
    assert undone.checked.mistakes == ()
    assert undone.found([]) is None
    for logs in (undone.logs, undone.held_out, undone.clean):
        (log,) = logs.values()
        np.testing.assert_allclose(log.wheel, logged().wheel, atol=1.0)
    assert undone.robot.effects == undone.good.effects == (RADIUS,)


@pytest.mark.parametrize("more", [REVERSED, ORDER])
def test_wiring_beside_that_of_the_robot_file_is_found_and_written_once(more):
    undone = Undone(ROBOT.with_effects(SWAPPED, RADIUS), {"log": logged(more, SWAPPED)}, {}, {})
    (mistake,) = undone.checked.mistakes
    assert mistake.effects == (more,)
    np.testing.assert_allclose(undone.logs["log"].wheel, logged().wheel, atol=1.0)
    named = PivotGain(castor=1, value=0.01)
    written = undone.found([named])
    assert written is not None
    assert written.effects == (RADIUS, named, more, SWAPPED)
    again = Undone(written, {"log": logged(more, SWAPPED)}, {}, {})
    assert again.checked.mistakes == ()
    np.testing.assert_array_equal(again.logs["log"].pivot, undone.logs["log"].pivot)
