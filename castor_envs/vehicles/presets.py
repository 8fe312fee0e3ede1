"""Robots and trains to start from, and the one home of every number that no paper gives.

A preset is a function under `named`: nothing else has to know of it.

Assumptions, and why:

- ASOC dimensions. Doebbler prints none but the encoder steps (0.3 and 0.07 deg), 20 Hz and 300 kg. The one-third
  prototype here has pivot radius R = 0.24 m, offset r_c = 72 mm, wheel radius 38.1 mm (3 inch wheels) and half track
  d = 58 mm: Table I's calibrated errors of r_c and beta follow from r_c / D near 0.16, and this gives 0.173. The
  full-scale base is three times as large in every length.
- Encoders with whole counts a turn: 1200 (0.3 deg) and 5143 (0.07 deg).
- Masses and inertias: an 18 kg chassis as a disc of 0.3 m radius, castors of 1.5 kg; full scale 250 kg and 16.7 kg
  each, 300 kg together. Wheel inertia: a solid disc.
- Contact: friction 0.8 (rubber on a hard floor), slip stiffness 80 a unit of load, so that 0.5 m/s2 (a force of 5 %
  of the load) costs 0.06 % slip; relaxation length 1 cm, the order of a wheel's contact patch.
- OmniMate: Borenstein's two trucks, here as two free castors with two wheels each; dimensions of a
  LabMate-sized truck.
- The differential robot is LabMate-sized (wheel radius 75 mm, track 340 mm: Borenstein and Feng's robot), the
  tricycle of the same scale. Their support castors carry nothing.
- Powered caster: pivots, wheel radius and offsets as TidyBot++ has them; masses, encoders and motors are
  assumed.
- Omni-wheel robot: distance, wheels and encoders as the OptiOdom data have them (0.195 m, 102 mm, 12 * 1024 counts a
  turn). Assumed: a 10 kg chassis as a disc of 0.2 m radius, for the wheels stand at its rim; 1 kg for each wheel with
  its motor, 0.4 kg of it turning; 20 rad/s (1 m/s; the data show 4 rad/s) and 1 N m, which starts the robot at over
  2 m/s2 in any direction.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import TypeVar

from castor_envs.errors import InputError, did_you_mean
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from castor_envs.vehicles.train import MOST_AXLES, Frame, TrainDescription

Make = TypeVar("Make", bound=Callable[..., RobotDescription | TrainDescription])

WHEEL_COUNTS = 1200.0
PIVOT_COUNTS = 5143
FRAME_LENGTH = 0.35
HALF_TRACK = 0.16

_PRESETS: dict[str, Callable[[], RobotDescription | TrainDescription]] = {}


def named(name: str, numbers: Iterable[int] = ()) -> Callable[[Make], Make]:
    """Make a function a preset: what it returns without arguments is known as `name` wherever a vehicle is asked for.

    With `numbers`, `name` has a place for one of them, as in ``"{}-castor"``, and the function is given it.
    """

    def register(make: Make) -> Make:
        for number in numbers:
            _register(name.format(number), partial(make, number))
        if not numbers:
            _register(name, make)
        return make

    return register


def _register(name: str, make: Callable[[], RobotDescription | TrainDescription]) -> None:
    if name in _PRESETS:
        raise ValueError(f"two presets are named {name!r}; rename one")
    _PRESETS[name] = make


def disc_inertia(mass: float, radius: float) -> float:
    """Return the spin inertia of a solid disc, kg m2."""
    return 0.5 * mass * radius**2


def pair(half_track: float, radius: float, mass: float, counts_per_rev: float | None) -> tuple[Wheel, Wheel]:
    """Return a left and a right wheel at +-half_track, solid discs of `mass` each; None is an idle pair."""
    inertia = disc_inertia(mass, radius)
    return (
        Wheel(lateral=half_track, radius=radius, inertia=inertia, counts_per_rev=counts_per_rev),
        Wheel(lateral=-half_track, radius=radius, inertia=inertia, counts_per_rev=counts_per_rev),
    )


def split_castor(pivot: tuple[float, float], scale: float = 1.0, mass: float = 1.5) -> Castor:
    """Return an active split-offset castor (ASOC) of the one-third prototype, or of `scale` times its lengths."""
    return Castor(
        pivot=pivot,
        offset=0.072 * scale,
        mass=mass,
        inertia=mass * (0.06 * scale) ** 2,
        pivot_counts_per_rev=PIVOT_COUNTS,
        wheels=pair(0.058 * scale, 0.0381 * scale, mass / 5, WHEEL_COUNTS),
    )


@named("asoc-prototype")
def asoc_prototype() -> RobotDescription:
    """Return the one-third prototype on three ASOCs (Doebbler V)."""
    return dataclasses.replace(n_castor(3), name="ASOC prototype, one-third scale")


@named("asoc-full-scale")
def asoc_full_scale() -> RobotDescription:
    """Return the 300 kg base on three ASOCs, three times the prototype's lengths (Doebbler II.A)."""
    angles = [2 * math.pi * i / 3 for i in range(3)]
    return RobotDescription(
        name="ASOC full scale, 300 kg",
        mass=250.0,
        inertia=disc_inertia(250.0, 0.9),
        max_wheel_speed=15.0,
        max_wheel_torque=40.0,
        castors=tuple(split_castor((0.72 * math.cos(a), 0.72 * math.sin(a)), scale=3.0, mass=50.0 / 3) for a in angles),
    )


@named("{}-castor", range(1, 7))
def n_castor(n: int) -> RobotDescription:
    """Return a base on n ASOCs (1 to 6), evenly on a circle of 0.24 m; castor 1 on the x axis (Doebbler II.C)."""
    if not 1 <= n <= 6:
        raise InputError(f"an n-castor base has 1 to 6 castors, got {n}")
    if n == 1:
        pivots = [(0.0, 0.0)]
    else:
        angles = [2 * math.pi * i / n for i in range(n)]
        pivots = [(0.24 * math.cos(angle), 0.24 * math.sin(angle)) for angle in angles]
    return RobotDescription(
        name=f"{n}-castor base",
        mass=6.0 * n,
        inertia=disc_inertia(6.0 * n, 0.3),
        max_wheel_speed=20.0,
        max_wheel_torque=1.0,
        castors=tuple(split_castor(pivot) for pivot in pivots),
    )


@named("omnimate")
def omnimate() -> RobotDescription:
    """Return a base on two split castors in line, OmniMate-like."""
    front, rear = (
        Castor(
            pivot=(x, 0.0),
            offset=0.05,
            mass=12.0,
            inertia=0.3,
            pivot_counts_per_rev=PIVOT_COUNTS,
            wheels=pair(0.17, 0.075, 1.5, 2000.0),
        )
        for x in (0.45, -0.45)
    )
    return RobotDescription(
        name="two-castor base, OmniMate-like",
        mass=60.0,
        inertia=8.0,
        max_wheel_speed=15.0,
        max_wheel_torque=8.0,
        castors=(front, rear),
    )


@named("differential")
def differential(radius: float = 0.075, track: float = 0.34, counts_per_rev: float = 2000.0) -> RobotDescription:
    """Return a robot with two driven wheels on one axle; by default LabMate-sized."""
    return RobotDescription(
        name="differential drive, LabMate-sized",
        mass=40.0,
        inertia=2.5,
        max_wheel_speed=15.0,
        max_wheel_torque=6.0,
        castors=(
            Castor(
                pivot=(0.0, 0.0),
                steering="fixed",
                mass=6.0,
                inertia=0.1,
                wheels=pair(track / 2, radius, 1.0, counts_per_rev),
            ),
        ),
    )


@named("tricycle")
def tricycle() -> RobotDescription:
    """Return a robot with one driven and steered front wheel and two idle rear wheels; origin at the rear axle."""
    radius = 0.075
    return RobotDescription(
        name="tricycle",
        mass=30.0,
        inertia=2.0,
        center_of_mass=(0.2, 0.0),
        max_wheel_speed=15.0,
        max_wheel_torque=6.0,
        max_steering_speed=3.0,
        max_steering_torque=10.0,
        castors=(
            Castor(
                pivot=(0.5, 0.0),
                steering="driven",
                mass=3.0,
                inertia=0.02,
                pivot_counts_per_rev=PIVOT_COUNTS,
                wheels=(Wheel(radius=radius, inertia=disc_inertia(1.0, radius), counts_per_rev=2000.0),),
            ),
            Castor(
                pivot=(0.0, 0.0),
                steering="fixed",
                mass=3.0,
                inertia=0.05,
                wheels=pair(0.17, radius, 1.0, None),
            ),
        ),
    )


def _four_modules(name: str, radius: float, offset: float, lateral: float) -> RobotDescription:
    corners = ((0.19015, 0.17015), (-0.19015, 0.17015), (-0.19015, -0.17015), (0.19015, -0.17015))
    wheel = Wheel(radius=radius, lateral=lateral, inertia=disc_inertia(0.4, radius), counts_per_rev=4096.0)
    return RobotDescription(
        name=name,
        mass=30.0,
        inertia=1.5,
        max_wheel_speed=20.0,
        max_wheel_torque=3.0,
        max_steering_speed=12.0,
        max_steering_torque=4.0,
        castors=tuple(
            Castor(
                pivot=corner,
                steering="driven",
                offset=offset,
                mass=1.5,
                inertia=0.004,
                pivot_counts_per_rev=4096,
                wheels=(wheel,),
            )
            for corner in corners
        ),
    )


@named("powered-caster")
def powered_caster() -> RobotDescription:
    """Return a base on four powered casters, TidyBot++-like: driven steering, one wheel each, with an offset."""
    return _four_modules("four powered casters, TidyBot++-like", radius=0.0508, offset=0.014, lateral=-0.00375)


@named("swerve")
def swerve() -> RobotDescription:
    """Return a swerve drive: four driven-steering modules whose wheels stand under their pivots."""
    return _four_modules("four swerve modules", radius=0.0508, offset=0.0, lateral=0.0)


@named("omni3")
def omni3(
    distance: float = 0.195,
    radii: tuple[float, float, float] = (0.051, 0.051, 0.051),
    counts_per_rev: float = 12.0 * 1024,
) -> RobotDescription:
    """Return a robot on three omni wheels `distance` from its origin: right front, left front, rear.

    Each wheel rolls around the origin; where all counts rise, the robot turns clockwise, seen from above.
    """
    castors = tuple(
        Castor(
            pivot=(distance * math.cos(bearing), distance * math.sin(bearing)),
            steering="fixed",
            angle=bearing - math.pi / 2,
            inertia=0.001,
            wheels=(
                Wheel(radius=radius, inertia=disc_inertia(0.4, radius), counts_per_rev=counts_per_rev, grip="omni"),
            ),
        )
        for bearing, radius in zip((-math.pi / 3, math.pi / 3, math.pi), radii, strict=True)
    )
    return RobotDescription(
        name="three omni wheels",
        mass=10.0,
        inertia=disc_inertia(10.0, 0.2),
        max_wheel_speed=20.0,
        max_wheel_torque=1.0,
        castors=castors,
    )


def axle_module(half_track: float = HALF_TRACK) -> RobotDescription:
    """Return one differential axle module."""
    robot = differential(track=2 * half_track)
    return dataclasses.replace(
        robot,
        name="axle module",
        mass=3.0,
        inertia=0.03,
        max_wheel_torque=3.0,
        max_wheel_speed=10.0,
        castors=(dataclasses.replace(robot.castors[0], mass=2.0, inertia=0.03),),
    )


@named("cfmmr-{}", range(2, MOST_AXLES + 1))
def cfmmr(n: int = 3) -> TrainDescription:
    """Return a train of n axles (2 to 10) like the CFMMR."""
    if not 2 <= n <= MOST_AXLES:
        raise InputError(f"a train has 2 to {MOST_AXLES} axles, got {n}")
    return TrainDescription(
        name=f"CFMMR, {n} axles", modules=(axle_module(),) * n, frames=(Frame(length=FRAME_LENGTH),) * (n - 1)
    )


def preset_names(kind: type[RobotDescription] | type[TrainDescription] = RobotDescription) -> tuple[str, ...]:
    """Return the names of all presets of robots, or of trains."""
    return tuple(name for name in _PRESETS if isinstance(any_preset(name), kind))


def train_names() -> tuple[str, ...]:
    """Return the names of all presets of trains."""
    return preset_names(TrainDescription)


def preset(name: str) -> RobotDescription:
    """Return a preset robot by name; raises InputError for any other name."""
    known = any_preset(name) if name in _PRESETS else None
    if not isinstance(known, RobotDescription):
        raise InputError(f"unknown robot {name!r}{did_you_mean(name, preset_names())}")
    return known


@cache
def any_preset(name: str) -> RobotDescription | TrainDescription:
    """Return a preset robot or train by name; raises InputError for any other name."""
    if name not in _PRESETS:
        raise InputError(f"unknown robot or train {name!r}{did_you_mean(name, _PRESETS)}")
    return _PRESETS[name]()
