"""How often ranks split boards of equally good estimators, how often intervals cover, and by how much stored scores
spread: tables of docs/benchmark.md.

python scripts/studies/study_ranking.py [--boards 1000] [--samples 2000]
"""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.leaderboard.ranking import FEWEST_CASES, different, intervals, ranks

Draw = Callable[[np.random.Generator, tuple[int, ...]], NDArray[np.float64]]


def correlated(random: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return scores of cases that are hard for all, each estimator's with a factor of 5 % beside."""
    return random.lognormal(0, 1, shape[1:]) * random.lognormal(0, 0.05, shape)


BOARDS: tuple[tuple[str, Draw, tuple[int, ...]], ...] = (
    ("normal", lambda random, shape: random.normal(5, 1, shape), (6, 20)),
    ("log-normal, sigma 1", lambda random, shape: random.lognormal(0, 1, shape), (20, 40)),
    ("cases of unequal difficulty", correlated, (6, 20)),
)
"""Scores (estimators, cases) of equally good estimators, and numbers of cases."""

SCORES: tuple[tuple[str, Draw, float], ...] = (
    ("normal", lambda random, shape: random.normal(0, 1, shape), 0.0),
    ("log-normal, sigma 0.5", lambda random, shape: random.lognormal(0, 0.5, shape), math.exp(0.125)),
    ("log-normal, sigma 1", lambda random, shape: random.lognormal(0, 1, shape), math.exp(0.5)),
    ("log-normal, sigma 1.5", lambda random, shape: random.lognormal(0, 1.5, shape), math.exp(1.125)),
    ("squared normal", lambda random, shape: random.normal(0, 1, shape) ** 2, 1.0),
)
"""Scores of one estimator, and their true mean."""
SAMPLE_SIZES = (6, 10, 20, 40, 100)
RESAMPLES = 999
"""Of the bootstrap: its quantiles at 2.5 and 97.5 % are the 25th smallest and the 25th largest."""
FIGURES = Path(__file__).parents[2] / "docs" / "results.json"
SPREADS = (0.25, 0.5, 1.0, 1.5)
"""Standard deviations of the logarithm of scores over cases that stored results are counted by."""
WIDE = 1.0
"""From here on upper ends are too low by what the page says."""

Ends = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From samples (k, n) to the ends of their intervals (k, 2)."""


def as_on_boards(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ends of the intervals that boards show."""
    found = intervals(samples, [(-math.inf, math.inf)] * len(samples))
    return np.array([(one.low, one.high) for one in found], dtype=float)


def bootstrap_t(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the ends of bootstrap-t intervals (B. Efron, "Nonparametric standard errors and confidence intervals",
    Canadian J. Statistics 9, 1981), for comparison."""
    n = samples.shape[1]
    chosen = np.random.default_rng(0).integers(n, size=(RESAMPLES, n))
    ends = []
    for sample in samples:
        again = sample[chosen]
        scatter = again.std(axis=1, ddof=1)
        t = np.where(scatter > 0, (again.mean(axis=1) - sample.mean()) / np.where(scatter > 0, scatter, 1.0), 0.0)
        ends.append(sample.mean() - np.quantile(t, [0.975, 0.025]) * sample.std(ddof=1))
    return np.array(ends)


def splits(draw: Draw, estimators: int, cases: int, boards: int) -> str:
    """Return in what share of boards ranks differ, and in parentheses that in which any two estimators do."""
    random = np.random.default_rng([estimators, cases])
    tables = [draw(random, (estimators, cases)) for _ in range(boards)]
    ranked = np.mean([len(set(ranks({str(k): row for k, row in enumerate(table)}).values())) > 1 for table in tables])
    told_apart = np.mean([different(table).any() for table in tables])
    return f"{100 * ranked:.1f} ({100 * told_apart:.1f})"


def coverage(draw: Draw, mean: float, cases: int, samples: int, ends: Ends = as_on_boards) -> tuple[float, float]:
    """Return in what share of samples, %, the interval covers the true mean, and in what share it ends below it."""
    low, high = ends(draw(np.random.default_rng(cases), (samples, cases))).T
    return 100 * float(np.mean((low <= mean) & (mean <= high))), 100 * float(np.mean(high < mean))


def spreads(figures: dict[str, Any]) -> list[tuple[str, str, float]]:
    """Return the standard deviation of the logarithm of scores over cases, of each row with enough cases for intervals.

    figures: of docs/results.json. Rows, by task and estimator, with a score of 0 are left out.
    """
    found = []
    for task in figures["tasks"]:
        for row in task["estimators"]:
            scores = np.array([score for score in row["by_case"] if score is not None])
            if len(scores) >= FEWEST_CASES and (scores > 0).all():
                found.append((task["task"], row["estimator"], float(np.std(np.log(scores), ddof=1))))
    return found


def spread_lines(figures: dict[str, Any]) -> list[str]:
    """Return a table of how many rows spread by how much, and a line of the tasks that have the widest."""
    rows = spreads(figures)
    counts, _ = np.histogram([size for *_, size in rows], [0.0, *SPREADS, math.inf])
    wide = sorted({task for task, _, size in rows if size > WIDE})
    return [
        f"| standard deviation of log scores over cases | {' | '.join(f'up to {s:g}' for s in SPREADS)} | above |",
        f"|---|{'--:|' * (len(SPREADS) + 1)}",
        f"| rows, of {len(rows)} | {' | '.join(map(str, counts))} |",
        f"above {WIDE:g} in: {', '.join(wide)}",
    ]


def main() -> None:
    """Print the tables in Markdown; shares are in per cent."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--boards", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=2000)
    options = parser.parse_args()
    sizes = (2, 9)
    print(f"| scores | {' | '.join(f'{size} estimators' for size in sizes)} |\n|---|{'--:|' * len(sizes)}")
    for name, draw, numbers in BOARDS:
        for cases in numbers:
            cells = (splits(draw, size, cases, options.boards) for size in sizes)
            print(f"| {name}, {cases} cases | {' | '.join(cells)} |", flush=True)
    print(f"\n| scores | {' | '.join(f'{n} cases' for n in SAMPLE_SIZES)} |\n|---|{'--:|' * len(SAMPLE_SIZES)}")
    name, draw, mean = next(row for row in SCORES if row[0].endswith("1.5"))
    for label, drawn, true, ends in (
        *((*row, as_on_boards) for row in SCORES),
        (f"{name}, by bootstrap-t", draw, mean, bootstrap_t),
    ):
        cells = (coverage(drawn, true, n, options.samples, ends) for n in SAMPLE_SIZES)
        print(f"| {label} | {' | '.join(f'{within:.1f} ({below:.1f})' for within, below in cells)} |", flush=True)
    print()
    print("\n".join(spread_lines(json.loads(FIGURES.read_text(encoding="utf-8")))))


if __name__ == "__main__":
    main()
