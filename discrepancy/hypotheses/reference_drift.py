"""A reference that goes to and fro: a tracked point that swings, as seen from the body, or a tracker that drifts.

No effect on angles shows in what is left of its poses, and no noise has a period: at each of many frequencies a sine is
fitted to it (Fisher's test for a hidden period, 1929). What drifts does so slowly, in place, along both axes.
"""

from collections.abc import Sequence

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose, wrap
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.inference.evidence import Evidence
from discrepancy.inference.findings import Finding, Rank
from discrepancy.validation.replay import poses_in

AXES = ("forward", "to the left", "turning")
UNITS = (1e3, "mm"), (1e3, "mm"), (1e3, "mrad")

LEAST_GAIN = 40.0
"""The deviance that a sine must take away: by chance in one of ten million logs."""

TIMES, FEWEST, MOST = 4, 12, 200
"""A period is seen so many times at least, in no fewer poses; and at most in a log."""

SLOWEST = 0.5
"""The same of what drifts, at least; at most `TIMES`."""


def swinging(robot: RobotDescription, logs: Sequence[Log], seen: Evidence) -> Finding | None:
    """Return the finding that the reference drifts, or the point swings which it tracks; None if neither does.

    seen: evidence of the logs by this robot.
    """
    best: tuple[float, str, float] | None = None
    for k, (log, state, clock) in enumerate(zip(logs, seen.state.states, seen.state.clocks, strict=True)):
        of = f" in log {k + 1}" if len(logs) > 1 else ""
        t, poses = poses_in(robot, log, clock, seen.state.mount)
        if len(t) < FEWEST:
            continue
        truly = np.stack([np.interp(t, log.t, column) for column in state[:, :3].T], axis=-1)
        off, away = relative_pose(truly, poses), poses - truly
        off[:, 2] = away[:, 2] = wrap(away[:, 2])
        found: list[tuple[float, str, float]] = []
        for axis, (scale, unit) in enumerate(UNITS):
            gain, frequency, size = _period(t, off[:, axis : axis + 1], TIMES, MOST)
            every, by = f"{1 / frequency:.1f} s", f"{scale * size:.2g} {unit}"
            found.append((gain, f"the tracked point swings {AXES[axis]} every {every}, by {by}{of}", size))
        for own, what, (scale, unit) in ((slice(2), "place", UNITS[0]), (slice(2, 3), "heading", UNITS[2])):
            gain, _, size = _period(t, away[:, own], SLOWEST, TIMES)
            found.append((gain, f"the reference's {what} drifts slowly, by {scale * size:.2g} {unit}{of}", size))
        best = max([*found, *([] if best is None else [best])])
    if best is None or best[0] < LEAST_GAIN:
        return None
    gain, said, size = best
    rank = Rank(Candidate(said), gain, gain, 0.0, (size,), (size / np.sqrt(gain),))
    return Finding("unexplained", f"no effect of the catalogue explains it; it looks like: {said}", (rank,), ())


def _period(t: Array, values: Array, fewest: float, most: float) -> tuple[float, float, float]:
    """Return the deviance that sines of the best frequency take away from values (k, axes), it (Hz), and how large the
    longest of them is. fewest, most: periods in all the time."""
    length, n = t[-1] - t[0], len(t)
    frequencies = np.arange(fewest, min(n / 2, most), 0.5) / length
    phase = 2 * np.pi * frequencies[:, None] * (t - t[0])
    sines = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase)], axis=-1)
    told = np.swapaxes(sines, 1, 2) @ sines
    fitted = np.linalg.solve(told, np.swapaxes(sines, 1, 2) @ values)
    left = np.maximum(np.sum((values - sines @ fitted) ** 2, axis=1), 1e-30)
    gains = n * np.sum(np.log(np.sum((values - values.mean(axis=0)) ** 2, axis=0) / left), axis=1)
    k = int(np.argmax(gains))
    return float(gains[k]), float(frequencies[k]), float(np.hypot(*fitted[k, :2]).max())
