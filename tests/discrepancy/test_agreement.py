"""`calibrate` and `diagnose` do not contradict each other on the same log."""

import numpy as np
import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset, preset_names
from discrepancy.posterior.finder import diagnose
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.identifiability import COVERAGE
from estimators.calibration.maximum_likelihood.calibrate import calibrate

QUICK = "2-castor"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == QUICK else pytest.mark.slow) for name in preset_names()]
)
def test_a_wheel_is_as_large_by_calibration_as_by_diagnosis(name):
    robot, radius = preset(name), WheelRadius(castor=1, wheel=1, value=0.01)
    motion = wander(np.random.default_rng([41, 1]), duration=15.0, holonomic=moves_sideways(robot))
    log = drive(robot.with_effects(radius), motion, 41, duration=15.0)
    found = calibrate(robot, [log])
    at = next(k for k, p in enumerate(found.parameters) if p.kind == "radius" and p.castor == 0)
    by_calibration = found.after[at] / found.before[at] - 1
    (answer,) = (
        answer
        for answer in diagnose(robot, [log]).answers
        if answer.verdict == "named" and isinstance(answer.effect, WheelRadius)
    )
    assert answer.effect is not None
    assert answer.effect == WheelRadius(castor=1, wheel=1, value=answer.effect.value)
    apart = abs(by_calibration - answer.effect.value)
    errors = found.standard_errors[at] / found.before[at], np.sqrt(answer.covariance[0, 0])
    assert apart < COVERAGE * np.hypot(*errors)
