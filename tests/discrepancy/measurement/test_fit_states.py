"""What truly happened, how contacts crept, and the noise beside it, against physics that is integrated by itself."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.clocks import SampleJitter
from castor_envs.effects.contact import SlipStiffness, SlipStiffnessLateral
from castor_envs.effects.dimensions import Track, WheelRadius
from castor_envs.effects.encoders import PivotBacklash, TickLoss
from castor_envs.effects.floor import FloorSlope
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import candidates_of, stacked
from discrepancy.measurement import fit_states
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import Noise, as_recorded
from estimators.calibration.drives import log_of
from estimators.calibration.maximum_likelihood.noise import LEAST
from estimators.likelihood.channels import Channels
from estimators.likelihood.creep_prediction import LEAST_NOISE
from estimators.likelihood.log_likelihood import LogLikelihood

ROBOT = preset("asoc-prototype")
"""Its logs are of the physics: whatever creeps there, no formula of the finder's made it."""


STRANGE = WheelRadius(castor=1, wheel=1, value=0.01)
"""An effect that no description tells."""


@cache
def driven(*effects):
    motion = wander(np.random.default_rng([11, 0]), duration=40.0)
    return drive(ROBOT.with_effects(*effects), motion, 11, duration=40.0)


def factor_of(robot, log):
    """The factor of creep under forces that a log shows."""
    model = LogLikelihood(Geometry.of(robot.as_built()), log)
    _, _, shared, _ = fit_states.fit_states(robot, [model], [log], None, None, LEAST)
    return shared.creep[0]


def test_contacts_creep_as_predicted_under_forces(monkeypatch):
    monkeypatch.setattr(fit_states, "AS_DESCRIBED", fit_states.DOUBT)  # as if nothing was known of it
    assert factor_of(ROBOT, driven()) == pytest.approx(1.0, abs=0.08)


STIFF = SlipStiffness(value=10.0), SlipStiffnessLateral(value=10.0)
SLOPE = FloorSlope(direction="x", value=0.03)


def test_stiff_contacts_creep_as_little_on_a_slope():
    """By the stiffness described they would creep down by 1 mm after 1 m, and the gap would be a quarter larger."""
    log = driven(*STIFF, SLOPE)
    sloping, even = (linearise(robot, [log], among=[]) for robot in (ROBOT.with_effects(SLOPE), ROBOT))
    errors = [np.hypot(*seen.errors[0][:, :2].T) for seen in (sloping, even)]
    assert sloping.creep < fit_states.RIGID
    assert np.mean(errors[0] ** 2) < 1.02**2 * np.mean(errors[1] ** 2)


@pytest.mark.parametrize(("name", "told"), [("asoc-prototype", True), ("tricycle", False), ("swerve", False)])
def test_logs_tell_how_contacts_creep_if_castors_are_free_to_follow(name, told):
    robot, motion = preset(name), wander(np.random.default_rng([11, 0]), duration=40.0, holonomic=name != "tricycle")
    log = drive(robot, motion, 11, duration=40.0)
    assert linearise(robot, [log], among=[]).shared.told == told


def test_a_large_effect_in_the_model_leaves_no_slip():
    """What creep is predicted depends on states, and these on creep."""
    described = preset("omnimate")
    robot = described.with_effects(PivotBacklash(castor=1, value=0.05))
    log = drive(robot, wander(np.random.default_rng([11, 0]), duration=20.0), 11, duration=20.0)
    assert linearise(robot, [log], among=[]).noise.along < 5e-5


@pytest.mark.parametrize(("name", "effects"), [("asoc-full-scale", ()), ("asoc-prototype", (STRANGE,))])
def test_creep_settles_however_little_wheels_roll(name, effects, monkeypatch):
    """At stops noise of the state once passed for wheels that disagree, at forces beyond friction: a fit to the first
    log took all rounds."""
    rounds = []
    follow = fit_states.fitted
    monkeypatch.setattr(fit_states, "fitted", lambda *args, **known: rounds.append(0) or follow(*args, **known))
    robot = preset(name)
    log = drive(robot.with_effects(*effects), wander(np.random.default_rng([11, 0]), duration=40.0), 11, duration=40.0)
    linearise(robot, [log], among=[])
    assert len(rounds) < fit_states.MOST_ROUNDS


@pytest.mark.parametrize("seed", [12, 22])
def test_a_reading_within_a_backlash_leaves_the_shaft_free(seed):
    """If it counted as read where the fit begins, slips of 1 to 6 mm after 1 m would be left."""
    effect = PivotBacklash(castor=1, value=0.1)
    motion = wander(np.random.default_rng([seed, 1]), duration=20.0)
    log = drive(ROBOT.with_effects(effect), motion, seed, duration=20.0)
    seen, less = (
        linearise(ROBOT.with_effects(dataclasses.replace(effect, value=value)), [log], among=())
        for value in (0.1, 0.095)
    )
    assert max(seen.noise.along, seen.noise.across) < 5e-5
    assert seen.gap is not None
    assert seen.gap[0] < 2e-3
    assert seen.log_evidence - less.log_evidence > 50


def test_the_other_wheels_tell_how_fast_a_wheel_turns_that_loses_counts_at_speed():
    """What its own encoder reads after a loss may be a lower speed at which it loses nothing: by it alone, 2 mm of slip
    after 1 m are left."""
    described = preset("omnimate")
    robot = described.with_effects(dataclasses.replace(TickLoss.variants(described)[0], value=0.1))
    log = drive(robot, wander(np.random.default_rng([5, 1]), duration=40.0), 5, duration=40.0)
    assert linearise(robot, [log], among=[]).noise.along < 1e-4


@pytest.mark.parametrize(("name", "part_left"), [("omnimate", 0.01), ("asoc-prototype", 0.01), ("differential", 0.1)])
def test_counts_that_a_wheel_loses_both_ways_are_put_back(name, part_left):
    """By the other wheels; on a differential robot, where these do not tell, by the reference."""
    described = preset(name)
    path = wander(np.random.default_rng(3), duration=30.0, holonomic=moves_sideways(described))
    log, channels = log_of(described, path, "all"), Channels(described)
    wheel = len(channels.sensed)
    true = np.column_stack([log.pivot, log.wheel])
    rate = np.abs(np.diff(true[:, wheel])) * 2 * np.pi / channels.per_rev[wheel] / np.diff(log.t)
    losses = [
        dataclasses.replace(effect, value=0.1, above=0.98 * float(np.quantile(rate, 0.6)))  # no speed that is held
        for effect in TickLoss.variants(described)[:2]
    ]
    robot = described.with_effects(*losses)
    read = np.round(channels.read(robot, log, true))
    lossy = dataclasses.replace(log, pivot=read[:, :wheel], wheel=read[:, wheel:])
    assert {effect.direction for effect in losses} == {"forward", "backward"}
    found = linearise(robot, [lossy], among=[]).designs[0].model.counts[:, wheel]
    assert np.ptp(found - true[:, wheel]) < part_left * np.sum(np.abs(np.diff(true - read, axis=0))[:, wheel])


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_angles_read_after_a_loss_are_told_from_angles_read_in_full(direction):
    random, count = np.random.default_rng(1), 0.003
    effect = TickLoss(castor=1, wheel=1, value=0.2, above=4.0, direction=direction)
    sign = 1.0 if direction == "forward" else -1.0
    durations, angle = np.full(4000, 0.05), random.uniform(-0.5, 0.5, 4000)
    read = np.where(sign * angle > effect.above * durations, (1 - effect.value) * angle, angle)
    ends = np.round(np.concatenate([[0.0], np.cumsum(read)]) / count) * count
    turned = effect.turned(durations, np.diff(ends), angle + 3 * count * random.uniform(-1, 1, 4000), count)
    np.testing.assert_allclose(turned, angle, atol=1.01 * count / (1 - effect.value))


@pytest.mark.parametrize("direction", ["forward", "backward"])
def test_a_wheel_at_the_very_speed_reads_what_it_read(direction):
    """Of angles within a count of the limit, sums of which are rounded, none is lost again or kept after all."""
    random, count, durations = np.random.default_rng(2), 0.003, np.full(4000, 0.05)
    effect = TickLoss(castor=1, wheel=1, value=0.2, above=4.0, direction=direction)
    sign = 1.0 if direction == "forward" else -1.0
    limit, lost = sign * effect.above * durations, random.random(4000) < 0.5
    read = limit * np.where(lost, 1 - effect.value, 1) + count * random.uniform(-0.5, 0.5, 4000)
    turned = effect.turned(durations, read, limit * np.where(lost, 1.02, 0.98), count)
    again = np.diff(1e4 * count + np.cumsum(np.append(0.0, turned)))
    assert np.array_equal(sign * again > effect.above * durations, lost)


def test_jitter_is_uncertainty_of_where_the_robot_was():
    """Readings that come early or late together contradict the reference, not each other."""
    robot, found = ROBOT.with_effects(SampleJitter(value=0.005)), []
    for seed in range(1, 5):
        log = as_recorded(robot, driven(), np.random.default_rng([seed, 4]), Noise())
        found.append([linearise(ROBOT, [log], among=[], jitter=jitter).noise.position for jitter in (0.0, 0.005)])
    unaware, aware = np.sqrt(np.mean(np.square(found), axis=0))
    assert aware == pytest.approx(Noise().position, rel=0.1)
    assert unaware > 1.2 * aware


def test_softer_contacts_creep_more_under_forces(monkeypatch):
    """Slip goes as one over stiffness."""
    monkeypatch.setattr(fit_states, "AS_DESCRIBED", fit_states.DOUBT)
    softer = factor_of(ROBOT, driven(SlipStiffness(value=-0.4)))
    assert softer == pytest.approx(1 / 0.6, rel=0.15)


def test_contacts_that_hardly_creep_are_taken_for_rigid():
    softest = ROBOT.with_effects(SlipStiffness(value=-0.9))  # described so; the log is of contacts ten times stiffer
    assert factor_of(softest.as_built(), driven()) < fit_states.RIGID


def test_noise_beside_an_effect_is_what_it_leaves():
    """Where encoders cannot contradict each other an effect that is not in the model passes for slip."""
    robot, radius = preset("differential"), WheelRadius(castor=1, wheel=1, value=0.002)
    motion = wander(np.random.default_rng([11, 1]), duration=30.0, holonomic=False)
    logs = [drive(robot.with_effects(*effects), motion, 11, duration=30.0) for effects in ((radius,), ())]
    (candidate,) = [candidate for candidate in candidates_of(robot) if candidate.is_of(radius)]
    with_it, without = (linearise(robot, [log], among=[candidate]) for log in logs)
    assert with_it.noise.along > 4 * without.noise.along
    left, least = (seen.reestimate_noise([candidate]).noise.along for seen in (with_it, without))
    assert left - least < 0.1 * (with_it.noise.along - without.noise.along)


@pytest.mark.parametrize("effect", [Track(castor=1, value=0.05), WheelRadius(castor=1, wheel=1, value=-0.03)])
def test_encoders_that_cannot_contradict_each_other_say_nothing_of_dimensions(effect):
    robot = preset("differential")
    motion = wander(np.random.default_rng(3), duration=20.0, holonomic=False)
    log = dataclasses.replace(drive(robot, motion, 3, duration=20.0), reference=None)
    logs_evidence = []
    for built in (robot, robot.with_effects(effect)):
        geometry = Geometry.of(built.as_built())
        model, unchanged = LogLikelihood(geometry, log), stacked(geometry, [])
        at = geometry, unchanged, np.zeros(0), model.start(geometry), np.zeros(2), np.zeros(3), LEAST_NOISE
        logs_evidence.append(model.reduce(*at).log_evidence())
    assert logs_evidence[1] == pytest.approx(logs_evidence[0], abs=0.5)


@pytest.mark.parametrize(("name", "duration"), [("3-castor", 40.0), ("omnimate", 60.0)])
def test_the_log_evidence_hardly_depends_on_where_a_fit_begins(name, duration):
    """Else by chance one effect seems likelier than another: with wheels' disagreement averaged over three samples and
    no longer, and fits that end at changes of 0.2, log evidences differ by 6.6 and 6.5."""
    robot = preset(name)
    log = drive(robot, wander(np.random.default_rng([21, 1]), duration=duration), 21, duration=duration)
    begin = linearise(robot, [log], among=[])
    found = [begin.log_evidence]
    for part in (0.004, -0.004, 0.001):
        wrong = robot.with_effects(WheelRadius(castor=1, wheel=1, value=part))
        start = linearise(wrong, [log], among=[], start=begin)
        found.append(linearise(robot, [log], among=[], start=start).log_evidence)
    assert np.ptp(found) < 0.5
