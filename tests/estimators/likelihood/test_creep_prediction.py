"""What creep masks of effects: against physics in which the controller does not know of them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from castor_envs.effects.dimensions import PivotBias, PivotOffset, WheelRadius
from castor_envs.effects.encoders import PivotBacklash
from castor_envs.effects.wiring import CastorOrder
from castor_envs.geometry.se2 import relative_pose
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.model.refit import Sized, refitted
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import Noise
from estimators.likelihood.creep_prediction import LEAST_NOISE, Slipping
from estimators.likelihood.log_likelihood import LogLikelihood

RADIUS = WheelRadius(castor=3, wheel=2, value=-0.1)
STEERED = PivotBias(castor=1, value=0.1)
PLAY = PivotBacklash(castor=5, value=0.22)


@cache
def driven(name, effect, seed=5):
    motion = wander(np.random.default_rng([seed, 1]), duration=15.0)
    return drive(preset(name).with_effects(effect), motion, seed, duration=15.0)


def candidate_of(robot, effect):
    return next(candidate for candidate in candidates_of(robot) if candidate.is_of(effect))


def usual_size(seen):
    """The largest size of disagreement, along and across, by the median."""
    (disagreement,) = seen.disagreements
    off = np.abs(disagreement.seen[disagreement.counted])
    return max(np.median(off[:, rows]) for rows in (disagreement.along, ~disagreement.along))


def creep_of_least_power(design, stiffness):
    """The slips (K - 1, rows, G + R) by which wheels whose held speeds contradict each other creep, per unit of each
    change: weighted least squares, with the stiffness of each row, of the residuals that no motion of body and castors
    explains."""
    model, changes = design.model, design.changes
    stiff = np.sqrt(stiffness / stiffness.max(axis=1, keepdims=True))[..., None]
    steps = slice(0, len(stiffness))
    moved = model._moved(changes.geometry, *model._matrices_in(changes.geometry, changes.state, steps))
    contradicting = -model._decreasing(changes, steps)
    return contradicting - moved @ (np.linalg.pinv(stiff * moved, rcond=1e-10) @ (stiff * contradicting))


def test_steered_wheels_disagree_as_predicted_of_an_effect_in_the_model():
    """By the description, which their controller uses, they agree; with the effect they disagree twenty times as much,
    of which the prediction leaves no more than they disagree by the description."""
    robot, log = preset("swerve"), driven("swerve", STEERED)
    plain, seen = (linearise(vehicle, [log], among=()) for vehicle in (robot, robot.with_effects(STEERED)))
    assert usual_size(seen) < 1.1 * usual_size(plain)
    (disagreement,), (design,) = seen.disagreements, seen.designs
    whole = design.model.disagreement(design.geometry, design.state)
    whole = np.abs(np.add.reduceat(whole, np.cumsum([0, *disagreement.steps[:-1]]), axis=0))
    assert np.abs(disagreement.seen).mean() < 0.1 * (whole / np.mean(disagreement.way * disagreement.steps[0])).mean()


def test_wheels_turn_as_if_their_castor_stood_where_a_stuck_reading_says():
    """Within a backlash a reading stands still, though the wheels that are driven by it push their castor on, and the
    floor holds it. In the project's physics the wheels of that castor contradict each other as predicted, but for a
    part that creep lets vanish; readings alone do not predict it."""
    robot = preset("6-castor").with_effects(PLAY)
    log = driven("6-castor", PLAY)
    seen = linearise(robot, [log], among=())
    (disagreement,), (design,) = seen.disagreements, seen.designs
    rows = [list(design.model.rows).index(k) for k in (8, 9)]  # the wheels of castor 5
    starts = np.cumsum([0, *disagreement.steps[:-1]])
    found = design.model.disagreement(design.geometry, design.state)[:, rows]
    predicted = Slipping(robot, design.model, log, design.state).disagreement[:, rows]
    found, as_read, by_floor = (np.add.reduceat(of, starts).ravel() for of in (found, *np.moveaxis(predicted, -1, 0)))
    correlation = np.corrcoef([found, as_read, by_floor])[0]
    assert correlation[2] > 0.75 > 0.5 > correlation[1]


def test_passive_castors_show_a_smaller_disagreement_with_the_effect_in_the_model():
    robot, log = preset("asoc-prototype"), driven("asoc-prototype", RADIUS)
    plain, seen = (linearise(vehicle, [log], among=()) for vehicle in (robot, robot.with_effects(RADIUS)))
    assert usual_size(seen) < 0.6 * usual_size(plain)


def test_wheels_disagree_as_predicted_where_their_controller_did_not_know_of_exchanged_encoders():
    robot, order = preset("5-castor"), CastorOrder(castor=2, exchanged_with=5)
    log = driven("5-castor", order)
    castors, wheels = [0, 4, 2, 3, 1], [0, 1, 8, 9, 4, 5, 6, 7, 2, 3]
    mended = replace(log, pivot=log.pivot[:, castors], wheel=log.wheel[:, wheels], undone=(order,))
    geometry = Geometry.of(robot.as_built())
    model = LogLikelihood(geometry, mended)
    state = np.column_stack([model.odometry(geometry), model.counts])
    disagreement = model.disagreement(geometry, state)
    predicted = Slipping(robot, model, mended, state).by_effects
    predicted = predicted - model.explained(geometry, state, predicted)
    assert np.corrcoef(disagreement.ravel(), predicted.ravel())[0, 1] > 0.9
    assert not Slipping(robot, model, replace(mended, undone=()), state).by_effects.any()


def test_doubt_about_expected_slips_is_a_variance_beside_noise():
    robot, log = preset("asoc-prototype"), driven("asoc-prototype", RADIUS)
    geometry, slips = Geometry.of(robot.as_built()), np.full((len(log) - 1, 9), 1e-4)
    model = LogLikelihood(geometry, log)
    state = model.start(geometry)
    plain = model.in_deviations(slips, geometry, state, LEAST_NOISE)
    model.expect(np.zeros_like(slips), slips / plain)  # as large as noise
    assert model.in_deviations(slips, geometry, state, LEAST_NOISE) == pytest.approx(plain / np.sqrt(2), rel=1e-9)


@pytest.mark.parametrize(("name", "effect"), [("asoc-prototype", RADIUS), ("swerve", STEERED)])
def test_odometry_with_predicted_creep_is_right_where_odometry_alone_is_not(name, effect):
    robot, log = preset(name).with_effects(effect), driven(name, effect)
    seen = linearise(robot, [log], among=())
    geometry = Geometry.of(robot.as_built())
    path = LogLikelihood(geometry, log).odometry(geometry)
    assert log.reference is not None
    assert seen.gap is not None
    off = relative_pose(path[0], path)[-1] - relative_pose(log.reference[0], log.reference[-1])
    assert seen.gap[0] < 2.5e-3
    beyond_noise = np.sqrt(max(seen.gap[0] ** 2 - 2 * Noise().position ** 2, 0.0))
    assert np.hypot(*off[:2]) > 8 * beyond_noise


@pytest.mark.parametrize(
    ("name", "effect"), [("swerve", STEERED), ("powered-caster", PivotOffset(castor=1, value=0.007))]
)
def test_an_effect_that_drags_wheels_is_as_likely_as_any_at_its_true_size(name, effect):
    """Its controller leaves no disagreement in what encoders read, so that says nothing for another size. Half of the
    angle of `swerve` is as likely, as the wheel slides with all its friction then."""
    log = driven(name, effect)

    def log_evidence(part, castor=1):
        changed = replace(effect, value=part * effect.value, castor=castor)
        return linearise(preset(name).with_effects(changed), [log], among=()).log_evidence

    true = log_evidence(1.0)
    assert true > max(log_evidence(0.5), log_evidence(1.5)) - 1.0
    assert true > log_evidence(1e-5) + 5.0
    assert true > log_evidence(1.0, castor=2) + 10.0


SMALL = [
    ("asoc-prototype", WheelRadius(castor=3, wheel=2, value=1e-4)),
    ("swerve", PivotBias(castor=1, value=1e-4)),
    ("powered-caster", WheelRadius(castor=3, wheel=1, value=1e-4)),
]


@pytest.mark.parametrize(("name", "effect"), SMALL)
def test_the_creep_that_a_small_effect_causes_is_of_least_power(name, effect):
    """The friction circle does not matter: the contact model has to agree with weighted least squares."""
    log, candidate = driven(name, effect), candidate_of(preset(name), effect)
    (design,) = linearise(preset(name), [log], among=[candidate]).designs
    slipping = Slipping(preset(name).with_effects(effect), design.model, log, design.state)
    linear = effect.value * creep_of_least_power(design, slipping.stiffness)[..., 0]
    predicted = slipping.by_effects
    product, square = np.sum(linear * predicted), np.sum(linear**2)
    assert product / np.sqrt(square * np.sum(predicted**2)) > 0.97
    assert product / square == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("name", ["asoc-prototype", "swerve"])
def test_wheels_that_are_driven_against_each_other_do_not_move_the_body(name):
    """Counts of wheels that creep against each other give the same path as counts of wheels that agree."""
    robot, effect = preset(name), WheelRadius(castor=1, wheel=1, value=0.03)
    (design,) = linearise(robot, [driven(name, effect)], among=[candidate_of(robot, effect)]).designs
    path = design.model.odometry(design.geometry)
    assert design.model.stiffness is not None
    creep = creep_of_least_power(design, design.model.stiffness)[..., 0]
    moved = design.model.odometry(design.geometry, effect.value * creep)
    assert np.abs(effect.value * creep).sum(axis=0).max() > 0.01
    assert moved == pytest.approx(path, abs=1e-4)  # at the readings, not at the state


def test_refits_reach_a_large_effect_that_creep_masks_within_the_stated_errors():
    """Errors in units of those stated, of independent logs: their squares sum to a chi-square variable."""
    robot, candidate, squares = preset("asoc-prototype"), candidate_of(preset("asoc-prototype"), RADIUS), 0.0
    near = (Sized(candidate, np.array([-0.09])),)
    for seed in range(5, 9):
        log, looked = driven("asoc-prototype", RADIUS, seed), []

        def look(named, start, among, log=log, looked=looked):
            looked.append(named)
            built = robot
            for effect in named:
                built = effect.candidate.added(built, effect.amplitudes)
            return linearise(built, [log], start=start, among=among)

        found, seen = refitted(robot, look, (), near, linearise(robot, [log], among=[candidate]))
        statistics, size = seen.logs[0], np.repeat(found[0].amplitudes, 2)  # creep masks it as predicted
        assert np.sum(statistics.information) ** -0.5 < 0.005 * abs(RADIUS.value)
        standard_error = np.sum(statistics.doubted(np.zeros(2), size).information) ** -0.5  # as answers state it
        squares += ((found[0].amplitudes[0] - RADIUS.value) / standard_error) ** 2
        assert looked[1][0].amplitudes[0] == pytest.approx(RADIUS.value, abs=1.5e-3)  # in the first step
    assert chi2.ppf(0.005, 4) < squares < chi2.ppf(0.995, 4)
