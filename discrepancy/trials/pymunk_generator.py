"""Logs of robots in the project's own pymunk physics, steered by the readings of their sensors."""

import numpy as np

from castor_envs.effects.catalogue import reference, sensor_model_of
from castor_envs.floor import Floor
from castor_envs.geometry.se2 import wrap
from castor_envs.logs.log import Log
from castor_envs.motion.controllers import KinematicController, trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import Trajectory
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.sensors.gyro import GyroSensor
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.hidden import Outside
from discrepancy.trials.reading import USUAL, Noise, as_recorded, counts_of


def drive(
    robot: RobotDescription,
    motion: Trajectory,
    seed: int,
    *,
    duration: float,
    floor: Floor | None = None,
    outside: Outside | None = None,
    rounded: bool = True,
    noise: Noise = USUAL,
) -> Log:
    """Return a log of `duration` s of a robot, its effects included, that is to follow a motion.

    seed: of the castors' start angles, the encoders' phases and the reference's noise, which are the
    same with and without effects. rounded: False gives counts before they are rounded and pivots unwrapped; what the
    controller hears is rounded all the same, so that the run is the same.
    """
    described, built, period = robot.as_described(), Geometry.of(robot.as_built()), robot.sample_period
    phases, starts = (np.random.default_rng([seed, k]) for k in (2, 3))
    phase = Encoders.random_phase(built, phases)
    geometry = Geometry.of(described)
    start = trailing_angles(geometry, motion.runs[0].legs[0].motion) + starts.uniform(-0.5, 0.5, geometry.n_castors)
    start = wrap(start)  # as an absolute encoder is read from its first count on
    world = RobotWorld(robot, floor or Floor(), castor_angles=start)
    encoders, read, controller = Encoders(built, phase), sensor_model_of(robot), KinematicController(described)

    rows = round(duration / period) + 1
    t, w = np.arange(rows) * np.float64(period), len(robot.wheels)
    true = np.zeros((rows, w + geometry.n_castors))
    pose, yaw_rate, command, steering = np.zeros((rows, 3)), np.zeros(rows), [], []
    gyro = GyroSensor.of(robot, np.random.default_rng([seed, 5]))
    seen, twist = np.zeros_like(true), motion.at(t + 0.5 * period)[1]
    for k in range(rows):
        true[k, :w], true[k, w:], pose[k] = world.wheel_angles, world.castor_angles, world.pose
        yaw_rate[k] = world.twist[2]
        angle = true[k] if outside is None else outside.changed(robot, t[: k + 1], true[: k + 1], pose[: k + 1])[-1]
        (wheel,), (castor,) = read(t[k : k + 1], angle[None, :w], angle[None, w:])
        seen[k, :w], seen[k, w:] = wheel, castor
        if k == rows - 1:
            break
        measured = castor_angles(geometry, encoders.pivot(castor))
        commands = controller.commands(measured, twist[k])
        world.advance(commands.wheel, commands.steering)
        command.append(commands.wheel)
        steering.append(commands.steering)
    command.append(0 * command[-1])
    steering.append(0 * steering[-1])

    if outside is not None:
        pose = outside.tracked(t, pose)
    wheel, pivot = counts_of(robot, seen, phase)
    exact = Log(
        t,
        wheel=wheel,
        pivot=pivot,
        command=np.array(command),
        steering_command=np.array(steering) if robot.driven_castors else None,
        reference=reference(robot, t, pose),
        gyro=None if gyro is None else gyro.readings(t, yaw_rate),
    )
    return as_recorded(robot, exact, np.random.default_rng([seed, 4]), noise, rounded)
