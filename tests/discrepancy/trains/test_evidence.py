"""The log evidence of descriptions of trains: where it is largest."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.dimensions import Track
from estimators.likelihood.trains.states import equations_of, fit_states

APART = 0.008


@pytest.mark.parametrize("reference", [False, True])
def test_wheels_that_slip_make_no_track_look_narrower(driven, reference):
    """Wheels slip by 3 mm after 1 m, each by itself. The likeliest track is the true one within the error of two logs
    together, which the curvature of the log evidence tells."""
    likeliest, precisions = [], []
    for seed in (1, 2):
        log, train = driven(seed=seed, reference=reference, seconds=30.0)
        random, turn = np.random.default_rng(seed), 2 * np.pi * 0.075 / 2000
        rolled = np.abs(np.diff(log.wheel, axis=0)) * turn
        slip = np.cumsum(3e-3 * np.sqrt(rolled) * random.standard_normal(rolled.shape) / turn, axis=0)
        slipped = dataclasses.replace(log, wheel=np.round(log.wheel + np.concatenate([np.zeros((1, 4)), slip])))
        logs, found = equations_of(train, [slipped])
        evidence = []
        for error in (-APART, 0.0, APART):
            first = train.modules[0].with_effects(Track(castor=1, value=error)) if error else train.modules[0]
            other = dataclasses.replace(train, modules=(first, train.modules[1]))
            evidence.append(-fit_states(other, logs, found, found.sizes).deviance / 2)
        less, there, more = evidence
        precisions.append((2 * there - less - more) / APART**2)
        likeliest.append((more - less) / 2 / APART / precisions[-1])
    error = np.sum(precisions) ** -0.5
    assert abs(np.average(likeliest, weights=precisions)) < 2 * error < 0.01
