"""From the description of a robot to the records that the wheel force law works on."""

import math

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.se2 import rotate_single
from castor_envs.physics import tyre as law
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.weight import chassis, wheel_loads

SERVO_BANDWIDTH = 40.0  # rad/s: settles well within a 50 ms sample period
MOST_SUBSTEPS = 20_000  # a sample period


def wheel_records(robot: RobotDescription, floor: Floor) -> NDArray[np.void]:
    """Return a record (`castor_envs.physics.tyre.WHEEL`) for each wheel, at rest.

    Raises InputError where the robot would tip, or where a cable is thicker than a wheel can climb.
    """
    smallest = min(wheel.radius for wheel in robot.wheels)
    for cable in floor.cables:
        if cable.diameter >= smallest:
            raise InputError(
                f"a cable of {cable.diameter} m is too thick for robot {robot.name!r}, whose smallest wheel has a "
                f"radius of {smallest} m; lay one of less than that"
            )
    records = np.zeros(len(robot.wheels), dtype=law.WHEEL)
    loads = wheel_loads(robot, floor.normal_gravity)
    contact, center = robot.contact, chassis(robot)[2]
    body = 0
    k = 0
    for castor in robot.castors:
        moving = castor.steering != "fixed"
        body += moving
        for wheel in castor.wheels:
            w = records[k]
            if moving:
                place, heading = np.array([0.0, wheel.lateral]), 0.0
            else:
                at = rotate_single(np.array([-castor.offset, wheel.lateral]), castor.angle)
                place, heading = np.array(castor.pivot) + at - center, castor.angle
            w["body"] = body if moving else 0
            w["x"], w["y"] = place
            w["cos"], w["sin"] = math.cos(heading), math.sin(heading)
            w["radius"], w["inertia"], w["load"] = wheel.radius, wheel.inertia, loads[k]
            w["grip"] = law.STANDARD if wheel.grip == "standard" else law.OMNI
            w["roller"] = math.tan(wheel.roller_angle)
            w["friction"], w["relaxation"] = contact.friction, contact.relaxation_length
            w["stiffness_long"] = contact.slip_stiffness_long * loads[k] / contact.relaxation_length
            w["stiffness_lat"] = contact.slip_stiffness_lat * loads[k] / contact.relaxation_length
            w["damping_long"] = contact.damping * w["stiffness_long"]
            w["damping_lat"] = contact.damping * w["stiffness_lat"]
            felt = wheel.inertia + loads[k] / floor.normal_gravity * wheel.radius**2
            w["proportional"] = SERVO_BANDWIDTH * felt
            w["integral_gain"] = SERVO_BANDWIDTH**2 / 4 * felt
            w["max_torque"], w["max_speed"] = robot.max_wheel_torque, robot.max_wheel_speed
            k += 1
    return records


def enough_substeps(robot: RobotDescription, records: NDArray[np.void]) -> int:
    """Return the substeps a sample period that keep the stiffest castor's contact mode well resolved.

    The contact sees body velocities explicitly, so with mode frequency omega a substep must keep omega dt and the
    bristle damping's omega^2 damping dt small. Raises InputError where that takes more than `MOST_SUBSTEPS`.
    """
    fastest = 0.0
    offset_of = {k: robot.castors[i].offset for k, i in enumerate(robot.wheel_castors)}
    for i, castor in enumerate(robot.castors):
        wheels = [k for k, j in enumerate(robot.wheel_castors) if i == j]
        stiffness = np.array([max(records[k]["stiffness_long"], records[k]["stiffness_lat"]) for k in wheels])
        arm = np.array([robot.wheels[k].lateral ** 2 + offset_of[k] ** 2 for k in wheels])
        if castor.steering == "fixed":
            mass, inertia, _ = chassis(robot)
            turning = float(np.sum(stiffness * arm)) / inertia
        else:
            mass = castor.mass
            turning = float(np.sum(stiffness * arm)) / (castor.inertia + castor.mass * castor.offset**2)
        fastest = max(fastest, float(np.sum(stiffness)) / mass, turning)
    longest = min(5e-4, 0.25 / math.sqrt(fastest), 0.3 / (fastest * max(robot.contact.damping, 1e-9)))
    substeps = math.ceil(robot.sample_period / longest)
    if substeps > MOST_SUBSTEPS:
        raise InputError(
            f"robot {robot.name!r}: a sample period would take {substeps} substeps of physics, more than "
            f"{MOST_SUBSTEPS}; its contact is too stiff or too damped for its masses, or its sample_period too long"
        )
    return substeps
