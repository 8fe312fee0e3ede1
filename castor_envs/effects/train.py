"""Effects of a train: what a real one does that its description leaves out. Each is one class, with one meaning.

An effect stands in the train file as ``{"name": "gauge_gain", "frame": 1, "value": 0.05}``. Frames are counted from 1
at the front (A), gauges from 1 at the frame's rear, axles from 1 at the front. Effects on a single axle module, such as
on its track and wheels, are effects of that robot and stand in its module.
"""

import dataclasses
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG, DurationOrNone
from castor_envs.errors import InputError
from castor_envs.vehicles.effect import Effect, Number, ThereOrNot
from castor_envs.vehicles.train import Frame, TrainDescription


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GaugeNoise(Effect[TrainDescription]):
    """Readings of a frame's gauges carry `value` (1/m, standard deviation) of white noise beyond what is described."""

    frame: Number
    value: Annotated[float, Field(ge=0, le=10)]
    name: Literal["gauge_noise"] = "gauge_noise"
    title = "noise of the gauges"
    unit = "1/m"
    step = 0.01
    tolerance = 1e-3  # 1/m: beside what gauges are described to have
    check = "Log the standing train; look for loose wires and for motors near the gauges' cables."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["GaugeNoise", ...]:
        """Return an instance for each frame."""
        return tuple(cls(frame=f, value=cls.step) for f in _frames(train))

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with this noise added to the frame's own, in the sum of squares."""
        noise = (frame_of(train, self.frame, self.name).gauge_noise ** 2 + self.value**2) ** 0.5
        return with_frame(train, self.frame, gauge_noise=noise)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GaugeGain(Effect[TrainDescription]):
    """Readings of a gauge, or of all gauges of a frame (`gauge` left out), are larger by the fraction `value`."""

    frame: Number
    gauge: Number | None = None
    value: Annotated[float, Field(ge=-0.5, le=0.5)]
    name: Literal["gauge_gain"] = "gauge_gain"
    title = "gain of gauges"
    unit = "1"
    step = 1e-3
    tolerance = 5e-3  # relative: makers state gauge factors to 0.5 to 1 %
    check = "Bend the frame along a template of known radius and read the gauges; check amplifier settings and glue."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["GaugeGain", ...]:
        """Return an instance for each frame's gauges together, and one for each gauge of frames with more than one."""
        return tuple(
            cls(frame=f, gauge=gauge, value=cls.step)
            for f in _frames(train)
            for gauge in (None, *(_gauges(train, f) if len(_gauges(train, f)) > 1 else ()))
        )

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with these gauges' gains scaled by 1 + value."""
        frame = frame_of(train, self.frame, self.name)
        gains = list(frame.gauge_gains or [1.0] * len(frame.gauge_positions))
        for k in range(len(gains)) if self.gauge is None else [gauge_of(frame, self.gauge, self.name) - 1]:
            gains[k] *= 1.0 + self.value
        return with_frame(train, self.frame, gauge_gains=tuple(gains))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GaugeDrift(Effect[TrainDescription]):
    """The zero of a frame's gauges drifts by `value` (1/m) a second."""

    frame: Number
    value: Annotated[float, Field(ge=-1, le=1)]
    name: Literal["gauge_drift"] = "gauge_drift"
    title = "zero drift of the gauges"
    unit = "1/m/s"
    step = 1e-4
    tolerance = 1e-5  # 1/m/s
    check = "Log the standing train for some minutes after switching it on; look for what warms the frame on one side."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["GaugeDrift", ...]:
        """Return an instance for each frame."""
        return tuple(cls(frame=f, value=cls.step) for f in _frames(train))

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with this drift added to the frame's."""
        drift = frame_of(train, self.frame, self.name).gauge_drift + self.value
        return with_frame(train, self.frame, gauge_drift=drift)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class DeadGauge(Effect[TrainDescription]):
    """A gauge reads 0, whatever the frame does."""

    frame: Number
    gauge: Number
    value: ThereOrNot = 1.0
    name: Literal["dead_gauge"] = "dead_gauge"
    title = "dead gauge"
    unit = "1"
    step = 1.0
    tolerance = 3e-3  # present or absent
    binary = True
    check = "Bend the frame by hand and look at this gauge's reading; check its wires, bridge and amplifier."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["DeadGauge", ...]:
        """Return an instance for each gauge that is not known to be dead."""
        built = train.as_built()
        return tuple(
            cls(frame=f, gauge=gauge)
            for f in _frames(train)
            for gauge in _gauges(train, f)
            if gauge not in built.frames[f - 1].dead_gauges
        )

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with this gauge dead."""
        frame = frame_of(train, self.frame, self.name)
        dead = tuple(sorted({*frame.dead_gauges, gauge_of(frame, self.gauge, self.name)}))
        return with_frame(train, self.frame, dead_gauges=dead)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ForeshorteningLeftOut(Effect[TrainDescription]):
    """A frame's posture leaves out the share `value` of how much the bent frame is shortened: x is too long."""

    frame: Number
    value: Annotated[float, Field(ge=0, le=1)] = 1.0
    name: Literal["foreshortening_left_out"] = "foreshortening_left_out"
    title = "foreshortening left out"
    unit = "1"
    step = 1e-3
    tolerance = 1e-3  # relative
    check = "Look how the sensor's program gets x from curvature: the integral of cos, or just the frame's length?"

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["ForeshorteningLeftOut", ...]:
        """Return an instance for each frame."""
        return tuple(cls(frame=f, value=cls.step) for f in _frames(train))

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with this share of the shortening left out of what is still computed."""
        left = 1.0 - frame_of(train, self.frame, self.name).foreshortening_left_out
        return with_frame(train, self.frame, foreshortening_left_out=1.0 - left * (1.0 - self.value))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class FrameLength(Effect[TrainDescription]):
    """A frame is longer by `value` (m) than its posture sensor knows; gauges stay where they are from the rear axle."""

    frame: Number
    value: Annotated[float, Field(ge=-1, le=1)]
    name: Literal["frame_length"] = "frame_length"
    title = "length of a frame"
    unit = "m"
    step = 1e-4
    tolerance = 2e-4  # m: as frames are cut and clamped
    check = "Measure the straight frame from axle to axle; look whether it has slipped in its clamps."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["FrameLength", ...]:
        """Return an instance for each frame."""
        return tuple(cls(frame=f, value=cls.step) for f in _frames(train))

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with this frame longer, its sensor as it was; raises InputError where no frame is left, or
        none under a gauge."""
        frame = frame_of(train, self.frame, self.name)
        length, gauges = frame.length + self.value, frame.gauge_positions
        if length < max(gauges[-1], 1e-3):
            raise InputError(
                f"effect {self.name}: frame {self.frame} of train {train.name!r} would be {length:.4g} m long; "
                f"its last gauge is {gauges[-1]:.4g} m from the rear axle"
            )
        return with_frame(train, self.frame, length=length, gauges=gauges, rps_length=frame.computed_length)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SensorStops(Effect[TrainDescription]):
    """From `value` seconds after its start, a frame's relative posture sensor repeats its last reading, which ages.

    The value is a time: at 0 the sensor never takes a second reading, and late ones change nothing.
    """

    frame: Number
    value: DurationOrNone
    name: Literal["sensor_stops"] = "sensor_stops"
    title = "posture sensor stops"
    unit = "s"
    step = 1.0
    tolerance = 1.0  # s: present or absent
    check = "Look at the sensor's supply and its connection at that time."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["SensorStops", ...]:
        """Return an instance for each frame."""
        return tuple(cls(frame=f, value=cls.step) for f in _frames(train))

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train whose sensor stops at that time, or earlier where it already stopped earlier."""
        before = frame_of(train, self.frame, self.name).rps_stops
        return with_frame(train, self.frame, rps_stops=self.value if before is None else min(before, self.value))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class AxleSlip(Effect[TrainDescription]):
    """Wheels of one axle slip more under the forces that they carry, along and across, by the fraction `value`."""

    axle: Number
    value: Annotated[float, Field(ge=-0.9, le=1000)]
    name: Literal["axle_slip"] = "axle_slip"
    title = "slip under one axle"
    unit = "1"
    step = 0.1
    tolerance = 0.1  # tyres are measured no better
    check = "Look for dirt or wear on this axle's treads, for low load on it, and for what lies on the floor there."

    @classmethod
    def variants(cls, train: TrainDescription) -> tuple["AxleSlip", ...]:
        """Return an instance for each axle."""
        return tuple(cls(axle=i, value=cls.step) for i in range(1, train.n_axles + 1))

    def apply(self, train: TrainDescription) -> TrainDescription:
        """Return the train with both slip stiffnesses of this module's contact divided by 1 + value."""
        if self.axle > train.n_axles:
            raise InputError(f"effect {self.name}: train {train.name!r} has no axle {self.axle}")
        modules = list(train.modules)
        contact = modules[self.axle - 1].contact
        softer = dataclasses.replace(
            contact,
            slip_stiffness_long=contact.slip_stiffness_long / (1.0 + self.value),
            slip_stiffness_lat=contact.slip_stiffness_lat / (1.0 + self.value),
        )
        modules[self.axle - 1] = dataclasses.replace(modules[self.axle - 1], contact=softer)
        return dataclasses.replace(train, modules=tuple(modules))


def frame_of(train: TrainDescription, number: int, effect: str) -> Frame:
    """Return frame `number` (from 1); raises InputError where the train has no such frame."""
    if number > len(train.frames):
        raise InputError(f"effect {effect}: train {train.name!r} has no frame {number}")
    return train.frames[number - 1]


def gauge_of(frame: Frame, number: int, effect: str) -> int:
    """Return a gauge's number (from 1); raises InputError where the frame has no such gauge."""
    if number > len(frame.gauge_positions):
        raise InputError(f"effect {effect}: the frame has no gauge {number}, it has {len(frame.gauge_positions)}")
    return number


def with_frame(train: TrainDescription, number: int, **changes: object) -> TrainDescription:
    """Return the train with some fields of frame `number` (from 1) replaced."""
    frames = list(train.frames)
    frames[number - 1] = dataclasses.replace(frames[number - 1], **changes)
    return dataclasses.replace(train, frames=tuple(frames))


def _frames(train: TrainDescription) -> range:
    return range(1, len(train.frames) + 1)


def _gauges(train: TrainDescription, frame: int) -> range:
    return range(1, len(train.frames[frame - 1].gauge_positions) + 1)
