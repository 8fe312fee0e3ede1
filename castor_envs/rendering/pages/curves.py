"""Curves for pages, drawn by uPlot in the browser."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array

MOST = 600
"""Points of a curve: a page is not wider."""
ZOOM = "Drag over a stretch to zoom, double-click to undo."
"""What a caption says of curves."""
DIGITS = 5
"""Significant digits of what is drawn."""


class Curve(NamedTuple):
    """One curve: y (k,) against rising x (k,), with a gap where y is NaN. color: 1 to 8, of the style sheet's
    colours."""

    label: str
    x: Array
    y: Array
    color: int
    dash: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves on shared axes. alt: what they show, in words, for who cannot see them."""

    xlabel: str
    ylabel: str
    series: tuple[Curve, ...]
    alt: str
    caption: str

    @property
    def curves(self) -> dict[str, Any]:
        """What the page holds for the script that draws."""
        return {
            "xlabel": self.xlabel,
            "ylabel": self.ylabel,
            "series": [
                {
                    "label": curve.label,
                    "color": f"--c{curve.color}",
                    "dash": curve.dash,
                    **dict(zip("xy", _few(curve.x, curve.y), strict=True)),
                }
                for curve in self.series
            ],
        }


def color_of(k: int) -> int:
    """Return the colour of the series with index k: the eight in turn."""
    return k % 8 + 1


def _few(x: Array, y: Array) -> tuple[list[float], list[float | None]]:
    """Return at most about `MOST` points of a curve, and one without a value (None) for each gap; of each stretch the
    least and the largest value stay."""
    known = np.isfinite(x) & np.isfinite(y)
    keep = np.flatnonzero(known)
    gaps = np.flatnonzero(~known[1:-1] & known[:-2]) + 1
    if len(keep) > MOST:
        parts = np.array_split(keep, MOST // 2)
        keep = np.array([part[end(y[part])] for part in parts for end in (np.argmin, np.argmax)])
    keep = np.union1d(keep, gaps)
    return _rounded(x[keep]), [value if math.isfinite(value) else None for value in _rounded(y[keep])]


def _rounded(values: Sequence[float] | Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in np.asarray(values, dtype=float).tolist()]
