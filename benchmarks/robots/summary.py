"""What a robot's or a train's file says, in words: its layout, what its wheels allow and show, what serves it."""

import math
from collections.abc import Iterator
from typing import Any

from castor_envs.description import InvalidDescription
from castor_envs.errors import InputError, printable, shortened
from castor_envs.logs.columns import LogColumns
from castor_envs.motion.mobility import Mobility, turned_by_motors
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.plausibility import remarks
from castor_envs.vehicles.robot import Castor, RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.registry import builtin_names

FORMAT = "castor-robot-check/1"
MM = 1e3


def findings_of(error: InputError) -> list[str]:
    """Return a line for each problem of a file that could not be read."""
    found = error.problems if isinstance(error, InvalidDescription) else [str(error)]
    return [printable(problem) for problem in found]


def as_data(vehicle: Vehicle) -> dict[str, Any]:
    """Return what a valid file says, as plain data for JSON; lengths in m; ``format`` is `FORMAT`."""
    robot = None if isinstance(vehicle, TrainDescription) else _mobility_data(vehicle)
    return {
        "format": FORMAT,
        "name": vehicle.name,
        "kind": vehicle.scope,
        "hash": vehicle.hash(),
        "valid": True,
        "remarks": [remark._asdict() for remark in remarks(vehicle)],
        "mobility": robot,
        "log_columns": _measured_columns(vehicle),
        "estimators": builtin_names(vehicle),
    }


def as_lines(vehicle: Vehicle) -> Iterator[str]:
    """Yield lines that say what a valid file says; lengths in mm, angles in degrees."""
    yield f"{shortened(vehicle.name)} ({vehicle.scope}, hash {vehicle.hash()})"
    yield from _of_train(vehicle) if isinstance(vehicle, TrainDescription) else _of_robot(vehicle)
    if vehicle.effects:
        yield f"effects: {', '.join(effect.name for effect in vehicle.effects)}"
    yield f"a log has: {', '.join(_measured_columns(vehicle))}"
    yield f"built-in estimators: {', '.join(builtin_names(vehicle)) or 'none serves it'}"


def _of_robot(robot: RobotDescription) -> Iterator[str]:
    names = list(robot.wheel_names)
    for number, castor in enumerate(robot.castors, start=1):
        own, names = names[: len(castor.wheels)], names[len(castor.wheels) :]
        yield f"castor {number}: {_castor(castor)}"
        for name, wheel in zip(own, castor.wheels, strict=True):
            side = "left" if wheel.lateral > 0 else "right"
            place = f", {MM * abs(wheel.lateral):g} mm to the {side}" if wheel.lateral else ""
            counts = "idle: no motor, no encoder"
            if wheel.counts_per_rev is not None:
                step = MM * math.tau * wheel.radius / wheel.counts_per_rev
                counts = f"{wheel.counts_per_rev:g} counts a turn, {step:.3g} mm each"
            kind = "" if wheel.grip == "standard" else f", omni, rollers at {math.degrees(wheel.roller_angle):g} deg"
            yield f"  wheel {name}: radius {MM * wheel.radius:g} mm{place}, {counts}{kind}"
    yield from _mobility(robot)


def _castor(castor: Castor) -> str:
    x, y = (MM * part for part in castor.pivot)
    parts = [f"pivot at ({x:g}, {y:g}) mm", castor.steering]
    if castor.steering == "fixed":
        parts[-1] += f" at {math.degrees(castor.angle):.4g} deg"
    if castor.offset or castor.steering != "fixed":
        parts.append(f"offset {MM * castor.offset:g} mm")
    if castor.pivot_counts_per_rev is not None:
        parts.append(
            f"{castor.pivot_counts_per_rev:g} counts a turn, {360 / castor.pivot_counts_per_rev:.3g} deg each, "
            f"zero {math.degrees(castor.pivot_zero):.4g} deg"
        )
    return ", ".join(parts)


def _of_train(train: TrainDescription) -> Iterator[str]:
    for number, module in enumerate(train.modules, start=1):
        left, right = module.wheels
        track = MM * (left.lateral - right.lateral)
        yield f"axle {number}: wheels {MM * left.radius:g} and {MM * right.radius:g} mm, {track:g} mm apart"
    for name, frame in zip(train.frame_names, train.frames, strict=True):
        gauges = ", ".join(f"{MM * place:g}" for place in frame.gauge_positions)
        yield f"frame {name}: {MM * frame.length:g} mm, gauges at {gauges} mm from its rear axle"


def _mobility(robot: RobotDescription) -> Iterator[str]:
    mobility = Mobility.of(robot)
    can = {
        3: "any direction, and turning",
        2: "two independent motions",
        1: "a single motion",
        0: "none: its fixed wheels hold it",
    }
    yield f"motion: {can[mobility.freedom]} ({mobility.freedom} of 3 degrees of freedom)"
    yield f"turns about: {_center(mobility)}"
    if not turned_by_motors(robot):
        yield "motors cannot turn its body: nothing holds it on its castor"
    if mobility.steered:
        numbers = ", ".join(str(i + 1) for i in mobility.steered)
        yield f"castors that turn first, as their offset is 0 or their wheels have rollers: {numbers}"
    errors = "errors show when encoders disagree" if mobility.redundancy else "errors show against a reference only"
    equations = f"{mobility.measured} equations for the 3 parts of a motion"
    yield f"encoders: {equations}, {mobility.redundancy} redundant: {errors}"
    if mobility.determined < 3:
        yield f"encoders do not determine the motion: only {mobility.determined} of its 3 parts"


def _center(mobility: Mobility) -> str:
    if mobility.freedom == 3:
        return "any point"
    if mobility.center is None:
        return "no point"
    point, along = mobility.center
    place = f"({MM * point[0]:.4g}, {MM * point[1]:.4g}) mm"
    if along is None:
        return f"the point {place} alone"
    bearing = math.degrees(math.atan2(along[1], along[0])) % 180.0
    return f"any point on the line through {place} at {bearing:.4g} deg from x, the line of its fixed axles"


def _mobility_data(robot: RobotDescription) -> dict[str, Any]:
    mobility = Mobility.of(robot)
    point, along = mobility.center or (None, None)
    return {
        "degrees_of_freedom": mobility.freedom,
        "center_of_rotation": None if point is None else point.tolist(),
        "center_line_direction": None if along is None else along.tolist(),
        "steered_castors": [i + 1 for i in mobility.steered],
        "equations": mobility.measured,
        "redundant": mobility.redundancy,
        "determined": mobility.determined,
    }


def _measured_columns(vehicle: Vehicle) -> list[str]:
    columns = LogColumns.of(vehicle)
    return [*columns.t, *columns.wheel, *columns.pivot, *columns.rps]
