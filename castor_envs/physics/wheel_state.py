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
    """Return the substeps a sample period that keep the stiffest mode of bodies on their contacts well resolved.

    A contact sees body velocities explicitly, so with mode frequency omega a substep must keep omega dt and the
    bristle damping's omega^2 damping dt small. Bodies are the chassis on the wheels of all castors fixed to it, and
    every other castor about its pivot; a body's contacts all give at once, and rollers at an angle push aside as well.
    Raises InputError where that takes more than `MOST_SUBSTEPS`.
    """
    fixed = np.array([castor.steering == "fixed" for castor in robot.castors])
    castor_of = np.array(robot.wheel_castors)
    stiffness = np.maximum(records["stiffness_long"] * (1.0 + records["roller"] ** 2), records["stiffness_lat"])
    turning = stiffness * (records["x"] ** 2 + records["y"] ** 2)  # from the centre of mass of the chassis

    fastest = 0.0
    if fixed.any():
        (mass, inertia, _), on_chassis = chassis(robot), fixed[castor_of]
        fastest = max(float(np.sum(stiffness[on_chassis])) / mass, float(np.sum(turning[on_chassis])) / inertia)
    for i in np.flatnonzero(~fixed).tolist():
        castor, wheels = robot.castors[i], np.flatnonzero(castor_of == i)
        arm = np.array([robot.wheels[k].lateral ** 2 + castor.offset**2 for k in wheels])
        about_pivot = float(np.sum(stiffness[wheels] * arm)) / (castor.inertia + castor.mass * castor.offset**2)
        fastest = max(fastest, float(np.sum(stiffness[wheels])) / castor.mass, about_pivot)
    longest = min(5e-4, 0.25 / math.sqrt(fastest), 0.3 / (fastest * max(robot.contact.damping, 1e-9)))
    substeps = math.ceil(robot.sample_period / longest)
    if substeps > MOST_SUBSTEPS:
        raise InputError(
            f"robot {robot.name!r}: a sample period would take {substeps} substeps of physics, more than "
            f"{MOST_SUBSTEPS}; its contact is too stiff or too damped for its masses, or its sample_period too long"
        )
    return substeps
