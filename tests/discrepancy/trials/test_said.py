"""What the finder says, in one form: classes, probabilities, credible sets and sizes."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import Track
from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.effects.floor import Bump
from castor_envs.effects.wiring import EncodersSwapped
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate, family_of
from discrepancy.posterior.answers import Answer
from discrepancy.preflight import Mistake
from discrepancy.trials.said import Said, Single, in_classes
from estimators.calibration.identifiability import COVERAGE

ROBOT = preset("asoc-prototype")
TRACK = Track(castor=1, value=1e-3)


def answer(probabilities, credible, kind=None, verdict: Any = "named", amplitudes=(1e-3,), covariance=((0.0,),)):
    """An answer of the posterior, made by hand."""
    candidate = Candidate("something") if kind is None else Candidate("an effect", (kind,), len(amplitudes))
    sizes = np.array(amplitudes), np.array(covariance)
    cost = np.zeros(2)
    return Answer(probabilities, credible, kind is None, candidate, *sizes, cost, verdict=verdict, reason="so")


def posterior_says(*answers, mistakes=()):
    return in_classes(ROBOT, {}, mistakes, answers)


def test_no_answer_is_no_discrepancy():
    assert posterior_says() == Said.of([]) == Said("no discrepancy")


def test_a_single_name_is_sure_and_has_a_size():
    told = {"track 1": 0.97, "wheel_radius 1 2": 0.02, "nothing": 0.01}
    sure = answer(told, ("track 1",), TRACK, covariance=[[1e-10]])
    said = posterior_says(sure)
    assert (said.verdict, said.named, said.credible, said.unnamed) == (
        "named",
        {"track 1": 0.97},
        (("track 1",),),
        False,
    )
    assert said.probabilities == pytest.approx({"track 1": 0.97, "wheel_radius 1 2": 0.02})
    (size,) = said.sizes
    assert (size["low"], size["high"]) == pytest.approx((1e-3 - COVERAGE * 1e-5, 1e-3 + COVERAGE * 1e-5))
    assert said.effects == (TRACK,)


def test_what_is_the_same_on_this_robot_is_said_with_the_name():
    sure = dataclasses.replace(answer({"track 1": 1.0}, ("track 1",), TRACK), alike=("wheel_radius 1 2", "drift"))
    assert posterior_says(sure).same_as == {"track 1": ("wheel_radius 1 2",)}
    assert posterior_says(answer({"track 1": 1.0}, ("track 1",), TRACK)).same_as == {}


def test_several_names_or_none_are_not_sure():
    names, drift = ("track 1", "wheel_radius 1 2"), "wheel_1l drifts with time"
    said = posterior_says(answer(dict.fromkeys(names, 0.5), names, TRACK, "ambiguous"))
    assert (said.verdict, said.named, said.sizes) == ("ambiguous", {}, ())
    said = posterior_says(answer({drift: 0.9, "wheel_1l jumps at 3.0 s": 0.1}, (drift,), None, "unexplained"))
    assert (said.verdict, said.credible, said.unnamed, said.probabilities) == ("unexplained", ((),), True, {})
    mixed = answer({"track 1": 0.5, drift: 0.5}, ("track 1", drift), TRACK, "ambiguous")
    said = posterior_says(mixed)
    assert (said.verdict, said.credible, said.unnamed) == ("ambiguous", (("track 1",),), True)


def test_probabilities_of_several_answers_add_up_as_of_independent_ones():
    first, second = (answer({"track 1": one, "nothing": 1 - one}, ("track 1",), TRACK) for one in (0.5, 0.8))
    assert posterior_says(first, second).probabilities == pytest.approx({"track 1": 0.9})


def test_a_wave_has_an_error_along_its_phase():
    wave = WheelEccentricity(castor=1, wheel=1, value=5e-3, phase=float(np.arctan2(4, 3)))
    covariance = np.outer([4, -3], [4, -3]) * 1e-8 + np.outer([3, 4], [3, 4]) / 25 * 1e-10
    told = answer({family_of(wave): 1.0}, (family_of(wave),), wave, amplitudes=[3e-3, 4e-3], covariance=covariance)
    (size,) = posterior_says(told).sizes
    assert size["high"] == pytest.approx(5e-3 + COVERAGE * 1e-5)


def test_names_at_a_place_on_the_floor_are_of_their_class():
    bump = Bump(x=0.12, y=0.3, direction=1.5, value=2e-3)
    assert posterior_says(answer({family_of(bump): 1.0}, (family_of(bump),), bump)).named == {"bump": 1.0}


def test_what_is_negligible_is_not_sure():
    said = posterior_says(answer({"track 1": 1.0}, ("track 1",), TRACK, "negligible"))
    assert (said.verdict, said.named, said.credible, said.effects) == ("negligible", {}, (("track 1",),), ())


def test_the_whole_is_as_sure_as_its_weakest_part():
    parts = {verdict: Single(verdict, {}, ()) for verdict in ("named", "negligible", "unconfirmed", "unexplained")}
    for fewer, expected in ((4, "unexplained"), (3, "unconfirmed"), (2, "named"), (1, "named")):
        assert Said.of(list(parts.values())[:fewer]).verdict == expected


def test_wiring_is_named_unless_it_may_be_something_else():
    swapped = EncodersSwapped(castor=1)
    said = posterior_says(mistakes=(Mistake("so", (swapped,)),))
    assert (said.verdict, said.named, said.sizes) == ("named", {"encoders_swapped 1": 1.0}, ())
    assert said.effects == (swapped,)
    said = posterior_says(mistakes=(Mistake("so", (swapped,), ("or not",)),))
    assert (said.verdict, said.named, said.effects) == ("ambiguous", {}, ())
