"""The posterior of a sum of single effects, against quadrature, symmetry, and data drawn from the model itself."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from discrepancy.posterior.calibrated import NOTHING
from discrepancy.posterior.single_effects import (
    LOG_WEIGHTS,
    SCALES,
    Component,
    Hypothesis,
    Posterior,
    SingleEffects,
)


def hypotheses(m, scale=1.0, **bounds):
    return [Hypothesis(f"effect {k}", np.eye(m)[:, [k]], scale, 1.0, **bounds) for k in range(m)]


@pytest.mark.parametrize(("most", "off"), [(100, 0.011), (500, 0.05)])
def test_the_mixture_of_normal_distributions_is_a_cauchy_distribution(most, off):
    size = np.append(0.0, np.geomspace(0.01, most, 300))[:, None]
    each = np.exp(LOG_WEIGHTS - (size / SCALES) ** 2 / 2) / (SCALES * np.sqrt(2 * np.pi))
    assert each.sum(axis=1) == pytest.approx(1 / (np.pi * (1 + size[:, 0] ** 2)), rel=off)


@pytest.mark.parametrize("size", [0.5, 3.0, 40.0])
@pytest.mark.parametrize(("least", "most"), [(-np.inf, np.inf), (0.0, np.inf), (-1.0, 20.0), (2.0, 5.0)])
def test_one_hypothesis_against_nothing_is_what_quadrature_says(size, least, most):
    information, score = np.array([[4.0]]), np.array([4.0 * size])
    one = SingleEffects(hypotheses(1, 2.0, least=least, most=most), information)
    found = one.posterior(score, 1)

    ends = max(least, -200.0), min(most, 200.0)
    inside = (np.arctan(most / 2) - np.arctan(least / 2)) / np.pi
    top = min(max(size, ends[0]), ends[1])

    def likely(b):
        return np.exp(-2 * (b - size) ** 2 + 2 * (top - size) ** 2) * 1 / (2 * np.pi * (1 + (b / 2) ** 2)) / inside

    def integrated(values):
        spans = np.unique(np.clip(top + np.array([-9, -1, -0.1, 0, 0.1, 1, 9]), *ends))
        return sum(quad(values, a, b, limit=200)[0] for a, b in pairwise(spans))

    factor = integrated(likely)
    mean = integrated(lambda b: b * likely(b)) / factor
    variance = integrated(lambda b: (b - mean) ** 2 * likely(b)) / factor

    log_factor = np.log(factor) + 2 * size**2 - 2 * (top - size) ** 2
    log_evidence = np.logaddexp(np.log(NOTHING), np.log(1 - NOTHING) + log_factor)
    assert found.bound == pytest.approx(log_evidence, abs=0.02)
    sizes, covariance = one.sizes(score, 0, found.components[1:])
    assert sizes[0] == pytest.approx(mean, rel=0.01, abs=0.02)
    assert covariance[0, 0] == pytest.approx(variance, rel=0.05)


@pytest.mark.parametrize("count", [1, 2, 6])
def test_effects_of_several_sizes_are_cauchy_distributed_together(count):
    """Beside one of fewer sizes, what each shows is weighed by the mean likelihood over draws from its prior."""
    random, precision = np.random.default_rng(5), 30.0
    shown = np.append(0.8, np.zeros(count - 1))
    information = precision * np.eye(count)
    several = Hypothesis("several", np.eye(count), 0.3, 1.0)
    one = Hypothesis("one", np.eye(count)[:, :1], 0.3, 1.0)
    found = SingleEffects([one, several], information).posterior(information @ shown, 1).components[0]

    # a normal vector over an independent normal number
    drawn = 0.3 * random.normal(size=(400_000, count)) / np.abs(random.normal(size=(400_000, 1)))
    factor = np.mean(np.exp(precision * np.sum(shown**2) / 2 - precision * np.sum((drawn - shown) ** 2, axis=1) / 2))
    assert found.probability[1] / found.nothing == pytest.approx((1 - NOTHING) / 2 / NOTHING * factor, rel=0.05)
    assert found.probability.sum() + found.nothing == pytest.approx(1.0)


def test_twins_share_their_probability_and_a_name_with_two_places_adds_it_up():
    direction = np.eye(2)[:, [0]]
    names = ["radius", "gain", "radius"]
    found = SingleEffects([Hypothesis(name, direction, 1.0, 1.0) for name in names], np.eye(2) * 100)
    posterior = found.posterior(np.array([1000.0, 0.0]))
    assert posterior.probabilities(posterior.components[0]) == pytest.approx({"radius": 2 / 3, "gain": 1 / 3}, rel=1e-6)
    assert posterior.credible_set(posterior.components[0]) == ("radius", "gain")


@pytest.mark.parametrize(
    ("nothing", "names"),
    [(0.02, ("cause",)), (0.049, ("cause",)), (0.051, ()), (0.01, ("cause", "other"))],
)
def test_a_credible_set_is_of_names_given_that_there_is_an_effect(nothing, names):
    """Else many that are impossible would make up for the last hundredth."""
    of_others = 0.06 if len(names) > 1 else 0.004
    probability = np.array([1 - nothing - of_others, of_others * 0.99, *np.full(100, of_others * 1e-4)])
    every = [Hypothesis(name, np.eye(1), 1.0, 1.0) for name in ("cause", "other", *map(str, range(100)))]
    component = Component(nothing, probability, np.zeros(1), 0.0, 0.0)
    assert Posterior(tuple(every), (component,), 0.0).credible_set(component) == names


def test_pure_noise_is_nothing():
    random = np.random.default_rng(0)
    design = random.normal(size=(200, 40))
    information = design.T @ design
    single = SingleEffects(hypotheses(40, 0.5), information)
    found = [single.posterior(design.T @ random.normal(size=200)) for _ in range(40)]
    assert sum(bool(one.credible_set(component)) for one in found for component in one.components) <= 2


def test_an_effect_of_two_sizes_is_found_in_any_mixture_of_them():
    information = np.diag([50.0, 50.0, 50.0, 50.0])
    every = [Hypothesis("phase", np.eye(4)[:, :2], 1.0, 1.0), Hypothesis("other", np.eye(4)[:, 2:], 1.0, 1.0)]
    for angle in np.linspace(0, 6, 7):
        score = information @ [3 * np.cos(angle), 3 * np.sin(angle), 0, 0]
        single = SingleEffects(every, information)
        found = single.posterior(score)
        assert found.components[0].probability[0] > 0.99
        sizes, covariance = single.sizes(score, 0, found.components[1:])
        assert sizes == pytest.approx(3 * np.array([np.cos(angle), np.sin(angle)]), rel=0.05, abs=0.05)
        assert np.sqrt(np.diag(covariance)) == pytest.approx(np.full(2, 50**-0.5), rel=0.1)


def test_two_effects_that_look_like_a_third_together_are_found():
    both = np.array([[1.0, 0.0, 0.7, 0.0], [0.0, 1.0, 0.7, 0.0], [0.0, 0.0, 0.14, 0.0], [0.0, 0.0, 0.0, 1.0]])
    information = 900 * both.T @ both
    posterior = SingleEffects(hypotheses(4, 0.1), information).posterior(information @ [1.0, 1.0, 0.0, 0.0])
    surely = {name for name, probability in posterior.inclusion().items() if probability > 0.9}
    assert surely == {"effect 0", "effect 1"}


def test_intervals_of_two_correlated_effects_are_those_of_least_squares():
    information = 1e4 * np.array([[1.0, 0.9], [0.9, 1.0]])
    truth, covariance = np.array([1.0, -2.0]), np.linalg.inv(information)
    single = SingleEffects(hypotheses(2, 1.0), information)
    found = single.posterior(information @ truth)
    for component in found.components[:2]:
        k = int(np.argmax(component.probability))
        others = [other for other in found.components if other is not component]
        sizes, squares = single.sizes(information @ truth, k, others)
        assert sizes[0] == pytest.approx(truth[k], rel=1e-3)
        assert squares[0, 0] == pytest.approx(covariance[k, k], rel=0.01)


def test_probabilities_are_calibrated_where_the_model_is_true():
    random = np.random.default_rng(1)
    told, right = [], []
    mixing = np.linalg.cholesky(0.6 * np.ones((30, 30)) + 0.4 * np.eye(30))
    for _ in range(100):
        design = random.normal(size=(300, 30)) @ mixing.T
        information = design.T @ design
        truth = np.zeros(30)
        there = random.random(5) > NOTHING
        for k in random.integers(30, size=5)[there]:
            truth[k] += 0.3 * random.standard_cauchy()
        score = information @ truth + design.T @ random.normal(size=300)
        posterior = SingleEffects(hypotheses(30, 0.3), information).posterior(score)
        for name, probability in posterior.inclusion().items():
            told.append(probability)
            right.append(truth[int(name.split()[1])] != 0)
    told, right = np.array(told), np.array(right, dtype=float)
    error = 0.0
    for low, high in ((0, 0.05), (0.05, 0.3), (0.3, 0.7), (0.7, 0.95), (0.95, 1.01)):
        inside = (told >= low) & (told < high)
        if inside.any():
            off = abs(told[inside].mean() - right[inside].mean())
            error += off * inside.mean()
            assert off < 3.5 * np.sqrt(0.25 / inside.sum()), (low, high)
    assert error < 0.03


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_never_exceeds_the_largest_log_likelihood(seed):
    random = np.random.default_rng(seed)  # similar signatures: sizes are still on the way where probabilities settle
    design = random.normal(size=(200, 1)) + 0.1 * random.normal(size=(200, 4))
    information = 1e4 * design.T @ design
    truth = random.normal(size=4)
    found = SingleEffects(hypotheses(4, 0.01), information).posterior(information @ truth)
    assert found.bound < truth @ information @ truth / 2
