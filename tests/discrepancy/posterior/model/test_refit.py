"""Sizes of effects by fits of the whole model, where the linear formula is wrong."""

from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import PivotGain
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.model.refit import Sized, refitted
from discrepancy.posterior.random_effects import Statistics

ROBOT = preset("tricycle")
GAIN = Candidate("gain", (PivotGain(castor=1, value=PivotGain.step),))


@pytest.mark.parametrize(("information", "reached"), [(1e5, 0.2), (1e4, 0.13)])
def test_a_size_of_which_the_formula_may_be_wrong_by_more_than_noise_is_found_by_fits(
    information, reached, statistics_of
):
    """The formula takes 13 % for right where 20 % is likelier; it may be wrong by 5 % of the deviance explained."""

    def look(effects, *_) -> Any:
        off = sum(float(effect.size) for effect in effects) - 0.2
        return statistics_of([GAIN], np.array([[information]]), -1e6 * off**2)

    new = (Sized(GAIN, np.array([0.13])),)
    (found,), _ = refitted(ROBOT, look, (), new, look(new))
    assert found.size == pytest.approx(reached, rel=0.05)


def test_a_size_that_is_far_too_small_is_found_though_log_evidence_is_uneven_there(statistics_of):
    """As of a backlash, where fits of a wrong size end in one of many states: up to the size there are dips."""

    def look(effects, *_) -> Any:
        size = sum(float(effect.size) for effect in effects)
        off = np.log(max(size, 1e-9) / 0.5)
        return statistics_of([GAIN], np.array([[1e8]]), -1e3 * abs(off) + 400 * np.cos(2 * np.pi * off / np.log(2)))

    new = (Sized(GAIN, np.array([0.5 / 8])),)
    (found,), _ = refitted(ROBOT, look, (), new, look(new))
    assert found.size == pytest.approx(0.5)


@pytest.mark.parametrize("covered", [1.0, 0.5, 0.3])
def test_a_size_is_found_in_few_fits_where_each_step_covers_a_part_of_what_is_left(covered, statistics_of):
    """As what an effect leaves unexplained passes for noise."""
    fits, information = list[float](), np.array([[1e6]])

    def look(effects, *_) -> Any:
        left = 0.2 - sum(float(effect.size) for effect in effects)
        fits.append(left)
        seen = statistics_of([GAIN], information, -1e6 * left**2)
        seen.logs = (Statistics(information, information @ [covered * left]),)
        return seen

    new = (Sized(GAIN, np.array([0.05])),)
    (found,), _ = refitted(ROBOT, look, (), new, look(new))
    assert found.size == pytest.approx(0.2, abs=1e-3)
    assert min(map(abs, fits[:8])) < 1e-3


def test_sizes_that_logs_hardly_distinguish_stay_as_small_as_they_are(statistics_of):
    """Two radii whose difference logs tell to 30 %, and the step along it is as large."""
    wheels = [Candidate(f"radius {k}", (WheelRadius(castor=1, wheel=k, value=WheelRadius.step),)) for k in (1, 2)]
    information = 1e8 * np.array([[1.0, 1.0 - 1e-7], [1.0 - 1e-7, 1.0]])

    def look(effects, *_) -> Any:
        total = sum(float(effect.amplitudes[0]) for effect in effects)
        seen = statistics_of(wheels, information, -1e8 * (total - 0.002) ** 2 / 2)
        along = 1e8 * (0.002 - total) * np.ones(2)
        seen.logs = (Statistics(information, along + np.array([3.0, -3.0])),)
        return seen

    new = tuple(Sized(wheel, np.array([0.0009])) for wheel in wheels)
    found, _ = refitted(preset("differential"), look, (), new, look(new))
    assert [effect.size for effect in found] == pytest.approx([0.001, 0.001], abs=3e-4)
