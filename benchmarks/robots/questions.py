"""Questions whose answers make a robot file: in millimetres and degrees, as a ruler and a protractor show them."""

import math
from collections.abc import Callable
from typing import Any

import typer
from pydantic import TypeAdapter, ValidationError

from castor_envs.description import Counts, explain
from castor_envs.vehicles.presets import disc_inertia
from castor_envs.vehicles.robot import Castor, Gyro, PivotCounts, RobotDescription, Wheel

MOST_CASTORS, MOST_WHEELS = 20, 8
"""More than any robot has; so that a slip of the keyboard is not followed by a hundred questions."""

INTRODUCTION = """\
Everything that carries wheels on one axle is a castor here, whether it turns or not: a differential drive is one fixed
castor with two wheels, a swerve module a driven castor with one. Origin and axes are yours: x forward, y to the left.
Lengths in mm, angles in degrees. Enter takes what is in brackets; Ctrl-C ends without a file."""


def asked() -> RobotDescription:
    """Ask for a robot at the terminal and return it, valid; raises typer.Abort where answers end."""
    print(INTRODUCTION)
    name = _ask("name", "my robot", str)
    castors: list[Castor] = []
    for number in range(1, _ask("how many castors", 1, _whole(1, MOST_CASTORS)) + 1):
        castors.append(_until_valid(lambda n=number: _castor(n, castors)))
    return _until_valid(lambda: _whole_robot(name, tuple(castors)))


def _castor(number: int, before: list[Castor]) -> Castor:
    print(f"castor {number}")
    x, y = _ask("  pivot: x, y (mm)", "0, 0", _pair)
    place = (x / 1e3, y / 1e3)
    if before and typer.confirm(f"  otherwise like castor {number - 1}?", default=True):
        last = before[-1]
        angle = _angle() if last.steering == "fixed" else 0.0
        return Castor(**{**_parts(last), "pivot": place, "angle": angle})
    steering = _ask("  steering: free, driven (by a motor) or fixed", "fixed", _one_of("free", "driven", "fixed"))
    parts: dict[str, Any] = {"pivot": place, "steering": steering}
    if steering == "fixed":
        parts["angle"] = _angle()
    else:
        default = 50.0 if steering == "free" else 0.0
        parts["offset"] = _ask("  offset: from the pivot back to the axle (mm)", default, _number) / 1e3
        counts = _ask("  counts a turn of its pivot encoder (0: none)", 4096, _counts_as(PivotCounts))
        parts["pivot_counts_per_rev"] = counts or None
        if counts:
            question = "  angle that the encoder shows when the castor rolls forward (deg)"
            parts["pivot_zero"] = math.radians(_ask(question, 0.0, _number))
    return Castor(wheels=_wheels(), **parts)


def _angle() -> float:
    return math.radians(_ask("  angle from x to its rolling direction (deg)", 0.0, _number))


def _wheels() -> tuple[Wheel, ...]:
    number = _ask("  wheels on its axle", 2, _whole(1, MOST_WHEELS))
    if number == 2:
        half = _ask("  distance between the wheels (mm)", 300.0, _positive) / 2
        laterals = [half, -half]
    else:
        question = "  their distances to the left of the pivot, from left to right (mm)"
        laterals = _ask(question, ", ".join(["0"] * number), lambda text: _numbers(text, number))
    radius = _ask("  radius of the wheels (mm)", 75.0, _positive) / 1e3
    counts = _ask("  counts a turn of a wheel (0: idle, without encoder)", 1200, _counts_as(Counts))
    grip = _ask("  grip: standard or omni (with rollers)", "standard", _one_of("standard", "omni"))
    roller = (
        math.radians(_ask("  angle of the rollers (deg; 0 omni, 45 Mecanum)", 0.0, _number)) if grip == "omni" else 0
    )
    return tuple(
        Wheel(radius=radius, lateral=lateral / 1e3, counts_per_rev=counts or None, grip=grip, roller_angle=roller)
        for lateral in laterals
    )


def _whole_robot(name: str, castors: tuple[Castor, ...]) -> RobotDescription:
    print("the whole")
    period = _ask("  sample period (ms)", 50.0, _positive) / 1e3
    mass = _ask("  mass without the castors (kg)", 10.0, _positive)
    middle = [sum(c.pivot[k] for c in castors) / len(castors) for k in (0, 1)]
    question = "  centre of this mass: x, y (mm)"
    x, y = _ask(question, ", ".join(f"{1e3 * part + 0.0:.4g}" for part in middle), _pair)
    reach = max(math.hypot(*c.pivot) + max(abs(w.lateral) for w in c.wheels) + c.offset for c in castors)
    inertia = _ask("  inertia about the centre (kg m2)", round(disc_inertia(mass, max(reach, 0.01)), 9), _positive)
    speed = _ask("  fastest turning of a wheel (rad/s)", 20.0, _positive)
    gyro = None
    if typer.confirm("  has it a gyro?", default=False):
        gyro = Gyro(noise=_ask("  its noise, one standard deviation (rad/s)", 0.002, _not_negative))
    return RobotDescription(
        name=name,
        castors=castors,
        sample_period=period,
        mass=mass,
        inertia=inertia,
        center_of_mass=(x / 1e3, y / 1e3),
        max_wheel_speed=speed,
        gyro=gyro,
    )


def _parts(castor: Castor) -> dict[str, Any]:
    return {name: getattr(castor, name) for name in castor.__dataclass_fields__}


def _until_valid(ask: Callable[[], Any]) -> Any:
    """Return what is asked for; where the answers together are not possible, say why and ask again."""
    while True:
        try:
            return ask()
        except ValidationError as error:
            print(f"  not possible: {explain(error)}; once more")


def _ask(question: str, default: Any, read: Callable[[str], Any]) -> Any:
    """Ask until `read` takes the answer; it raises typer.BadParameter with what an answer should be."""
    return typer.prompt(question, default=default, value_proc=lambda text: read(str(text).strip()))


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise typer.BadParameter(f"expected a number, got {text!r}") from None
    if not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {text!r}")
    return value


def _positive(text: str) -> float:
    if (value := _number(text)) <= 0:
        raise typer.BadParameter(f"expected a number above 0, got {text!r}")
    return value


def _not_negative(text: str) -> float:
    if (value := _number(text)) < 0:
        raise typer.BadParameter(f"expected 0 or more, got {text!r}")
    return value


def _counts_as(kind: Any) -> Callable[[str], float]:
    """Return what reads 0, or what files take as a number of this kind."""
    accepted = TypeAdapter(kind)

    def read(text: str) -> float:
        if value := _number(text):
            try:
                accepted.validate_python(value)
            except ValidationError as error:
                raise typer.BadParameter(explain(error)) from None
        return value

    return read


def _numbers(text: str, count: int) -> list[float]:
    parts = text.replace(",", " ").split()
    if len(parts) != count:
        raise typer.BadParameter(f"expected {count} number(s), got {text!r}")
    return [_number(part) for part in parts]


def _pair(text: str) -> tuple[float, float]:
    x, y = _numbers(text, 2)
    return x, y


def _whole(least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        value = _number(text)
        if not (value.is_integer() and least <= value <= most):
            raise typer.BadParameter(f"expected a whole number from {least} to {most}, got {text!r}")
        return int(value)

    return read


def _one_of(*words: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if text not in words:
            raise typer.BadParameter(f"expected {', '.join(words[:-1])} or {words[-1]}, got {text!r}")
        return text

    return read
