"""What Doebbler's paper does not specify: every assumption of its tables with default, unit, limits and reason.

From the fields of `Assumptions` come the options of ``castor-bench tables``, their help, and the conditions that are
shown with each table.
"""

import dataclasses
import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_args

import typer

from benchmarks.tasks.kinematic import ROBOT, RUNS, Distribution
from castor_envs.errors import InputError
from castor_envs.motion.trajectories import CORNER_RADIUS, Corners, Direction, Trajectory, umbmark
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.robot import RobotDescription

SIDE = 1.5
"""Of the square, m: the paper's."""

SAMPLE_PERIOD = 0.05
"""s: the paper's 20 Hz."""


class Condition(NamedTuple):
    """What a table was computed with. unit: None for words and numbers of things."""

    name: str
    value: float | int | str
    default: float | int | str
    unit: str | None = None

    @property
    def key(self) -> str:
        """The name for programs, with its unit."""
        return self.name if self.unit is None else f"{self.name}_{self.unit.replace('/', '_').replace('%', 'percent')}"

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        shown = (f"{value:g}" if isinstance(value, float) else f"{value}" for value in (self.value, self.default))
        return "{} {}{} (default {})".format(self.name.replace("_", " "), next(shown), unit, next(shown))


#: Conditions that the paper states, for every table with squares.
GIVEN = (Condition("side", SIDE, SIDE, "m"), Condition("sample_period", SAMPLE_PERIOD, SAMPLE_PERIOD, "s"))


@dataclass(frozen=True)
class AssumptionSpec:
    """Describes an assumption: the tables that it matters to, what it means, why it has its default.

    unit: None for words and numbers of things. limits: smallest and largest value. corners: the only kind of corners
    that it matters to, or None.
    """

    tables: str
    meaning: str
    reason: str
    unit: str | None = None
    limits: tuple[float, float] | None = None
    corners: Corners | None = None


@dataclass(frozen=True)
class Assumptions:
    """A value for every assumption, in the units that people read; raises InputError for an impossible one."""

    robot: Annotated[
        str,
        AssumptionSpec(
            "Tables I to III",
            "dimensions and encoders: a preset's name or a robot file",
            "the paper prints no dimensions; castor_envs/vehicles/presets.py says how these follow",
        ),
    ] = ROBOT
    speed: Annotated[
        float,
        AssumptionSpec("Tables II, III", "speed along the sides", "slow, as UMBmark asks for", "m/s", (0.05, 5.0)),
    ] = 0.25
    acceleration: Annotated[
        float,
        AssumptionSpec(
            "Tables II, III",
            "acceleration along the sides",
            "a twentieth of gravity: little slip",
            "m/s2",
            (0.01, 50.0),
        ),
    ] = 0.5
    corners: Annotated[
        Corners,
        AssumptionSpec(
            "Tables II, III",
            "at the corners the base turns on the spot, keeps its heading, or drives quarter circles",
            "UMBmark turns on the spot; the printed percentages would fit rounded corners",
        ),
    ] = "turn"
    turn_rate: Annotated[
        float,
        AssumptionSpec(
            "Tables II, III",
            "rate of turns on the spot",
            "the castors then move about as fast as along the sides",
            "deg/s",
            (5.0, 720.0),
            corners="turn",
        ),
    ] = 45.0
    turn_acceleration: Annotated[
        float,
        AssumptionSpec(
            "Tables II, III",
            "angular acceleration of turns on the spot",
            "full rate after half a second, as along the sides",
            "deg/s2",
            (1.0, 7200.0),
            corners="turn",
        ),
    ] = 90.0
    corner_radius: Annotated[
        float,
        AssumptionSpec(
            "Table II (III keeps to the default)",
            "radius of rounded corners",
            "gives the path of 5.727 m that the printed percentages imply",
            "m",
            (0.01, 0.49 * SIDE),
            corners="rounded",
        ),
    ] = CORNER_RADIUS
    distribution: Annotated[
        Distribution,
        AssumptionSpec(
            "Tables I to III",
            "distribution of parameter errors, of Table I's mean sizes",
            "'up to 4 %' is twice the mean error of r_w, as of uniform errors",
        ),
    ] = "uniform"
    runs: Annotated[
        int, AssumptionSpec("Table II", "squares each way", "UMBmark's number, and the paper's", limits=(1, 100))
    ] = RUNS
    turns: Annotated[
        int, AssumptionSpec("Table I", "full turns about each pivot, each way", "the fewest full ones", limits=(1, 100))
    ] = 1
    distance_error: Annotated[
        float,
        AssumptionSpec(
            "Table I, last column",
            "mean size of the error of the known distances D between pivots",
            "the paper names none; rounding alone leaves less of r_w and d than it prints",
            "%",
            (0.001, 10.0),
        ),
    ] = 0.06
    robots: Annotated[
        int,
        AssumptionSpec(
            "Table III",
            "robots driven, at most as many as sets",
            "the paper has one, which says little",
            limits=(2, 1000),
        ),
    ] = 20
    seed: Annotated[
        int,
        AssumptionSpec(
            "Tables I to III",
            "of all that is random",
            "any does; with 0, set k is the tasks' case k",
            limits=(0, 10**9),
        ),
    ] = 0

    def __post_init__(self) -> None:
        """Refuse what is impossible."""
        for name, kind, default, about in _assumptions():
            value, words, known = getattr(self, name), name.replace("_", " "), get_args(kind)
            if known and value not in known:
                raise InputError(f"unknown {words} {value!r}; known: {', '.join(known)}")
            if about.limits and not about.limits[0] <= value <= about.limits[1]:
                unit = f" {about.unit}" if about.unit else ""
                least, limit = about.limits
                raise InputError(f"{words} must lie between {least:.10g} and {limit:.10g}{unit}, got {value:.10g}")
            if value != default and not self._matters(about):
                raise InputError(f"{words} matters to corners {about.corners!r} alone, and these are {self.corners!r}")
        _ = self.base

    def _matters(self, about: AssumptionSpec) -> bool:
        return about.corners in (None, self.corners)

    @functools.cached_property
    def base(self) -> RobotDescription:
        """The robot, at the paper's sample period; raises InputError unless it is a base of split castors."""
        robot, source = load_robot(self.robot), f"robot {self.robot}"
        for i, castor in enumerate(robot.castors, start=1):
            if castor.steering != "free" or castor.pivot_counts_per_rev is None:
                raise InputError(f"{source}: castor {i} must turn freely and have a pivot encoder; {_NEEDED}")
            if len(castor.wheels) != 2 or not all(w.driven and w.grip == "standard" for w in castor.wheels):
                raise InputError(f"{source}: castor {i} must have two driven wheels without rollers; {_NEEDED}")
            if not castor.wheels[0].lateral > 0 > castor.wheels[1].lateral:
                raise InputError(f"{source}: castor {i} must have a wheel on either side of its pivot; {_NEEDED}")
        if not len(robot.castors) == len({castor.pivot for castor in robot.castors}) >= 2:
            raise InputError(f"{source}: needs two castors or more, with pivots apart; {_NEEDED}")
        if robot.effects:
            raise InputError(f"{source}: has effects; tables know no errors but Table I's: leave the effects out")
        return dataclasses.replace(robot, sample_period=SAMPLE_PERIOD)

    @property
    def base_of_three(self) -> RobotDescription:
        """The same, of three castors; raises InputError for another number."""
        if len(self.base.castors) != 3:
            raise InputError(
                f"robot {self.robot}: Doebbler's Tables II and III leave out one castor of three, and it has "
                f"{len(self.base.castors)}; choose another, or --table doebbler-1"
            )
        return self.base

    def square(self, direction: Direction) -> Trajectory:
        """Return the square that is driven."""
        return umbmark(
            direction,
            self.corners,
            side=SIDE,
            speed=self.speed,
            acceleration=self.acceleration,
            turn_speed=math.radians(self.turn_rate),
            turn_acceleration=math.radians(self.turn_acceleration),
            corner_radius=self.corner_radius,
        )

    def used(self, names: tuple[str, ...]) -> tuple[Condition, ...]:
        """Return the named conditions, without those that do not matter at these corners."""
        return tuple(
            Condition(name, getattr(self, name), default, about.unit)
            for name, _, default, about in _assumptions()
            if name in names and self._matters(about)
        )

    def changed(self) -> tuple[str, ...]:
        """Return the names of the assumptions that are not the default ones."""
        return tuple(name for name, _, default, _ in _assumptions() if getattr(self, name) != default)


@functools.cache
def _assumptions() -> tuple[tuple[str, Any, Any, AssumptionSpec], ...]:
    """Return name, type, default and description of every assumption."""
    return tuple(
        (field.name, kind, field.default, about)
        for field in dataclasses.fields(Assumptions)
        for kind, about in [get_args(field.type)]
    )


_NEEDED = "the tables are of bases on castors with two driven wheels and a pivot encoder each"

#: Assumptions of both Tables II and III.
OF_SQUARES = ("robot", "speed", "acceleration", "corners", "turn_rate", "turn_acceleration", "distribution", "seed")


def option_name(name: str) -> str:
    """Return the option of the command line that sets an assumption."""
    return f"--{name.replace('_', '-')}"


def with_assumptions(command: Callable[..., None]) -> Callable[..., None]:
    """Replace a command's parameter `assumptions` by an option for each assumption."""

    def option(name: str, kind: Any, default: Any, about: AssumptionSpec) -> inspect.Parameter:
        unit = f", {about.unit}" if about.unit else ""
        known = f": {' | '.join(get_args(kind))}" if get_args(kind) else ""
        text = f"{about.tables}: {about.meaning}{unit}{known}. Reason: {about.reason}."
        asked = Annotated[str if get_args(kind) else kind, typer.Option(option_name(name), help=text)]
        return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=asked)

    @functools.wraps(command)
    def with_options(**given: Any) -> None:
        assumed = {name: given.pop(name) for name, *_ in _assumptions()}
        command(**given, assumptions=Assumptions(**assumed))

    parameters = [
        parameter for name, parameter in inspect.signature(command).parameters.items() if name != "assumptions"
    ]
    parameters = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    signature = inspect.Signature([*parameters, *(option(*assumption) for assumption in _assumptions())])
    setattr(with_options, "__signature__", signature)  # noqa: B010
    return with_options
