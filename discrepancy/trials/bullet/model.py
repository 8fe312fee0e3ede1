"""A Bullet model of a robot, from the numbers of a robot file, and how it is stepped.

The robot is one articulated body: chassis, forks on their pivots, wheels on their axles. The axle of a castor that
turns and has several wheels rocks freely about its rolling direction, so its wheels share its load whatever their
radii. Robots whose castors do not hold them upright get four frictionless skids.

Wheels are spheres: a sphere touches the floor in a single point, right below its centre however the axle leans, so it
rolls its radius and turns on the spot about that point without resistance. Bullet's cylinders touch along a line, in
points that come and go, so their tracks change by up to the cylinder's width and they rub as they turn: on cylinders 20
mm wide the prototype's wheels were 0.8 % of their way off, on spheres 0.0005 %. A sphere's mass and inertia are the
wheel's all the same.

Contacts are rigid along the floor: Coulomb's friction with its cone, no creep below it. Across the floor they give a
little, for rigid ones leave open which of more than three carries how much. Nothing sinks into rolling radii by that: a
sphere's lowest point stays at its radius. Other changes of a tyre's rolling radius (load, wear) are modelled as a gear
between tyre and rim (`Rig.radius`), because Bullet's shapes cannot change while they roll.

Wheels and steering have velocity servos: torque = gain * (command - rate), within the motor's torque. Bullet's motors
take it as the most that they may exert toward the commanded rate, so that no step overshoots it.
"""

import importlib
import math
import sys
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

WHEELS_BELOW = (3, 12)
"""Python versions that PyBullet 3.2.7 has no wheels for begin here; the extra in pyproject.toml says the same."""

STEP = 2e-3
"""Physics step, s, at most. What it costs: `discrepancy.trials.bullet.generator`."""

ITERATIONS, CLOSE = 200, 1e-14
"""Passes of Bullet's solver over all constraints, at most, and the square of the change of velocity (m/s or rad/s) in a
pass that ends them. 50 passes let wheels of little load slip by some 10 um in a metre."""

SINKING, REDUNDANT = 4e-5, 10.0
"""How far contacts give under their static loads, m, and how many times that on robots that stand on more than three
castors, to have all of them carry with radii that differ."""

SKID_SINKING = 2e-4
"""The same for skids, m: softer, so that wheels carry the load whatever their radii."""

CONTACT_DAMPING = 0.7
"""Damping of contacts normal to the floor, in parts of the critical damping under static load."""

GRAVITY = 9.81
"""m/s2: gravity for which dampers are chosen."""

HEIGHT = 1.0
"""Height of the chassis' centre of mass over the axles, in wheel radii."""

TILTING = 0.6
"""Inertia of chassis and forks about level axes over that about the vertical: they are flat."""

ROCKING = 0.2
"""Part of its fork's mass and inertia that a rocking axle has."""

DROOP, STEERING_DROOP = 0.1, 0.01
"""How far wheels and steering fall behind their commands at full torque, in parts of their highest rate."""

CLEARANCE = 1e-3
"""How high over the floor the robot is put down, m."""


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


@dataclass(eq=False)
class Parts:
    """The parts of a model before it is built, for effects to change.

    links: parents before their children; each wheel's hinge is called "roll_0", ..., each pivot "pivot_0", .... load
    (w,): static, of wheels, N; sinking: how far their contacts give under it, m. skids (s, 2): in B, m; skid_load: N.
    height: of B's origin over the floor, m. gravity (3,): in N, m/s2. step: s.
    """

    robot: RobotDescription
    build: Build
    links: list[Link]
    load: Array
    sinking: float
    skids: Array
    skid_load: float
    height: float
    gravity: tuple[float, float, float]
    step: float

    def link(self, name: str) -> Link:
        """Return a part by its name."""
        return next(link for link in self.links if link.name == name)


@dataclass(eq=False)
class Rig:
    """A robot in a separate Bullet world, and its state.

    client, body: numbers that Bullet gave to the world and the robot. center (3,): of mass of the chassis, in B, m.
    load (w,): at rest, N. step_size: s. hinges, spheres: Bullet's numbers of the links on hinges, and of those that
    carry wheels. pivot (n,), roll (w,): which hinges are the castors' pivots (-1: fixed) and the wheels'. springs
    (j, 2): of hinges, as in `Link`. place (3,), turn (4,): of the centre of mass in N, m, and the quaternion
    (x, y, z, w) of B. joint (j,): angles of hinges, rad. speed (3,), spin (3,), rate (j,): their rates; the chassis' in
    N. radius (w,): of rolling, m, at the moment.
    """

    bullet: Any
    client: int
    body: int
    build: Build
    center: Array
    load: Array
    step_size: float
    hinges: list[int]
    spheres: list[int]
    pivot: NDArray[np.intp]
    roll: NDArray[np.intp]
    springs: Array
    place: Array
    turn: Array
    joint: Array = field(init=False)
    speed: Array = field(init=False)
    spin: Array = field(init=False)
    rate: Array = field(init=False)
    radius: Array = field(init=False)

    def __post_init__(self) -> None:
        self.joint, self.rate = np.zeros((2, len(self.hinges)))
        self.speed, self.spin = np.zeros((2, 3))
        self.radius = self.build.radius.copy()
        self._sprung = np.flatnonzero(self.springs[:, 0]).tolist()

    def close(self) -> None:
        """Remove the world."""
        self.bullet.disconnect(self.client)

    def put(self, pose: tuple[float, float, float]) -> None:
        """Put the robot to a pose of B, at rest, leaning as it leans."""
        before = self.pose()
        self.turn = turned(self.turn, np.array([0.0, 0.0, pose[2] - before[2]]))
        self.place[:2] += pose[:2] - self.pose()[:2]
        self.speed, self.spin, self.rate = np.zeros(3), np.zeros(3), np.zeros(len(self.hinges))

    def wheel_places(self) -> Array:
        """Return where the wheels stand (w, 2), m in N."""
        x, y, heading = self.pose()
        build = self.build
        theta = np.where(self.pivot >= 0, self.joint[self.pivot], build.angle)[build.castor] + heading
        pivot = (build.pivot[:, 0] + 1j * build.pivot[:, 1])[build.castor] * np.exp(1j * heading)
        place = x + 1j * y + pivot + (1j * build.lateral - build.offset[build.castor]) * np.exp(1j * theta)
        return np.column_stack([place.real, place.imag])

    def set_gravity(self, gravity: tuple[float, float, float]) -> None:
        """Set the acceleration of free fall in N, m/s2."""
        self.bullet.setGravity(*gravity, physicsClientId=self.client)

    def servo(self, hinges: list[int], command: Array, torque: Array) -> None:
        """Let motors turn some hinges toward rates (k,), rad/s, with torques (k,) of at most that, N m."""
        self.bullet.setJointMotorControlArray(
            self.body,
            [self.hinges[hinge] for hinge in hinges],
            self.bullet.VELOCITY_CONTROL,
            targetVelocities=command.tolist(),
            velocityGains=[1.0] * len(hinges),
            forces=torque.tolist(),
            physicsClientId=self.client,
        )

    def step(self) -> None:
        """Make one step: velocities that hold half-way through it, where Bullet is put, then the whole step."""
        bullet, body, client, half = self.bullet, self.body, self.client, self.step_size / 2
        self._act_springs()
        bullet.resetBasePositionAndOrientation(
            body,
            (self.place + half * self.speed).tolist(),
            turned(self.turn, half * self.spin).tolist(),
            physicsClientId=client,
        )
        bullet.resetBaseVelocity(body, self.speed.tolist(), self.spin.tolist(), physicsClientId=client)
        bullet.resetJointStatesMultiDof(
            body,
            self.hinges,
            (self.joint + half * self.rate)[:, None].tolist(),
            self.rate[:, None].tolist(),
            physicsClientId=client,
        )
        bullet.stepSimulation(physicsClientId=client)
        speed, spin = bullet.getBaseVelocity(body, physicsClientId=client)
        self.speed, self.spin = np.array(speed), np.array(spin)
        self.rate = np.array([joint[1] for joint in bullet.getJointStates(body, self.hinges, physicsClientId=client)])
        self.place = self.place + self.step_size * self.speed
        self.turn = turned(self.turn, self.step_size * self.spin)
        self.joint = self.joint + self.step_size * self.rate

    def loads(self) -> Array:
        """Return the loads of wheels on the floor (w,), N."""
        load = np.zeros(len(self.spheres))
        for contact in self.bullet.getContactPoints(self.body, physicsClientId=self.client):
            if contact[3] in self.spheres:
                load[self.spheres.index(contact[3])] += contact[9]
        return load

    def set_friction(self, wheel: int, friction: float) -> None:
        """Give a wheel's contact another coefficient of friction."""
        self.bullet.changeDynamics(
            self.body, self.spheres[wheel], lateralFriction=friction, physicsClientId=self.client
        )

    def pose(self) -> Array:
        """Return the pose (3,) of B: x, y, m, and psi, rad, between -pi and pi."""
        x, y, z, w = self.turn.tolist()
        origin = self.place - rotated(self.turn, self.center)
        return np.array([origin[0], origin[1], math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))])

    def _act_springs(self) -> None:
        if not self._sprung:
            return
        stiffness, damping = self.springs[self._sprung].T
        torque = -stiffness * self.joint[self._sprung] - damping * self.rate[self._sprung]
        self.bullet.setJointMotorControlArray(
            self.body,
            [self.hinges[hinge] for hinge in self._sprung],
            self.bullet.TORQUE_CONTROL,
            forces=torque.tolist(),
            physicsClientId=self.client,
        )


def bullet_module() -> Any:
    """Return PyBullet; raises InputError where it is not installed."""
    try:
        return importlib.import_module("pybullet")
    except ImportError:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        hint = "" if sys.version_info < WHEELS_BELOW else f" on Python 3.11: there are no wheels of it for {version}"
        raise InputError(f"generator bullet needs PyBullet; install castor-envs[bullet]{hint}") from None


def turned(turn: Array, by: Array) -> Array:
    """Return a quaternion (x, y, z, w) turned further by a rotation vector (3,) in N, rad."""
    x, y, z, w = turn.tolist()
    angle = math.sqrt(float(by @ by))
    a, b, c = (by * (math.sin(angle / 2) / angle if angle > 0 else 0.5)).tolist()
    d = math.cos(angle / 2)
    return np.array(
        [
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
            d * w - a * x - b * y - c * z,
        ]
    )


def rotated(turn: Array, vector: Array) -> Array:
    """Return a vector (3,) turned by a quaternion (x, y, z, w)."""
    axis, w = turn[:3], turn[3]
    side = 2 * np.cross(axis, vector)
    return vector + w * side + np.cross(axis, side)


def parts_of(robot: RobotDescription, floor: Floor, step: float) -> Parts:
    """Return the parts of a robot's model on a floor; raises InputError for what the simulator cannot build."""
    check_drivable(robot, "Bullet")
    build, described = Build.of(robot), Build.of(robot.as_described())
    if floor.cables:
        raise InputError(
            "the floor has cables (effect 'bump'); the Bullet generator has none, for its robots have no springs, and "
            "wheels beside a cable would leave the floor: leave them out"
        )
    if build.long or build.side or build.viscous:
        raise InputError(
            f"robot {robot.name!r} has tyres that creep otherwise than described; the Bullet generator's contacts do "
            "not creep: leave out slip_stiffness, slip_stiffness_lateral and contact_creep"
        )
    height, skids = float(described.radius.max()), skids_of(robot, described)
    loads = static_loads(robot, described, floor.normal_gravity, skids)
    links: list[Link] = []
    for i in range(len(build.offset)):
        links += _castor(robot, build, i)
        for k in np.flatnonzero(build.castor == i).tolist():
            links.append(_wheel(robot, build, k, float(described.radius[k]) - height))
    redundant = not len(skids) and len(build.offset) > 3
    return Parts(
        robot=robot,
        build=build,
        links=links,
        load=loads[: len(build.radius)],
        sinking=SINKING * (REDUNDANT if redundant else 1.0),
        skids=skids,
        skid_load=float(loads[-1]),
        height=height,
        gravity=(*floor.downhill_gravity, -floor.normal_gravity),
        step=step,
    )


def rig_of(parts: Parts) -> Rig:
    """Build a model in a new world; raises InputError where PyBullet is not installed."""
    bullet = bullet_module()
    client = bullet.connect(bullet.DIRECT)
    at = {"physicsClientId": client}
    bullet.setPhysicsEngineParameter(
        fixedTimeStep=parts.step,
        numSubSteps=0,
        numSolverIterations=ITERATIONS,
        solverResidualThreshold=CLOSE,
        deterministicOverlappingPairs=1,
        **at,
    )
    floor = bullet.createMultiBody(0, bullet.createCollisionShape(bullet.GEOM_PLANE, **at), **at)
    bullet.changeDynamics(floor, -1, lateralFriction=1.0, **at)  # Bullet multiplies it with the wheels'
    robot, links = parts.robot, parts.links
    center = np.array([*robot.center_of_mass, HEIGHT * parts.height])
    larger = max(parts.build.radius[link.wheel] - link.place[2] for link in links if link.wheel is not None)
    place = np.array([0.0, 0.0, larger + CLEARANCE]) + center
    body = _body(bullet, at, parts, center, place)
    bullet.changeDynamics(
        body,
        -1,
        localInertiaDiagonal=[TILTING * robot.inertia, TILTING * robot.inertia, robot.inertia],
        linearDamping=0.0,
        angularDamping=0.0,
        lateralFriction=0.0,
        **_springy(parts.skid_load, SKID_SINKING),
        **at,
    )
    hinges = [j for j, link in enumerate(links) if link.axis is not None]
    for j, link in enumerate(links):
        bullet.changeDynamics(body, j, localInertiaDiagonal=link.inertia, jointDamping=0.0, **at)
        if link.wheel is not None:
            springy = _springy(float(parts.load[link.wheel]), parts.sinking)
            bullet.changeDynamics(body, j, lateralFriction=robot.contact.friction, **springy, **at)
        if link.limits is not None:
            low, high = link.limits
            bullet.changeDynamics(body, j, jointLowerLimit=low, jointUpperLimit=high, **at)
    still = [0.0] * len(hinges)
    bullet.setJointMotorControlArray(body, hinges, bullet.VELOCITY_CONTROL, forces=still, **at)

    def hinge(name: str) -> int:
        return next((at for at, j in enumerate(hinges) if links[j].name == name), -1)

    rig = Rig(
        bullet=bullet,
        client=client,
        body=body,
        build=parts.build,
        center=center,
        load=parts.load,
        step_size=parts.step,
        hinges=hinges,
        spheres=[next(j for j, link in enumerate(links) if link.wheel == k) for k in range(len(parts.load))],
        pivot=np.array([hinge(f"pivot_{i}") for i in range(len(robot.castors))], dtype=np.intp),
        roll=np.array([hinge(f"roll_{k}") for k in range(len(parts.load))], dtype=np.intp),
        springs=np.array([links[j].spring for j in hinges]),
        place=place,
        turn=np.array([0.0, 0.0, 0.0, 1.0]),
    )
    rig.set_gravity(parts.gravity)
    return rig


def _castor(robot: RobotDescription, build: Build, i: int) -> list[Link]:
    """Return fork and, where it rocks, axle of a castor."""
    castor, behind = robot.castors[i], float(build.offset[i])
    (mass, inertia), free = fork(castor), castor.steering != "fixed"
    rocking = ROCKING if free and len(castor.wheels) > 1 else 0.0

    def part(share: float) -> tuple[float, tuple[float, float, float]]:
        return share * mass, (share * TILTING * inertia, share * TILTING * inertia, share * inertia)

    place = (float(build.pivot[i, 0]), float(build.pivot[i, 1]), 0.0)
    axis, turned_by = ((0.0, 0.0, 1.0), 0.0) if free else (None, castor.angle)
    links = [Link(f"pivot_{i}", None, place, *part(1 - rocking), axis, turned_by, behind)]
    if rocking:
        links.append(Link(f"axle_{i}", f"pivot_{i}", (-behind, 0.0, 0.0), *part(rocking), (1.0, 0.0, 0.0)))
    return links


def _wheel(robot: RobotDescription, build: Build, k: int, height: float) -> Link:
    i, wheel = int(build.castor[k]), robot.wheels[k]
    rocks = build.turning[i] and np.sum(build.castor == i) > 1
    place = (0.0 if rocks else -float(build.offset[i]), float(build.lateral[k]), height)
    inertia = ACROSS * wheel.inertia, wheel.inertia, ACROSS * wheel.inertia
    parent = f"axle_{i}" if rocks else f"pivot_{i}"
    return Link(f"roll_{k}", parent, place, wheel_mass(wheel.inertia, wheel.radius), inertia, (0.0, 1.0, 0.0), wheel=k)


def _body(bullet: Any, at: dict[str, int], parts: Parts, center: Array, place: Array) -> int:
    """Make the articulated body, its chassis' centre of mass at a place (3,), and return its number."""
    number = {link.name: j for j, link in enumerate(parts.links)}
    shape, positions = -1, []
    if len(parts.skids):
        radius = parts.height / 4
        low = parts.sinking - SKID_SINKING - parts.height + radius
        shape = bullet.createCollisionShapeArray(
            shapeTypes=[bullet.GEOM_SPHERE] * len(parts.skids),
            radii=[radius] * len(parts.skids),
            collisionFramePositions=[[x - center[0], y - center[1], low - center[2]] for x, y in parts.skids.tolist()],
            **at,
        )
    for link in parts.links:
        from_center = -center if link.parent is None else np.zeros(3)
        positions.append((np.array(link.place) + from_center).tolist())
    level = [0.0, 0.0, 0.0, 1.0]
    return bullet.createMultiBody(
        parts.robot.mass,
        shape,
        -1,
        place.tolist(),
        level,
        linkMasses=[link.mass for link in parts.links],
        linkCollisionShapeIndices=[
            -1
            if link.wheel is None
            else bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=float(parts.build.radius[link.wheel]), **at)
            for link in parts.links
        ],
        linkVisualShapeIndices=[-1] * len(parts.links),
        linkPositions=positions,
        linkOrientations=[[0.0, 0.0, math.sin(link.turned / 2), math.cos(link.turned / 2)] for link in parts.links],
        linkInertialFramePositions=[[-link.behind, 0.0, 0.0] for link in parts.links],
        linkInertialFrameOrientations=[level] * len(parts.links),
        linkParentIndices=[0 if link.parent is None else number[link.parent] + 1 for link in parts.links],
        linkJointTypes=[bullet.JOINT_FIXED if link.axis is None else bullet.JOINT_REVOLUTE for link in parts.links],
        linkJointAxis=[link.axis or (0.0, 0.0, 1.0) for link in parts.links],
        **at,
    )


def _springy(load: float, sinking: float) -> dict[str, float]:
    """Return stiffness and damping of a contact that gives by `sinking` (m) under `load` (N)."""
    stiffness = load / sinking
    return {
        "contactStiffness": stiffness,
        "contactDamping": 2 * CONTACT_DAMPING * math.sqrt(sinking / GRAVITY) * stiffness,
    }
