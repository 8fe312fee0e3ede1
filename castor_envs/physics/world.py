"""The world: a robot as pymunk bodies on wheels, stepped one sample period at a time."""

import math
from typing import Literal

import numpy as np
import pymunk
from numpy.typing import ArrayLike, NDArray
from pymunk.constraints import Constraint, PivotJoint, SimpleMotor

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.kinematics import Geometry, castor_rates, inverse
from castor_envs.physics import wheels as law
from castor_envs.physics.chipmunk import BodyLink
from castor_envs.robot import RobotDescription

Array = NDArray[np.float64]
Drive = Literal["servo", "voltage", "off"]

SERVO_BANDWIDTH = 40.0  # rad/s: settles well within a 50 ms sample period
SOLVER_ITERATIONS = 4
_DRIVES = {"off": law.OFF, "servo": law.SERVO, "voltage": law.VOLTAGE}


class World:
    """A robot on a floor.

    Bodies: the chassis, which carries fixed castors rigidly, and every other castor on a pivot joint. Wheels are not
    bodies: each has a spin, a motor and a contact force (`castor_envs.physics.wheels`). Loads are constant, from the
    static balance of the chassis on its pivots.

    robot: effects are folded in. pose: of B in N. castor_angles (n,): theta at the start, those of fixed castors
    ignored. twist: (v_x, v_y, omega) in B at the start; castors and wheels start in rolling motion with it. stepper:
    "compiled" or "reference" (plain Python). substeps: a sample period; None takes as many as the robot's stiffest
    contact needs.
    """

    def __init__(
        self,
        robot: RobotDescription,
        floor: Floor | None = None,
        *,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        castor_angles: ArrayLike | None = None,
        twist: ArrayLike = (0.0, 0.0, 0.0),
        stepper: Literal["compiled", "reference"] = "compiled",
        substeps: int | None = None,
    ) -> None:
        self.robot = robot.as_built()
        self.floor = floor or Floor()
        self.geometry = Geometry.of(self.robot)
        self.wheels = _wheel_records(self.robot, self.floor)
        self.substeps = substeps or _enough_substeps(self.robot, self.wheels)
        self.dt = self.robot.sample_period / self.substeps
        self.time = 0.0
        self._stepper = stepper
        self._driven_wheels = np.array(self.robot.driven_wheels, dtype=np.intp)
        self._patches, self._cables = self.floor.patch_array(), self.floor.cable_array()

        angles = np.zeros(len(self.robot.castors)) if castor_angles is None else np.array(castor_angles, float)
        self._start_angles = np.where(self.geometry.fixed, self.geometry.angle, angles)
        self._build(np.asarray(pose, dtype=float), np.asarray(twist, dtype=float))

    def _build(self, pose: Array, twist: Array) -> None:
        self._space = pymunk.Space()
        self._space.iterations = SOLVER_ITERATIONS
        self._space.gravity = self.floor.downhill_gravity
        theta = self._start_angles
        rates = np.nan_to_num(castor_rates(self.geometry, theta, twist))
        spin = inverse(self.geometry, theta, rates, twist).rate
        self.wheels["speed"] = spin

        mass, inertia, center = chassis(self.robot)
        self._center = center
        base = pymunk.Body(mass, inertia)
        _place(base, pose[:2], pose[2], twist, center)
        self._bodies = [base]
        self._motors: list[SimpleMotor] = []
        joints: list[Constraint] = []
        for i, castor in enumerate(self.robot.castors):
            if castor.steering == "fixed":
                continue
            body = pymunk.Body(castor.mass, castor.inertia)
            pivot = np.array(castor.pivot)
            at = pose[:2] + _turned(pivot, pose[2])
            u = twist[:2] + twist[2] * np.array([-pivot[1], pivot[0]])
            own = np.array([*_turned(u, -theta[i]), twist[2] + rates[i]])
            _place(body, at, pose[2] + theta[i], own, np.array([-castor.offset, 0.0]))
            joint = PivotJoint(base, body, tuple(pivot - center), (castor.offset, 0.0))
            joint.error_bias = 0.0  # all of a joint's drift is put right in the next step
            joints.append(joint)
            if castor.steering == "driven":
                motor = SimpleMotor(base, body, 0.0)
                self._motors.append(motor)
                joints.append(motor)
            self._bodies.append(body)
        self._space.add(*self._bodies, *joints)
        self._link = BodyLink(self._space, self._bodies)
        self._castor_bodies = np.cumsum(~self.geometry.fixed) * ~self.geometry.fixed

    def advance(self, wheel_command: ArrayLike, steering_command: ArrayLike = 0.0, drive: Drive = "servo") -> None:
        """Run one sample period with constant commands.

        wheel_command (driven wheels,): rad/s; with drive "voltage" a fraction of the full voltage, in [-1, 1]. Beyond
        the robot's limits it is clipped. steering_command (driven castors,): rad/s. drive "off" leaves all motors
        dead.
        """
        robot = self.robot
        limit = robot.max_wheel_speed if drive == "servo" else 1.0
        self.wheels["drive"][self._driven_wheels] = _DRIVES[drive]
        self.wheels["command"][self._driven_wheels] = np.clip(wheel_command, -limit, limit)
        rates = np.broadcast_to(np.asarray(steering_command, dtype=float), len(self._motors))
        for motor, rate in zip(self._motors, rates, strict=True):
            motor.rate = -float(np.clip(rate, -robot.max_steering_speed, robot.max_steering_speed))
            motor.max_force = 0.0 if drive == "off" else robot.max_steering_torque
        link = self._link
        if self._stepper == "compiled":
            law.advance(
                link.addresses,
                link.motion,
                link.got,
                link.loads,
                link.given,
                self.wheels,
                self._patches,
                self._cables,
                self.floor.climbing,
                self.dt,
                self.substeps,
            )
        else:
            records = self.wheels.view(np.recarray)
            for _ in range(self.substeps):
                law.wheel_forces(
                    link.read(),
                    records,
                    self._patches,
                    self._cables,
                    self.floor.climbing,
                    self.dt,
                    link.loads,
                )
                link.write()
                self._space.step(self.dt)
        self.time += self.robot.sample_period

    @property
    def pose(self) -> Array:
        """Pose of B in N: x, y (m), psi (rad, unwrapped)."""
        x, y, psi = self._link.read()[0, :3]
        return np.array([*((x, y) - _turned(self._center, psi)), psi])

    @property
    def twist(self) -> Array:
        """Velocity of B's origin in B and turning rate: v_x, v_y (m/s), omega (rad/s)."""
        _, _, psi, *velocity, omega = self._link.read()[0]
        v = _turned(np.array(velocity), -psi)
        return np.array([v[0] + omega * self._center[1], v[1] - omega * self._center[0], omega])

    @property
    def castor_angles(self) -> Array:
        """Theta of each castor (n,), rad, unwrapped."""
        angles = self._link.read()[:, 2]
        return np.where(self.geometry.fixed, self.geometry.angle, angles[self._castor_bodies] - angles[0])

    @property
    def wheel_angles(self) -> Array:
        """How far each wheel has turned since the start (w,), rad."""
        return np.array(self.wheels["angle"])

    def energy(self) -> float:
        """Return all mechanical energy: bodies, wheel spin, bristles, slope, wheels risen on cables; J.

        Chipmunk moves first and accelerates then, so its velocities are those of half a substep after the positions:
        heights and bristles are taken there, these halfway to where the next substep brings them.
        """
        motion, w, after = self._link.read(), self.wheels, self.wheels.copy()
        unused = np.zeros_like(self._link.loads)
        law.wheel_forces(
            motion, after.view(np.recarray), self._patches, self._cables, self.floor.climbing, self.dt, unused
        )
        masses = np.array([body.mass for body in self._bodies])
        inertias = np.array([body.moment for body in self._bodies])
        kinetic = 0.5 * np.sum(masses * (motion[:, 3] ** 2 + motion[:, 4] ** 2) + inertias * motion[:, 5] ** 2)
        middle = motion[:, :2] + 0.5 * self.dt * motion[:, 3:5]
        height = -np.sum(masses[:, None] * middle * np.array(self.floor.downhill_gravity))
        spin = 0.5 * np.sum(w["inertia"] * w["speed"] ** 2)
        long = 0.5 * (w["stretch_long"] + after["stretch_long"])
        lat = 0.5 * (w["stretch_lat"] + after["stretch_lat"])
        bristles = 0.5 * np.sum(w["stiffness_long"] * long**2 + w["stiffness_lat"] * lat**2)
        risen = self._climbed(motion) if self.floor.climbing else 0.0
        return float(kinetic + height + spin + bristles + risen)

    def _climbed(self, motion: Array) -> float:
        """Return the potential energy of wheels that stand on cables half a substep on, J."""
        energy = 0.0
        for wheel in self.wheels.view(np.recarray):
            x, y, arm_x, arm_y, _, _ = law.contact_at(wheel, motion[wheel.body], 0.5 * self.dt)
            place = x + arm_x, y + arm_y
            energy += wheel.load * law.rise_between(*place, *place, wheel.radius, self._cables)[0]
        return float(energy)


def _turned(vector: Array, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _place(body: pymunk.Body, at: Array, angle: float, twist: Array, center: Array) -> None:
    """Put a body with frame origin `at` and `twist` in its frame; `center` is its centre of mass in that frame."""
    velocity = _turned(np.array([twist[0] - twist[2] * center[1], twist[1] + twist[2] * center[0]]), angle)
    position = at + _turned(center, angle)
    body.angle = float(angle)
    body.position = (float(position[0]), float(position[1]))
    body.velocity = (float(velocity[0]), float(velocity[1]))
    body.angular_velocity = float(twist[2])


def castor_center(robot: RobotDescription, i: int) -> Array:
    """Return the centre of mass of castor i in the frame of its pivot turned by its own angle: behind the pivot."""
    return np.array([-robot.castors[i].offset, 0.0])


def chassis(robot: RobotDescription) -> tuple[float, float, Array]:
    """Return mass, inertia and centre of mass (2,) in B of the chassis with the castors fixed to it."""
    parts = [(robot.mass, robot.inertia, np.array(robot.center_of_mass))]
    for i, castor in enumerate(robot.castors):
        if castor.steering == "fixed":
            center = np.array(castor.pivot) + _turned(castor_center(robot, i), castor.angle)
            parts.append((castor.mass, castor.inertia, center))
    mass = sum(part[0] for part in parts)
    center = sum((part[0] * part[2] for part in parts), np.zeros(2)) / mass
    inertia = sum(part[1] + part[0] * float(np.sum((part[2] - center) ** 2)) for part in parts)
    return mass, inertia, center


def wheel_loads(robot: RobotDescription, gravity: float) -> Array:
    """Return the load on each wheel (w,), N.

    The chassis stands on its pivots: the smallest loads (in the sum of squares) that balance its weight and moments,
    which is exact for three; a pivot bearing takes moments, so a castor's own weight and load stand on its wheels by
    the lever rule about the pivot's line. Moments that no arrangement of these pivots can balance are left to support
    castors without load.
    """
    pivots = np.array([castor.pivot for castor in robot.castors])
    balance = np.vstack([np.ones(len(pivots)), pivots.T])
    weight = robot.mass * gravity * np.array([1.0, *robot.center_of_mass])
    on_pivot = np.linalg.pinv(balance, rcond=1e-9) @ weight
    on_pivot *= robot.mass * gravity / np.sum(on_pivot)
    loads = []
    for castor, load in zip(robot.castors, on_pivot, strict=True):
        if load <= 0:
            raise InputError(
                f"robot {robot.name!r}: center_of_mass {robot.center_of_mass} lies outside its pivots, and the castor "
                f"at {castor.pivot} would lift; move one of them"
            )
        total = float(load) + castor.mass * gravity
        lateral = np.array([wheel.lateral for wheel in castor.wheels])
        if len(lateral) == 1:
            share = np.ones(1)
        else:
            share = np.linalg.pinv(np.vstack([np.ones(len(lateral)), lateral])) @ np.array([1.0, 0.0])
        if np.any(share <= 0):
            raise InputError(
                f"robot {robot.name!r}: the wheels of the castor at {castor.pivot} all stand to one side of its pivot, "
                "and it would tip; set their lateral positions to both sides"
            )
        loads += list(total * share)
    return np.array(loads)


def _wheel_records(robot: RobotDescription, floor: Floor) -> NDArray[np.void]:
    records = np.zeros(len(robot.wheels), dtype=law.WHEEL)
    loads = wheel_loads(robot, floor.normal_gravity)
    contact, center = robot.contact, chassis(robot)[2]
    body = 0
    k = 0
    for castor in robot.castors:
        moving = castor.steering != "fixed"
        body += moving
        for wheel in castor.wheels:
            w = records[k]
            if moving:
                place, heading = np.array([0.0, wheel.lateral]), 0.0
            else:
                at = _turned(np.array([-castor.offset, wheel.lateral]), castor.angle)
                place, heading = np.array(castor.pivot) + at - center, castor.angle
            w["body"] = body if moving else 0
            w["x"], w["y"] = place
            w["cos"], w["sin"] = math.cos(heading), math.sin(heading)
            w["radius"], w["inertia"], w["load"] = wheel.radius, wheel.inertia, loads[k]
            w["grip"] = law.STANDARD if wheel.grip == "standard" else law.OMNI
            w["roller"] = math.tan(wheel.roller_angle)
            w["friction"], w["relaxation"] = contact.friction, contact.relaxation_length
            w["stiffness_long"] = contact.slip_stiffness_long * loads[k] / contact.relaxation_length
            w["stiffness_lat"] = contact.slip_stiffness_lat * loads[k] / contact.relaxation_length
            w["damping_long"] = contact.damping * w["stiffness_long"]
            w["damping_lat"] = contact.damping * w["stiffness_lat"]
            felt = wheel.inertia + loads[k] / floor.normal_gravity * wheel.radius**2
            w["proportional"] = SERVO_BANDWIDTH * felt
            w["integral_gain"] = SERVO_BANDWIDTH**2 / 4 * felt
            w["max_torque"], w["max_speed"] = robot.max_wheel_torque, robot.max_wheel_speed
            k += 1
    return records


def _enough_substeps(robot: RobotDescription, records: NDArray[np.void]) -> int:
    """Return the substeps a sample period that keep the stiffest castor's contact mode well resolved.

    The contact sees body velocities explicitly, so with mode frequency omega a substep must keep omega dt and the
    bristle damping's omega^2 damping dt small.
    """
    fastest = 0.0
    offset_of = {k: robot.castors[i].offset for k, i in enumerate(robot.wheel_castors)}
    for i, castor in enumerate(robot.castors):
        own = [k for k, j in enumerate(robot.wheel_castors) if i == j]
        stiffness = np.array([max(records[k]["stiffness_long"], records[k]["stiffness_lat"]) for k in own])
        arm = np.array([robot.wheels[k].lateral ** 2 + offset_of[k] ** 2 for k in own])
        if castor.steering == "fixed":
            mass, inertia, _ = chassis(robot)
            turning = float(np.sum(stiffness * arm)) / inertia
        else:
            mass = castor.mass
            turning = float(np.sum(stiffness * arm)) / (castor.inertia + castor.mass * castor.offset**2)
        fastest = max(fastest, float(np.sum(stiffness)) / mass, turning)
    longest = min(5e-4, 0.25 / math.sqrt(fastest), 0.3 / (fastest * max(robot.contact.damping, 1e-9)))
    return math.ceil(robot.sample_period / longest)
