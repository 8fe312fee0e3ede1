"""Statistics that are written down by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from discrepancy.posterior.random_effects import Statistics


@pytest.fixture
def statistics_of():
    """A function that returns the statistics of candidates of one amplitude, at their most likely sizes."""

    def of(candidates, information, log_evidence):
        count = len(candidates)
        return SimpleNamespace(
            candidates=tuple(candidates),
            columns=tuple(np.arange(k, k + 1) for k in range(count)),
            logs=(Statistics(information, np.zeros(count)),),
            usual=np.full(count, np.nan),
            redundant=True,
            masked=1.0,
            log_evidence=log_evidence,
        )

    return of
