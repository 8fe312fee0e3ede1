"""Hypotheses of the pre-flight: gross mistakes, the name of each, and how a log that contains it is to be read."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, permutations

from castor_envs.effects.dimensions import CountsPerRev, PivotBias
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.logs.columns import LogColumns
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.reading import Channels, Reading

MANY = 4
"""Most castors of which all orders are tried; of more castors only cyclic shifts and reversals are."""

UNITS = {"radians": 2 * math.pi, "degrees": 360.0}


@dataclass(frozen=True)
class Hypothesis:
    """A mistake. what: its name. read: changes a reading into that of a log with the mistake. effects: equivalent
    effects, if there are any.

    remedy: what to do. scaled: the channels whose counts per turn are wrong by a factor, if that is the mistake. plain:
    whether it is a single mistake at one place, which is likelier than many at once.
    """

    what: str
    read: Callable[[Reading], Reading]
    effects: tuple[Effect, ...] = ()
    remedy: str = ""
    scaled: tuple[int, ...] = ()
    plain: bool = True


def hypotheses(robot: RobotDescription) -> list[Hypothesis]:
    """Return every mistake that is considered for a robot, except factors of any size (`scale`)."""
    channels = Channels(robot)
    return [
        *_wiring(robot, channels),
        *_orders(robot, channels),
        *_many(robot, channels),
        *_foreign(robot, channels),
        *_turned(robot, channels),
        *_units(robot, channels),
        *_reference(),
    ]


def wiring(robot: RobotDescription) -> list[Hypothesis]:
    """Return the plain mistakes of wiring, which may occur in pairs."""
    return list(_wiring(robot, Channels(robot)))


def places_to_scale(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Return the groups of wheel channels that may share wrong counts per turn, by name."""
    channels, names = Channels(robot), LogColumns.of(robot).wheel
    places: dict[str, tuple[int, ...]] = {names[k]: (k,) for k in channels.wheels}
    if len(robot.castors) > 1:
        for i in range(1, len(robot.castors) + 1):
            if len(channels_of_castor := channels.of_castor(i)) > 1:
                places[f"the wheels of castor {i}"] = channels_of_castor
    if len(names) > 1:
        places["all wheels"] = channels.wheels
    return places


def pivots_to_scale(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Return the groups of pivot channels that may share wrong counts per turn, by name."""
    channels = Channels(robot)
    places = {f"pivot_{i + 1}": (k,) for i, k in zip(robot.pivot_encoders, channels.pivots, strict=True)}
    return places | ({"all pivots": channels.pivots} if len(places) > 1 else {})


def scale(robot: RobotDescription, place: str, scaled: tuple[int, ...], factor: float) -> Hypothesis:
    """Return the mistake that wheels, or pivots, give `factor` times the counts per turn in the robot file."""
    channels = Channels(robot)
    if set(scaled) <= set(channels.pivots):
        return Hypothesis(
            f"the counts of {place} are {factor:.3g} times what pivot_counts_per_rev says",
            lambda reading: reading.scaled(scaled, factor),
            remedy="turn the castor once around by hand, read its counts, and correct pivot_counts_per_rev",
            plain=len(scaled) == 1,
        )
    effects = ()
    if abs(factor - 1) <= 0.5:
        wheels = [
            (i, j) for i in range(1, len(robot.castors) + 1) for j in range(1, len(robot.castors[i - 1].wheels) + 1)
        ]
        named = [(i, j) for i, j in wheels if channels.has(i, j) and channels.at(i, j) in scaled]
        effects = tuple(CountsPerRev(castor=i, wheel=j, value=factor - 1) for i, j in named)
    described = sorted({robot.wheels[robot.driven_wheels[k]].counts_per_rev or 0.0 for k in scaled})
    right = " and ".join(f"{counts * factor:.5g} for {counts:g}" for counts in described)
    return Hypothesis(
        f"the counts of {place} are {factor:.3g} times what counts_per_rev says",
        lambda reading: reading.scaled(scaled, factor),
        effects,
        f"give counts_per_rev {right} (or correct radius, gear or unit)",
        scaled=scaled,
        plain=len(scaled) == 1,
    )


def _by_effects(channels: Channels, description: str, effects: tuple[Effect, ...], plain: bool = True) -> Hypothesis:
    return Hypothesis(
        description,
        lambda reading: reduce(channels.read, effects, reading),
        effects,
        effects[0].check[0].lower() + effects[0].check[1:].rstrip("."),
        plain=plain,
    )


def _wiring(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    names = LogColumns.of(robot)
    names = (*names.wheel, *names.pivot)
    for kind in (EncodersSwapped, EncoderReversed, CastorOrder):
        for effect in kind.variants(robot):
            match effect:
                case EncodersSwapped():
                    sentence = f"the left and right encoder of castor {effect.castor} are swapped"
                case EncoderReversed():
                    sentence = f"{names[channels.at(effect.castor, effect.wheel)]} counts backwards"
                case _:
                    sentence = f"castors {effect.castor} and {effect.exchanged_with} are exchanged"
            yield _by_effects(channels, sentence, (effect,))


def _orders(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield orders of castors that differ by more than one exchange."""
    pairs = {(effect.castor, effect.exchanged_with) for effect in CastorOrder.variants(robot)}
    alike: list[int] = []
    for i in range(1, len(robot.castors) + 1):
        if not alike or (alike[0], i) in pairs:
            alike += [i] if any(i in pair for pair in pairs) else []
    n = len(alike)
    if n <= MANY:
        orders = list(permutations(alike))
    else:
        around = [tuple(alike[k:] + alike[:k]) for k in range(1, n)]
        orders = [*around, *(tuple(order[::-1]) for order in [tuple(alike), *around])]
    for order in orders:
        exchanges = _exchanges(alike, list(order))
        if len(exchanges) > 1:
            shown = ", ".join(map(str, order))
            sentence = f"the castors are connected in the order {shown}, not {', '.join(map(str, alike))}"
            effects = tuple(CastorOrder(castor=a, exchanged_with=b) for a, b in exchanges)
            yield _by_effects(channels, sentence, effects, plain=False)


def _exchanges(alike: list[int], order: list[int]) -> list[tuple[int, int]]:
    """Return the exchanges, first to last, after which the place alike[k] shows castor order[k]."""
    shown, found = list(alike), []
    for k, castor in enumerate(order):
        at = shown.index(castor)
        if at != k:
            shown[k], shown[at] = shown[at], shown[k]
            found.append((alike[k], alike[at]))
    return found


def _many(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield mistakes that are the same on the whole robot, or on all wheels of a castor."""
    reversals = EncoderReversed.variants(robot)
    wheels = tuple(reversal for reversal in reversals if reversal.wheel is not None)
    pivots = tuple(reversal for reversal in reversals if reversal.wheel is None)
    if len(wheels) > 1:
        yield _by_effects(channels, "all wheels count backwards", wheels, plain=False)
    if len(pivots) > 1:
        yield _by_effects(channels, "all pivots count backwards", pivots, plain=False)
    swaps = EncodersSwapped.variants(robot)
    if len(swaps) > 1:
        sentence = "the left and right encoders of every castor are swapped"
        yield _by_effects(channels, sentence, swaps, plain=False)
    for swap in swaps:
        castor_reversals = tuple(reversal for reversal in wheels if reversal.castor == swap.castor)
        if len(robot.castors) > 1 and len(castor_reversals) < len(wheels):
            sentence = f"both wheels of castor {swap.castor} count backwards"
            yield _by_effects(channels, sentence, castor_reversals, plain=False)
        sentence = f"the left and right encoder of castor {swap.castor} are swapped and both count backwards"
        yield _by_effects(channels, sentence, (swap, *castor_reversals), plain=False)


def _foreign(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield exchanges of two encoders of different castors, without the other encoders of these castors."""
    columns = LogColumns.of(robot)
    names = (*columns.wheel, *columns.pivot)
    castor = [robot.wheel_castors[k] for k in robot.driven_wheels] + list(robot.pivot_encoders)
    for kind in (channels.wheels, channels.pivots):
        for a, b in combinations(kind, 2):
            alone = len(channels.of_castor(castor[a] + 1)) + len(channels.pivot_of(castor[a] + 1)) == 1
            if castor[a] != castor[b] and not alone:
                yield Hypothesis(
                    f"{names[a]} and {names[b]} are exchanged",
                    lambda reading, a=a, b=b: reading.exchanged((a,), (b,)),
                    remedy="turn one by hand and see which counts change; exchange the columns",
                )
    if len({castor[k] for k in channels.wheels}) > 1 and channels.pivots:
        for i, j in combinations(sorted({castor[k] + 1 for k in channels.wheels}), 2):
            first, second = channels.of_castor(i), channels.of_castor(j)
            if len(first) == len(second) > 1:
                yield Hypothesis(
                    f"the wheel encoders, not the pivots, of castors {i} and {j} are exchanged",
                    lambda reading, first=first, second=second: reading.exchanged(first, second),
                    remedy="turn one wheel by hand and see which counts change; exchange the columns",
                    plain=False,
                )


def _turned(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield castors that are mounted, or zeroed, off by quarter or half turns."""
    for angle, name in (
        (math.pi, "half a turn"),
        (math.pi / 2, "a quarter turn"),
        (-math.pi / 2, "minus a quarter turn"),
    ):
        biases = tuple(dataclasses.replace(bias, value=angle) for bias in PivotBias.variants(robot))
        for bias in biases:
            yield _by_effects(channels, f"pivot_{bias.castor} reads {name} too much", (bias,))
        if len(biases) > 1:
            yield _by_effects(channels, f"all pivots read {name} too much", biases, plain=False)


def _units(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    wheel = [robot.wheels[k].counts_per_rev or 1.0 for k in robot.driven_wheels]
    pivot = [float(robot.castors[i].pivot_counts_per_rev or 1) for i in robot.pivot_encoders]
    turns = (*wheel, *pivot)
    kinds = {
        "wheels": channels.wheels,
        "pivots": channels.pivots,
        "wheels and pivots": channels.wheels + channels.pivots,
    }
    for unit, turn in UNITS.items():
        for name, unit_channels in kinds.items():
            if not channels.pivots and name != "wheels":
                continue

            def read(reading: Reading, unit_channels: tuple[int, ...] = unit_channels, turn: float = turn) -> Reading:
                for k in unit_channels:
                    reading = reading.scaled((k,), turn / turns[k])
                return reading

            remedy = f"give counts: multiply by counts a turn over {turn:.5g}"
            yield Hypothesis(f"{name} are given in {unit}, not in counts", read, remedy=remedy, plain=False)


def _reference() -> Iterator[Hypothesis]:
    degrees = 180 / math.pi
    kinds: list[tuple[str, str, dict[str, float]]] = [
        ("ref_x and ref_y are in millimetres", "divide them by 1000", {"lengths": 1000.0}),
        ("ref_x and ref_y are in centimetres", "divide them by 100", {"lengths": 100.0}),
        ("ref_psi is in degrees", "multiply it by pi/180", {"headings": degrees}),
        ("ref_psi runs clockwise", "change its sign", {"headings": -1.0}),
        (
            "the reference is seen in a mirror (y to the right, ref_psi clockwise)",
            "change the signs of ref_y and ref_psi",
            {"headings": -1.0, "across": -1.0},
        ),
        (
            "the reference is in millimetres and degrees",
            "divide ref_x and ref_y by 1000, multiply ref_psi by pi/180",
            {"lengths": 1000.0, "headings": degrees},
        ),
    ]
    for sentence, remedy, by in kinds:
        yield Hypothesis(sentence, lambda reading, by=by: reading.referred(**by), remedy=remedy)
