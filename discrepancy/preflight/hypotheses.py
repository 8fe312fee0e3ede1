"""Hypotheses of the pre-flight: gross mistakes, the name of each, and how a log that contains it is to be read."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, permutations

from castor_envs.effects.dimensions import CountsPerRev, PivotBias
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.reading import Channels, Reading

MANY = 4
"""Most castors of which all orders are tried; of more castors only cyclic shifts and reversals are."""

TURNS = {"half a turn": math.pi, "a quarter turn": math.pi / 2, "minus a quarter turn": -math.pi / 2}
UNITS = {"radians": 2 * math.pi, "degrees": 360.0}
"""Of encoders: what a turn is in them."""

DEGREES = math.degrees(1)
REFERENCE: tuple[tuple[str, str, dict[str, float]], ...] = (
    ("ref_x and ref_y are in millimetres", "divide them by 1000", {"lengths": 1000.0}),
    ("ref_x and ref_y are in centimetres", "divide them by 100", {"lengths": 100.0}),
    ("ref_psi is in degrees", "multiply it by pi/180", {"headings": DEGREES}),
    ("ref_psi runs clockwise", "change its sign", {"headings": -1.0}),
    (
        "the reference is seen in a mirror (y to the right, ref_psi clockwise)",
        "change the signs of ref_y and ref_psi",
        {"headings": -1.0, "across": -1.0},
    ),
    (
        "the reference is in millimetres and degrees",
        "divide ref_x and ref_y by 1000, multiply ref_psi by pi/180",
        {"lengths": 1000.0, "headings": DEGREES},
    ),
)
"""Of the reference: mistake, remedy, and its factors in a `Reading`."""


@dataclass(frozen=True)
class Hypothesis:
    """A mistake. what: its name. read: changes a reading into that of a log with the mistake. effects: equivalent
    effects, if there are any. remedy: what to do. plain: whether it is a single mistake at one place, which is likelier
    than many at once.
    """

    what: str
    read: Callable[[Reading], Reading]
    effects: tuple[Effect, ...] = ()
    remedy: str = ""
    plain: bool = True


def hypotheses(robot: RobotDescription) -> list[Hypothesis]:
    """Return every mistake that is considered for a robot, except factors of any size (`scale`)."""
    channels = Channels(robot)
    return [
        *wiring(robot),
        *_orders(robot, channels),
        *_many(robot, channels),
        *_foreign(channels),
        *_turned(robot, channels),
        *_units(robot, channels),
        *(
            Hypothesis(what, lambda reading, by=by: dataclasses.replace(reading, **by), remedy=remedy)
            for what, remedy, by in REFERENCE
        ),
    ]


def wiring(robot: RobotDescription) -> list[Hypothesis]:
    """Return the plain mistakes of wiring, which may occur in pairs."""
    channels = Channels(robot)
    return [
        *(
            _by_effects(channels, f"the left and right encoder of castor {swap.castor} are swapped", swap)
            for swap in EncodersSwapped.variants(robot)
        ),
        *(
            _by_effects(channels, f"{channels.names[channels.at(off.castor, off.wheel)]} counts backwards", off)
            for off in EncoderReversed.variants(robot)
        ),
        *(
            _by_effects(channels, f"castors {order.castor} and {order.exchanged_with} are exchanged", order)
            for order in CastorOrder.variants(robot)
        ),
    ]


def places_to_scale(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Return the groups of wheel channels that may share wrong counts per turn, by name."""
    channels = Channels(robot)
    places = {channels.names[k]: (k,) for k in channels.wheels}
    if len(robot.castors) > 1:
        of_castors = {f"the wheels of castor {i}": channels.of_castor(i) for i in range(1, len(robot.castors) + 1)}
        places |= {name: wheels for name, wheels in of_castors.items() if len(wheels) > 1}
    return places | ({"all wheels": channels.wheels} if len(channels.wheels) > 1 else {})


def pivots_to_scale(robot: RobotDescription) -> dict[str, tuple[int, ...]]:
    """Return the groups of pivot channels that may share wrong counts per turn, by name."""
    channels = Channels(robot)
    places = {channels.names[k]: (k,) for k in channels.pivots}
    return places | ({"all pivots": channels.pivots} if len(places) > 1 else {})


def scale(robot: RobotDescription, place: str, scaled: tuple[int, ...], factor: float) -> Hypothesis:
    """Return the mistake that wheels, or pivots, give `factor` times the counts per turn in the robot file."""
    channels, effects = Channels(robot), ()
    if set(scaled) <= set(channels.pivots):
        key, remedy = "pivot_counts_per_rev", "turn the castor once around by hand, read its counts, and correct"
        remedy = f"{remedy} pivot_counts_per_rev"
    else:
        described = sorted({robot.wheels[robot.driven_wheels[k]].counts_per_rev or 0.0 for k in scaled})
        right = " and ".join(f"{counts * factor:.5g} for {counts:g}" for counts in described)
        key, remedy = "counts_per_rev", f"give counts_per_rev {right} (or correct radius, gear or unit)"
        if abs(factor - 1) <= 0.5:  # as far as the effect goes
            places = [place for place, k in channels.wheel_at.items() if k in scaled]
            effects = tuple(CountsPerRev(castor=i, wheel=j, value=factor - 1) for i, j in places)
    return Hypothesis(
        f"the counts of {place} are {factor:.3g} times what {key} says",
        lambda reading: reading.scaled(scaled, factor),
        effects,
        remedy,
        plain=len(scaled) == 1,
    )


def _by_effects(channels: Channels, what: str, *effects: Effect, plain: bool = True) -> Hypothesis:
    remedy = effects[0].check[0].lower() + effects[0].check[1:].rstrip(".")
    return Hypothesis(what, lambda reading: reduce(channels.read, effects, reading), effects, remedy, plain)


def _orders(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield orders of castors that differ by more than one exchange."""
    pairs = [(order.castor, order.exchanged_with) for order in CastorOrder.variants(robot)]
    alike = list(dict.fromkeys(i for pair in pairs if pair[0] == pairs[0][0] for i in pair))
    shifted = [alike[k:] + alike[:k] for k in range(len(alike))]
    orders = permutations(alike) if len(alike) <= MANY else [*shifted, *(order[::-1] for order in shifted)]
    for order in orders:
        shown, exchanges = list(alike), []
        for k, castor in enumerate(order):
            if (at := shown.index(castor)) != k:
                shown[k], shown[at] = shown[at], shown[k]
                exchanges.append(CastorOrder(castor=alike[k], exchanged_with=alike[at]))
        if len(exchanges) > 1:
            connected, described = (", ".join(map(str, castors)) for castors in (order, alike))
            what = f"the castors are connected in the order {connected}, not {described}"
            yield _by_effects(channels, what, *exchanges, plain=False)


def _many(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield mistakes that are the same on the whole robot, or on all wheels of a castor."""
    reversals, swaps = EncoderReversed.variants(robot), EncodersSwapped.variants(robot)
    wheels = [reversal for reversal in reversals if reversal.wheel is not None]
    pivots = [reversal for reversal in reversals if reversal.wheel is None]
    for what, effects in (
        ("all wheels count backwards", wheels),
        ("all pivots count backwards", pivots),
        ("the left and right encoders of every castor are swapped", swaps),
    ):
        if len(effects) > 1:
            yield _by_effects(channels, what, *effects, plain=False)
    for swap in swaps:
        both = [reversal for reversal in wheels if reversal.castor == swap.castor]
        if len(both) < len(wheels):
            yield _by_effects(channels, f"both wheels of castor {swap.castor} count backwards", *both, plain=False)
        what = f"the left and right encoder of castor {swap.castor} are swapped and both count backwards"
        yield _by_effects(channels, what, swap, *both, plain=False)


def _foreign(channels: Channels) -> Iterator[Hypothesis]:
    """Yield exchanges of two encoders of different castors, without the other encoders of these castors."""
    names, castor = channels.names, channels.castor
    for a, b in (*combinations(channels.wheels, 2), *combinations(channels.pivots, 2)):
        if castor[a] != castor[b] and castor.count(castor[a]) > 1:
            yield Hypothesis(
                f"{names[a]} and {names[b]} are exchanged",
                lambda reading, a=a, b=b: reading.exchanged((a,), (b,)),
                remedy="turn one by hand and see which counts change; exchange the columns",
            )
    for i, j in combinations(sorted({castor[k] for k in channels.wheels}), 2) if channels.pivots else ():
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
    for name, angle in TURNS.items():
        biases = [dataclasses.replace(bias, value=angle) for bias in PivotBias.variants(robot)]
        for bias in biases:
            yield _by_effects(channels, f"pivot_{bias.castor} reads {name} too much", bias)
        if len(biases) > 1:
            yield _by_effects(channels, f"all pivots read {name} too much", *biases, plain=False)


def _units(robot: RobotDescription, channels: Channels) -> Iterator[Hypothesis]:
    """Yield encoders that do not give counts."""
    wheels, pivots = channels.wheels, channels.pivots
    turns = [robot.wheels[k].counts_per_rev or 1.0 for k in robot.driven_wheels]
    turns += [robot.castors[i].pivot_counts_per_rev or 1.0 for i in robot.pivot_encoders]
    kinds = {"wheels": wheels} | ({"pivots": pivots, "wheels and pivots": wheels + pivots} if pivots else {})
    for unit, turn in UNITS.items():
        for name, of in kinds.items():
            yield Hypothesis(
                f"{name} are given in {unit}, not in counts",
                lambda reading, of=of, turn=turn: reduce(
                    lambda read, k: read.scaled((k,), turn / turns[k]), of, reading
                ),
                remedy=f"give counts: multiply by counts a turn over {turn:.5g}",
                plain=False,
            )
