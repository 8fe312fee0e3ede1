"""Units that a channel's name or its format says, and what is taken where neither does."""

import re
from collections.abc import Mapping

from castor_envs.logs.mapping.places import words_of
from castor_envs.logs.mapping.units import LENGTHS, RATE, ROW
from castor_envs.logs.recordings.recording import Found
from castor_envs.logs.unit_words import WORDS

_MOTOR = re.compile(r"(?<![A-Za-z])[mM]\d")
"""A motor's name, such as ``M1``, whose letter is no unit."""

_IN_RADIANS = re.compile(r"(^| )(position|velocity)\[|\.(angle|heading)$")
"""Joints of ROS and angles of WPILib's structs, whose units their definitions say."""

_DEFINED = re.compile(_IN_RADIANS.pattern + r"|\.(x|y|distance|speed)$|angular_velocity\.z$")
"""These, and what else messages and structs define: m, m/s, rad/s."""


def says_unit(name: str, unit: str) -> bool:
    """Return whether a channel's name, or the definition of its message or struct, says that it has this unit."""
    if _DEFINED.search(name):
        return True
    base = unit.removesuffix(RATE).removesuffix(ROW)
    return bool(_words(name) & WORDS.get(base, {base})) or (base == "deg" and in_degrees(name))


def in_degrees(name: str) -> bool:
    """Return whether a name says that an angle or a turning is in degrees."""
    return "°" in name or bool(WORDS["deg"] & words_of(name))


def angle_unit(channel: str, found: Mapping[str, Found], per: str) -> str:
    """Return the unit of an encoder that its format or name says; or that its numbers suggest: whole ones are counts.

    per: "/s" for a speed, else "".
    """
    if _IN_RADIANS.search(channel):
        return "rad" + per
    if channel.endswith(".speed") and channel.removesuffix("speed") + "angle" in found:  # WPILib's SwerveModuleState
        return "m/s"
    given = _words(channel)
    if "°" in channel:
        return "deg" + per
    for unit, words in (*WORDS.items(), ("m", {"distance"})):
        if given & words:
            return unit if unit == "rpm" else unit + per
    if given & {"enc", "encoder", "encoders"}:
        return ("counts" if channel not in found or found[channel].whole or not found[channel].count else "m") + per
    return ("counts" if channel in found and found[channel].whole else "rad") + per


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
