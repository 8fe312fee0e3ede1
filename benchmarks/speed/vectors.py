"""Many environments stepped as one, beside Gymnasium's loop over single ones, and by several threads."""

import statistics
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import SyncVectorEnv

import castor_envs  # noqa: F401  (registers the environments)
from benchmarks.speed.figures import Effort, Figure, Group, Work, by_turns, steps_of
from benchmarks.speed.steps import DRIVEN

SIZES = 64, 1024
STEPS = 4
"""A round, from a reset on."""
LONG = 100
"""Steps a round in which episodes end and others begin: with random actions a robot is lost after some 60."""
THREADS = 2


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield what a step of a vector takes for each member, of how many of the loop's that is, and what threads gain."""
    for title, (name, vehicle) in DRIVEN.items():
        loop = SyncVectorEnv([lambda name=name, vehicle=vehicle: _single(name, vehicle)] * SIZES[0])
        made = {size: _vector(name, vehicle, size, 1) for size in SIZES}
        for size, vector in made.items():
            taken, gained = _beside(vector, loop, STEPS, max(1, effort.rounds * SIZES[0] // size))
            yield Figure(f"step of {title}, {size} at once, for each", 1e6 * taken, "us")
            yield Figure(f"step of {title} in SyncVectorEnv / {size} at once", gained, "x")
        taken, gained = _beside(made[SIZES[0]], loop, LONG, max(1, effort.rounds // 10))
        yield Figure(f"step of {title}, {SIZES[0]} at once, with new episodes, for each", 1e6 * taken, "us")
        yield Figure(f"step of {title} in SyncVectorEnv / {SIZES[0]} at once, with new episodes", gained, "x")
        threaded = _vector(name, vehicle, SIZES[-1], THREADS)
        both = (made[SIZES[-1]], threaded)
        one, several = (steps_of(env, STEPS) for env in both)
        gained = _faster(one, several, effort.rounds, _begun(both))
        yield Figure(f"step of {title}, {SIZES[-1]} at once, one thread / {THREADS}, by the clock", gained, "x")
        threaded.close()
    gained = _faster(*_spins(), effort.rounds)
    yield Figure(f"sines alone, one thread / {THREADS}, by the clock", gained, "x")


def _single(name: str, vehicle: str) -> Any:
    return gym.make(name, **_of(name, vehicle))


def _vector(name: str, vehicle: str, size: int, threads: int) -> Any:
    return gym.make_vec(
        name, num_envs=size, vectorization_mode="vector_entry_point", threads=threads, **_of(name, vehicle)
    )


def _of(name: str, vehicle: str) -> dict[str, Any]:
    return {"train" if name == "castor/CFMMR-v1" else "robot": vehicle}


def _beside(vector: Any, loop: Any, steps: int, rounds: int) -> tuple[float, float]:
    """Return the CPU time (s) of a step of each member of a vector, and as how many of it a step in the loop takes."""
    envs: dict[str, Any] = {"vector": vector, "loop": loop}
    variants = {key: steps_of(env, steps) for key, env in envs.items()}
    times = by_turns(variants, rounds, lambda: [env.reset(seed=0) for env in envs.values()])
    each = {key: [taken / steps / envs[key].num_envs for taken in of] for key, of in times.items()}
    gained = statistics.median(a / b for a, b in zip(each["loop"], each["vector"], strict=True))
    return statistics.median(each["vector"]), gained


def _begun(envs: Sequence[Any]) -> Work:
    """Return what begins new episodes in all and takes the first step, which gathers what single ones have begun."""

    def begin() -> None:
        for env in envs:
            env.reset(seed=0)
            env.step(0 * env.action_space.sample())

    return begin


def _faster(one: Work, several: Work, rounds: int, prepare: Work = lambda: None) -> float:
    """Return how many times faster the second is by the clock: the median over rounds in which both take turns.

    prepare: called before each round, not timed.
    """
    ratios = []
    for _ in range(rounds):
        prepare()
        ratios.append(_clocked(one) / _clocked(several))
    return statistics.median(ratios)


def _clocked(work: Work) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def _spins() -> tuple[Work, Work]:
    """Return the same work for one thread and for several: what the machine has to offer at that time."""
    data = [np.linspace(0.0, 1.0, 20_000) for _ in range(THREADS)]

    def spin(values: Any) -> None:
        for _ in range(100):
            np.sin(values)  # which lets the interpreter go on

    def one() -> None:
        for values in data:
            spin(values)

    def several() -> None:
        threads = [threading.Thread(target=spin, args=(values,)) for values in data]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    return one, several


GROUP = Group("Vectors of environments", figures)
