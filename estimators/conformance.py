"""Tells the author of an estimator what is wrong with it before a benchmark does.

Runs the estimator on short noise-free drives of one robot, in this process and without a time limit: an estimator that
hangs hangs the check. ``castor-bench check`` runs it in a process of its own, with a limit.
"""

import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from castor_envs.errors import InputError
from castor_envs.kinematics import Array, Geometry
from castor_envs.presets import preset, preset_names
from castor_envs.robot import RobotDescription
from estimators.check_drives import Observations, straight, turning, winding, with_pivot_counts_unwrapped
from estimators.protocol import Estimator
from estimators.registry import EstimatorEntry

TOLERANCE = 1e-9
"""m and rad: what a change of frame or of batch size may change."""

BATCH = 7
"""Robots in the batch that is compared with singles: a number that no other axis has, so that mixed-up axes show."""

STARTS = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, 0.7], [-1.5, 4.0, -2.5]])


@dataclass(frozen=True)
class Finding:
    """One thing checked: its name, whether it is right, and otherwise what is wrong and what to do."""

    name: str
    passed: bool
    message: str = ""


class _Wrong(Exception):  # noqa: N818 - a verdict, not an error of this program
    """What is wrong with the estimator and what to do."""


def check(entry: EstimatorEntry, robot: RobotDescription | None = None) -> list[Finding]:
    """Return what was checked of an estimator, in the order of the checks.

    robot: to check on; None takes the first preset, in the order of `candidates`, that the estimator serves. What the
    estimator raises becomes a finding. While it does not return poses at all, nothing further is checked.
    """
    findings = [_finding(entry, "is constructed without arguments", entry.factory)]
    if findings[-1].passed:
        subject = _Subject(entry, robot or preset(_served_preset(entry)))
        for name, run in _FIRST.items():
            findings.append(_finding(entry, name, lambda run=run: run(subject)))
            if not findings[-1].passed:
                return findings
        findings += [_finding(entry, name, lambda run=run: run(subject)) for name, run in _CHECKS.items()]
        if entry.batched:
            findings.append(_finding(entry, "gives in a batch what it gives alone", lambda: _batch(subject), _BATCHED))
    return findings


def candidates() -> list[str]:
    """Return the presets in the order in which one is looked for that an estimator serves."""
    return list(dict.fromkeys(["asoc-prototype", "differential", *preset_names()]))


def refusal(entry: EstimatorEntry, robot: RobotDescription) -> str | None:
    """Return why the estimator's `reset` declines a robot, with a ValueError; None if it does not.

    Whatever else goes wrong is for `check` to find.
    """
    try:
        estimator = entry.factory()
    except (Exception, SystemExit):
        return None
    try:
        estimator.reset(robot, np.zeros(3))
    except ValueError as error:
        return _reason(error)
    except (Exception, SystemExit):
        pass
    return None


def _served_preset(entry: EstimatorEntry) -> str:
    served = (name for name in candidates() if refusal(entry, preset(name)) is None)
    return next(served, candidates()[0])


class _Subject:
    """An estimator under test, the robot, and the drives."""

    def __init__(self, entry: EstimatorEntry, robot: RobotDescription) -> None:
        self.entry, self.robot = entry, robot
        self.straight, self.turning, self.winding = straight(robot), turning(robot), winding(robot)

    def estimate(
        self,
        observations: Observations,
        pose: Array = STARTS[1],
        estimator: Estimator | None = None,
        robot: RobotDescription | None = None,
    ) -> Array:
        """Return the poses (N, 3) of an estimator (None: a new one) that starts at `pose`."""
        estimator = estimator or self.entry.factory()
        estimator.reset(robot or self.robot, pose.copy())
        return np.array([_pose(estimator.update(_copy(observation)), k) for k, observation in enumerate(observations)])


def _serves(subject: _Subject) -> None:
    try:
        subject.estimate([])
    except ValueError as error:
        # Only an InputError is surely meant; any other may be a mistake, so it is said where it comes from.
        place = "" if isinstance(error, InputError) else f" {_place(subject.entry, error)}"
        raise _Wrong(
            f"reset refuses robot {subject.robot.name!r}: {_reason(error)}{place}; check with a robot that it serves"
        ) from None


def _returns_poses(subject: _Subject) -> None:
    subject.estimate(subject.winding.observations)


def _starts_at_start(subject: _Subject) -> None:
    for start in STARTS:
        first = subject.estimate(subject.winding.observations[:1], start)[0]
        if np.abs(first - start).max() > TOLERANCE:
            raise _Wrong(
                f"after reset at {_text(start)} the first update, with wheel increments 0, returns {_text(first)}: "
                "return the start pose until a wheel turns"
            )


def _drives_straight(subject: _Subject) -> None:
    true = subject.straight.pose
    error = np.abs(subject.estimate(subject.straight.observations, np.zeros(3)) - true)
    length = float(np.hypot(*true[-1, :2]))
    worst = int(np.argmax(error.max(axis=1)))
    if error[:, :2].max() > 0.02 * length or error[:, 2].max() > 0.05:
        raise _Wrong(
            f"driven straight to {_text(true[worst])} its pose is off by {_text(error[worst])}: check the signs and "
            "units (wheel increments are counts since the last sample, 2 pi / counts_per_rev rad each; pivot angles "
            "are counts * 2 pi / pivot_counts_per_rev - pivot_zero)"
        )


def _keeps_psi_unwrapped(subject: _Subject) -> None:
    psi = subject.estimate(subject.turning.observations)[:, 2]
    k = int(np.argmax(np.abs(np.diff(psi))))
    if abs(psi[k + 1] - psi[k]) > np.pi / 2:
        raise _Wrong(
            f"psi jumps by {psi[k + 1] - psi[k]:.2f} rad from update {k} to the next while the robot turns evenly: "
            "keep it unwrapped, by adding up changes of heading"
        )
    turned, true = psi[-1] - psi[0], subject.turning.pose[-1, 2]
    if abs(turned - true) > 0.1 * abs(true):
        raise _Wrong(f"over a turn by {true:.2f} rad psi changes by {turned:.2f} rad: check the heading")


def _moves_with_start(subject: _Subject) -> None:
    observations = subject.winding.observations
    at_origin = subject.estimate(observations, STARTS[0])
    for start in STARTS[1:]:
        cos, sin = np.cos(start[2]), np.sin(start[2])
        x, y, psi = at_origin.T
        expected = start + np.stack([cos * x - sin * y, sin * x + cos * y, psi], axis=-1)
        error = np.abs(subject.estimate(observations, start) - expected).max()
        if error > TOLERANCE:
            raise _Wrong(
                f"started at {_text(start)} the path is not that from {_text(STARTS[0])} moved and turned, but off by "
                f"up to {error:.2g}: start from the pose that reset is given, psi included"
            )


def _is_deterministic(subject: _Subject) -> None:
    first, second = (subject.estimate(subject.winding.observations) for _ in range(2))
    if not np.array_equal(first, second):
        raise _Wrong(
            f"two instances on the same data differ by up to {np.abs(first - second).max():.2g}: draw random numbers "
            "from a generator seeded in reset, keep no state in the class"
        )


def _is_reset(subject: _Subject) -> None:
    estimator = subject.entry.factory()
    subject.estimate(subject.turning.observations, STARTS[2], estimator)
    again = subject.estimate(subject.winding.observations, STARTS[1], estimator)
    fresh = subject.estimate(subject.winding.observations, STARTS[1])
    if not np.array_equal(again, fresh):
        raise _Wrong(
            f"after a second reset it differs from a new instance by up to {np.abs(again - fresh).max():.2g}: set all "
            "state in reset, the last pivot counts too"
        )


def _leaves_input_alone(subject: _Subject) -> None:
    estimator, pose = subject.entry.factory(), STARTS[1].copy()
    estimator.reset(subject.robot, pose)
    for k, observation in enumerate(subject.winding.observations):
        given = _copy(observation)
        estimator.update(given)
        if given.keys() != observation.keys():
            raise _Wrong("update adds or removes keys of the observation: work on a copy")
        if changed := [key for key in given if not np.array_equal(given[key], observation[key])]:
            raise _Wrong(f"update {k} changes {changed[0]!r} in the observation it is given: work on a copy")
        if not np.array_equal(pose, STARTS[1]):
            raise _Wrong("the pose array given to reset is changed later: keep a copy, np.array(pose)")


def _reads_wrapped_pivots(subject: _Subject) -> None:
    observations = subject.winding.observations
    wrapped = subject.estimate(observations)
    unwrapped = subject.estimate(with_pivot_counts_unwrapped(subject.robot, observations))
    error = np.abs(wrapped - unwrapped).max()
    if error > 1e-6:
        raise _Wrong(
            f"pivot counts that wrap at pivot_counts_per_rev change the estimate by up to {error:.2g}: wrap "
            "differences of pivot angles into (-pi, pi]"
        )


def _batch(subject: _Subject) -> None:
    robots = [_scaled(subject.robot, 1.0 + 0.01 * i) for i in range(BATCH)]
    starts = np.array([STARTS[i % len(STARTS)] + i for i in range(BATCH)])
    estimator = subject.entry.factory()
    estimator.reset(Geometry.of(robots), starts.copy())
    together = []
    for k, observation in enumerate(subject.winding.observations):
        poses = np.asarray(estimator.update({key: np.tile(value, (BATCH, 1)) for key, value in observation.items()}))
        if poses.shape != (BATCH, 3):
            raise _Wrong(
                f"for a batch of {BATCH}, update {k} returns shape {poses.shape}, not ({BATCH}, 3): {_BATCHED}"
            )
        together.append(poses.copy())
    for i in (0, 3, 6):
        alone = subject.estimate(subject.winding.observations, starts[i], robot=robots[i])
        error = np.abs(np.array(together)[:, i] - alone).max()
        if not error <= TOLERANCE:
            raise _Wrong(f"robot {i} in a batch of {BATCH} is off by up to {error:.2g} from the same alone: {_BATCHED}")


_BATCHED = "index from the last axis, as in wheel[..., 0], or take out `batched = True`"

_FIRST: dict[str, Callable[[_Subject], None]] = {
    "serves the robot": _serves,
    "returns three finite numbers": _returns_poses,
}

_CHECKS: dict[str, Callable[[_Subject], None]] = {
    "returns the start pose first": _starts_at_start,
    "drives straight where the robot does": _drives_straight,
    "keeps psi unwrapped": _keeps_psi_unwrapped,
    "moves and turns with the start pose": _moves_with_start,
    "is deterministic": _is_deterministic,
    "forgets all at reset": _is_reset,
    "leaves its input alone": _leaves_input_alone,
    "reads pivot counts that wrap": _reads_wrapped_pivots,
}


def _finding(entry: EstimatorEntry, name: str, run: Callable[[], object], advice: str = "") -> Finding:
    """Run one check; whatever it raises is the finding."""
    try:
        run()
    except _Wrong as wrong:
        return Finding(name, False, str(wrong))
    except (Exception, SystemExit) as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return Finding(name, False, f"raises {text} {_place(entry, error)}{advice and ': ' + advice}")
    return Finding(name, True)


def _place(entry: EstimatorEntry, error: BaseException) -> str:
    """Return where something was raised: the last line of the estimator's own file on the way, if there is one."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == _file_of(entry)] or frames
    return f"({own[-1].name}, line {own[-1].lineno} of {own[-1].filename})"


def _reason(error: ValueError) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _pose(value: object, k: int) -> Array:
    """Return what update number k returned as an array; raises _Wrong where it is no pose."""
    try:
        pose = np.asarray(value)
    except ValueError:
        pose = np.array(None)
    if pose.shape != (3,):
        what = f"shape {pose.shape}" if pose.dtype.kind in "fiu" else type(value).__name__
        raise _Wrong(f"update {k} returns {what}: return an array of three numbers x, y, psi")
    if pose.dtype != np.float64:
        raise _Wrong(f"update {k} returns numbers of type {pose.dtype}: return float64, as np.array(..., dtype=float)")
    if not np.isfinite(pose).all():
        raise _Wrong(f"update {k} returns {_text(pose)}: return finite numbers, from the first update on")
    return pose.copy()


def _scaled(robot: RobotDescription, factor: float) -> RobotDescription:
    """Return the robot with all wheels' radii scaled."""
    castors = [
        replace(castor, wheels=tuple(replace(wheel, radius=factor * wheel.radius) for wheel in castor.wheels))
        for castor in robot.castors
    ]
    return replace(robot, castors=tuple(castors))


def _copy(observation: dict[str, Array]) -> dict[str, Array]:
    return {key: value.copy() for key, value in observation.items()}


def _file_of(entry: EstimatorEntry) -> str | None:
    reset = getattr(entry.kind.update, "__code__", None)
    return None if reset is None else reset.co_filename


def _text(pose: Array) -> str:
    return f"({', '.join(f'{number:.4g}' for number in pose)})"
