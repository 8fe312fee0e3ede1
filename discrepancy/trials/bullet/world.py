"""Robots in PyBullet: rigid bodies in 3-D with its contacts, in steps of at most 2 ms.

Step. Contacts hold half-way through each step, so that what the encoders see belongs to the path to second order in
the step. Measured by halving it, in 20 s of random wander: the prototype's contacts slip by 1.4 um for each metre
rolled and by 3.6 um to the side with 2 ms, by 0.6 and 2.5 um with 1 ms, by 0.4 and 2.3 um with 0.5 ms. (What stays is
that the chassis leans as it speeds up; with rigid contacts nothing else slips.) Of first order is where the robot goes,
for motors answer to the rates of the step before: 1 ms puts it at most 0.9 mm elsewhere than 2 ms, on 4 m, counts and
reference alike. Robots whose steering motors can disagree (swerve, powered casters) slip where they do, by some 0.05 %
and 0.02 % of their way, whatever the step.

Cost. 60 s of the prototype take 11 s of CPU time, of other presets 8 to 22 s (six castors).
"""

import math

import numpy as np
from numpy.typing import NDArray

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.bullet.model import SKID_SINKING, Parts, bullet_module
from discrepancy.trials.foreign.run import GIVING_WAY, SETTLING, Simulator, friction_at
from discrepancy.trials.foreign.standing import DROOP, STEERING_DROOP, TILTING, damping_of
from discrepancy.trials.hidden import Outside

STEP = 2e-3
"""Physics step, s, at most."""

ITERATIONS, CLOSE = 200, 1e-14
"""Passes of Bullet's solver over all constraints, at most, and the square of the change of velocity (m/s or rad/s) in a
pass that ends them. 50 passes let wheels of little load slip by some 10 um in a metre."""

HEIGHT = 1.0
"""Height of the chassis' centre of mass over the axles, in wheel radii."""

CLEARANCE = 1e-3
"""How high over the floor the robot is put down, m."""


class World:
    """A robot in a separate Bullet world, moved on one physics step after the other.

    pivot (n,), roll (w,): which hinges are the castors' pivots (-1: fixed) and the wheels'. joint (j,): angles of
    hinges, rad. radius (w,): of rolling, m, at the moment. States are the angles (w + n,) of the wheels' rims since the
    start and of castors, and the pose (3,). Rims turn by more than treads where rolling radii are smaller than spheres:
    encoders and motors are on the rims.
    """

    def __init__(self, robot: RobotDescription, floor: Floor, step: float, outside: Outside | None = None) -> None:
        parts = Parts(robot, floor, step)
        if outside is not None:
            outside.build(parts)
        geometry, bullet = parts.geometry, bullet_module()
        driven, steered = list(robot.driven_wheels), list(robot.driven_castors)
        self.robot, self.geometry, self.tyres = robot, geometry, parts.tyres
        self._bullet, self._step, self._driven = bullet, step, driven
        self._gravity = (*floor.downhill_gravity, -floor.normal_gravity)
        self._at = at = {"physicsClientId": bullet.connect(bullet.DIRECT)}
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=step,
            numSubSteps=0,
            numSolverIterations=ITERATIONS,
            solverResidualThreshold=CLOSE,
            deterministicOverlappingPairs=1,
            **at,
        )
        ground = bullet.createMultiBody(0, bullet.createCollisionShape(bullet.GEOM_PLANE, **at), **at)
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, **at)  # Bullet multiplies it with the wheels'
        self._center = np.array([*robot.center_of_mass, HEIGHT * parts.height])
        larger = max(geometry.radius[link.wheel] - link.place[2] for link in parts.links if link.wheel is not None)
        self._place = np.array([0.0, 0.0, larger + CLEARANCE]) + self._center
        self._turn = np.array([0.0, 0.0, 0.0, 1.0])
        self._body, self._usual = self._made(parts), robot.contact.friction

        hinged = [(j, link) for j, link in enumerate(parts.links) if link.axis is not None]
        number = {link.name: at for at, (_, link) in enumerate(hinged)}
        self._hinges = [j for j, _ in hinged]
        spheres = {link.wheel: j for j, link in enumerate(parts.links) if link.wheel is not None}
        self._spheres = [spheres[k] for k in range(len(parts.load))]
        self.pivot = np.array([number.get(f"pivot_{i}", -1) for i in range(len(robot.castors))], dtype=np.intp)
        self.roll: NDArray[np.intp] = np.array([number[f"roll_{k}"] for k in range(len(parts.load))], dtype=np.intp)
        springs = np.array([link.spring for _, link in hinged])
        self._sprung = np.flatnonzero(springs[:, 0]).tolist()
        self._stiffness, self._damping = springs[self._sprung].T
        self.joint, self._rate = np.zeros((2, len(hinged)))
        self._speed, self._spin = np.zeros((2, 3))
        bullet.setJointMotorControlArray(
            self._body, self._hinges, bullet.VELOCITY_CONTROL, forces=[0.0] * len(hinged), **at
        )
        bullet.setGravity(*self._gravity, **at)

        self.radius, self._turned = geometry.radius.copy(), np.zeros(len(geometry.radius))
        self._outside = outside
        self._patches, self._friction = floor.patches, np.full(len(geometry.radius), self._usual)
        self._mean_load, self._soft_load = parts.load[driven].mean(), parts.load.copy()
        self._motors = [*self.roll[driven].tolist(), *self.pivot[steered].tolist()]
        motors = [(robot.max_wheel_torque, DROOP, robot.max_wheel_speed)] * len(driven)
        motors += [(robot.max_steering_torque, STEERING_DROOP, robot.max_steering_speed)] * len(steered)
        self._torque, droop, self._limit = np.array(motors).T
        self._gain, self._gear = self._torque / (droop * self._limit), np.ones(len(motors))

    def _made(self, parts: Parts) -> int:
        """Make the articulated body, its chassis' centre of mass at its place, and return its number."""
        bullet, at, links, robot, radius = self._bullet, self._at, parts.links, parts.robot, parts.height / 4
        number = {link.name: j for j, link in enumerate(links)}
        chassis = -1
        if len(parts.skids):
            low = parts.sinking - SKID_SINKING - parts.height + radius
            skids = [[x - self._center[0], y - self._center[1], low - self._center[2]] for x, y in parts.skids.tolist()]
            chassis = bullet.createCollisionShapeArray(
                shapeTypes=[bullet.GEOM_SPHERE] * len(skids),
                radii=[radius] * len(skids),
                collisionFramePositions=skids,
                **at,
            )
        shapes = [-1] * len(links)
        for j, link in enumerate(links):
            if link.wheel is not None:
                tread = float(parts.geometry.radius[link.wheel])
                shapes[j] = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=tread, **at)
        from_center = [-self._center if link.parent is None else np.zeros(3) for link in links]
        level = [0.0, 0.0, 0.0, 1.0]
        body = bullet.createMultiBody(
            robot.mass,
            chassis,
            -1,
            self._place.tolist(),
            level,
            linkMasses=[link.mass for link in links],
            linkCollisionShapeIndices=shapes,
            linkVisualShapeIndices=[-1] * len(links),
            linkPositions=[(np.array(link.place) + off).tolist() for link, off in zip(links, from_center, strict=True)],
            linkOrientations=[[0.0, 0.0, math.sin(link.turned / 2), math.cos(link.turned / 2)] for link in links],
            linkInertialFramePositions=[[-link.behind, 0.0, 0.0] for link in links],
            linkInertialFrameOrientations=[level] * len(links),
            linkParentIndices=[0 if link.parent is None else number[link.parent] + 1 for link in links],
            linkJointTypes=[bullet.JOINT_FIXED if link.axis is None else bullet.JOINT_REVOLUTE for link in links],
            linkJointAxis=[link.axis or (0.0, 0.0, 1.0) for link in links],
            **at,
        )
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
        for j, link in enumerate(links):
            bullet.changeDynamics(body, j, localInertiaDiagonal=link.inertia, jointDamping=0.0, **at)
            if link.wheel is not None:
                springy = _springy(float(parts.load[link.wheel]), parts.sinking)
                bullet.changeDynamics(body, j, lateralFriction=robot.contact.friction, **springy, **at)
            if link.limits is not None:
                low, high = link.limits
                bullet.changeDynamics(body, j, jointLowerLimit=low, jointUpperLimit=high, **at)
        return body

    def close(self) -> None:
        """Remove the world."""
        self._bullet.disconnect(**self._at)

    def settle(self, theta: Array, start: tuple[float, float, float]) -> None:
        """Let the robot stand on its contacts, castors at theta (n,), then put it to the start at rest, leaning as it
        leans."""
        turning, still = self.pivot >= 0, np.zeros(len(self._motors))
        self.joint[self.pivot[turning]] = theta[turning]
        self._bullet.setGravity(0.0, 0.0, self._gravity[2], **self._at)
        for _ in range(round(SETTLING / self._step)):
            self._servo(still)
            self._advance()
        self._bullet.setGravity(*self._gravity, **self._at)
        self._turn = turned(self._turn, np.array([0.0, 0.0, start[2] - self._pose()[2]]))
        self._place[:2] += start[:2] - self._pose()[:2]
        self._speed, self._spin, self._rate = np.zeros(3), np.zeros(3), np.zeros(len(self._hinges))
        self._turned[:] = 0.0

    def step(self, t: float, wheel: Array, steering: Array) -> None:
        """Make one step from t with wheels and steering commanded at rates, rad/s."""
        if self.tyres.shrinking or self._outside is not None:
            self._set_radii(t)
        if self._patches:
            self._set_friction()
        self._servo(np.concatenate([wheel, steering]))
        self._advance()
        self._turned += self._step * self._rate[self.roll] * self.geometry.radius / self.radius

    def state(self) -> Array:
        """Return the angles of wheels and castors, and the pose."""
        return np.concatenate([self._turned, self._castors(), self._pose()])

    def angles(self, states: Array) -> Array:
        """Return the angles (m, w + n) in states (m, s)."""
        return states[:, :-3]

    def poses(self, states: Array) -> Array:
        """Return the poses (m, 3) in successive states (m, s)."""
        return np.column_stack([states[:, -3:-1], np.unwrap(states[:, -1])])

    def _castors(self) -> Array:
        return np.where(self.pivot >= 0, self.joint[self.pivot], self.geometry.angle)

    def _pose(self) -> Array:
        """Return the pose (3,) of B: x, y, m, and psi, rad, between -pi and pi."""
        x, y, z, w = self._turn.tolist()
        origin = self._place - rotated(self._turn, self._center)
        return np.array([origin[0], origin[1], math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))])

    def _servo(self, command: Array) -> None:
        """Let motors turn their hinges toward rates (k,), rad/s, with torques in proportion to what is missing."""
        command = np.clip(command, -self._limit, self._limit)
        behind = np.abs(command - self._rate[self._motors] * self._gear)
        self._bullet.setJointMotorControlArray(
            self._body,
            [self._hinges[hinge] for hinge in self._motors],
            self._bullet.VELOCITY_CONTROL,
            targetVelocities=(command / self._gear).tolist(),
            velocityGains=[1.0] * len(self._motors),
            forces=(np.minimum(self._gain * behind, self._torque) * self._gear).tolist(),
            **self._at,
        )

    def _advance(self) -> None:
        """Make one step: velocities that hold half-way through it, where Bullet is put, then the whole step."""
        bullet, body, at, half = self._bullet, self._body, self._at, self._step / 2
        if self._sprung:
            torque = -self._stiffness * self.joint[self._sprung] - self._damping * self._rate[self._sprung]
            hinges = [self._hinges[hinge] for hinge in self._sprung]
            bullet.setJointMotorControlArray(body, hinges, bullet.TORQUE_CONTROL, forces=torque.tolist(), **at)
        place, turn = self._place + half * self._speed, turned(self._turn, half * self._spin)
        bullet.resetBasePositionAndOrientation(body, place.tolist(), turn.tolist(), **at)
        bullet.resetBaseVelocity(body, self._speed.tolist(), self._spin.tolist(), **at)
        joint = self.joint + half * self._rate
        bullet.resetJointStatesMultiDof(body, self._hinges, joint[:, None].tolist(), self._rate[:, None].tolist(), **at)
        bullet.stepSimulation(**at)
        self._speed, self._spin = map(np.array, bullet.getBaseVelocity(body, **at))
        self._rate = np.array([joint[1] for joint in bullet.getJointStates(body, self._hinges, **at)])
        self._place = self._place + self._step * self._speed
        self._turn = turned(self._turn, self._step * self._spin)
        self.joint = self.joint + self._step * self._rate

    def _loads(self) -> Array:
        """Return the loads of wheels on the floor (w,), N."""
        load = np.zeros(len(self._spheres))
        for contact in self._bullet.getContactPoints(self._body, **self._at):
            if contact[3] in self._spheres:
                load[self._spheres.index(contact[3])] += contact[9]
        return load

    def _set_radii(self, t: float) -> None:
        geometry, shrinking = self.geometry, self.tyres.shrinking
        self.radius[:] = geometry.radius
        if shrinking:
            self._soft_load += (self._loads() - self._soft_load) * min(self._step / GIVING_WAY, 1.0)
            self.radius -= shrinking * (self._soft_load - self._mean_load)
        if self._outside is not None:
            self._outside.act(self, t)
        self._gear[: len(self._driven)] = (geometry.radius / self.radius)[self._driven]

    def _set_friction(self) -> None:
        geometry, (x, y, heading) = self.geometry, self._pose()
        castor, theta = geometry.wheel_castor, self._castors()[geometry.wheel_castor]
        from_pivot = rotate(np.column_stack([-geometry.offset[castor], geometry.lateral]), theta)
        places = rotate(geometry.pivot[castor] + from_pivot, heading) + np.array([x, y])
        for k, place in enumerate(places.tolist()):
            friction = friction_at(self._patches, place, self._usual)
            if friction != self._friction[k]:
                self._bullet.changeDynamics(self._body, self._spheres[k], lateralFriction=friction, **self._at)
                self._friction[k] = friction


def turned(turn: Array, by: Array) -> Array:
    """Return a quaternion (x, y, z, w) turned further by a rotation vector (3,) in N, rad.

    Bullet's own are of single precision, and scipy's rotations make a step take half as long again.
    """
    x, y, z, w = turn.tolist()
    angle = math.sqrt(float(by @ by))
    a, b, c = (by * (math.sin(angle / 2) / angle if angle > 0 else 0.5)).tolist()
    d = math.cos(angle / 2)
    vector = d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w
    return np.array([*vector, d * w - a * x - b * y - c * z])


def rotated(turn: Array, vector: Array) -> Array:
    """Return a vector (3,) turned by a quaternion (x, y, z, w)."""
    axis, w = turn[:3], turn[3]
    side = 2 * np.cross(axis, vector)
    return vector + w * side + np.cross(axis, side)


def _springy(load: float, sinking: float) -> dict[str, float]:
    """Return stiffness and damping of a contact that gives by `sinking` (m) under `load` (N)."""
    stiffness = load / sinking
    return {"contactStiffness": stiffness, "contactDamping": damping_of(sinking) * stiffness}


SIMULATOR = Simulator(World, STEP)
simulate, drive = SIMULATOR.simulate, SIMULATOR.drive
