"""What is allowed in a robot's or a train's file, yet hardly meant: wrong units, slips of the keyboard, odd layouts.

Each check is a function under `check`, given a robot; nothing else has to know of it. Limits are far beyond robots that
people build, so that a remark is worth reading: mines' trucks have wheels of 2 m, steel balls of mice 5 mm.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from castor_envs.errors import InputError
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from castor_envs.vehicles.train import TrainDescription
from castor_envs.vehicles.weight import wheel_loads

LARGEST_RADIUS, SMALLEST_RADIUS = 2.0, 2e-3
"""m, of wheels."""
LARGEST_ROBOT = 30.0
"""m, from the origin to a pivot or from a castor's middle to a wheel."""
LONGEST_TRAIL = 10.0
"""Wheel radii that a castor's offset is at most; shopping trolleys have 0.5, the largest of the presets 1.9."""
SHORTEST_TRAIL = 0.02
"""Wheel radii that a free castor's offset is at least; with less hardly anything turns it."""
COARSEST = 0.02
"""m of floor a count."""
COARSEST_PIVOT = 36
"""Counts a turn of a pivot encoder: 10 degrees each."""
FASTEST, SLOWEST = 40.0, 0.01
"""m/s at a wheel's rim."""
LONGEST_PERIOD, SHORTEST_PERIOD = 1.0, 1e-4
"""s, between samples."""
UNEQUAL = 5.0
"""Times that one wheel's radius is another's."""
ROUNDEST = 10.0
"""Times the radius of gyration is larger or smaller than the distance of the wheels from the origin."""
GRAVITY = 9.80665
REFUSED = "until then environments and castor-bench drive refuse it, while logs of it can be read"
"""What follows where a wheel carries no load."""

Check = Callable[[RobotDescription], Iterator["Remark"]]
_CHECKS: list[Check] = []


class Remark(NamedTuple):
    """What is odd: where, in words with castors and wheels counted from 1, and what, why, and what it should be."""

    where: str
    what: str


def remarks(vehicle: Vehicle) -> tuple[Remark, ...]:
    """Return what is hardly meant in a description; nothing of a robot or train that people build."""
    if not isinstance(vehicle, TrainDescription):
        return tuple(remark for check in _CHECKS for remark in check(vehicle))
    of_modules: dict[Remark, None] = {}
    for number, module in enumerate(vehicle.modules, start=1):
        alike = next(n for n, other in enumerate(vehicle.modules, start=1) if other.hash() == module.hash())
        if alike == number:
            of_modules |= dict.fromkeys(Remark(f"module {number}, {where}", what) for where, what in remarks(module))
    return (*of_modules, *_of_frames(vehicle))


def check(made: Check) -> Check:
    """Add a check."""
    _CHECKS.append(made)
    return made


@check
def _sizes(robot: RobotDescription) -> Iterator[Remark]:
    for where, wheel in _wheels(robot):
        if wheel.radius > LARGEST_RADIUS:
            yield Remark(where, f"radius {wheel.radius:g} m is more than any robot has{_in_metres(wheel.radius)}")
        if wheel.radius < SMALLEST_RADIUS:
            yield Remark(where, f"radius {wheel.radius:g} m is less than {1e3 * SMALLEST_RADIUS:g} mm; give metres")
        if abs(wheel.lateral) > LARGEST_ROBOT:
            yield Remark(where, f"lateral {wheel.lateral:g} m is more than any robot has{_in_metres(wheel.lateral)}")
    for where, castor in _castors(robot):
        if math.hypot(*castor.pivot) > LARGEST_ROBOT:
            far = _in_metres(max(castor.pivot, key=abs))
            yield Remark(where, f"pivot {list(castor.pivot)} m is farther out than any robot's{far}")


@check
def _trails(robot: RobotDescription) -> Iterator[Remark]:
    for where, castor in _castors(robot):
        largest = max(wheel.radius for wheel in castor.wheels)
        if castor.offset > LONGEST_TRAIL * largest:
            yield Remark(
                where,
                f"offset {castor.offset:g} m is {castor.offset / largest:.3g} wheel radii; it is the distance from the "
                "pivot back to the axle, not the castor's place on the robot, which is `pivot`",
            )
        elif castor.steering == "free" and castor.offset < SHORTEST_TRAIL * largest:
            yield Remark(where, f"offset {castor.offset:g} m is so short that hardly anything turns the free castor")


@check
def _sides(robot: RobotDescription) -> Iterator[Remark]:
    for where, castor in _castors(robot):
        lateral = [wheel.lateral for wheel in castor.wheels]
        if len(lateral) > 1 and (min(lateral) >= 0 or max(lateral) <= 0):
            yield Remark(
                where,
                f"all wheels stand to one side (lateral {lateral}); lateral is positive to the left of the castor and "
                "negative to the right, so a pair has both signs",
            )


@check
def _angles(robot: RobotDescription) -> Iterator[Remark]:
    for where, castor in _castors(robot):
        for name, angle in (("angle", castor.angle), ("pivot_zero", castor.pivot_zero)):
            if abs(angle) > 2 * math.pi:
                yield Remark(
                    where, f"{name} {angle:g} rad is over a turn; if degrees were meant: {math.radians(angle):.6g}"
                )


@check
def _encoders(robot: RobotDescription) -> Iterator[Remark]:
    for where, wheel in _wheels(robot):
        if wheel.counts_per_rev is None or wheel.radius > LARGEST_RADIUS:
            continue
        if (step := math.tau * wheel.radius / wheel.counts_per_rev) > COARSEST:
            yield Remark(
                where,
                f"counts_per_rev {wheel.counts_per_rev:g}: a count is {1e3 * step:.3g} mm of floor; give the counts of "
                "a turn of the wheel: the encoder's, times 4 if edges are counted, times the gear ratio",
            )
    for where, castor in _castors(robot):
        turn = castor.pivot_counts_per_rev
        if turn is not None and turn < COARSEST_PIVOT:
            yield Remark(where, f"pivot_counts_per_rev {turn:g}: a count is {360 / turn:.3g} degrees of the castor")
        if turn is None and castor.steering != "fixed":
            yield Remark(
                where,
                "turns and has no pivot encoder (pivot_counts_per_rev is null): estimators leave its wheels out, and "
                "no environment drives it",
            )
    if not robot.driven_wheels:
        yield Remark(
            "robot", "no wheel has an encoder (counts_per_rev is null in all): there is nothing to estimate by"
        )


@check
def _places(robot: RobotDescription) -> Iterator[Remark]:
    if len(robot.castors) > 1 and len({castor.pivot for castor in robot.castors}) == 1:
        yield Remark(
            "robot", f"all castors have their pivot at {list(robot.castors[0].pivot)}; each stands at its own place"
        )
    else:
        for number, castor in enumerate(robot.castors, start=1):
            first = next(n for n, other in enumerate(robot.castors, start=1) if other.pivot == castor.pivot)
            if first < number:
                yield Remark(f"castor {number}", f"has its pivot where castor {first} has it, {list(castor.pivot)}")


@check
def _alike(robot: RobotDescription) -> Iterator[Remark]:
    small = min(wheel.radius for wheel in robot.wheels)
    for where, wheel in _wheels(robot):
        if small * UNEQUAL < wheel.radius <= LARGEST_RADIUS:
            yield Remark(where, f"radius {wheel.radius:g} m is {wheel.radius / small:.3g} times the smallest wheel's")


@check
def _speeds(robot: RobotDescription) -> Iterator[Remark]:
    speed = robot.max_wheel_speed * max(wheel.radius for wheel in robot.wheels)
    if not SLOWEST <= speed <= FASTEST:
        rpm = "" if speed < SLOWEST else f"; if turns a minute were meant: {robot.max_wheel_speed * math.tau / 60:.4g}"
        yield Remark(
            "robot", f"max_wheel_speed {robot.max_wheel_speed:g} rad/s is {speed:.3g} m/s at the largest wheel{rpm}"
        )
    period = robot.sample_period
    if not SHORTEST_PERIOD <= period <= LONGEST_PERIOD:
        meant = f"; if milliseconds were meant: {period / 1e3:g}" if period > LONGEST_PERIOD else ""
        yield Remark("robot", f"sample_period {period:g} s{meant}")


@check
def _weight(robot: RobotDescription) -> Iterator[Remark]:
    try:
        wheel_loads(robot, GRAVITY)
    except InputError as error:
        yield Remark("robot", f"{str(error).partition(': ')[2]}; {REFUSED}")
    reach = max(math.hypot(*castor.pivot) + max(abs(w.lateral) for w in castor.wheels) for castor in robot.castors)
    gyration = math.sqrt(robot.inertia / robot.mass)
    if reach > 0 and not 1 / ROUNDEST <= gyration / reach <= ROUNDEST:
        yield Remark(
            "robot",
            f"inertia {robot.inertia:g} kg m2 and mass {robot.mass:g} kg: as if all mass were {gyration:.3g} m from "
            f"the middle, where the wheels reach {reach:.3g} m; a disc has inertia mass * radius^2 / 2",
        )


def _of_frames(train: TrainDescription) -> Iterator[Remark]:
    for name, frame in zip(train.frame_names, train.frames, strict=True):
        if frame.length > LARGEST_ROBOT:
            yield Remark(
                f"frame {name}", f"length {frame.length:g} m is more than any train has{_in_metres(frame.length)}"
            )


def _in_metres(length: float) -> str:
    return f"; lengths are in metres (if millimetres were meant: {length / 1e3:g})"


def _castors(robot: RobotDescription) -> Iterator[tuple[str, Castor]]:
    for number, castor in enumerate(robot.castors, start=1):
        yield f"castor {number}", castor


def _wheels(robot: RobotDescription) -> Iterator[tuple[str, Wheel]]:
    for name, wheel in zip(robot.wheel_names, robot.wheels, strict=True):
        yield f"wheel {name}", wheel
