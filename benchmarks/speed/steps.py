"""A step of an environment as a multiple of 50 bare steps of pymunk on the same bodies, and beside MuJoCo."""

import itertools
import statistics
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np

import castor_envs  # noqa: F401  (registers the environments)
from benchmarks.speed.figures import Effort, Figure, Group, Work, by_turns, ratio, steps_of
from castor_envs.floor import Floor
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.robot import RobotDescription

try:
    import mujoco
except ImportError:  # the extra "trial"
    mujoco = None

DRIVEN = {
    "prototype": ("castor/ASOC-v1", "asoc-prototype"),
    "differential": ("castor/ASOC-v1", "differential"),
    "5-axle train": ("castor/CFMMR-v1", "cfmmr-5"),
}
BARE = 50
STEPS = 10
"""Steps a round, from a reset on: short, so that the machine changes little between the variants."""

SIX_CONTACTS = """
<mujoco><option timestep="0.001"/><worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 .05"><freejoint/>
<geom type="box" size=".2 .2 .02" pos="0 0 .05" mass="10"/>{}</body></worldbody></mujoco>
"""


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield a step's time for each vehicle, and what it is a multiple of."""
    for title, (name, vehicle) in DRIVEN.items():
        made = {"through gym.make": _made(name, vehicle), "step": _made(name, vehicle).unwrapped}
        variants = {key: steps_of(env, STEPS) for key, env in made.items()} | {"bare": _bare(vehicle), **_mujoco()}
        times = by_turns(variants, effort.rounds, lambda made=made: [env.reset(seed=0) for env in made.values()])
        yield Figure(f"step of {title}", 1e6 * statistics.median(times["step"]) / STEPS, "us")
        yield Figure(f"step of {title} / {BARE} bare steps", ratio(times, "step", "bare"), "x")
        yield Figure(f"step of {title} through gym.make / without", ratio(times, "through gym.make", "step"), "x")
        if "MuJoCo" in times:
            told = f"{BARE} steps of MuJoCo with six contacts / step of {title}"
            yield Figure(told, ratio(times, "MuJoCo", "step"), "x")
        env, seeds = _made(name, vehicle), itertools.count()
        resets = by_turns({"reset": lambda env=env, seeds=seeds: env.reset(seed=next(seeds))}, effort.rounds)
        yield Figure(f"reset of {title}", 1e3 * statistics.median(resets["reset"]), "ms")


def _made(name: str, vehicle: str) -> Any:
    of: dict[str, Any] = {"train" if name == "castor/CFMMR-v1" else "robot": vehicle}
    env = gym.make(name, **of)
    env.reset(seed=0)
    return env


def _bare(name: str) -> Work:
    vehicle = load_vehicle(name)
    world = RobotWorld(vehicle, Floor()) if isinstance(vehicle, RobotDescription) else TrainWorld(vehicle, Floor())
    space, dt = world.simulation.space, world.simulation.dt

    def steps() -> None:
        for _ in range(BARE * STEPS):
            space.step(dt)

    return steps


def _mujoco() -> dict[str, Work]:
    """Return as many steps of MuJoCo as `_bare` takes of pymunk, of a base on six spheres; nothing without MuJoCo."""
    if mujoco is None:
        return {}
    physics: Any = mujoco
    turns = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    feet = "".join(
        f'<geom type="sphere" size=".05" pos="{0.2 * np.cos(turn):.3f} {0.2 * np.sin(turn):.3f} 0"/>' for turn in turns
    )
    model = physics.MjModel.from_xml_string(SIX_CONTACTS.format(feet))
    data = physics.MjData(model)

    def steps() -> None:
        for _ in range(BARE * STEPS):
            physics.mj_step(model, data)

    return {"MuJoCo": steps}


GROUP = Group("Steps", figures)
