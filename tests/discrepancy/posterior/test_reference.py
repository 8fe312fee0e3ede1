"""A reference that is mounted, or whose clock is set, otherwise than in clean logs."""

import dataclasses
from functools import cache, partial

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import cauchy, invgamma, norm

from castor_envs.effects.catalogue import readings, reference
from castor_envs.effects.clocks import AllLatency, ClockOffset
from castor_envs.effects.reference import ReferenceLeverX, ReferenceLeverY, ReferenceYaw
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.diagnose import examine
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import FAULT, FREEDOM, LOG_ODDS
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.priors import same_effects
from discrepancy.posterior.reference import KINDS, UNKNOWN, Shown, _Change, _or_rivals, reference_answers, rivals

ROBOT = preset("differential")


TO_AND_FRO = Trajectory("to and fro", tuple(Run((Leg((way, 0.0, 0.0), 1.0),), 0.25, 0.5) for way in (1.0, -1.0) * 2))


def driven(seed, *effects, duration=15.0, path=None):
    """A log of perfect rolling whose reference, with errors of 0.5 mm and 0.5 mrad, is as effects make it; path: by
    default a random one."""
    robot = ROBOT.with_effects(*effects)
    random = np.random.default_rng([seed, 1])
    motion = roll(robot.as_built(), path or wander(random, duration=duration, holonomic=False))
    wheel, castor = readings(robot, motion.t, motion.wheel_angle, motion.castor_angle)
    encoders = Encoders(Geometry.of(robot), np.full(2, 0.4))
    pose = reference(robot, motion.t, motion.pose)
    pose += random.normal(size=pose.shape) * 5e-4
    pose[np.arange(len(pose)) % 5 > 0] = np.nan
    return Log(motion.t, encoders.wheel(wheel), encoders.pivot(castor), reference=pose)


@cache
def clean():
    return [driven(seed) for seed in (11, 12, 13)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "cost", "same"),
    [
        (ReferenceLeverX(value=-0.012), (0.012, 0.0), ("pivot_position_x 1",)),
        (ReferenceLeverY(value=0.012), (0.012, 0.0), ("pivot_position_y 1",)),
        (ReferenceYaw(value=0.02), (0.0, 0.02), ()),
        (ClockOffset(value=-0.02), None, ()),
        (AllLatency(value=0.02), None, ()),
    ],
    ids=lambda given: getattr(given, "name", ""),
)
def test_what_differs_from_clean_logs_is_named_with_its_size(effect, cost, same):
    found = examine(ROBOT, {"a": driven(1, effect)}, {"b": driven(2, effect)}, dict(zip("cde", clean(), strict=True)))
    (answer,) = found.data["answers"]
    assert (answer["verdict"], tuple(answer["same_as"])) == ("named", same)
    low, high = answer["interval"]
    assert abs((low + high) / 2 - effect.value) < 0.75 * (high - low)
    assert high - low < abs(effect.value) / 2
    if cost is not None:
        assert answer["cost"] == pytest.approx(cost, rel=0.1)
    (written,) = found.data["effects"]
    assert written["name"] == (effect.name if cost else "clock_offset")
    assert not any("that is fitted" in line for line in found.data["preflight"])
    before, after = found.data["replay"]["before"], found.data["replay"]["after"]
    assert after["position_rms_mm"] == pytest.approx(before["position_rms_mm"], rel=0.05)


@pytest.mark.parametrize(
    ("path", "late", "possible"), [(TO_AND_FRO, -0.02, True), (None, -0.02, False), (TO_AND_FRO, 0.02, False)]
)
def test_contacts_that_creep_under_the_forces_of_a_straight_drive_are_a_rival_of_a_clock_that_lags(
    path, late, possible
):
    """A robot of mass m whose contacts creep by c follows its wheels by m c later, along; where it turns, it also
    creeps across. By a negative amount no contact creeps."""
    seen = linearise(ROBOT, [driven(1, ClockOffset(value=late), path=path)])
    found = rivals(seen, KINDS.index(ClockOffset), late, same_effects(ROBOT)[1])
    assert (found.get("contact_creep", -np.inf) > -LOG_ODDS) == possible
    assert all(log_odds < -LOG_ODDS for family, log_odds in found.items() if family != "contact_creep")


@pytest.mark.parametrize(
    ("log_odds", "credible"),
    [
        ({}, ("reference_lever_x",)),
        ({"creep": -6.0}, ("reference_lever_x",)),
        ({"creep": -1.0, "slope": -9.0}, ("reference_lever_x", "creep")),
        ({"creep": 6.0}, ("reference_lever_x", "creep")),
    ],
)
def test_rivals_that_are_likely_enough_share_the_credible_set(log_odds, credible):
    told = Answer.judged_apart(Candidate("lever", (ReferenceLeverX(value=0.02),)), 0.99, 0.02, 1e-3, np.zeros(2))
    answer = _or_rivals(told, log_odds)
    assert answer.credible == credible
    assert sum(answer.probabilities.values()) == pytest.approx(1.0, abs=2e-3)
    assert answer.probabilities["nothing"] == pytest.approx(0.01)
    if "creep" in credible:
        odds = answer.probabilities["creep"] / answer.probabilities["reference_lever_x"]
        assert odds == pytest.approx(np.exp(log_odds["creep"]))


def test_an_effect_that_the_robot_file_has_already_is_not_missing():
    effect = ReferenceLeverX(value=-0.03)
    logs = [driven(1, effect)]
    robot = ROBOT.with_effects(effect)
    shown = Shown.by(linearise(ROBOT, clean(), among=()))
    assert reference_answers(ROBOT, ROBOT, logs, linearise(ROBOT, logs, among=()), None, shown, 30)
    seen = linearise(robot, logs, among=())
    assert not reference_answers(robot, ROBOT, logs, seen, None, shown, 30)
    (answer,) = reference_answers(robot, robot, logs, seen, None, shown, 30)
    assert answer.size == pytest.approx(-0.03, abs=5e-3)


@pytest.mark.slow
def test_clocks_that_start_anyhow_in_each_log_tell_nothing():
    scattered = [driven(k, ClockOffset(value=value)) for k, value in ((11, 0.05), (12, -0.08), (13, 0.11))]
    found = diagnose(ROBOT, [driven(1, ClockOffset(value=-0.06))], clean=scattered)
    assert found.verdict in ("no discrepancy", "negligible")


def test_sizes_and_errors_are_those_of_each_log_by_itself():
    logs = [driven(1, ReferenceYaw(value=0.01)), driven(2, ClockOffset(value=0.015))]
    shown = Shown.by(linearise(ROBOT, logs, among=()))
    true = np.array([[0, 0, 0.01, 0], [0, 0, 0, 0.015]])
    assert np.all(np.abs(shown.size - true) < 4 * np.sqrt(shown.variance))
    assert np.all(np.sqrt(shown.variance) < [5e-4, 5e-4, 2e-3, 2e-3])
    no_reference = Shown.by(linearise(ROBOT, [dataclasses.replace(logs[0], reference=None)], among=()))
    assert np.all(np.isinf(no_reference.variance))


@pytest.mark.slow
def test_errors_of_sizes_are_as_stated():
    effects = [ReferenceLeverX(value=-0.012), ReferenceLeverY(value=0.012), ReferenceYaw(value=0.02)]
    effects.append(ClockOffset(value=-0.02))
    usual, off = Shown.by(linearise(ROBOT, clean(), among=())), []
    for seed in range(20, 36):
        shown = Shown.by(linearise(ROBOT, [driven(seed, *effects)], among=()))
        changes = [_Change(usual.of(k), shown.of(k), 0.0) for k in range(len(KINDS))]
        true = [effect.value / effect.tolerance for effect in effects]
        off.append([(change.size - size) / change.error for change, size in zip(changes, true, strict=True)])
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.75)
    assert np.all(np.std(off, axis=0) < 1.4)


@pytest.mark.parametrize(
    ("robot", "looks"),
    [
        ("differential", {"pivot_position_x 1": (-1, 0, 0), "pivot_position_y 1": (0, -1, 0)}),
        ("asoc-prototype", {}),
    ],
)
def test_a_place_that_no_log_shows_looks_like_a_tracked_point_that_moved_back(robot, looks):
    _, unseen = same_effects(preset(robot))
    assert unseen.keys() == looks.keys()
    for family, mount in looks.items():
        assert unseen[family] == pytest.approx(np.array(mount), abs=1e-3)


def test_the_bayes_factor_is_that_of_the_stated_priors_integrated_numerically():
    """Of one clean log and one other, in tolerances: their difference has the variances of both, each with a scatter of
    one inverse gamma distribution, and a fault of a Cauchy distribution, or a tolerance, in addition."""
    known, shown = (np.array([0.3]), np.array([0.5])), (np.array([9.0]), np.array([0.8]))
    change = _Change(known, shown, 1.0)

    def mean_over_scatter(density):
        weight = partial(invgamma.pdf, a=FREEDOM / 2, scale=FREEDOM / 4)
        return quad(lambda square: weight(square) * density(np.sqrt(1.3 + 2 * square)), 0.0, 2e3, limit=400)[0]

    def faulty(deviation):
        inside = quad(lambda size: norm.pdf(7.7, size, deviation) * cauchy.pdf(size, scale=FAULT), -40, 60, limit=400)
        return inside[0]

    good = mean_over_scatter(lambda deviation: norm.pdf(7.7, 0.0, np.hypot(deviation, np.sqrt(0.5))))
    assert change.log_bayes_factor == pytest.approx(np.log(mean_over_scatter(faulty) / good), abs=0.05)
    size = mean_over_scatter(
        lambda deviation: quad(
            lambda size: size * norm.pdf(7.7, size, deviation) * cauchy.pdf(size, scale=FAULT), -40, 60, limit=400
        )[0]
    ) / mean_over_scatter(faulty)
    assert change.size == pytest.approx(size, rel=0.01)


def test_in_good_order_a_bayes_factor_of_19_is_as_rare_as_it_says():
    """The mean of a Bayes factor over data of the other hypothesis is 1, so that it exceeds 19 less often than once in
    19 times; scatter is drawn from its prior."""
    random, exceeded, draws = np.random.default_rng(0), 0, 600
    for _ in range(draws):
        scatter = np.sqrt(invgamma(FREEDOM / 2, scale=FREEDOM / 4).rvs(random_state=random))
        about = random.normal() * np.sqrt(0.5)
        variances = random.uniform(0.01, 4.0, size=4)
        sizes = random.normal(size=4) * np.sqrt(variances + scatter**2)
        change = _Change((sizes[:3], variances[:3]), (sizes[3:] + about, variances[3:]), 0.0)
        exceeded += change.log_bayes_factor > np.log(19)
    assert exceeded <= draws / 19


def test_held_out_logs_confirm_a_change_that_lasts_and_speak_against_one_that_does_not():
    usual, logs = (np.zeros(3), np.full(3, 0.1)), (np.array([30.0]), np.array([0.1]))
    change = _Change(usual, logs, 0.0)
    assert change.confirmed((np.array([30.5]), np.array([0.1]))) > 3
    assert change.confirmed((np.array([0.0]), np.array([0.1]))) < -3
    assert change.confirmed((np.zeros(1), np.full(1, UNKNOWN**2))) == pytest.approx(0.0, abs=0.01)


def test_every_kind_is_an_effect_of_any_robot():
    assert all(len(kind.variants(preset(name))) == 1 for kind in KINDS for name in ("differential", "swerve"))
