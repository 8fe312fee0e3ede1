"""Pictures for Vogt's tables: the four configurations as in the paper's Figs. 5 and 6, and where the metrics fail."""

import io
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.papers.failure_modes import METRICS, RATIOS, SWEEPS, Sweep, ties
from benchmarks.papers.vogt import selected_axle
from benchmarks.tasks.static_tests import STATIC_TESTS, StaticTest
from castor_envs.errors import InputError
from castor_envs.files import write_atomically, writing
from castor_envs.geometry.arrays import Array
from castor_envs.rendering.drawing import palette
from estimators.trains import grpec

#: m, drawn: half an axle, and a wheel's radius.
HALF_TRACK, WHEEL = 0.05, 0.02
#: Height of a row of panels, inches.
ROW = 2.4
UNITS = {"theta_xy": ("m", 1.0), "theta_phi": ("deg", 180 / np.pi), "theta_dev": ("deg", 180 / np.pi)}
Style = dict[str, Any]


def _rgb(color: palette.Color) -> tuple[float, ...]:
    return tuple(part / 255 for part in color)


INK, FADED = _rgb(palette.INK), _rgb(palette.FADED)
TRUTH: Style = {"color": _rgb(palette.SLIPPERY), "linewidth": 7, "alpha": 0.45, "solid_capstyle": "round"}
ODOMETRY: Style = {"color": INK, "linewidth": 1.6}
RELATIVE: Style = {"color": _rgb(palette.ESTIMATE), "linewidth": 1.6, "linestyle": (0, (4, 2))}
CORRECTED: Style = {"color": _rgb(palette.ESTIMATE), "linewidth": 2.4}
AXLES: tuple[Style, ...] = (
    {"color": _rgb(palette.TRUTH), "linewidth": 2.0},
    {"color": _rgb(palette.ESTIMATE), "linewidth": 2.0, "linestyle": (0, (6, 2))},
    {"color": _rgb(palette.ROUGH), "linewidth": 2.0, "linestyle": (0, (2, 1.5))},
)


def write_figures(folder: Path) -> list[Path]:
    """Write all figures as PNG files and return their paths; raises InputError where they cannot be written."""
    written = []
    with writing(f"--figures {folder}"):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise InputError(f"--figures {folder}: a file is in the folder's place; name another folder") from None
        for name, figure in _figures():
            buffer = io.BytesIO()
            FigureCanvasAgg(figure)
            figure.savefig(buffer, format="png", metadata={"Software": None})
            write_atomically(folder / name, buffer.getvalue())
            written.append(folder / name)
    return written


def _figures() -> Iterator[tuple[str, Figure]]:
    yield "failure-modes.png", failure_modes()
    for test in STATIC_TESTS:
        yield f"configuration-test-{test.number}.png", configuration(test)


def configuration(test: StaticTest) -> Figure:
    """Draw a static test: on the left odometry, the relative poses attached to each axle, and the truth.

    On the right the vectors between neighbouring axles (thin) and from the last to the first (thick), whose angle is
    theta_dev, as in the paper's Fig. 5.
    """
    figure = Figure(figsize=(8, 3 * ROW + 2.3), dpi=100, layout="constrained")
    panels = figure.subplots(3, 2, sharex=True, sharey=True)
    errors = grpec.errors(test.odometry, test.relative)
    selected = selected_axle(test, "theta_xy")
    for axle, poses in enumerate(grpec.attached(test.odometry, test.relative), start=1):
        left, right = panels[axle - 1]
        style = CORRECTED if axle == selected else RELATIVE
        _train(left, test.truth, TRUTH)
        _train(left, test.odometry, ODOMETRY)
        _train(left, poses, style)
        phi = np.degrees(errors.theta_phi[axle - 1])
        values = f"theta_xy {errors.theta_xy[axle - 1]:.3f} m   theta_phi {phi:.1f} deg"
        mark = "; selected by theta_xy: corrected" if axle == selected else ""
        left.set_title(f"attached to axle {axle}{mark}\n{values}", fontsize=10)
        for poses_of, vectors in ((test.odometry, ODOMETRY), (poses, style)):
            _vectors(right, poses_of, vectors)
        right.set_title(f"deviation vectors\ntheta_dev {np.degrees(errors.theta_dev[axle - 1]):.1f} deg", fontsize=10)
    for axes in panels.flat:
        axes.set_aspect("equal")
        axes.grid(color="#e8e6e0", linewidth=0.6)
        axes.set_axisbelow(True)
    for axes in panels[:, 0]:
        axes.set_ylabel("y, m")
    for axes in panels[-1]:
        axes.set_xlabel("x, m")
    known = (
        ("odometry", ODOMETRY),
        ("relative poses, attached", RELATIVE),
        ("the same, selected: corrected", CORRECTED),
        (f"true (axle {test.true_axle} is right)", TRUTH),
    )
    handles = [panels[0, 0].plot([], [], **style, label=label)[0] for label, style in known]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    span = np.ptp(panels[0, 0].axis()[:2]) / np.ptp(panels[0, 0].axis()[2:])
    figure.set_figwidth(max(8.0, 2 * ROW * span + 1.0))
    figure.suptitle(f"Test {test.number}: {test.description}", fontsize=12)
    return figure


def failure_modes() -> Figure:
    """Draw the error of every attachment against the ratio of the frames' curvatures, with the ties."""
    figure = Figure(figsize=(11, 9), dpi=100, layout="constrained")
    panels = figure.subplots(len(METRICS), len(SWEEPS), sharex=True, sharey="row")
    for row, metric in zip(panels, METRICS, strict=True):
        for axes, sweep in zip(row, SWEEPS, strict=True):
            _sweep(axes, sweep, metric)
        row[0].set_ylabel(f"{metric}, {UNITS[metric][0]}")
    for axes, sweep in zip(panels[0], SWEEPS, strict=True):
        axes.set_title(f"{sweep.title} (test {sweep.test.number})", fontsize=11)
    for axes, sweep in zip(panels[-1], SWEEPS, strict=True):
        kept, swept = ("A", "B") if sweep.keeps == 0 else ("B", "A")
        axes.set_xlabel(f"curvature of frame {swept} / curvature of frame {kept}, magnitudes")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    return figure


def _sweep(axes: Axes, sweep: Sweep, metric: str) -> None:
    ratios = np.linspace(*RATIOS, 401)
    scale = UNITS[metric][1]
    errors = scale * sweep.errors(metric, ratios)
    for axle, style in enumerate(AXLES, start=1):
        axes.plot(ratios, errors[:, axle - 1], **style, label=f"attached to axle {axle}")
    axes.axvline(sweep.claimed, color=FADED, linewidth=1.2, linestyle=":", label="the paper says it fails")
    axes.axvline(sweep.test_ratio, color=FADED, linewidth=1.0, alpha=0.6, label="the test itself")
    for tie in ties(sweep, metric):
        height = scale * sweep.errors(metric, tie.ratio)[tie.axles[0] - 1]
        face = INK if tie.lowest else "white"
        label = "tie (filled: of the lowest)" if metric == METRICS[0] else None
        axes.plot(tie.ratio, height, "o", color=INK, markerfacecolor=face, markersize=7, linestyle="none", label=label)
        axes.annotate(f"{tie.ratio:.3f}", (tie.ratio, height), (-8, 8), textcoords="offset points", ha="right")
    axes.grid(color="#e8e6e0", linewidth=0.6)
    axes.set_ylim(bottom=0)


def _train(axes: Axes, poses: Array, style: Style) -> None:
    """Draw frames as cubic curves that leave both axles along x, axles as bars with a wheel at each end."""
    for front, rear in pairwise(poses):
        axes.plot(*_curve(rear, front).T, **style)
    bar = {**style, "linestyle": "-", "linewidth": 1.5 * style["linewidth"]}
    for x, y, psi in poses:
        ahead, aside = np.array([np.cos(psi), np.sin(psi)]), np.array([-np.sin(psi), np.cos(psi)])
        ends = [np.array([x, y]) + side * HALF_TRACK * aside for side in (-1, 1)]
        axes.plot(*np.transpose(ends), **bar)
        for end in ends:
            axes.plot(*np.transpose([end - WHEEL * ahead, end + WHEEL * ahead]), **bar)


def _curve(start: Array, end: Array) -> Array:
    """Return points (K, 2) of the cubic Hermite curve between two poses, along x at both."""
    t = np.linspace(0, 1, 40)[:, None]
    chord = np.hypot(*(end - start)[:2])
    out, into = (chord * np.array([np.cos(pose[2]), np.sin(pose[2])]) for pose in (start, end))
    return (
        (2 * t**3 - 3 * t**2 + 1) * start[:2]
        + (t**3 - 2 * t**2 + t) * out
        + (3 * t**2 - 2 * t**3) * end[:2]
        + (t**3 - t**2) * into
    )


def _vectors(axes: Axes, poses: Array, style: Style) -> None:
    color = style["color"]
    axes.plot(poses[:, 0], poses[:, 1], color=color, linewidth=0.9, marker="o", markersize=3)
    tip, tail = tuple(poses[0, :2]), tuple(poses[-1, :2])
    arrow = {"arrowstyle": "-|>", "color": color, "linewidth": 2.4, "linestyle": "--", "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tip, tail, arrowprops=arrow)
