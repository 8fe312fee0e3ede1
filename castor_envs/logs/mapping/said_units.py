"""Units that a channel's name or its format says, and what is taken where neither does."""

import re
from collections.abc import Iterable, Mapping

from castor_envs.logs.mapping.places import words_of
from castor_envs.logs.mapping.units import LENGTHS, RATE, ROW
from castor_envs.logs.recordings.recording import Found
from castor_envs.logs.unit_words import WORDS

SPEED = {"velocity", "velocities", "vel", "v", "omega", "speed", "speeds", "rpm", "mps", "dps", "cps"}
_ENCODER = {"enc", "encoder", "encoders"}

_PER_SECOND = re.compile(
    r"(°|deg|rad|rev|rot|tick|count|m)(s|rees|ians|ations|eters|etres)?[ _]?(/|_|per)[ _]?s(ec)?(?![a-z\d])"
)
"""A unit of speed in a name, such as ``deg/s``, ``m_s`` and ``ticks per sec``."""

_MOTOR = re.compile(r"(?<![A-Za-z])[mM]\d")
"""A motor's name, such as ``M1``, whose letter is no unit."""

_DEFINED = (
    (re.compile(r"(^| )position\[|\.(angle|heading)$"), "rad"),
    (re.compile(r"(^| )velocity\[|angular_velocity\.z$"), "rad/s"),
    (re.compile(r"\.(x|y|distance)$"), "m"),
    (re.compile(r"\.speed$"), "m/s"),
)
"""Names by the definitions of messages of ROS and of structs of WPILib, which say these units."""


def _defined(name: str) -> str | None:
    """Return the unit by the definition of a message or struct whose field a name looks like, None for others."""
    return next((unit for pattern, unit in _DEFINED if pattern.search(name)), None)


def says_unit(name: str, unit: str) -> bool:
    """Return whether a channel's name, or the definition of its message or struct, says that it has this unit."""
    if _defined(name) == unit:
        return True
    base = unit.removesuffix(RATE).removesuffix(ROW)
    return bool(_words(name) & WORDS.get(base, {base})) or (base == "deg" and in_degrees(name))


def says_speed(name: str) -> bool:
    """Return whether a channel's name says a speed, unless its message or struct is defined to hold an angle."""
    return _defined(name) != "rad" and bool(SPEED & words_of(name) or _PER_SECOND.search(name.lower()))


def in_degrees(name: str) -> bool:
    """Return whether a name says that an angle or a turning is in degrees."""
    return "°" in name or bool(WORDS["deg"] & words_of(name))


def angle_unit(channel: str, found: Mapping[str, Found], per: str, alike: Iterable[str] = ()) -> str:
    """Return the unit of an encoder that its format or name says; or that its numbers suggest: whole ones are counts.

    per: "/s" for a speed, else "". alike: channels of the other encoders of its kind, whose unit is the same.
    """
    if (defined := _defined(channel)) in ("rad", "rad/s"):
        return "rad" + per
    if defined == "m/s" and channel.removesuffix("speed") + "angle" in found:  # WPILib's SwerveModuleState
        return "m/s"
    read = [found[name] for name in (channel, *alike) if name in found]
    whole = all(one.whole or not one.count for one in read)
    given = _words(channel)
    if "°" in channel:
        return "deg" + per
    for unit, words in (*WORDS.items(), ("m", {"distance"})):
        if given & words:
            return unit if unit == "rpm" else unit + per
    counts = whole and (channel in found or bool(given & _ENCODER))
    return ("counts" if counts else "m" if given & (_ENCODER | {"v"}) else "rad") + per


def rate_unit(name: str, found: Mapping[str, Found]) -> str:
    """Return the unit of a command: what its name states, or else rad/s."""
    unit = angle_unit(name, found, "/s")
    return unit if unit != "counts/s" or WORDS["counts"] & words_of(name) else "rad/s"


def length_in(name: str) -> float:
    """Return how many metres the unit of length in a name is, 1 without one."""
    return next((metres for unit, metres in LENGTHS.items() if unit in words_of(name)), 1.0)


def _words(name: str) -> set[str]:
    """Return the words of a name that may be units."""
    return words_of(name) - ({"m"} if _MOTOR.search(name) else set())
