"""The world: a robot as pymunk bodies on wheels, stepped one sample period at a time."""

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
from castor_envs.physics.statics import castor_center, chassis, turned
from castor_envs.physics.wheel_records import enough_substeps, wheel_records
from castor_envs.robot import RobotDescription

Array = NDArray[np.float64]
Drive = Literal["servo", "voltage", "off"]

SOLVER_ITERATIONS = 10  # 4 do for the presets; a chassis lighter than its castors needs more
FASTEST = 1e3  # m/s and rad/s: nothing on castors moves so fast, so physics has gone wrong
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
        self.wheels = wheel_records(self.robot, self.floor)
        self.substeps = substeps or enough_substeps(self.robot, self.wheels)
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
            at = pose[:2] + turned(pivot, pose[2])
            u = twist[:2] + twist[2] * np.array([-pivot[1], pivot[0]])
            own = np.array([*turned(u, -theta[i]), twist[2] + rates[i]])
            _place(body, at, pose[2] + theta[i], own, castor_center(self.robot, i))
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
        if not np.all(np.abs(link.read()[:, 3:]) < FASTEST):
            raise InputError(
                f"robot {robot.name!r}: its physics became unstable at {self.time:.2f} s; a mass, an inertia or "
                "the contact is out of proportion to the others"
            )

    @property
    def pose(self) -> Array:
        """Pose of B in N: x, y (m), psi (rad, unwrapped)."""
        x, y, psi = self._link.read()[0, :3]
        return np.array([*((x, y) - turned(self._center, psi)), psi])

    @property
    def twist(self) -> Array:
        """Velocity of B's origin in B and turning rate: v_x, v_y (m/s), omega (rad/s)."""
        _, _, psi, *velocity, omega = self._link.read()[0]
        v = turned(np.array(velocity), -psi)
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


def _place(body: pymunk.Body, at: Array, angle: float, twist: Array, center: Array) -> None:
    """Put a body with frame origin `at` and `twist` in its frame; `center` is its centre of mass in that frame."""
    velocity = turned(np.array([twist[0] - twist[2] * center[1], twist[1] + twist[2] * center[0]]), angle)
    position = at + turned(center, angle)
    body.angle = float(angle)
    body.position = (float(position[0]), float(position[1]))
    body.velocity = (float(velocity[0]), float(velocity[1]))
    body.angular_velocity = float(twist[2])
