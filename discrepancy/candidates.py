"""What may be missing in a robot's description: the effects of the catalogue, and rivals without a name.

Each candidate has a signature: what it changes in a log for a unit of it, at what truly happened as the log tells it
(smoothed: the differences of single counts would make one effect look like another).
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects import Effect, catalogue, readings
from castor_envs.errors import InputError
from castor_envs.kinematics import Array, Geometry
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription

BLOCKS = 4
"""Parts of equal length that a log is cut into for rivals that come and go."""

SOUGHT_OTHERWISE = frozenset(
    (
        "clock_offset",
        "clock_skew",
        "all_latency",
        "sample_jitter",
        "encoders_swapped",
        "encoder_reversed",
        "castor_order",
    )
)
"""The reference's clock (all encoders late is the same) is found beside everything else; wrong wiring is no small
change; jitter has no mean."""


@dataclass(frozen=True)
class Candidate:
    """A possible cause. effect: of the catalogue, in the size of its step; None: a rival without a name, as `what`."""

    what: str
    effect: Effect | None = None

    @property
    def family(self) -> str:
        """The same for all that no log can tell apart: the name to report, and where on the robot."""
        if self.effect is None:
            return self.what
        name = self.effect.same_as[0] if self.effect.same_as else self.effect.name
        return " ".join([name, *(str(value) for key, value in place_of(self.effect).items() if key != "phase")])


def place_of(effect: Effect) -> dict[str, object]:
    """Return the fields of an effect that say where it is: all but its name and amplitude."""
    return {f.name: getattr(effect, f.name) for f in fields(effect) if f.name not in ("name", "value")}


@dataclass(frozen=True, eq=False)
class Signatures:
    """The signatures of P candidates in one log: of the first G `geometries`, changed by `steps` (G,), of the others
    `readings` (K, s + d, P - G), counts for a unit."""

    candidates: tuple[Candidate, ...]
    geometries: tuple[Geometry, ...]
    steps: Array
    readings: Array


class _Channels:
    """The pivot and wheel encoders of a robot, in the order of a state's counts."""

    def __init__(self, robot: RobotDescription) -> None:
        self.geometry = Geometry.of(robot.as_built())
        self.sensed: NDArray[np.intp] = np.flatnonzero(~np.isnan(self.geometry.pivot_counts_per_rev))
        self.driven: NDArray[np.intp] = np.flatnonzero(~np.isnan(self.geometry.counts_per_rev))
        self.names = [f"pivot_{i + 1}" for i in self.sensed] + [f"wheel_{robot.wheel_names[k]}" for k in self.driven]
        pivots = self.geometry.pivot_counts_per_rev[self.sensed]
        self.per_rev = np.concatenate([pivots, self.geometry.counts_per_rev[self.driven]])

    def read(self, robot: RobotDescription, log: Log, counts: Array) -> Array:
        """Return what the robot's encoders read (K, s + d), not rounded, of true counts."""
        geometry, s, rows = self.geometry, len(self.sensed), len(counts)
        angles = counts * 2 * np.pi / self.per_rev
        wheel = np.zeros((rows, len(geometry.radius)))
        castor = np.tile(np.where(geometry.fixed, geometry.angle, 0.0), (rows, 1))
        castor[:, self.sensed] = angles[:, :s] - geometry.pivot_zero[self.sensed]
        turns = 2 * np.pi * np.round(castor[0] / (2 * np.pi))  # a log begins within half a turn of 0
        castor -= turns
        wheel[:, self.driven] = angles[:, s:]
        wheel, castor = readings(robot, log.t, wheel, castor)
        seen = np.column_stack(
            [(castor + turns)[:, self.sensed] + geometry.pivot_zero[self.sensed], wheel[:, self.driven]]
        )
        return seen * self.per_rev / (2 * np.pi)


def signatures_of(robot: RobotDescription, log: Log, state: Array) -> Signatures:
    """Return the signatures of all candidates beyond the robot's own effects, at a state (K, 3 + s + d)."""
    channels = _Channels(robot)
    counts = state[:, 3 : 3 + len(channels.names)]
    plain = channels.read(robot, log, counts)
    built: list[tuple[Candidate, Geometry, float]] = []
    read: list[tuple[Candidate, Array]] = []
    for effect in catalogue(robot.as_described()):
        if effect.name in SOUGHT_OTHERWISE:
            continue
        candidate = Candidate(_described(effect), effect)
        try:
            changed = robot.with_effects(effect)
            geometry = Geometry.of(changed.as_built())
        except InputError:
            continue
        if _differ(channels.geometry, geometry):
            built.append((candidate, geometry, effect.value))
        else:
            more = (channels.read(changed, log, counts) - plain) / effect.value
            if np.any(more):
                read.append((candidate, more))
    read += _rivals(channels, log, counts)
    return Signatures(
        (*(one for one, _, _ in built), *(one for one, _ in read)),
        tuple(geometry for _, geometry, _ in built),
        np.array([step for _, _, step in built]),
        np.stack([more for _, more in read], axis=-1),
    )


def correction_of(robot: RobotDescription, log: Log, state: Array) -> Array:
    """Return how many counts more (K, s + d) the robot's effects on sensors make of a state than it holds."""
    channels = _Channels(robot)
    counts = state[:, 3 : 3 + len(channels.names)]
    return channels.read(robot, log, counts) - counts


def _described(effect: Effect) -> str:
    place = place_of(effect)
    where = [f"{key} {value}" for key, value in place.items() if key in ("castor", "wheel") and value is not None]
    return ", ".join([effect.title, *where])


def _differ(one: Geometry, other: Geometry) -> bool:
    names = ("pivot", "offset", "pivot_zero", "angle", "lateral", "radius", "roller")
    return any(not np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def _rivals(channels: _Channels, log: Log, counts: Array) -> Iterator[tuple[Candidate, Array]]:
    """Yield rivals without a name: of one channel at a time, what comes and goes, jumps, repeats, or grows."""
    edges = np.linspace(0, len(counts), BLOCKS + 1).astype(int).tolist()
    speed = np.gradient(counts, log.t, axis=0)
    every = np.arange(len(counts))
    for c, name in enumerate(channels.names):

        def alone(what: str, values: Array, c: int = c, name: str = name) -> tuple[Candidate, Array]:
            more = np.zeros_like(counts)
            more[:, c] = values - values[0]
            return Candidate(f"{name} {what}"), more

        own, angle = counts[:, c], counts[:, c] * 2 * np.pi / channels.per_rev[c]
        for first, last in itertools.pairwise(edges):
            span = f"from {log.t[first]:.0f} to {log.t[last - 1]:.0f} s"
            yield alone(f"reads in proportion too much {span}", own[np.clip(every, first, last - 1)])
            if first:
                yield alone(f"jumps at {log.t[first]:.0f} s", (every >= first) * 1.0)
        for times in (2, 3):
            for shape in (np.sin, np.cos):
                yield alone(f"repeats {times} times a turn ({shape.__name__})", shape(times * angle))
        yield alone("reads too much with speed", np.cumsum(speed[:, c] * np.abs(speed[:, c]) * np.gradient(log.t)))
        yield alone("drifts with time", log.t - log.t[0])
