"""A gyro in the diagnosis of a robot whose encoders cannot contradict each other."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.dimensions import Track, WheelRadius
from castor_envs.effects.reference import GyroScale
from castor_envs.errors import InputError
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro
from discrepancy.posterior.finder import diagnose
from discrepancy.preflight import preflight
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.identifiability import COVERAGE
from estimators.calibration.maximum_likelihood.calibrate import calibrate

NOISE, DURATION = 5e-4, 20.0
ROBOT = dataclasses.replace(preset("differential"), gyro=Gyro(noise=NOISE))


def driven(*effects, reference=False, seed=43):
    """Return a log of the robot with effects, and a gyro of an unknown bias."""
    true = dataclasses.replace(ROBOT, gyro=Gyro(noise=NOISE, bias=0.01)).with_effects(*effects)
    motion = wander(np.random.default_rng([seed, 1]), duration=DURATION, holonomic=False)
    log = drive(true, motion, seed, duration=DURATION)
    return log if reference else dataclasses.replace(log, reference=None)


def test_without_a_reference_a_gyro_tells_a_track_that_is_too_wide():
    """Radius of both wheels, track and gyro's scale change the turn alike: the answer holds all three, and no more."""
    log = driven(Track(castor=1, value=0.02))
    (answer,) = (answer for answer in diagnose(ROBOT, [log]).answers if answer.verdict in ("named", "ambiguous"))
    assert set(answer.probabilities) - {"nothing"} == {"track 1", "all_wheel_radius", "gyro_scale"}
    assert sum(answer.probabilities.values()) > 0.95
    with pytest.raises(InputError, match="nothing is observable without reference poses"):
        diagnose(ROBOT, [dataclasses.replace(log, gyro=None)])


def test_with_a_reference_the_gyros_scale_is_named_and_the_robot_is_right():
    log = driven(GyroScale(value=0.02), reference=True)
    (answer,) = diagnose(ROBOT, [log]).answers
    assert answer.verdict == "named"
    assert isinstance(answer.effect, GyroScale)
    assert abs(answer.effect.value - 0.02) < COVERAGE * np.sqrt(answer.covariance[0, 0])


def test_calibration_and_diagnosis_agree_with_a_gyro():
    log = driven(WheelRadius(castor=1, wheel=1, value=0.01), reference=True)
    found = calibrate(ROBOT, [log])
    at = next(k for k, p in enumerate(found.parameters) if p.kind == "radius" and p.wheel == 0)
    by_calibration, error = (part[at] / found.before[at] for part in (found.after, found.standard_errors))
    (answer,) = (answer for answer in diagnose(ROBOT, [log]).answers if answer.verdict == "named")
    assert isinstance(answer.effect, WheelRadius)
    apart = abs(by_calibration - 1 - answer.effect.value)
    assert apart < COVERAGE * np.hypot(error, np.sqrt(answer.covariance[0, 0]))


@pytest.mark.parametrize(("factor", "what"), [(-1.0, "change its sign"), (np.degrees(1.0), "give rad/s")])
def test_a_wrong_sign_or_unit_is_a_gross_mistake(factor, what):
    log = driven()
    checked = preflight(ROBOT, [log, dataclasses.replace(log, gyro=factor * log.gyro)])
    (mistake,) = checked.mistakes
    assert mistake.what.startswith("log 2: gyro_z ")
    assert what in mistake.what
    assert checked.fatal
    assert not preflight(ROBOT, [log]).mistakes
