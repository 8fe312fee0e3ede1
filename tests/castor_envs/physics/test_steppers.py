"""The substep, the stepper and the process change nothing that counts."""

import dataclasses
import math
import os
import subprocess
import sys

import numpy as np
import pytest

from castor_envs.floor import Cable, Floor, Patch
from castor_envs.motion.controllers import KinematicController
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.solver import PIVOT, SPRING, solving_order
from castor_envs.physics.stepper import Drive
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Contact

NO_SIDEWAYS = ("differential", "tricycle")
ROUGH = Floor(
    patches=(
        Patch(center=(0.2, 0.1), size=(0.5, 0.3), friction=0.1, angle=0.4),
        Patch(center=(0.1, -0.2), size=(0.4, 0.2), friction=0.3),
    ),
    cables=(
        Cable(center=(0.15, 0.0), direction=1.4, length=0.6, diameter=0.01),
        Cable(center=(-0.2, 0.1), direction=0.3, length=0.8, diameter=0.008),
    ),
    slope=(0.04, -0.02),
)


def twist_at(name, t, speed):
    """A drive with reversals, turns on the way and sideways legs; `speed` in m/s."""
    ramp = speed * min(1.0, t / 0.4)
    sideways = 0.0 if name in NO_SIDEWAYS else 0.7 * math.sin(2.3 * t)
    return ramp * np.array([0.8 * math.cos(1.7 * t), sideways, 2.5 * math.sin(1.1 * t)])


def driven(name, *, speed, duration=5.0, floor=None, friction=0.8, **options):
    robot = dataclasses.replace(preset(name), contact=Contact(friction=friction))
    world, controller = RobotWorld(robot, floor, **options), KinematicController(robot)
    for k in range(round(duration / robot.sample_period)):
        wanted = twist_at(name, (k + 0.5) * robot.sample_period, speed)
        world.advance(*controller.commands(world.castor_angles, wanted))
    return world


SPEEDS = {
    "asoc-prototype": 0.5,
    "asoc-full-scale": 0.6,
    "2-castor": 0.5,
    "6-castor": 0.5,
    "omnimate": 0.4,
    "differential": 0.9,
    "tricycle": 0.7,
    "powered-caster": 0.25,  # its casters must turn at speed / 14 mm, and can 12 rad/s
    "swerve": 0.6,
}


@pytest.mark.parametrize("friction", [0.8, 0.1])
@pytest.mark.parametrize("name", SPEEDS)
def test_halving_the_substep_moves_the_end_of_a_drive_by_less_than_a_millimetre(name, friction):
    coarse = driven(name, speed=SPEEDS[name], friction=friction)
    fine = driven(name, speed=SPEEDS[name], friction=friction, substeps=2 * coarse.substeps)
    assert math.dist(coarse.pose[:2], fine.pose[:2]) < 1e-3
    assert abs(coarse.pose[2] - fine.pose[2]) < 5e-3


@pytest.mark.parametrize("name", ["asoc-prototype", "differential", "tricycle", "powered-caster"])
def test_halving_the_substep_moves_little_on_a_rough_floor_too(name):
    coarse = driven(name, speed=SPEEDS[name], floor=ROUGH)
    fine = driven(name, speed=SPEEDS[name], floor=ROUGH, substeps=2 * coarse.substeps)
    assert math.dist(coarse.pose[:2], fine.pose[:2]) < 1e-3


DRIVES: tuple[Drive, ...] = ("servo", "voltage", "servo", "off")


def commands(robot, samples):
    """Random driving by turns with servos, voltage, and motors off: what `advance` takes, sample by sample."""
    random = np.random.default_rng(7)
    angles = random.uniform(-math.pi, math.pi, len(robot.castors))
    rows = []
    for k in range(samples // 10):
        drive = DRIVES[k % 4]
        limit = 0.5 if drive == "voltage" else 0.4 * robot.max_wheel_speed
        wheels = random.uniform(-limit, limit, len(robot.driven_wheels))
        rows += [(wheels, random.uniform(-4, 4, len(robot.driven_castors)), drive)] * 10
    return angles, rows


def state(world):
    return np.array([*world.pose, *world.castor_angles, *world.wheel_angles])


def episode(name, stepper, samples, substeps):
    """Poses, castor angles and wheel angles of random driving."""
    angles, rows = commands(preset(name), samples)
    world = RobotWorld(preset(name), ROUGH, castor_angles=angles, stepper=stepper, substeps=substeps)
    states = []
    for row in rows:
        world.advance(*row)
        states.append(state(world))
    return np.array(states)


@pytest.mark.parametrize("name", ["powered-caster", "tricycle", "differential", "omnimate", "swerve"])
def test_reference_and_compiled_stepper_agree(name):
    reference, compiled = (episode(name, stepper, samples=40, substeps=30) for stepper in ("reference", "compiled"))
    assert np.ptp(reference[:, :2]) > 0.1
    np.testing.assert_allclose(compiled, reference, rtol=0, atol=1e-12)


def test_reference_and_compiled_stepper_agree_on_a_drive_that_magnifies_the_last_bit():
    """From a sample on the prototype's does, 1e5 times in 50 ms, by any stepper: so both begin anew and drive 10 ms."""
    robot = dataclasses.replace(preset("asoc-prototype"), sample_period=0.01)
    angles, rows = commands(robot, samples=40)
    driven = RobotWorld(robot, ROUGH, castor_angles=angles, substeps=6)
    for row in rows:
        worlds = [RobotWorld(robot, ROUGH, stepper=stepper, substeps=6) for stepper in ("reference", "compiled")]
        for world in worlds:
            own = world.simulation.joints.copy()  # without impulses, as pymunk's are in a new world
            world.simulation.resume(driven.simulation.motion, driven.wheels, own, driven.time)
            assert len(world.simulation.space.bodies) == 4  # which moves them there
            world.advance(*row)
        np.testing.assert_allclose(state(worlds[1]), state(worlds[0]), rtol=0, atol=1e-12)
        for _ in range(5):
            driven.advance(*row)
    assert math.hypot(*driven.pose[:2]) > 0.1


def train_episode(axles, stepper, samples):
    """Poses, joint angles and wheel angles of a train that is driven at random, and bent."""
    train, random = load_train(f"cfmmr-{axles}"), np.random.default_rng(axles)
    world, rows = TrainWorld(train, ROUGH, bends=0.5, stepper=stepper), []
    for _ in range(samples):
        world.advance(random.uniform(-8, 8, 2 * axles))
        rows.append([*world.poses.ravel(), *np.concatenate(world.joint_angles), *world.wheel_angles])
    return np.array(rows)


def test_reference_and_compiled_stepper_agree_on_trains():
    """pymunk solves joint by joint, the compiled solver along the chain: the order changes nothing."""
    reference, compiled = (train_episode(3, stepper, samples=8) for stepper in ("reference", "compiled"))
    assert np.ptp(reference[:, 2]) > 0.02
    np.testing.assert_allclose(compiled, reference, rtol=0, atol=1e-12)


@pytest.mark.parametrize("iterations", [1, 2, 7])
def test_every_joint_waits_for_the_same_joints_as_one_after_the_other(iterations):
    """Of each two turns that share a body, the one that came first still does; all turns are there."""
    star = tuple((PIVOT, 0, i) for i in (1, 2, 3))
    chain = tuple((kind, i, i + 1) for i in range(5) for kind in (PIVOT, SPRING))
    for joints in (star, chain, (*chain, *((PIVOT, 2, 6 + i) for i in range(2)))):
        order = solving_order(joints, iterations).tolist()
        assert sorted(order) == sorted([*range(len(joints))] * iterations)
        for body in range(8):
            on = [number for number, joint in enumerate(joints) if body in joint[1:]]
            assert [number for number in order if number in on] == on * iterations


@pytest.mark.parametrize("name", ["asoc-prototype", "tricycle"])
def test_a_world_that_starts_again_is_as_a_new_one(name):
    robot, random = preset(name), np.random.default_rng(3)
    command = random.uniform(-4, 4, len(robot.driven_wheels))
    steering = random.uniform(-2, 2, len(robot.driven_castors))
    angles = random.uniform(-3, 3, len(robot.castors))
    pose, twist = random.uniform(-1, 1, (2, 3))
    used, new = RobotWorld(robot, ROUGH), RobotWorld(robot, ROUGH, castor_angles=angles, pose=pose, twist=twist)
    for _ in range(5):
        used.advance(command, steering)
    used.restart(angles, pose, twist)
    for _ in range(5):
        assert used.pose.tobytes() == new.pose.tobytes()
        assert used.wheels.tobytes() == new.wheels.tobytes()
        for world in (used, new):
            world.advance(command, steering)


def test_a_train_that_starts_again_is_as_a_new_one():
    used, new = (TrainWorld(load_train("cfmmr-3"), bends=0.3) for _ in range(2))
    for _ in range(5):
        used.advance(np.arange(6.0))
    used.restart()
    for _ in range(5):
        assert used.poses.tobytes() == new.poses.tobytes()
        assert used.wheels.tobytes() == new.wheels.tobytes()
        for world in (used, new):
            world.advance(np.arange(6.0))


def test_the_same_run_is_the_same_bit_for_bit():
    first, second = (driven("asoc-prototype", speed=0.5, duration=2.0, floor=ROUGH) for _ in range(2))
    assert first.pose.tobytes() == second.pose.tobytes()
    assert first.wheels.tobytes() == second.wheels.tobytes()


DIGEST = """
import hashlib
import numpy as np
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import preset

floor = Floor(
    slope=(0.04, -0.02),
    patches=(Patch(center=(0.2, 0.1), size=(0.5, 0.3), friction=0.1, angle=0.4),),
    cables=(Cable(center=(0.15, 0.0), direction=1.4, length=0.6, diameter=0.01),),
)
digest = hashlib.sha256()
for name in ("asoc-prototype", "powered-caster", "tricycle"):
    robot, random = preset(name), np.random.default_rng(4)
    world = RobotWorld(robot, floor, castor_angles=random.uniform(-3, 3, len(robot.castors)))
    for _ in range(60):
        wheels = random.uniform(-5, 5, len(robot.driven_wheels))
        world.advance(wheels, random.uniform(-2, 2, len(robot.driven_castors)))
        digest.update(world.pose.tobytes() + world.castor_angles.tobytes() + world.wheels.tobytes())
print(digest.hexdigest())
"""


def test_another_process_repeats_a_run_bit_for_bit(tmp_path):
    namespace = {}
    exec(compile(DIGEST.replace("print(digest", "result = (digest"), "digest", "exec"), namespace)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONHASHSEED": "12345"}
    command = [sys.executable, "-c", DIGEST]
    completed = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert completed.stdout.strip() == namespace["result"]
