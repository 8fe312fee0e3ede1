"""Effects of a train's relative posture sensors: what a real sensor does that its description leaves out.

An effect stands in the train file as ``{"name": "gauge_gain", "frame": 1, "value": 0.05}``. Frames are counted from 1
at the front (A), gauges from 1 at the frame's rear. To add an effect, add a class to this module and to `TrainEffect`.
"""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG, NotNegative
from castor_envs.errors import InputError

if TYPE_CHECKING:
    from castor_envs.train import Frame, TrainDescription

Number = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GaugeNoise:
    """Readings of a frame's gauges carry `value` (1/m, standard deviation) of white noise beyond what is described."""

    frame: Number
    value: Annotated[float, Field(ge=0, le=10)]
    name: Literal["gauge_noise"] = "gauge_noise"

    def apply(self, train: "TrainDescription") -> "TrainDescription":
        """Return the train with this noise added to the frame's own, in the sum of squares."""
        noise = (frame_of(train, self.frame, self.name).gauge_noise ** 2 + self.value**2) ** 0.5
        return with_frame(train, self.frame, gauge_noise=noise)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GaugeGain:
    """Readings of a gauge, or of all gauges of a frame (`gauge` left out), are larger by the fraction `value`."""

    frame: Number
    gauge: Number | None = None
    value: Annotated[float, Field(ge=-0.5, le=0.5)]
    name: Literal["gauge_gain"] = "gauge_gain"

    def apply(self, train: "TrainDescription") -> "TrainDescription":
        """Return the train with these gauges' gains scaled by 1 + value."""
        frame = frame_of(train, self.frame, self.name)
        gains = list(frame.gauge_gains or [1.0] * len(frame.gauge_positions))
        for k in range(len(gains)) if self.gauge is None else [gauge_of(frame, self.gauge, self.name) - 1]:
            gains[k] *= 1.0 + self.value
        return with_frame(train, self.frame, gauge_gains=tuple(gains))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GaugeDrift:
    """The zero of a frame's gauges drifts by `value` (1/m) a second."""

    frame: Number
    value: Annotated[float, Field(ge=-1, le=1)]
    name: Literal["gauge_drift"] = "gauge_drift"

    def apply(self, train: "TrainDescription") -> "TrainDescription":
        """Return the train with this drift added to the frame's."""
        drift = frame_of(train, self.frame, self.name).gauge_drift + self.value
        return with_frame(train, self.frame, gauge_drift=drift)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DeadGauge:
    """A gauge reads 0, whatever the frame does."""

    frame: Number
    gauge: Number
    name: Literal["dead_gauge"] = "dead_gauge"

    def apply(self, train: "TrainDescription") -> "TrainDescription":
        """Return the train with this gauge dead."""
        frame = frame_of(train, self.frame, self.name)
        dead = tuple(sorted({*frame.dead_gauges, gauge_of(frame, self.gauge, self.name)}))
        return with_frame(train, self.frame, dead_gauges=dead)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SensorStops:
    """A frame's relative posture sensor repeats its last reading after `value` seconds; its age tells."""

    frame: Number
    value: NotNegative
    name: Literal["sensor_stops"] = "sensor_stops"

    def apply(self, train: "TrainDescription") -> "TrainDescription":
        """Return the train whose sensor stops then, or when it stopped before."""
        before = frame_of(train, self.frame, self.name).rps_stops
        return with_frame(train, self.frame, rps_stops=self.value if before is None else min(before, self.value))


TrainEffect = Annotated[
    GaugeNoise | GaugeGain | GaugeDrift | DeadGauge | SensorStops,
    Field(discriminator="name"),
]


def frame_of(train: "TrainDescription", number: int, effect: str) -> "Frame":
    """Return frame `number` (from 1); raises InputError where the train has no such frame."""
    if number > len(train.frames):
        raise InputError(f"effect {effect}: train {train.name!r} has no frame {number}")
    return train.frames[number - 1]


def gauge_of(frame: "Frame", number: int, effect: str) -> int:
    """Return a gauge's number (from 1); raises InputError where the frame has no such gauge."""
    if number > len(frame.gauge_positions):
        raise InputError(f"effect {effect}: the frame has no gauge {number}, it has {len(frame.gauge_positions)}")
    return number


def with_frame(train: "TrainDescription", number: int, **changes: object) -> "TrainDescription":
    """Return the train with some fields of frame `number` (from 1) replaced."""
    frames = list(train.frames)
    frames[number - 1] = dataclasses.replace(frames[number - 1], **changes)
    return dataclasses.replace(train, frames=tuple(frames))


def apply_train_effects(
    train: "TrainDescription", effects: tuple[GaugeNoise | GaugeGain | GaugeDrift | DeadGauge | SensorStops, ...]
) -> "TrainDescription":
    """Apply effects in order."""
    for effect in effects:
        train = effect.apply(train)
    return train
