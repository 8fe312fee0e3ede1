"""The drive that would distinguish effects which logs do not: that of the largest expected log Bayes factor.

Let I be what logs say together, those that there are and that of the drive, beyond what robots in good order show. If
effect A of size a is there, and b is the size of effect B that is most like it, then ln p(logs | A) - ln p(logs | B) is
expected to be (a - b)' I (a - b) / 2. Of a drive the least over all pairs (A, B) of a credible set counts.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import Trajectory, chained, wander
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.answers import Answer, Cause, Place
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import PARTS, direction_of, order_of
from discrepancy.posterior.random_effects import GoodOrder, Statistics
from estimators.calibration.drives import DRIVES, REFERENCE, Poses, log_of
from estimators.likelihood.statistics import pseudo_inverse

SEEDS = (1, 2, 3)
"""Of random paths beside that of `DRIVES`: where one was driven, and it is not enough, another one may be."""

SAME = 0.05
"""Part of its way by which a robot may be off a drive and still have driven it."""


@dataclass(frozen=True, eq=False)
class SeparatingDrive:
    """A drive, the places where poses are to be taken, and the least log Bayes factor that is expected of it."""

    trajectory: Trajectory
    poses: Poses
    expected: float

    @property
    def what(self) -> str:
        """In words."""
        return f"{self.trajectory.name} {REFERENCE[self.poses]}"


def separating_drives(
    robot: RobotDescription, answers: Sequence[Answer], seen: Linearised
) -> list[SeparatingDrive | None]:
    """Return for each answer the new drive that best distinguishes the effects in its credible set.

    seen: statistics of all candidates in the logs. None for answers that are not ambiguous, whose set has no two
    effects, or where no drive makes the odds between any two of them as large as a credible set requires.
    """
    best: list[SeparatingDrive | None] = [None] * len(answers)
    asked = {k: likely for k, answer in enumerate(answers) if len(likely := _likely(answer, seen)) > 1}
    if not asked:
        return best
    poses: Poses = "none" if seen.gap is None else "all"
    effects = [candidate for candidate in seen.candidates if candidate.kinds]
    order = order_of(seen, None)
    known = order.beyond(seen.logs).information
    for drive in _new_drives(robot, seen):
        try:
            new = linearise(robot, [log_of(robot, drive, poses)], among=effects).at_noise(seen.noise)
        except (InputError, np.linalg.LinAlgError):  # the robot cannot drive it, or it shows nothing
            continue
        for k, likely in asked.items():
            expected, before = _expected(new, seen, answers[k], likely, order, known), best[k]
            if expected > (LOG_ODDS if before is None else before.expected):
                best[k] = SeparatingDrive(drive, poses, expected)
    return best


def _likely(answer: Answer, seen: Linearised) -> list[Cause]:
    """Return the effects in an ambiguous answer's credible set, one of each family, its own first."""
    if answer.verdict != "ambiguous" or answer.candidate not in seen.candidates:
        return []
    likely = {answer.candidate.family: answer.candidate}
    for candidate in seen.candidates:
        if candidate.kinds and candidate.family in answer.credible:
            likely.setdefault(candidate.family, candidate)
    return list(likely.values())


def _expected(
    new: Linearised, seen: Linearised, answer: Answer, likely: Sequence[Cause], order: GoodOrder, known: Array
) -> float:
    """Return the least expected log Bayes factor between the effects of an answer; 0 if the drive hides one.

    known (m, m): information of the logs so far, beyond good order. The answer's effect, the first, has the size that
    was found; each other effect has the size at which it is most similar to that in these logs. The alternative to each
    may have any size, and any part of it may be masked by creep.
    """
    if not new.columns.keys() >= set(likely):
        return 0.0
    information = order.beyond([*seen.logs, _in_columns_of(seen, new)]).information
    directions = [[direction_of(seen, Place(cause, part)) for part in PARTS] for cause in likely]
    found = direction_of(seen, Place(likely[0], answer.masked)) @ answer.amplitudes
    sizes = [found, *(_nearest(found, of_effect, known) for of_effect in directions[1:])]
    pairs = itertools.permutations(range(len(likely)), 2)
    left = (sizes[a] - _nearest(sizes[a], directions[b], information) for a, b in pairs)
    return min(float(size @ information @ size) / 2 for size in left)


def _nearest(size: Array, directions: Sequence[Array], information: Array) -> Array:
    """Return the size (m,) along one of the directions (m, c) whose signature is most similar to that of `size`."""
    nearest = []
    for direction in directions:
        strength = direction.T @ information @ direction
        amplitudes = pseudo_inverse(strength) @ (direction.T @ information @ size)
        nearest.append(direction @ amplitudes)
    return min(nearest, key=lambda other: float((size - other) @ information @ (size - other)))


def _in_columns_of(seen: Linearised, new: Linearised) -> Statistics:
    """Return the expected statistics of a new log, in the columns of `seen`; 0 for candidates that it does not show."""
    at, of = (
        np.concatenate([log.columns[candidate] + part for part in (0, len(log.usual)) for candidate in new.candidates])
        for log in (seen, new)
    )
    information = np.zeros_like(seen.logs[0].information)
    information[np.ix_(at, at)] = new.logs[0].information[np.ix_(of, of)]
    return Statistics(information, np.zeros(len(information)))


def _new_drives(robot: RobotDescription, seen: Linearised) -> Iterator[Trajectory]:
    """Yield all drives that may be asked for, each in one go, but those that the logs have driven."""
    reach = max(np.hypot(*castor.pivot) + abs(wheel.lateral) for castor in robot.castors for wheel in castor.wheels)
    drives = [chained(name, make(robot)) for name, make in DRIVES.items()]
    for seed in SEEDS:
        path = wander(np.random.default_rng(seed), holonomic=moves_sideways(robot))
        drives.append(chained(f"a random path of 60 s (no. {seed + 1})", [path]))
    for drive in drives:
        asked = drive.at(np.arange(0.0, drive.duration, robot.sample_period))[0]
        if not any(_has_driven(state[:, :3], asked, float(reach)) for state in seen.state.states):
            yield drive


def _has_driven(pose: Array, drive: Array, reach: float) -> bool:
    """Whether a robot at poses (K, 3) has done the same as a drive (J, 3) from its start, at whatever speed."""
    covered, asked = _way_of(pose, reach), _way_of(drive, reach)
    if covered[-1] < (1 - SAME) * asked[-1]:
        return False
    moved = relative_pose(pose[0], pose)
    there = np.column_stack([np.interp(asked, covered, column) for column in moved.T])
    off = there - relative_pose(drive[0], drive)
    return bool(np.max(np.hypot(off[:, 0], off[:, 1]) + reach * np.abs(off[:, 2])) < SAME * asked[-1])


def _way_of(pose: Array, reach: float) -> Array:
    """Return how far (K,), m, a robot has gone or, `reach` m from its middle, turned since the start."""
    step = np.diff(pose, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]) + reach * np.abs(step[:, 2]))])
