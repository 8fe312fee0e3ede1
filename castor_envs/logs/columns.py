"""The columns of a robot's or a train's logs: their names, and whether a header has them."""

import difflib
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from castor_envs.logs.table import complaint
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.train import TrainDescription

#: Names of a header that an error lists: more than any robot of the presets needs.
SHOWN = 20
#: Columns that may be left out beside others of their part: of positions without a heading.
HEADINGS = ("ref_psi", "fix_psi")
_OTHER_PROGRAM = "; castor-bench import makes a log of a recording by another program"


class LogColumns(NamedTuple):
    """The names of a vehicle's log columns, part by part, each in the order of the same part of a `Log`."""

    t: tuple[str, ...]
    wheel: tuple[str, ...]
    pivot: tuple[str, ...]
    command: tuple[str, ...]
    steering_command: tuple[str, ...]
    reference: tuple[str, ...]
    gyro: tuple[str, ...]
    fix: tuple[str, ...]
    fix_age: tuple[str, ...]
    rps: tuple[str, ...]
    rps_age: tuple[str, ...]

    @classmethod
    def of(cls, vehicle: Vehicle) -> "LogColumns":
        """Return the column names of a robot's or a train's logs."""
        if isinstance(vehicle, TrainDescription):
            return cls._of_train(vehicle)
        robot = vehicle
        driven = [robot.wheel_names[k] for k in robot.driven_wheels]
        return cls(
            t=("t",),
            wheel=tuple(f"wheel_{name}" for name in driven),
            pivot=tuple(f"pivot_{i + 1}" for i in robot.pivot_encoders),
            command=tuple(f"cmd_{name}" for name in driven),
            steering_command=tuple(f"cmd_pivot_{i + 1}" for i in robot.driven_castors),
            reference=("ref_x", "ref_y", "ref_psi"),
            gyro=("gyro_z",),
            fix=("fix_x", "fix_y", "fix_psi"),
            fix_age=("fix_age",),
            rps=(),
            rps_age=(),
        )

    @classmethod
    def _of_train(cls, train: TrainDescription) -> "LogColumns":
        return cls(
            t=("t",),
            wheel=tuple(f"wheel_{name}" for name in train.wheel_names),
            pivot=(),
            command=tuple(f"cmd_{name}" for name in train.wheel_names),
            steering_command=(),
            reference=tuple(f"ref_{i + 1}_{part}" for i in range(train.n_axles) for part in ("x", "y", "psi")),
            gyro=(),
            fix=(),
            fix_age=(),
            rps=tuple(f"rps_{frame}_{part}" for frame in train.frame_names for part in ("x", "y", "phi")),
            rps_age=tuple(f"rps_age_{frame}" for frame in train.frame_names),
        )

    @property
    def known(self) -> set[str]:
        """All names."""
        return {name for part in self for name in part}

    def check_header(self, path: Path, line: int, names: Sequence[str]) -> None:
        """Raise InputError for unnamed, duplicate or missing columns.

        t, wheels and pivots are required; each other part needs all of its columns, but for `HEADINGS`, or none.
        """
        if len(names) == 1:
            message = f"the header has a single column; separate columns by commas{_OTHER_PROGRAM}"
            raise complaint(path, line, None, message)
        known = self.known
        if not known.intersection(names):
            message = f"no column of a log is in the header, which has {listed(names)}{_OTHER_PROGRAM}"
            raise complaint(path, line, None, message)
        places: dict[str, int] = {}
        for k, name in enumerate(names):
            if not name.strip():
                message = f"the column at place {k + 1} has no name; name or remove it"
                raise complaint(path, line, None, message)
            first = places.setdefault(name, k)
            if first < k:
                message = f"appears twice, at places {first + 1} and {k + 1}; rename or remove one"
                raise complaint(path, line, name, message)
        for name in names:
            if name in known or not self._foreign(name):
                continue
            message = "belongs to a train of other axles than given; give the robot or train that made the log"
            raise complaint(path, line, name, message)
        for age, of in ((self.rps_age, self.rps), (self.fix_age, self.fix)):
            ages = [name for name in age if name in names]
            if ages and not any(name in names for name in of):
                raise complaint(path, line, ages[0], f"is the age of {of[0]!r} and the others, which are missing")
        missing = self._missing(names)
        if missing:
            raise complaint(path, line, missing[0], f"is missing; {self._hint(missing, names)}")

    def _missing(self, names: Sequence[str]) -> list[str]:
        """Return the columns that a header lacks."""
        return [
            name
            for part, expected in self._asdict().items()
            if part in ("t", "wheel", "pivot") or any(name in names for name in expected)
            for name in expected
            if name not in (*names, *HEADINGS)
        ]

    def _foreign(self, name: str) -> bool:
        """Return whether an unknown column is one of trains, where this vehicle is a robot or a shorter train."""
        train = re.fullmatch(r"rps_(age_)?[A-J](_x|_y|_phi)?|ref_\d+_(x|y|psi)", name) is not None
        return train or (bool(self.rps) and re.fullmatch(r"wheel_\d+[lr]", name) is not None)

    @staticmethod
    def check_castors(path: Path, line: int, names: Sequence[str], vehicle: Vehicle) -> None:
        """Raise InputError for encoders of castors that a robot does not have."""
        if isinstance(vehicle, TrainDescription):
            return
        for name in names:
            encoder = re.fullmatch(r"(?:wheel|pivot)_(\d+)(?:[lr]|_\d+)?", name)
            if encoder is not None and int(encoder[1]) > len(vehicle.castors):
                message = f"{vehicle.name!r} has no castor {int(encoder[1])}; give the robot that made the log"
                raise complaint(path, line, name, message)

    def _hint(self, missing: Sequence[str], names: Sequence[str]) -> str:
        """Return what to do about missing columns: where each has a similar name in the header, it may be called so."""
        known, given = self.known, "give the robot or train that made the log"
        unknown = {name.lower(): name for name in names if name not in known}
        near = {name for column in missing for name in _nearest(column, unknown)}
        if len(near) == len(missing):
            return f"did you mean {unknown[_nearest(missing[0], unknown)[0]]!r}? rename it, or {given}"
        other = "" if known.intersection(names) - {"t"} else _OTHER_PROGRAM
        return f"the header has {listed(names)}; add the column, or {given}{other}"


def _nearest(missing: str, unknown: Collection[str]) -> list[str]:
    """Return the name most similar to a missing column's, none where none is similar."""
    return difflib.get_close_matches(missing, unknown, n=1, cutoff=0.4 if missing == "t" else 0.6)


def listed(names: Sequence[str]) -> str:
    """Return column names as text; of more than `SHOWN`, the first ones and the number of all."""
    ending = f", ... ({len(names)} columns)" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + ending
