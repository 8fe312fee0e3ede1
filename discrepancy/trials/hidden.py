"""What a trial hides: effects of the catalogue, by their classes, and effects outside it.

The right verdict on an effect outside the catalogue is "unexplained".
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from castor_envs.effects.parts import pivot_encoders, wheel_encoders
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True)
class Outside:
    """An effect outside the catalogue.

    castor, wheel: where it is, counted from 1; wheel None: on the castor itself, or its pivot. value: its size. seed:
    of its phase or its times. only: what may have it. step: a size to begin with. power: z and cost grow about as the
    size to this power.
    """

    castor: int
    wheel: int | None
    value: float
    seed: int = 0
    only: ClassVar[Literal["wheels", "pivots", "encoders", "castors"]] = "wheels"
    step: ClassVar[float] = 1e-3
    power: ClassVar[float] = 1.0
    wiring: ClassVar[bool] = False

    @classmethod
    def places(cls, robot: RobotDescription) -> Sequence[tuple[int, int | None]]:
        """Return the castors and wheels of a robot that may have this effect."""
        wheels = wheel_encoders(robot)
        pivots = [(castor, None) for castor in pivot_encoders(robot)]
        castors = [(i + 1, None) for i in range(len(robot.castors))]
        return {"wheels": wheels, "pivots": pivots, "encoders": [*wheels, *pivots], "castors": castors}[cls.only]

    @cached_property
    def phase(self) -> float:
        """Where in a turn it is, rad."""
        return float(np.random.default_rng(self.seed).uniform(-np.pi, np.pi))

    def wheel_in(self, robot: RobotDescription) -> int:
        """Return the index of its wheel."""
        return robot.wheel_places.index((self.castor, self.wheel))

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles (K, w + n), rad, that encoders see for true angles (K, w + n) along a path (K, 3).

        A row depends only on the rows before it, so that samples may be passed one by one.
        """
        return angle

    def tracked(self, t: Array, pose: Array) -> Array:
        """Return the poses (K, 3) that the reference reports for true poses."""
        return pose

    def build(self, parts: Any) -> None:
        """Change the parts of a simulator's model that is to be built."""

    def act(self, world: Any, t: float) -> None:
        """Change a simulator's model before each physics step, t s since the start."""


Hidden = Effect[RobotDescription] | Outside


def catalogued(hidden: Sequence[Hidden]) -> list[Effect[RobotDescription]]:
    """Return the effects of the catalogue."""
    return [effect for effect in hidden if not isinstance(effect, Outside)]


def outside_in(hidden: Sequence[Hidden]) -> Outside | None:
    """Return the effect outside the catalogue; None if there is none."""
    return next((effect for effect in hidden if isinstance(effect, Outside)), None)


def outsider(kinds: Sequence[type[Outside]], robot: RobotDescription, random: np.random.Generator) -> Outside:
    """Return an effect of one of these kinds, at a random place of the robot, in the size of its step."""
    possible = [kind for kind in kinds if kind.places(robot)]
    kind = possible[int(random.integers(len(possible)))]
    castor, wheel = kind.places(robot)[int(random.integers(len(kind.places(robot))))]
    return kind(castor, wheel, kind.step, int(random.integers(2**31)))


def class_of(hidden: Hidden) -> str:
    """Return the class of an effect, the same for all effects that no log can distinguish: the name to report, and the
    place on the robot; of an effect outside the catalogue the name alone.

    Further numbers (phase, threshold, a place on the floor) are not part of it.
    """
    if isinstance(hidden, Outside):
        return type(hidden).__name__
    name = hidden.indistinguishable_from[0] if hidden.indistinguishable_from else hidden.name
    fields = [field.name for field in dataclasses.fields(hidden) if field.name not in ("name", "value", "seed")]
    place = [value for field in fields if not isinstance(value := getattr(hidden, field), float)]
    return " ".join([name, *map(str, place)])
