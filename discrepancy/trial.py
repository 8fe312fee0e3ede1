"""Hidden-effect trials: logs of simulated robots with one effect or none, and what the finder makes of them.

The base on three split castors drives at random in pymunk physics, steered by what its own sensors say. Every fourth
case has no effect; the others one, drawn from the catalogue, on a castor or wheel and of a size (`SIZES`, log-uniform)
drawn anew. Every case has a second log, of another motion, held out. The finder gets logs and the robot's file.
"""

import dataclasses
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from castor_envs.controller import KinematicController, trailing_angles
from castor_envs.effects import EFFECTS, Effect
from castor_envs.envs.sensed_robot import SensedRobot
from castor_envs.floor import Floor
from castor_envs.kinematics import Geometry
from castor_envs.logs import Log
from castor_envs.presets import preset
from castor_envs.robot import RobotDescription
from castor_envs.trajectories import wander
from discrepancy.candidates import Candidate
from discrepancy.diagnosis import Diagnosis, diagnose

ROBOT, DURATION = "asoc-prototype", 60.0
REFERENCE_EVERY, REFERENCE_NOISE = 20, (1e-3, 1e-3, 1e-3)
"""Samples between reference poses, and their standard deviations, m, m, rad."""

SIZES: dict[str, tuple[float, float]] = {
    "wheel_radius": (0.002, 0.01),
    "all_wheel_radius": (0.003, 0.01),
    "track": (0.005, 0.02),
    "pivot_offset": (0.0004, 0.002),
    "pivot_position_x": (0.0015, 0.006),
    "pivot_position_y": (0.0015, 0.006),
    "pivot_bias": (0.002, 0.01),
    "pivot_gain": (0.001, 0.005),
    "pivot_eccentricity": (0.003, 0.015),
    "wheel_eccentricity": (0.01, 0.05),
    "encoder_latency": (0.002, 0.01),
    "pivot_backlash": (0.004, 0.02),
    "tick_loss": (0.01, 0.05),
}
"""From the smallest amplitude that matters on this robot to five times that, in the effects' units."""


@dataclass(frozen=True)
class Outcome:
    """What became of a case. family: of the hidden effect, None for none. kind: "exact" (for clean robots: nothing
    named), "in the set", "nothing", "wrong"."""

    case: int
    effect: Effect | None
    family: str | None
    kind: str
    found: Diagnosis


def log_at_random(robot: RobotDescription, seed: int, duration: float = DURATION) -> Log:
    """Return a log of a robot that drives at random, with reference poses; effects of the robot are in it."""
    trajectory, random = wander(np.random.default_rng([seed, 1]), duration=duration), np.random.default_rng([seed, 2])
    sensed, geometry, period = SensedRobot(robot, Floor()), Geometry.of(robot), robot.sample_period
    start = trailing_angles(geometry, trajectory.runs[0].legs[0].motion) + random.uniform(-0.5, 0.5, geometry.n_castors)
    sensed.reset(random, start)
    controller = KinematicController(sensed.described)
    wheel, pivot = [np.zeros(len(robot.driven_wheels))], [sensed.observation["pivot"]]
    poses, commands = [sensed.world.pose.copy()], []
    for k in range(int(trajectory.duration / period)):
        command = controller.commands(sensed.measured_castor_angles(), trajectory.at((k + 0.5) * period)[1])
        sensed.advance(command)
        commands.append(command.wheel)
        wheel.append(wheel[-1] + sensed.observation["wheel"])
        pivot.append(sensed.observation["pivot"])
        poses.append(sensed.world.pose.copy())
    reference = np.array(poses)
    reference[:, 2] = np.unwrap(reference[:, 2])
    reference += np.random.default_rng([seed, 3]).normal(size=reference.shape) * REFERENCE_NOISE
    reference[np.arange(len(reference)) % REFERENCE_EVERY > 0] = np.nan
    commands.append(commands[-1] * 0)
    return Log(
        period * np.arange(len(reference)), np.array(wheel), np.array(pivot), np.array(commands), reference=reference
    )


def hidden(robot: RobotDescription, case: int, seed: int) -> Effect | None:
    """Return the effect of a case, None for every fourth."""
    if case % 4 == 0:
        return None
    random = np.random.default_rng([seed, case])
    name = sorted(SIZES)[random.integers(len(SIZES))]
    variants = EFFECTS[name].variants(robot)
    low, high = SIZES[name]
    size = float(np.exp(random.uniform(np.log(low), np.log(high))))
    sign = 1.0 if name in ("pivot_backlash", "tick_loss", "encoder_latency") else float(random.choice([-1.0, 1.0]))
    return dataclasses.replace(variants[random.integers(len(variants))], value=sign * size)


def run(cases: int, seed: int = 0, duration: float = DURATION) -> Iterator[Outcome]:
    """Yield what becomes of each case."""
    robot = preset(ROBOT)
    for case in range(cases):
        effect = hidden(robot, case, seed)
        real = robot if effect is None else robot.with_effects(effect)
        log, kept_back = (log_at_random(real, 1000 * seed + 2 * case + k, duration) for k in (0, 1))
        found = diagnose(robot, [log], [kept_back])
        family = None if effect is None else Candidate("", effect).family
        yield Outcome(case, effect, family, _kind(family, found), found)


def rates(outcomes: list[Outcome]) -> dict[str, Counter[str]]:
    """Return how often each kind of outcome came, for clean robots and for each effect."""
    table: dict[str, Counter[str]] = {}
    for one in outcomes:
        table.setdefault("none" if one.effect is None else one.effect.name, Counter())[one.kind] += 1
    return dict(sorted(table.items()))


def _kind(family: str | None, found: Diagnosis) -> str:
    said = [name for one in found.findings if one.verdict in ("named", "ambiguous") for name in one.families]
    if family is None:
        return "wrong" if said else "exact"
    if not said:
        return "nothing"
    if family not in said:
        return "wrong"
    return "exact" if len(said) == 1 else "in the set"
