"""Statistics that are written down by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from discrepancy.measurement.design_matrix import columns_of
from discrepancy.posterior.random_effects import Statistics


@pytest.fixture
def statistics_of():
    """A function that returns the statistics of candidates at their most likely sizes."""

    def of(candidates, information, log_evidence):
        count = sum(candidate.columns for candidate in candidates)
        return SimpleNamespace(
            candidates=tuple(candidates),
            columns=columns_of(candidates),
            logs=(Statistics(information, np.zeros(count)),),
            usual=np.full(count, np.nan),
            redundant=True,
            masked=1.0,
            cost=np.ones((2, count)),
            log_evidence=log_evidence,
            log_evidence_of_motion=log_evidence,
        )

    return of
