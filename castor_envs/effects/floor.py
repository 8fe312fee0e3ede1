"""Effects of the floor: slope, a cable, a slippery place. Places are given in the frame N, that of reference poses."""

import dataclasses
import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG, FINEST, Extent, Place
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion, Slip
from castor_envs.vehicles.effect import Contacts, Effect
from castor_envs.vehicles.robot import RobotDescription

Angle = Annotated[float, Field(ge=-math.pi, le=math.pi)]

PARTS = 128
"""Points of a step at which a cable's gradient is computed."""


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class FloorSlope(Effect[RobotDescription]):
    """The floor rises by `value` (m per m) along x or y (`direction`) of the world frame."""

    name: Literal["floor_slope"] = "floor_slope"
    direction: Literal["x", "y"]
    value: Annotated[float, Field(ge=-0.5, le=0.5)]
    title = "slope of the floor"
    unit = "m/m"
    step = 0.01
    tolerance = 1e-3  # m/m: floors of laboratories are even to 2 mm in 2 m
    creep = "forces"
    check = "Lay a spirit level on the floor along both axes; compare wheel counts uphill with those downhill."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["FloorSlope", ...]:
        """Return an instance along each axis."""
        return (cls(direction="x", value=cls.step), cls(direction="y", value=cls.step))

    def floor(self, robot: RobotDescription, floor: Floor) -> Floor:
        """Return the floor, steeper by `value`."""
        x, y = floor.slope
        slope = (x + self.value, y) if self.direction == "x" else (x, y + self.value)
        return dataclasses.replace(floor, slope=slope)

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip:
        """Return the additional creep of contacts under the component of the weight along the floor."""
        return contacts.creep(self.floor(contacts.robot, Floor())) - contacts.creep()


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Bump(Effect[RobotDescription]):
    """A cable of diameter `value` (m) lies on the floor through (x, y), along `direction` (rad, world frame).

    It is `length` (m) long, with (x, y) at its middle.
    """

    name: Literal["bump"] = "bump"
    x: Place
    y: Place
    direction: Angle
    length: Extent = 100.0
    value: Annotated[float, Field(ge=0.0, le=0.1)]
    title = "cable or threshold on the floor"
    unit = "m"
    step = 1e-3
    tolerance = 1e-4  # m: joints of floors
    check = "Look on the floor at this place for a cable, a joint or a threshold."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["Bump", ...]:
        """Return no instance: the place of a cable has to be found in logs first."""
        return ()

    def where(self) -> tuple[str, ...]:
        """Return where the cable lies."""
        return f"through x {self.x:.2f}, y {self.y:.2f} m", f"direction {self.direction:.2f} rad"

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot as it is; raises InputError where its wheels cannot climb the cable."""
        smallest = min(wheel.radius for wheel in robot.wheels)
        if self.value >= smallest:
            raise InputError(
                f"effect {self.name}: a cable of {self.value} m is too thick for robot {robot.name!r}, whose smallest "
                f"wheel has a radius of {smallest} m"
            )
        return robot

    def floor(self, robot: RobotDescription, floor: Floor) -> Floor:
        """Return the floor with the cable on it; unchanged where the cable is thinner than `FINEST`."""
        if self.value < FINEST:
            return floor
        cable = Cable(center=(self.x, self.y), direction=self.direction, length=self.length, diameter=self.value)
        return dataclasses.replace(floor, cables=(*floor.cables, cable))

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip:
        """Return by how much contacts move less in plan than wheels roll on their way over the cable.

        Slip by the climbing force is left out: the way down gives it back.
        """
        robot, motion = contacts.robot, contacts.motion
        path = contacts.paths()[:, : len(robot.wheels)]
        places, longer = contacts.places(), np.zeros_like(path)
        for part in (np.arange(PARTS) + 0.5) / PARTS:
            climb = self._climb(robot, motion, (1 - part) * places[:-1] + part * places[1:])
            longer += (np.sqrt(1.0 + climb**2) - 1.0) / PARTS
        return Slip(-path * longer, np.zeros_like(motion.half_way))

    def _climb(self, robot: RobotDescription, motion: Motion, places: Array) -> Array:
        """Return how steeply wheels climb along their rolling directions (K - 1, w), m/m, at places in steps.

        On the cable a wheel's centre follows an arc of the sum of both radii about the cable's axis.
        """
        along, across = _along_and_across(places, self.x, self.y, self.direction)
        radius = np.array([wheel.radius for wheel in robot.wheels])
        on = (across**2 < 2.0 * radius * self.value) & (np.abs(along) <= self.length / 2)
        below = np.where(on, (radius + self.value / 2) ** 2 - across**2, 1.0)
        heading = motion.heading[:, None] + motion.half_way[:, list(robot.wheel_castors)] - self.direction
        return np.where(on, -across / np.sqrt(below) * np.sin(heading), 0.0)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class FrictionPatch(Effect[RobotDescription]):
    """In a rectangle of the floor the friction, whatever it is there, is lower by the fraction `value`.

    x, y: its centre in N, m. length, width: its sides, m, turned by `angle` (rad).
    """

    name: Literal["friction_patch"] = "friction_patch"
    x: Place
    y: Place
    length: Extent
    width: Extent
    angle: Angle = 0.0
    value: Annotated[float, Field(ge=0.0, le=1.0)]
    title = "slippery place on the floor"
    unit = "1"
    step = 0.5
    tolerance = 0.1  # floors are that uneven
    check = "Look on the floor at this place for dust, water or another covering."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["FrictionPatch", ...]:
        """Return no instance: the place of a slippery patch has to be found in logs first."""
        return ()

    def where(self) -> tuple[str, ...]:
        """Return where the rectangle lies, and how large it is."""
        size = f"{self.length:.2f} by {self.width:.2f} m"
        return f"around x {self.x:.2f}, y {self.y:.2f} m", size, f"turned by {self.angle:.2f} rad"

    def floor(self, robot: RobotDescription, floor: Floor) -> Floor:
        """Return the floor with the patch on it."""
        if self.value == 0.0:
            return floor
        patch = Patch(
            center=(self.x, self.y),
            size=(self.length, self.width),
            angle=self.angle,
            friction=1.0 - self.value,
            relative=True,
        )
        return dataclasses.replace(floor, patches=(*floor.patches, patch))

    def inside(self, contacts: Contacts[RobotDescription]) -> NDArray[np.bool_]:
        """Return which contacts stand in the rectangle half-way through each step (K - 1, w)."""
        places = contacts.places()
        middle = (places[1:] + places[:-1]) / 2
        along, across = _along_and_across(middle, self.x, self.y, self.angle)
        return (np.abs(along) <= self.length / 2) & (np.abs(across) <= self.width / 2)

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip:
        """Return where contacts may slide: the fraction `value` of each path inside, as of wheels that spin.

        Only the shape of this slip over time is meant: how far wheels slide differs from pass to pass, in size and
        sign.
        """
        path = contacts.paths()[:, : len(contacts.robot.wheels)]
        lost = -self.value * np.where(self.inside(contacts), path, 0.0)
        return Slip(lost, np.zeros_like(contacts.motion.half_way))


def _along_and_across(places: Array, x: float, y: float, direction: float) -> tuple[Array, Array]:
    """Return places (..., 2) in N as seen from (x, y) along `direction` and to its left."""
    c, s = math.cos(direction), math.sin(direction)
    right, up = places[..., 0] - x, places[..., 1] - y
    return c * right + s * up, c * up - s * right
