"""Effects outside the catalogue, for the MuJoCo simulator."""

import math
import xml.etree.ElementTree as ET

from castor_envs.errors import InputError
from discrepancy.trials.hidden import Outside
from discrepancy.trials.mujoco.model import THINNESS, Parts, element, text
from discrepancy.trials.mujoco.world import World
from discrepancy.trials.outside import Glitches


class WobblingWheel(Outside):
    """A wheel sits askew on its axle: its contact goes to and fro along the axle by `value` (m), once a turn."""

    def build(self, parts: Parts) -> None:
        """Tilt the ellipsoid: its lowest point then shifts by (r - b^2 / r) times the tilt."""
        k = self.wheel_in(parts.robot)
        tilt = self.value / (parts.geometry.radius[k] * (1 - THINNESS**2))
        geom = parts.wheels[k].find("geom")
        assert geom is not None  # every wheel is built with one
        geom.set("euler", text(tilt, 0, 0))


class FlatSpot(Outside):
    """A wheel has worn down by `value` (m) in one place, `WIDTH` (rad) of its tread, with smooth ends."""

    step, WIDTH = 2e-4, 0.6

    def act(self, world: World, t: float) -> None:
        """Set the radius at the contact."""
        k = self.wheel_in(world.robot)
        away = math.remainder(float(world.data.qpos[world.roll[k]]) - self.phase, 2 * math.pi)
        inside = abs(away) < self.WIDTH / 2
        worn = self.value * math.cos(math.pi * away / self.WIDTH) ** 2 if inside else 0.0
        world.set_radius(k, world.radius[k] - worn)


class WarmingWheel(Outside):
    """A wheel grows by the fraction `value` as it warms up, with the time constant `WARMING` (s)."""

    WARMING = 30.0

    def act(self, world: World, t: float) -> None:
        """Set the radius."""
        k = self.wheel_in(world.robot)
        world.set_radius(k, world.radius[k] * (1 + self.value * (1 - math.exp(-max(t, 0.0) / self.WARMING))))


class PivotPlay(Outside):
    """A castor's pivot has play in its seat: `value` (m) from end to end, forward and sideways."""

    step = 5e-4
    only = "castors"

    def build(self, parts: Parts) -> None:
        """Put two short slides between body and pivot."""
        half = text(-self.value / 2, self.value / 2)
        for place, axis in enumerate(("1 0 0", "0 1 0")):
            play = {"range": half, "damping": "5", "frictionloss": "0.1", "solreflimit": "0.004 1"}
            parts.castors[self.castor - 1].insert(place, ET.Element("joint", {"type": "slide", "axis": axis} | play))


class StickyPivot(Outside):
    """A free castor's pivot sticks: it starts at the torque `value` (N m) and slides at 0.3 of that."""

    step = 1.0
    only = "castors"

    def build(self, parts: Parts) -> None:
        """Give the pivot friction, as stiff as contacts are."""
        joints = parts.castors[self.castor - 1].findall("joint")
        pivot = next((joint for joint in joints if joint.get("type") == "hinge"), None)
        if pivot is None:
            raise InputError(f"castor {self.castor} does not turn; give one that does")
        pivot.set("frictionloss", text(self.value))
        pivot.set("solreffriction", text(parts.step, 1))
        pivot.set("solimpfriction", text(0.99, 0.99, 0.001, 0.5, 2))

    def act(self, world: World, t: float) -> None:
        """Set the friction for the rate at which the pivot turns (Stribeck's curve, of 0.1 rad/s)."""
        dof = world.model.joint(f"pivot_{self.castor - 1}").dofadr[0]
        sticking = math.exp(-((float(world.data.qvel[dof]) / 0.1) ** 2))
        world.model.dof_frictionloss[dof] = self.value * (0.3 + 0.7 * sticking)


class LooseMast(Outside):
    """The tracked point sits on a mast of 0.2 kg that swings: at `value` (Hz), with a damping ratio of 0.05."""

    only = "castors"
    step, power = 2.0, -2.0

    def build(self, parts: Parts) -> None:
        """Put a small mass on two springs above the body's origin."""
        mast = element(parts.chassis, "body", name="mast", pos="0 0 0.1")
        mass, rate = 0.2, 2 * math.pi * self.value
        spring = {"stiffness": mass * rate**2, "damping": 2 * 0.05 * mass * rate}
        for name, axis in (("mast_x", "1 0 0"), ("mast_y", "0 1 0")):
            element(mast, "joint", name=name, type="slide", axis=axis, **spring)
        element(mast, "inertial", pos="0 0 0", mass=mass, diaginertia="1e-5 1e-5 1e-5")


class CountGlitches(Glitches):
    """A wheel's counter jumps, and stays there."""

    only = "wheels"


KINDS = (WobblingWheel, FlatSpot, WarmingWheel, PivotPlay, StickyPivot, LooseMast, CountGlitches)
