"""How a log may have to be read: channels exchanged, reversed, scaled or shifted.

Channels: the wheels with an encoder, then the castors with a pivot encoder, in the order of the log's columns.
"""

import dataclasses
from dataclasses import dataclass

from castor_envs.effects.dimensions import PivotBias
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.logs.columns import LogColumns
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True)
class Reading:
    """How a log was read.

    source: for each channel the channel whose angle it shows. gain: factor on its counts, below 0 where it is reversed.
    shift: excess of its reading, rad, of pivots alone. lengths, headings, across: factors on the reference's positions,
    on its headings and, in addition, on y.
    """

    source: tuple[int, ...]
    gain: tuple[float, ...]
    shift: tuple[float, ...]
    lengths: float = 1.0
    headings: float = 1.0
    across: float = 1.0

    def exchanged(self, first: tuple[int, ...], second: tuple[int, ...]) -> "Reading":
        """Return the reading with two groups of channels exchanged."""
        place = list(range(len(self.source)))
        for a, b in zip(first, second, strict=True):
            place[a], place[b] = b, a
        source, gain, shift = (tuple(values[k] for k in place) for values in (self.source, self.gain, self.shift))
        return dataclasses.replace(self, source=source, gain=gain, shift=shift)

    def scaled(self, channels: tuple[int, ...], by: float) -> "Reading":
        """Return the reading with the counts of these channels multiplied."""
        return dataclasses.replace(self, gain=tuple(g * by if k in channels else g for k, g in enumerate(self.gain)))

    def shifted(self, channels: tuple[int, ...], by: float) -> "Reading":
        """Return the reading with these pivots turned by an angle."""
        return dataclasses.replace(self, shift=tuple(s + by if k in channels else s for k, s in enumerate(self.shift)))


class Channels:
    """The channels of a robot. wheels, pivots: their numbers. names: of their columns. wheel_at: the channel of each
    wheel by its castor and number; pivot_of: of each pivot by its castor; both from 1. castor: that of each channel."""

    def __init__(self, robot: RobotDescription) -> None:
        columns, driven = LogColumns.of(robot), list(robot.driven_wheels)
        self.names = (*columns.wheel, *columns.pivot)
        self.wheels = tuple(range(len(driven)))
        self.pivots = tuple(range(len(driven), len(self.names)))
        places = [(i, j) for i, castor in enumerate(robot.castors, 1) for j in range(1, len(castor.wheels) + 1)]
        self.wheel_at = {place: driven.index(k) for k, place in enumerate(places) if k in driven}
        self.pivot_of = {i + 1: channel for i, channel in zip(robot.pivot_encoders, self.pivots, strict=True)}
        self.castor = (*(i for i, _ in self.wheel_at), *self.pivot_of)

    def nominal(self) -> Reading:
        """Return the reading in which the log agrees with the description."""
        n = len(self.names)
        return Reading(tuple(range(n)), (1.0,) * n, (0.0,) * n)

    def of_castor(self, castor: int) -> tuple[int, ...]:
        """Return the channels of the wheels of castor `castor` (from 1)."""
        return tuple(k for k in self.wheels if self.castor[k] == castor)

    def at(self, castor: int, wheel: int | None) -> int:
        """Return the channel of a wheel (from 1), or of the pivot where wheel is None."""
        return self.pivot_of[castor] if wheel is None else self.wheel_at[castor, wheel]

    def read(self, reading: Reading, effect: Effect) -> Reading:
        """Return the reading after an effect of wiring, or a turned pivot; raises ValueError for other effects."""
        match effect:
            case EncodersSwapped():
                left, right = self.of_castor(effect.castor)
                return reading.exchanged((left,), (right,))
            case EncoderReversed():
                return reading.scaled((self.at(effect.castor, effect.wheel),), -1.0)
            case CastorOrder():
                first, second = (
                    tuple(k for k, of in enumerate(self.castor) if of == castor)
                    for castor in (effect.castor, effect.exchanged_with)
                )
                return reading.exchanged(first, second)
            case PivotBias():
                return reading.shifted((self.pivot_of[effect.castor],), effect.value)
            case _:
                raise ValueError(f"{effect.name} is no effect of wiring")
