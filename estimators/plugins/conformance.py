"""Shows the author of an estimator what is wrong with it before a benchmark does.

Runs the estimator on short noise-free drives of one robot or train, in this process and without a time limit: an
estimator that hangs hangs the check. ``castor-bench check`` runs it in a separate process, with a time limit.
"""

import copy
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from castor_envs.errors import one_line
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.motion.kinematics import Geometry
from castor_envs.processes import end_if_forked
from castor_envs.sensors.observation import Observations as SampledObservations
from castor_envs.vehicles.load import Vehicle, load_vehicle
from castor_envs.vehicles.presets import preset_names, train_names
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins import drives as check_drives
from estimators.plugins import train_drives
from estimators.plugins.drives import Drive, Observations, with_pivot_counts_unwrapped
from estimators.plugins.registry import EstimatorEntry, declines, reset_at_origin
from estimators.plugins.uncertainty import covariance_of, has_status, invalid, takes_covariance

TOLERANCE = 1e-9
"""m and rad: largest difference allowed after a change of frame or of batch size."""

BATCH = 7
"""Robots in the batch that is compared with single robots: no other axis is as long, so that mixed-up axes show."""

NEAR = 0.1
"""m and rad: how far an estimate may be from the truth on the winding drive of 3 m; no built-in one is off by 2 cm."""

LOST = slice(40, 100)
"""Samples without relative poses, in the check that a train's estimator survives them."""

STARTS = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, 0.7], [-1.5, 4.0, -2.5]])


@dataclass(frozen=True)
class Finding:
    """One thing checked: its name, whether it is right, and otherwise what is wrong and what to do."""

    name: str
    passed: bool
    message: str = ""


class _Wrong(Exception):  # noqa: N818 - a verdict, not an error of this program
    """What is wrong with the estimator and what to do."""


def check(entry: EstimatorEntry, vehicle: Vehicle | None = None, brief: bool = False) -> list[Finding]:
    """Return what was checked of an estimator, in the order of the checks.

    vehicle: robot or train to check on; None takes the first preset, in the order of `candidates`, that the estimator
    serves. brief: only whether it gives poses, starts at the start and stays near the truth, for further layouts of an
    estimator that has passed the rest. What the estimator raises becomes a finding. If it does not return poses at all,
    nothing further is checked.
    """
    findings = [_finding(entry, "is constructed without arguments", entry.factory)]
    if findings[-1].passed:
        subject = _Subject(entry, vehicle or load_vehicle(_served_preset(entry)))
        for name, run in _FIRST.items():
            findings.append(_finding(entry, name, lambda run=run: run(subject)))
            if not findings[-1].passed:
                return findings
        is_train = isinstance(subject.vehicle, TrainDescription)
        checks = _BRIEF if brief else _CHECKS | (_OF_TRAINS if is_train else _OF_ROBOTS)
        findings += [_finding(entry, name, lambda run=run: run(subject)) for name, run in checks.items()]
        if entry.batched and not brief and isinstance(subject.vehicle, RobotDescription):
            findings.append(_finding(entry, "gives in a batch what it gives alone", lambda: _batch(subject), _BATCHED))
    return findings


def candidates() -> list[str]:
    """Return the presets in the order in which they are tried until an estimator serves one."""
    return list(dict.fromkeys(["asoc-prototype", "differential", *preset_names(), "cfmmr-3", *train_names()]))


def refusal(entry: EstimatorEntry, vehicle: Vehicle) -> str | None:
    """Return why the estimator's `reset`, or a smoother's `estimate`, declines a robot or a train; None if it does not.

    Other failures are left for `check` to find.
    """
    try:
        estimator = entry.factory()
    except (Exception, SystemExit):
        return None
    try:
        if entry.smoother:
            shape = (vehicle.n_axles, 3) if isinstance(vehicle, TrainDescription) else (3,)
            seen = SampledObservations.of(_drives(vehicle)[0].observations)
            estimator.estimate(vehicle, np.zeros(shape), seen)
        else:
            reset_at_origin(estimator, vehicle)
    except (Exception, SystemExit) as error:
        return declines(error, vehicle)
    return None


def _served_preset(entry: EstimatorEntry) -> str:
    served = (name for name in candidates() if refusal(entry, load_vehicle(name)) is None)
    return next(served, candidates()[0])


@lru_cache(maxsize=4)  # the same for every estimator that is checked on a vehicle
def _drives(vehicle: Vehicle) -> tuple[Drive, Drive, Drive]:
    """Return the straight, the turning and the winding drive of a robot or a train."""
    if isinstance(vehicle, TrainDescription):
        return train_drives.straight(vehicle), train_drives.turning(vehicle), train_drives.winding(vehicle)
    return check_drives.straight(vehicle), check_drives.turning(vehicle), check_drives.winding(vehicle)


class _Subject:
    """An estimator under test, the robot or train, and the drives.

    K samples give poses (K, 3) of a robot and (K, N, 3) of a train.
    """

    def __init__(self, entry: EstimatorEntry, vehicle: Vehicle) -> None:
        self.entry, self.vehicle = entry, vehicle
        self.straight, self.turning, self.winding = _drives(vehicle)

    @cached_property
    def wound(self) -> Array:
        """The poses of a new estimator on the winding drive from STARTS[1]."""
        return self.estimate(self.winding)

    def estimate(
        self,
        drive: Drive,
        start: Array = STARTS[1],
        estimator: Any = None,
        vehicle: Vehicle | None = None,
        observations: Observations | None = None,
    ) -> Array:
        """Return the poses of an estimator (None: a new one) on a drive moved to `start` (3,).

        observations: given to it instead of the drive's observations.
        """
        estimator = estimator or self.entry.factory()
        first = se2.compose(start, drive.pose[0])
        seen = drive.observations if observations is None else observations
        if self.entry.smoother:
            poses = estimator.estimate(vehicle or self.vehicle, first.copy(), SampledObservations.of(seen))
            return _pose(poses, None, (len(seen), *first.shape))
        estimator.reset(vehicle or self.vehicle, first.copy())
        return np.array([_pose(estimator.update(_copy(row)), k, first.shape) for k, row in enumerate(seen)])


def _serves(subject: _Subject) -> None:
    try:
        # A smoother has no `reset` that could be asked alone.
        subject.estimate(subject.straight, observations=None if subject.entry.smoother else [])
    except Exception as error:
        kind, reason = _kind(subject.vehicle), declines(error, subject.vehicle)
        asked = "estimate" if subject.entry.smoother else "reset"
        if reason is not None:
            raise _Wrong(
                f"{asked} declines {kind} {subject.vehicle.name!r}: {reason}; check with one that it serves"
            ) from None
        if isinstance(error, ValueError):
            raise _Wrong(
                f"{asked} raises {one_line(error)} {_place(subject.entry, error)}: mend it, or, if the estimator is "
                f"not made for {kind} {subject.vehicle.name!r}, raise estimators.Declined with what it needs"
            ) from None
        raise


def _returns_poses(subject: _Subject) -> None:
    _ = subject.wound


def _starts_at_start(subject: _Subject) -> None:
    seen = subject.winding.observations[: None if subject.entry.smoother else 1]
    for start in STARTS:
        first = subject.estimate(subject.winding, start, observations=seen)[0]
        given = se2.compose(start, subject.winding.pose[0])
        if np.abs(first - given).max() > TOLERANCE:
            raise _Wrong(
                f"after reset at {_text(given)} the first update, with wheel increments 0, returns {_text(first)}: "
                "return the start pose until a wheel turns"
            )


def _drives_straight(subject: _Subject) -> None:
    true = subject.straight.pose
    error = np.abs(subject.estimate(subject.straight, np.zeros(3)) - true)
    length = float(np.hypot(*(true[-1] - true[0])[..., :2].T).max())
    worst = int(np.argmax(error.reshape(len(error), -1).max(axis=1)))
    if error[..., :2].max() > 0.02 * length or error[..., 2].max() > 0.05:
        raise _Wrong(
            f"driven straight to {_text(true[worst])} its pose is off by {_text(error[worst])}: check the signs and "
            "units (wheel increments are counts since the last sample, 2 pi / counts_per_rev rad each; "
            f"{_READINGS[_kind(subject.vehicle)]})"
        )


def _keeps_psi_unwrapped(subject: _Subject) -> None:
    of_all = subject.estimate(subject.turning)[..., 2].reshape(len(subject.turning.pose), -1)
    turns = np.ravel(subject.turning.pose[-1, ..., 2] - subject.turning.pose[0, ..., 2])
    for psi, true in zip(of_all.T, turns, strict=True):
        k = int(np.argmax(np.abs(np.diff(psi))))
        if abs(psi[k + 1] - psi[k]) > np.pi / 2:
            raise _Wrong(
                f"psi jumps by {psi[k + 1] - psi[k]:.2f} rad from update {k} to the next while the "
                f"{_kind(subject.vehicle)} turns evenly: keep it unwrapped, by adding up changes of heading"
            )
        turned = psi[-1] - psi[0]
        if abs(turned - true) > 0.1 * abs(true):
            raise _Wrong(f"over a turn by {true:.2f} rad psi changes by {turned:.2f} rad: check the heading")


def _drives_round(subject: _Subject) -> None:
    for drive, way in ((subject.turning, "round a circle of 1.6 m"), (subject.winding, "through bends to both sides")):
        difference = subject.estimate(drive, np.zeros(3)) - drive.pose
        difference[..., 2] = wrap(difference[..., 2])  # whole turns are checked separately
        error = np.abs(difference).max(axis=(0, 2))
        axle = int(np.argmax(error))
        if error[axle] > 0.1:
            raise _Wrong(
                f"driven {way}, axle {axle + 1} is off by up to {error[axle]:.2g} (m, rad): check which wheels and "
                "frames belong to which axle (both are counted from the front), and whose frame a relative pose is in "
                "(its rear axle's)"
            )


def _stays_near(subject: _Subject) -> None:
    error = np.abs(subject.estimate(subject.winding, np.zeros(3)) - subject.winding.pose)
    far = np.argwhere(error.reshape(len(error), -1).max(axis=1) > NEAR)
    if far.size:
        raise _Wrong(
            f"driven through bends for {subject.winding.observations[-1]['time'][0]:.0f} s, without slip and with the "
            f"dimensions described, it is off by {error[far[0, 0]].max():.2g} (m, rad) at update {far[0, 0]} and by up "
            f"to {error.max():.2g}: it diverges on this layout; mend it, or raise estimators.Declined in reset"
        )


def _survives_silence(subject: _Subject) -> None:
    observations = train_drives.with_silent_sensors(subject.winding.observations, LOST)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an estimator may well warn
        poses = subject.estimate(subject.winding, observations=observations)
    true = se2.compose(STARTS[1], subject.winding.pose)
    error, before = np.abs(poses - true).max(), np.abs(subject.wound - true).max()
    if error > before + 0.5:
        raise _Wrong(
            f"where no frame has a relative pose for a while (rps NaN) the poses go off by up to {error:.2g} (m, rad), "
            "though the wheels roll without slip: go on by odometry alone"
        )


def _takes_covariance(subject: _Subject) -> None:
    """Check that an estimator that wants the covariance of the start gets on with a true one and with an unsure one."""
    smoother, seen = subject.entry.smoother, subject.winding.observations
    start = se2.compose(STARTS[1], subject.winding.pose[0])
    for variance in (0.0, 1e-4):
        estimator = subject.entry.factory()
        if not takes_covariance(estimator.estimate if smoother else estimator.reset):
            return
        covariance = np.broadcast_to(variance * np.eye(3), (*start.shape, 3)).copy()
        if smoother:
            poses = estimator.estimate(
                subject.vehicle, start.copy(), SampledObservations.of(seen), covariance=covariance
            )
            _pose(poses, None, (len(seen), *start.shape))
            continue
        estimator.reset(subject.vehicle, start.copy(), covariance=covariance)
        for k, row in enumerate(seen):
            _pose(estimator.update(_copy(row)), k, start.shape)


def _moves_with_start(subject: _Subject) -> None:
    at_origin = subject.estimate(subject.winding, STARTS[0])
    for k, start in enumerate(STARTS[1:], start=1):
        poses = subject.wound if k == 1 else subject.estimate(subject.winding, start)
        error = np.abs(poses - se2.compose(start, at_origin)).max()
        if error > TOLERANCE:
            raise _Wrong(
                f"started at {_text(start)} the path is not that from {_text(STARTS[0])} moved and turned, but off by "
                f"up to {error:.2g}: start from the pose that reset is given, psi included"
            )


def _is_deterministic(subject: _Subject) -> None:
    first, second = subject.wound, subject.estimate(subject.winding)
    if not np.array_equal(first, second):
        raise _Wrong(
            f"two instances on the same data differ by up to {np.abs(first - second).max():.2g}: draw random numbers "
            "from a generator seeded in reset, keep no state in the class"
        )


def _is_reset(subject: _Subject) -> None:
    estimator = subject.entry.factory()
    subject.estimate(subject.turning, STARTS[2], estimator)
    again = subject.estimate(subject.winding, STARTS[1], estimator)
    fresh = subject.wound
    if not np.array_equal(again, fresh):
        raise _Wrong(
            f"after a second reset it differs from a new instance by up to {np.abs(again - fresh).max():.2g}: set all "
            "state in reset, the last pivot counts too"
        )


def _leaves_input_alone(subject: _Subject) -> None:
    estimator, start = subject.entry.factory(), se2.compose(STARTS[1], subject.winding.pose[0])
    pose = start.copy()
    if subject.entry.smoother:
        given = SampledObservations.of(subject.winding.observations)
        before = copy.deepcopy(vars(given))
        estimator.estimate(subject.vehicle, pose, given)
        changed = [name for name, of in vars(given).items() if of is not None and not np.array_equal(of, before[name])]
        if changed or not np.array_equal(pose, start):
            raise _Wrong(f"estimate changes {changed[0] if changed else 'the start pose'!r} that it is given: copy it")
        return
    estimator.reset(subject.vehicle, pose)
    for k, observation in enumerate(subject.winding.observations):
        given = _copy(observation)
        estimator.update(given)
        if given.keys() != observation.keys():
            raise _Wrong("update adds or removes keys of the observation: work on a copy")
        if changed := [key for key in given if not np.array_equal(given[key], observation[key])]:
            raise _Wrong(f"update {k} changes {changed[0]!r} in the observation it is given: work on a copy")
        if not np.array_equal(pose, start):
            raise _Wrong("the pose array given to reset is changed later: keep a copy, np.array(pose)")


def _reads_wrapped_pivots(subject: _Subject) -> None:
    wrapped = subject.wound
    counted_on = with_pivot_counts_unwrapped(_robot(subject), subject.winding.observations)
    unwrapped = subject.estimate(subject.winding, observations=counted_on)
    error = np.abs(wrapped - unwrapped).max()
    if error > 1e-6:
        raise _Wrong(
            f"pivot counts that wrap at pivot_counts_per_rev change the estimate by up to {error:.2g}: wrap "
            "differences of pivot angles into (-pi, pi]"
        )


def _says_how_sure_it_is(subject: _Subject) -> None:
    given = {}
    for start in (STARTS[0], STARTS[1]):
        estimator = subject.entry.factory()
        poses = subject.estimate(subject.winding, start, estimator)
        try:
            given[float(start[2])] = covariance = covariance_of(estimator, poses[-1].shape)
            has_status(estimator)
        except ValueError as error:
            raise _Wrong(f"after an update its {error}") from None
        if covariance is None:
            return
        if (problem := invalid(covariance)) is not None:
            raise _Wrong(f"after an update its {problem}")
    at_origin, turned = given.values()
    turn = se2.rotation(np.array(STARTS[1][2]))
    expected = turn @ at_origin @ turn.T
    if np.abs(turned - expected).max() > 1e-6 * np.abs(expected).max():
        raise _Wrong(
            "started with another heading its covariance is not that of the first start turned: give it in the world's "
            "axes, not in the body's"
        )


def _batch(subject: _Subject) -> None:
    robots = [_scaled(_robot(subject), 1.0 + 0.01 * i) for i in range(BATCH)]
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
        alone = subject.estimate(subject.winding, starts[i], vehicle=robots[i])
        error = np.abs(np.array(together)[:, i] - alone).max()
        if not error <= TOLERANCE:
            raise _Wrong(f"robot {i} in a batch of {BATCH} is off by up to {error:.2g} from the same alone: {_BATCHED}")


_READINGS = {
    "robot": "pivot angles are counts * 2 pi / pivot_counts_per_rev - pivot_zero",
    "train": "axle by axle from the front, left then right; relative poses are in m and rad",
}
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
    "says how sure it is, if it does": _says_how_sure_it_is,
    "takes the start's covariance, if it wants it": _takes_covariance,
}

_BRIEF: dict[str, Callable[[_Subject], None]] = {
    "returns the start pose first": _starts_at_start,
    "drives straight where the robot does": _drives_straight,
    "stays near the truth in bends": _stays_near,
}

_OF_ROBOTS: dict[str, Callable[[_Subject], None]] = {
    "stays near the truth in bends": _stays_near,
    "reads pivot counts that wrap": _reads_wrapped_pivots,
}

_OF_TRAINS: dict[str, Callable[[_Subject], None]] = {
    "drives round where the train does": _drives_round,
    "survives missing relative poses": _survives_silence,
}


def _finding(entry: EstimatorEntry, name: str, run: Callable[[], object], advice: str = "") -> Finding:
    """Run one check; an exception becomes the finding."""
    try:
        run()
    except _Wrong as wrong:
        return Finding(name, False, str(wrong))
    except (Exception, SystemExit) as error:
        end_if_forked()
        return Finding(name, False, f"raises {one_line(error)} {_place(entry, error)}{advice and ': ' + advice}")
    return Finding(name, True)


def _place(entry: EstimatorEntry, error: BaseException) -> str:
    """Return where something was raised: the last line of the estimator's own file on the way, if there is one."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [frame for frame in frames if frame.filename == _file_of(entry)] or frames
    return f"({inside[-1].name}, line {inside[-1].lineno} of {inside[-1].filename})"


def _kind(vehicle: Vehicle) -> str:
    return "train" if isinstance(vehicle, TrainDescription) else "robot"


def _robot(subject: _Subject) -> RobotDescription:
    """Return the subject's vehicle, in checks that only robots get."""
    assert isinstance(subject.vehicle, RobotDescription)
    return subject.vehicle


def _pose(value: object, k: int | None, shape: tuple[int, ...]) -> Array:
    """Return what update number k, or the whole log if None, returned as an array of this shape; else raises _Wrong."""
    end_if_forked()
    did = "estimate" if k is None else f"update {k}"
    try:
        pose = np.asarray(value)
    except ValueError:
        pose = np.array(None)
    if pose.shape != shape:
        given = f"shape {pose.shape}" if pose.dtype.kind in "fiu" else type(value).__name__
        of_axles = "" if shape == (3,) else f" for each of {shape[0]} axles, shape {shape}"
        if k is None:
            of_axles = f" for each of {shape[0]} samples{' and the axles' if len(shape) == 3 else ''}, shape {shape}"
        raise _Wrong(f"{did} returns {given}: return an array of three numbers x, y, psi{of_axles}")
    if pose.dtype != np.float64:
        raise _Wrong(f"{did} returns numbers of type {pose.dtype}: return float64, as np.array(..., dtype=float)")
    if not np.isfinite(pose).all():
        raise _Wrong(f"{did} returns {_text(pose)}: return finite numbers, from the first update on")
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
    code = getattr(getattr(entry.kind, "estimate" if entry.smoother else "update"), "__code__", None)
    return None if code is None else code.co_filename


def _text(pose: Array) -> str:
    if pose.ndim > 1:
        return f"[{', '.join(_text(row) for row in pose[:3])}{', ...' if len(pose) > 3 else ''}]"
    return f"({', '.join(f'{number:.4g}' for number in pose)})"
