"""The world: a robot as pymunk bodies on wheels, stepped one sample period at a time."""

import numpy as np
import pymunk
from numpy.typing import ArrayLike
from pymunk.constraints import Constraint, PivotJoint, SimpleMotor

from castor_envs.effects.catalogue import creep_compliance_of, floor_of, radii_of
from castor_envs.errors import InputError, whole_number
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.bodies import motion_of, pose_of, twist_of
from castor_envs.geometry.se2 import rotate_single
from castor_envs.motion.kinematics import Geometry, castor_rates, inverse
from castor_envs.physics.stepper import Drive, Simulation, Stepper, move
from castor_envs.physics.wheel_state import enough_substeps, wheel_records
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.weight import castor_center, chassis

SOLVER_ITERATIONS = 10  # 4 do for the presets; a chassis lighter than its castors needs more


class RobotWorld:
    """A robot on a floor.

    Bodies: the chassis, which carries fixed castors rigidly, and every other castor on a pivot joint. Wheels are not
    bodies: each has a spin, a motor and a contact force (`castor_envs.physics.tyre`). Loads are constant, from the
    static balance of the chassis on its pivots; radii that change as castors turn are those of mid-sample.

    robot: effects are folded in. floor: as described; the robot's effects on it are added. pose: of B in N.
    castor_angles (n,): theta at the start, those of fixed castors ignored. twist: (v_x, v_y, omega) in B at the start;
    castors and wheels start in rolling motion with it. stepper: "compiled" or "reference" (plain Python). substeps: a
    sample period; None takes as many as the robot's stiffest contact needs. held: the castor (from 1) whose driven
    wheels are blocked, whatever they are commanded; in the attribute, which of the driven wheels they are (from 0).
    """

    def __init__(
        self,
        robot: RobotDescription,
        floor: Floor | None = None,
        *,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        castor_angles: ArrayLike | None = None,
        twist: ArrayLike = (0.0, 0.0, 0.0),
        stepper: Stepper = "compiled",
        substeps: int | None = None,
        held: int | None = None,
    ) -> None:
        self.robot = robot.as_built()
        self.floor = floor_of(robot, floor or Floor())
        self.geometry = Geometry.of(self.robot)
        self.wheels = wheel_records(self.robot, self.floor)
        self.wheels["creep_compliance"] = creep_compliance_of(robot)
        self.changing_radii = radii_of(robot)
        self.driven_wheels = np.array(self.robot.driven_wheels, dtype=np.intp)
        if held is not None:
            held = whole_number(held, "held, the number of a castor,")
        castor_number = np.array(self.robot.wheel_castors)[self.driven_wheels] + 1
        self.held = np.flatnonzero(castor_number == held)
        if held is not None and not self.held.size:
            raise InputError(f"robot {self.robot.name!r} has no castor {held} with driven wheels to hold")
        self.castor_bodies = np.cumsum(~self.geometry.fixed) * ~self.geometry.fixed

        self._mass, self._inertia, self.center = chassis(self.robot)
        motion, self.wheels["speed"] = self._start(pose, castor_angles, twist)
        bodies, joints = self._build(motion)
        self._steers = len(self.robot.driven_castors)
        self.simulation = Simulation(
            f"robot {self.robot.name!r}",
            bodies,
            joints,
            self.wheels,
            self.floor,
            sample_period=self.robot.sample_period,
            substeps=substeps or enough_substeps(self.robot, self.wheels),
            iterations=SOLVER_ITERATIONS,
            stepper=stepper,
        )

    def _start(self, pose: ArrayLike, castor_angles: ArrayLike | None, twist: ArrayLike) -> tuple[Array, Array]:
        """Return how bodies move at the start (b, 6), and how fast wheels turn (w,), rad/s."""
        pose, twist = np.asarray(pose, dtype=float), np.asarray(twist, dtype=float)
        angles = np.zeros(len(self.robot.castors)) if castor_angles is None else np.array(castor_angles, float)
        theta = np.where(self.geometry.fixed, self.geometry.angle, angles)
        rates, speed = np.zeros(len(theta)), np.zeros(len(self.wheels))
        if twist.any():
            rates = np.nan_to_num(castor_rates(self.geometry, theta, twist))
            speed = inverse(self.geometry, theta, rates, twist).rate
        motion = [motion_of(pose[:2], pose[2], twist, self.center)]
        for i, castor in enumerate(self.robot.castors):
            if castor.steering != "fixed":
                pivot = np.array(castor.pivot)
                at = pose[:2] + rotate_single(pivot, pose[2])
                u = twist[:2] + twist[2] * np.array([-pivot[1], pivot[0]])
                castor_twist = np.array([*rotate_single(u, -theta[i]), twist[2] + rates[i]])
                motion.append(motion_of(at, pose[2] + theta[i], castor_twist, castor_center(self.robot, i)))
        return np.array(motion), speed

    def _build(self, motion: Array) -> tuple[list[pymunk.Body], list[Constraint]]:
        base = pymunk.Body(self._mass, self._inertia)
        bodies: list[pymunk.Body] = [base]
        joints: list[Constraint] = []
        for castor in self.robot.castors:
            if castor.steering == "fixed":
                continue
            body = pymunk.Body(castor.mass, castor.inertia)
            joint = PivotJoint(base, body, tuple(np.array(castor.pivot) - self.center), (castor.offset, 0.0))
            joint.error_bias = 0.0  # all of a joint's drift is corrected in the next step
            joints.append(joint)
            if castor.steering == "driven":
                joints.append(SimpleMotor(base, body, 0.0))
            bodies.append(body)
        for body, row in zip(bodies, motion, strict=True):
            move(body, row)
        return bodies, joints

    def restart(
        self, castor_angles: ArrayLike, pose: ArrayLike = (0.0, 0.0, 0.0), twist: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Start again as if made anew, castors at these angles (n,); pose, twist: as for a new world."""
        motion, speed = self._start(pose, castor_angles, twist)
        self.simulation.restart(motion)
        self.wheels["speed"] = speed

    def advance(self, wheel_command: ArrayLike, steering_command: ArrayLike = 0.0, drive: Drive = "servo") -> None:
        """Run one sample period with constant commands.

        wheel_command (driven wheels,): rad/s; with drive "voltage" a fraction of the full voltage, in [-1, 1]. Beyond
        the robot's limits it is clipped. steering_command (driven castors,): rad/s. drive "off" leaves all motors
        dead.
        """
        robot = self.robot
        limit = robot.max_wheel_speed if drive == "servo" else 1.0
        self.simulation.command(self.driven_wheels, wheel_command, limit, drive)
        if self.held.size:
            self.simulation.command(self.driven_wheels[self.held], 0.0, 1.0, "off" if drive == "off" else "servo")
        if self._steers:
            most = robot.max_steering_speed
            rates = np.broadcast_to(np.minimum(np.maximum(steering_command, -most), most), self._steers)
            self.simulation.steer(rates, 0.0 if drive == "off" else robot.max_steering_torque)
        if self.changing_radii is not None:
            self.wheels["radius"] = self.changing_radii(self._half_on()[None])[0]
        self.simulation.advance()

    @property
    def time(self) -> float:
        """Since the start, s."""
        return self.simulation.time

    @property
    def substeps(self) -> int:
        """Substeps a sample period."""
        return self.simulation.substeps

    @property
    def dt(self) -> float:
        """Length of a substep, s."""
        return self.simulation.dt

    @property
    def pose(self) -> Array:
        """Pose of B in N: x, y (m), psi (rad, unwrapped)."""
        return pose_of(self.simulation.motion[0], self.center)

    @property
    def twist(self) -> Array:
        """Velocity of B's origin in B and turning rate: v_x, v_y (m/s), omega (rad/s)."""
        return twist_of(self.simulation.motion[0], self.center)

    @property
    def castor_angles(self) -> Array:
        """Theta of each castor (n,), rad, unwrapped."""
        angles = self.simulation.motion[:, 2]
        return np.where(self.geometry.fixed, self.geometry.angle, angles[self.castor_bodies] - angles[0])

    def _half_on(self) -> Array:
        """Return the castor angles (n,) half a sample period ahead at their present rates, rad."""
        rate = self.simulation.motion[:, 5]
        turning = np.where(self.geometry.fixed, 0.0, rate[self.castor_bodies] - rate[0])
        return self.castor_angles + turning * self.robot.sample_period / 2

    @property
    def wheel_angles(self) -> Array:
        """How far each wheel has turned since the start (w,), rad."""
        return np.array(self.wheels["angle"])

    def energy(self) -> float:
        """Return all mechanical energy, J."""
        return self.simulation.energy()
