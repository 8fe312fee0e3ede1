"""Effects that a trial hides: their classes, sizes and places."""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from castor_envs.effects.clocks import SampleJitter
from castor_envs.effects.parts import wheel_channel
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True)
class Hidden:
    """A hidden effect: of the catalogue, or of a generator and outside the catalogue; its size is `field`.

    power: z and cost grow about as the size to this power.
    """

    what: Any
    field: str = "value"
    power: float = 1.0

    @property
    def effect(self) -> Effect | None:
        """The effect, if it is of the catalogue."""
        return self.what if isinstance(self.what, Effect) else None

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effect alone, or none if it is outside the catalogue."""
        return () if self.effect is None else (self.effect,)

    @property
    def outside(self) -> Any | None:
        """The effect, if it is outside the catalogue."""
        return None if self.effect is not None else self.what

    @property
    def jitter(self) -> bool:
        """Whether it is jitter of sampling, which changes no mean."""
        return isinstance(self.what, SampleJitter)

    @property
    def wiring(self) -> bool:
        """Whether it is wrong wiring, which has no size."""
        return self.effect is not None and self.effect.wiring

    @property
    def label(self) -> str:
        """The class of the effect, or its name if it is outside the catalogue."""
        return type(self.what).__name__ if self.effect is None else class_of(self.effect)

    @property
    def size(self) -> float:
        """The size of the effect."""
        return float(getattr(self.what, self.field))

    def scaled(self, size: float) -> "Hidden":
        """Return the effect with another size; raises ValueError for a size that it cannot have."""
        current = getattr(self.what, self.field)
        new = max(round(size), 1) if isinstance(current, int) else size
        return dataclasses.replace(self, what=dataclasses.replace(self.what, **{self.field: new}))


Outsiders = Callable[[RobotDescription, np.random.Generator], Iterator[Hidden]]
"""Yields effects that are not in the catalogue, each in a size to begin with."""


def class_of(effect: Effect) -> str:
    """Return the class of an effect, the same for all effects that no log can distinguish: the name to report, and the
    place on the robot.

    Further numbers (phase, threshold, a place on the floor) are not part of it.
    """
    name = effect.indistinguishable_from[0] if effect.indistinguishable_from else effect.name
    fields = [field.name for field in dataclasses.fields(effect) if field.name not in ("name", "value", "seed")]
    place = [value for field in fields if not isinstance(value := getattr(effect, field), float)]
    return " ".join([name, *map(str, place)])


def wheel_of(robot: RobotDescription, effect: Any) -> int:
    """Return the index of the wheel that an effect is on, by its `castor` and `wheel`, from 1."""
    return robot.wheel_places.index((effect.castor, effect.wheel))


def counter_of(robot: RobotDescription, effect: Any) -> int:
    """Return the column of wheel counts of the wheel that an effect is on; raises InputError for an idle wheel."""
    return robot.driven_wheels.index(wheel_channel(robot, effect.castor, effect.wheel, type(effect).__name__))


def place_at_random(robot: RobotDescription, random: np.random.Generator) -> dict[str, int]:
    """Return a random castor and one of its wheels, from 1."""
    castor = int(random.integers(len(robot.castors))) + 1
    return {"castor": castor, "wheel": int(random.integers(len(robot.castors[castor - 1].wheels))) + 1}
