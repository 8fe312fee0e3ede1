"""Where GRPEC's metrics select a wrong axle: a train's two frames bent against each other, or to the same side.

Vogt and Minor, section IV C, say without figures that "test 2 fails when the curvature of both frames are equal and
test 3 fails when the curvature of one of the frames is about 67% of the other frame". Here odometry is aligned, as in
both tests, one frame keeps its bend, and the other's grows.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.papers.comparison import Appendix
from benchmarks.tasks.static_tests import STATIC_TESTS, StaticTest
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.presets import FRAME_LENGTH
from estimators.trains import grpec

METRICS = ("theta_xy", "theta_phi", "theta_dev")
RATIOS = (0.2, 1.2)

#: Errors (m or rad) and ratios that differ by no more count as equal.
SAME = 1e-9

#: A bend so small that its sine equals the angle, rad.
SMALL_BEND = 1e-3


@dataclass(frozen=True, eq=False)
class Sweep:
    """Two frames of constant curvature, whose ratio is swept.

    test: the static test of the paper that lies on this sweep. claimed: the ratio at which the paper says it fails.
    keeps: the frame that keeps its bend, 0 for A, 1 for B. side: 1 where the other frame bends to the same side, -1
    for the opposite one. bend: of the frame that keeps it, rad.
    """

    name: str
    title: str
    test: StaticTest
    claimed: float
    keeps: int
    side: int
    bend: float

    @property
    def test_ratio(self) -> float:
        """The curvature ratio of the static test itself."""
        return abs(float(self.test.relative[1 - self.keeps, 2] / self.test.relative[self.keeps, 2]))

    def relative(self, ratio: ArrayLike) -> Array:
        """Return the frames' relative poses (..., 2, 3) at curvature ratios (...)."""
        ratio = np.asarray(ratio, dtype=float)
        bends = [self.side * ratio * self.bend] * 2
        bends[self.keeps] = np.full_like(ratio, self.bend)
        return bent(FRAME_LENGTH, np.stack(bends, axis=-1))

    def errors(self, metric: str, ratio: ArrayLike) -> Array:
        """Return the error (..., 3) of each attachment by a metric, m or rad, at curvature ratios (...)."""
        return getattr(grpec.errors(self.test.odometry, self.relative(ratio)), metric)

    def selected(self, metric: str, ratio: float) -> int:
        """Return the axle, from 1, that a metric selects at a curvature ratio."""
        return int(grpec.select(self.errors(metric, ratio), self.errors("theta_xy", ratio))) + 1


#: Tests 2 and 3 of the paper: the frame that bends most keeps its bend.
SWEEPS = tuple(
    Sweep(name, title, test, claimed, keeps, side, bend=float(test.relative[keeps, 2]))
    for name, title, test, claimed, keeps, side in (
        ("same-side", "both frames bent to the same side", STATIC_TESTS[1], 1.0, 0, 1),
        ("opposite-sides", "frames bent to opposite sides", STATIC_TESTS[2], 0.67, 1, -1),
    )
)


@dataclass(frozen=True)
class Tie:
    """A curvature ratio at which axles (from 1) have the same error. lowest: whether no axle has a lower error."""

    ratio: float
    axles: tuple[int, ...]
    lowest: bool


@dataclass(frozen=True)
class Selection:
    """The axle, from 1, that is selected at all curvature ratios between `low` and `high`."""

    low: float
    high: float
    axle: int


def bent(length: float, angle: ArrayLike) -> Array:
    """Return the relative pose (..., 3) of a frame of constant curvature that bends by `angle` (...), rad."""
    angle = np.asarray(angle, dtype=float)
    chord = length * np.sinc(angle / (2 * np.pi))
    return np.stack([chord * np.cos(angle / 2), chord * np.sin(angle / 2), angle], axis=-1)


def ties(sweep: Sweep, metric: str) -> tuple[Tie, ...]:
    """Return all ties of a metric within `RATIOS`, by rising ratio."""
    found: dict[tuple[float, tuple[int, ...]], Tie] = {}
    for i, j in combinations(range(3), 2):
        for ratio in _roots(lambda ratio, i=i, j=j: np.diff(sweep.errors(metric, ratio)[..., [i, j]])[..., 0]):
            errors = sweep.errors(metric, ratio)
            axles = tuple(int(k) + 1 for k in np.flatnonzero(np.abs(errors - errors[i]) <= SAME))
            # Three equal errors are found as three pairs.
            found.setdefault((round(ratio, 9), axles), Tie(ratio, axles, bool(errors[i] <= errors.min() + SAME)))
    return tuple(sorted(found.values(), key=lambda tie: tie.ratio))


def selections(sweep: Sweep, metric: str) -> tuple[Selection, ...]:
    """Return which axles a metric selects within `RATIOS`; the selection changes only at ties of the lowest error."""
    bounds = [RATIOS[0], *(tie.ratio for tie in ties(sweep, metric) if tie.lowest), RATIOS[1]]
    found: list[Selection] = []
    for low, high in pairwise(bounds):
        axle = sweep.selected(metric, (low + high) / 2)
        if found and found[-1].axle == axle:
            low = found.pop().low
        found.append(Selection(low, high, axle))
    return tuple(found)


def with_small_bends(sweep: Sweep) -> Sweep:
    """Return the sweep for bends so small that its ties are those of the linear theory."""
    return replace(sweep, bend=float(np.copysign(SMALL_BEND, sweep.bend)))


@functools.cache
def failure_modes() -> Appendix:
    """Return where the metrics fail, as an appendix to the tables of these metrics."""
    return Appendix(
        key="failure_modes",
        title="Where the metrics fail",
        lines=tuple(line for sweep in SWEEPS for line in failure_lines(sweep)),
        data={
            "frame_length_m": FRAME_LENGTH,
            "ratios": list(RATIOS),
            "sweeps": [_sweep_data(sweep) for sweep in SWEEPS],
        },
    )


def failure_lines(sweep: Sweep) -> list[str]:
    """Return what a sweep shows, line by line: where each metric's selection changes, and what the paper claims."""
    kept, swept = ("A", "B") if sweep.keeps == 0 else ("B", "A")
    true, small = sweep.test.true_axle, with_small_bends(sweep)
    lines = [
        f"{sweep.title}: {kept} by {abs(sweep.bend):.4f} rad, {swept} by {RATIOS[0]:g} to {RATIOS[1]:g} times "
        f"that; test {sweep.test.number} sits at {sweep.test_ratio:.3f}, where axle {true} is true. The paper: it "
        f"fails at {_claim(sweep)}."
    ]
    for metric in METRICS:
        ranges = [_range(selection, true) for selection in selections(sweep, metric)]
        if len(ranges) == 1:
            ranges = [f"selects axle {selections(sweep, metric)[0].axle} throughout"]
        of_small = [tie.ratio for tie in ties(small, metric)]
        for k, tie in enumerate(ties(sweep, metric)):
            axles = f"{', '.join(map(str, tie.axles[:-1]))} and {tie.axles[-1]}"
            moved = f" (for small bends {of_small[k]:.3f})" if abs(of_small[k] - tie.ratio) > 5e-4 else ""
            ranges.append(f"axles {axles} tie at {tie.ratio:.3f}{moved}{'' if tie.lowest else ', above it'}")
        lines.append(f"  {metric}: {'; '.join(ranges)}")
    return lines


def _claim(sweep: Sweep) -> str:
    return "equal curvature" if sweep.claimed == 1 else f"a ratio of about {sweep.claimed:g}"


def _range(selection: Selection, true: int) -> str:
    place = f"from {selection.low:.3f} to {selection.high:.3f}"
    return f"selects axle {selection.axle}{'' if selection.axle == true else ' (wrong)'} {place}"


def _sweep_data(sweep: Sweep) -> dict[str, Any]:
    small = with_small_bends(sweep)
    return {
        "name": sweep.name,
        "title": sweep.title,
        "test": sweep.test.number,
        "test_ratio": sweep.test_ratio,
        "claimed_ratio": sweep.claimed,
        "true_axle": sweep.test.true_axle,
        "bend_rad": sweep.bend,
        "metrics": [
            {
                "metric": metric,
                "selections": [_selection_data(selection) for selection in selections(sweep, metric)],
                "ties": [_tie_data(tie) for tie in ties(sweep, metric)],
                "ties_of_small_bends": [_tie_data(tie) for tie in ties(small, metric)],
            }
            for metric in METRICS
        ],
    }


def _selection_data(selection: Selection) -> dict[str, Any]:
    return {"from_ratio": selection.low, "to_ratio": selection.high, "axle": selection.axle}


def _tie_data(tie: Tie) -> dict[str, Any]:
    return {"ratio": tie.ratio, "axles": list(tie.axles), "lowest": tie.lowest}


def _roots(function: Callable[..., Array]) -> list[float]:
    """Return where a function of the ratio changes sign: brackets first, then Brent's method."""
    from scipy.optimize import brentq  # slow to import

    edges = np.linspace(*RATIOS, 64)
    values = function(edges)
    roots: list[float] = []
    for k in np.flatnonzero(values[:-1] * values[1:] <= 0):
        root = float(brentq(function, edges[k], edges[k + 1], xtol=1e-14))  # pyright: ignore[reportArgumentType]
        if not roots or root - roots[-1] > SAME:
            roots.append(root)
    return roots
