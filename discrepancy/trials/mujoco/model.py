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

import importlib
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.build import Build, check_drivable
from discrepancy.trials.foreign.standing import ACROSS, fork, skids_of, static_loads, wheel_mass

STEP = 1e-3
"""Physics step, s, at most."""

SINKING, REDUNDANT = 5e-4, 4.0
"""How far springs give under their static loads where all wheels of a castor rise together, m, and how many times that
on robots that stand on more than three castors or skids, to have all of them carry on uneven floors."""

ROCKING = 16.0
"""How many times softer the springs are where one wheel rises and its neighbours sink."""

SPRING_DAMPING = 0.7
"""Damping of springs, in parts of the critical damping under static load."""

THINNESS = 0.15
"""A wheel's half width over its radius."""

GRAVITY = 9.81
"""m/s2: gravity for which dampers are chosen."""

HEIGHT = 2.0
"""Height of the chassis' centre of mass over the axles, in wheel radii."""

DROOP, STEERING_DROOP = 0.1, 0.01
"""How far wheels and steering fall behind their commands at full torque, in parts of their highest rate."""

TIGHTNESS = 10.0
"""MuJoCo's impratio: how much stiffer contacts are along the floor than across it."""

IMPEDANCE, CONTACT_TIME = 0.99, 0.7
"""MuJoCo's solimp (constant), and solref in physics steps; below half a step contacts chatter."""

AHEAD = (1 + IMPEDANCE * CONTACT_TIME) / 2
"""Physics steps from a step's start to the state whose contacts hold in it: half a step on, and as much further as side
slip lags behind the turning of the contacts, which MuJoCo leaves out."""

PIVOT_DAMPING = 1e-3
"""N m s: damping of a free pivot."""


def text(*values: float) -> str:
    """Return numbers as MuJoCo's files have them."""
    return " ".join(repr(float(value)) for value in values)


@dataclass(eq=False)
class Parts:
    """The XML elements of a model while it is made, for effects to change.

    load (w,): static, of wheels, N. step: s. sinking: how far castors' springs give under these loads, m.
    """

    build: Build
    root: ET.Element
    chassis: ET.Element
    castors: list[ET.Element]
    wheels: list[ET.Element]
    load: Array
    step: float
    sinking: float


@dataclass(eq=False)
class Rig:
    """A compiled model with its state, and where things are in it.

    pivot (n,), slide (w,), roll (w,): places in qpos of the pivots (-1: fixed), the wheels' slides and their turning;
    slide_dof, roll_dof (w,): in qvel. hub (w,), geom (w,): the wheels' bodies and shapes. tracked: places in qpos of a
    mast's two slides, or empty. radius (w,): as built, m. load (w,): at rest, N. step: s.
    """

    model: Any
    data: Any
    build: Build
    radius: Array
    load: Array
    step: float
    pivot: NDArray[np.intp] = field(init=False)
    slide: NDArray[np.intp] = field(init=False)
    slide_dof: NDArray[np.intp] = field(init=False)
    roll: NDArray[np.intp] = field(init=False)
    roll_dof: NDArray[np.intp] = field(init=False)
    tracked: NDArray[np.intp] = field(init=False)
    geom: NDArray[np.intp] = field(init=False)
    hub: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        mujoco = mujoco_module()

        def places(kind: Any, names: list[str], addresses: Any) -> NDArray[np.intp]:
            found = [mujoco.mj_name2id(self.model, kind, name) for name in names]
            return np.array([addresses[k] if k >= 0 else -1 for k in found], dtype=np.intp)

        joint, at = mujoco.mjtObj.mjOBJ_JOINT, self.model.jnt_qposadr
        n, w = len(self.build.offset), len(self.build.radius)
        self.pivot = places(joint, [f"pivot_{i}" for i in range(n)], at)
        self.slide = places(joint, [f"slide_{k}" for k in range(w)], at)
        self.slide_dof = places(joint, [f"slide_{k}" for k in range(w)], self.model.jnt_dofadr)
        self.roll_dof = places(joint, [f"roll_{k}" for k in range(w)], self.model.jnt_dofadr)
        self.roll = places(joint, [f"roll_{k}" for k in range(w)], at)
        mast = places(joint, ["mast_x", "mast_y"], at)
        self.tracked = mast[mast >= 0]
        self.hub = places(mujoco.mjtObj.mjOBJ_BODY, [f"hub_{k}" for k in range(w)], np.arange(self.model.nbody))
        self.geom = places(mujoco.mjtObj.mjOBJ_GEOM, [f"wheel_{k}" for k in range(w)], np.arange(self.model.ngeom))

    def loads(self) -> Array:
        """Return the loads of the wheels' springs (w,), N."""
        return -self.data.qfrc_spring[self.slide_dof]

    def set_radius(self, wheel: int, radius: float) -> None:
        """Give a wheel another radius, m."""
        self.model.geom_size[self.geom[wheel], [0, 2]] = radius
        self.model.geom_rbound[self.geom[wheel]] = radius

    def set_friction(self, wheel: int, friction: float) -> None:
        """Give a wheel's contact another coefficient of friction."""
        self.model.geom_friction[self.geom[wheel], 0] = friction

    def set_creep(self, viscous: float) -> None:
        """Let contacts slip by `viscous` (m/s) more for each N of friction, for the state that the model is in."""
        rows = np.ravel([np.arange(1, 3) + c.efc_address for c in self.data.contact[: self.data.ncon] if c.dim == 3])
        damping = 2 / (IMPEDANCE * CONTACT_TIME * self.step)
        creep = float(np.mean(self.data.efc_R[rows])) * (1 / damping + self.step)  # as the step treats it implicitly
        self.model.opt.impratio *= creep / (creep + viscous)

    def forces(self) -> tuple[Array, Array]:
        """Return the floor's friction on wheels (w,), N: along their rolling directions, and to their left."""
        mujoco, force = mujoco_module(), np.zeros(6)
        total = np.zeros((len(self.geom), 3))
        for c in range(self.data.ncon):
            contact = self.data.contact[c]
            wheel = np.flatnonzero(self.geom == contact.geom[1])
            if len(wheel):
                mujoco.mj_contactForce(self.model, self.data, c, force)
                total[wheel[0]] += contact.frame.reshape(3, 3).T @ force[:3]
        left = self.data.xmat[self.hub].reshape(-1, 3, 3)[:, :2, 1]
        ahead = np.column_stack([left[:, 1], -left[:, 0]])
        return (total[:, :2] * ahead).sum(axis=1), (total[:, :2] * left).sum(axis=1)

    def wheel_places(self) -> Array:
        """Return where the wheels' centres are (w, 3), m in N."""
        return self.data.geom_xpos[self.geom]


def parts_of(robot: RobotDescription, floor: Floor, step: float) -> Parts:
    """Return the elements of a robot's model on a floor; raises InputError for what the simulator cannot build."""
    check_drivable(robot, "MuJoCo")
    build, described = Build.of(robot), Build.of(robot.as_described())
    if min(build.long, build.side) < 0:
        raise InputError(
            f"robot {robot.name!r} has tyres that hold better than described; MuJoCo's contacts are almost rigid "
            "already, and tyres can but slip more: give slip stiffnesses below 0"
        )
    height = float(described.radius.max())
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    option = ET.SubElement(
        root,
        "option",
        timestep=text(step),
        integrator="discrete",
        cone="elliptic",
        impratio=text(TIGHTNESS),
        gravity=text(*floor.downhill_gravity, -floor.normal_gravity),
        tolerance="1e-10",
    )
    ET.SubElement(option, "flag", refsafe="disable")
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "geom", type="plane", size="0 0 1", contype="0", conaffinity="3", condim="1")
    for cable in floor.cables:
        half = np.array([math.cos(cable.direction), math.sin(cable.direction)]) * cable.length / 2
        ends = [(*(np.array(cable.center) + way * half), cable.diameter / 2) for way in (-1, 1)]
        shape = {"type": "capsule", "size": text(cable.diameter / 2), "fromto": text(*ends[0], *ends[1])}
        ET.SubElement(world, "geom", shape, contype="0", conaffinity="1", condim="1")
    chassis = ET.SubElement(world, "body", name="chassis", pos=text(0, 0, height))
    ET.SubElement(chassis, "freejoint")
    center = (*robot.center_of_mass, HEIGHT * height)
    tilting = 0.6 * robot.inertia
    inertia = text(tilting, tilting, robot.inertia)
    ET.SubElement(chassis, "inertial", pos=text(*center), mass=text(robot.mass), diaginertia=inertia)
    skids = skids_of(robot, described)
    loads = static_loads(robot, described, floor.normal_gravity, skids)
    actuator = ET.SubElement(root, "actuator")
    standing = len(skids) + (len(build.offset) if build.turning.any() else 0)
    sinking = SINKING * (REDUNDANT if standing > 3 else 1.0)
    wheel_loads = loads[: len(build.radius)]
    build.radius[:] -= build.shrinking * (wheel_loads - wheel_loads[build.driven].mean())
    parts = Parts(build, root, chassis, [], [], loads[: len(build.radius)], step, sinking)
    for i in range(len(build.offset)):
        parts.castors.append(_castor(parts, robot, actuator, i))
    for k in range(len(build.radius)):
        # The fork is made for the described wheel; a larger one presses its spring in.
        behind, aside = float(build.offset[build.castor[k]]), float(build.lateral[k])
        place = -behind, aside, float(described.radius[k]) - height
        parts.wheels.append(_wheel(parts, robot, actuator, k, place))
    _share_loads(parts)
    # Skids touch the plane alone, so no cable lifts the wheels by them.
    for place, load in zip(skids, loads[len(build.radius) :], strict=True):
        skid = ET.SubElement(chassis, "body", pos=text(*place, height / 4 - height))
        ET.SubElement(skid, "joint", _spring(load, sinking))
        ET.SubElement(skid, "inertial", pos="0 0 0", mass="0.05", diaginertia="1e-4 1e-4 1e-4")
        ET.SubElement(skid, "geom", type="sphere", size=text(height / 4), condim="1", contype="2", conaffinity="0")
    return parts


def mujoco_module() -> Any:
    """Return the module; raises InputError where it is not installed, or too old for the integrator needed."""
    try:
        mujoco: Any = importlib.import_module("mujoco")
    except ImportError:
        raise InputError("the MuJoCo generator needs mujoco: pip install castor-envs[trial]") from None
    if not hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE"):
        raise InputError(f"the MuJoCo generator needs mujoco 3.13 or newer, not {mujoco.__version__}: update it")
    return mujoco


def rig_of(parts: Parts) -> Rig:
    """Compile a model; raises InputError where MuJoCo is not installed."""
    mujoco = mujoco_module()
    model = mujoco.MjModel.from_xml_string(ET.tostring(parts.root, encoding="unicode"))
    return Rig(model, mujoco.MjData(model), parts.build, parts.build.radius.copy(), parts.load, parts.step)


def _castor(parts: Parts, robot: RobotDescription, actuator: ET.Element, i: int) -> ET.Element:
    build, castor = parts.build, robot.castors[i]
    body = ET.SubElement(parts.chassis, "body", name=f"castor_{i}", pos=text(*build.pivot[i], 0))
    if castor.steering == "fixed":
        body.set("euler", text(0, 0, castor.angle))
    else:
        damping = PIVOT_DAMPING if castor.steering == "free" else 0.0
        ET.SubElement(body, "joint", name=f"pivot_{i}", type="hinge", axis="0 0 1", damping=text(damping))
    if castor.steering == "driven":
        limit = robot.max_steering_torque
        ET.SubElement(
            actuator,
            "velocity",
            name=f"steer_{i}",
            joint=f"pivot_{i}",
            kv=text(limit / (STEERING_DROOP * robot.max_steering_speed)),
            forcerange=text(-limit, limit),
        )
    mass, inertia = fork(castor)
    across = 0.6 * inertia
    ET.SubElement(
        body, "inertial", pos=text(-build.offset[i], 0, 0), mass=text(mass), diaginertia=text(across, across, inertia)
    )
    return body


def _wheel(parts: Parts, robot: RobotDescription, actuator: ET.Element, k: int, place: tuple[float, ...]) -> ET.Element:
    build, wheel = parts.build, robot.wheels[k]
    radius, spin = build.radius[k], wheel.inertia
    body = ET.SubElement(parts.castors[build.castor[k]], "body", name=f"hub_{k}", pos=text(*place))
    ET.SubElement(
        body, "joint", {"name": f"slide_{k}"} | _spring(parts.load[k], parts.sinking * _rocking(parts.build, k))
    )
    ET.SubElement(body, "joint", name=f"roll_{k}", type="hinge", axis="0 1 0")
    mass = text(wheel_mass(spin, wheel.radius))
    ET.SubElement(body, "inertial", pos="0 0 0", mass=mass, diaginertia=text(ACROSS * spin, spin, ACROSS * spin))
    ET.SubElement(
        body,
        "geom",
        name=f"wheel_{k}",
        type="ellipsoid",
        size=text(radius, THINNESS * radius, radius),
        priority="1",
        condim="3",
        friction=text(robot.contact.friction, 0.005, 0.0001),
        solref=text(CONTACT_TIME * parts.step, 1),
        solimp=text(IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2),
        contype="1",
        conaffinity="0",
    )
    if wheel.driven:
        limit = robot.max_wheel_torque
        reach = text(-limit, limit)
        ET.SubElement(
            actuator,
            "velocity",
            name=f"drive_{k}",
            joint=f"roll_{k}",
            kv=text(limit / (DROOP * robot.max_wheel_speed)),
            forcerange=reach,
        )
    return body


def _spring(load: float, sinking: float) -> dict[str, str]:
    """Return the vertical slide of a wheel or skid whose spring gives by `sinking` (m) under `load` (N)."""
    stiffness = load / sinking
    return {
        "type": "slide",
        "axis": "0 0 1",
        "stiffness": text(stiffness),
        "springref": text(-sinking),
        "damping": text(_damping(sinking) * stiffness),
    }


def _damping(sinking: float) -> float:
    """Return the damping of a spring over its stiffness, s, that gives by `sinking` (m) under its load."""
    return 2 * SPRING_DAMPING * math.sqrt(sinking / GRAVITY)


def _rocking(build: Build, wheel: int) -> float:
    """Return how many times softer the spring of a single wheel is than the springs of its castor."""
    return ROCKING if np.sum(build.castor == build.castor[wheel]) > 1 else 1.0


def _share_loads(parts: Parts) -> None:
    """Add springs that only the common rising of a castor's wheels compresses, with the stiffness that their sinking
    requires."""
    tendons = ET.SubElement(parts.root, "tendon")
    for i in range(len(parts.castors)):
        wheels = np.flatnonzero(parts.build.castor == i)
        if len(wheels) > 1:
            stiffness = parts.load[wheels].mean() * (1 - 1 / ROCKING) / parts.sinking / len(wheels)
            spring = {"stiffness": text(stiffness), "damping": text(_damping(parts.sinking) * stiffness)}
            tendon = ET.SubElement(tendons, "fixed", spring, springlength="0")
            for k in wheels:
                ET.SubElement(tendon, "joint", joint=f"slide_{k}", coef="1")
