"""An estimator's update: of one robot from Python, and of many robots at once, for each of them."""

import statistics
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.speed.figures import Effort, Figure, Group, by_turns
from benchmarks.tasks.kinematic import ROBOT
from castor_envs.errors import Declined
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.presets import cfmmr
from estimators.plugins.registry import builtin_names, load_estimator, reset_at_origin
from estimators.trains import grpec

SINGLE = {ROBOT: ("cast-0", "ipec-1", "wheel-odometry", "filter"), "swerve": ("wheel-odometry", "wpilib-swerve")}
BATCHED = ("cast-0", "ipec-1", "wheel-odometry", "filter")
ROBOTS, UPDATES = 1000, 20

SNAPSHOTS, SPREAD = 100_000, (0.1, 0.1, 0.3)
"""Of a train on three axles; standard deviations of its odometry and its relative poses, m, m and rad."""


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield updates of one robot for each vehicle, then those of many; peers that are not installed are left out."""
    for name, estimators in SINGLE.items():
        robot = load_vehicle(name)
        made = {spec: load_estimator(spec).factory() for spec in estimators if spec in builtin_names(robot)}
        for estimator in made.values():
            reset_at_origin(estimator, robot)
        times = by_turns({spec: _updates(of, robot, ()) for spec, of in made.items()}, effort.rounds)
        for spec, of in times.items():
            yield Figure(f"update of {spec} on {name}", 1e6 * statistics.median(of) / UPDATES, "us")
    robot: Any = load_vehicle(ROBOT)
    stack, many = Geometry.of([robot] * ROBOTS), {}
    for spec in BATCHED:
        estimator: Any = load_estimator(spec).factory()
        try:
            estimator.reset(stack, np.zeros((ROBOTS, 3)))
        except Declined:
            continue
        many[spec] = _updates(estimator, robot, (ROBOTS,))
    for spec, of in by_turns(many, effort.rounds).items():
        told = f"update of {spec}, {ROBOTS} robots at once, for each"
        yield Figure(told, 1e9 * statistics.median(of) / UPDATES / ROBOTS, "ns")
    (of,) = by_turns({"grpec-xy": _corrections()}, effort.rounds).values()
    yield Figure(
        f"correction by grpec-xy, {SNAPSHOTS:,} at once, for each", 1e6 * statistics.median(of) / SNAPSHOTS, "us"
    )


def _updates(estimator: Any, robot: Any, stack: tuple[int, ...]) -> Any:
    """Return what takes samples of random turns of wheels and castors, the first of them new each time."""
    random = np.random.default_rng(0)
    wheels, castors = len(robot.wheels), len(robot.castors)
    samples = [
        {
            "wheel": random.integers(20, 40, (*stack, wheels)).astype(float),
            "pivot": random.integers(0, 3, (*stack, castors)).astype(float),
            "time": np.full((*stack, 1), k * robot.sample_period),
        }
        for k in range(UPDATES)
    ]

    def updates() -> None:
        for sample in samples:
            estimator.update(sample)

    return updates


def _corrections() -> Callable[[], object]:
    """Return what corrects random snapshots of a train on three axles."""
    random = np.random.default_rng(0)
    odometry, relative = (random.normal(0.0, SPREAD, (SNAPSHOTS, axles, 3)) for axles in (3, 2))
    relative[..., 0] += cfmmr(3).frames[0].length

    def corrections() -> object:
        distance = grpec.errors(odometry, relative).theta_xy
        return grpec.corrected(odometry, relative, grpec.select(distance, distance))

    return corrections


GROUP = Group("Updates of estimators", figures)
