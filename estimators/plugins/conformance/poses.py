"""Checks that an estimator's poses are right: where it starts, straight, round, in bends, from any start."""

import warnings

import numpy as np

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from estimators.plugins import train_drives
from estimators.plugins.conformance.subject import STARTS, Subject, Wrong, kind_of, robot_of, text
from estimators.plugins.drives import with_pivot_counts_unwrapped

NEAR = 0.1
"""m and rad: how far an estimate may be from the truth on the winding drive of 3 m; no built-in one is off by 2 cm."""

TURN = 0.1
"""Relative difference allowed between changes of heading and the true ones."""

LOST = slice(40, 100)
"""Samples without relative poses, in the check that a train's estimator survives them."""

_READINGS = {
    "robot": "pivot angles are counts * 2 pi / pivot_counts_per_rev - pivot_zero",
    "train": "axle by axle from the front, left then right; relative poses are in m and rad",
}


def starts_at_start(subject: Subject) -> None:
    """The first pose, before a wheel turns, is the start."""
    seen = subject.winding.observations[: None if subject.entry.smoother else 1]
    for start in STARTS:
        first = subject.estimate(subject.winding, start, observations=seen)[0]
        given = se2.compose(start, subject.winding.pose[0])
        if np.abs(first - given).max() > subject.tolerance:
            raise Wrong(
                f"after reset at {text(given)} the first update, with wheel increments 0, returns {text(first)}: "
                "return the start pose until a wheel turns"
            )


def drives_straight(subject: Subject) -> None:
    """On a straight way it is where the vehicle is."""
    true = subject.straight.pose
    error = np.abs(subject.estimate(subject.straight, np.zeros(3)) - true)
    length = float(np.hypot(*(true[-1] - true[0])[..., :2].T).max())
    worst = int(np.argmax(error.reshape(len(error), -1).max(axis=1)))
    if error[..., :2].max() > 0.02 * length or error[..., 2].max() > 0.05:
        raise Wrong(
            f"driven straight to {text(true[worst])} its pose is off by {text(error[worst])}: check the signs and "
            "units (wheel increments are counts since the last sample, 2 pi / counts_per_rev rad each; "
            f"{_READINGS[kind_of(subject.vehicle)]})"
        )


_RATIOS = {
    -1.0: "the sign: are left and right exchanged?",
    2.0: "is half the track used for the track?",
    0.5: "is twice the track used for the track?",
    float(np.degrees(1)): "psi is in rad, not in degrees",
    float(np.radians(1)): "are angles taken for degrees?",
}
"""What headings that change by such multiples of the true turn are likely to come from."""


def turns_as_the_vehicle(subject: Subject) -> None:
    """Headings change by as much as the vehicle turns, wrapped or not."""
    _, _, ratio = _turns(subject)
    if not abs(ratio - 1) <= TURN:
        cause = next((why for known, why in _RATIOS.items() if abs(ratio / known - 1) <= TURN), "check the heading")
        raise Wrong(f"while the {kind_of(subject.vehicle)} turns, psi changes by {ratio:.2g} times as much: {cause}")


def keeps_psi_unwrapped(subject: Subject) -> None:
    """Headings go on beyond a turn."""
    steps, true, ratio = _turns(subject)
    jump = np.abs(steps - ratio * true)
    k, axle = np.unravel_index(np.argmax(jump), jump.shape)
    if jump[k, axle] > np.pi / 2:
        raise Wrong(
            f"psi jumps by {steps[k, axle]:.2f} rad from update {k} to the next while the "
            f"{kind_of(subject.vehicle)} turns evenly: keep it unwrapped, by adding up changes of heading"
        )


def _turns(subject: Subject) -> tuple[Array, Array, float]:
    """Return by how much headings change from update to update while the vehicle turns, the true changes (K, axles),
    rad, and the median of their ratio."""
    steps, true = (
        np.diff(poses[..., 2].reshape(len(poses), -1), axis=0)
        for poses in (subject.estimate(subject.turning), subject.turning.pose)
    )
    turning = true != 0
    return steps, true, float(np.median(steps[turning] / true[turning]))


def drives_round(subject: Subject) -> None:
    """On circles and bends every axle of a train is where it is."""
    for drive, way in ((subject.turning, "round a circle of 1.6 m"), (subject.winding, "through bends to both sides")):
        difference = subject.estimate(drive, np.zeros(3)) - drive.pose
        difference[..., 2] = wrap(difference[..., 2])  # whole turns are checked separately
        error = np.abs(difference).max(axis=(0, 2))
        axle = int(np.argmax(error))
        if error[axle] > 0.1:
            raise Wrong(
                f"driven {way}, axle {axle + 1} is off by up to {error[axle]:.2g} (m, rad): check which wheels and "
                "frames belong to which axle (both are counted from the front), and whose frame a relative pose is in "
                "(its rear axle's)"
            )


def stays_near(subject: Subject) -> None:
    """On a winding way it stays within `NEAR` of the truth."""
    error = np.abs(subject.estimate(subject.winding, np.zeros(3)) - subject.winding.pose)
    far = np.argwhere(error.reshape(len(error), -1).max(axis=1) > NEAR)
    if far.size:
        raise Wrong(
            f"driven through bends for {subject.winding.observations[-1]['time'][0]:.0f} s, without slip and with the "
            f"dimensions described, it is off by {error[far[0, 0]].max():.2g} (m, rad) at update {far[0, 0]} and by up "
            f"to {error.max():.2g}: it diverges on this layout; mend it, or raise estimators.Declined in reset"
        )


def moves_with_start(subject: Subject) -> None:
    """Started elsewhere, the path is the same, moved and turned."""
    at_origin = subject.estimate(subject.winding, STARTS[0])
    for k, start in enumerate(STARTS[1:], start=1):
        poses = subject.wound if k == 1 else subject.estimate(subject.winding, start)
        difference = poses - se2.compose(start, at_origin)
        difference[..., 2] = wrap(difference[..., 2])  # whole turns are checked separately
        error = np.abs(difference).max()
        if error > subject.tolerance:
            raise Wrong(
                f"started at {text(start)} the path is not that from {text(STARTS[0])} moved and turned, but off by "
                f"up to {error:.2g}: start from the pose that reset is given, psi included"
            )


def survives_silence(subject: Subject) -> None:
    """Without relative poses for a while a train goes on by odometry."""
    observations = train_drives.with_silent_sensors(subject.winding.observations, LOST)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an estimator may well warn
        poses = subject.estimate(subject.winding, observations=observations)
    true = se2.compose(STARTS[1], subject.winding.pose)
    error, before = np.abs(poses - true).max(), np.abs(subject.wound - true).max()
    if error > before + 0.5:
        raise Wrong(
            f"where no frame has a relative pose for a while (rps NaN) the poses go off by up to {error:.2g} (m, rad), "
            "though the wheels roll without slip: go on by odometry alone"
        )


def reads_wrapped_pivots(subject: Subject) -> None:
    """Pivot counts that wrap give what those that do not wrap give, if there are any."""
    if not robot_of(subject).pivot_encoders:
        return
    wrapped = subject.wound
    counted_on = with_pivot_counts_unwrapped(robot_of(subject), subject.winding.observations)
    unwrapped = subject.estimate(subject.winding, observations=counted_on)
    error = np.abs(wrapped - unwrapped).max()
    if error > max(1e-6, subject.tolerance):
        raise Wrong(
            f"pivot counts that wrap at pivot_counts_per_rev change the estimate by up to {error:.2g}: wrap "
            "differences of pivot angles into (-pi, pi]"
        )
