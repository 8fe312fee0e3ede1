"""Effects outside the catalogue, for the Bullet simulator."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.bullet.model import Link, Parts
from discrepancy.trials.bullet.world import World
from discrepancy.trials.foreign.run import Outside
from discrepancy.trials.hidden import Hidden, counter_of, place_at_random, wheel_of


@dataclass(frozen=True)
class StickingCounter(Outside):
    """Now and then a wheel's counter misses counts for a while, and then comes back to the true count.

    part: of the counts that it misses; 1: it freezes. rate: how often a second, on average. time: how long, s.
    """

    castor: int
    wheel: int
    part: float
    rate: float = 0.2
    time: float = 0.5

    def __post_init__(self) -> None:
        if abs(self.part) > 1:
            raise ValueError(f"a counter cannot miss more than all, got the part {self.part:g}")

    def count(self, robot: RobotDescription, t: Array, wheel: Array, random: np.random.Generator) -> Array:
        """Return the counts less what is missing at the moment."""
        channel, wheel = counter_of(robot, self), wheel.copy()
        true, since = wheel[:, channel].copy(), -1
        sticks = random.uniform(size=len(t)) < self.rate * np.diff(t, prepend=t[0])
        for k in range(len(t)):
            if since >= 0 and t[k] - t[since] > self.time:
                since = -1
            if since < 0 and sticks[k]:
                since = k - 1
            if since >= 0:
                wheel[k, channel] -= self.part * (true[k] - true[since])
        return wheel


@dataclass(frozen=True)
class ConicalWheel(Outside):
    """A wheel with a tread worn to a cone, on a fork that leans.

    Which part of the cone touches the floor depends on where the castor points: the rolling radius is larger by the
    fraction `cone` where it points along `along` (rad, on the body), and smaller by it the other way.
    """

    castor: int
    wheel: int
    cone: float
    along: float = 0.0
    acts = True

    def build(self, parts: Parts) -> None:
        """Raise InputError for a castor that does not turn."""
        if parts.geometry.fixed[self.castor - 1]:
            raise InputError(f"castor {self.castor} does not turn; give one that does")

    def act(self, world: World, t: float) -> None:
        """Set the radius for where the castor points."""
        k, pivot = wheel_of(world.robot, self), world.pivot[self.castor - 1]
        world.radius[k] *= 1 + self.cone * math.cos(world.joint[pivot] - self.along)


@dataclass(frozen=True)
class FlexingFork(Outside):
    """A castor's fork bends half-way between pivot and axle, by `give` (rad) for each N of side force."""

    castor: int
    give: float
    damping: ClassVar[float] = 0.5
    front: ClassVar[float] = 0.4

    def build(self, parts: Parts) -> None:
        """Put a hinge with a spring there; `front` of the fork's mass stays before it."""
        i = self.castor - 1
        half, fork, castor = float(parts.geometry.offset[i]) / 2, parts.link(f"pivot_{i}"), parts.robot.castors[i]
        if parts.geometry.fixed[i] or half == 0.0:
            raise InputError(f"castor {self.castor} has no fork to bend: give one that turns and has an offset")
        stiffness = half / abs(self.give)
        ahead = self.front * fork.inertia[2]
        inertia = 1 / (1 / ahead + 1 / (castor.inertia + castor.mass * half**2))
        if math.sqrt(stiffness / inertia) * parts.step > 1.0:
            raise InputError(f"a fork that gives {self.give:g} rad/N is too stiff to simulate; give a softer one")
        spring = stiffness, 2 * self.damping * math.sqrt(stiffness * inertia)
        children = [link for link in parts.links if link.parent == fork.name]
        mass, moments = fork.mass, fork.inertia
        fork.mass, fork.inertia = self.front * mass, scaled(moments, self.front)
        left = (1 - self.front) * mass, scaled(moments, 1 - self.front)
        rear = Link(f"flex_{i}", fork.name, (-half, 0.0, 0.0), *left, (0.0, 0.0, 1.0), behind=half, spring=spring)
        parts.links.insert(parts.links.index(fork) + 1, rear)
        for child in children:
            child.parent, child.place = rear.name, (child.place[0] + half, *child.place[1:])


@dataclass(frozen=True)
class LooseTyre(Outside):
    """A wheel's tyre has play on its hub, where motor and encoder are: `play` (rad) from end to end."""

    castor: int
    wheel: int
    play: float
    hub: ClassVar[float] = 0.2

    def build(self, parts: Parts) -> None:
        """Make the wheel of two parts, the tyre turning on the hub, which has `hub` of the wheel's mass."""
        k = wheel_of(parts.robot, self)
        hub = parts.link(f"roll_{k}")
        half, mass, moments = abs(self.play) / 2, hub.mass, hub.inertia
        hub.mass, hub.inertia, hub.wheel = self.hub * mass, scaled(moments, self.hub), None
        left = (1 - self.hub) * mass, scaled(moments, 1 - self.hub)
        tyre = Link(f"tyre_{k}", hub.name, (0.0, 0.0, 0.0), *left, (0.0, 1.0, 0.0), wheel=k, limits=(-half, half))
        parts.links.insert(parts.links.index(hub) + 1, tyre)


def scaled(inertia: tuple[float, float, float], part: float) -> tuple[float, float, float]:
    """Return a part of an inertia (3,)."""
    return inertia[0] * part, inertia[1] * part, inertia[2] * part


def outsiders(robot: RobotDescription, random: np.random.Generator) -> Iterator[Hidden]:
    """Yield each effect once, at a random place of the robot, in a size to begin with."""
    place = place_at_random(robot, random)
    along = float(random.uniform(-math.pi, math.pi))
    yield Hidden(StickingCounter(**place, part=2e-3), "part")
    yield Hidden(ConicalWheel(**place, cone=5e-4, along=along), "cone")
    yield Hidden(FlexingFork(castor=place["castor"], give=1e-3), "give")
    yield Hidden(LooseTyre(**place, play=5e-3), "play")
