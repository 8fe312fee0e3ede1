"""A substep of the physics as a multiple of a bare step of pymunk on the same bodies, on a clean and a rough floor."""

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.speed.figures import Effort, Figure, Group, by_turns, ratio
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.robot import RobotDescription

VEHICLES = ("differential", "asoc-prototype", "powered-caster", "6-castor", "cfmmr-3", "cfmmr-5", "cfmmr-10")
FLOORS = {
    "clean": Floor(),
    "rough": Floor(
        patches=tuple(Patch(center=(1.0 + i, 0.0), size=(0.5, 0.5), friction=0.1) for i in range(2)),
        cables=tuple(Cable(center=(0.3 + 0.1 * i, 0.0), direction=1.57, length=0.2, diameter=0.01) for i in range(10)),
    ),
}
PERIODS = 4
"""Sample periods a round: few, so that the machine changes little between the variants."""


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield the ratio for each vehicle and floor."""
    for name in VEHICLES:
        for title, floor in FLOORS.items():
            physics, bare = _variants(name, floor)
            times = by_turns({"physics": physics, "bare": bare}, effort.rounds)
            yield Figure(f"substep of {name}, {title} floor / bare step", ratio(times, "physics", "bare"), "x")


def _variants(name: str, floor: Floor) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return some sample periods of the physics, and as many bare steps as these take substeps."""
    (world, motors), (still, _) = _world(name, floor), _world(name, floor)
    command = np.full(motors, 3.0)
    space, dt = still.simulation.space, still.simulation.dt

    def physics() -> None:
        for _ in range(PERIODS):
            world.advance(command)

    def bare() -> None:
        for _ in range(PERIODS * world.substeps):
            space.step(dt)

    return physics, bare


def _world(name: str, floor: Floor) -> tuple[RobotWorld | TrainWorld, int]:
    """Return a world, and how many motors its vehicle has."""
    vehicle = load_vehicle(name)
    if isinstance(vehicle, RobotDescription):
        return RobotWorld(vehicle, floor), len(vehicle.driven_wheels)
    return TrainWorld(vehicle, floor), 2 * vehicle.n_axles


GROUP = Group("Substeps", figures)
