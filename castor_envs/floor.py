"""The floor: friction patches, slope, and cables to roll over."""

import math
import os
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from castor_envs import description
from castor_envs.description import CONFIG, Angle, Extent, FrictionOrNone, Place
from castor_envs.errors import InputError, did_you_mean

FORMAT = "castor-floor/1"

#: Rise over run along one axis: 45 degrees, where friction 1 no longer holds anything; the steepest streets have 0.35.
Slope = Annotated[float, Field(ge=-1.0, le=1.0)]
#: m/s2: a small asteroid's to four times Jupiter's.
Gravity = Annotated[float, Field(ge=1e-3, le=1e2)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Patch:
    """A rectangle with its own friction.

    center: m. size: along and across, m. friction: Coulomb coefficient. angle: by which it is turned, rad. relative:
    whether the friction is a factor of that of what the patch lies on.
    """

    center: tuple[Place, Place]
    size: tuple[Extent, Extent]
    friction: FrictionOrNone
    angle: Angle = 0.0
    # Files of floors without such patches are as they were before there were any.
    relative: Annotated[bool, Field(exclude_if=lambda value: not value)] = False

    def on(self, below: float) -> float:
        """Return the friction there, on what has the friction `below`."""
        return self.friction * below if self.relative else self.friction


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Cable:
    """A round cable on the floor.

    center: m. direction: of its axis, rad. length: m. diameter: m.
    """

    center: tuple[Place, Place]
    direction: Angle
    length: Extent
    diameter: Extent


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Floor:
    """The floor in N.

    patches: where they overlap, the last one counts, or lies on the others if it is `relative`. cables: to roll over.
    slope: rise over run along x and y, dimensionless. climbing: whether a wheel on a cable pays the climbing force
    (False: it only rolls the longer way). gravity: m/s2.
    """

    patches: tuple[Patch, ...] = ()
    cables: tuple[Cable, ...] = ()
    slope: tuple[Slope, Slope] = (0.0, 0.0)
    climbing: bool = True
    gravity: Gravity = 9.80665

    @property
    def normal_gravity(self) -> float:
        """Gravity's part across the floor, m/s2."""
        return self.gravity / math.sqrt(1.0 + self.slope[0] ** 2 + self.slope[1] ** 2)

    @property
    def downhill_gravity(self) -> tuple[float, float]:
        """Gravity's part along the floor, m/s2."""
        return -self.slope[0] * self.normal_gravity, -self.slope[1] * self.normal_gravity

    def patch_array(self) -> NDArray[np.float64]:
        """Return the patches as rows (x, y, cos, sin, half length, half width, friction, its factor).

        The friction on a patch is the first number and the second times the friction below: one of both is 0.
        """
        rows = [
            (*p.center, math.cos(p.angle), math.sin(p.angle), p.size[0] / 2, p.size[1] / 2)
            + ((0.0, p.friction) if p.relative else (p.friction, 0.0))
            for p in self.patches
        ]
        return np.array(rows, dtype=float).reshape(-1, 8)

    def cable_array(self) -> NDArray[np.float64]:
        """Return the cables as rows (x, y, cos, sin, half length, radius)."""
        rows = [
            (*c.center, math.cos(c.direction), math.sin(c.direction), c.length / 2, c.diameter / 2) for c in self.cables
        ]
        return np.array(rows, dtype=float).reshape(-1, 6)

    def to_dict(self) -> dict[str, Any]:
        """Return the floor as plain data, ``format`` first."""
        return description.to_data(_ADAPTER, self, FORMAT)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the floor as JSON; the file is complete or not there."""
        description.save(path, self.to_dict())

    @classmethod
    def from_dict(cls, data: Any, source: str = "floor") -> "Floor":
        """Read a floor from plain data; raises InputError that names `source` and the offending keys."""
        return description.from_data(_ADAPTER, data, FORMAT, source)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Floor":
        """Read a floor from a JSON file; raises InputError that names file and key."""
        return description.load(_ADAPTER, path, FORMAT)


_ADAPTER = TypeAdapter(Floor)


def cable_extra_roll(wheel_radius: float, diameter: float) -> float:
    """Return by how much the path rolled over a cable exceeds the path in plan, m.

    The wheel's centre follows an arc of radius r + a about the cable's: 2 (r + a)(phi - sin phi), with a half the
    diameter and cos phi = (r - a) / (r + a).
    """
    radius = diameter / 2
    phi = math.acos((wheel_radius - radius) / (wheel_radius + radius))
    return 2.0 * (wheel_radius + radius) * (phi - math.sin(phi))


#: Floors by name. "slippery": 100 m square of friction 0.04 (wet soap), a little less than what named courses ask for
#: where they speed up at 0.5 m/s2.
FLOORS = {"slippery": Floor(patches=(Patch(center=(0.0, 0.0), size=(100.0, 100.0), friction=0.04),))}


def load_floor(floor: Floor | str | os.PathLike[str] | None) -> Floor:
    """Return a floor given as a `Floor`, a name or the path of a file, or None for an even floor; raises InputError."""
    floor = os.fspath(floor) if isinstance(floor, os.PathLike) else floor
    if isinstance(floor, str):
        if floor not in FLOORS and not floor.endswith(".json") and not os.path.exists(floor):
            raise InputError(f"there is no floor or file {floor!r}{did_you_mean(floor, FLOORS)}")
        return FLOORS[floor] if floor in FLOORS else Floor.load(floor)
    floor = Floor() if floor is None else floor
    if not isinstance(floor, Floor):
        raise InputError(f"floor must be a Floor, a name or the path of a floor file, got {type(floor).__name__}")
    return floor
