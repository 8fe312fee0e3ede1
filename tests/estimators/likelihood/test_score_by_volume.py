"""What the volume of likely states adds to the slope of log evidence, against log evidence itself on both sides."""

from dataclasses import replace

import numpy as np
import pytest

from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset
from estimators.calibration.maximum_likelihood.fit import State, fitted
from estimators.likelihood.log_likelihood import LogLikelihood, Noise

Number = tuple[str, tuple[int, ...]]
"""A field of a geometry, and which of its numbers."""

TRICYCLE = preset("tricycle")
COARSE = replace(Geometry.of(TRICYCLE), pivot_counts_per_rev=np.array([400.0, np.nan]))
"""A tricycle whose steering encoder hardly tells how its castor turns."""

CHANGE = 1e-5
"""m: with 1e-4 the forward difference of the volume is off by 1 %."""


def straight() -> Log:
    """A tricycle drives 4 m; its steering encoder always reads 0, as its castor turns within half a count."""
    front, random, t, geometry = TRICYCLE.castors[0], np.random.default_rng(3), 0.05 * np.arange(400), COARSE
    steered = 2 * np.pi / geometry.pivot_counts_per_rev[0] * 0.45 * np.sin(1.3 * t)
    way = 0.01 * (1 - np.cos(0.7 * t))
    psi = np.cumsum(way * np.sin(steered)) / front.pivot[0]
    pose = np.column_stack([np.cumsum(way * np.cos(psi)), np.cumsum(way * np.sin(psi)), psi])
    wheel = np.round(np.cumsum(way) / geometry.radius[0] * geometry.counts_per_rev[0] / (2 * np.pi))
    noise = random.normal(size=pose.shape) * 1e-3
    return Log(t, wheel[:, None], np.zeros((400, 1)), reference=pose + noise)


def moved(geometry: Geometry, number: Number, by: float) -> Geometry:
    name, index = number
    numbers = np.array(getattr(geometry, name))
    numbers[index] += by
    return replace(geometry, **{name: numbers})


def slopes(model: LogLikelihood, geometry: Geometry, at: State, noise: Noise, number: Number) -> tuple[float, float]:
    """Slopes of log evidence at a state by a number of the geometry: its central difference, and that of the formula's
    least squares alone."""
    lower, higher = (moved(geometry, number, by) for by in (-CHANGE, CHANGE))

    def log_evidence(geometry: Geometry) -> float:
        nothing = geometry, np.zeros(0), at.states[0], at.clocks[0], at.mount, noise
        return model.reduce(geometry, *nothing).log_evidence()

    changed = replace(higher, **{number[0]: getattr(higher, number[0])[None]})
    one = (changed, np.array([CHANGE]), at.states[0], at.clocks[0], at.mount, noise)
    least_squares = -float(model.reduce(geometry, *one).gradient[0, 0])
    return (log_evidence(higher) - log_evidence(lower)) / (2 * CHANGE), least_squares


@pytest.mark.parametrize("number", [("pivot", (0, 0)), ("pivot", (1, 0)), ("offset", (0,))])
def test_with_the_volume_the_score_is_the_slope_of_log_evidence_where_steering_stands_still(number):
    geometry, log = COARSE, straight()
    model = LogLikelihood(geometry, log)
    at, noise, _ = fitted([model], geometry, (), np.zeros(0), None)
    for _ in range(15):  # the slope of the least squares is exact where the state is the most likely, to rounding
        at, _, _ = fitted([model], geometry, (), np.zeros(0), noise, (at, noise))
    whole, least_squares = slopes(model, geometry, at, noise, number)
    larger = moved(geometry, number, CHANGE)
    by_volume, _ = model.score_by_volume(
        geometry, [larger], np.array([CHANGE]), at.states[0], at.clocks[0], at.mount, noise
    )
    assert abs(whole - least_squares) > 5
    assert least_squares + by_volume[0] == pytest.approx(whole, abs=0.01 * abs(whole - least_squares))


@pytest.mark.parametrize("axis", [0, 1])
def test_all_castors_out_of_place_are_the_same_as_a_reference_that_is_mounted_elsewhere(axis):
    geometry, log = COARSE, straight()
    model = LogLikelihood(geometry, log)
    at, noise, _ = fitted([model], geometry, (), np.zeros(0), None)
    shifted = moved(moved(geometry, ("pivot", (0, axis)), CHANGE), ("pivot", (1, axis)), CHANGE)
    given = [shifted], np.array([CHANGE]), at.states[0], at.clocks[0], at.mount, noise
    by_place, by_mount = model.score_by_volume(geometry, *given)
    assert abs(by_mount[axis]) > 0.1
    assert by_place[0] + by_mount[axis] == pytest.approx(0.0, abs=0.02 * float(abs(by_mount[axis])) + 1e-3)
