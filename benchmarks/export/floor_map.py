"""A floor as a map of the ROS map server: a picture and a YAML file that says where it lies. `evo` draws such maps.

Format: http://wiki.ros.org/map_server#Map_format: the picture's lower left corner stands at `origin`, `resolution` is
in m a pixel, white is free.
"""

import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from castor_envs.files import write_atomically
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array

FINE = 0.01
"""m a pixel, as thin as cables are; coarser where the map would have more than `MOST_PIXELS` along a side."""
MOST_PIXELS = 4000
MARGIN = 0.5
"""m shown around all that was driven and all that lies on the floor."""
FREE, CABLE = 254, 0
"""Shades of the bare floor, as ROS has free space, and of cables, as ROS has obstacles."""
DULLEST, BRIGHTEST = 120, 200
"""Shades of patches, from friction 0 to 1 and more; 205 is what maps have for unknown."""


def write_floor_map(path: Path, floor: Floor, driven: Array) -> None:
    """Write `path`, which ends in .yaml, and a PNG beside it. driven (k, 2 or more): places that the map contains."""
    picture, resolution, origin = floor_map(floor, driven)
    image = io.BytesIO()
    Image.fromarray(picture).save(image, format="png")
    write_atomically(path.with_suffix(".png"), image.getvalue())
    lines = (
        f"image: {path.with_suffix('.png').name}",
        f"resolution: {resolution!r}",
        f"origin: [{origin[0]!r}, {origin[1]!r}, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
    )
    write_atomically(path, "\n".join(lines) + "\n")


def floor_map(floor: Floor, driven: Array) -> tuple[NDArray[np.uint8], float, tuple[float, float]]:
    """Return the picture (rows from the top, columns), m a pixel, and where its lower left corner is in N, m."""
    corners = [np.asarray(driven, dtype=float)[:, :2]]
    boxes = [(p.center, p.angle, p.size) for p in floor.patches]
    boxes += [(c.center, c.direction, (c.length, c.diameter)) for c in floor.cables]
    for center, angle, size in boxes:
        half = np.abs(_turned(np.array(size) / 2 * np.array([(1, 1), (1, -1)]), -angle)).max(axis=0)
        corners.append(np.array(center) + np.array([half, -half]))
    low, high = (bound(np.concatenate(corners), axis=0) for bound in (np.min, np.max))
    low, high = low - MARGIN, high + MARGIN
    resolution = max(FINE, float(np.max(high - low)) / MOST_PIXELS)
    width, height = (math.ceil(side) for side in ((high - low) / resolution).tolist())
    x = low[0] + resolution * (np.arange(width) + 0.5)
    y = low[1] + resolution * (height - np.arange(height) - 0.5)
    places = np.stack(np.meshgrid(x, y), axis=-1)
    picture = np.full((height, width), FREE, dtype=np.uint8)
    for patch in floor.patches:
        shade = round(DULLEST + (BRIGHTEST - DULLEST) * min(patch.on(1.0), 1.0))
        picture[_within(places, patch.center, patch.angle, patch.size)] = shade
    for cable in floor.cables:
        wide = max(cable.diameter, 2 * resolution)  # so that the middle of a pixel is on it
        picture[_within(places, cable.center, cable.direction, (cable.length, wide))] = CABLE
    return picture, resolution, (float(low[0]), float(low[1]))


def _within(places: Array, center: tuple[float, float], angle: float, size: tuple[float, float]) -> NDArray[np.bool_]:
    """Return which places (..., 2) lie in a rectangle."""
    return np.all(np.abs(_turned(places - np.array(center), angle)) <= np.array(size) / 2, axis=-1)


def _turned(points: Array, angle: float) -> Array:
    """Return points (..., 2) as seen from axes that are turned by an angle."""
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([(c, -s), (s, c)])
