"""Cases of trials: the mix of strata, motions, logs that repeat, effects outside the catalogue, sizes by strength."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset, preset_names
from discrepancy.trials.cases import BOUNDS, CLEAN_LOGS, MIX, SEVERAL, UNTRACKED, Case, hide, motion, setting
from discrepancy.trials.generators import generator
from discrepancy.trials.hidden import class_of, outside_in, outsider
from discrepancy.trials.outside import KINDS, SpeedSquared
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import EXACT, USUAL, Noise, angles_of, counts_of
from discrepancy.trials.strength.solve_size import TrialRun, solve_size
from discrepancy.validation.sufficient import redundancy

ROBOT, ROBOTS = preset("asoc-prototype"), preset_names()
OWN = generator("pymunk")
MOTION = wander(np.random.default_rng(1), duration=8)
TWENTY = sum(MIX.values())


def drawn(number, seed=4):
    return hide(setting(number, seed, ROBOTS, foreign=False), 0, seed, OWN.outsiders)


def settings(count, foreign=False):
    return [setting(number, 4, ROBOTS, foreign=foreign) for number in range(1, count + 1)]


def poses(log):
    assert log.reference is not None
    return log.reference


def test_strata_come_in_a_fixed_mix():
    cases = settings(3 * TWENTY)
    for first in range(0, 3 * TWENTY, TWENTY):
        assert Counter(case.stratum for case in cases[first : first + TWENTY]) == MIX


def test_robots_come_in_turn():
    cases = settings(3 * len(ROBOTS))
    assert set(Counter(case.robot for case in cases).values()) == {3}
    assert {case.robot for case in cases[: len(ROBOTS)]} == set(ROBOTS)
    assert {setting(number, 4, ["swerve"], foreign=False).robot for number in range(1, 9)} == {"swerve"}


def test_cases_follow_from_number_and_seed():
    for number in range(1, TWENTY + 1):
        assert drawn(number) == drawn(number)
        assert drawn(number) != drawn(number, seed=5)
    seeds = [seed for number in range(1, 60) for trial in (4, 5) for seed in drawn(number, trial).seeds]
    assert len(set(seeds)) == len(seeds)


def test_what_is_hidden_fits_the_stratum():
    for case in map(drawn, range(1, 4 * TWENTY + 1)):
        many = {"clean": 0, **SEVERAL}.get(case.stratum, 1)
        low, high = BOUNDS[case.measure]
        assert len(case.hidden) == many
        assert len({class_of(one) for one in case.hidden}) == many
        assert len(case.targets) == (0 if case.stratum == "wiring" else many)
        assert all(low <= target <= high for target in case.targets)
        assert (outside_in(case.hidden) is not None) == (case.stratum == "outside")
        assert any(one.wiring for one in case.hidden) == (case.stratum == "wiring")
        assert case.stratum == "clean" or (case.course != "wander") == (case.stratum == "poor")


def test_clean_logs_are_of_every_motion():
    clean = [case.course for case in map(drawn, range(1, 4 * TWENTY + 1)) if case.stratum == "clean"]
    assert set(clean) == {"wander", "to and fro", "circles"}


def test_parts_are_those_stated():
    """Within four standard deviations of a draw with these odds."""
    for foreign, expected in ((False, CLEAN_LOGS["own"]), (True, CLEAN_LOGS["foreign"])):
        cases = settings(600, foreign)
        redundant = [case for case in cases if redundancy(preset(case.robot))]
        assert all(case.reference for case in cases if case not in redundant)
        for some, so, part in (
            (cases, lambda case: case.clean, expected),
            (cases, lambda case: case.measure == "cost", 0.5),
            (redundant, lambda case: not case.reference, UNTRACKED),
        ):
            assert np.mean([so(case) for case in some]) == pytest.approx(part, abs=4 * np.sqrt(0.25 / len(some)))


@pytest.mark.parametrize("measure", ["cost", "z"])
def test_targets_are_log_uniform(measure):
    cases = [case for case in map(drawn, range(1, 201)) if case.measure == measure]
    targets = np.log([target for case in cases for target in case.targets])
    low, high = np.log(BOUNDS[measure])
    width = (high - low) / np.sqrt(12 * len(targets))
    assert np.mean(targets) == pytest.approx((low + high) / 2, abs=4 * width)


@pytest.mark.parametrize("course", ["wander", "to and fro", "circles"])
def test_motions_last_repeat_and_suit_the_robot(course):
    for name in ("asoc-prototype", "differential", "tricycle", "1-castor"):
        one = motion(preset(name), course, 3, 30.0)
        assert one.duration >= 30.0
        np.testing.assert_array_equal(one.at([3.0, 11.0])[0], motion(preset(name), course, 3, 30.0).at([3.0, 11.0])[0])
        sideways = np.abs(one.at(np.linspace(0, 30, 200))[1][:, 1]).max()
        assert (sideways > 0) == (name not in ("differential", "tricycle"))


def test_poor_motions_are_poor():
    twist = motion(ROBOT, "to and fro", 3, 30.0).at(np.linspace(0, 30, 200))[1]
    assert not twist[:, 2].any()
    assert np.linalg.matrix_rank(twist, tol=1e-9) == 1
    twist = motion(ROBOT, "circles", 3, 30.0).at(np.linspace(0, 30, 200))[1]
    assert np.linalg.matrix_rank(twist, tol=1e-9) == 1


def test_a_log_is_the_exact_one_rounded_with_noise():
    log = drive(ROBOT, MOTION, 5, duration=6.0)
    exact = drive(ROBOT, MOTION, 5, duration=6.0, rounded=False, noise=EXACT)
    np.testing.assert_array_equal(log.wheel, np.round(exact.wheel))
    np.testing.assert_array_equal(log.pivot, np.mod(np.round(exact.pivot), 5143))
    assert np.isfinite(poses(log)[:: USUAL.every]).all()
    assert np.isnan(poses(log)[1 : USUAL.every]).all()
    off = (poses(log) - poses(exact))[:: USUAL.every]
    assert 0 < np.abs(off).max() < 6e-3


def test_seeds_mean_the_same_with_and_without_effects():
    effect = WheelEccentricity(castor=2, wheel=1, value=1e-3)
    logs = [drive(robot, MOTION, 5, duration=6.0, noise=EXACT) for robot in (ROBOT, ROBOT.with_effects(effect))]
    noisy = [
        drive(robot, MOTION, 5, duration=6.0, noise=Noise(every=1)) for robot in (ROBOT, ROBOT.with_effects(effect))
    ]
    np.testing.assert_array_equal(logs[0].pivot[0], logs[1].pivot[0])
    np.testing.assert_allclose(poses(noisy[0]) - poses(logs[0]), poses(noisy[1]) - poses(logs[1]), rtol=0, atol=1e-12)


def test_angles_and_counts_are_each_others_inverse():
    exact = drive(ROBOT, MOTION, 5, duration=6.0, rounded=False, noise=EXACT)
    wheel, pivot = counts_of(ROBOT, angles_of(ROBOT, exact))
    np.testing.assert_allclose(wheel, exact.wheel - exact.wheel[0], atol=1e-9)
    np.testing.assert_allclose(pivot - exact.pivot, np.round((pivot - exact.pivot) / 5143) * 5143, atol=1e-9)


def test_effects_outside_the_catalogue_are_all_drawn_and_do_something():
    exact = drive(ROBOT, wander(np.random.default_rng(1), duration=50), 5, duration=50.0, rounded=False, noise=EXACT)
    angle, pose, random = angles_of(ROBOT, exact), poses(exact), np.random.default_rng(2)
    assert {type(outsider(KINDS, ROBOT, random)) for _ in range(100)} == set(KINDS)
    for kind in KINDS:
        one = outsider([kind], ROBOT, random)
        seen = one.changed(ROBOT, exact.t, angle, pose), one.tracked(exact.t, pose)
        none = dataclasses.replace(one, value=0.0)
        assert any(not np.array_equal(a, b) for a, b in zip(seen, (angle, pose), strict=True))
        np.testing.assert_array_equal(none.changed(ROBOT, exact.t, angle, pose), angle)
        np.testing.assert_array_equal(none.tracked(exact.t, pose), pose)
        part = one.changed(ROBOT, exact.t[:600], angle[:600], pose[:600])
        np.testing.assert_allclose(part, seen[0][:600], atol=1e-12)  # the past does not hang on the future


def case_of(hidden, target, measure, robot="asoc-prototype"):
    return Case(1, "one", robot, "wander", (7, 8), False, True, measure, (hidden,), (target,))


def test_the_size_of_an_effect_is_solved_for_its_strength():
    case = case_of(WheelEccentricity(castor=1, wheel=1, value=1e-3, phase=0.5), 60.0, "z")
    trial_run = TrialRun(case, 0, OWN, 12.0)
    found = solve_size(case, trial_run)
    assert found is not None
    strength = trial_run.strength(found.hidden)
    assert strength.z[0] == pytest.approx(60.0, rel=1e-3)
    assert 0 < strength.z_sep[0] <= strength.z[0] * (1 + 1e-9)
    assert strength.cosine == pytest.approx(1.0, abs=1e-3)
    assert trial_run.z(case.hidden[0]) < 60.0 / 1.5


def test_the_cost_is_the_target_also_of_effects_outside_the_catalogue():
    """A wheel of a differential robot reads the wrong way, by an effect or by what the catalogue does not have."""
    case = case_of(WheelRadius(castor=1, wheel=1, value=1e-3), 0.2, "cost", "differential")
    trial_run = TrialRun(case, 0, OWN, 12.0)
    found = solve_size(case, trial_run)
    assert found is not None
    assert trial_run.cost(found.hidden[0]) == pytest.approx(0.2, rel=0.05)
    once, twice = (trial_run.cost(SpeedSquared(1, 1, size)) for size in (1e-3, 2e-3))
    assert once > 0
    assert twice == pytest.approx(2 * once, rel=0.05)


def test_an_impossible_target_has_no_size():
    for measure in ("z", "cost"):
        case = case_of(WheelEccentricity(castor=1, wheel=1, value=1e-3), 1e9, measure)
        assert solve_size(case, TrialRun(case, 0, OWN, 6.0)) is None


def test_a_castor_steered_by_a_wrong_reading_reads_as_commanded():
    """Without a reference little of the encoder's error shows in the log of a robot that is steered by it; on castors
    that swing freely all of it does."""
    bias = PivotBias(castor=2, value=0.1)
    shown = {}
    for robot in ("swerve", "4-castor"):
        case = dataclasses.replace(case_of(bias, 1.0, "z", robot), reference=False)
        trial_run = TrialRun(case, 0, OWN, 8.0)
        on_same_run = trial_run.metric.signal(trial_run.metric.read(bias))
        shown[robot] = trial_run.z(bias) / float(np.linalg.norm(on_same_run))
        assert trial_run.cost(bias) > 0.01
    assert shown["swerve"] < 0.3
    assert shown["4-castor"] == pytest.approx(1.0)
