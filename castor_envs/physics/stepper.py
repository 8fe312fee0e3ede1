"""Bodies and wheels, stepped one sample period at a time, two ways that agree: compiled, and by pymunk."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pymunk
from numpy.typing import ArrayLike, NDArray
from pymunk.constraints import Constraint, SimpleMotor

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.kernels.arguments import array
from castor_envs.kernels.kernel import Kernel
from castor_envs.physics import tyre as law
from castor_envs.physics.solver import (
    BODY,
    INVERSE,
    JOINT,
    LOAD,
    MOTOR,
    PLACE,
    SPRING,
    joint_records,
    places_ahead,
    solving_order,
)

Drive = Literal["servo", "voltage", "off"]
Stepper = Literal["compiled", "reference"]

FASTEST = 1e3  # m/s and rad/s: nothing on wheels moves so fast, so physics has gone wrong

WORLD = np.dtype(
    [
        # substeps a sample period: the most and the fewest of all lanes, and each one's own; whether cables are
        # climbed; a substep's length (s), and gravity downhill (m/s2)
        *((name, np.int64) for name in ("substeps", "fewest", "climbing")),
        *((name, float) for name in ("own_substeps", "dt", "gravity_x", "gravity_y")),
    ],
    align=True,
)
ADVANCE = Kernel(
    "castor_envs.physics.compiled_loop",
    "advance",
    (
        *(array(WORLD, 1), array(BODY, 1), array(INVERSE, 1), array(JOINT, 1), array(np.uint16, 1)),
        *(array(law.WHEEL, 1), array(float, 2), array(float, 2), array(LOAD, 1), array(PLACE, 1), array(PLACE, 1)),
        *(array(float, 1), array(float, 1)),
    ),
)
DRIVES = {"off": law.OFF, "servo": law.SERVO, "voltage": law.VOLTAGE}


def records(rows: Array, kind: np.dtype) -> NDArray[np.void]:
    """Return rows (n, k) as records (n,) of k numbers, in the same memory."""
    return rows.view(kind)[:, 0]


def move(body: pymunk.Body, motion: Array) -> None:
    """Let a body of pymunk move like this (6,)."""
    x, y, angle, v_x, v_y, spin = motion.tolist()
    body.angle, body.position = angle, (x, y)
    body.velocity, body.angular_velocity = (v_x, v_y), spin


class Simulation:
    """What `RobotWorld` and `TrainWorld` share: bodies and joints, wheels on them, a floor, and time.

    name: of what is simulated, for errors. bodies: in the order in which wheels count them. wheels (w,): records
    (`castor_envs.physics.tyre.WHEEL`). iterations: of the solver. stepper: "compiled", or "reference" (plain Python,
    and pymunk for the bodies). motion (b, 6): of each body x, y, angle, v_x, v_y, angular velocity, of its centre of
    mass in N. layout: of each joint its kind and its two bodies.
    """

    def __init__(
        self,
        name: str,
        bodies: Sequence[pymunk.Body],
        joints: Sequence[Constraint],
        wheels: NDArray[np.void],
        floor: Floor,
        *,
        sample_period: float,
        substeps: int,
        iterations: int,
        stepper: Stepper,
    ) -> None:
        self.name, self.wheels, self.floor = name, wheels, floor
        self.sample_period, self.dt, self.substeps = sample_period, sample_period / substeps, substeps
        self.time = 0.0
        self._space = pymunk.Space()
        self._space.iterations = iterations
        self._space.gravity = floor.downhill_gravity
        self._space.add(*bodies, *joints)
        self._motors = [joint for joint in joints if isinstance(joint, SimpleMotor)]
        self._stepper: Stepper = stepper
        self._bodies, self._shown = tuple(bodies), False
        self.motion = np.empty((len(bodies), 6))
        self._take()
        self.masses = np.array([(body.mass, body.moment) for body in bodies])
        self.joints = joint_records(bodies, joints, self.dt)
        law.for_substeps(wheels, self.dt)
        self._fresh = wheels.copy(), self.joints.copy()
        self.iterations, self.layout = iterations, tuple(self.joints[["kind", "a", "b"]].tolist())
        self.patches, self.cables = floor.patch_array(), floor.cable_array()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_run_substeps"}  # bound to its memory

    @property
    def space(self) -> pymunk.Space:
        """The same bodies, as they are now, in pymunk; how they are moved there counts. Ask again after `advance`."""
        if not self._shown:
            for body, row in zip(self._bodies, self.motion, strict=True):
                move(body, row)
            self._shown = True
        return self._space

    def _take(self) -> None:
        """Move as the bodies in pymunk do."""
        for row, body in zip(self.motion, self._bodies, strict=True):
            row[:] = *body.position, body.angle, *body.velocity, body.angular_velocity

    @property
    def settings(self) -> tuple[float, ...]:
        """The record of `WORLD`."""
        few = self.substeps
        return few, few, self.floor.climbing, few, self.dt, *self.floor.downhill_gravity

    @cached_property
    def _run_substeps(self) -> Callable[[], None]:
        """The compiled loop over the substeps of a sample period."""
        order, bodies = solving_order(self.layout, self.iterations), len(self.motion)
        world = np.array([self.settings], dtype=WORLD)
        scratch = (*(np.empty(bodies, dtype=kind) for kind in (LOAD, PLACE, PLACE)), np.empty(0), np.empty(0))
        there = self.wheels, self.patches, self.cables
        moving, inverse = records(self.motion, BODY), records(1.0 / self.masses, INVERSE)
        return ADVANCE.bind(world, moving, inverse, self.joints, order, *there, *scratch)

    def restart(self, motion: Array) -> None:
        """Start again, bodies in `motion` (b, 6), as if made anew. Compiled ones only: pymunk's joints remember."""
        if self._stepper != "compiled":
            raise ValueError("a world of the reference stepper cannot start again; make a new one")
        self.resume(motion, *self._fresh, 0.0)

    def resume(self, motion: Array, wheels: NDArray[np.void], joints: NDArray[np.void], time: float) -> None:
        """Take a state: motion (b, 6), records of wheels and joints, time (s)."""
        self.motion[:], self.wheels[:], self.joints[:] = motion, wheels, joints
        self.time, self._shown = time, False

    def command(self, wheels: NDArray[np.intp], command: ArrayLike, limit: ArrayLike, drive: Drive) -> None:
        """Set the mode of some wheels' motors, and their command within +-limit."""
        self.wheels["drive"][wheels] = DRIVES[drive]
        self.wheels["command"][wheels] = np.minimum(np.maximum(command, -np.asarray(limit)), limit)

    def steer(self, rates: ArrayLike, most: float) -> None:
        """Command the motors between bodies: rates (m,), rad/s, of the second against the first, within +-most N m."""
        motors = self.joints["kind"] == MOTOR
        self.joints["rate"][motors] = -np.asarray(rates)
        self.joints["most"][motors] = most * self.dt
        if self._stepper == "reference":
            for motor, rate in zip(self._motors, np.asarray(rates).tolist(), strict=True):
                motor.rate, motor.max_force = -rate, most

    def advance(self) -> None:
        """Run one sample period; raises InputError where physics becomes unstable."""
        if self._shown:
            self._take()
            self._shown = False
        if self._stepper == "compiled":
            self._run_substeps()
        else:
            self._advance_by_pymunk()
        self.time += self.sample_period
        if not np.abs(self.motion[:, 3:]).max() < FASTEST:
            raise self.unstable(self.time)

    def unstable(self, time: float) -> InputError:
        """Return the error for physics that became unstable at a time, s."""
        return InputError(
            f"{self.name}: its physics became unstable at {time:.2f} s; a mass, an inertia, a stiffness or "
            "the contact is out of proportion to the others"
        )

    def _advance_by_pymunk(self) -> None:
        """Run the substeps in plain Python: the same laws for wheels, pymunk for bodies and joints."""
        loads = np.empty(len(self.motion), dtype=LOAD).view(np.recarray)
        for _ in range(self.substeps):
            self._wheel_forces(self.wheels, loads)
            for body, (x, y, torque) in zip(self._bodies, loads.tolist(), strict=True):
                body.force, body.torque = (x, y), torque
            self._space.step(self.dt)
            self._take()

    def _wheel_forces(self, wheels: NDArray[np.void], loads: Any) -> Any:
        """Advance wheels by a substep in plain Python, fill in loads (b,); return the places (b,) of half a substep."""
        bodies = records(self.motion, BODY).view(np.recarray)
        middle, end = np.empty((2, len(bodies)), dtype=PLACE).view(np.recarray)
        places_ahead(bodies, 0.5 * self.dt, middle)
        places_ahead(bodies, self.dt, end)
        there = self.patches, self.cables, self.floor.climbing
        law.wheel_forces(bodies, middle, end, wheels.view(np.recarray), *there, self.dt, loads)
        return middle

    def energy(self) -> float:
        """Return all mechanical energy: bodies, wheel spin, bristles, bent frames, slope, wheels on cables; J.

        Chipmunk moves first and accelerates then, so its velocities are those of half a substep after the positions:
        heights, bends and bristles are taken there, these halfway to where the next substep brings them.
        """
        motion, w, after = self.motion, self.wheels, self.wheels.copy()
        middle = self._wheel_forces(after, np.empty(len(motion), dtype=LOAD).view(np.recarray))
        masses, inertias = self.masses.T
        kinetic = 0.5 * np.sum(masses * (motion[:, 3] ** 2 + motion[:, 4] ** 2) + inertias * motion[:, 5] ** 2)
        gravity_x, gravity_y = self.floor.downhill_gravity
        height = -np.sum(masses * (gravity_x * middle.x + gravity_y * middle.y))
        spin = 0.5 * np.sum(w["inertia"] * w["speed"] ** 2)
        long = 0.5 * (w["stretch_long"] + after["stretch_long"])
        lat = 0.5 * (w["stretch_lat"] + after["stretch_lat"])
        bristles = 0.5 * np.sum(w["stiffness_long"] * long**2 + w["stiffness_lat"] * lat**2)
        risen = self._climbed(middle) if self.floor.climbing else 0.0
        return float(kinetic + height + spin + bristles + self._bent() + risen)

    def _bent(self) -> float:
        """Return the energy in rotary springs half a substep on, J."""
        springs = self.joints[self.joints["kind"] == SPRING]
        a, b = self.motion[springs["a"]], self.motion[springs["b"]]
        angle = a[:, 2] - b[:, 2] - springs["rest"] + 0.5 * self.dt * (a[:, 5] - b[:, 5])
        return float(np.sum(0.5 * springs["stiffness"] * angle**2))

    def _climbed(self, middle: Any) -> float:
        """Return the potential energy of wheels on cables half a substep on, where bodies are `middle` (b,), J."""
        energy = 0.0
        for wheel in self.wheels.view(np.recarray):
            body = middle[wheel.body]
            arm_x, arm_y, _, _ = law.contact_at(wheel, body)
            place = body.x + arm_x, body.y + arm_y
            energy += wheel.load * law.rise_between(*place, *place, wheel.radius, self.cables)[0]
        return float(energy)
