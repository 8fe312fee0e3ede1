"""Maps of the floor for pages: patches, cables, paths and spots, as what an SVG is made of."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.rendering.caption import round_length
from castor_envs.rendering.drawing.path import Path
from castor_envs.rendering.outlines import placed

WIDTH = 640
"""Of a map in its own units; a page shows it in its own width."""
SQUAREST, WIDEST = 1.0, 0.5
"""Most and least height of a map as a part of its width."""
MARGIN = 0.07
"""Of the larger extent, that is seen around all paths."""
LEAST = 0.2
"""m: least extent of a map, where a robot hardly moves; spots of another unit give their own."""


class Line(NamedTuple):
    """A path on a map, with a gap where points are NaN. kind: classes of the style sheet, such as ``true`` or
    ``estimate s1``."""

    points: Array
    kind: str
    label: str


class Spot(NamedTuple):
    """A disc of radius r (units of the map) at x, y (m)."""

    x: float
    y: float
    r: float
    kind: str
    label: str


class _Drawn(NamedTuple):
    """A polygon or polyline in the map's units."""

    points: str
    kind: str
    label: str


@dataclass(frozen=True)
class FloorMap:
    """What an SVG is made of, in units of the map, y down. scale: how far apart grid lines are, in words."""

    width: float
    height: float
    patches: tuple[_Drawn, ...]
    cables: tuple[tuple[float, float, float, float], ...]
    gridlines: tuple[tuple[float, float, float, float], ...]
    paths: tuple[_Drawn, ...]
    spots: tuple[Spot, ...]
    scale: str
    alt: str


def floor_map(
    lines: Sequence[Line],
    alt: str,
    spots: Sequence[Spot] = (),
    floor: Floor | None = None,
    friction: float = 1.0,
    unit: str = "m",
    least: float = LEAST,
) -> FloorMap:
    """Return a map of all lines (points (k, 2), m) and spots; patches and cables show where they are in sight.

    friction: outside of patches, by which a patch is slippery or rough. unit: of all places, for the grid's spacing in
    words; least: extent in it.
    """
    places = [np.asarray(line.points, dtype=float)[:, :2] for line in lines]
    places += [np.array([[spot.x, spot.y]]) for spot in spots]
    seen = np.concatenate([*places, np.zeros((0, 2))])
    seen = seen[np.isfinite(seen).all(axis=1)] if len(seen) else np.zeros((1, 2))
    low, high = (seen.min(axis=0), seen.max(axis=0)) if len(seen) else (np.zeros(2), np.zeros(2))
    extent = np.maximum(high - low, least) + 2 * MARGIN * max(float(np.max(high - low)), least)
    center = (low + high) / 2
    part = min(max(extent[1] / extent[0], WIDEST), SQUAREST)
    height = round(WIDTH * part)
    scale = min(WIDTH / extent[0], height / extent[1])

    def at(points: Array) -> Array:
        return np.round((np.asarray(points)[:, :2] - center) * (scale, -scale) + (WIDTH / 2, height / 2), 1)

    step = round_length(max(extent) / 4)
    reach = np.array([WIDTH, height]) / scale / 2
    gridlines: list[tuple[float, float, float, float]] = []
    for axis in (0, 1):
        first, last = (math.ceil((center - reach)[axis] / step), math.floor((center + reach)[axis] / step))
        for k in range(first, last + 1):
            mark = round(float(at(np.full((1, 2), k * step))[0, axis]), 1)
            gridlines.append((mark, 0.0, mark, height) if axis == 0 else (0.0, mark, WIDTH, mark))
    floor = Floor() if floor is None else floor
    return FloorMap(
        width=WIDTH,
        height=height,
        patches=tuple(
            _Drawn(
                _points(at(placed(_CORNERS * patch.size / 2, (*patch.center, patch.angle)))),
                "slippery" if patch.on(friction) < friction else "rough",
                f"friction {patch.on(friction):.2g}",
            )
            for patch in floor.patches
        ),
        cables=tuple(
            (*at(_ends(cable.center, cable.direction, cable.length)).ravel().tolist(),)  # type: ignore[misc]
            for cable in floor.cables
        ),
        gridlines=tuple(gridlines),
        paths=tuple(
            _Drawn(_points(at(_corners(piece, 0.5 / scale))), line.kind, line.label)
            for line in lines
            for piece in _pieces(line.points)
        ),
        spots=tuple(spot._replace(x=x, y=y) for spot in spots for x, y in at(np.array([[spot.x, spot.y]])).tolist()),
        scale=f"Grid: {step:g} {unit}",
        alt=alt,
    )


_CORNERS = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])


def _ends(center: tuple[float, float], direction: float, length: float) -> Array:
    half = np.array([math.cos(direction), math.sin(direction)]) * length / 2
    return np.array([center - half, center + half])


def _pieces(points: Array) -> list[Array]:
    """Return the parts of a path between points that are not finite; an empty one where there is none."""
    places = np.asarray(points, dtype=float)[:, :2]
    known = np.isfinite(places).all(axis=1)
    pieces = np.split(places, np.flatnonzero(~known))
    pieces = [piece[np.isfinite(piece).all(axis=1)] for piece in pieces]
    return [piece for piece in pieces if len(piece)] or [np.zeros((0, 2))]


def _corners(points: Array, pixel: float) -> Array:
    """Return the corners of a path that make it out to within a pixel."""
    path = Path(pixel)
    for place in points:
        path.lengthen(place)
    return path.corners


def _points(places: Array) -> str:
    return " ".join(f"{x:g},{y:g}" for x, y in places.tolist())
