"""What robots in good order show, by the class of effects."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.presets import any_preset, preset
from discrepancy.hypotheses.candidates import Candidate, candidates_of
from discrepancy.measurement.design_matrix import columns_of
from discrepancy.posterior.answers import Cause
from discrepancy.posterior.priors import order_of, tolerances
from discrepancy.posterior.random_effects import Statistics
from discrepancy.trains.candidates import named_candidates

SCATTER, SEEN = 3.0, 1e4
"""Standard deviation of sizes, and the information on each, both by their tolerances."""


@dataclass(eq=False)
class Shown:
    """Logs that show each size of these candidates by itself, as good as `SEEN` tells."""

    candidates: tuple[Cause, ...]
    logs: tuple[Statistics, ...]
    columns: Any
    usual: Array
    lasting = np.zeros(0, dtype=int)
    redundant = True

    @classmethod
    def of(cls, candidates, seed, logs=40) -> Any:
        count = sum(candidate.columns for candidate in candidates)
        shown: Any = cls(tuple(candidates), (), columns_of(candidates), np.ones(count))
        shown.usual = tolerances(shown)
        random, information = np.random.default_rng(seed), np.diag(SEEN / shown.usual**2)
        sizes = [SCATTER * shown.usual * random.normal(size=count) for _ in range(logs)]
        shown.logs = tuple(Statistics(information, information @ size) for size in sizes)
        return shown

    def parts(self, order, *, which):
        """The scatter of the sizes of some candidates, by their tolerances."""
        columns = np.concatenate([at for candidate, at in self.columns.items() if which(candidate)])
        return np.sqrt(np.diag(order.scatter))[columns] / self.usual[columns]


def is_of(*names):
    return lambda candidate: candidate.kinds[0].name in names


@pytest.mark.parametrize("name", ["wheel_radius", "wheel_eccentricity", "pivot_bias"])
def test_effects_of_a_class_scatter_alike_in_all_their_columns(name):
    clean = Shown.of(candidates_of(preset("asoc-prototype")), 1)
    parts = clean.parts(order_of(clean, clean), which=is_of(name))
    assert len(parts) > 2
    assert np.ptp(parts) == pytest.approx(0.0, abs=1e-12)
    assert parts[0] == pytest.approx(SCATTER, rel=0.15)


def test_late_pivots_and_late_wheels_are_two_classes():
    clean = Shown.of(candidates_of(preset("asoc-prototype")), 1)
    parts = clean.parts(order_of(clean, clean), which=is_of("encoder_latency"))
    assert len(np.unique(np.round(parts, 9))) == 2


def test_effects_that_clean_logs_do_not_hold_scatter_as_their_class_does():
    candidates = candidates_of(preset("asoc-prototype"))
    first = next(candidate for candidate in candidates if candidate.kinds[0].name == "wheel_radius")
    clean = Shown.of([candidate for candidate in candidates if candidate is not first], 1)
    seen = Shown.of(candidates, 2)
    parts = seen.parts(order_of(seen, clean), which=is_of("wheel_radius"))
    assert np.ptp(parts) == pytest.approx(0.0, abs=1e-12)
    assert parts[0] == pytest.approx(SCATTER, rel=0.15)


def test_what_happens_at_a_time_scatters_alike_at_any_and_is_no_background_of_another_log():
    """A log's own times are not those of clean logs, though they may read the same."""
    spans = [
        Candidate("wheel_1l jumps at 3.0 s", when=" at 3.0 s"),
        Candidate("pivot_2 jumps at 9.0 s", when=" at 9.0 s"),
    ]
    alike, always = Candidate("wheel_2l jumps at 9.0 s", when=" at 9.0 s"), Candidate("wheel_1l drifts with time")
    clean, log = Shown.of([*spans, alike, always], 6), Shown.of([spans[0], always], 7)
    order = order_of(log, clean)
    (of_span,), (of_drift,) = log.columns.values()
    assert order.background[of_span] == 0.0
    assert order.background[of_drift] != 0.0
    parts = clean.parts(order_of(clean, clean), which=lambda candidate: candidate.what.startswith("wheel"))
    assert parts[0] == pytest.approx(parts[1], rel=1e-9)
    assert np.sqrt(order.scatter[of_span, of_span]) / log.usual[of_span] == pytest.approx(parts[0], rel=1e-9)


def test_gauges_of_all_frames_scatter_alike():
    train: Any = any_preset("cfmmr-3")
    clean = Shown.of(named_candidates(train), 1)
    parts = clean.parts(order_of(clean, clean), which=is_of("gauge_gain"))
    assert len(parts) > 2
    assert np.ptp(parts) == pytest.approx(0.0, abs=1e-12)
