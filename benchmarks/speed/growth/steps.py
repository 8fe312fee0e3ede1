"""What a step costs by the number of robots, castors, axles, cables and patches."""

import statistics
from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

import castor_envs  # noqa: F401  (registers the environments)
from benchmarks.speed.figures import Effort, by_turns, steps_of
from benchmarks.speed.growth.curve import Curve
from castor_envs.floor import Cable, Floor, Patch

ROBOTS = (1, 4, 16, 64, 256)
CASTORS = {1: "1-castor", 2: "2-castor", 3: "3-castor", 4: "4-castor", 6: "6-castor"}
AXLES = {n: f"cfmmr-{n}" for n in (2, 3, 4, 5, 6, 8, 10)}
OBSTACLES = (0, 1, 10, 100, 1000)
STEPS = 10


def curves(effort: Effort) -> Iterator[Curve]:
    """Yield the CPU time of a step, us."""
    many = {n: gym.make_vec("castor/ASOC-v1", n, "vector_entry_point", robot="asoc-prototype") for n in ROBOTS}
    yield _curve("step of a robot among many", "robots", many, effort, each=True)
    for over, name, kind, vehicles in (
        ("castors", "castor/ASOC-v1", "robot", CASTORS),
        ("axles", "castor/CFMMR-v1", "train", AXLES),
    ):
        options: list[dict[str, Any]] = [{kind: vehicle} for vehicle in vehicles.values()]
        made = {n: gym.make(name, **of).unwrapped for n, of in zip(vehicles, options, strict=True)}
        yield _curve(f"step of a {kind}", over, made, effort)
    for over, floor in (("cables", with_cables), ("patches", with_patches)):
        on = {n: gym.make("castor/ASOC-v1", robot="asoc-prototype", floor=floor(n)).unwrapped for n in OBSTACLES}
        yield _curve("step of the prototype", over, on, effort)


def with_cables(n: int) -> Floor:
    """Return a floor with n cables, drawn in the square where the robot drives."""
    random = np.random.default_rng(0)
    return Floor(
        cables=tuple(
            Cable(
                center=tuple(random.uniform(-3, 3, 2)), direction=random.uniform(0, np.pi), length=0.3, diameter=0.008
            )
            for _ in range(n)
        )
    )


def with_patches(n: int) -> Floor:
    """Return a floor with n patches, drawn likewise."""
    random = np.random.default_rng(0)
    return Floor(
        patches=tuple(
            Patch(center=tuple(random.uniform(-3, 3, 2)), size=(0.3, 0.2), friction=0.5, angle=random.uniform(0, np.pi))
            for _ in range(n)
        )
    )


def _curve(title: str, over: str, made: Mapping[int, Any], effort: Effort, each: bool = False) -> Curve:
    """Return the median time of a step of each environment; each: divided by the number of robots in it."""

    def reset() -> None:
        for env in made.values():
            env.reset(seed=0)

    times = by_turns({f"{n}": steps_of(env, STEPS) for n, env in made.items()}, effort.rounds, reset)
    costs = [1e6 * statistics.median(times[f"{n}"]) / STEPS / (n if each else 1) for n in made]
    for env in made.values():
        env.close()
    return Curve(title, over, "us", list(map(float, made)), costs)
