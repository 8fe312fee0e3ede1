"""Where on a robot a wheel or a pivot is, by its place in the robot file and by what a channel's name says."""

import re
from collections.abc import Collection

import numpy as np

from castor_envs.description import FINEST
from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.mapping.channel_map import UNDECIDED, ChannelMap
from castor_envs.vehicles.robot import RobotDescription

FORE = ({"front", "fl", "fr", "lf", "rf"}, {"rear", "back", "rl", "rr", "bl", "br", "lr", "lb", "rb"})
"""Words for what is before and behind the middle of a robot; of one with a front, "lr" is left and rear."""

PLAIN = ({"left", "l"}, {"right", "r"})
SHORT = ({"fl", "rl", "bl", "lf", "lr", "lb"}, {"fr", "rr", "br", "rf", "rb"})
"""Words for what is to the left and to the right, alone and with what is before and behind."""

SIDE = (PLAIN[0] | SHORT[0], PLAIN[1] | SHORT[1])
SAID = set().union(*FORE, *PLAIN, *SHORT)

_NUMBER = re.compile(r"(?<!\d)\d{1,4}(?!\d)")
"""A number in a name; longer ones are none of a castor."""

NEAR = 0.1
"""What is nearer to the middle than this part of the farthest is neither before nor behind, neither left nor right."""


def words_of(name: str) -> set[str]:
    """Return the words and numbers in a name, in lower case; ``leftWheel_2`` has left, wheel and 2."""
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name)}


def _side(given: set[str], words: tuple[set[str], set[str]]) -> int:
    """Return 1 or -1 for words of the first or of the second kind, 0 for none or both."""
    return int(bool(given & words[0])) - int(bool(given & words[1]))


def _signs(at: Array) -> list[int]:
    """Return 1, -1 or 0 for each coordinate: which side of the middle it is on."""
    off = at - at.mean()
    return (
        np.where(np.abs(off) > max(NEAR * np.abs(off).max(initial=0.0), FINEST), np.sign(off), 0).astype(int).tolist()
    )


class Places:
    """The places of a robot's castors and wheels, as (1, 0 or -1: front or rear; 1, 0 or -1: left or right).

    Of wheels, where castors with two of them stand beside each other, left and right are those of the castor. names:
    all channels, which tell whether their numbers begin at 0. only: columns that are the only ones of their kind.
    """

    def __init__(self, robot: RobotDescription, names: Collection[str] = ()) -> None:
        columns = LogColumns.of(robot)
        self.only = {names[0] for names in (columns.wheel, columns.pivot) if len(names) == 1}
        self._numbered: dict[str, set[int]] = {}
        for name in names:
            for number in _NUMBER.finditer(name):
                self._numbered.setdefault(name[: number.start()], set()).add(int(number[0]))
        pivots = np.array([castor.pivot for castor in robot.castors])
        self.castors = list(zip(*(_signs(axis) for axis in pivots.T), strict=True))
        self._beside = any(side for _, side in self.castors)
        wheels = pivots[list(robot.wheel_castors)]
        if not self._beside:
            wheels = wheels + np.array([[0.0, wheel.lateral] for wheel in robot.wheels])
        places = zip(*(_signs(axis) for axis in wheels.T), strict=True)
        self._of = {f"wheel_{name}": place for name, place in zip(robot.wheel_names, places, strict=True)}
        self._of |= {f"pivot_{i}": place for i, place in enumerate(self.castors, 1)}

    def agreement(self, key: str, name: str) -> int:
        """Return how much a channel's name speaks for the place of a column: 2 for each word, -4 against it."""
        given, said = words_of(name), 0
        within = key[-1] in "lr"
        of_castor = SHORT if within and self._beside else SIDE
        place = self._of.get(key.replace("cmd_pivot_", "pivot_").replace("cmd_", "wheel_"), (0, 0))
        for axis, words in enumerate((FORE, of_castor)):
            stated = _side(given, words)
            if stated and any(other[axis] for other in self._of.values()):
                said += 2 if stated == place[axis] else -4
        if within and self._beside and (stated := _side(given, PLAIN)):
            said += 2 if stated == (1 if key[-1] == "l" else -1) else -4
        return said

    def says_castor(self, name: str) -> bool:
        """Return whether a name says which castor it is of, by its place."""
        given = words_of(name)
        return any(
            _side(given, words) != 0 and any(place[axis] for place in self.castors)
            for axis, words in enumerate((FORE, SIDE))
        )

    def numbers(self, name: str) -> set[int]:
        """Return the numbers in a name, counted from 1 on: those from 0 on, in brackets as of arrays or by the names of
        all channels, which begin alike and go on with 0 and 1 and not the number of castors, are raised by 1."""
        for number in _NUMBER.finditer(name):
            before, alike = name[: number.start()], self._numbered.get(name[: number.start()], set())
            in_brackets = before.endswith("[") and name[number.end() :].startswith("]")
            if in_brackets or ({0, 1} <= alike and len(self.castors) not in alike):
                return {int(number[0]) + 1}
        return {int(number) for number in _NUMBER.findall(name)}

    def remark(self, by: ChannelMap) -> str | None:
        """Return what to say of a first map that takes castors by numbers in names, None where there is nothing; no
        castor is taken for another that is the only one with wheels, or with pivots, to be read."""
        channels = set[str]()
        for kind in ("wheel_", "pivot_"):
            columns = {key: column for key, column in by.columns.items() if key.startswith(kind)}
            if len({_NUMBER.findall(key)[0] for key in columns}) > 1:
                channels |= {name for key, column in columns.items() for name in column.channels if name != key}
        if all(self.says_castor(name) for name in channels - {UNDECIDED}):
            return None
        named = [
            " ".join(filter(None, (("", "front", "rear")[fore], ("", "left", "right")[side]))) or "in the middle"
            for fore, side in self.castors
        ]
        return (
            f"castors are taken in the order of the robot file: {', '.join(named)}; no name says their places, so "
            "check that the recording has the same order"
        )
