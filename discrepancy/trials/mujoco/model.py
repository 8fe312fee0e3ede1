"""A MuJoCo model of a robot, from the numbers of a robot file.

The chassis is a free rigid body, its frame at the height of the largest wheel's axle. Every wheel hangs on a
vertical slide with spring and damper, and the wheels of a castor share load through a spring that only their rising
together compresses, so all wheels carry load over bumps too. A wheel is a thin ellipsoid, which touches a plane at one
point. Robots whose castors do not hold them upright get four frictionless skids. Wheels and steering have velocity
servos: torque = gain * (command - rate), within the motor's torque.

Contacts are MuJoCo's with elliptic friction cones, its friction softened by its impedance alone: they creep as a
viscous layer does, at a speed in proportion to the force, and not as brush tyres do. Its integrator "discrete" is
needed: the others solve contacts as if servos and dampers were not there, and wheels chatter.
"""

import dataclasses
import importlib
import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from castor_envs.errors import InputError, with_extra
from castor_envs.floor import Floor
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.build import built, check_drivable
from discrepancy.trials.foreign.standing import (
    ACROSS,
    DROOP,
    STEERING_DROOP,
    TILTING,
    damping_of,
    fork,
    skids_of,
    static_loads,
    wheel_mass,
)

SINKING, REDUNDANT = 5e-4, 4.0
"""How far springs give under their static loads where all wheels of a castor rise together, m, and how many times that
on robots that stand on more than three castors or skids, to have all of them carry on uneven floors."""

ROCKING = 16.0
"""How many times softer the springs are where one wheel rises and its neighbours sink."""

THINNESS = 0.15
"""A wheel's half width over its radius."""

HEIGHT = 2.0
"""Height of the chassis' centre of mass over the axles, in wheel radii."""

TIGHTNESS = 10.0
"""MuJoCo's impratio: how much stiffer contacts are along the floor than across it."""

IMPEDANCE, CONTACT_TIME = 0.99, 0.7
"""MuJoCo's solimp (constant), and solref in physics steps; below half a step contacts chatter."""

PIVOT_DAMPING = 1e-3
"""N m s: damping of a free pivot."""


def text(*values: float) -> str:
    """Return numbers as MuJoCo's files have them."""
    return " ".join(repr(float(value)) for value in values)


def element(parent: ET.Element, tag: str, **given: Any) -> ET.Element:
    """Return a new element of a model; numbers, and sequences of them, are written as MuJoCo's files have them."""
    written = {name: value if isinstance(value, str) else text(*np.ravel(value)) for name, value in given.items()}
    return ET.SubElement(parent, tag, written)


def mujoco_module() -> Any:
    """Return the module; raises InputError where it is not installed, or too old for the integrator needed."""
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError:
        raise InputError(f"the MuJoCo generator needs mujoco; {with_extra('trial')}") from None
    if not hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE"):
        raise InputError(f"the MuJoCo generator needs mujoco 3.13 or newer, not {mujoco.__version__}: update it")
    return mujoco


class Parts:
    """The XML elements of a robot's model on a floor while it is made, for effects to change.

    load (w,): static, of wheels, N. step: s. sinking: how far castors' springs give under these loads, m.
    """

    def __init__(self, robot: RobotDescription, floor: Floor, step: float) -> None:
        """Raise InputError for what the simulator cannot build."""
        check_drivable(robot, "MuJoCo")
        (geometry, tyres), described = built(robot), Geometry.of(robot.as_described())
        if min(tyres.long, tyres.side) < 0:
            raise InputError(
                f"robot {robot.name!r} has tyres that hold better than described; MuJoCo's contacts are almost rigid "
                "already, and tyres can but slip more: give slip stiffnesses below 0"
            )
        height = float(geometry.radius.max())
        axles = geometry.radius - height
        self.robot, self.tyres, self.step, self.root = robot, tyres, step, ET.Element("mujoco")
        element(self.root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
        option = element(
            self.root,
            "option",
            timestep=step,
            integrator="discrete",
            cone="elliptic",
            impratio=TIGHTNESS,
            gravity=(*floor.downhill_gravity, -floor.normal_gravity),
            tolerance="1e-10",
        )
        element(option, "flag", refsafe="disable")
        world = element(self.root, "worldbody")
        element(world, "geom", type="plane", size="0 0 1", contype="0", conaffinity="3", condim="1")
        for cable in floor.cables:
            half = np.array([math.cos(cable.direction), math.sin(cable.direction)]) * cable.length / 2
            ends = [(*(np.array(cable.center) + way * half), cable.diameter / 2) for way in (-1, 1)]
            shape = {"type": "capsule", "size": cable.diameter / 2, "fromto": ends}
            element(world, "geom", **shape, contype="0", conaffinity="1", condim="1")
        self.chassis = element(world, "body", name="chassis", pos=(0, 0, height))
        element(self.chassis, "freejoint")
        center = (*robot.center_of_mass, HEIGHT * height)
        inertia = (TILTING * robot.inertia, TILTING * robot.inertia, robot.inertia)
        element(self.chassis, "inertial", pos=center, mass=robot.mass, diaginertia=inertia)
        skids = skids_of(robot, described)
        loads = static_loads(robot, described, floor.normal_gravity, skids)
        self._actuator = element(self.root, "actuator")
        standing = len(skids) + (geometry.n_castors if not geometry.fixed.all() else 0)
        self.sinking = SINKING * (REDUNDANT if standing > 3 else 1.0)
        self.load = loads[: len(geometry.radius)]
        shrunk = tyres.shrinking * (self.load - self.load[list(robot.driven_wheels)].mean())
        self.geometry = dataclasses.replace(geometry, radius=geometry.radius - shrunk)
        self.castors = [self._castor(i) for i in range(geometry.n_castors)]
        # Forks are made for wheels without load.
        self.wheels = [self._wheel(k, float(axle)) for k, axle in enumerate(axles)]
        self._share_loads()
        # Skids touch the plane alone, so no cable lifts the wheels by them.
        for place, load in zip(skids, loads[len(geometry.radius) :], strict=True):
            skid = element(self.chassis, "body", pos=(*place, height / 4 - height))
            element(skid, "joint", **_spring(load, self.sinking))
            element(skid, "inertial", pos="0 0 0", mass="0.05", diaginertia="1e-4 1e-4 1e-4")
            element(skid, "geom", type="sphere", size=height / 4, condim="1", contype="2", conaffinity="0")

    def _castor(self, i: int) -> ET.Element:
        geometry, robot, castor = self.geometry, self.robot, self.robot.castors[i]
        body = element(self.chassis, "body", name=f"castor_{i}", pos=(*geometry.pivot[i], 0))
        if castor.steering == "fixed":
            body.set("euler", text(0, 0, castor.angle))
        else:
            damping = PIVOT_DAMPING if castor.steering == "free" else 0.0
            element(body, "joint", name=f"pivot_{i}", type="hinge", axis="0 0 1", damping=damping)
        if castor.steering == "driven":
            droop = STEERING_DROOP * robot.max_steering_speed
            self._servo(f"steer_{i}", f"pivot_{i}", robot.max_steering_torque, droop)
        mass, inertia = fork(castor)
        moments = (TILTING * inertia, TILTING * inertia, inertia)
        element(body, "inertial", pos=(-geometry.offset[i], 0, 0), mass=mass, diaginertia=moments)
        return body

    def _wheel(self, k: int, height: float) -> ET.Element:
        robot, wheel, castor, geometry = self.robot, self.robot.wheels[k], self.geometry.wheel_castor, self.geometry
        radius, spin = geometry.radius[k], wheel.inertia
        place = -geometry.offset[castor[k]], geometry.lateral[k], height
        body = element(self.castors[castor[k]], "body", name=f"hub_{k}", pos=place)
        alone = np.sum(castor == castor[k]) == 1
        slide = _spring(self.load[k], self.sinking * (1.0 if alone else ROCKING))
        element(body, "joint", name=f"slide_{k}", **slide)
        element(body, "joint", name=f"roll_{k}", type="hinge", axis="0 1 0")
        mass = wheel_mass(spin, wheel.radius)
        element(body, "inertial", pos="0 0 0", mass=mass, diaginertia=(ACROSS * spin, spin, ACROSS * spin))
        element(
            body,
            "geom",
            name=f"wheel_{k}",
            type="ellipsoid",
            size=(radius, THINNESS * radius, radius),
            priority="1",
            condim="3",
            friction=(robot.contact.friction, 0.005, 0.0001),
            solref=(CONTACT_TIME * self.step, 1),
            solimp=(IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2),
            contype="1",
            conaffinity="0",
        )
        if wheel.driven:
            self._servo(f"drive_{k}", f"roll_{k}", robot.max_wheel_torque, DROOP * robot.max_wheel_speed)
        return body

    def _servo(self, name: str, joint: str, torque: float, droop: float) -> None:
        """Add a motor that turns a joint as commanded, `droop` (rad/s) slower at its full torque (N m)."""
        given = {"kv": torque / droop, "forcerange": (-torque, torque)}
        element(self._actuator, "velocity", name=name, joint=joint, **given)

    def _share_loads(self) -> None:
        """Add springs that only the common rising of a castor's wheels compresses, with the stiffness that their
        sinking requires."""
        tendons = element(self.root, "tendon")
        for i in range(len(self.castors)):
            wheels = np.flatnonzero(self.geometry.wheel_castor == i)
            if len(wheels) > 1:
                stiffness = self.load[wheels].mean() * (1 - 1 / ROCKING) / self.sinking / len(wheels)
                damping = damping_of(self.sinking) * stiffness
                tendon = element(tendons, "fixed", stiffness=stiffness, damping=damping, springlength="0")
                for k in wheels:
                    element(tendon, "joint", joint=f"slide_{k}", coef="1")


def _spring(load: float, sinking: float) -> dict[str, Any]:
    """Return the vertical slide of a wheel or skid whose spring gives by `sinking` (m) under `load` (N)."""
    stiffness = load / sinking
    spring = {"stiffness": stiffness, "springref": -sinking, "damping": damping_of(sinking) * stiffness}
    return {"type": "slide", "axis": "0 0 1"} | spring
