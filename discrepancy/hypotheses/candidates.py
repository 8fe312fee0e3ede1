"""What may be missing in a robot's description: the effects of the catalogue, and rivals without a name.

Each candidate has a signature: what it changes in a log for a unit of it, at what truly happened as the log tells it
(smoothed: the differences of single counts would make one effect look like another).
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.catalogue import catalogue, radii_of, readings
from castor_envs.effects.clocks import AllLatency, EncoderLatency
from castor_envs.effects.encoders import PivotEccentricity
from castor_envs.effects.floor import Bump
from castor_envs.effects.parts import channel
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion, Slip
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.contact_motion import ContactMotion, contact_paths
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription

SWEPT = np.pi
"""rad that a castor must sweep for what repeats with its angle to be told from a bias and a gain of its encoder. What
is in the model stays a candidate: with it, the castor may seem to sweep a little less."""

BLOCKS = 4
"""Parts of equal length that a log is cut into for rivals that come and go."""

ENDS = 0.05
"""Part of a log at each of its ends in which no jump is looked for: there it is a bias in all but name."""

DITHERS = (np.arange(4) - 1.5) / 4
"""Counts a sample: the signature of an effect that hangs on parts of a count is the mean over such parts."""


NEAR = 0.1
"""Part of a cable's diameter over which its derivative is taken."""

NUMBERS = ("pivot", "offset", "pivot_zero", "angle", "lateral", "radius", "roller")
"""Of a geometry, all that may differ between robots of one layout."""


@dataclass(frozen=True)
class Candidate:
    """A possible cause.

    kinds: of the catalogue, in the size of its step; two that differ by a quarter turn of `phase` are one effect of any
    phase; none: a rival without a name, as `what`. columns: amplitudes that it takes.
    """

    what: str
    kinds: tuple[Effect, ...] = ()
    columns: int = 1

    @property
    def family(self) -> str:
        """The same for all that no log can tell apart: the name to report, and where on the robot."""
        return family_of(self.kinds[0]) if self.kinds else self.what

    @property
    def at_a_place(self) -> bool:
        """Whether it is at one place on the floor."""
        return any(isinstance(kind, Bump) for kind in self.kinds)

    @property
    def sought_in_steps(self) -> bool:
        """Whether its place or time was chosen, among all steps, to suit the logs."""
        return self.at_a_place or " jumps at " in self.what

    def effect(self, amplitudes: Sequence[float] | Array) -> Effect:
        """Return the effect of some amplitudes (columns,); raises ValueError for one that cannot be."""
        kind, size = self.kinds[0], float(amplitudes[0])
        if self.kinds[0].binary:
            return kind
        if self.columns == 1:
            return dataclasses.replace(kind, value=size)
        phase = math.atan2(float(amplitudes[1]), size)
        return dataclasses.replace(kind, value=math.hypot(*amplitudes), phase=phase)

    def added(self, robot: RobotDescription, amplitudes: Sequence[float] | Array) -> RobotDescription:
        """Return the robot with the effect of these amplitudes beside its own; raises ValueError for what cannot be."""
        return robot.with_effects(self.effect(amplitudes))

    def is_of(self, effect: Effect) -> bool:
        """Whether an effect is of this kind and place, whatever its size and phase."""
        return any(
            type(kind) is type(effect) and _place_but_phase(kind) == _place_but_phase(effect) for kind in self.kinds
        )


def place_of(effect: Effect) -> dict[str, object]:
    """Return the fields of an effect that say where it is: all but its name and amplitude."""
    return {f.name: getattr(effect, f.name) for f in fields(effect) if f.name not in ("name", "value")}


def family_of(effect: Effect) -> str:
    """Return the name to report of all effects that no log can tell from this one, and where on the robot it is."""
    name = effect.indistinguishable_from[0] if effect.indistinguishable_from else effect.name
    place = (value for key, value in _place_but_phase(effect).items() if key != "above")
    places = (round(value, 2) if isinstance(value, float) else value for value in place)
    return " ".join([name, *(str(value) for value in places)])


def described(effect: Effect) -> str:
    """Return an effect and its place in words."""
    return ", ".join([effect.title, *effect.where()])


def rate_of(effects: Sequence[Effect]) -> float:
    """Return what the clock of the reference gains by effects, s/s."""
    gains = (np.diff(effect.reference_time(np.array([0.0, 1.0])))[0] - 1 for effect in effects)
    return float(np.round(sum(gains), 12))


@dataclass(frozen=True, eq=False)
class Signatures:
    """What candidates do to one log, a column each or two.

    The first G columns are of `geometries`, changed by `steps` (G,); the others of `readings` (K, s + d, R), counts
    read more for a unit, `slips`, R of them, and `rates` (R,), what the clock of the reference gains for a unit.
    places: which of the R are at a place on the floor.
    """

    candidates: tuple[Candidate, ...]
    geometries: tuple[Geometry, ...]
    steps: Array
    readings: Array
    slips: tuple[Slip, ...]
    rates: Array
    places: tuple[int, ...]


class Channels:
    """The pivot and wheel encoders of a robot, in the order of a state's counts."""

    def __init__(self, robot: RobotDescription) -> None:
        self.geometry = Geometry.of(robot.as_built())
        self.sensed: NDArray[np.intp] = np.flatnonzero(~np.isnan(self.geometry.pivot_counts_per_rev))
        self.driven: NDArray[np.intp] = np.flatnonzero(~np.isnan(self.geometry.counts_per_rev))
        self.names = [f"pivot_{i + 1}" for i in self.sensed] + [f"wheel_{robot.wheel_names[k]}" for k in self.driven]
        pivots = self.geometry.pivot_counts_per_rev[self.sensed]
        self.per_rev = np.concatenate([pivots, self.geometry.counts_per_rev[self.driven]])

    def angles(self, counts: Array) -> tuple[Array, Array]:
        """Return the angles of wheels (K, w) and castors (K, n) at counts, rad; 0 of wheels without encoder."""
        geometry, s, rows = self.geometry, len(self.sensed), len(counts)
        angles = counts * 2 * np.pi / self.per_rev
        wheel = np.zeros((rows, len(geometry.radius)))
        castor = np.tile(np.where(geometry.fixed, geometry.angle, 0.0), (rows, 1))
        castor[:, self.sensed] = angles[:, :s] - geometry.pivot_zero[self.sensed]
        wheel[:, self.driven] = angles[:, s:]
        return wheel, castor

    def motion(self, log: Log, state: Array, consistent_wheels: bool = False) -> Motion:
        """Return the motion that a state (K, 3 + s + d) tells of; consistent_wheels: as `Motion` has it."""
        wheel, castor = self.angles(state[:, 3:])
        return Motion(log.t, state[:, :3], wheel, castor, consistent_wheels)

    def read(self, robot: RobotDescription, log: Log, counts: Array) -> Array:
        """Return what a robot's encoders read (K, s + d), not rounded, of true counts: what its wheels turn more than
        those built here, as their radii differ, too."""
        geometry = self.geometry
        wheel, castor = self.angles(counts)
        turns = 2 * np.pi * np.round(castor[0] / (2 * np.pi))  # a log begins within half a turn of 0
        castor -= turns
        wheel, castor = readings(robot, log.t, self._rolled(robot, wheel, castor), castor)
        seen = np.column_stack(
            [(castor + turns)[:, self.sensed] + geometry.pivot_zero[self.sensed], wheel[:, self.driven]]
        )
        return seen * self.per_rev / (2 * np.pi)

    def unread(self, robot: RobotDescription, log: Log, seen: Array, counts: Array) -> Array:
        """Return nearer to the counts (K, s + d) of which a robot's encoders read `seen`, from counts that are near.

        What is read more than of these is put right; of an encoder that is late, that much earlier: elsewhere it would
        make quick motion worse.
        """
        excess = seen - self.read(robot, log, counts)
        for column, latency in enumerate(self._latencies(robot)):
            if latency:
                excess[:, column] = np.interp(log.t + latency, log.t, excess[:, column])
        return counts + excess

    def _latencies(self, robot: RobotDescription) -> Array:
        """Return by how much every encoder is read late (s + d,), s."""
        columns = [*(len(robot.wheels) + self.sensed), *self.driven]
        total = np.zeros(len(robot.wheels) + len(robot.castors))
        for effect in robot.effects:
            if isinstance(effect, AllLatency):
                total += effect.value
            elif isinstance(effect, EncoderLatency):
                total[channel(robot, effect.castor, effect.wheel, effect.name)] += effect.value
        return total[columns]

    def _rolled(self, robot: RobotDescription, wheel: Array, castor: Array) -> Array:
        """Return how far a robot's wheels (K, w) turn where those built here turn so far."""
        radii, mean = radii_of(robot), Geometry.of(robot.as_built()).radius
        if radii is None and np.array_equal(mean, self.geometry.radius):
            return wheel
        half_way = (castor[1:] + castor[:-1]) / 2
        turned = np.diff(wheel, axis=0) * self.geometry.radius / (mean if radii is None else radii(half_way))
        return np.concatenate([wheel[:1], wheel[:1] + np.cumsum(turned, axis=0)])


def signatures_of(
    robot: RobotDescription,
    log: Log,
    state: Array,
    wanted: Array,
    among: Sequence[Candidate] | None = None,
    of: str = "",
    places: Sequence[Candidate] = (),
) -> Signatures:
    """Return the signatures of candidates (None: all) beyond the robot's own effects, at a state (K, 3 + s + d).

    wanted: as `LogLikelihood.wanted`: it says where a channel jumps, if it does. of: which log it is, for rivals that
    have their time in it. places: more candidates, of the floor.
    """
    channels = Channels(robot)
    counts = state[:, 3 : 3 + len(channels.names)]
    plain = {0.0: channels.read(robot, log, counts)}
    rows = np.arange(len(counts))[:, None]

    def added(changed: RobotDescription, dithers: Array) -> Array:
        """Return the counts that are read more, on average."""
        total = np.zeros_like(counts)
        for dither in dithers.tolist():
            seen = counts + dither * rows
            if dither not in plain:
                plain[dither] = channels.read(robot, log, seen)
            total += channels.read(changed, log, seen) - plain[dither]
        return total / len(dithers)

    built: list[tuple[Candidate, Geometry, float]] = []
    read: list[tuple[Candidate, Array, tuple[Slip, ...]]] = []
    clocks: list[tuple[Candidate, Array, tuple[Slip, ...]]] = []
    motion = channels.motion(log, state, consistent_wheels=True)
    swept = np.ptp(motion.castor_angle, axis=0)
    no_readings, still = np.zeros((*counts.shape, 1)), Slip.none(motion)
    for candidate in [*candidates_of(robot), *places] if among is None else among:
        kind, in_robot = candidate.kinds[0], any(candidate.is_of(effect) for effect in robot.effects)
        if isinstance(kind, PivotEccentricity) and swept[kind.castor - 1] < SWEPT and not in_robot:
            continue
        if rate_of(candidate.kinds):
            clocks.append((candidate, no_readings, (still,)))
            continue
        try:
            changed = [robot.with_effects(effect) for effect in candidate.kinds]
            geometry = Geometry.of(changed[0].as_built())
        except InputError:
            continue
        if differ(channels.geometry, geometry) and kind.radius_change(robot.as_built()) is None:
            built.append((candidate, geometry, kind.value))
        else:
            dithers = DITHERS if kind.discrete else np.zeros(1)
            excess = np.stack([added(changed_robot, dithers) for changed_robot in changed], axis=-1) / kind.value
            if np.any(excess):
                read.append((candidate, excess, (still,) * candidate.columns))
            elif (slip := _slip_of(candidate, robot, motion)) is not None:
                read.append((candidate, no_readings, (slip,)))
    if among is None:
        read += [
            (candidate, excess, (still,) * candidate.columns)
            for candidate, excess in _misread(channels, log, counts, wanted, of)
        ]
        read += [
            (candidate, np.repeat(no_readings, candidate.columns, axis=-1), slips)
            for candidate, slips in _slipping(robot, motion)
        ]
    read += clocks if log.reference is not None else []
    of_columns = [candidate for candidate, _, slips in read for _ in slips]
    return Signatures(
        (*(candidate for candidate, _, _ in built), *(candidate for candidate, _, _ in read)),
        tuple(geometry for _, geometry, _ in built),
        np.array([step for _, _, step in built]),
        np.concatenate([no_readings[..., :0], *(excess for _, excess, _ in read)], axis=-1),
        tuple(slip for _, _, slips in read for slip in slips),
        np.array(
            [
                rate_of(candidate.kinds) / (candidate.kinds[0].value if candidate.kinds else 1.0)
                for candidate in of_columns
            ]
        ),
        tuple(k for k, candidate in enumerate(of_columns) if candidate.at_a_place),
    )


def _slip_of(candidate: Candidate, robot: RobotDescription, motion: Motion) -> Slip | None:
    """Return the slip of a unit of an effect; None if there is none.

    Around the size that the robot has of it: what a cable makes wheels roll more is not in proportion to its diameter.
    """
    kind = candidate.kinds[0]
    size = next((effect.value for effect in robot.effects if isinstance(effect, Bump) and candidate.is_of(effect)), 0.0)
    low, high = ((1 - NEAR) * size, (1 + NEAR) * size) if size > 0 else (0.0, kind.value)
    contacts = ContactMotion(robot.as_built(), motion)
    try:
        slip = dataclasses.replace(kind, value=high).slip(contacts)
        lower_slip = dataclasses.replace(kind, value=low).slip(contacts) if size > 0 else None
    except InputError:  # a robot that cannot stand by itself
        return None
    if slip is None or not (np.any(slip.rolling) or np.any(slip.side)):
        return None
    slip = slip if lower_slip is None else slip - lower_slip
    return Slip(slip.rolling / (high - low), slip.side / (high - low))


def candidates_of(robot: RobotDescription) -> list[Candidate]:
    """Return the effects that a robot may have, those of all phases as one.

    Of those of timing only a clock's rate: its offset (all encoders late is the same) is found beside everything else,
    and jitter has no mean. Nor wrong wiring, which is no small change. Of those that no log tells apart the first: the
    others would come and go with what else is in the robot.
    """
    found: dict[str, list[Effect]] = {}
    for effect in catalogue(robot.as_described()):
        reported, *_ = effect.indistinguishable_from or (effect.name,)
        if effect.name == reported and not effect.wiring and (not effect.timing or rate_of([effect])):
            found.setdefault(f"{effect.name} {_place_but_phase(effect)}", []).append(effect)
    return [Candidate(described(kinds[0]), tuple(kinds), len(kinds)) for kinds in found.values()]


def without(robot: RobotDescription, kind: type[Effect]) -> RobotDescription:
    """Return a robot without its effects of some kind."""
    return dataclasses.replace(robot, effects=tuple(effect for effect in robot.effects if not isinstance(effect, kind)))


def differ(first: Geometry, second: Geometry) -> bool:
    """Whether two robots are built differently."""
    return any(not np.array_equal(getattr(first, name), getattr(second, name)) for name in NUMBERS)


def stacked(layout: Geometry, geometries: Sequence[Geometry]) -> Geometry:
    """Return several geometries of one layout as one, with a leading axis."""
    numbers = {
        name: np.array([getattr(geometry, name) for geometry in geometries]).reshape(-1, *getattr(layout, name).shape)
        for name in NUMBERS
    }
    return dataclasses.replace(layout, **numbers)


def _place_but_phase(effect: Effect) -> dict[str, object]:
    return {key: value for key, value in place_of(effect).items() if key != "phase"}


def _slipping(robot: RobotDescription, motion: Motion) -> Iterator[tuple[Candidate, tuple[Slip, ...]]]:
    """Yield rivals without a name: one wheel or castor that slips as it turns, or more and more."""
    paths, later, no_slip = contact_paths(robot.as_built(), motion), motion.middle - motion.middle[0], Slip.none(motion)
    wheel_angle = (motion.wheel_angle[1:] + motion.wheel_angle[:-1]) / 2
    swept = motion.body[:, 2:] + motion.turned

    def alone(behaviour: str, place: str, k: int, *values: Array) -> tuple[Candidate, tuple[Slip, ...]]:
        slips = []
        for value in values:
            rolling, side = no_slip.rolling.copy(), no_slip.side.copy()
            (side if place.startswith("castor") else rolling)[:, k] = value
            slips.append(Slip(rolling, side))
        return Candidate(f"{place} {behaviour}", columns=len(values)), tuple(slips)

    for k in robot.driven_wheels:
        i = robot.wheel_castors[k]
        place, rolled, turn, theta = (
            f"wheel_{robot.wheel_names[k]}",
            paths[:, k],
            wheel_angle[:, k],
            motion.half_way[:, i],
        )
        behaviour = "slips where its castor turns, once a turn"
        yield alone(behaviour, place, k, swept[:, i] * np.sin(turn), swept[:, i] * np.cos(turn))
        for times in (1, 2) if np.ptp(theta) >= SWEPT else ():
            behaviour = f"slips by its castor's angle, {times} times a turn"
            yield alone(behaviour, place, k, rolled * np.sin(times * theta), rolled * np.cos(times * theta))
        yield alone("slips more and more", place, k, rolled * later)
    for i in range(len(robot.castors)):
        wheels = [k for k in robot.driven_wheels if robot.wheel_castors[k] == i]
        if not wheels:
            continue
        place, rolled, theta = f"castor_{i + 1}", paths[:, wheels].mean(axis=1), motion.half_way[:, i]
        yield alone("slips to its side with speed", place, i, np.abs(rolled) * rolled / motion.period)
        for times in (1, 2) if np.ptp(theta) >= SWEPT else ():
            behaviour = f"slips to its side by its angle, {times} times a turn"
            yield alone(behaviour, place, i, rolled * np.sin(times * theta), rolled * np.cos(times * theta))


def _misread(channels: Channels, log: Log, counts: Array, wanted: Array, of: str) -> Iterator[tuple[Candidate, Array]]:
    """Yield rivals without a name: of one channel at a time, what comes and goes, jumps, repeats, or grows."""
    edges = np.linspace(0, len(counts), BLOCKS + 1).astype(int).tolist()
    speed = np.gradient(counts, log.t, axis=0)
    samples = np.arange(len(counts))
    for c, name in enumerate(channels.names):

        def alone(behaviour: str, *values: Array, c: int = c, name: str = name) -> tuple[Candidate, Array]:
            excess = np.zeros((*counts.shape, len(values)))
            excess[:, c] = np.stack(values, axis=-1) - [value[0] for value in values]
            return Candidate(f"{name} {behaviour}", columns=len(values)), excess

        channel_counts, angle = counts[:, c], counts[:, c] * 2 * np.pi / channels.per_rev[c]
        for first, last in itertools.pairwise(edges):
            span = f"from {log.t[first]:.0f} to {log.t[last - 1]:.0f} s{of}"
            yield alone(f"reads in proportion too much {span}", channel_counts[np.clip(samples, first, last - 1)])
        ends = int(ENDS * len(counts))
        later = np.abs(np.cumsum(wanted[:0:-1, c])[::-1])[ends : len(counts) - 1 - ends]
        jump = 1 + ends + int(np.argmax(later))
        yield alone(f"jumps at {log.t[jump]:.1f} s{of}", np.where(samples >= jump, 1.0, 0.0))
        for times in (2, 3) if np.ptp(angle) >= SWEPT else ():
            yield alone(f"repeats {times} times a turn", np.sin(times * angle), np.cos(times * angle))
        yield alone("reads too much with speed", np.cumsum(speed[:, c] * np.abs(speed[:, c]) * np.gradient(log.t)))
        yield alone("drifts with time", log.t - log.t[0])
