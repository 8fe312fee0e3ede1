"""Runs of robots in foreign simulators, and the logs that encoders and the reference make of them.

Nothing here uses the project's own physics. The same run can be read again for the same robot with other effects on
its sensors.
"""

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import make_interp_spline

from castor_envs.effects.catalogue import floor_of, reference
from castor_envs.effects.clocks import SampleJitter
from castor_envs.floor import Floor, Patch
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate_single, wrap
from castor_envs.logs.log import Log
from castor_envs.motion.controllers import KinematicController, trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import Trajectory
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.vehicles.effect import SensorModel
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.hidden import Outside
from discrepancy.trials.reading import USUAL, Noise, as_recorded, counts_of

SETTLING = 0.5
"""How long the robot stands before the start, s."""

BY_SAMPLE = ("tick_loss", "lost_remainders")
"""Effects that act on what a wheel turns in a whole sample period."""

GIVING_WAY = 0.03
"""Time constant with which soft tyres give way to their loads, s."""


class Sensors:
    """The encoders of a robot, read one sample period after the other. The effects on them see the true angles (m, w +
    n) of wheels and castors, rad, at the simulation's own fine steps (m,)."""

    def __init__(self, robot: RobotDescription) -> None:
        built = robot.as_built()
        effects = [effect for effect in robot.effects if not isinstance(effect, SampleJitter)]
        models = [(effect.name in BY_SAMPLE, effect.sensor_model(built)) for effect in effects]
        self._models = [_ByPeriod(model) if by_sample else model for by_sample, model in models if model is not None]
        self._w = len(robot.wheels)

    def push(self, t: Array, angle: Array) -> Array:
        """Return the angles that encoders see in a period, whose sample is in the last row; the first call has the
        start alone."""
        wheel, castor = angle[:, : self._w], angle[:, self._w :]
        for model in self._models:
            wheel, castor = model(t, wheel, castor)
        return np.column_stack([wheel, castor])


class _ByPeriod:
    """A sensor model that sees a period's last row alone: what it changes there shows in the rows up to the next."""

    def __init__(self, model: SensorModel) -> None:
        self._model, self._change = model, (0.0, 0.0)

    def __call__(self, t: Array, wheel: Array, castor: Array) -> tuple[Array, Array]:
        """Return both angles as encoders see them."""
        seen = self._model(t[-1:], wheel[-1:], castor[-1:])
        read = tuple(
            np.vstack([true[:-1] + change, last])
            for true, change, last in zip((wheel, castor), self._change, seen, strict=True)
        )
        self._change = seen[0] - wheel[-1:], seen[1] - castor[-1:]
        return read[0], read[1]


def reading_times(robot: RobotDescription, t: Array) -> Array:
    """Return when (K,) the encoders are read for the rows of times t (K,): uneven with jitter."""
    times = np.array(t, dtype=float)
    for effect in robot.effects:
        if isinstance(effect, SampleJitter):
            half = np.diff(t, prepend=t[0]) / 2
            shift = effect.value * np.random.default_rng(effect.seed).standard_normal(len(t))
            times += np.clip(shift, -half, half)
    return times


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A run: states at N + 1 times of the physics, of which every `every`-th is a sample.

    t (N + 1,): s. angle (N + 1, w + n): of wheels since the start, and of castors, rad, true and unwrapped. pose
    (N + 1, 3): of the point that the reference tracks. state (N + 1, ...): as the simulator has it. command (K, driven
    wheels), steering (K, driven castors): rad/s, the last row 0. phase (driven wheels,): of encoders, counts.
    """

    t: Array
    angle: Array
    pose: Array
    state: Array
    command: Array
    steering: Array
    phase: Array
    every: int
    seed: int


class World(Protocol):
    """A robot in a simulator, moved on one physics step after the other."""

    def settle(self, theta: Array, start: tuple[float, float, float]) -> None:
        """Let the robot stand for `SETTLING`, castors at theta (n,), then put it to the start at rest."""

    def step(self, t: float, wheel: Array, steering: Array) -> None:
        """Make one step from t with wheels and steering commanded at rates, rad/s."""

    def state(self) -> Array:
        """Return the state (s,)."""
        ...

    def angles(self, states: Array) -> Array:
        """Return the angles (m, w + n) in states (m, s): of wheels since the start, and of castors."""
        ...

    def poses(self, states: Array) -> Array:
        """Return the poses (m, 3) of the tracked point in successive states (m, s)."""
        ...

    def close(self) -> None:
        """Give the world back."""


@dataclass(frozen=True)
class Simulator:
    """A foreign simulator. world: makes one from robot, floor, step (s) and effect outside the catalogue (None: none).
    longest: physics step, s."""

    world: Callable[[RobotDescription, Floor, float, Outside | None], World]
    longest: float

    def drive(
        self,
        robot: RobotDescription,
        motion: Trajectory,
        seed: int,
        *,
        duration: float,
        floor: Floor | None = None,
        outside: Outside | None = None,
        rounded: bool = True,
        noise: Noise = USUAL,
    ) -> Log:
        """Return the log of a robot with its effects that drives a motion for `duration` s, with reference poses.

        rounded: whether encoders round to counts. The same seed gives the same start, encoder phases and noise
        whichever the effects. Raises InputError for robots, floors and effects that the simulator has not, or where it
        is not installed.
        """
        run = self.simulate(robot, motion, seed, duration=duration, floor=floor, outside=outside)
        return read(run, robot, outside=outside, rounded=rounded, noise=noise)

    def simulate(
        self,
        robot: RobotDescription,
        motion: Trajectory,
        seed: int,
        *,
        duration: float,
        floor: Floor | None = None,
        outside: Outside | None = None,
    ) -> Run:
        """Return the run of a robot, steered sample by sample from its encoders as its effects corrupt them."""
        described, period, random = robot.as_described(), robot.sample_period, np.random.default_rng([seed, 2])
        geometry, w = Geometry.of(described), len(robot.wheels)
        every, samples = math.ceil(period / self.longest - 1e-9), round(duration / period)
        t = np.arange(samples * every + 1, dtype=np.float64) * period / every
        theta = start_angles(geometry, motion, random)
        phase = Encoders.random_phase(geometry, random)
        moved = robot.driven_wheels, robot.driven_castors
        command, steering = (np.zeros((samples + 1, len(motors))) for motors in moved)
        encoders, sensors = Encoders(Geometry.of(robot.as_built()), phase), Sensors(robot)
        controller = KinematicController(described)
        with closing(self.world(robot, floor_of(robot, floor or Floor()), period / every, outside)) as world:
            world.settle(theta, motion.start)
            states = np.tile(world.state(), (len(t), 1))
            seen = sensors.push(t[:1], world.angles(states[:1]))
            for k in range(samples):
                measured = castor_angles(geometry, encoders.pivot(seen[-1, w:]))
                command[k], steering[k] = controller.commands(measured, motion.at((k + 0.5) * period)[1])
                ahead = slice(k * every + 1, (k + 1) * every + 1)
                for row in range(ahead.start, ahead.stop):
                    world.step(t[row - 1], command[k], steering[k])
                    states[row] = world.state()
                seen = sensors.push(t[ahead], world.angles(states[ahead]))
            angle, pose = world.angles(states), world.poses(states)
        return Run(
            t=t,
            angle=angle,
            pose=pose,
            state=states,
            command=command,
            steering=steering,
            phase=phase,
            every=every,
            seed=seed,
        )


def start_angles(geometry: Geometry, motion: Trajectory, random: np.random.Generator) -> Array:
    """Return the castors' angles (n,) at the start: free ones about half a radian off where they would trail."""
    trailing = trailing_angles(geometry, motion.runs[0].legs[0].motion)
    off = random.uniform(-0.5, 0.5, len(trailing))
    return wrap(np.where(geometry.fixed | geometry.driven, trailing, trailing + off))


def friction_at(patches: tuple[Patch, ...], place: list[float], otherwise: float) -> float:
    """Return the friction at a place (x, y, m): that of the last patch there, on what it lies on, else `otherwise`."""
    friction = otherwise
    for patch in patches:
        off = rotate_single(np.subtract(place, patch.center), -patch.angle)
        if np.all(np.abs(off) <= np.array(patch.size) / 2):
            friction = patch.on(friction)
    return friction


def read(
    run: Run, robot: RobotDescription, *, outside: Outside | None = None, rounded: bool = True, noise: Noise = USUAL
) -> Log:
    """Return a run's log as the encoders of a robot report it, with its effects on sensors, time and counts.

    Jitter reads the encoders at uneven times; effects after it in the robot file are not affected by it.
    """
    sensors, every = Sensors(robot), run.every
    rows = [slice(0, 1), *(slice(k + 1, k + every + 1) for k in range(0, len(run.t) - 1, every))]
    seen = np.vstack([sensors.push(run.t[samples], run.angle[samples]) for samples in rows])
    t = run.t[::every]
    sampled = make_interp_spline(run.t, seen, k=1)(reading_times(robot, t))  # straight on after the last time
    pose = run.pose
    if outside is not None:
        sampled, pose = outside.changed(robot, t, sampled, pose[::every]), outside.tracked(run.t, pose)
    wheel, pivot = counts_of(robot, sampled, run.phase)
    steering = run.steering if run.steering.shape[1] else None
    pose = reference(robot, run.t, pose)[::every]
    exact = Log(t, wheel, pivot, run.command, steering, reference=pose)
    return as_recorded(robot, exact, np.random.default_rng([run.seed, 3]), noise, rounded)
