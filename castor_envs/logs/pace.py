"""Whether a log's samples come at the pace that its robot file says, or its times are in another unit."""

from collections.abc import Iterator

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.recordings.recording import UNITS, TimeUnit

NAMES: dict[TimeUnit, str] = {
    "ms": "milliseconds",
    "us": "microseconds",
    "ns": "nanoseconds",
    "min": "minutes",
    "h": "hours",
    "d": "days",
}
"""Units of time that a log may be in by mistake, in words."""

UNIT_OFF, MOST_OFF = 5.0, 1e3
"""Largest factor by which the sample period in a unit may differ from the robot's: no robot file is off by as much as
from unit to unit; and by which it may be off for whatever reason."""

LONGEST_GAP = 86400.0
"""s: most between two samples, a day."""


def unit_meant(period: float, declared: float, taken: TimeUnit = "s") -> TimeUnit | None:
    """Return the unit of times that were taken for another, by their period and the declared one, s; None where no
    other unit makes these alike."""
    for unit, size in UNITS.items():
        if unit != taken and 1 / UNIT_OFF < period * size / UNITS[taken] / declared < UNIT_OFF:
            return unit
    return None


def wrong_times(t: Array, declared: float) -> Iterator[str]:
    """Yield what is wrong with times t (K,), s, that no drive of a robot with the declared sample period, s, has."""
    steps = np.diff(t)
    period, longest = float(np.median(steps)), int(np.argmax(steps))
    apart = f"samples are {period:g} s apart, and the robot file says {declared:g} s"
    if (unit := unit_meant(period, declared)) is not None:
        size = UNITS[unit] / UNITS["s"]
        remedy = f"divide t by {1 / size:g}" if size < 1 else f"multiply t by {size:g}"
        yield f"t is in {NAMES[unit]}, not in s: {apart}; {remedy}"
    elif not 1 / MOST_OFF < period / declared < MOST_OFF:
        yield f"{apart}; correct t, or sample_period"
    elif steps[longest] > LONGEST_GAP:
        at = f"row {longest + 1} (t {t[longest]:.6g} s)"
        yield f"nothing for {steps[longest]:g} s after {at}; correct t, or split the log there"
