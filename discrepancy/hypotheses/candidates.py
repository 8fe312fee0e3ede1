"""Candidates: the effects of the catalogue that a robot's description may be missing, and unnamed alternatives.

Each candidate has a signature: the change of a log per unit of its amplitude, at the fitted state. The state is
smoothed, as signatures from differences of single counts would resemble each other.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from castor_envs.effects.catalogue import catalogue, gyro_gain_of
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
from discrepancy.hypotheses.stretches import by_disagreement, by_motion
from estimators.likelihood.channels import Channels
from estimators.likelihood.disagreement import BODY
from estimators.likelihood.log_likelihood import LogLikelihood
from estimators.likelihood.sparse_columns import SparseColumns

SWEPT = np.pi
"""rad that a castor must sweep so that errors periodic in its angle can be distinguished from a bias and a gain of its
encoder. What is in the model stays a candidate: with it, the castor may seem to sweep a little less."""

ENDS = 0.05
"""Part of a log at each end in which no jump is searched: it could not be distinguished from a bias."""

DITHERS = (np.arange(4) - 1.5) / 4
"""Counts per sample: the signature of an effect that depends on fractions of a count is the mean over these drifts."""


NEAR = 0.1
"""Part of a cable's diameter over which its derivative is taken."""

NUMBERS = ("pivot", "offset", "pivot_zero", "angle", "lateral", "radius", "roller")
"""Fields of a geometry that may differ between robots of one layout."""


@dataclass(frozen=True)
class Candidate:
    """A possible cause.

    kinds: effects of the catalogue, with the value of their step; two that differ by a quarter turn of `phase`
    represent an effect of any phase; empty: an unnamed alternative, described by `what`. columns: number of amplitudes.
    when: the end of `what` that tells a time in one of the logs, of causes that other logs do not have.
    """

    what: str
    kinds: tuple[Effect, ...] = ()
    columns: int = 1
    when: str = ""

    @property
    def family(self) -> str:
        """The name to report, and the place on the robot: the same for all candidates that no log can distinguish."""
        return family_of(self.kinds[0]) if self.kinds else self.what

    @property
    def alike(self) -> str:
        """What the cause does, whichever wheel or castor it is of, and whenever: causes that do the same scatter alike
        among robots in good order."""
        if self.kinds:
            of_pivot = getattr(self.kinds[0], "wheel", 0) is None
            return f"{self.kinds[0].name} of a pivot" if of_pivot else self.kinds[0].name
        place, _, behaviour = self.what.removesuffix(self.when).partition(" ")
        return f"{place.partition('_')[0]} {behaviour}"

    @property
    def at_a_place(self) -> bool:
        """Whether the effect is at one place on the floor."""
        return any(isinstance(kind, Bump) for kind in self.kinds)

    @property
    def searched_over_steps(self) -> bool:
        """Whether its place or time was chosen among all steps to suit the logs."""
        return self.at_a_place or bool(self.when)

    def effect(self, amplitudes: Sequence[float] | Array) -> Effect:
        """Return the effect with these amplitudes (columns,); raises ValueError for amplitudes that it cannot have."""
        kind, size = self.kinds[0], float(amplitudes[0])
        if self.kinds[0].binary:
            return kind
        if self.columns == 1:
            return dataclasses.replace(kind, value=size)
        phase = math.atan2(float(amplitudes[1]), size)
        return dataclasses.replace(kind, value=math.hypot(*amplitudes), phase=phase)

    def added(self, robot: RobotDescription, amplitudes: Sequence[float] | Array) -> RobotDescription:
        """Return the robot with the effect of these amplitudes added; raises ValueError for amplitudes that it cannot
        have."""
        return robot.with_effects(self.effect(amplitudes))

    def is_of(self, effect: Effect) -> bool:
        """Whether an effect is of this kind and place, whatever its size and phase."""
        return any(type(kind) is type(effect) and place_of(kind) == place_of(effect) for kind in self.kinds)


SWAYING = Candidate("reference sways with acceleration")
"""An unnamed alternative: poses of the reference are off in proportion to the tracked point's acceleration, as on a
soft mast, or by a filter."""


def place_of(effect: Effect) -> dict[str, object]:
    """Return the fields of an effect that define its place: all but its name, amplitude and phase."""
    return {f.name: getattr(effect, f.name) for f in fields(effect) if f.name not in ("name", "value", "phase")}


def family_of(effect: Effect) -> str:
    """Return the name to report for all effects that no log can distinguish from this effect, and the place on the
    robot."""
    name = effect.indistinguishable_from[0] if effect.indistinguishable_from else effect.name
    place = (value for key, value in place_of(effect).items() if key != "above")
    places = (round(value, 2) if isinstance(value, float) else value for value in place)
    return " ".join([name, *(str(value) for value in places)])


def described(effect: Effect) -> str:
    """Return an effect and its place in words."""
    return ", ".join([effect.title, *effect.where()])


def encoder_of(robot: RobotDescription, effect: Effect) -> str | None:
    """Return the name of the encoder, as "wheel_1l", that an effect makes read wrongly; None if it does so of none, or
    of all."""
    castor, wheel = getattr(effect, "castor", None), getattr(effect, "wheel", None)
    if castor is None or type(effect).sensor_model is Effect.sensor_model:
        return None
    return encoder_name(robot, castor, wheel)


def encoder_name(robot: RobotDescription, castor: int, wheel: int | None) -> str:
    """Return the name of a wheel's encoder, or of the castor's pivot encoder where wheel is None."""
    return f"pivot_{castor}" if wheel is None else f"wheel_{robot.wheel_names[channel(robot, castor, wheel, '')]}"


def rate_of(effects: Sequence[Effect]) -> float:
    """Return the rate that effects add to the clock of the reference, s/s."""
    gains = (np.diff(effect.reference_time(np.array([0.0, 1.0])))[0] - 1 for effect in effects)
    return float(np.round(sum(gains), 12))


def gyro_scale_of(effects: Sequence[Effect]) -> float:
    """Return the part by which the gyro reads too much by effects."""
    return float(np.round(gyro_gain_of(effects) - 1, 12))


@dataclass(frozen=True, eq=False)
class Signatures:
    """Signatures of candidates in one log, one or two columns each.

    The first G columns are of `geometries`, changed by `steps` (G,); the other R of `readings` (K, s + d, R), counts
    read too much per unit, of `slips` (K - 1, w + n, R), m per unit that wheels roll and castors move to their side,
    and of `rates` (R,), rate of the reference's clock, `sways` (R,), by how much its poses are off in proportion to the
    tracked point's acceleration, s2, and `gyro_scales` (R,), part by which the gyro reads too much, per unit.
    """

    candidates: tuple[Candidate, ...]
    geometries: tuple[Geometry, ...]
    steps: Array
    readings: SparseColumns
    slips: SparseColumns
    rates: Array
    sways: Array
    gyro_scales: Array


def signatures_of(
    robot: RobotDescription,
    log: Log,
    state: Array,
    model: LogLikelihood,
    among: Sequence[Candidate] | None = None,
    of: str = "",
    places: Sequence[Candidate] = (),
    creep: float = 1.0,
) -> Signatures:
    """Return the signatures of candidates (None: all) beyond the robot's own effects, at a state (K, 3 + s + d).

    model: of the log, which locates jumps of a channel, and stretches in which it reads wrongly. of: name of the log,
    for unnamed alternatives at a time in it. places: further candidates, at places of the floor. creep: how many times
    as much as described contacts creep under forces.
    """
    channels = Channels(robot)
    counts = state[:, 3 : 3 + len(channels.names)]
    plain = {0.0: channels.read(robot, log, counts)}
    rows = np.arange(len(counts))[:, None]
    rate = _rate(counts, log.t)

    def added(changed: RobotDescription, dithers: Array) -> Array:
        """Return the excess of the readings, averaged over dithers, at the times of what late encoders read: as the
        counts that states are fitted to (`Channels.unread`)."""
        total = np.zeros_like(counts)
        for dither in dithers.tolist():
            seen = counts + dither * rows
            if dither not in plain:
                plain[dither] = channels.read(robot, log, seen)
            total += channels.read(changed, log, seen) - plain[dither]
        return channels.undelayed(robot, log, total / len(dithers))

    built: list[tuple[Candidate, Geometry, float]] = []
    read: list[tuple[Candidate, SparseColumns, SparseColumns]] = []
    unread: list[Candidate] = []  # by encoders: rates of clocks, scales of gyros, and what sways
    motion = channels.motion(log, state, consistent_wheels=True)
    swept = np.ptp(motion.castor_angle, axis=0)
    slip_rows = motion.wheel_angle.shape[1] + motion.castor_angle.shape[1]

    def misreading(candidate: Candidate, excess: Array) -> tuple[Candidate, SparseColumns, SparseColumns]:
        return candidate, SparseColumns.of(excess), SparseColumns((len(counts) - 1, slip_rows, candidate.columns))

    def slipping(candidate: Candidate, slips: SparseColumns) -> tuple[Candidate, SparseColumns, SparseColumns]:
        return candidate, SparseColumns((*counts.shape, candidate.columns)), slips

    for candidate in dict.fromkeys([*candidates_of(robot), *places]) if among is None else among:
        kind, in_robot = candidate.kinds[0], any(candidate.is_of(effect) for effect in robot.effects)
        if isinstance(kind, PivotEccentricity) and swept[kind.castor - 1] < SWEPT and not in_robot:
            continue
        if rate_of(candidate.kinds) or gyro_scale_of(candidate.kinds):
            measured = log.reference if rate_of(candidate.kinds) else log.gyro
            unread += [candidate] if measured is not None else []
            continue
        if isinstance(kind, EncoderLatency | AllLatency) and not in_robot:  # else by what the late encoder reads
            late = channels.latencies(robot.as_described().with_effects(kind)) / kind.value
            read.append(misreading(candidate, -(late * rate)[..., None]))
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
            if (own := _smaller(robot, candidate)) is None:
                excess = np.stack([added(larger, dithers) for larger in changed], axis=-1) / kind.value
            else:
                excess = added(own, dithers)[..., None] / -kind.value
            if np.any(excess):
                read.append(misreading(candidate, excess))
            elif (slip := _slip_of(candidate, robot, motion)) is not None:
                both = np.concatenate([slip.rolling, slip.side], axis=1) * (creep if kind.creep == "forces" else 1.0)
                read.append(slipping(candidate, SparseColumns.of(both[..., None])))
    if among is None:
        read += [misreading(candidate, excess) for candidate, excess in _misread(channels, log, state, model, of)]
        read += [slipping(candidate, slips) for candidate, slips in _slipping(robot, motion)]
        unread += [SWAYING] if log.reference is not None else []
    read += [misreading(candidate, np.zeros((*counts.shape, 1))) for candidate in unread]
    of_columns = [candidate for candidate, _, _ in read for _ in range(candidate.columns)]
    return Signatures(
        (*(candidate for candidate, _, _ in built), *(candidate for candidate, _, _ in read)),
        tuple(geometry for _, geometry, _ in built),
        np.array([step for _, _, step in built]),
        SparseColumns.joined([excess for _, excess, _ in read], counts.shape),
        SparseColumns.joined([slips for _, _, slips in read], (len(counts) - 1, slip_rows)),
        np.array([_per_unit(rate_of, candidate) for candidate in of_columns]),
        np.array([float(candidate == SWAYING) for candidate in of_columns]),
        np.array([_per_unit(gyro_scale_of, candidate) for candidate in of_columns]),
    )


def _rate(counts: Array, t: Array) -> Array:
    """Return the rates of counts (K, channels) in counts/s at times t (K,): central differences of fourth order, of
    second order at the ends.

    By a sample and the one before it alone, a delay would average noise, and logs would seem likelier with it.
    """
    near, far = (counts[2 * n :] - counts[: -2 * n] for n in (1, 2))
    rate = np.gradient(counts, t, axis=0, edge_order=2)
    over, twice = (t[2 * n :] - t[: -2 * n] for n in (1, 2))
    rate[2:-2] = 4 / 3 * near[1:-1] / over[1:-1, None] - far / twice[:, None] / 3
    return rate


def _smaller(robot: RobotDescription, candidate: Candidate) -> RobotDescription | None:
    """Return a robot whose own effect of this kind is smaller by a step; None if it has none as large, or of one size.

    The same effect once more may not be more of it: a wheel that seems slow, as its counts are lost at speed, loses no
    more of them.
    """
    step = candidate.kinds[0]
    for k, effect in enumerate(robot.effects):
        if candidate.is_of(effect) and candidate.columns == 1 and not step.binary and effect.value > step.value:
            smaller = dataclasses.replace(effect, value=effect.value - step.value)
            return dataclasses.replace(robot, effects=(*robot.effects[:k], smaller, *robot.effects[k + 1 :]))
    return None


def _per_unit(of: Callable[[Sequence[Effect]], float], candidate: Candidate) -> float:
    return of(candidate.kinds) / (candidate.kinds[0].value if candidate.kinds else 1.0)


def _slip_of(candidate: Candidate, robot: RobotDescription, motion: Motion) -> Slip | None:
    """Return the slip per unit of an effect; None if it causes none.

    It is a derivative at the size that the effect has in the robot, as the extra roll over a cable is not in proportion
    to its diameter.
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
    """Return the effects that a robot may have; the two phases of a periodic effect are one candidate.

    Of timing effects only the rate of a clock: its offset (equivalent to all encoders late) is always fitted, and
    jitter has mean 0. No wrong wiring, which is no small change. Of effects that no log can distinguish only the first:
    which of the others are distinguishable would depend on the effects in the robot.
    """
    found: dict[str, list[Effect]] = {}
    for effect in catalogue(robot.as_described()):
        reported, *_ = effect.indistinguishable_from or (effect.name,)
        if effect.name == reported and not effect.wiring and (not effect.timing or rate_of([effect])):
            found.setdefault(f"{effect.name} {place_of(effect)}", []).append(effect)
    return [Candidate(described(kinds[0]), tuple(kinds), len(kinds)) for kinds in found.values()]


def without(robot: RobotDescription, *kinds: type[Effect]) -> RobotDescription:
    """Return a robot without its effects of these kinds."""
    return dataclasses.replace(
        robot, effects=tuple(effect for effect in robot.effects if not isinstance(effect, kinds))
    )


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


def _slipping(robot: RobotDescription, motion: Motion) -> Iterator[tuple[Candidate, SparseColumns]]:
    """Yield unnamed alternatives: one wheel or castor that slips periodically with its angle, or increasingly with
    time; with the slips (K - 1, w + n, columns) of wheels and castors."""
    paths, later = contact_paths(robot.as_built(), motion), motion.middle - motion.middle[0]
    wheel_angle = (motion.wheel_angle[1:] + motion.wheel_angle[:-1]) / 2
    swept = motion.body[:, 2:] + motion.turned

    def alone(behaviour: str, place: str, k: int, *values: Array) -> tuple[Candidate, SparseColumns]:
        row = k + len(robot.wheels) if place.startswith("castor") else k
        shape = len(later), len(robot.wheels) + len(robot.castors), len(values)
        slips = SparseColumns(shape, values, [row] * len(values), range(len(values)))
        return Candidate(f"{place} {behaviour}", columns=len(values)), slips

    for k in robot.driven_wheels:
        i = robot.wheel_castors[k]
        place, rolled, turn = f"wheel_{robot.wheel_names[k]}", paths[:, k], wheel_angle[:, k]
        theta = motion.half_way[:, i]
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


def _misread(
    channels: Channels, log: Log, state: Array, model: LogLikelihood, of: str
) -> Iterator[tuple[Candidate, Array]]:
    """Yield unnamed alternatives of one channel at a time: readings that are wrong in part of the log, jump, repeat, or
    drift."""
    counts, score = state[:, 3 : 3 + len(channels.names)], model.score_by_counts(state)
    speed = np.gradient(counts, log.t, axis=0)
    samples = np.arange(len(counts))
    for c, name in enumerate(channels.names):

        def alone(
            behaviour: str, *values: Array, when: str = "", c: int = c, name: str = name
        ) -> tuple[Candidate, Array]:
            excess = np.zeros((*counts.shape, len(values)))
            excess[:, c] = np.stack(values, axis=-1) - [value[0] for value in values]
            return Candidate(f"{name} {behaviour}{when}", columns=len(values), when=when), excess

        channel_counts, angle = counts[:, c], counts[:, c] * 2 * np.pi / channels.per_rev[c]
        later = np.cumsum(score[:0:-1, c])[::-1]  # by a jump in each step
        stretches = [by_motion(np.diff(channel_counts), later)]
        if c >= len(channels.sensed) and len(model.rows) > BODY:
            (row,) = np.flatnonzero(model.rows == channels.driven[c - len(channels.sensed)])
            stretches.append(by_disagreement(model, channels.geometry, state, log.t, int(row)))
        found = [stretch for stretch in stretches if stretch is not None]
        spans = {f" from {log.t[first]:.1f} to {log.t[last]:.1f} s{of}": (first, last) for first, last in found}
        for span, (first, last) in spans.items():
            yield alone("reads in proportion too much", channel_counts[np.clip(samples, first, last)], when=span)
        ends = int(ENDS * len(counts))
        jump = 1 + ends + int(np.argmax(np.abs(later[ends : len(later) - ends])))
        yield alone("jumps", np.where(samples >= jump, 1.0, 0.0), when=f" at {log.t[jump]:.1f} s{of}")
        if np.ptp(angle) >= SWEPT:
            yield alone("repeats every turn", *(of(k * angle) for k in (1, 2, 3) for of in (np.sin, np.cos)))
        yield alone("reads too much with speed", np.cumsum(speed[:, c] * np.abs(speed[:, c]) * np.gradient(log.t)))
        yield alone("drifts with time", log.t - log.t[0])
