"""A Bullet model of a robot, from the numbers of a robot file, and how it is stepped.

The robot is one articulated body: chassis, forks on their pivots, wheels on their axles. The axle of a castor that
turns and has several wheels rocks freely about its rolling direction, so its wheels share its load whatever their
radii; axles are as high as their wheels are large, so that all stand on a level floor. Robots whose castors do not hold
them upright get four frictionless skids.

Wheels are spheres: a sphere touches the floor in a single point, right below its centre however the axle leans, so it
rolls its radius and turns on the spot about that point without resistance. Bullet's cylinders touch along a line, in
points that come and go, so their tracks change by up to the cylinder's width and they rub as they turn: on cylinders 20
mm wide the prototype's wheels were 0.8 % of their way off, on spheres 0.0005 %. A sphere's mass and inertia are the
wheel's all the same.

Contacts are rigid along the floor: Coulomb's friction with its cone, no creep below it. Across the floor they give a
little, for rigid ones leave open which of more than three carries how much. Nothing sinks into rolling radii by that: a
sphere's lowest point stays at its radius. Other changes of a tyre's rolling radius (load, wear) are modelled as a gear
between tyre and rim (`World.radius`), because Bullet's shapes cannot change while they roll.

Wheels and steering have velocity servos: torque = gain * (command - rate), within the motor's torque. Bullet's motors
take it as the most that they may exert toward the commanded rate, so that no step overshoots it.
"""

import importlib
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from castor_envs.errors import InputError, with_extra
from castor_envs.floor import Floor
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.build import built, check_drivable
from discrepancy.trials.foreign.standing import ACROSS, TILTING, fork, skids_of, static_loads, wheel_mass

WHEELS_BELOW = (3, 12)
"""Python versions that PyBullet 3.2.7 has no wheels for begin here; the extra in pyproject.toml says the same."""

SINKING, REDUNDANT = 4e-5, 10.0
"""How far contacts give under their static loads, m, and how many times that on robots that stand on more than three
castors, to have all of them carry with radii that differ."""

SKID_SINKING = 2e-4
"""The same for skids, m: softer, so that wheels carry the load whatever their radii."""

ROCKING = 0.2
"""Part of its fork's mass and inertia that a rocking axle has."""


@dataclass(eq=False)
class Link:
    """A part of the robot on a hinge, or fixed where `axis` is None.

    place: of its frame's origin in the parent's frame, m; None as parent is the chassis, whose frame is B. turned: of
    its frame against the parent's, about z, rad. inertia (3,): about its centre of mass, which is `behind` (m) behind
    its origin, kg m2. wheel: which wheel's sphere it carries; None: it does not touch the floor. limits: of its angle,
    rad. spring: stiffness and damping of its hinge, N m and N m s a rad.
    """

    name: str
    parent: str | None
    place: tuple[float, float, float]
    mass: float
    inertia: tuple[float, float, float]
    axis: tuple[float, float, float] | None
    turned: float = 0.0
    behind: float = 0.0
    wheel: int | None = None
    limits: tuple[float, float] | None = None
    spring: tuple[float, float] = (0.0, 0.0)

    def split(self, part: float) -> tuple[float, tuple[float, float, float]]:
        """Keep a part of mass and inertia, and return the rest of them."""
        (x, y, z), mass = self.inertia, self.mass
        self.mass, self.inertia = part * mass, (part * x, part * y, part * z)
        rest = 1 - part
        return rest * mass, (rest * x, rest * y, rest * z)


def bullet_module() -> Any:
    """Return PyBullet; raises InputError where it is not installed."""
    try:
        return importlib.import_module("pybullet")
    except ImportError:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        hint = "" if sys.version_info < WHEELS_BELOW else f" on Python 3.11: there are no wheels of it for {version}"
        raise InputError(f"generator bullet needs PyBullet; {with_extra('bullet')}{hint}") from None


class Parts:
    """The parts of a robot's model on a floor before it is built, for effects to change.

    links: parents before their children; each wheel's hinge is called "roll_0", ..., each pivot "pivot_0", .... load
    (w,): static, of wheels, N; sinking: how far their contacts give under it, m. skids (s, 2): in B, m; skid_load: N.
    height: of B's origin over the floor, m. step: s.
    """

    def __init__(self, robot: RobotDescription, floor: Floor, step: float) -> None:
        """Raise InputError for what the simulator cannot build."""
        check_drivable(robot, "Bullet")
        (geometry, tyres), described = built(robot), Geometry.of(robot.as_described())
        if floor.cables:
            raise InputError(
                "the floor has cables (effect 'bump'); the Bullet generator has none, for its robots have no springs, "
                "and wheels beside a cable would leave the floor: leave them out"
            )
        if tyres.long or tyres.side or tyres.viscous:
            raise InputError(
                f"robot {robot.name!r} has tyres that creep otherwise than described; the Bullet generator's contacts "
                "do not creep: leave out slip_stiffness, slip_stiffness_lateral and contact_creep"
            )
        self.robot, self.geometry, self.tyres, self.step = robot, geometry, tyres, step
        self.height, self.skids = float(geometry.radius.max()), skids_of(robot, described)
        loads = static_loads(robot, described, floor.normal_gravity, self.skids)
        self.load, self.skid_load = loads[: len(geometry.radius)], float(loads[-1])
        redundant = not len(self.skids) and geometry.n_castors > 3
        self.sinking = SINKING * (REDUNDANT if redundant else 1.0)
        self.links: list[Link] = []
        for i in range(geometry.n_castors):
            self.links += self._castor(i)
            self.links += [self._wheel(k) for k in np.flatnonzero(geometry.wheel_castor == i).tolist()]

    def link(self, name: str) -> Link:
        """Return a part by its name."""
        return next(link for link in self.links if link.name == name)

    def _castor(self, i: int) -> list[Link]:
        """Return fork and, where it rocks, axle of a castor."""
        castor, behind = self.robot.castors[i], float(self.geometry.offset[i])
        (mass, inertia), free = fork(castor), castor.steering != "fixed"
        rocking = ROCKING if free and len(castor.wheels) > 1 else 0.0

        def part(share: float) -> tuple[float, tuple[float, float, float]]:
            return share * mass, (share * TILTING * inertia, share * TILTING * inertia, share * inertia)

        place = (float(self.geometry.pivot[i, 0]), float(self.geometry.pivot[i, 1]), 0.0)
        axis, turned_by = ((0.0, 0.0, 1.0), 0.0) if free else (None, castor.angle)
        links = [Link(f"pivot_{i}", None, place, *part(1 - rocking), axis, turned_by, behind)]
        if rocking:
            links.append(Link(f"axle_{i}", f"pivot_{i}", (-behind, 0.0, 0.0), *part(rocking), (1.0, 0.0, 0.0)))
        return links

    def _wheel(self, k: int) -> Link:
        geometry, wheel = self.geometry, self.robot.wheels[k]
        i, mass = int(geometry.wheel_castor[k]), wheel_mass(wheel.inertia, wheel.radius)
        rocks = not geometry.fixed[i] and np.sum(geometry.wheel_castor == i) > 1
        behind, height = 0.0 if rocks else -float(geometry.offset[i]), float(geometry.radius[k]) - self.height
        inertia = ACROSS * wheel.inertia, wheel.inertia, ACROSS * wheel.inertia
        parent, place = f"axle_{i}" if rocks else f"pivot_{i}", (behind, float(geometry.lateral[k]), height)
        return Link(f"roll_{k}", parent, place, mass, inertia, (0.0, 1.0, 0.0), wheel=k)
