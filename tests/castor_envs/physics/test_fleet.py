"""What stands in a lane is to the last bit what it would be alone: beside any others, in any width, on threads."""

import dataclasses

import numpy as np
import pytest

import castor_envs.physics.fleet as fleets
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.physics.fleet import Fleet, structure
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.presets import preset, preset_names

CABLE = Cable(center=(0.05, 0.0), direction=1.5, length=2.0, diameter=0.01)
FLOORS = (
    Floor(),
    Floor(cables=(CABLE,), slope=(0.03, -0.02)),
    Floor(patches=(Patch(center=(0.0, 0.0), size=(4.0, 4.0), friction=0.1),)),
    Floor(patches=(Patch(center=(0.3, 0.0), size=(0.6, 9.0), friction=0.0),) * 2, cables=(CABLE,) * 2, gravity=3.0),
)
ROBOTS = preset_names()


def robots(name, count, **changes):
    robot = dataclasses.replace(preset(name), **changes)
    return [RobotWorld(robot, FLOORS[i % len(FLOORS)], twist=(0.2, 0.0, 0.1 * i)) for i in range(count)]


def differing(worlds, samples, fast=0.7, **options):
    """Drive worlds at random, alone and as a fleet; return the numbers of those that end elsewhere."""
    simulations = [world.simulation for world in worlds]
    fleet, random = Fleet(simulations, **options), np.random.default_rng(4)
    for lane in range(len(worlds)):
        fleet.load(lane)
    wheels = np.arange(len(simulations[0].wheels))
    limit = np.stack([one.wheels["max_speed"] for one in simulations])
    for sample in range(samples):
        command = fast * random.uniform(-1, 1, limit.shape) * limit
        drive = "voltage" if sample % 2 else "servo"
        most = limit if drive == "servo" else np.ones_like(limit)
        command = command if drive == "servo" else command / limit
        fleet.command(wheels, command, most, drive)
        fleet.advance()
        for lane, one in enumerate(simulations):
            one.command(wheels, command[lane], most[lane], drive)
            one.advance()
    fleet.close()
    states = [(one.motion.copy(), one.wheels.copy(), one.joints.copy()) for one in simulations]
    for lane in range(len(worlds)):
        fleet.give_back(lane)
    return [
        lane
        for lane, (one, state) in enumerate(zip(simulations, states, strict=True))
        if any(
            now.tobytes() != then.tobytes()
            for now, then in zip((one.motion, one.wheels, one.joints), state, strict=True)
        )
        or fleet.motion[lane].tobytes() != one.motion.tobytes()
    ]


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_on_floors_of_their_own(name):
    assert differing(robots(name, 9), samples=2) == []


@pytest.mark.parametrize("axles", [2, 5])
def test_trains(axles):
    worlds = [TrainWorld(load_train(f"cfmmr-{axles}"), floor, bends=0.3) for floor in FLOORS]
    assert differing(worlds, samples=2) == []


@pytest.mark.parametrize("width", [8, 16, 32])
def test_any_width(monkeypatch, width):
    monkeypatch.setattr(fleets, "WIDTHS", {width: 1.0})
    assert differing(robots("asoc-prototype", 10), samples=2) == []


def test_each_has_as_many_substeps_as_it_needs():
    """A lane that is done waits for its neighbours; a lighter robot takes more substeps."""
    worlds = [world for mass in (3.0, 60.0, 8.0, 14.0) for world in robots("asoc-prototype", 3, mass=mass)]
    assert len({world.substeps for world in worlds}) > 2
    assert differing(worlds, samples=3) == []


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_change_nothing(threads):
    worlds = robots("differential", 70)
    assert differing(worlds, samples=2, threads=threads) == []


def test_a_lane_beside_an_unstable_one_goes_its_way():
    """Numbers that are none stay where they are."""
    worlds = robots("differential", 8)
    simulations = [world.simulation for world in worlds]
    fleet = Fleet(simulations)
    simulations[3].motion[:, 3] = np.nan
    for lane in range(8):
        fleet.load(lane)
    fleet.advance()
    assert np.isnan(fleet.motion[3]).any()
    for lane in {*range(8)} - {3}:
        simulations[lane].advance()
        assert fleet.motion[lane].tobytes() == simulations[lane].motion.tobytes()


def test_what_is_built_differently_has_another_structure():
    kinds = [RobotWorld(preset(name)).simulation for name in ("omni3", "swerve", "4-castor")]
    kinds.append(RobotWorld(preset("omni3"), Floor(climbing=False)).simulation)
    assert len({structure(kind) for kind in kinds}) == len(kinds)
