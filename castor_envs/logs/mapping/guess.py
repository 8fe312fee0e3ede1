"""A first map of a recording, from its channels' names and numbers; what these do not tell stays undecided."""

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter

from castor_envs.logs.columns import LogColumns
from castor_envs.logs.mapping.channel_map import UNDECIDED, ChannelMap, Column, Source
from castor_envs.logs.mapping.places import SAID, Places, words_of
from castor_envs.logs.mapping.said_units import SPEED, angle_unit, in_degrees, length_in, rate_unit, says_speed
from castor_envs.logs.mapping.units import LENGTHS
from castor_envs.logs.recordings.recording import Clock, Found
from castor_envs.logs.unit_words import WORDS
from castor_envs.vehicles.robot import RobotDescription

HEADING = {"heading", "psi", "yaw", "theta", "phi"}
WHEEL = {"wheel", "wheels", "enc", "encoder", "encoders", "tick", "ticks", "count", "counts", "position", "distance"}
STEERED = {"steer", "steering", "pivot", "swivel", "azimuth", "fork", "caster", "castor"}
PIVOT = STEERED | {"turn", "angle"}
COMMANDED = {"cmd", "command", "commands", "commanded", "target", "setpoint", "desired"}
RATE = SPEED | {"rate", "per", "s", "sec"}
UNITS = {"s"}.union(*WORDS.values())
BARE = (UNITS - WORDS["counts"]) | {"ms", "us", "ns"}
"""Words that alone, or with the number of a column, are a unit and name nothing."""
NEVER = {"effort", "torque", "current", "voltage", "volts", "temperature", "covariance", "heading"}
TRUSTED = {"truth", "gt", "ground", "mocap", "vicon", "optitrack", "qualisys", "tracker", "ref", "reference", "opti"}
LOCATED = {"prism", "leica", "gps", "gnss", "rtk", "utm", "uwb", "easting", "northing"}
"""Words of positions that are a reference without a heading; one beside them that never changes is none."""

ESTIMATED = {"odom", "odometry", "amcl", "estimate", "estimated", "filtered", "ekf"}
"""Words of poses that are estimates, which are no reference."""

MAPPED = {"east", "north", "easting", "northing", "height", "latitude", "longitude", "altitude"}
PLACED = {"x", "y", "z", "w", "qx", "qy", "qz", "qw", "roll", "pitch"} | HEADING | MAPPED
BODY = PLACED | {"vx", "vy", "vz", "dx", "dy", "dtheta", "omega"}
"""Words of the pose and the motion of a body, which no wheel has."""
COORDINATES = {"x": {"x", "easting"}, "y": {"y", "northing"}, "heading": HEADING}
"""Words of the coordinates of a pose."""

_OF_POSE = re.compile(r"\.(x|y|z|heading)$")
MOVED = SPEED | {"pos", "position", "distance", "angle"}
ENCODER = {"wheel", "wheels", "enc", "encoder", "encoders", "tick", "ticks"}
DRIVE = {"drive", "driven", "traction"}
"""Words for a driven wheel, in names that say beside them where it is and what is measured, and nothing else."""

MEASURED = MOVED | ENCODER | UNITS | {"motor", "joint"}

_PLACE = re.compile(r"(\d+)([lr])?$")
"""The number and the side in the name of a log's column."""

_JOINT = re.compile(r"(?:^| )((?:position|velocity)\[.*\])$")
"""What names a joint of ROS in a channel: ``velocity[left]`` of whatever topic."""

RECEIVED = "received"
"""Source of channels of ROS whose messages have no time in a header, but that of their receipt."""

FEW_TURNS = 4 * math.pi
"""rad: an angle that is larger is taken for degrees, if nothing says its unit."""

ENOUGH = 3
"""Score from which a channel is taken: a side or a number, and a word, speak for it."""


def guess_map(found: Mapping[str, Found], clock: Clock, robot: RobotDescription) -> ChannelMap:
    """Return a map of all columns that a robot's log needs, and of those that it may have where a channel's name fits.

    Where none fits, a needed one is `UNDECIDED`, in the unit of the others of its kind if there are any. Channels that
    never change are taken only where no others fit.
    """
    columns, free, places = LogColumns.of(robot), dict(found), Places(robot, found)
    own = {key: unit for key, unit in _log_units(columns).items() if key in free and _is_own(key, places)}
    guessed = {key: Column(channel=key, unit=unit) for key, unit in own.items()}
    free = {name: channel for name, channel in free.items() if name not in guessed}
    for names, words in ((columns.pivot, PIVOT), (columns.wheel, WHEEL)):
        wanted = [key for key in names if key not in guessed]
        alike = _alike(wanted, _live(free), words, places) or _alike(wanted, free, words, places)
        for key in wanted:
            channel = alike.get(key) or _best(key, _live(free), words, places)
            if channel == UNDECIDED:
                channel = _best(key, free, words, places)
            unit = angle_unit(channel, found, "/s" if says_speed(channel) else "", alike.values())
            guessed[key] = Column(channel=channel, unit=unit, scale=length_in(channel) if unit[0] == "m" else 1.0)
            free.pop(channel, None)
        chosen = [guessed[key] for key in names if guessed[key].channel != UNDECIDED]
        sibling = chosen[0] if chosen else Column(channel=UNDECIDED, unit=UNDECIDED)
        undecided = [key for key in wanted if guessed[key].channel == UNDECIDED]
        guessed |= dict.fromkeys(undecided, replace(sibling, channel=UNDECIDED))
    commanded = {key: _best(key, free, COMMANDED, places) for key in columns.command if key not in guessed}
    if commanded and UNDECIDED not in commanded.values() and len({*commanded.values()}) == len(commanded):
        guessed |= {key: Column(channel=name, unit=rate_unit(name, found)) for key, name in commanded.items()}
    gyros = [name for name in free if _is_gyro(name)]
    gyros.sort(key=lambda name: (not _live({name: free[name]}), _is_angle(name)))  # what changes, and rates, first
    if gyros and columns.gyro[0] not in guessed:
        angle = _is_angle(gyros[0])
        turned = angle and _most(found[gyros[0]]) > FEW_TURNS
        unit = ("deg" if turned or in_degrees(gyros[0]) else "rad") + ("" if angle else "/s")
        guessed[columns.gyro[0]] = Column(channel=gyros[0], unit=unit)
    if columns.reference[0] not in guessed:
        guessed |= _reference(columns.reference, free)
    ordered = {key: guessed[key] for part in columns for key in part if key in guessed}
    sources = {"main": Source.of(clock)}
    for key, column in ordered.items():
        if any(name in found and not found[name].stamped for name in column.channels):
            sources[RECEIVED], ordered[key] = Source(time="receive"), replace(column, source=RECEIVED)
    return ChannelMap(columns=ordered, sources=sources)


def possible_wheels(found: Iterable[str]) -> list[str]:
    """Return the channels that may be a wheel's, whatever they are called: all but poses and motions of a body, as of
    trackers, odometry, TF and IMUs, commands, and quantities that are no motion. A side, as of ``omega_left``, makes it
    a wheel's, unless it is that of a topic or of a pose."""
    return [name for name in found if _may_be_wheel(name)]


def is_estimate(words: Collection[str]) -> bool:
    """Return whether a pose is the robot's own, computed or commanded, by the words of its channel's name."""
    return bool({*words} & (ESTIMATED | COMMANDED)) and not {*words} & TRUSTED


def lacks_heading(columns: Mapping[str, Column]) -> bool:
    """Return whether a map's reference has no heading, though its positions are no receiver's and no prism's."""
    positions = [name for key in ("ref_x", "ref_y") if key in columns for name in columns[key].channels]
    return bool(positions) and "ref_psi" not in columns and not any(words_of(name) & LOCATED for name in positions)


def _may_be_wheel(name: str) -> bool:
    given = words_of(name)
    if given & ENCODER:
        return True
    never = NEVER - {"current"} if given & MOVED else NEVER  # the current position is no current
    if given & (COMMANDED | never) or _is_gyro(name) or given - UNITS in ({"e"}, {"n"}):
        return False
    own = name.partition(" ")[2] if name.startswith("/") else name  # without the topic of ROS
    return not given & BODY or (bool(words_of(own) & SAID) and not _OF_POSE.search(name))


def _live(found: Mapping[str, Found]) -> dict[str, Found]:
    """Return the channels that change."""
    return {name: channel for name, channel in found.items() if channel.low != channel.high}


def _log_units(columns: LogColumns) -> dict[str, str]:
    """Return the columns of a log and their units, for files that have them already."""
    units = {"wheel": "counts", "pivot": "counts", "command": "rad/s", "steering_command": "rad/s", "gyro": "rad/s"}
    named = {key: unit for part, unit in units.items() for key in getattr(columns, part)}
    return named | dict(zip(columns.reference, ("m", "m", "rad"), strict=True))


def _is_own(key: str, places: Places) -> bool:
    """Return whether a channel that is called like a log's column is that; ``wheel_1`` beside ``wheel_0`` is not."""
    match = _PLACE.search(key)
    return match is None or int(match[1]) in places.numbers(key)


def _best(key: str, free: Iterable[str], words: set[str], places: Places) -> str:
    """Return the channel whose name speaks best for a column, `UNDECIDED` where none does."""
    scored = [(_score(key, name, words, places), name) for name in free]
    best = max((score for score, _ in scored), default=0)
    return next(name for score, name in scored if score == best) if best >= ENOUGH else UNDECIDED


def _alike(keys: Sequence[str], free: Iterable[str], words: set[str], places: Places) -> dict[str, str]:
    """Return a channel for each of these columns, of names that differ in sides and numbers only; none if no such names
    fit all columns."""
    families: dict[frozenset[str], dict[str, tuple[int, str]]] = {}
    for key in keys:
        for name in free:
            if (score := _score(key, name, words, places)) >= ENOUGH:
                family = families.setdefault(frozenset(w for w in words_of(name) - SAID if not w.isdigit()), {})
                family[key] = max(family.get(key, (0, "")), (score, name), key=itemgetter(0))
    whole = [family for family in families.values() if len({name for _, name in family.values()}) == len(keys)]
    best = max(whole, key=lambda family: sum(score for score, _ in family.values()), default={})
    return {key: name for key, (_, name) in best.items()}


def _score(key: str, name: str, words: set[str], places: Places) -> int:
    if name.endswith(".heading") and words_of(name.rpartition("/")[2]) & PIVOT:  # a struct that is a rotation alone
        name = name.removesuffix(".heading")
    given = words_of(name)
    if given <= BARE | {word for word in given if word.isdigit()}:
        return 0
    if given & NEVER or (words is not COMMANDED and given & COMMANDED) or _is_gyro(name):
        return 0
    if words is PIVOT and says_speed(name):  # a pivot's angle is needed
        return 0
    match = _PLACE.search(key)
    number, side = (int(match[1]), match[2]) if match else (0, None)
    joint = _JOINT.search(name)
    alone = words_of(joint[1]) if joint else given
    last = words_of(joint[1] if joint else name.rpartition("/")[2])
    plain = {word for word in last if not word.isdigit()} <= DRIVE | MEASURED | SAID | words
    drives = bool(last & DRIVE) and (plain or bool(given & SPEED)) and not last & STEERED
    if words is PIVOT and drives:
        return 0
    of_wheel = words is WHEEL and (alone <= SAID | SPEED | UNITS or name.endswith(".speed") or drives)
    score = 2 if given & words or of_wheel else 0
    score += 1 if key in places.only and plain and last & (STEERED if words is PIVOT else DRIVE) else 0
    if words is WHEEL:
        score -= 4 if given & STEERED else 0
        score -= 3 if "angle" in given and not (drives or "wheel" in given) else 0
        score += 1 if given & SPEED else 0
        score += 1 if "wheel" in given else 0
        if score <= 0:
            return 0
        score += 1 if not given & SPEED else -1
    if score <= 0:
        return 0
    score += places.agreement(key, name)
    if not places.says_castor(name) and (len(places.castors) > 1 or side is None):
        numbers = places.numbers(name)
        score += 2 if number in numbers else -2 if numbers else 0
    return score


def _is_gyro(name: str) -> bool:
    given = words_of(name)
    turning = {"gyro"} & given or {"yaw", "rate"} <= given or {"angular", "velocity"} <= given
    return bool(turning) and not given & (ESTIMATED | COMMANDED | {"x", "y", "linear"})


def _is_angle(gyro: str) -> bool:
    """Return whether a gyro's name says the angle that it has summed, such as the yaw, and not a rate."""
    given = words_of(gyro)
    return bool(given & (HEADING | {"angle"})) and not given & RATE


def _most(channel: Found) -> float:
    """Return the largest size of what a channel holds."""
    return max(abs(channel.low), abs(channel.high))


def _reference(names: tuple[str, ...], found: Mapping[str, Found]) -> dict[str, Column]:
    """Return the columns of the pose that most looks like a tracker's, or else of such a position without a heading; of
    odometry's poses none."""
    poses: dict[frozenset[str], dict[str, str]] = {}
    for channel in found:
        given = words_of(channel)
        part = next((part for part, words in COORDINATES.items() if given & words), None)
        if part is not None:
            other = {"x", "y", "pos", "position", *LENGTHS, "rad", "deg", *HEADING}
            words = frozenset({"northing" if word == "easting" else word for word in given} - other)
            poses.setdefault(words, {})[part] = channel
    live, fitting = _live(found), dict[frozenset[str], dict[str, str]]()
    for words, parts in poses.items():
        if words & LOCATED and parts.get("heading") not in live:
            parts.pop("heading", None)
        needed = {"x", "y"} if words & (LOCATED | TRUSTED) else {"x", "y", "heading"}
        if needed <= set(parts) and not is_estimate(words):
            fitting[words] = parts
    if not fitting:
        return {}
    chosen = max(
        fitting.items(),
        key=lambda pose: ("heading" in pose[1], any(p in live for p in pose[1].values()), bool(pose[0] & TRUSTED)),
    )[1]
    units = [next((unit for unit in LENGTHS if unit in words_of(chosen[part])), "m") for part in ("x", "y")]
    if (heading := chosen.get("heading")) is not None:
        units.append("deg" if in_degrees(heading) or _most(found[heading]) > FEW_TURNS else "rad")
    return {
        key: Column(channel=chosen[part], unit=unit) for key, part, unit in zip(names, COORDINATES, units, strict=False)
    }
