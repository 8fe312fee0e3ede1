"""Checks of an estimator's conduct: what it serves, its state, its input, its covariance, batches."""

import copy
from dataclasses import replace

import numpy as np

from castor_envs.errors import message_of, one_line
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.sensors.observation import Observations as SampledObservations
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.conformance.subject import (
    STARTS,
    Subject,
    Wrong,
    copied,
    kind_of,
    place,
    robot_of,
    shaped,
)
from estimators.plugins.registry import declines
from estimators.plugins.uncertainty import covariance_of, has_status, invalid, takes_covariance

BATCH = 7
"""Robots in the batch that is compared with single robots: no other axis is as long, so that mixed-up axes show."""

BATCHED = "index from the last axis, as in wheel[..., 0], or take out `batched = True`"


def serves(subject: Subject) -> None:
    """The estimator serves the vehicle, or says by `Declined` why not."""
    try:
        # A smoother has no `reset` that could be asked alone.
        subject.estimate(subject.straight, observations=None if subject.entry.smoother else [])
    except Exception as error:
        kind, reason = kind_of(subject.vehicle), declines(error, subject.vehicle)
        asked = "estimate" if subject.entry.smoother else "reset"
        if reason is not None:
            raise Wrong(
                f"{asked} declines {kind} {subject.vehicle.name!r}: {reason}; check with one that it serves"
            ) from None
        if isinstance(error, ValueError):
            raise Wrong(
                f"{asked} raises {one_line(error)} {place(subject.entry, error)}: mend it, or, if the estimator is "
                f"not made for {kind} {subject.vehicle.name!r}, raise estimators.Declined with what it needs"
            ) from None
        raise


def returns_poses(subject: Subject) -> None:
    """Every update gives a pose of finite numbers."""
    _ = subject.wound


def is_deterministic(subject: Subject) -> None:
    """Two instances give the same poses for the same data."""
    first, second = subject.wound, subject.estimate(subject.winding)
    if not np.array_equal(first, second):
        raise Wrong(
            f"two instances on the same data differ by up to {np.abs(first - second).max():.2g}: draw random numbers "
            "from a generator seeded in reset, keep no state in the class"
        )


def is_reset(subject: Subject) -> None:
    """After a second reset it gives what a new instance gives."""
    estimator = subject.entry.factory()
    subject.estimate(subject.turning, STARTS[2], estimator)
    again = subject.estimate(subject.winding, STARTS[1], estimator)
    fresh = subject.wound
    if not np.array_equal(again, fresh):
        raise Wrong(
            f"after a second reset it differs from a new instance by up to {np.abs(again - fresh).max():.2g}: set all "
            "state in reset, the last pivot counts too"
        )


def leaves_input_alone(subject: Subject) -> None:
    """What it is given is unchanged afterwards."""
    estimator, start = subject.entry.factory(), se2.compose(STARTS[1], subject.winding.pose[0])
    pose = start.copy()
    if subject.entry.smoother:
        given = SampledObservations.of(subject.winding.observations)
        before = copy.deepcopy(vars(given))
        estimator.estimate(subject.vehicle, pose, given)
        changed = [name for name, of in vars(given).items() if of is not None and not np.array_equal(of, before[name])]
        if changed or not np.array_equal(pose, start):
            raise Wrong(f"estimate changes {changed[0] if changed else 'the start pose'!r} that it is given: copy it")
        return
    estimator.reset(subject.vehicle, pose)
    for k, observation in enumerate(subject.winding.observations):
        given = copied(observation)
        estimator.update(given)
        if given.keys() != observation.keys():
            raise Wrong("update adds or removes keys of the observation: work on a copy")
        if changed := [key for key in given if not np.array_equal(given[key], observation[key])]:
            raise Wrong(f"update {k} changes {changed[0]!r} in the observation it is given: work on a copy")
        if not np.array_equal(pose, start):
            raise Wrong("the pose array given to reset is changed later: keep a copy, np.array(pose)")


def takes_start_covariance(subject: Subject) -> None:
    """One that wants the covariance of the start gets on with a true one and with an unsure one."""
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
            shaped(poses, None, (len(seen), *start.shape))
            continue
        estimator.reset(subject.vehicle, start.copy(), covariance=covariance)
        for k, row in enumerate(seen):
            shaped(estimator.update(copied(row)), k, start.shape)


def says_how_sure_it_is(subject: Subject) -> None:
    """Its covariance, if it has one, is one, and turns with the start."""
    if subject.entry.smoother:
        return
    at_origin, turned = (_last_covariance(subject, start) for start in (STARTS[0], STARTS[1]))
    if at_origin is None or turned is None:
        return
    turn = se2.rotation(np.array(STARTS[1][2]))
    expected = turn @ at_origin @ turn.T
    if np.abs(turned - expected).max() > 1e-6 * np.abs(expected).max():
        raise Wrong(
            "started with another heading its covariance is not that of the first start turned: give it in the world's "
            "axes, not in the body's"
        )


def _last_covariance(subject: Subject, start: Array) -> Array | None:
    """Return the covariance after the winding drive from `start`, None if there is none; it is looked at after every
    update, as a run looks at it after any."""
    estimator, shape, given = subject.entry.factory(), subject.winding.pose[0].shape, []

    def look(k: int) -> None:
        try:
            given.append(covariance_of(estimator, shape))
            has_status(estimator)
            problem = None if given[-1] is None else invalid(given[-1])
        except ValueError as error:
            problem = message_of(error)
        if problem is not None:
            raise Wrong(f"after update {k} its {problem}")

    subject.estimate(subject.winding, start, estimator, after=look)
    without = [k for k, covariance in enumerate(given) if covariance is None]
    if 0 < len(without) < len(given):
        raise Wrong(f"has a covariance after some updates, and none after update {without[0]}: give one after each")
    return given[-1]


def batch(subject: Subject) -> None:
    """Robots in a batch get the poses that each gets alone."""
    robots = [_scaled(robot_of(subject), 1.0 + 0.01 * i) for i in range(BATCH)]
    starts = np.array([STARTS[i % len(STARTS)] + i for i in range(BATCH)])
    estimator = subject.entry.factory()
    estimator.reset(Geometry.of(robots), starts.copy())
    together = []
    for k, observation in enumerate(subject.winding.observations):
        poses = np.asarray(estimator.update({key: np.tile(value, (BATCH, 1)) for key, value in observation.items()}))
        if poses.shape != (BATCH, 3):
            raise Wrong(f"for a batch of {BATCH}, update {k} returns shape {poses.shape}, not ({BATCH}, 3): {BATCHED}")
        together.append(poses.copy())
    for i in (0, 3, 6):
        alone = subject.estimate(subject.winding, starts[i], vehicle=robots[i])
        error = np.abs(np.array(together)[:, i] - alone).max()
        if not error <= subject.tolerance:
            raise Wrong(f"robot {i} in a batch of {BATCH} is off by up to {error:.2g} from the same alone: {BATCHED}")


def _scaled(robot: RobotDescription, factor: float) -> RobotDescription:
    """Return the robot with all wheels' radii scaled."""
    castors = [
        replace(castor, wheels=tuple(replace(wheel, radius=factor * wheel.radius) for wheel in castor.wheels))
        for castor in robot.castors
    ]
    return replace(robot, castors=tuple(castors))
