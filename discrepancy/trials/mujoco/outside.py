"""Effects outside the catalogue, for the MuJoCo simulator."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.run import Outside
from discrepancy.trials.hidden import Hidden, counter_of, place_at_random, wheel_of
from discrepancy.trials.mujoco.model import THINNESS, Parts, element, text
from discrepancy.trials.mujoco.world import World


@dataclass(frozen=True)
class WobblingWheel(Outside):
    """A wheel sits askew on its axle: its contact goes to and fro along the axle by `size` (m), once a turn."""

    castor: int
    wheel: int
    size: float

    def build(self, parts: Parts) -> None:
        """Tilt the ellipsoid: its lowest point then shifts by (r - b^2 / r) times the tilt."""
        k = wheel_of(parts.robot, self)
        tilt = self.size / (parts.geometry.radius[k] * (1 - THINNESS**2))
        geom = parts.wheels[k].find("geom")
        assert geom is not None  # every wheel is built with one
        geom.set("euler", text(tilt, 0, 0))


@dataclass(frozen=True)
class FlatSpot(Outside):
    """A wheel has worn down by `depth` (m) in one place, `width` (rad) of its tread, with smooth ends."""

    castor: int
    wheel: int
    depth: float
    width: float = 0.6
    phase: float = 1.0
    acts = True

    def act(self, world: World, t: float) -> None:
        """Set the radius at the contact."""
        k = wheel_of(world.robot, self)
        away = math.remainder(float(world.data.qpos[world.roll[k]]) - self.phase, 2 * math.pi)
        inside = abs(away) < self.width / 2
        worn = self.depth * math.cos(math.pi * away / self.width) ** 2 if inside else 0.0
        world.set_radius(k, world.radius[k] - worn)


@dataclass(frozen=True)
class WarmingWheel(Outside):
    """A wheel grows by the fraction `growth` as it warms up, with the time constant `time` (s)."""

    castor: int
    wheel: int
    growth: float
    time: float = 30.0
    acts = True

    def act(self, world: World, t: float) -> None:
        """Set the radius."""
        k = wheel_of(world.robot, self)
        world.set_radius(k, world.radius[k] * (1 + self.growth * (1 - math.exp(-max(t, 0.0) / self.time))))


@dataclass(frozen=True)
class PivotPlay(Outside):
    """A castor's pivot has play in its seat: `size` (m) from end to end, forward and sideways."""

    castor: int
    size: float

    def build(self, parts: Parts) -> None:
        """Put two short slides between body and pivot."""
        castor = parts.castors[self.castor - 1]
        half = text(-self.size / 2, self.size / 2)
        for place, axis in enumerate(("1 0 0", "0 1 0")):
            play = {"range": half, "damping": "5", "frictionloss": "0.1", "solreflimit": "0.004 1"}
            castor.insert(place, ET.Element("joint", {"type": "slide", "axis": axis} | play))


@dataclass(frozen=True)
class StickyPivot(Outside):
    """A free castor's pivot sticks: it starts at the torque `stick` (N m) and slides at `slide` of that."""

    castor: int
    stick: float
    slide: float = 0.3
    speed: float = 0.1
    acts = True

    def build(self, parts: Parts) -> None:
        """Give the pivot friction, as stiff as contacts are."""
        castor = parts.castors[self.castor - 1]
        pivot = next((joint for joint in castor.findall("joint") if joint.get("type") == "hinge"), None)
        if pivot is None:
            raise InputError(f"castor {self.castor} does not turn; give one that does")
        pivot.set("frictionloss", text(self.stick))
        pivot.set("solreffriction", text(parts.step, 1))
        pivot.set("solimpfriction", text(0.99, 0.99, 0.001, 0.5, 2))

    def act(self, world: World, t: float) -> None:
        """Set the friction for the rate at which the pivot turns (Stribeck's curve, `speed` in rad/s)."""
        dof = world.model.joint(f"pivot_{self.castor - 1}").dofadr[0]
        sticking = math.exp(-((float(world.data.qvel[dof]) / self.speed) ** 2))
        world.model.dof_frictionloss[dof] = self.stick * (self.slide + (1 - self.slide) * sticking)


@dataclass(frozen=True)
class LooseMast(Outside):
    """The tracked point sits on a mast that swings: `frequency` (Hz), damping ratio `damping`."""

    frequency: float
    damping: float = 0.05
    mass: ClassVar[float] = 0.2

    def build(self, parts: Parts) -> None:
        """Put a small mass on two springs above the body's origin."""
        mast = element(parts.chassis, "body", name="mast", pos="0 0 0.1")
        rate = 2 * math.pi * self.frequency
        spring = {"stiffness": self.mass * rate**2, "damping": 2 * self.damping * self.mass * rate}
        for name, axis in (("mast_x", "1 0 0"), ("mast_y", "0 1 0")):
            element(mast, "joint", name=name, type="slide", axis=axis, **spring)
        element(mast, "inertial", pos="0 0 0", mass=self.mass, diaginertia="1e-5 1e-5 1e-5")


@dataclass(frozen=True)
class CountGlitches(Outside):
    """A wheel's counter jumps by up to `counts`, up or down, `rate` times a second on average, and stays there."""

    castor: int
    wheel: int
    counts: int
    rate: float = 0.2

    def count(self, robot: RobotDescription, t: Array, wheel: Array, random: np.random.Generator) -> Array:
        """Add the jumps."""
        channel = counter_of(robot, self)
        hit = random.uniform(size=len(t)) < self.rate * np.diff(t, prepend=t[0])
        jump = np.where(hit, np.ceil(self.counts * random.uniform(size=len(t))) * random.choice([-1, 1], len(t)), 0)
        wheel = wheel.copy()
        wheel[:, channel] += np.cumsum(jump)
        return wheel


def outsiders(robot: RobotDescription, random: np.random.Generator) -> Iterator[Hidden]:
    """Yield each effect once, at a random place of the robot, in a size to begin with."""
    place = place_at_random(robot, random)
    castor = place["castor"]
    yield Hidden(WobblingWheel(**place, size=1e-3), "size")
    yield Hidden(FlatSpot(**place, depth=2e-4, phase=float(random.uniform(-3, 3))), "depth")
    yield Hidden(WarmingWheel(**place, growth=1e-3), "growth")
    yield Hidden(PivotPlay(castor=castor, size=5e-4), "size")
    yield Hidden(StickyPivot(castor=castor, stick=1.0), "stick")
    yield Hidden(LooseMast(frequency=2.0), "frequency", power=-2.0)
    yield Hidden(CountGlitches(**place, counts=3), "counts")
