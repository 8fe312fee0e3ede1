"""Pictures for the report: traces and replays as SVG.

The same input gives the same bytes. Grey: the robot file as given; the accent colour: with the effects found.
"""

import io
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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
from discrepancy.report.parts import MILLI, PERCENT
from discrepancy.report.traces import Errors, Traces
from discrepancy.validation.cost import gap_of
from discrepancy.validation.replay import Replay

Shown = TypeVar("Shown", Traces, Replay)

ABSCISSAE = {
    "own angle": "angle of the encoder's shaft, degrees",
    "castor angle": "angle of the castor, degrees",
    "speed": "speed of the encoder's shaft, rad/s",
}
"""What a learned curve depends on."""

STATES = ("as described", "with robot.json")

WIDTH = 5.6
"""Inches; text of 9 points can then be read on a phone."""

SHOWN = 8
"""Candidates, the best ones."""


def _hex(color: Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


BEFORE, AFTER, OTHERS = "#9b978c", _hex(TRUTH), "#c9c6bd"
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
    "axes.titlesize": "medium",
    "axes.titlelocation": "left",
    "grid.color": _hex(GRID),
    "grid.linewidth": 0.4,
    "xtick.color": _hex(FADED),
    "ytick.color": _hex(FADED),
    "text.color": _hex(INK),
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.markersize": 3,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


@dataclass(frozen=True)
class Picture:
    """name: which section of the report it belongs to. svg: a whole SVG file. alt: what it shows, for who cannot see
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
    gaps = {title: [gap_of(log.off for log in errors) for errors in pair] for title, pair in seen.items()}
    rms = {title: [f"{MILLI * gap[0]:.2f} mm" for gap in pair if gap] for title, pair in gaps.items()}
    headed = any(np.isfinite(errors.off[:, 2]).any() for pair in seen.values() for errors in pair[0])
    with _drawing(3.8 if headed else 2.4) as figure:
        grid = figure.subplots(2 if headed else 1, len(seen), squeeze=False, sharex="col", sharey="row")
        for (title, pair), (position, *headings) in zip(seen.items(), grid.T, strict=True):
            for several, color, label in zip(pair, (BEFORE, AFTER), STATES, strict=True):
                for k, (way, off) in enumerate(several):
                    away = MILLI * np.hypot(off[:, 0], off[:, 1])
                    position.plot(way, away, color=color, label="_" if k else label)
                    for heading in headings:
                        heading.plot(way, MILLI * off[:, 2], color=color)
            lowest = [position, *headings][-1]
            lowest.set_xlabel(f"driven, m ({title})" if len(seen) > 1 else "driven, m")
            position.set_title(f"rms {', then '.join(rms[title])}", loc="right", fontsize="small", color=_hex(FADED))
        grid[0, 0].set_ylim(bottom=0)
        grid[0, 0].set_ylabel("position off by, mm")
        if headed:
            grid[1, 0].set_ylabel("heading, mrad")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2, handlelength=1.4)
    found = any(mended for _, mended in seen.values())
    said = "; ".join(f"{title}, {' and '.join(values)} rms" for title, values in rms.items())
    return _picture(
        figure,
        "drift",
        f"How far odometry is off the reference along the way, as described{' and with robot.json' * found}: {said}.",
        "How far odometry with predicted creep is off the reference, against the distance driven: a line for each log; "
        "their rms is in the table. Vertical strokes are turns on the spot. Odometry begins at the likeliest pose, "
        "which need not be the reference's first." + " Grey: the robot file as given; blue: with robot.json." * found,
    )


def slip(before: Traces, after: Traces | None = None) -> Picture:
    """Return which channel slips when, as a map of channels and time."""
    shown, rows = _both(before, after), len(before.channels)
    top = float(max(np.percentile(np.abs(before.slip), 99), 1e-6))
    with _drawing(0.5 + (0.35 + 0.19 * rows) * len(shown), grid=False) as figure:
        maps = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
        scale = ScalarMappable(Normalize(-MILLI * top, MILLI * top), SIGNED)
        for axes, (traces, _, label) in zip(maps, shown, strict=True):
            axes.pcolorfast(_edges(traces.middle), np.arange(rows + 1.0), scale.to_rgba(MILLI * traces.slip.T))
            axes.set_yticks(np.arange(rows) + 0.5, traces.channels, fontsize="small")
            axes.invert_yaxis()
            axes.tick_params(length=0)
            axes.set_title(label)
        maps[-1].set_xlabel("time, s")
        _color_bar(figure, scale, list(maps), "mm of slip in a second")
    worst = before.worst()
    return _picture(
        figure,
        "slip",
        f"A map of slip by channel and time{_also(after)}; most of it in {worst['channel']}, and at its largest, "
        f"{MILLI * worst['most_slip_m']:.2g} mm, at {worst['at_s']:.0f} s.",
        "By how much each wheel's rolling and each castor's side motion miss perfect rolling. One row that stands "
        "out is a wheel or castor; one column, an event.",
    )


def floor(before: Traces) -> Picture:
    """Return where on the floor wheels slip."""
    size = MILLI * np.sqrt(np.mean(before.slip**2, axis=1))
    with _drawing(3.4) as figure:
        axes, order = figure.subplots(), np.argsort(size)
        axes.plot(before.path[:, 0], before.path[:, 1], color=_hex(GRID), linewidth=0.8, zorder=1)
        x, y = before.place[order].T
        points = axes.scatter(x, y, c=size[order], s=18, cmap=PLAIN, linewidths=0, vmin=0, zorder=2)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x, m")
        axes.set_ylabel("y, m")
        _color_bar(figure, points, [axes], "mm of slip in a second (rms)")
    worst = before.worst()
    return _picture(
        figure,
        "floor",
        f"Slip on a map of the floor; most near x {worst['x_m']:.2f}, y {worst['y_m']:.2f} m.",
        "Slip where it happened. Dark points close together are a place on the floor; evenly spread ones, the robot.",
    )


def probabilities(names: Sequence[tuple[str, float, str]], named: Sequence[str] = ()) -> Picture:
    """Return how likely each name is, the likeliest first: (name, probability, how that is written).

    named: the names that are given to what is missing.
    """
    best = sorted(names, key=lambda entry: -entry[1])[:SHOWN]
    labels, rows = [_short(name) for name, _, _ in best], np.arange(len(best))
    with _drawing(0.55 + 0.2 * len(best) + 0.11 * sum(label.count("\n") for label in labels), grid=False) as figure:
        axes = figure.subplots()
        colors = [AFTER if name in named else OTHERS for name, _, _ in best]
        bars = axes.barh(rows, [PERCENT * part for _, part, _ in best], color=colors, height=0.62)
        axes.bar_label(bars, [said for _, _, said in best], padding=3, fontsize="small")
        axes.set_yticks(rows, labels, fontsize="small")
        axes.invert_yaxis()
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("probability, %")
        axes.set_xlim(0, 115)
        axes.set_xticks(np.arange(0, 101, 20))
    return _picture(
        figure,
        "probabilities",
        f"Bars of the probability of every name: {', '.join(f'{name} {said}' for name, _, said in best)}.",
        "How likely it is that each of these is among what is missing."
        + (" Blue: what is named." if any(name in named for name, _, _ in best) else ""),
    )


def learned_curve(what: str, curve: Mapping[str, Any]) -> Picture:
    """Return by how much an encoder reads too much, against the quantity that this depends on, with its 95 % band.

    curve: as in a diagnosis' data: of, unit ("rad" or "rad/s"), knots, and values, low and high at these. Between knots
    it is straight; by angle it goes on after a turn as it began.
    """
    at, *heights = (np.array(curve[key]) for key in ("knots", "values", "low", "high"))
    quantity, unit = ABSCISSAE[curve["of"]].split(", ")
    if unit == "degrees":
        at = np.degrees(np.append(at, at[0] + 2 * np.pi))
        heights = [np.append(height, height[0]) for height in heights]
    value, low, high = (PERCENT * height for height in heights)
    with _drawing(2.6) as figure:
        axes = figure.subplots()
        axes.axhline(0, color=BEFORE, linewidth=0.8)
        axes.fill_between(at, low, high, color=AFTER, alpha=0.2, linewidth=0, label="95 % band")
        axes.plot(at, value, "o-", color=AFTER, label="learned from the logs")
        if unit == "degrees":
            axes.set_xticks(at[0] + np.arange(0, 361, 60))
        axes.margins(x=0.02)
        axes.set_xlabel(f"{quantity}, {unit}")
        axes.set_ylabel("reads too much by, %")
        _legend_above(axes)
    top, bottom = int(np.argmax(value)), int(np.argmin(value))
    return _picture(
        figure,
        "curve",
        f"A curve against {quantity}, {unit}: {what} reads too much by {value[bottom]:+.2f} % at {at[bottom]:.3g} "
        f"{unit} up to {value[top]:+.2f} % at {at[top]:.3g} {unit}.",
        f"By how much the encoder reads too much, against the {quantity}, as learned from the logs: "
        "points at the knots that are in the robot file, and the band that holds it with 95 %. Where the band is wide, "
        "the logs hardly show it.",
    )


def replays(before: Replay, after: Replay | None = None) -> Picture | None:
    """Return by how much the simulation misses the measurement in every window: motion and encoders.

    Wheels that are driven by their counts turn as these say, and are left out; None where nothing else is there.
    """
    shown, posed = _both(before, after), bool(np.isfinite(before.body).any())
    kinds = {"wheels": ("wheels, mm", before.wheel_names), "pivots": ("pivots, mrad", before.pivot_names)}
    kinds = {kind: told for kind, told in kinds.items() if told[1] and (kind, before.drive) != ("wheels", "counts")}
    if not posed and not kinds:
        return None
    panels: list[Any] = [["position"] * max(len(kinds), 1)] * posed + [list(kinds)] * bool(kinds)
    widths = [1 + len(names) for _, names in kinds.values()] or None
    with _drawing(1.7 * len(panels)) as figure:
        axes_of = figure.subplot_mosaic(panels, width_ratios=widths)
        top = axes_of[panels[0][0]]
        if posed:
            for replay, color, label in shown:
                position = MILLI * np.hypot(replay.body[:, 0], replay.body[:, 1])
                top.plot(np.arange(1, len(position) + 1), position, "o-", color=color, label=label)
            top.set_ylabel("position, mm")
            top.set_xlabel("window")
            top.xaxis.set_major_locator(MaxNLocator(integer=True))
            top.set_ylim(bottom=0)
        for kind, (label, names) in kinds.items():
            axes = axes_of[kind]
            width, places = 0.8 / len(shown), np.arange(len(names))
            for k, (replay, color, replay_label) in enumerate(shown):
                gaps = MILLI * np.sqrt(np.mean(getattr(replay, kind) ** 2, axis=0))
                axes.bar(places - 0.4 + width * (k + 0.5), gaps, width * 0.9, color=color, label=replay_label)
            axes.set_xticks(places, [name.partition("_")[2] for name in names])
            axes.grid(visible=False, axis="x")
            axes.set_ylabel(label)
        _legend_above(top)
    return _picture(
        figure,
        "replay",
        f"The gap between simulation and measurement in {len(before.start)} windows{_also(after)}"
        + (", and by encoder." if kinds else "."),
        "How far the simulated robot ends up from the measured one after each window"
        + (", and what its encoders count beyond the measured ones (rms)." if kinds else "."),
    )


def _both(before: Shown, after: Shown | None) -> list[tuple[Shown, str, str]]:
    return [(before, BEFORE, STATES[0])] + ([] if after is None else [(after, AFTER, STATES[1])])


def _also(after: object) -> str:
    return " as described" if after is None else " as described and with robot.json"


def _short(text: str) -> str:
    """Return text that matplotlib does not take for mathematics, in short lines."""
    lines = textwrap.wrap(text, 34, max_lines=2, placeholder=" \N{HORIZONTAL ELLIPSIS}")
    return "\n".join(lines).replace("$", r"\$")


def _edges(middle: Array) -> Array:
    """Return the edges (n + 1,) of windows by their middles (n,)."""
    half = np.diff(middle, append=2 * middle[-1] - middle[-2] if len(middle) > 1 else middle[-1] + 1) / 2
    return np.append(middle[0] - half[0], middle + half)


def _color_bar(figure: Figure, scale: ScalarMappable, axes: list[Axes], label: str) -> None:
    bar = figure.colorbar(scale, ax=axes, shrink=0.8, pad=0.02, aspect=30)
    bar.set_label(label)
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]


def _legend_above(axes: Axes) -> None:
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2, handlelength=1.4)


@contextmanager
def _drawing(height: float, grid: bool = True) -> Iterator[Figure]:
    with mpl.rc_context({**STYLE, "axes.grid": grid}):
        yield Figure(figsize=(WIDTH, height), layout="constrained")


def _picture(figure: Figure, name: str, alt: str, caption: str) -> Picture:
    """Return a figure as a picture: the same bytes for the same figure."""
    out = io.StringIO()
    with mpl.rc_context({**STYLE, "svg.hashsalt": name}):
        figure.savefig(out, format="svg", metadata={"Date": None}, transparent=True)
    return Picture(name, out.getvalue(), alt, caption)
