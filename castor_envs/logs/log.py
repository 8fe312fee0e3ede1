"""A log: what one run of a robot or a train recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.dtypes import StringDType
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array, Numbers
from castor_envs.sensors.observation import Observations, commanded_before, increments
from castor_envs.vehicles.effect import Effect

#: The parts of a log that are always there, and those that may be None.
REQUIRED = ("t", "wheel", "pivot")
OPTIONAL = ("command", "steering_command", "reference", "gyro", "fix", "fix_age", "rps", "rps_age")
#: The type of arrays of text: 16 bytes a cell, and those of it where they are more than 15.
TEXT = StringDType()


@dataclass(frozen=True, eq=False)
class Log:
    """One run of K samples.

    t (K,), s. wheel (K, driven wheels), cumulative counts. pivot (K, pivot encoders), counts as read, maybe wrapped.
    command (K, driven wheels) and steering_command (K, driven castors), rad/s, or None. reference (K, 3): a tracker's
    x, y, psi of the body, rows of NaN where none was taken (psi alone, of a robot: positions without heading), or None.
    gyro (K,), rad/s, or None. fix (K, 3): x, y, psi of the body as an external sensor has it, NaN where there is none
    (psi alone: of the position only), and fix_age (K,), s, how long ago that was true; zeros where it is left out.
    extra: the columns that the vehicle does not have, as text (K,). undone: mistakes of wiring that are undone in these
    counts, while the controller of the run did not know of them. Arrays of any real numbers are held as float64, text
    as `TEXT`.

    Of a train of N axles and F frames: wheel and command (K, 2N), pivot (K, 0), reference (K, 3N), axle by axle. rps
    (K, 3F): x, y, phi of every frame's front axle in its rear axle's frame, NaN where a frame has no reading. rps_age
    (K, F), s: how old each frame's reading is; zeros where it is left out. Both are None for robots alone.
    """

    t: Numbers
    wheel: Numbers
    pivot: Numbers
    command: Numbers | None = None
    steering_command: Numbers | None = None
    reference: Numbers | None = None
    gyro: Numbers | None = None
    fix: Numbers | None = None
    fix_age: Numbers | None = None
    rps: Numbers | None = None
    rps_age: Numbers | None = None
    extra: Mapping[str, Sequence[str] | Numbers] = field(default_factory=dict)
    undone: tuple[Effect, ...] = ()

    def __post_init__(self):
        for part in (*REQUIRED, *OPTIONAL):
            if getattr(self, part) is not None:
                values = np.asarray(getattr(self, part), dtype=float)
                if len(values) != len(self.t):
                    raise ValueError(f"{part} has {len(values)} rows, t has {len(self.t)}")
                object.__setattr__(self, part, values)
        object.__setattr__(self, "extra", {name: np.asarray(cells, TEXT) for name, cells in self.extra.items()})
        if self.rps is not None and self.rps_age is None:
            object.__setattr__(self, "rps_age", np.zeros((len(self.t), self.rps.shape[1] // 3)))
        if self.rps is None and self.rps_age is not None:
            raise ValueError("rps_age without rps: the age of what?")
        if self.fix is not None and self.fix_age is None:
            object.__setattr__(self, "fix_age", np.zeros(len(self.t)))
        if self.fix is None and self.fix_age is not None:
            raise ValueError("fix_age without fix: the age of what?")

    def __len__(self) -> int:
        return len(self.t)

    def observations(self) -> Observations:
        """Return what an estimator sees, sample by sample: increments of counts, commands, never the reference."""
        pivot = self.pivot if self.rps is None else None
        told = [None if of is None else commanded_before(of) for of in (self.command, self.steering_command)]
        seen = {name: getattr(self, name) for name in ("gyro", "fix", "fix_age", "rps", "rps_age")}
        return Observations(increments(self.wheel), self.t, pivot, **seen, command=told[0], steering_command=told[1])


def poses_taken(log: Log) -> NDArray[np.intp]:
    """Return the rows of a robot's log in which there is a whole reference pose."""
    return np.flatnonzero(np.zeros(0) if log.reference is None else np.isfinite(log.reference).all(axis=1))


def positions_taken(log: Log) -> NDArray[np.intp]:
    """Return the rows of a log in which there is a reference position, with a heading or, of a robot, without."""
    return np.flatnonzero(np.zeros(0) if log.reference is None else np.isfinite(log.reference[:, 0]))


def pivot_jumps(count: Numbers, counts_per_rev: float) -> NDArray[np.intp]:
    """Return the indices k at which pivot counts (N,) jump, from k - 1 to k, by over half a turn.

    Counts that stay within one revolution (max - min <= counts_per_rev) may come from an encoder that wraps: a jump of
    over half a turn is then taken for a wrap, and no error can be detected. Counts that range over more do not wrap:
    such a jump is then a real change, which every reader that takes the shorter way round would get wrong.
    """
    if np.ptp(count) <= counts_per_rev:
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(np.abs(np.diff(count)) > counts_per_rev / 2) + 1


def unwrapped(count: Numbers, counts_per_rev: Array | float) -> Array:
    """Return counts (K,) or (K, s) of pivot encoders that go on where these wrap after a turn: from one row to the next
    the shorter way round."""
    steps = np.diff(count, axis=0, prepend=count[:1])
    return count[0] + np.cumsum(steps - counts_per_rev * np.round(steps / counts_per_rev), axis=0)
