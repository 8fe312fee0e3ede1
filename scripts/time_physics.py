"""Time the compiled physics against bare steps of pymunk with the same bodies: CPU time, alternating, in one process.

Run from the repository: ``.venv/bin/python scripts/time_physics.py [NAME ...]``.

Each round times a few sample periods of both variants, one right after the other, which one first by turns, and takes
the ratio of their CPU times. What else the machine does slows both of a round much alike (caches, clock rate, a
hyper-thread's neighbour); the median over the rounds leaves out those in which it did not. Beside the median stand the
quartiles of the ratios, between which half of the rounds lie: of one round, not of the median.
"""

import gc
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from castor_envs.floor import Cable, Floor, Patch
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.presets import preset

VEHICLES = ("differential", "asoc-prototype", "powered-caster", "6-castor", "cfmmr-3", "cfmmr-5", "cfmmr-10")
ROUNDS = 400
PERIODS = 4  # a round: short, so that the machine changes little between both variants
WARM = 20  # rounds before those that count: compiling, filling caches
ROUGH = Floor(
    patches=tuple(Patch(center=(1.0 + i, 0.0), size=(0.5, 0.5), friction=0.1) for i in range(2)),
    cables=tuple(Cable(center=(0.3 + 0.1 * i, 0.0), direction=1.57, length=0.2, diameter=0.01) for i in range(10)),
)


def spent(advance: Callable[[], None]) -> float:
    """Return the CPU time of PERIODS sample periods, s."""
    began = time.process_time()
    for _ in range(PERIODS):
        advance()
    return time.process_time() - began


def variants(name: str, floor: Floor) -> tuple[Callable[[], None], Callable[[], None], int]:
    """Return a sample period of the physics, one of bare steps, and how many substeps both take."""

    def world_of() -> tuple[RobotWorld | TrainWorld, int]:
        if name.startswith("cfmmr"):
            train = load_train(name)
            return TrainWorld(train, floor), 2 * train.n_axles
        robot = preset(name)
        return RobotWorld(robot, floor), len(robot.driven_wheels)

    (world, motors), (still, _) = world_of(), world_of()
    command = np.full(motors, 3.0)
    space, dt = still.simulation.space, still.simulation.dt

    def bare() -> None:
        for _ in range(world.substeps):
            space.step(dt)

    return lambda: world.advance(command), bare, world.substeps


def main() -> None:
    """Print a row for each robot or train and floor."""
    print(f"{'vehicle':16} {'floor':6} {'us a substep':>12} {'us bare':>8} {'ratio':>6}  quartiles")
    gc.disable()
    for name in sys.argv[1:] or VEHICLES:
        for floor, title in ((Floor(), "clean"), (ROUGH, "rough")):
            physics, bare, substeps = variants(name, floor)
            rows = []
            for turn in range(WARM + ROUNDS):
                if turn % 2:
                    times = spent(physics), spent(bare)
                else:
                    times = spent(bare), spent(physics)
                    times = times[::-1]
                rows.append(times)
            ours, theirs = np.array(rows[WARM:]).T
            low, median, high = statistics.quantiles(ours / theirs, n=4)
            each = [1e6 * float(np.median(times)) / (PERIODS * substeps) for times in (ours, theirs)]
            row = f"{name:16} {title:6} {each[0]:12.2f} {each[1]:8.2f} {median:5.2f}x  {low:.2f} to {high:.2f}"
            print(row, flush=True)


if __name__ == "__main__":
    main()
