"""How often ranks split boards of equally good estimators, and how often intervals cover: tables of docs/benchmark.md.

python scripts/studies/study_ranking.py [--boards 1000] [--samples 2000]
"""

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.leaderboard.ranking import different, interval, ranks

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
    ("log-normal, sigma 0.5", lambda random, shape: random.lognormal(0, 0.5, shape), float(np.exp(0.125))),
    ("squared normal", lambda random, shape: random.normal(0, 1, shape) ** 2, 1.0),
)
"""Scores of one estimator, and their true mean."""


def splits(draw: Draw, estimators: int, cases: int, boards: int) -> str:
    """Return in what share of boards ranks differ, and in parentheses that in which any two estimators do."""
    random = np.random.default_rng([estimators, cases])
    tables = [draw(random, (estimators, cases)) for _ in range(boards)]
    ranked = np.mean([len(set(ranks({str(k): row for k, row in enumerate(table)}).values())) > 1 for table in tables])
    told_apart = np.mean([different(table).any() for table in tables])
    return f"{100 * ranked:.1f} ({100 * told_apart:.1f})"


def coverage(draw: Draw, mean: float, cases: int, samples: int) -> str:
    """Return in what share of samples the interval covers the true mean."""
    random = np.random.default_rng(cases)
    limits = (interval(draw(random, (cases,))) for _ in range(samples))
    covered = [found.low is not None and found.high is not None and found.low <= mean <= found.high for found in limits]
    return f"{100 * np.mean(covered):.1f}"


def main() -> None:
    """Print both tables in Markdown, in per cent."""
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
    numbers = (6, 10, 20, 40)
    print(f"\n| scores | {' | '.join(f'{cases} cases' for cases in numbers)} |\n|---|{'--:|' * len(numbers)}")
    for name, draw, mean in SCORES:
        cells = (coverage(draw, mean, cases, options.samples) for cases in numbers)
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
