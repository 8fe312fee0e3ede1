"""Candidates: effects that a train's description may be missing, and unnamed alternatives."""

import dataclasses
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.effects.dimensions import AllWheelRadius, Track, WheelRadius
from castor_envs.effects.train import AxleSlip, DeadGauge, ForeshorteningLeftOut, FrameLength, GaugeDrift, GaugeGain
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.train import TrainDescription
from discrepancy.hypotheses.candidates import place_of
from discrepancy.posterior.linearise import COUNTS, SLIP
from estimators.likelihood.trains.rows import ROUGH, TrainLog
from estimators.likelihood.trains.states import Term

OF_TRAINS = (GaugeGain, GaugeDrift, ForeshorteningLeftOut, FrameLength, AxleSlip)
OF_AXLES = (Track, WheelRadius, AllWheelRadius)

BLOCKS = 8
"""Number of equal parts of a log in which unnamed alternatives are tried."""


PARTS = ("x", "y", "heading")


@dataclass(frozen=True)
class Candidate:
    """A candidate: an effect (`kind`), or an unnamed alternative (`term`). what: in words.

    family: name of the answer, for unnamed alternatives the same at any time of the log. alike: what the cause does,
    whichever wheel, axle or frame it is of, as such causes scatter alike among trains in good order. axle: that (from
    1) whose module has the effect; None for effects of the train. usual: size of an unnamed alternative in a train in
    good order.
    """

    what: str
    family: str
    alike: str
    kind: Effect | None = None
    axle: int | None = None
    term: Term | None = field(default=None, compare=False)
    usual: float = field(default=math.nan, compare=False)
    columns = 1

    @classmethod
    def of(cls, effect: Effect, train: TrainDescription, axle: int | None = None) -> "Candidate":
        """Return the candidate of an effect."""
        place, frame, gauge = "", getattr(effect, "frame", None), getattr(effect, "gauge", None)
        if frame is not None:
            place = f"frame {train.frame_names[frame - 1]}"
        if gauge is not None:
            place = f"gauge {gauge} of {place}"
        if axle is not None or isinstance(effect, AxleSlip):
            place, wheel = f"axle {axle or getattr(effect, 'axle', 0)}", getattr(effect, "wheel", None)
            place = place if wheel is None else f"{'left' if wheel == 1 else 'right'} wheel of {place}"
        what = f"{effect.title}, {place}"
        return cls(what, what, effect.name, effect, axle)

    @property
    def kinds(self) -> tuple[Effect, ...]:
        """The effect; empty for an unnamed alternative."""
        return () if self.kind is None else (self.kind,)

    @property
    def when(self) -> str:
        """The end of `what` that tells a time in one of the logs; empty for causes that other logs may have."""
        return self.what.removeprefix(self.family)

    def restored(self, change: float) -> tuple[int, int] | None:
        """Return the frame and the gauge, from 1, that work again if this effect (a dead gauge) is removed; None for
        other effects."""
        return (self.kind.frame, self.kind.gauge) if isinstance(self.kind, DeadGauge) and change < 0 else None

    def effect(self, amplitudes: Sequence[float] | Array) -> Effect:
        """Return the effect of this amplitude (1,), wherever it is; raises ValueError if it cannot have it."""
        (kind,) = self.kinds
        return kind if kind.binary else dataclasses.replace(kind, value=float(amplitudes[0]))

    def added(self, train: TrainDescription, amplitudes: Sequence[float] | Array) -> TrainDescription:
        """Return the train with the effect of this amplitude (1,) added."""
        return self._with(train, (*self._effects(train), self.effect(amplitudes)))

    def enlarged(self, train: TrainDescription) -> tuple[TrainDescription, float]:
        """Return the train with a little more of this effect, and the change of its amplitude.

        In a train that has the effect its amplitude grows by a step, or shrinks where it cannot grow; a binary effect
        is removed. Other trains get the effect in the size of its step.
        """
        (kind,), effects = self.kinds, self._effects(train)
        for k, effect in enumerate(effects):
            if type(effect) is type(kind) and place_of(effect) == place_of(kind):
                if effect.binary:
                    return self._with(train, (*effects[:k], *effects[k + 1 :])), -kind.step
                for change in (kind.step, -kind.step):
                    with suppress(ValueError):
                        larger = dataclasses.replace(effect, value=effect.value + change)
                        return self._with(train, (*effects[:k], larger, *effects[k + 1 :])), change
        return self.added(train, [kind.step]), kind.step

    def _effects(self, train: TrainDescription) -> tuple[Effect, ...]:
        return train.effects if self.axle is None else train.modules[self.axle - 1].effects

    def _with(self, train: TrainDescription, effects: tuple[Effect, ...]) -> TrainDescription:
        """Return the train, or the train with this effect's module, with other effects."""
        if self.axle is None:
            return dataclasses.replace(train, effects=effects)
        modules = list(train.modules)
        modules[self.axle - 1] = dataclasses.replace(modules[self.axle - 1], effects=effects)
        return dataclasses.replace(train, modules=tuple(modules))


def named_candidates(train: TrainDescription) -> list[Candidate]:
    """Return every effect that the train may have and that changes the mean of readings, each in the size of its
    step."""
    found = [Candidate.of(effect, train) for kind in OF_TRAINS for effect in kind.variants(train)]
    for i, module in enumerate(train.modules, start=1):
        found += [Candidate.of(effect, train, i) for kind in OF_AXLES for effect in kind.variants(module)]
    gone = {(f, gauge) for f, frame in enumerate(train.as_built().frames, start=1) for gauge in frame.dead_gauges}
    place = [(getattr(candidate.kind, "frame", 0), getattr(candidate.kind, "gauge", None)) for candidate in found]
    return [candidate for candidate, at in zip(found, place, strict=True) if at not in gone]


def dead_gauges(train: TrainDescription) -> list[Candidate]:
    """Return every gauge that may be dead."""
    return [Candidate.of(effect, train) for effect in DeadGauge.variants(train)]


def rivals(train: TrainDescription, log: TrainLog, number: int) -> list[Candidate]:
    """Return unnamed alternatives in a log, `number` from 0.

    An error of a wheel's counts in proportion to its speed is not among them: it could not be distinguished from its
    radius.
    """
    found: list[Candidate] = []
    t, name = log.t, f"log {number + 1}"
    edges = np.linspace(0.0, t[-1], BLOCKS + 1)
    way = np.sqrt(np.mean(log.signed_travel**2))

    def add(
        family: str, alike: str, time: str, kind: str, width: int, at: int | slice, course: Array, usual: ArrayLike
    ) -> None:
        change = np.zeros((len(course), width))
        change[:, at] = -course
        if kind.startswith("gauges"):
            change *= log.read[:, int(kind.removeprefix("gauges")), None]
        shown = np.sqrt(np.mean(change**2, axis=0))
        if shown.any():
            size = float(np.min(np.broadcast_to(usual, width)[shown > 0] / shown[shown > 0]))
            found.append(Candidate(f"{family} {time}", family, alike, term=Term(number, kind, change), usual=size))

    def count(w: int, how: str, when: str, course: Array) -> None:
        alike = f"counts otherwise{how}"
        add(f"wheel {train.wheel_names[w]} {alike}", alike, when, "counts", 2 * log.n, w, course, COUNTS)

    def read(f: int, j: int, how: str, when: str, course: Array) -> None:
        part, usual = PARTS[j], ROUGH[j]
        name = f"{part} of frame {train.frame_names[f]}'s sensor {how}"
        add(name, f"{part} {how}", when, f"gauges{f}", 3, j, course, usual)

    wheels, sensors = range(2 * log.n), [(f, j) for f in range(log.f) for j in range(len(PARTS))]
    for b in range(BLOCKS):
        inside = ((t >= edges[b]) & (t < edges[b + 1] + (b == BLOCKS - 1))).astype(float)
        since = (t >= edges[b]).astype(float)
        ramp = np.clip((t - edges[b]) / (edges[b + 1] - edges[b]), 0.0, 1.0)
        span, at = f"from {edges[b]:.1f} to {edges[b + 1]:.1f} s of {name}", f"at {edges[b]:.1f} s of {name}"
        for w in wheels:
            count(w, "", span, ramp)
        for i in range(log.n):
            aside = "slips to its side"
            add(f"axle {i + 1} {aside}", aside, span, "side", log.n, i, np.diff(ramp), SLIP * way)
        for sensor in sensors:
            read(*sensor, "is off", span, inside)
            if b:
                read(*sensor, "jumps", at, since)
    for sensor in sensors:
        read(*sensor, "drifts", f"in {name}", t - t.mean())
    for f, frame in enumerate(train.frame_names):
        if log.read[:, f].any():
            rate, late = np.gradient(log.smoothed(train.as_built(), f), t, axis=0), "reads late"
            sensor_late = f"frame {frame}'s sensor {late}"
            add(sensor_late, late, f"in {name}", f"gauges{f}", 3, slice(None), -rate, ROUGH)
    ways = np.concatenate([np.zeros((1, log.n)), np.cumsum(log.signed_travel, axis=0)])
    speed = np.abs(np.gradient(ways, t, axis=0))
    for w in wheels:
        travel = log.signed_travel[:, w // 2]
        usual_speed = speed[1:, w // 2] @ travel**2 / max(float(np.sum(travel**2)), 1e-12)
        course = np.cumsum(np.append(0.0, (speed[1:, w // 2] - usual_speed) * travel))
        count(w, " with speed", f"in {name}", course)
        count(w, " with its angle", f"(sine) in {name}", np.sin(log.turned[:, w]))
        count(w, " with its angle", f"(cosine) in {name}", np.cos(log.turned[:, w]))
    return found
