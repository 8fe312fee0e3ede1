"""Logs for trials from another simulator: rigid bodies in 3-D with MuJoCo's contacts.

Nothing here uses the project's own physics, kinematics or sensor models. `drive` makes a log: `simulate` runs the
robot in steps of about 1 ms, steered by the readings of its encoders, and `read` samples that run at the log's rate.

Steps are of second order: contacts hold half-way through each step, so that paths are not off by the half step that
MuJoCo's own integrators lag behind, as a late encoder would.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from castor_envs.effects.catalogue import floor_of
from castor_envs.floor import Floor, Patch
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.trajectories import Trajectory
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.build import Build, Controller
from discrepancy.trials.foreign.run import Run as AnyRun
from discrepancy.trials.foreign.run import read, start_angles
from discrepancy.trials.foreign.sensors import Sensors, measured_angles
from discrepancy.trials.mujoco.model import AHEAD, STEP, Rig, mujoco_module, parts_of, rig_of
from discrepancy.trials.mujoco.outside import Outside
from discrepancy.trials.noise import Noise

RELAXATION = 0.01
"""Distance in which tyre creep follows the force, m."""

GIVING_WAY = 0.03
"""Time constant with which soft tyres give way to their loads, s."""

SETTLING = 0.5
"""How long the robot stands before the start, s."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Run(AnyRun):
    """What happened in MuJoCo.

    height (N + 1, w): of the wheels' centres over the floor, m. load (N + 1, w): on the wheels' springs, N.
    """

    height: Array
    load: Array


def drive(
    robot: RobotDescription,
    motion: Trajectory,
    seed: int,
    *,
    duration: float,
    floor: Floor | None = None,
    outside: Outside | None = None,
    rounded: bool = True,
    noise: Noise = Noise(),  # noqa: B008
) -> Log:
    """Return the log of a robot with its effects that drives a motion for `duration` s, with reference poses.

    rounded: whether encoders round to counts. The same seed gives the same start, encoder phases and noise whichever
    the effects. Raises InputError for robots and effects that the simulator has not, or where MuJoCo is missing.
    """
    run = simulate(robot, motion, seed, duration=duration, floor=floor, outside=outside)
    return read(run, robot, outside=outside, rounded=rounded, noise=noise)


def simulate(
    robot: RobotDescription,
    motion: Trajectory,
    seed: int,
    *,
    duration: float,
    floor: Floor | None = None,
    outside: Outside | None = None,
) -> Run:
    """Return the run of a robot, steered sample by sample from its encoders as its effects corrupt them."""
    floor, described, period = floor_of(robot, floor or Floor()), Build.of(robot.as_described()), robot.sample_period
    substeps = math.ceil(period / STEP - 1e-9)
    parts = parts_of(robot, floor, period / substeps)
    if outside is not None:
        outside.build(parts)
    rig = rig_of(parts)

    random = np.random.default_rng([seed, 2])
    theta = start_angles(described, motion, random)
    phase = random.uniform(size=len(described.driven))
    stepper = _Stepper(rig, floor, outside)
    stepper.settle(theta, motion.start)

    samples = round(duration / period)
    course = np.empty((samples * substeps + 1, rig.model.nq))
    height, load = np.empty((2, samples * substeps + 1, len(described.radius)))
    t = np.arange(len(course), dtype=np.float64) * period / substeps
    course[0], height[0], load[0] = stepper.state()
    command, steering = np.zeros((samples + 1, len(described.driven))), np.zeros((samples + 1, len(described.steered)))
    sensors, controller = Sensors(robot), Controller(described, period, robot.max_steering_speed)
    seen = sensors.push(t[:1], _angles(rig, course[:1], course[0], described))
    for k in range(samples):
        measured = measured_angles(described, sensors.pivots(seen[-1]))
        twist = motion.at((k + 0.5) * period)[1]
        command[k], steering[k] = controller.commands(measured, twist)
        _command(rig, robot, described, command[k], steering[k])
        ahead = slice(k * substeps + 1, (k + 1) * substeps + 1)
        for row in range(ahead.start, ahead.stop):
            stepper.step(t[row - 1])
            course[row], height[row], load[row] = stepper.state()
        seen = sensors.push(t[ahead], _angles(rig, course[ahead], course[0], described))
    return Run(
        t=t,
        angle=_angles(rig, course, course[0], described),
        pose=_poses(rig, course),
        height=height,
        load=load,
        command=command,
        steering=steering,
        phase=phase,
        every=substeps,
        seed=seed,
    )


class _Stepper:
    """Moves a model on, one physics step after the other."""

    def __init__(self, rig: Rig, floor: Floor, outside: Outside | None) -> None:
        self._mujoco: Any = mujoco_module()
        self._rig, self._outside = rig, outside if outside is not None and outside.acts else None
        self._patches, self._friction = floor.patches, rig.model.geom_friction[rig.geom, 0].copy()
        self._soft = _SoftTyres(rig) if rig.build.shrinking else None
        self._creep = _TyreCreep(rig) if rig.build.long or rig.build.side else None
        self._before = np.empty(rig.model.nq)

    def settle(self, theta: Array, pose: tuple[float, float, float]) -> None:
        """Let the robot stand until its springs rest, then put it to the start, castors at theta (n,)."""
        model, data, rig = self._rig.model, self._rig.data, self._rig
        turning = rig.pivot >= 0
        data.qpos[rig.pivot[turning]] = theta[turning]
        gravity = model.opt.gravity.copy()
        model.opt.gravity[:2] = 0.0
        for _ in range(round(SETTLING / model.opt.timestep)):
            self.step(0.0)
        model.opt.gravity[:] = gravity
        heading = _poses(rig, data.qpos[None])[0, 2]
        turn = np.array([math.cos((pose[2] - heading) / 2), 0.0, 0.0, math.sin((pose[2] - heading) / 2)])
        self._mujoco.mju_mulQuat(data.qpos[3:7], turn, data.qpos[3:7].copy())
        data.qpos[:2], data.qvel[:] = pose[:2], 0.0
        self._mujoco.mj_forward(model, data)
        if rig.build.viscous:
            rig.set_creep(rig.build.viscous)

    def step(self, t: float) -> None:
        """Make one step from t: velocities from the state `AHEAD`, then the whole step with them."""
        model, data = self._rig.model, self._rig.data
        if self._soft is not None:
            self._soft.act()
        if self._outside is not None:
            self._outside.act(self._rig, t)
        if self._creep is not None:
            self._creep.act()
        if self._patches:
            self._set_friction()
        self._before[:] = data.qpos
        self._mujoco.mj_integratePos(model, data.qpos, data.qvel, model.opt.timestep * AHEAD)
        self._mujoco.mj_step(model, data)
        data.qpos[:] = self._before
        self._mujoco.mj_integratePos(model, data.qpos, data.qvel, model.opt.timestep)

    def state(self) -> tuple[Array, Array, Array]:
        """Return qpos, and the heights (w,) and loads (w,) of the wheels' centres in the step that led there."""
        return self._rig.data.qpos, self._rig.wheel_places()[:, 2], self._rig.loads()

    def _set_friction(self) -> None:
        for k, place in enumerate(self._rig.wheel_places()[:, :2].tolist()):
            friction = [patch.friction for patch in self._patches if _inside(patch, place)]
            self._rig.set_friction(k, friction[-1] if friction else self._friction[k])


class _SoftTyres:
    """Radii that are smaller by `Build.shrinking` times the load of the moment."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._unloaded = rig, rig.radius + rig.build.shrinking * rig.load

    def act(self) -> None:
        """Set radii for the loads of the step before."""
        rig = self._rig
        target = self._unloaded - rig.build.shrinking * rig.loads()
        rig.radius[:] += (target - rig.radius) * min(rig.step / GIVING_WAY, 1.0)
        for k, radius in enumerate(rig.radius.tolist()):
            rig.set_radius(k, radius)


class _TyreCreep:
    """Slip of tyres in proportion to force and distance, beyond what contacts creep, after a relaxation length.

    A wheel under a force along its rolling direction gets another radius, a pair under a side force other headings.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._share = np.zeros((2, len(rig.radius)))

    def act(self) -> None:
        """Set radii and headings for the forces of the step before."""
        rig, build = self._rig, self._rig.build
        (along, aside), up = rig.forces(), rig.loads()
        rate = rig.data.qvel[rig.roll_dof] * rig.radius
        sideways, load = (np.bincount(build.castor, force, len(build.offset)) for force in (aside, up))
        aside = (sideways / np.maximum(load, 1e-9))[build.castor]
        share = np.array([build.long * along / np.maximum(up, 1e-9), build.side * aside]) * np.sign(rate)
        self._share += np.minimum(np.abs(rate) * rig.step / RELAXATION, 1.0) * (share - self._share)
        for k, (long, side) in enumerate(self._share.T.tolist()):
            rig.set_radius(k, rig.radius[k] * (1 - long))
            rig.model.body_quat[rig.hub[k]] = math.cos(side / 2), 0.0, 0.0, -math.sin(side / 2)


def _inside(patch: Patch, place: list[float]) -> bool:
    x, y = place[0] - patch.center[0], place[1] - patch.center[1]
    c, s = math.cos(patch.angle), math.sin(patch.angle)
    return abs(c * x + s * y) <= patch.size[0] / 2 and abs(c * y - s * x) <= patch.size[1] / 2


def _command(rig: Rig, robot: RobotDescription, build: Build, wheel: Array, steering: Array) -> None:
    limit = robot.max_wheel_speed
    for k, rate in zip(build.driven, np.clip(wheel, -limit, limit).tolist(), strict=True):
        rig.data.actuator(f"drive_{k}").ctrl = rate
    for i, rate in zip(build.steered, steering, strict=True):
        rig.data.actuator(f"steer_{i}").ctrl = rate


def _angles(rig: Rig, course: Array, start: Array, build: Build) -> Array:
    """Return the angles (m, w + n) in states (m, nq): of wheels since the start, and of castors."""
    fixed = np.where(build.turning, 0.0, build.angle)
    castors = np.where(rig.pivot >= 0, course[:, rig.pivot], fixed)
    return np.column_stack([course[:, rig.roll] - start[rig.roll], castors])


def _poses(rig: Rig, course: Array) -> Array:
    """Return the poses (m, 3) of the tracked point in states (m, nq)."""
    x, y = course[:, 0], course[:, 1]
    a, b, c, d = course[:, 3:7].T
    heading = np.unwrap(np.arctan2(2 * (a * d + b * c), 1 - 2 * (c**2 + d**2)))
    if len(rig.tracked):
        ahead, aside = course[:, rig.tracked].T
        x = x + np.cos(heading) * ahead - np.sin(heading) * aside
        y = y + np.sin(heading) * ahead + np.cos(heading) * aside
    return np.column_stack([x, y, heading])
