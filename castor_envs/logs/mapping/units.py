"""Units of a recording's numbers, and what makes numbers of a log from them.

wheel_...       counts, rev, deg, rad, m (rolled by a wheel of the robot file's radius); the same a second (rad/s
                ..., rpm), which are summed over time; the same a row (counts/row ...), which are added up
pivot_...       counts, rev, deg, rad
cmd_...         rad/s, deg/s, rev/s, rpm, counts/s; of wheels m/s
gyro_z          rad/s, deg/s; as the angle that a gyro has summed rad, deg, rev
ref_x, ref_y    m, cm, mm; so are fix_x and fix_y
ref_psi         rad, deg, quaternion; so is fix_psi; both may be left out beside positions
"""

import math

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
TURN = {"rev": 1.0, "deg": 360.0, "rad": 2 * math.pi}
"""A whole turn in units of an angle."""

ANGLES = ("counts", "rev", "deg", "rad")
GYRO_ANGLES = ("rad", "deg", "rev")
RATE, ROW = "/s", "/row"


def units_of(part: str, name: str) -> tuple[str, ...]:
    """Return the units that a column may have, by the part of the log and the column's name."""
    match part:
        case "wheel":
            turned = (*ANGLES, "m")
            return (*turned, *(unit + RATE for unit in turned), "rpm", *(unit + ROW for unit in turned))
        case "pivot":
            return ANGLES
        case "command":
            return ("rad/s", "deg/s", "rev/s", "rpm", "counts/s", "m/s")
        case "steering_command":
            return ("rad/s", "deg/s", "rev/s", "rpm", "counts/s")
        case "gyro":
            return ("rad/s", "deg/s", *GYRO_ANGLES)
        case _:
            return ("rad", "deg", "quaternion") if name.endswith("_psi") else tuple(LENGTHS)


def kind_of(unit: str) -> str:
    """Return what a wheel's numbers are: "position", "speed", or "increment" from row to row."""
    return "speed" if unit.endswith(RATE) or unit == "rpm" else "increment" if unit.endswith(ROW) else "position"


def counts_in(unit: str, counts_per_rev: float, radius: float | None = None) -> float:
    """Return how many counts of an encoder one unit is, a second or a row where the unit is of such."""
    if unit == "rpm":
        return counts_per_rev / 60
    angle = unit.removesuffix(RATE).removesuffix(ROW)
    if angle == "counts":
        return 1.0
    turn = TURN | ({} if radius is None else {"m": 2 * math.pi * radius})
    return counts_per_rev / turn[angle]


def radians_in(unit: str, counts_per_rev: float = math.nan, radius: float | None = None) -> float:
    """Return how many radians one unit of an angle is, or rad/s one of a rate."""
    if unit.removesuffix(RATE) == "counts":
        return 2 * math.pi / counts_per_rev
    return counts_in(unit, 2 * math.pi, radius)
