"""The numbers of a robot file that calibration can find, as a vector."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription

Kind = Literal["radius", "lateral", "offset", "pivot_zero", "angle", "pivot_x", "pivot_y"]
ANGLES = ("pivot_zero", "angle")


@dataclass(frozen=True)
class Parameter:
    """One number: its kind, the index (from 0) of its castor, and of wheels the index among all of the robot's.

    name: for people. scale: unit of its changes: a length of the robot, m, or 1 rad.
    """

    kind: Kind
    castor: int
    wheel: int | None
    name: str
    scale: float

    @property
    def unit(self) -> str:
        """Unit of the number: "m" or "rad"."""
        return "rad" if self.kind in ANGLES else "m"


def parameters_of(robot: RobotDescription, pivots: bool = False) -> tuple[Parameter, ...]:
    """Return the parameters of a robot that calibration can find, in file order.

    Wheels with encoders: radius, and on castors with several wheels the lateral place. Castors with a pivot encoder:
    pivot_zero. Castors that trail: offset. Castors that are steered, and fixed ones on an omni wheel: the pivot's
    place; fixed ones on omni wheels: the angle. pivots: also the places of the pivots of castors that turn freely;
    without it they are taken as known, and the scale of a robot without reference poses rests on them.
    """
    size = _size(robot)
    found = []
    of_castor = np.array(robot.wheel_castors)
    for i, castor in enumerate(robot.castors):
        omni = castor.steering == "fixed" and any(w.grip == "omni" for w in castor.wheels)

        def add(kind: Kind, scale: float, dimension: str, wheel: int | None = None, i: int = i) -> None:
            found.append(Parameter(kind, i, wheel, f"castor {i + 1} {dimension}", scale))

        if castor.offset > 0 and castor.steering != "fixed":
            add("offset", castor.offset, "offset")
        if castor.pivot_counts_per_rev is not None:
            add("pivot_zero", 1.0, "pivot_zero")
        if omni:
            add("angle", 1.0, "angle")
        if castor.steering == "driven" or omni or (pivots and castor.steering == "free"):
            add("pivot_x", size, "pivot x")
            add("pivot_y", size, "pivot y")
        for k, wheel in zip(np.flatnonzero(of_castor == i).tolist(), castor.wheels, strict=True):
            if not wheel.driven:
                continue
            side = _side(robot, i, k)
            add("radius", wheel.radius, f"{side}radius", k)
            if len(castor.wheels) > 1:
                add("lateral", abs(wheel.lateral) or size, f"{side}lateral", k)
    return tuple(found)


def values_of(geometry: Geometry, parameters: Sequence[Parameter]) -> Array:
    """Return the parameters (P,) of a robot's geometry."""
    return np.array([getattr(geometry, _field(p))[_place(p)] for p in parameters])


def geometry_with(geometry: Geometry, parameters: Sequence[Parameter], values: Array) -> Geometry:
    """Return the geometry with other parameters; values (..., P) give it leading axes."""
    values = np.asarray(values, dtype=float)
    lead = values.shape[:-1]
    changed = {field.name: getattr(geometry, field.name) for field in fields(geometry)}
    for name in ("pivot", "offset", "pivot_zero", "angle", "lateral", "radius", "roller"):
        changed[name] = np.broadcast_to(changed[name], (*lead, *changed[name].shape)).copy()
    for p, value in zip(parameters, np.moveaxis(values, -1, 0), strict=True):
        changed[_field(p)][(..., *_place(p))] = value
    return Geometry(**changed)


def robot_with(robot: RobotDescription, parameters: Sequence[Parameter], values: Array) -> RobotDescription:
    """Return the robot file with other parameters (P,)."""
    castors = list(robot.castors)
    first = np.searchsorted(robot.wheel_castors, np.arange(len(castors)))
    for p, value in zip(parameters, values.tolist(), strict=True):
        castor = castors[p.castor]
        if p.wheel is not None:
            wheels = list(castor.wheels)
            k = p.wheel - int(first[p.castor])
            wheels[k] = replace(wheels[k], **{p.kind: value})
            castor = replace(castor, wheels=tuple(wheels))
        elif p.kind in ("pivot_x", "pivot_y"):
            x, y = castor.pivot
            castor = replace(castor, pivot=(value, y) if p.kind == "pivot_x" else (x, value))
        else:
            castor = replace(castor, **{p.kind: value})
        castors[p.castor] = castor
    return replace(robot, castors=tuple(castors))


def _field(parameter: Parameter) -> str:
    return "pivot" if parameter.kind in ("pivot_x", "pivot_y") else parameter.kind


def _place(parameter: Parameter) -> tuple[int, ...]:
    if parameter.wheel is not None:
        return (parameter.wheel,)
    axis = {"pivot_x": (0,), "pivot_y": (1,)}.get(parameter.kind, ())
    return (parameter.castor, *axis)


def _side(robot: RobotDescription, castor: int, wheel: int) -> str:
    """Return "left " and "right " on castors with two wheels, a number on others with several."""
    name = robot.wheel_names[wheel].removeprefix(f"{castor + 1}").lstrip("_")
    return {"": "", "l": "left ", "r": "right "}.get(name, f"wheel {name} ")


def _size(robot: RobotDescription) -> float:
    """Return the largest distance of a wheel's floor contact from the body's origin, m."""
    geometry = Geometry.of(robot)
    reach = np.hypot(*geometry.pivot.T) + geometry.offset
    return float(np.max(reach[geometry.wheel_castor] + np.abs(geometry.lateral)))
