"""A robot as foreign simulators build it: its dimensions with all effects on them, and how its tyres give way."""

import dataclasses
from typing import NamedTuple

from castor_envs.effects.catalogue import creep_compliance_of
from castor_envs.effects.dimensions import LoadRadius
from castor_envs.errors import InputError
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription


class Tyres(NamedTuple):
    """How tyres give way beyond the description.

    shrinking: of radii, m for each N more than average. long, side: slip, as a part of the distance rolled, per unit
    ratio of force to load. viscous: slip in m/s per N of force.
    """

    shrinking: float
    long: float
    side: float
    viscous: float


def built(robot: RobotDescription) -> tuple[Geometry, Tyres]:
    """Return dimensions and tyres of a robot with its effects; radii are those without load.

    Raises InputError for a castor or wheel that the robot does not have.
    """
    yielding = [effect for effect in robot.effects if isinstance(effect, LoadRadius)]
    rigid = tuple(effect for effect in robot.effects if effect not in yielding)
    real, contact = dataclasses.replace(robot, effects=rigid).as_built(), robot.contact
    return Geometry.of(real), Tyres(
        sum(effect.value for effect in yielding),
        1 / real.contact.slip_stiffness_long - 1 / contact.slip_stiffness_long,
        1 / real.contact.slip_stiffness_lat - 1 / contact.slip_stiffness_lat,
        creep_compliance_of(robot),
    )


def check_drivable(robot: RobotDescription, simulator: str) -> None:
    """Raise InputError for a robot that no foreign simulator can drive; simulator: its name, for the message."""
    if any(wheel.grip != "standard" for wheel in robot.wheels):
        raise InputError(f"robot {robot.name!r} has omni wheels; the {simulator} generator has none")
    blind = [castor for castor in robot.castors if castor.steering != "fixed" and castor.pivot_counts_per_rev is None]
    if blind or not robot.driven_wheels:
        missing = f"the castor at {blind[0].pivot} has no pivot encoder" if blind else "no wheel has a motor"
        raise InputError(f"robot {robot.name!r} cannot be driven: {missing}; give it counts per turn")
    if any(effect.gyro_gain() != 1.0 for effect in robot.effects):
        raise InputError(f"robot {robot.name!r} has an effect on its gyro; the {simulator} generator has no gyros")
