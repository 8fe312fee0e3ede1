"""A tracked point that swings: what is left of the reference goes to and fro, as seen from the body.

No effect on angles shows in it, and no noise has a period: at each of many frequencies a sine is fitted to what is
left of the reference's poses in the body's frame (Fisher's test for a hidden period, 1929).
"""

from collections.abc import Sequence

import numpy as np

from castor_envs.kinematics import Array
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from castor_envs.se2 import relative_pose
from discrepancy.candidates import Candidate
from discrepancy.evidence import Evidence
from discrepancy.findings import Finding, Rank
from discrepancy.replay import poses_in
from estimators.castor_odometry import wrap

AXES = ("forward", "to the left", "turning")
UNITS = (1e3, "mm"), (1e3, "mm"), (1e3, "mrad")

LEAST_GAIN = 40.0
"""The deviance that a sine must take away: by chance in one of ten million logs."""

TIMES, FEWEST, MOST = 4, 12, 200
"""A period is seen so many times at least, in no fewer poses; and at most in a log."""


def swinging(robot: RobotDescription, logs: Sequence[Log], seen: Evidence) -> Finding | None:
    """Return the finding that the point swings which the reference tracks; None if it does not, or there is none.

    seen: evidence of the logs by this robot.
    """
    best: tuple[float, str, float] | None = None
    for k, (log, state, clock) in enumerate(zip(logs, seen.state.states, seen.state.clocks, strict=True)):
        of = f" in log {k + 1}" if len(logs) > 1 else ""
        t, poses = poses_in(robot, log, clock, seen.state.mount)
        if len(t) < FEWEST:
            continue
        truly = np.stack([np.interp(t, log.t, column) for column in state[:, :3].T], axis=-1)
        off = relative_pose(truly, poses)
        off[:, 2] = wrap(off[:, 2])
        for axis, (scale, unit) in enumerate(UNITS):
            gain, frequency, size = _period(t, off[:, axis])
            if best is None or gain > best[0]:
                every, by = f"{1 / frequency:.1f} s", f"{scale * size:.2g} {unit}"
                best = gain, f"the tracked point swings {AXES[axis]} every {every}, by {by}{of}", size
    if best is None or best[0] < LEAST_GAIN:
        return None
    gain, said, size = best
    rank = Rank(Candidate(said), gain, gain, 0.0, (size,), (size / np.sqrt(gain),))
    return Finding("unexplained", f"no effect of the catalogue looks like it; it is: {said}", (rank,), ())


def _period(t: Array, values: Array) -> tuple[float, float, float]:
    """Return the deviance that the best sine takes away from values (k,), its frequency (Hz) and amplitude."""
    length, n = t[-1] - t[0], len(t)
    frequencies = np.arange(TIMES, min(n / 2, MOST), 0.5) / length
    phase = 2 * np.pi * frequencies[:, None] * (t - t[0])
    sines = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase)], axis=-1)
    told = np.swapaxes(sines, 1, 2) @ sines
    fitted = np.linalg.solve(told, np.swapaxes(sines, 1, 2) @ values[:, None])
    left = np.sum((values - (sines @ fitted)[..., 0]) ** 2, axis=1)
    k = int(np.argmin(left))
    gain = n * float(np.log(np.sum((values - values.mean()) ** 2) / max(left[k], 1e-30)))
    return gain, float(frequencies[k]), float(np.hypot(*fitted[k, :2, 0]))
