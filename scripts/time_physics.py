"""Time the compiled physics against bare steps of pymunk with the same bodies: CPU time, alternating, in one process.

Run from the repository: ``.venv/bin/python scripts/time_physics.py``.
"""

import statistics
import time

import numpy as np

from castor_envs.floor import Cable, Floor, Patch
from castor_envs.physics.robot_world import World
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.presets import preset

ROUNDS, PERIODS = 15, 40
ROUGH = Floor(
    patches=tuple(Patch(center=(1.0 + i, 0.0), size=(0.5, 0.5), friction=0.1) for i in range(2)),
    cables=tuple(Cable(center=(0.3 + 0.1 * i, 0.0), direction=1.57, length=0.2, diameter=0.01) for i in range(10)),
)


def spent(function, *arguments):
    """Return the CPU time of PERIODS calls, s."""
    began = time.process_time()
    for _ in range(PERIODS):
        function(*arguments)
    return time.process_time() - began


def bare(space, dt, substeps):
    """Step a pymunk space alone for one sample period."""
    for _ in range(substeps):
        space.step(dt)


def world_of(name, floor):
    """Return the world of a robot or a train, and how many commands it takes."""
    if name.startswith("cfmmr"):
        train = load_train(name)
        return TrainWorld(train, floor), 2 * train.n_axles
    robot = preset(name)
    return World(robot, floor), len(robot.driven_wheels)


def main():
    """Print a row for each robot or train and floor."""
    print(f"{'robot':16} {'floor':6} {'us a substep':>12} {'us bare':>8} {'ratio':>6}")
    for name in ("differential", "asoc-prototype", "powered-caster", "6-castor", "cfmmr-3", "cfmmr-5", "cfmmr-10"):
        for floor, title in ((Floor(), "clean"), (ROUGH, "rough")):
            (world, motors), (other, _) = world_of(name, floor), world_of(name, floor)
            command = np.full(motors, 3.0)
            space, dt = other._simulation.space, other._simulation.dt
            ours, theirs = [], []
            for _ in range(ROUNDS):
                ours.append(spent(world.advance, command))
                theirs.append(spent(bare, space, dt, other.substeps))
            steps = PERIODS * world.substeps
            ratio = statistics.median(a / b for a, b in zip(ours[1:], theirs[1:], strict=True))
            each = [1e6 * statistics.median(times[1:]) / steps for times in (ours, theirs)]
            print(f"{name:16} {title:6} {each[0]:12.2f} {each[1]:8.2f} {ratio:6.2f}")


if __name__ == "__main__":
    main()
