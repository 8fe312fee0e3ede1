"""UMBmark's picture: where odometry said the squares ended, before and after a correction.

Borenstein and Feng, "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", IEEE Trans. Robotics
and Automation 12(6), 1996: return errors of clockwise and counter-clockwise runs, and their centres of gravity.
"""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from benchmarks.scoring.square_metrics import umbmark
from castor_envs.errors import InputError
from castor_envs.rendering.drawing import palette

Runs = tuple[ArrayLike, ArrayLike]
"""Return errors (n, 2 or 3), x, y (m), of clockwise and of counter-clockwise runs (`metrics.return_errors`)."""

WAYS = (("cw", palette.TRUTH, "o"), ("ccw", palette.ESTIMATE, "s"))


def umbmark_scatter(before: Runs, after: Runs) -> Figure:
    """Return a figure of all end points with the centroids of both directions, before (hollow) and after (filled).

    Axes in mm, on one scale; the label of each centroid gives its distance from zero. Raises InputError for directions
    without a run or with errors that are not finite.
    """
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.axhline(0, color=_rgb(palette.AXES), linewidth=0.8, zorder=0)
    axes.axvline(0, color=_rgb(palette.AXES), linewidth=0.8, zorder=0)
    for stage, runs in (("before", before), ("after", after)):
        clusters = [_millimetres(f"{stage}, {way[0]}", errors) for way, errors in zip(WAYS, runs, strict=True)]
        found = umbmark(*clusters)
        for (way, color, marker), points, centroid, distance in zip(
            WAYS, clusters, (found.centroid_cw, found.centroid_ccw), (found.r_cw, found.r_ccw), strict=True
        ):
            rgb = _rgb(color)
            face = "none" if stage == "before" else rgb
            axes.plot([0, centroid[0]], [0, centroid[1]], color=rgb, linewidth=0.8, alpha=0.6, zorder=1)
            axes.scatter(*points.T, s=26, marker=marker, facecolors=face, edgecolors=rgb, label=f"{way} {stage}")
            name = f"{way} {stage}: centroid {distance:.1f} mm off"
            axes.scatter(
                *centroid, s=110, marker="+" if stage == "before" else "x", color=rgb, linewidths=2, label=name
            )
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("return error in x (mm)")
    axes.set_ylabel("return error in y (mm)")
    axes.grid(color=_rgb(palette.GRID), linewidth=0.5)
    axes.set_axisbelow(True)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    return figure


def _millimetres(name: str, errors: ArrayLike) -> np.ndarray:
    """Return x and y (n, 2), mm, after checking them."""
    points = np.asarray(errors, dtype=float)
    if points.ndim != 2 or not points.size or points.shape[1] < 2 or not np.isfinite(points).all():
        raise InputError(f"{name}: give the finite return errors (n, 2) of at least one run")
    return 1e3 * points[:, :2]


def _rgb(color: palette.Color) -> tuple[float, float, float]:
    red, green, blue = color
    return red / 255, green / 255, blue / 255
