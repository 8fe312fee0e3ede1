"""Cases of trials: the mix of strata, motions, logs that repeat, effects outside the catalogue, sizes by strength."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.trials.cases import LARGE, MIX, RANGE, Case, Hidden, draw, motion
from discrepancy.trials.generators import generator
from discrepancy.trials.noise import EXACT, REFERENCE_EVERY, Noise
from discrepancy.trials.outside import KINDS, outside_effects
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import angles_of, counts_of
from discrepancy.trials.strength.solve_size import TrialRun, solve_size

ROBOT = preset("asoc-prototype")
OWN = generator("pymunk")
MOTION = wander(np.random.default_rng(1), duration=8)


def drawn(number, seed=4):
    return draw(number, 0, seed, ROBOT, OWN.outsiders)


def poses(log):
    assert log.reference is not None
    return log.reference


def test_strata_come_in_a_fixed_mix():
    found = Counter(drawn(number).stratum for number in range(1, 2 * len(MIX) + 1))
    assert found == Counter({stratum: 2 * count for stratum, count in Counter(MIX).items()})


def test_cases_follow_from_number_and_seed():
    assert drawn(3) == drawn(3)
    assert drawn(3) != drawn(3, seed=5)
    assert len({drawn(number).seeds for number in range(1, 60)}) == 59


def test_what_is_hidden_fits_the_stratum():
    for number in range(1, 81):
        case = drawn(number)
        many = {"clean": 0, "two": 2}.get(case.stratum, 1)
        assert len(case.hidden) == len(case.targets) == many
        low, high = LARGE if case.stratum == "large" else RANGE
        assert all(low <= target <= high for target in case.targets)
        assert len({one.label for one in case.hidden}) == many
        assert (case.outside is not None) == (case.stratum == "outside")
        assert (case.course != "wander") == (case.stratum == "poor")


def test_targets_are_log_uniform():
    targets = [np.log(target) for n in range(1, 401) if (case := drawn(n)).stratum == "one" for target in case.targets]
    low, high = np.log(RANGE)
    width = (high - low) / np.sqrt(12 * len(targets))
    assert np.mean(targets) == pytest.approx((low + high) / 2, abs=4 * width)


@pytest.mark.parametrize("course", ["wander", "to and fro", "circles"])
def test_motions_last_and_repeat(course):
    one = motion(course, 3, 30.0)
    assert one.duration >= 30.0
    np.testing.assert_array_equal(one.at([3.0, 11.0])[0], motion(course, 3, 30.0).at([3.0, 11.0])[0])


def test_poor_motions_are_poor():
    twist = motion("to and fro", 3, 30.0).at(np.linspace(0, 30, 200))[1]
    assert not twist[:, 2].any()
    assert np.linalg.matrix_rank(twist, tol=1e-9) == 1
    twist = motion("circles", 3, 30.0).at(np.linspace(0, 30, 200))[1]
    assert np.linalg.matrix_rank(twist, tol=1e-9) == 1


def test_a_log_is_the_exact_one_rounded_with_noise():
    log = drive(ROBOT, MOTION, 5, duration=6.0)
    exact = drive(ROBOT, MOTION, 5, duration=6.0, rounded=False, noise=EXACT)
    np.testing.assert_array_equal(log.wheel, np.round(exact.wheel))
    np.testing.assert_array_equal(log.pivot, np.mod(np.round(exact.pivot), 5143))
    assert np.isfinite(poses(log)[::REFERENCE_EVERY]).all()
    assert np.isnan(poses(log)[1:REFERENCE_EVERY]).all()
    off = (poses(log) - poses(exact))[::REFERENCE_EVERY]
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
    exact = drive(ROBOT, MOTION, 5, duration=6.0, rounded=False, noise=EXACT)
    angle, pose, kinds = angles_of(ROBOT, exact), poses(exact), set()
    for one in outside_effects(ROBOT, np.random.default_rng(2)):
        kinds.add(type(one))
        one = dataclasses.replace(one, **({"start": 1.0, "end": 4.0} if hasattr(one, "start") else {}))
        seen = one.changed(ROBOT, exact.t, angle, pose), one.tracked(exact.t, pose)
        none = one.scaled(0.0)
        assert any(not np.array_equal(a, b) for a, b in zip(seen, (angle, pose), strict=True)) or (
            one.name in ("Glitches", "StickyPivot", "FlatSpot")  # not within six seconds, maybe
        )
        np.testing.assert_array_equal(none.changed(ROBOT, exact.t, angle, pose), angle)
        np.testing.assert_array_equal(none.tracked(exact.t, pose), pose)
        part = one.changed(ROBOT, exact.t[:60], angle[:60], pose[:60])
        np.testing.assert_allclose(part, seen[0][:60], atol=1e-12)  # the past does not hang on the future
    assert kinds == set(KINDS)


def test_an_effect_is_settled_to_the_strength_wanted():
    effect = WheelEccentricity(castor=1, wheel=1, value=1e-3, phase=0.5)
    case = Case(1, "one", "wander", (7, 8), (Hidden(effect),), (12.0,))
    trial_run = TrialRun(ROBOT, case, 0, OWN, 12.0)
    found = solve_size(case, trial_run)
    assert found is not None
    strength = trial_run.strength(found.hidden, alternatives=True)
    assert strength.z[0] == pytest.approx(12.0, rel=0.1)
    assert strength.z_sep is not None
    assert 0 < strength.z_sep[0] <= strength.z[0] * (1 + 1e-9)
    assert strength.cosine == pytest.approx(1.0, abs=1e-3)


def test_what_cannot_be_is_not_settled():
    effect = WheelEccentricity(castor=1, wheel=1, value=1e-3)
    case = Case(1, "large", "wander", (7, 8), (Hidden(effect),), (1e9,))
    assert solve_size(case, TrialRun(ROBOT, case, 0, OWN, 6.0)) is None
