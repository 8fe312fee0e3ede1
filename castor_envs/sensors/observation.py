"""What an estimator sees of one sample: the one place where observations are built, live, from logs, and stacked.

Of a robot "wheel" (driven wheels,), counts since the sample before (0 in the first); "pivot" (pivot encoders,),
absolute counts; "time" (1,), s; "gyro" (1,), rad/s, where there is one. Of a train "wheel" as above, axle by axle;
"rps" (3 F,), x, y (m), phi (rad) of every frame's front axle in its rear axle's frame, NaN where there is no reading;
"rps_age" (F,), s since that reading was taken; and "time". Never the truth.

From logs that have them also "fix" (3,), x, y (m), psi (rad) of the body as an external sensor has it, NaN where this
sample has none or it has no heading, and "fix_age" (1,), s since that was true; and "command" (driven wheels,) and
"steering_command" (driven castors,), rad/s: what the motors were told in the period that led to this sample, 0 in the
first, NaN where the log has a blank. The environments leave them to `info`: some agents are those who command.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Numbers

Observation = dict[str, Numbers]

OPTIONAL = ("pivot", "gyro", "fix", "fix_age", "rps", "rps_age", "command", "steering_command")
"""The parts of `Observations` that may be None."""


def increments(counts: ArrayLike) -> Numbers:
    """Return the counts since the sample before (K, ...), 0 in the first, from cumulative counts (K, ...)."""
    counts = np.asarray(counts, dtype=float)
    return np.diff(counts, axis=0, prepend=counts[:1])


def commanded_before(command: ArrayLike) -> Numbers:
    """Return commands (K, ...) of the periods that begin at rows as those of the periods that end there: 0 first."""
    command = np.asarray(command, dtype=float)
    return np.concatenate([np.zeros_like(command[:1]), command[:-1]])


def observation(
    wheel: ArrayLike,
    time: ArrayLike,
    *,
    pivot: ArrayLike | None = None,
    gyro: ArrayLike | None = None,
    fix: ArrayLike | None = None,
    fix_age: ArrayLike | None = None,
    rps: ArrayLike | None = None,
    rps_age: ArrayLike | None = None,
    command: ArrayLike | None = None,
    steering_command: ArrayLike | None = None,
) -> Observation:
    """Return one observation, its arrays copied; parts that are None are left out.

    wheel (..., driven wheels): increments of counts. time, gyro and fix_age (...): a number for each robot of a stack.
    pivot (..., pivot encoders). fix (..., 3). rps (..., 3 F) and rps_age (..., F). command (..., driven wheels) and
    steering_command (..., driven castors): of the period that led to it.
    """
    parts = {
        "wheel": wheel,
        "pivot": pivot,
        "rps": rps,
        "rps_age": rps_age,
        "time": np.asarray(time)[..., None],
        "gyro": None if gyro is None else np.asarray(gyro)[..., None],
        "fix": fix,
        "fix_age": None if fix_age is None else np.asarray(fix_age)[..., None],
        "command": command,
        "steering_command": steering_command,
    }
    return {name: np.array(values, dtype=float) for name, values in parts.items() if values is not None}


def copied(given: Observation) -> Observation:
    """Return an observation whose arrays are its own: whoever is given it may write into it."""
    return {name: values.copy() for name, values in given.items()}


@dataclass(frozen=True, eq=False)
class Observations:
    """All observations of a run of K samples, or of several alike along leading axes. Iterating yields the samples.

    wheel (..., K, driven wheels): increments of counts. time (..., K), s. pivot (..., K, pivot encoders), gyro (...,
    K), fix (..., K, 3), fix_age (..., K), rps (..., K, 3 F), rps_age (..., K, F), command (..., K, driven wheels),
    steering_command (..., K, driven castors), both of the period that led to each sample: None where there are none.
    """

    wheel: Numbers
    time: Numbers
    pivot: Numbers | None = None
    gyro: Numbers | None = None
    fix: Numbers | None = None
    fix_age: Numbers | None = None
    rps: Numbers | None = None
    rps_age: Numbers | None = None
    command: Numbers | None = None
    steering_command: Numbers | None = None

    @classmethod
    def of(cls, samples: Sequence[Observation]) -> "Observations":
        """Return the observations of single samples, one or more, that all have the same parts."""
        parts = {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}
        flat = {name: parts.pop(name)[..., 0] for name in ("time", "gyro", "fix_age") if name in parts}
        return cls(**parts, **flat)

    @classmethod
    def stack(cls, members: Sequence["Observations"]) -> "Observations":
        """Return the observations of runs of equal length and layout along one new leading axis."""

        def stacked(name: str) -> Numbers | None:
            parts = [getattr(member, name) for member in members]
            return None if any(part is None for part in parts) else np.stack(parts)

        wheel, time = (np.stack([getattr(member, name) for member in members]) for name in ("wheel", "time"))
        return cls(wheel, time, **{name: stacked(name) for name in OPTIONAL})

    def copied(self) -> "Observations":
        """Return the same with arrays of their own, for whoever may write into them."""
        parts = {name: None if (part := getattr(self, name)) is None else part.copy() for name in OPTIONAL}
        return Observations(self.wheel.copy(), self.time.copy(), **parts)

    def __len__(self) -> int:
        return self.time.shape[-1]

    def __iter__(self) -> Iterator[Observation]:
        return (self.at(k) for k in range(len(self)))

    def at(self, k: int) -> Observation:
        """Return observation k, its arrays copied."""

        def sample(values: Numbers | None) -> Numbers | None:
            return None if values is None else values[..., k, :]

        return observation(
            self.wheel[..., k, :],
            self.time[..., k],
            pivot=sample(self.pivot),
            gyro=None if self.gyro is None else self.gyro[..., k],
            fix=sample(self.fix),
            fix_age=None if self.fix_age is None else self.fix_age[..., k],
            rps=sample(self.rps),
            rps_age=sample(self.rps_age),
            command=sample(self.command),
            steering_command=sample(self.steering_command),
        )
