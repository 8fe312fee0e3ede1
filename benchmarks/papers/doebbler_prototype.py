"""Doebbler, Davis, Junkins and Valasek, Table III: the uncalibrated prototype and seven estimators; ours in physics."""

from dataclasses import replace

import gymnasium as gym
import numpy as np

from benchmarks.papers.assumptions import GIVEN, OF_SQUARES, Assumptions
from benchmarks.papers.comparison import Comparison, Effort, PaperTable, TableSource
from benchmarks.papers.simulations import rolled_square
from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.registry import score
from benchmarks.tasks.kinematic import UNCALIBRATED
from benchmarks.tasks.task import Episode, Run
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.trajectories import CORNER_RADIUS, Direction
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.registry import load_estimator

#: Table III: E_max, mm, of one robot.
TABLE_3 = {"ipec-1": 540, "ipec-2": 511, "ipec-3": 458, "cast-1": 544, "cast-2": 459, "cast-3": 432, "cast-0": 191}

#: Assumptions of this table, which the paper does not state.
ASSUMES = (*OF_SQUARES, "robots")


def tables() -> tuple[TableSource, ...]:
    """Return Doebbler's Table III."""
    return (TableSource("doebbler-3", _physics, ASSUMES),)


def episode(number: int, assumed: Assumptions) -> Episode:
    """Return a square each way, in physics, of a robot whose parameters are off; estimators get the nominal ones."""
    described = assumed.base_of_three
    random = np.random.default_rng([number, 7, assumed.seed])
    built = UNCALIBRATED.applied(described, random, assumed.distribution)
    ways = ("cw", "ccw")
    first = 100 * number + 10**6 * assumed.seed
    runs = (Run(_driven(built, way, assumed, first + k), way) for k, way in enumerate(ways))
    return Episode(described, tuple(runs))


def _driven(robot: RobotDescription, direction: Direction, assumed: Assumptions, seed: int) -> Log:
    """Return the log of one square in `castor/UMBmark-v0`; the estimates it is given change nothing."""
    env = gym.make(
        "castor_envs:castor/UMBmark-v0",
        robot=robot,
        direction=direction,
        corners=assumed.corners,
        speed=assumed.speed,
        acceleration=assumed.acceleration,
        turn_speed=np.radians(assumed.turn_rate),
        turn_acceleration=np.radians(assumed.turn_acceleration),
    )
    recorder = RecordLog(env)
    recorder.reset(seed=seed)
    finished = False
    while not finished:
        *_, terminated, truncated, _ = recorder.step(np.zeros(3))
        finished = terminated or truncated
    recorder.close()
    return recorder.log()


def _physics(effort: Effort) -> PaperTable:
    robots = min(effort.assumptions.robots, effort.sets)
    assumed = replace(effort.assumptions, robots=robots, corner_radius=CORNER_RADIUS)
    rolled_square(assumed, "ccw")  # says if the motors are too slow
    effort.progress.start("Doebbler, Table III", robots)
    errors: dict[str, list[float]] = {name: [] for name in TABLE_3}
    for number in range(robots):
        driven = episode(number, assumed)
        seen = observed_runs(driven)
        for name in TABLE_3:
            entry = load_estimator(name)
            estimates = estimate_singly(entry.spec, entry.source_hash, seen)
            if isinstance(estimates, Failure):
                raise RuntimeError(f"{name}: {estimates.reason}")
            errors[name].append(1e3 * score(driven, [estimate.poses for estimate in estimates])["E_max_syst"])
        effort.progress.advance()
    values = tuple(
        Comparison(
            (("estimator", name),),
            name.upper(),
            f"E_max in physics, mean of {robots} robots, mm",
            "E_max",
            "mm",
            float(printed),
            float(np.mean(errors[name])),
            0,
            float(np.std(errors[name], ddof=1) / np.sqrt(robots)),
        )
        for name, printed in TABLE_3.items()
    )
    best = sum(min(errors, key=lambda name, k=k: errors[name][k]) == "cast-0" for k in range(robots))
    spread = np.array([errors["cast-0"], errors["cast-1"]])
    means = {name: float(np.mean(values)) for name, values in errors.items()}
    ahead = [np.mean([row[f"cast-{i}"] for i in (1, 2, 3)]) / row["cast-0"] for row in (TABLE_3, means)]
    notes = (
        "The paper drove one uncalibrated prototype. Ours are robots with Table I's uncalibrated errors, driven in "
        "physics with slip; estimators get the nominal dimensions.",
        f"From robot to robot CAST-0 runs from {spread[0].min():.0f} to {spread[0].max():.0f} mm and CAST-1 from "
        f"{spread[1].min():.0f} to {spread[1].max():.0f}: one robot says little. CAST-0 is the best of the seven on "
        f"{best} of {robots}. CAST-1 to -3 over CAST-0: printed {ahead[0]:.2f}, ours {ahead[1]:.2f}.",
    )
    if effort.assumptions.corner_radius != CORNER_RADIUS:
        notes += (f"The environment rounds corners with {CORNER_RADIUS:g} m, and no other radius.",)
    title = "Doebbler, Table III: the uncalibrated prototype"
    return PaperTable(
        "doebbler-3", title, values, notes, "estimator", (*assumed.used((*ASSUMES, "corner_radius")), *GIVEN)
    )
