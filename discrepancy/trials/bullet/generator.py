"""Logs for trials from another simulator: rigid bodies in 3-D with PyBullet's contacts.

Nothing here uses the project's own physics, kinematics or sensor models. `drive` makes a log: `simulate` runs the
robot in steps of at most 2 ms, steered by the readings of its encoders, and what foreign simulators share reads that
run at the log's rate.

Step. Contacts hold half-way through each step, so that what the encoders see belongs to the path to second order in
the step. Measured by halving it, in 20 s of random wander: the prototype's contacts slip by 1.4 um for each metre
rolled and by 3.6 um to the side with 2 ms, by 0.6 and 2.5 um with 1 ms, by 0.4 and 2.3 um with 0.5 ms. (What stays is
that the chassis leans as it speeds up; with rigid contacts nothing else slips.) Of first order is where the robot goes,
for motors answer to the rates of the step before: 1 ms puts it at most 0.9 mm elsewhere than 2 ms, on 4 m, counts and
reference alike. Robots whose steering motors can disagree (swerve, powered casters) slip where they do, by some 0.05 %
and 0.02 % of their way, whatever the step.

Cost. 60 s of the prototype take 11 s of CPU time, of other presets 8 to 22 s (six castors).
"""

import contextlib
import math

import numpy as np

from castor_envs.effects.catalogue import floor_of
from castor_envs.floor import Floor, Patch
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.trajectories import Trajectory
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.bullet.model import DROOP, STEERING_DROOP, STEP, Rig, parts_of, rig_of
from discrepancy.trials.bullet.outside import Outside
from discrepancy.trials.foreign.build import Build, Controller
from discrepancy.trials.foreign.run import Run, read, start_angles
from discrepancy.trials.foreign.sensors import Sensors, measured_angles
from discrepancy.trials.noise import Noise

GIVING_WAY = 0.03
"""Time constant with which soft tyres give way to their loads, s."""

SETTLING = 0.5
"""How long the robot stands before the start, s."""


def drive(
    robot: RobotDescription,
    motion: Trajectory,
    seed: int,
    *,
    duration: float,
    floor: Floor | None = None,
    outside: Outside | None = None,
    rounded: bool = True,
    noise: Noise | None = None,
) -> Log:
    """Return the log of a robot with its effects that drives a motion for `duration` s, with reference poses.

    rounded: whether encoders round to counts. noise: of the reference (None: `Noise()`). The same seed gives the same
    start, encoder phases and noise whichever the effects. Raises InputError for robots, floors and effects that the
    simulator has not, or where PyBullet is missing.
    """
    run = simulate(robot, motion, seed, duration=duration, floor=floor, outside=outside)
    return read(run, robot, outside=outside, rounded=rounded, noise=Noise() if noise is None else noise)


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

    random = np.random.default_rng([seed, 2])
    theta = start_angles(described, motion, random)
    phase = random.uniform(size=len(described.driven))
    samples, w = round(duration / period), len(described.radius)
    t = np.arange(samples * substeps + 1, dtype=np.float64) * period / substeps
    angle, pose = np.empty((len(t), w + len(theta))), np.empty((len(t), 3))
    command, steering = np.zeros((samples + 1, len(described.driven))), np.zeros((samples + 1, len(described.steered)))
    sensors, controller = Sensors(robot), Controller(described, period, robot.max_steering_speed)
    with contextlib.closing(_Stepper(robot, rig_of(parts), parts.gravity, floor, outside)) as stepper:
        stepper.settle(theta, motion.start)
        angle[0], pose[0] = stepper.state()
        seen = sensors.push(t[:1], angle[:1])
        for k in range(samples):
            measured = measured_angles(described, sensors.pivots(seen[-1]))
            command[k], steering[k] = controller.commands(measured, motion.at((k + 0.5) * period)[1])
            ahead = slice(k * substeps + 1, (k + 1) * substeps + 1)
            for row in range(ahead.start, ahead.stop):
                stepper.step(t[row - 1], command[k], steering[k])
                angle[row], pose[row] = stepper.state()
            seen = sensors.push(t[ahead], angle[ahead])
    pose[:, 2] = np.unwrap(pose[:, 2])
    return Run(t=t, angle=angle, pose=pose, command=command, steering=steering, phase=phase, every=substeps, seed=seed)


class _Stepper:
    """Moves a model on, one physics step after the other: motors, what radii and friction depend on, then Bullet.

    Rims turn by more than treads where rolling radii are smaller than spheres: encoders and motors are on the rims.
    """

    def __init__(
        self,
        robot: RobotDescription,
        rig: Rig,
        gravity: tuple[float, float, float],
        floor: Floor,
        outside: Outside | None,
    ) -> None:
        build, driven, steered = rig.build, rig.build.driven, rig.build.steered
        self._rig, self._gravity, self._outside = (
            rig,
            gravity,
            outside if outside is not None and outside.acts else None,
        )
        self._patches, self._friction = floor.patches, np.full(len(build.radius), robot.contact.friction)
        self._usual = robot.contact.friction
        self._mean_load, self._soft_load = rig.load[driven].mean(), rig.load.copy()
        self._driven, self._hinges = driven, [*rig.roll[driven].tolist(), *rig.pivot[steered].tolist()]
        motors = [(robot.max_wheel_torque, DROOP, robot.max_wheel_speed)] * len(driven)
        motors += [(robot.max_steering_torque, STEERING_DROOP, robot.max_steering_speed)] * len(steered)
        self._torque, droop, self._limit = np.array(motors).T
        self._gain = self._torque / (droop * self._limit)
        self._gear = np.ones(len(self._hinges))
        self._turned, self._constant = np.zeros(len(build.radius)), not build.shrinking and self._outside is None
        self._still = np.zeros(len(self._hinges))

    def close(self) -> None:
        """Give the world back."""
        self._rig.close()

    def settle(self, theta: Array, start: tuple[float, float, float]) -> None:
        """Let the robot stand on its contacts, castors at theta (n,), then put it to the start at rest."""
        rig = self._rig
        turning = rig.pivot >= 0
        rig.joint[rig.pivot[turning]] = theta[turning]
        rig.set_gravity((0.0, 0.0, self._gravity[2]))
        for _ in range(round(SETTLING / rig.step_size)):
            self._servo(self._still)
            rig.step()
        rig.set_gravity(self._gravity)
        rig.put(start)
        self._turned[:] = 0.0

    def step(self, t: float, wheel: Array, steering: Array) -> None:
        """Make one step from t with wheels and steering commanded at rates, rad/s."""
        rig = self._rig
        if not self._constant:
            self._set_radii(t)
        if self._patches:
            self._set_friction()
        self._servo(np.concatenate([wheel, steering]))
        rig.step()
        self._turned += rig.step_size * rig.rate[rig.roll] * rig.build.radius / rig.radius

    def state(self) -> tuple[Array, Array]:
        """Return the angles (w + n,) of the wheels' rims since the start and of castors, and the pose (3,)."""
        rig = self._rig
        castors = np.where(rig.pivot >= 0, rig.joint[rig.pivot], rig.build.angle)
        return np.concatenate([self._turned, castors]), rig.pose()

    def _servo(self, command: Array) -> None:
        rig = self._rig
        command = np.clip(command, -self._limit, self._limit)
        behind = np.abs(command - rig.rate[self._hinges] * self._gear)
        rig.servo(self._hinges, command / self._gear, np.minimum(self._gain * behind, self._torque) * self._gear)

    def _set_radii(self, t: float) -> None:
        rig, build = self._rig, self._rig.build
        rig.radius[:] = build.radius
        if build.shrinking:
            self._soft_load += (rig.loads() - self._soft_load) * min(rig.step_size / GIVING_WAY, 1.0)
            rig.radius -= build.shrinking * (self._soft_load - self._mean_load)
        if self._outside is not None:
            self._outside.act(rig, t)
        self._gear[: len(self._driven)] = (build.radius / rig.radius)[self._driven]

    def _set_friction(self) -> None:
        for k, place in enumerate(self._rig.wheel_places().tolist()):
            inside = [patch.friction for patch in self._patches if _inside(patch, place)]
            friction = inside[-1] if inside else self._usual
            if friction != self._friction[k]:
                self._rig.set_friction(k, friction)
                self._friction[k] = friction


def _inside(patch: Patch, place: list[float]) -> bool:
    x, y = place[0] - patch.center[0], place[1] - patch.center[1]
    c, s = math.cos(patch.angle), math.sin(patch.angle)
    return abs(c * x + s * y) <= patch.size[0] / 2 and abs(c * y - s * x) <= patch.size[1] / 2
