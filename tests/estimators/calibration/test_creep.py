"""Intervals of calibrated numbers where a controller that has other numbers drives wheels against each other.

The logs are of the physics, which knows nothing of the formulas that calibration predicts creep by.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.identifiability import COVERAGE
from estimators.calibration.likelihood_method import MaximumLikelihoodMethod
from estimators.calibration.maximum_likelihood import calibrate as maximum_likelihood
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.calibration.parameters import values_of
from estimators.calibration.protocol import Recording

WRONG = {
    31: WheelRadius(castor=1, wheel=1, value=0.02),
    32: PivotBias(castor=2, value=0.02),
    33: WheelRadius(castor=2, wheel=1, value=-0.02),
}
"""By the seed of the drive: what the description, and with it the controller, does not know."""


@cache
def driven(name, effect, seed, duration=40.0):
    robot = preset(name)
    motion = wander(np.random.default_rng([seed, 1]), duration=duration, holonomic=moves_sideways(robot))
    return drive(robot if effect is None else robot.with_effects(effect), motion, seed, duration=duration)


@cache
def calibrated(name, seed):
    return calibrate(preset(name), [driven(name, WRONG[seed], seed)])


def truth(name, effect, parameters):
    return values_of(Geometry.of(preset(name).with_effects(effect).as_built()), parameters)


def held(found, name, effect):
    """Which of the true values that the logs show are within their 95 % intervals."""
    seen = np.linalg.norm(found.unseen, axis=0) < 0.5
    away = np.abs(found.after - truth(name, effect, found.parameters))
    return (away <= COVERAGE * found.standard_errors)[seen]


def coverage(name, without_creep=False):
    shares = []
    for seed, effect in WRONG.items():
        log = driven(name, effect, seed)
        found = calibrated(name, seed) if not without_creep else calibrate_without_creep(preset(name), log)
        shares.append(held(found, name, effect))
    return float(np.mean(np.concatenate(shares)))


def calibrate_without_creep(robot, log):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(maximum_likelihood, "_with_creep", lambda *arguments: (*arguments[-3:], ""))
        return calibrate(robot, [log])


def test_true_values_are_within_their_intervals():
    """Without creep fewer than half are."""
    log = driven("asoc-prototype", WRONG[31], 31)
    found, without = calibrated("asoc-prototype", 31), calibrate_without_creep(preset("asoc-prototype"), log)
    assert held(found, "asoc-prototype", WRONG[31]).mean() > 0.9
    assert held(without, "asoc-prototype", WRONG[31]).mean() < 0.5
    assert found.creeps
    assert not without.creeps
    assert not found.creep_left_out


@pytest.mark.parametrize("error", [np.linalg.LinAlgError, ValueError])
def test_where_creep_cannot_be_fitted_it_is_left_out(monkeypatch, error):
    log, fitted = driven("asoc-prototype", WRONG[31], 31), maximum_likelihood.fitted

    def fails(*arguments, creep=None, **options):
        if creep is not None:
            raise error
        return fitted(*arguments, creep=creep, **options)

    monkeypatch.setattr(maximum_likelihood, "fitted", fails)
    found = calibrate(preset("asoc-prototype"), [log])
    assert not found.creeps
    assert found.creep_left_out
    assert found.after == pytest.approx(calibrate_without_creep(preset("asoc-prototype"), log).after, rel=1e-12)


COVERED = "asoc-prototype", "2-castor", "4-castor", "omnimate", "swerve", "powered-caster"


@pytest.mark.slow
@pytest.mark.parametrize("name", COVERED)
def test_intervals_hold_their_share_of_true_values(name):
    assert coverage(name) >= 0.93


def test_true_values_are_within_their_intervals_without_reference_poses():
    log = dataclasses.replace(driven("asoc-prototype", WRONG[31], 31), reference=None)
    found, without = calibrate(preset("asoc-prototype"), [log]), calibrate_without_creep(preset("asoc-prototype"), log)
    assert held(found, "asoc-prototype", WRONG[31]).mean() > 0.9
    assert held(without, "asoc-prototype", WRONG[31]).mean() < 0.8


def test_wheels_that_cannot_disagree_creep_under_forces_only():
    """Which these logs hardly show."""
    moved = []
    for seed in (31, 32, 33):
        log = driven("differential", None, seed)
        found, without = calibrate(preset("differential"), [log]), calibrate_without_creep(preset("differential"), log)
        assert found.creeps
        seen = without.standard_errors > 0
        moved.append((found.after - without.after)[seen] / without.standard_errors[seen])
        np.testing.assert_allclose(found.standard_errors, without.standard_errors, rtol=0.05)
    assert np.sqrt(np.mean(np.square(moved), axis=0)).max() < 0.2


def test_a_wheel_of_a_swerve_is_found_within_its_interval():
    """The controller's numbers are as good as a ruler: if their spread were fitted too, it could grow without bound."""
    found = calibrated("swerve", 31)
    (first,) = (k for k, p in enumerate(found.parameters) if (p.kind, p.castor) == ("radius", 0))
    assert abs(found.after[first] - 1.02 * found.before[first]) < COVERAGE * found.standard_errors[first]
    assert held(found, "swerve", WRONG[31]).all()


def test_a_robot_whose_loads_are_unknown_is_calibrated_without_creep_and_told_so():
    robot = dataclasses.replace(preset("asoc-prototype"), center_of_mass=(1.0, 0.0))  # it would tip over
    report = MaximumLikelihoodMethod().report(robot, [Recording(driven("asoc-prototype", None, 31, 20.0))])
    (remark,) = (remark for remark in report.remarks if "creep" in remark)
    assert "is left out" in remark
    assert "would lift" in remark


if __name__ == "__main__":  # the table in docs/benchmark.md
    for preset_name in COVERED:
        print(f"| {preset_name} | {coverage(preset_name, without_creep=True):.2f} | {coverage(preset_name):.2f} |")
