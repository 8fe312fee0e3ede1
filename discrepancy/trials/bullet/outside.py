"""Effects outside the catalogue, for the Bullet simulator."""

import math

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.bullet.model import Link, Parts
from discrepancy.trials.bullet.world import World
from discrepancy.trials.hidden import Outside
from discrepancy.trials.outside import Misreading


class StickingCounter(Misreading):
    """Once in 5 s on average, for 0.5 s, a wheel's counter misses the part `value` of all counts (1: it freezes), and
    then comes back to the true count."""

    step = 2e-3

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        if abs(self.value) > 1:
            raise ValueError(f"a counter cannot miss more than all, got the part {self.value:g}")
        starts = np.cumsum(0.5 + np.random.default_rng(self.seed).exponential(4.5, 1000))
        began = np.append(0.0, starts)[np.searchsorted(starts, t - t[0])] + t[0]
        sticks = (began > t[0]) & (t < began + 0.5)
        return np.where(sticks, np.interp(began, t, angle) - angle, 0.0)


class ConicalWheel(Outside):
    """A wheel with a tread worn to a cone, on a fork that leans.

    Which part of the cone touches the floor depends on where the castor points: the rolling radius is larger by the
    fraction `value` where it points along `phase` on the body, and smaller by it the other way.
    """

    step = 5e-4

    def build(self, parts: Parts) -> None:
        """Raise InputError for a castor that does not turn."""
        if parts.geometry.fixed[self.castor - 1]:
            raise InputError(f"castor {self.castor} does not turn; give one that does")

    def act(self, world: World, t: float) -> None:
        """Set the radius for where the castor points."""
        k, pivot = self.wheel_in(world.robot), world.pivot[self.castor - 1]
        world.radius[k] *= 1 + self.value * math.cos(world.joint[pivot] - self.phase)


class FlexingFork(Outside):
    """A castor's fork bends half-way between pivot and axle, by `value` (rad) for each N of side force."""

    only = "castors"
    FRONT, DAMPING = 0.4, 0.5

    def build(self, parts: Parts) -> None:
        """Put a hinge with a spring there; the part `FRONT` of the fork's mass stays before it."""
        i = self.castor - 1
        half, fork, castor = float(parts.geometry.offset[i]) / 2, parts.link(f"pivot_{i}"), parts.robot.castors[i]
        if parts.geometry.fixed[i] or half == 0.0:
            raise InputError(f"castor {self.castor} has no fork to bend: give one that turns and has an offset")
        stiffness, ahead = half / abs(self.value), self.FRONT * fork.inertia[2]
        inertia = 1 / (1 / ahead + 1 / (castor.inertia + castor.mass * half**2))
        if math.sqrt(stiffness / inertia) * parts.step > 1.0:
            raise InputError(f"a fork that gives {self.value:g} rad/N is too stiff to simulate; give a softer one")
        children = [link for link in parts.links if link.parent == fork.name]
        spring = stiffness, 2 * self.DAMPING * math.sqrt(stiffness * inertia)
        rear = Link(f"flex_{i}", fork.name, (-half, 0.0, 0.0), *fork.split(self.FRONT), (0.0, 0.0, 1.0), behind=half)
        rear.spring = spring
        parts.links.insert(parts.links.index(fork) + 1, rear)
        for child in children:
            child.parent, child.place = rear.name, (child.place[0] + half, *child.place[1:])


class LooseTyre(Outside):
    """A wheel's tyre has play on its hub, where motor and encoder are: `value` (rad) from end to end."""

    step, HUB = 5e-3, 0.2

    def build(self, parts: Parts) -> None:
        """Make the wheel of two parts, the tyre turning on the hub, which has the part `HUB` of the wheel's mass."""
        k, half = self.wheel_in(parts.robot), abs(self.value) / 2
        hub = parts.link(f"roll_{k}")
        hub.wheel, left = None, hub.split(self.HUB)
        tyre = Link(f"tyre_{k}", hub.name, (0.0, 0.0, 0.0), *left, (0.0, 1.0, 0.0), wheel=k, limits=(-half, half))
        parts.links.insert(parts.links.index(hub) + 1, tyre)


KINDS = (StickingCounter, ConicalWheel, FlexingFork, LooseTyre)
