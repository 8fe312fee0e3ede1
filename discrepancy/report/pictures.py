"""Pictures for the report: traces and replays as SVG to embed in a page.

The same input gives the same bytes. Grey: the robot file as given; the accent colour: with the effects found.
"""

import io
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from castor_envs.geometry.arrays import Array
from castor_envs.rendering.drawing.palette import AXES, ESTIMATE, FADED, GRID, INK, TRUTH, WHITE, Color
from discrepancy.report.traces import Errors, Traces
from discrepancy.validation.replay import Replay

Shown = TypeVar("Shown", Traces, Replay)

_ANGLES = {"own angle": "angle of the encoder's shaft", "castor angle": "angle of the castor"}

WIDTH = 5.6
"""Inches; text of 9 points can then be read on a phone."""

SHOWN = 8
"""Candidates, the best ones."""


def _hex(color: Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


BEFORE, AFTER = "#9b978c", _hex(TRUTH)
SIGNED = LinearSegmentedColormap.from_list("signed", [_hex(color) for color in (ESTIMATE, WHITE, TRUTH)])
PLAIN = LinearSegmentedColormap.from_list("plain", ["#e9e7e0", _hex(TRUTH)])

STYLE: Any = {
    "font.size": 9.0,
    "font.family": "DejaVu Sans",
    "svg.fonttype": "path",
    "axes.edgecolor": _hex(AXES),
    "axes.labelcolor": _hex(INK),
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "grid.color": _hex(GRID),
    "grid.linewidth": 0.4,
    "xtick.color": _hex(FADED),
    "ytick.color": _hex(FADED),
    "text.color": _hex(INK),
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


@dataclass(frozen=True)
class Picture:
    """name: which section of the report it belongs to. svg: an <svg> element. alt: what it shows, for who cannot see
    it. caption: what to read from it."""

    name: str
    svg: str
    alt: str
    caption: str


def drift(groups: Mapping[str, tuple[Sequence[Errors], Sequence[Errors]]]) -> Picture | None:
    """Return by how much odometry is off the reference, along the way; None where there is no reference.

    groups: a column each, by what it is of: the errors in its logs, as described and, if any, with what was found.
    """
    seen = {title: pair for title, pair in groups.items() if any(len(errors.off) for errors in pair[0])}
    if not seen:
        return None
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
        grid = figure.subplots(2, len(seen), squeeze=False, sharex="col", sharey="row")
        for (title, pair), (position, heading) in zip(seen.items(), grid.T, strict=True):
            for several, color, label in zip(pair, (BEFORE, AFTER), ("as described", "with robot.json"), strict=True):
                for k, (way, off) in enumerate(several):
                    away = 1e3 * np.hypot(off[:, 0], off[:, 1])
                    position.plot(way, away, color=color, label="_" if k else label)
                    heading.plot(way, 1e3 * off[:, 2], color=color)
            heading.set_xlabel(f"driven, m ({title})" if len(seen) > 1 else "driven, m")
        grid[0, 0].set_ylim(bottom=0)
        grid[0, 0].set_ylabel("position off by, mm")
        grid[1, 0].set_ylabel("heading, mrad")
        _legend_above(grid[0, 0])
        svg = _svg(figure, "drift")
    found = any(mended for _, mended in seen.values())
    said = [
        f"{title}, {' and '.join(f'{_rms_mm(errors):.2f} mm' for errors in pair if errors)} rms"
        for title, pair in seen.items()
    ]
    return Picture(
        "drift",
        svg,
        f"How far odometry is off the reference along the way, as described{' and with robot.json' * found}: "
        f"{'; '.join(said)}.",
        "How far odometry with predicted creep is off the reference, against the distance driven: a line for each log; "
        "their rms is in the table. Vertical strokes are turns on the spot. Odometry begins at the likeliest pose, "
        "which need not be the reference's first." + " Grey: the robot file as given; blue: with robot.json." * found,
    )


def slip(before: Traces, after: Traces | None = None) -> Picture:
    """Return which channel slips when, as a map of channels and time."""
    shown = list(_both(before, after, "as described", "with robot.json"))
    rows = len(before.channels)
    top = float(max(np.percentile(np.abs(before.slip), 99), 1e-6))
    with mpl.rc_context({**STYLE, "axes.grid": False}):
        figure, rows_of_axes = _figure(0.5 + (0.35 + 0.19 * rows) * len(shown), len(shown))
        scale = ScalarMappable(Normalize(-1e3 * top, 1e3 * top), SIGNED)
        for axes, (traces, _, label) in zip(rows_of_axes, shown, strict=True):
            colors = scale.to_rgba(1e3 * traces.slip.T)
            axes.pcolorfast(_edges(traces.middle), np.arange(rows + 1.0), colors)
            axes.set_yticks(np.arange(rows) + 0.5, traces.channels, fontsize=7.5)
            axes.invert_yaxis()
            axes.tick_params(length=0)
            axes.set_title(label)
        rows_of_axes[-1].set_xlabel("time, s")
        bar = figure.colorbar(scale, ax=rows_of_axes, shrink=0.8, pad=0.02, aspect=30)
        bar.set_label("mm of slip in a second")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        svg = _svg(figure, "slip")
    worst = before.worst()
    return Picture(
        "slip",
        svg,
        f"A map of slip by channel and time{_also(after)}; most of it in {worst['channel']}, and at its largest, "
        f"{1e3 * worst['most_slip_m']:.2g} mm, at {worst['at_s']:.0f} s.",
        "By how much each wheel's rolling and each castor's side motion miss perfect rolling. One row that stands "
        "out is a wheel or castor; one column, an event.",
    )


def floor(before: Traces) -> Picture:
    """Return where on the floor wheels slip."""
    size = 1e3 * np.sqrt(np.mean(before.slip**2, axis=1))
    with mpl.rc_context(STYLE):
        figure, (axes,) = _figure(3.4, 1)
        axes.plot(before.path[:, 0], before.path[:, 1], color=_hex(GRID), linewidth=0.8, zorder=1)
        order = np.argsort(size)
        x, y = before.place[order].T
        points = axes.scatter(x, y, c=size[order], s=18, cmap=PLAIN, linewidths=0, vmin=0, zorder=2)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x, m")
        axes.set_ylabel("y, m")
        bar = figure.colorbar(points, ax=axes, shrink=0.8, pad=0.02, aspect=30)
        bar.set_label("mm of slip in a second (rms)")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        svg = _svg(figure, "floor")
    worst = before.worst()
    return Picture(
        "floor",
        svg,
        f"Slip on a map of the floor; most near x {worst['x_m']:.2f}, y {worst['y_m']:.2f} m.",
        "Slip where it happened. Dark points close together are a place on the floor; evenly spread ones, the robot.",
    )


def probabilities(names: Sequence[tuple[str, float, str]], named: Sequence[str] = ()) -> Picture:
    """Return how likely each name is, the likeliest first: (name, probability, how that is written).

    named: the names that are given to what is missing.
    """
    best = sorted(names, key=lambda entry: -entry[1])[:SHOWN]
    svg = _bars("probabilities", [(name, 100 * part, said) for name, part, said in best], named, "probability, %", 100)
    told = ", ".join(f"{name} {said}" for name, _, said in best)
    return Picture(
        "probabilities",
        svg,
        f"Bars of the probability of every name: {told}.",
        "How likely it is that each of these is among what is missing."
        + (" Blue: what is named." if any(name in named for name, _, _ in best) else ""),
    )


def learned_curve(what: str, curve: Mapping[str, Any]) -> Picture:
    """Return by how much an encoder reads too much, against the quantity that this depends on, with its 95 % band.

    curve: as in a diagnosis' data: of, unit ("rad" or "rad/s"), knots, and values, low and high at these. Between knots
    it is straight; by angle it goes on after a turn as it began.
    """
    at, *heights = (np.array(curve[key]) for key in ("knots", "values", "low", "high"))
    by_speed = curve["unit"] == "rad/s"
    label = "speed of the encoder's shaft, rad/s" if by_speed else f"{_ANGLES[curve['of']]}, degrees"
    if not by_speed:
        at = np.degrees(np.append(at, at[0] + 2 * np.pi))
        heights = [np.append(height, height[0]) for height in heights]
    value, low, high = (100 * height for height in heights)
    with mpl.rc_context(STYLE):
        figure, (axes,) = _figure(2.6, 1)
        axes.axhline(0, color=BEFORE, linewidth=0.8)
        axes.fill_between(at, low, high, color=AFTER, alpha=0.2, linewidth=0, label="95 % band")
        axes.plot(at, value, "o-", color=AFTER, markersize=3.5, label="learned from the logs")
        if not by_speed:
            axes.set_xticks(at[0] + np.arange(0, 361, 60))
        axes.margins(x=0.02)
        axes.set_xlabel(label)
        axes.set_ylabel("reads too much by, %")
        _legend_above(axes)
        svg = _svg(figure, "curve")
    top, bottom = int(np.argmax(value)), int(np.argmin(value))
    unit = "rad/s" if by_speed else "degrees"
    return Picture(
        "curve",
        svg,
        f"A curve against {label}: {what} reads too much by {value[bottom]:+.2f} % at {at[bottom]:.3g} {unit} up to "
        f"{value[top]:+.2f} % at {at[top]:.3g} {unit}.",
        f"By how much the encoder reads too much, against the {label.partition(',')[0]}, as learned from the logs: "
        "points at the knots that are in the robot file, and the band that holds it with 95 %. Where the band is wide, "
        "the logs hardly show it.",
    )


def replays(before: Replay, after: Replay | None = None) -> Picture:
    """Return by how much the simulation misses the measurement in every window: motion and encoders."""
    shown = list(_both(before, after, "as described", "with robot.json"))
    posed = bool(np.isfinite(before.body).any())
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4 if posed else 2.0), layout="constrained")
        kinds = {
            "wheels": ("wheel counts, mm", before.wheel_names),
            "pivots": ("pivot counts, mrad", before.pivot_names),
        }
        kinds = {kind: told for kind, told in kinds.items() if told[1]}
        rows = figure.add_gridspec(2 if posed else 1, 1)
        lower = rows[-1].subgridspec(1, len(kinds), width_ratios=[1 + len(names) for _, names in kinds.values()])
        encoder_axes = [figure.add_subplot(lower[k]) for k in range(len(kinds))]
        top = figure.add_subplot(rows[0]) if posed else encoder_axes[0]
        if posed:
            for replay, color, label in shown:
                position = 1e3 * np.hypot(replay.body[:, 0], replay.body[:, 1])
                top.plot(np.arange(1, len(position) + 1), position, "o-", color=color, markersize=3, label=label)
            top.set_ylabel("position, mm")
            top.set_xlabel("window")
            top.xaxis.set_major_locator(MaxNLocator(integer=True))
            top.set_ylim(bottom=0)
        for axes, (kind, (label, names)) in zip(encoder_axes, kinds.items(), strict=True):
            width = 0.8 / len(shown)
            for k, (replay, color, replay_label) in enumerate(shown):
                gaps = 1e3 * np.sqrt(np.mean(getattr(replay, kind) ** 2, axis=0))
                axes.bar(
                    np.arange(len(names)) - 0.4 + width * (k + 0.5), gaps, width * 0.9, color=color, label=replay_label
                )
            axes.set_xticks(np.arange(len(names)), [name.partition("_")[2] for name in names])
            axes.grid(visible=False, axis="x")
            axes.set_ylabel(label)
        _legend_above(top)
        svg = _svg(figure, "replay")
    return Picture(
        "replay",
        svg,
        f"The gap between simulation and measurement in {len(before.start)} windows{_also(after)}, and by encoder.",
        "How far the simulated robot ends up from the measured one after each window, and what its encoders count "
        "beyond the measured ones (rms).",
    )


def _bars(
    name: str, bars: Sequence[tuple[str, float, str]], named: Sequence[str], label: str, longest: float | None = None
) -> str:
    """Return bars, each with what it is of, its length and what is written at its end; the named in colour."""
    with mpl.rc_context({**STYLE, "axes.grid": False}):
        names = [_plain(bar_name) for bar_name, _, _ in bars]
        figure, (axes,) = _figure(0.55 + 0.2 * len(bars) + 0.11 * sum(bar_name.count("\n") for bar_name in names), 1)
        colors = [AFTER if bar_name in named else "#c9c6bd" for bar_name, _, _ in bars]
        axes.barh(np.arange(len(bars)), [length for _, length, _ in bars], color=colors, height=0.62)
        axes.set_yticks(np.arange(len(bars)), names, fontsize=7.5)
        for row, (_, length, said) in enumerate(bars):
            axes.annotate(said, (length, row), (3, 0), textcoords="offset points", va="center", fontsize=7.5)
        axes.invert_yaxis()
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel(label)
        axes.margins(x=0.1)
        if longest is not None:
            axes.set_xlim(0, 1.15 * longest)
            axes.set_xticks(np.linspace(0, longest, 6))
        return _svg(figure, name)


def _both(before: Shown, after: Shown | None, first: str, second: str) -> list[tuple[Shown, str, str]]:
    return [(before, BEFORE, first)] + ([] if after is None else [(after, AFTER, second)])


def _also(after: object) -> str:
    return " as described" if after is None else " as described and with robot.json"


def _rms_mm(errors: Sequence[Errors]) -> float:
    off = np.concatenate([log.off for log in errors])
    return 1e3 * float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))))


def _plain(text: str) -> str:
    """Return text that matplotlib does not take for mathematics, in short lines."""
    lines = textwrap.wrap(text, 34, max_lines=2, placeholder=" \N{HORIZONTAL ELLIPSIS}")
    return "\n".join(lines).replace("$", r"\$")


def _edges(middle: Array) -> Array:
    if len(middle) < 2:
        return np.array([middle[0] - 0.5, middle[0] + 0.5])
    half_way = (middle[1:] + middle[:-1]) / 2
    return np.concatenate([[2 * middle[0] - half_way[0]], half_way, [2 * middle[-1] - half_way[-1]]])


def _figure(height: float, rows: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False)
    return figure, list(axes[:, 0])


def _legend_above(axes: Axes) -> None:
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2, handlelength=1.4)


def _svg(figure: Figure, name: str) -> str:
    """Return a figure as an element to stand in a page: its ids begin with a name of their own, no address in it."""
    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(out, format="svg", metadata={"Date": None}, transparent=True)
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)
    svg = svg.replace("xlink:href", "href")
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'href="#', f'href="#{name}-', svg)
    svg = svg.replace("url(#", f"url(#{name}-")
    # The page sets the width; the view box keeps the proportions.
    svg = re.sub(r'^<svg([^>]*?) width="[^"]*"', r"<svg\1", svg)
    svg = re.sub(r'^<svg([^>]*?) height="[^"]*"', r"<svg\1", svg)
    return svg.strip()
