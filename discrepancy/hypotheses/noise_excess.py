"""Logs that are noisier than clean ones, though no candidate tells why."""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from discrepancy.hypotheses.candidates import Candidate
from discrepancy.inference.evidence import Evidence
from discrepancy.inference.findings import Rank

LOUDER, MUCH_LOUDER, SURELY = 1.5, 2.25, 5.0
"""So many times more noise than in clean logs is a discrepancy, if the held-out logs have it too, or there are none;
if it is so by so many standard errors."""

PART = 0.01
"""Of the squares of noise beyond clean logs', what must be left beside effects: large ones are never wholly right."""

TOLD = {
    "along": ("slip along", "mm after 1 m"),
    "across": ("slip to the side", "mm after 1 m"),
    "position": ("noise of the reference's position", "mm"),
    "heading": ("noise of the reference's heading", "mrad"),
}
"""What every field of `Noise` is, and its thousandth."""


def louder_than(good: Evidence, first: Evidence, left: Evidence, held: Callable[[], Evidence] | None) -> Rank | None:
    """Return that what effects leave of logs is noisier than clean ones; None if it is not.

    first: evidence before any effect; held: what is left of held-out logs, which have to be noisier too.
    """
    louder = {
        name: ratio
        for name, ratio in ratios(good, left, LOUDER if held else MUCH_LOUDER).items()
        if ratio**2 - 1 > PART * ((getattr(first.noise, name) / getattr(good.noise, name)) ** 2 - 1)
    }
    if louder and held is not None:
        also = ratios(good, held(), LOUDER)
        louder = {name: ratio for name, ratio in louder.items() if name in also}
    if not louder:
        return None
    name = max(louder, key=louder.__getitem__)
    (what, unit), size, usual = TOLD[name], getattr(left.noise, name), getattr(good.noise, name)
    count, ratio = _counted(left, name), louder[name]
    gain = float(count * (ratio**2 - 1 - 2 * np.log(ratio)))
    said = f"{what} of {1e3 * size:.2g} {unit}, {1e3 * usual:.2g} in the clean logs"
    return Rank(Candidate(said), gain, gain, 0.0, (size,), (size / np.sqrt(2 * count),))


def ratios(good: Evidence, seen: Evidence, least: float) -> dict[str, float]:
    """Return how many times larger each size of noise is that surely is so, by so many times at least."""
    found = {}
    for name, size in asdict(seen.noise).items():
        counts = _counted(seen, name), _counted(good, name)
        ratio = size / getattr(good.noise, name)
        if all(counts) and np.log(ratio) > max(np.log(least), SURELY * np.sqrt(sum(1 / (2 * n) for n in counts))):
            found[name] = ratio
    return found


def _counted(seen: Evidence, name: str) -> int:
    """Return how many errors a size of noise is found from."""
    return {"position": 2 * seen.poses, "heading": seen.poses}.get(name, seen.steps)
