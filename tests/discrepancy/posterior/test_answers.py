"""Answers are those of a posterior, whose components stand for single effects."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from discrepancy.posterior.answers import Place, answers_of
from discrepancy.posterior.single_effects import Hypothesis, Posterior, SingleEffects


@dataclasses.dataclass(frozen=True)
class _Cause:
    family: str
    kinds: tuple[int, ...] = (1,)


CAUSES: Any = (_Cause("eccentric"), _Cause("late"))
COLUMNS = dict(zip(CAUSES, (np.array([0, 1]), np.array([2])), strict=True))
SEEN: Any = SimpleNamespace(candidates=CAUSES, columns=COLUMNS, cost=np.ones((2, 3)))


@pytest.mark.parametrize("part", [1.0, 0.7])
def test_an_effect_that_two_components_share_has_the_size_of_both(part):
    information = 1e4 * np.array([[1.0, 0.1, 0.2], [0.1, 1.0, 0.3], [0.2, 0.3, 1.0]])
    truth = np.array([3.0, -4.0, 2.0])
    named = [Hypothesis("eccentric", np.eye(3)[:, :2], 5.0, 1.0), Hypothesis("late", np.eye(3)[:, 2:], 5.0, 1.0)]
    single, score = SingleEffects(named, information), information @ truth
    found = single.posterior(score)
    eccentric, late = sorted(found.components[:2], key=lambda component: component.probability[1])
    shares = [dataclasses.replace(eccentric, mean=share * eccentric.mean) for share in (part, 1 - part) if share > 0]
    posterior = Posterior(tuple(named), (*shares, late), found.bound)
    answers = answers_of(SEEN, single, posterior, score, [Place(cause, 0.0) for cause in CAUSES], np.zeros(3))
    assert [answer.credible for answer in answers] == [("eccentric",), ("late",)]
    assert np.concatenate([answer.amplitudes for answer in answers]) == pytest.approx(truth, rel=1e-5)
    covariance = np.linalg.inv(information)
    assert answers[0].covariance == pytest.approx(covariance[:2, :2], rel=1e-4)
