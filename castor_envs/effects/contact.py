"""Effects on how wheels hold the floor: tyres that creep more or less than described, under drive and side forces."""

import dataclasses
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG
from castor_envs.geometry.steps import Slip
from castor_envs.vehicles.effect import Contacts, Effect
from castor_envs.vehicles.robot import RobotDescription

Stiffness = Annotated[float, Field(ge=-0.9, le=10.0)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SlipStiffness(Effect[RobotDescription]):
    """All wheels creep less under drive forces: their longitudinal slip stiffness is larger by the fraction `value`."""

    name: Literal["slip_stiffness"] = "slip_stiffness"
    value: Stiffness
    title = "slip stiffness of the tyres"
    unit = "1"
    step = 0.1
    tolerance = 0.1  # tyres are measured no better
    creep = "compliance"
    check = "Compare wheel counts on a distance driven softly with those driven with hard starts and stops."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["SlipStiffness", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with `contact.slip_stiffness_long` scaled by 1 + value."""
        stiffness = robot.contact.slip_stiffness_long * (1.0 + self.value)
        return dataclasses.replace(robot, contact=dataclasses.replace(robot.contact, slip_stiffness_long=stiffness))

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip:
        """Return the creep of wheels under the forces of the motion beyond that with the stiffness described."""
        return contacts.of(self.apply(contacts.robot)).creep() - contacts.creep()


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SlipStiffnessLateral(Effect[RobotDescription]):
    """All wheels slip less under side forces: their lateral slip stiffness is larger by the fraction `value`."""

    name: Literal["slip_stiffness_lateral"] = "slip_stiffness_lateral"
    value: Stiffness
    title = "side slip with load"
    unit = "1"
    step = 0.1
    tolerance = 0.1  # tyres are measured no better
    creep = "compliance"
    check = "Drive bends fast and slowly and compare where the robot ends; look at the tyres' pressure and hardness."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["SlipStiffnessLateral", ...]:
        """Return an instance if the robot has wheels without rollers."""
        return (cls(value=cls.step),) if any(wheel.grip == "standard" for wheel in robot.wheels) else ()

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with `contact.slip_stiffness_lat` scaled by 1 + value."""
        stiffness = robot.contact.slip_stiffness_lat * (1.0 + self.value)
        return dataclasses.replace(robot, contact=dataclasses.replace(robot.contact, slip_stiffness_lat=stiffness))

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip:
        """Return the sideways slip of castors beyond that with the stiffness described."""
        return contacts.of(self.apply(contacts.robot)).creep() - contacts.creep()


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ContactCreep(Effect[RobotDescription]):
    """Contacts creep under force even at rest: each slips at `value` (m/s) for every N of force on it.

    Along and across, in addition to the slip in proportion to the distance rolled.
    """

    name: Literal["contact_creep"] = "contact_creep"
    value: Annotated[float, Field(ge=0.0, le=0.1)]
    title = "contacts that creep at standstill"
    unit = "m/s/N"
    step = 1e-5
    tolerance = 1e-6  # m/s/N: 10 N move a wheel by less than 1 mm in a minute
    creep = "compliance"
    check = "Leave the robot on a slope, wheels braked, and see whether it moves; look for soft or wet tyres or carpet."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["ContactCreep", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def creep_compliance(self) -> float:
        """Return `value`."""
        return self.value

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip:
        """Return the additional slip of contacts under the forces of the motion."""
        return contacts.creep(creep_compliance=self.value) - contacts.creep()
