"""How a log may have to be read: channels exchanged, reversed, scaled or shifted.

Channels: the wheels with an encoder, then the castors with a pivot encoder, in the order of the log's columns.
"""

import dataclasses
from dataclasses import dataclass

from castor_envs.effects.dimensions import PivotBias
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
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

    def referred(self, lengths: float = 1.0, headings: float = 1.0, across: float = 1.0) -> "Reading":
        """Return the reading with positions, headings and y of the reference multiplied."""
        return dataclasses.replace(
            self,
            lengths=self.lengths * lengths,
            headings=self.headings * headings,
            across=self.across * across,
        )


class Channels:
    """The channels of a robot: where each castor's wheels and pivot are."""

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        driven = list(robot.driven_wheels)
        self.count = len(driven) + len(robot.pivot_encoders)
        self.wheels = tuple(range(len(driven)))
        self.pivots = tuple(range(len(driven), self.count))
        self._wheel: dict[tuple[int, int], int] = {}
        numbers: dict[int, int] = {}
        for k, i in enumerate(robot.wheel_castors):
            numbers[i] = numbers.get(i, 0) + 1
            if k in driven:
                self._wheel[i + 1, numbers[i]] = driven.index(k)
        self._pivot = {i + 1: len(driven) + j for j, i in enumerate(robot.pivot_encoders)}

    def nominal(self) -> Reading:
        """Return the reading in which the log agrees with the description."""
        return Reading(tuple(range(self.count)), (1.0,) * self.count, (0.0,) * self.count)

    def of_castor(self, castor: int) -> tuple[int, ...]:
        """Return the channels of the wheels of castor `castor` (from 1)."""
        return tuple(channel for (i, _), channel in self._wheel.items() if i == castor)

    def pivot_of(self, castor: int) -> tuple[int, ...]:
        """Return the channel of the pivot of castor `castor`, none where there is no encoder."""
        return (self._pivot[castor],) if castor in self._pivot else ()

    def has(self, castor: int, wheel: int) -> bool:
        """Whether a wheel (both from 1) has an encoder."""
        return (castor, wheel) in self._wheel

    def at(self, castor: int, wheel: int | None) -> int:
        """Return the channel of a wheel (from 1), or of the pivot where wheel is None."""
        return self._pivot[castor] if wheel is None else self._wheel[castor, wheel]

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
                    (*self.of_castor(castor), *self.pivot_of(castor))
                    for castor in (effect.castor, effect.exchanged_with)
                )
                return reading.exchanged(first, second)
            case PivotBias():
                return reading.shifted(self.pivot_of(effect.castor), effect.value)
            case _:
                raise ValueError(f"{effect.name} is no effect of wiring")
