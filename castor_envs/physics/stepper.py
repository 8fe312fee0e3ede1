"""Bodies and wheels in one pymunk space, stepped one sample period at a time, two ways that agree."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Literal

import numpy as np
import pymunk
from numpy.typing import ArrayLike, NDArray
from pymunk.constraints import Constraint, DampedRotarySpring

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.kernels.arguments import INTEGER, REAL, array
from castor_envs.kernels.kernel import Kernel
from castor_envs.physics import tyre as law
from castor_envs.physics.chipmunk import BodyLink

Drive = Literal["servo", "voltage", "off"]
Stepper = Literal["compiled", "reference"]

FASTEST = 1e3  # m/s and rad/s: nothing on wheels moves so fast, so physics has gone wrong
_ADVANCE = Kernel(
    "castor_envs.physics.compiled_loop",
    "advance",
    (
        *(array(np.int64, 1), array(float, 2), array(np.int32, 1), array(float, 2), array(np.int32, 1)),
        *(array(law.WHEEL, 1), array(float, 2), array(float, 2), INTEGER, REAL, INTEGER),
    ),
)
_DRIVES = {"off": law.OFF, "servo": law.SERVO, "voltage": law.VOLTAGE}


class Simulation:
    """What `RobotWorld` and `TrainWorld` share: a space with bodies and joints, wheels on them, a floor, and time.

    name: of what is simulated, for errors. bodies: in the order in which wheels count them. wheels (w,): records
    (`castor_envs.physics.tyre.WHEEL`). iterations: of Chipmunk's solver. stepper: "compiled" or "reference" (plain
    Python).
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
        self.space = pymunk.Space()
        self.space.iterations = iterations
        self.space.gravity = floor.downhill_gravity
        self.space.add(*bodies, *joints)
        self._bodies, self._joints = tuple(bodies), tuple(joints)
        self._stepper: Stepper = stepper
        self._link = BodyLink(self.space, list(bodies))
        self._patches, self._cables = floor.patch_array(), floor.cable_array()

    @cached_property
    def _run_substeps(self) -> Callable[[], None]:
        """The compiled loop over the substeps of a sample period."""
        link = self._link
        buffers = link.addresses, link.motion, link.got, link.loads, link.given
        there = self.wheels, self._patches, self._cables, self.floor.climbing
        return _ADVANCE.bind(*buffers, *there, self.dt, self.substeps)

    @property
    def motion(self) -> Array:
        """Of each body x, y, angle, v_x, v_y, angular velocity, (b, 6), of its centre of mass in N."""
        return self._link.read()

    def command(self, wheels: NDArray[np.intp], command: ArrayLike, limit: ArrayLike, drive: Drive) -> None:
        """Set the mode of some wheels' motors, and their command within +-limit."""
        self.wheels["drive"][wheels] = _DRIVES[drive]
        self.wheels["command"][wheels] = np.minimum(np.maximum(command, -np.asarray(limit)), limit)

    def advance(self) -> None:
        """Run one sample period; raises InputError where physics becomes unstable."""
        link = self._link
        if self._stepper == "compiled":
            self._run_substeps()
        else:
            records = self.wheels.view(np.recarray)
            for _ in range(self.substeps):
                law.wheel_forces(
                    link.read(), records, self._patches, self._cables, self.floor.climbing, self.dt, link.loads
                )
                link.write()
                self.space.step(self.dt)
        self.time += self.sample_period
        if not np.all(np.abs(link.read()[:, 3:]) < FASTEST):
            raise InputError(
                f"{self.name}: its physics became unstable at {self.time:.2f} s; a mass, an inertia, a stiffness or "
                "the contact is out of proportion to the others"
            )

    def energy(self) -> float:
        """Return all mechanical energy: bodies, wheel spin, bristles, bent frames, slope, wheels on cables; J.

        Chipmunk moves first and accelerates then, so its velocities are those of half a substep after the positions:
        heights, bends and bristles are taken there, these halfway to where the next substep brings them.
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
        return float(kinetic + height + spin + bristles + self._bent() + risen)

    def _bent(self) -> float:
        """Return the energy in rotary springs half a substep on, J."""
        energy = 0.0
        for spring in self._joints:
            if isinstance(spring, DampedRotarySpring):
                angle = spring.a.angle - spring.b.angle - spring.rest_angle
                angle += 0.5 * self.dt * (spring.a.angular_velocity - spring.b.angular_velocity)
                energy += 0.5 * spring.stiffness * angle**2
        return energy

    def _climbed(self, motion: Array) -> float:
        """Return the potential energy of wheels that stand on cables half a substep on, J."""
        energy = 0.0
        for wheel in self.wheels.view(np.recarray):
            x, y, arm_x, arm_y, _, _ = law.contact_at(wheel, motion[wheel.body], 0.5 * self.dt)
            place = x + arm_x, y + arm_y
            energy += wheel.load * law.rise_between(*place, *place, wheel.radius, self._cables)[0]
        return float(energy)
