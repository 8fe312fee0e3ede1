"""Robots in MuJoCo: rigid bodies in 3-D with its contacts, in steps of about 1 ms.

Steps are of second order: contacts hold half-way through each step, so that paths are not off by the half step that
MuJoCo's own integrators lag behind, as a late encoder would.
"""

import math
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.run import GIVING_WAY, SETTLING, Simulator, friction_at
from discrepancy.trials.hidden import Outside
from discrepancy.trials.mujoco.model import CONTACT_TIME, IMPEDANCE, Parts, mujoco_module

STEP = 1e-3
"""Physics step, s, at most."""

AHEAD = (1 + IMPEDANCE * CONTACT_TIME) / 2
"""Physics steps from a step's start to the state whose contacts hold in it: half a step on, and as much further as side
slip lags behind the turning of the contacts, which MuJoCo leaves out."""

RELAXATION = 0.01
"""Distance in which tyre creep follows the force, m."""


class World:
    """A compiled model with its state, and where things are in it.

    pivot (n,), roll (w,): places in qpos of the pivots (-1: fixed) and the wheels' turning. radius (w,): as built, m.
    States are qpos, then heights (w,) of the wheels' centres over the floor, m, and loads (w,) of the wheels, N.
    """

    def __init__(self, robot: RobotDescription, floor: Floor, step: float, outside: Outside | None = None) -> None:
        parts = Parts(robot, floor, step)
        if outside is not None:
            outside.build(parts)
        mujoco = self._mujoco = mujoco_module()
        self.model: Any = mujoco.MjModel.from_xml_string(ET.tostring(parts.root, encoding="unicode"))
        self.data: Any = mujoco.MjData(self.model)
        self.robot, self.geometry, self.tyres = robot, parts.geometry, parts.tyres
        self.radius, self._step, self._patches = parts.geometry.radius.copy(), step, floor.patches
        self._outside = outside
        warnings = mujoco.mjtWarning
        self._unstable = warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC

        model, wheels = self.model, range(len(robot.wheels))
        joints = {model.joint(k).name: model.joint(k) for k in range(model.njnt)}
        turning = [f"pivot_{i}" for i in range(len(robot.castors))]
        self.pivot = np.array([joints[name].qposadr[0] if name in joints else -1 for name in turning], dtype=np.intp)
        self.roll: NDArray[np.intp] = np.array([joints[f"roll_{k}"].qposadr[0] for k in wheels])
        self._roll_dof = [joints[f"roll_{k}"].dofadr[0] for k in wheels]
        self._slide_dof = [joints[f"slide_{k}"].dofadr[0] for k in wheels]
        self._slide = [joints[f"slide_{k}"].qposadr[0] for k in wheels]
        self._tracked = [joints[name].qposadr[0] for name in ("mast_x", "mast_y") if name in joints]
        self._hub = [model.body(f"hub_{k}").id for k in wheels]
        self._geom = [model.geom(f"wheel_{k}").id for k in wheels]
        self._weight = model.body_mass[self._hub] * floor.normal_gravity
        motors = [*(f"drive_{k}" for k in robot.driven_wheels), *(f"steer_{i}" for i in robot.driven_castors)]
        self._motors, self._fastest = [model.actuator(name).id for name in motors], robot.max_wheel_speed
        self._friction = self.model.geom_friction[self._geom, 0].copy()
        self._unloaded = self.radius + self.tyres.shrinking * parts.load
        self._share = np.zeros((2, len(self.radius)))
        self._start = self.data.qpos.copy()

    def settle(self, theta: Array, start: tuple[float, float, float]) -> None:
        """Let the robot stand until its springs rest, then put it to the start, castors at theta (n,)."""
        model, data, turning = self.model, self.data, self.pivot >= 0
        data.qpos[self.pivot[turning]] = theta[turning]
        gravity, still = model.opt.gravity.copy(), np.zeros(len(self._motors))
        model.opt.gravity[:2] = 0.0
        for _ in range(round(SETTLING / self._step)):
            self.step(0.0, still, still[:0])
        model.opt.gravity[:] = gravity
        away = start[2] - self.poses(data.qpos[None])[0, 2]
        turn = np.array([math.cos(away / 2), 0.0, 0.0, math.sin(away / 2)])
        self._mujoco.mju_mulQuat(data.qpos[3:7], turn, data.qpos[3:7].copy())
        data.qpos[:2], data.qvel[:] = start[:2], 0.0
        self._mujoco.mj_forward(model, data)
        if self.tyres.viscous:
            self._set_creep()
        self._start = data.qpos.copy()

    def step(self, t: float, wheel: Array, steering: Array) -> None:
        """Make one step from t: velocities from the state `AHEAD`, then the whole step with them.

        Raises ArithmeticError where the simulation becomes unstable: MuJoCo would begin anew.
        """
        model, data = self.model, self.data
        data.ctrl[self._motors] = np.append(np.clip(wheel, -self._fastest, self._fastest), steering)
        if self.tyres.shrinking:
            target = self._unloaded - self.tyres.shrinking * self._loads()
            self.radius[:] += (target - self.radius) * min(self._step / GIVING_WAY, 1.0)
            for k, radius in enumerate(self.radius.tolist()):
                self.set_radius(k, radius)
        if self._outside is not None:
            self._outside.act(self, t)
        if self.tyres.long or self.tyres.side:
            self._slip_tyres()
        if self._patches:
            for k, place in enumerate(data.geom_xpos[self._geom, :2].tolist()):
                model.geom_friction[self._geom[k], 0] = friction_at(self._patches, place, self._friction[k])
        before = data.qpos.copy()
        self._mujoco.mj_integratePos(model, data.qpos, data.qvel, self._step * AHEAD)
        self._mujoco.mj_step(model, data)
        if any(data.warning[kind].number for kind in self._unstable):
            raise ArithmeticError(f"the simulation of {self.robot.name!r} became unstable at {t:.4g} s")
        data.qpos[:] = before
        self._mujoco.mj_integratePos(model, data.qpos, data.qvel, self._step)

    def state(self) -> Array:
        """Return qpos, and the heights and loads of the wheels in the step that led there."""
        return np.concatenate([self.data.qpos, self.data.geom_xpos[self._geom, 2], self._loads()])

    def angles(self, states: Array) -> Array:
        """Return the angles (m, w + n) in states (m, s): of wheels since the start, and of castors."""
        castors = np.where(self.pivot >= 0, states[:, self.pivot], self.geometry.angle)
        return np.column_stack([states[:, self.roll] - self._start[self.roll], castors])

    def poses(self, states: Array) -> Array:
        """Return the poses (m, 3) of the tracked point in successive states (m, s)."""
        x, y = states[:, 0], states[:, 1]
        a, b, c, d = states[:, 3:7].T
        heading = np.unwrap(np.arctan2(2 * (a * d + b * c), 1 - 2 * (c**2 + d**2)))
        if len(self._tracked):
            ahead, aside = states[:, self._tracked].T
            x = x + np.cos(heading) * ahead - np.sin(heading) * aside
            y = y + np.sin(heading) * ahead + np.cos(heading) * aside
        return np.column_stack([x, y, heading])

    def close(self) -> None:
        """Do nothing: a model is only memory."""

    def set_radius(self, wheel: int, radius: float) -> None:
        """Give a wheel another radius, m. Its axle follows: a wheel that shrinks would else leave the floor for a step,
        and spin."""
        self.data.qpos[self._slide[wheel]] += radius - self.model.geom_size[self._geom[wheel], 0]
        self.model.geom_size[self._geom[wheel], [0, 2]] = radius
        self.model.geom_rbound[self._geom[wheel]] = radius

    def _loads(self) -> Array:
        """Return the loads of wheels on the floor (w,), N: what their springs carry, and their own weight."""
        return self._weight - self.data.qfrc_spring[self._slide_dof]

    def _set_creep(self) -> None:
        """Let contacts slip by `Tyres.viscous` more for each N of friction, for the state that the model is in."""
        rows = np.ravel([np.arange(1, 3) + c.efc_address for c in self.data.contact[: self.data.ncon] if c.dim == 3])
        damping = 2 / (IMPEDANCE * CONTACT_TIME * self._step)
        creep = float(np.mean(self.data.efc_R[rows])) * (1 / damping + self._step)  # as the step treats it implicitly
        self.model.opt.impratio *= creep / (creep + self.tyres.viscous)

    def _slip_tyres(self) -> None:
        """Let tyres slip in proportion to force and distance, beyond what contacts creep, after a relaxation length.

        A wheel under a force along its rolling direction gets another radius, a pair under a side force other headings.
        """
        castor, (along, aside), up = self.geometry.wheel_castor, self._forces(), self._loads()
        rate = self.data.qvel[self._roll_dof] * self.radius
        sideways, load = (np.bincount(castor, force, self.geometry.n_castors) for force in (aside, up))
        aside = (sideways / np.maximum(load, 1e-9))[castor]
        share = np.array([self.tyres.long * along / np.maximum(up, 1e-9), self.tyres.side * aside]) * np.sign(rate)
        self._share += np.minimum(np.abs(rate) * self._step / RELAXATION, 1.0) * (share - self._share)
        for k, (long, side) in enumerate(self._share.T.tolist()):
            self.set_radius(k, self.radius[k] * (1 - long))
            self.model.body_quat[self._hub[k]] = math.cos(side / 2), 0.0, 0.0, -math.sin(side / 2)

    def _forces(self) -> tuple[Array, Array]:
        """Return the floor's friction on wheels (w,), N: along their rolling directions, and to their left."""
        force, total = np.zeros(6), np.zeros((len(self._geom), 3))
        for c in range(self.data.ncon):
            contact = self.data.contact[c]
            if contact.geom[1] in self._geom:
                self._mujoco.mj_contactForce(self.model, self.data, c, force)
                total[self._geom.index(contact.geom[1])] += contact.frame.reshape(3, 3).T @ force[:3]
        left = self.data.xmat[self._hub].reshape(-1, 3, 3)[:, :2, 1]
        ahead = np.column_stack([left[:, 1], -left[:, 0]])
        return (total[:, :2] * ahead).sum(axis=1), (total[:, :2] * left).sum(axis=1)


SIMULATOR = Simulator(World, STEP)
simulate, drive = SIMULATOR.simulate, SIMULATOR.drive
