"""Hypotheses of the pre-flight: gross mistakes, and what each does to a log.

Mistakes are linear. A row of a log is a vector: the counts of all encoders, in the order of
`estimators.likelihood.channels.Channels`, the reference's x, y and psi, and 1. The reading of a log with a mistake is
the matrix that makes it of the row without. So an inverse undoes a mistake, and mistakes together are a product.
"""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from pydantic import ValidationError

from castor_envs.effects.dimensions import CountsPerRev, PivotBias
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from estimators.likelihood.channels import Channels

TURNS = {"half a turn": math.pi, "a quarter turn": math.pi / 2, "minus a quarter turn": -math.pi / 2}
UNITS = {"radians": math.tau, "degrees": math.degrees(math.tau)}
"""Of encoders: what a turn is in them."""

MM, CM, DEGREES, REVERSED = 1000.0, 100.0, UNITS["degrees"] / UNITS["radians"], -1.0
MIRROR = "the reference is seen in a mirror (y to the right, ref_psi clockwise)"
BOTH = "divide ref_x and ref_y by 1000, multiply ref_psi by pi/180"
REFERENCE = (
    ("ref_x and ref_y are in millimetres", "divide them by 1000", {"x": MM, "y": MM}),
    ("ref_x and ref_y are in centimetres", "divide them by 100", {"x": CM, "y": CM}),
    ("ref_psi is in degrees", "multiply it by pi/180", {"psi": DEGREES}),
    ("ref_x and ref_y were in metres and are divided by 1000", "multiply them by 1000", {"x": 1 / MM, "y": 1 / MM}),
    ("ref_psi was in radians and is multiplied by pi/180", "multiply it by 180/pi", {"psi": 1 / DEGREES}),
    ("ref_psi runs clockwise", "change its sign", {"psi": REVERSED}),
    (MIRROR, "change the signs of ref_y and ref_psi", {"y": REVERSED, "psi": REVERSED}),
    ("the reference is in millimetres and degrees", BOTH, {"x": MM, "y": MM, "psi": DEGREES}),
)
"""Of the reference: mistake, remedy, and factors."""

POSITIONS = (
    *(mistake for mistake in REFERENCE if "psi" not in mistake[2]),
    ("the reference is seen in a mirror (y to the right)", "change the sign of ref_y", {"y": REVERSED}),
)
"""The same of positions without headings."""


@dataclass(frozen=True, eq=False)
class Misreading:
    """A mistake in how logs were read.

    what: its name. reading: see above. remedy: what to do. effects: equivalent ones, if there are any. gross: whether
    it is told here; false: it only competes, and what effects of the catalogue are there is looked for later.
    """

    what: str
    reading: Array
    remedy: str
    effects: tuple[Effect, ...] = ()
    gross: bool = True


def reading_of(robot: RobotDescription, effects: Sequence[Effect]) -> Array:
    """Return the reading (c + 4, c + 4) of a log with effects of wiring, or turned pivots, made in this order."""
    built = robot.as_built()
    channels = Channels(built)
    c, s = len(channels.names), len(channels.sensed)
    probes, reading = np.eye(c + 1, c, k=-1), np.eye(c + 4)
    for effect in effects:
        made = np.eye(c + 4)
        if isinstance(effect, PivotBias):
            k = list(channels.sensed).index(effect.castor - 1)
            made[k, -1] = effect.value * channels.per_rev[k] / math.tau
        else:
            log = Log(np.arange(c + 1.0), wheel=probes[:, s:], pivot=probes[:, :s])
            seen = channels.read(built.with_effects(effect), log, probes)
            made[:c, :c], made[:c, -1] = (seen[1:] - seen[0]).T, seen[0]
        reading = made @ reading
    return reading


class Table:
    """The mistakes that are considered for a robot.

    nominal: the reading of a log without any. wiring: those of encoders at one place, which may come together with
    others. all: these, and all others but wrong counts a turn (`scaled`). places: encoders that may share these, their
    columns and their name. pivots: number of columns of pivots, which come first.
    """

    def __init__(self, robot: RobotDescription, headed: bool = True) -> None:
        """headed: whether the reference has headings."""
        self._robot, self._channels = robot, (channels := Channels(robot))
        self._reference = REFERENCE if headed else POSITIONS
        self.pivots, self.nominal = len(channels.sensed), np.eye(len(channels.names) + 4)
        of_castor = channels.geometry.wheel_castor[channels.driven] + 1
        groups = {f"the wheels of castor {i}": np.flatnonzero(of_castor == i) + self.pivots for i in of_castor}
        pivots, wheels = np.split(np.arange(len(channels.names)), [self.pivots])
        self._kinds = {kind: of for kind, of in (("wheels", wheels), ("pivots", pivots)) if len(of)}
        self.places: dict[tuple[int, ...], str] = {(k,): name for k, name in enumerate(channels.names)}
        for name, of in ({f"all {kind}": of for kind, of in self._kinds.items()} | groups).items():
            self.places.setdefault(tuple(of.tolist()), name)
        of_effects = []
        for what, effects in self._effects():
            if effects:
                remedy = effects[0].check[0].lower() + effects[0].check[1:].rstrip(".")
                of_effects.append(Misreading(what, reading_of(robot, effects), remedy, tuple(effects)))
        self.wiring = [mistake for mistake in of_effects if len(mistake.effects) == 1 and mistake.effects[0].wiring]
        self.all = [*of_effects, *self._exchanged(), *self._units()]

    def multiplied(self, columns: Sequence[int], factor: float | Array) -> Array:
        """Return the reading of a log some of whose columns are multiplied."""
        reading = self.nominal.copy()
        reading[list(columns), list(columns)] = factor
        return reading

    def scaled(self, columns: tuple[int, ...], factor: float, gross: bool) -> Misreading:
        """Return the mistake that encoders give `factor` times the counts per turn in the robot file."""
        effects: tuple[Effect, ...] = ()
        if columns[0] < self.pivots:
            key = "pivot_counts_per_rev"
            remedy = f"turn the castor once around by hand, read its counts, and correct {key}"
        else:
            described = np.unique(self._channels.per_rev[list(columns)])
            right = " and ".join(f"{counts * factor:.5g} for {counts:g}" for counts in described)
            key, remedy = "counts_per_rev", f"give counts_per_rev {right} (or correct radius, gear or unit)"
            counts = CountsPerRev.variants(self._robot)
            with contextlib.suppress(ValidationError):  # of a factor beyond what such an effect can be
                effects = tuple(dataclasses.replace(counts[k - self.pivots], value=factor - 1) for k in columns)
        what = f"the counts of {self.places[columns]} are {factor:.3g} times what {key} says"
        return Misreading(what, self.multiplied(columns, factor), remedy, effects, gross)

    def turned(self, pivot: int, angle: float) -> Misreading:
        """Return that a pivot's zero, of the encoder in this column, is off by an angle, rad."""
        castor = int(self._channels.sensed[pivot]) + 1
        effect = PivotBias(castor=castor, value=angle)
        what = f"the zero of pivot_{castor} is off by {angle:.2g} rad"
        return Misreading(what, reading_of(self._robot, [effect]), "", (effect,), gross=False)

    def _effects(self) -> Iterator[tuple[str, Sequence[Effect]]]:
        """Yield mistakes and the effects that make them: at one place, then the same at many, if there are any."""
        robot = self._robot
        swaps, orders = EncodersSwapped.variants(robot), CastorOrder.variants(robot)
        reversals, biases = EncoderReversed.variants(robot), PivotBias.variants(robot)
        names = np.roll(self._channels.names, -len(biases)).tolist()  # wheels before pivots
        for swap in swaps:
            yield f"the left and right encoder of castor {swap.castor} are swapped", [swap]
        for name, reversal in zip(names, reversals, strict=True):
            yield f"{name} counts backwards", [reversal]
        for order in orders:
            yield f"castors {order.castor} and {order.exchanged_with} are exchanged", [order]
        castors = [order.exchanged_with for order in orders if order.castor == orders[0].castor]
        castors = [order.castor for order in orders[:1]] + castors
        for k, way in product(range(len(castors)), (1, -1)):
            order = (castors[k:] + castors[:k])[::way]
            connected, described = (", ".join(map(str, each)) for each in (order, castors))
            what = f"the castors are connected in the order {connected}, not {described}"
            yield what, list(_exchanges(castors, order))
        wheels = [reversal for reversal in reversals if reversal.wheel is not None]
        yield "all wheels count backwards", wheels
        yield "all pivots count backwards", reversals[len(wheels) :]
        yield "the left and right encoders of every castor are swapped", swaps
        for swap in swaps:
            both = [reversal for reversal in wheels if reversal.castor == swap.castor]
            yield f"both wheels of castor {swap.castor} count backwards", both
            what = f"the left and right encoder of castor {swap.castor} are swapped and both count backwards"
            yield what, [swap, *both]
        for name, angle in TURNS.items():
            turned = [dataclasses.replace(bias, value=angle) for bias in biases]
            for bias in turned:
                yield f"pivot_{bias.castor} reads {name} too much", [bias]
            yield f"all pivots read {name} too much", turned

    def _exchanged(self) -> Iterator[Misreading]:
        """Yield exchanges of two wheels' or two pivots' encoders, or those of all wheels of two castors."""
        for (first, name), (second, other) in combinations(self.places.items(), 2):
            if len(first) == len(second) and (first[0] < self.pivots) == (second[0] < self.pivots):
                reading = self.nominal.copy()
                reading[[*first, *second]] = self.nominal[[*second, *first]]
                remedy = "turn one wheel or castor by hand and see which counts change; exchange the columns"
                yield Misreading(f"{name} and {other} are exchanged", reading, remedy)

    def _units(self) -> Iterator[Misreading]:
        """Yield encoders that do not give counts, and references in other units or axes."""
        kinds = self._kinds | {" and ".join(self._kinds): np.concatenate(list(self._kinds.values()))}
        for unit, turn in UNITS.items():
            for name, columns in kinds.items():
                reading = self.multiplied(columns.tolist(), turn / self._channels.per_rev[columns])
                remedy = f"give counts: multiply by counts a turn over {turn:.5g}"
                yield Misreading(f"{name} are given in {unit}, not in counts", reading, remedy)
        for what, remedy, by in self._reference:
            columns = [{"x": -4, "y": -3, "psi": -2}[part] for part in by]
            yield Misreading(what, self.multiplied(columns, np.array(list(by.values()))), remedy)


def _exchanges(shown: Sequence[int], order: Sequence[int]) -> Iterator[CastorOrder]:
    """Yield the exchanges of two castors each that bring castors into an order."""
    shown, castors = list(shown), shown
    for k, castor in enumerate(order):
        if (at := shown.index(castor)) != k:
            shown[k], shown[at] = shown[at], shown[k]
            yield CastorOrder(castor=castors[k], exchanged_with=castors[at])
