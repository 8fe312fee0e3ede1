"""The pre-flight: gross mistakes, reported before any small effect is looked for.

Mistakes of assembly are the most common: encoders swapped or reversed, castors in the wrong order, counts per turn
wrong by a factor, degrees for radians. Each is a hypothesis about how the log was read (`hypotheses`). The simplest
that makes encoders and reference agree with rolling is reported (`search`), with all others that do so equally well.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.findings import Mistake, Preflight
from discrepancy.preflight.misfit import SEEN, Misfit, Misfits
from discrepancy.preflight.reading import Reading
from discrepancy.preflight.sanity import (
    Named,
    check_logs,
    dead_channels,
    not_finite,
    remarks,
    time_mistakes,
    wrapped_counts,
)
from discrepancy.preflight.search import MUCH, YAW, Candidate, Found, search

__all__ = ["Mistake", "Preflight", "check_logs", "preflight"]

OUTLIER, OUTLIER_PART = 8.0, 0.2
"""A pose is off if the error of odometry there exceeds this multiple of the median, and this part of the way."""

CONTRADICTED = 0.05
"""Least unexplained part (rms) of a motion that is reported."""

AGREED = 0.1
"""The part (rms) up to which encoders and reference agree well enough to say how the reference is turned."""


def preflight(robot: RobotDescription, logs: Sequence[Log], names: Sequence[str] = ()) -> Preflight:
    """Return the gross mistakes in logs of a robot, and remarks on them.

    names: of the logs; "log 1" and so on if left out. Small effects are ignored here.
    """
    called = [Named(name, log) for name, log in zip(names or _numbered(logs), logs, strict=True)]
    broken = [mistake for named_log in called for mistake in not_finite(robot, named_log)]
    if broken:
        return Preflight(tuple(broken))
    reported = [remark for named_log in called for remark in remarks(robot, named_log)]
    mistakes = [
        mistake
        for named_log in called
        for kind in (time_mistakes, wrapped_counts)
        for mistake in kind(robot, named_log)
    ]
    if mistakes:
        return Preflight(tuple(mistakes), tuple(reported))
    dead = dead_channels(robot, logs)
    misfits = Misfits(robot, logs, dead)
    if not misfits.sees:
        reported.append(
            "too little motion, or too few encoders and reference poses, to look for swapped or reversed encoders"
        )
        return Preflight((), tuple(reported))
    found = search(robot, misfits)
    mistakes = [*_dead(robot, logs, misfits, found, dead), *_mistakes(robot, misfits, found)]
    reported += _poses_off(called, misfits, found.best.reading)
    left = found.best.misfit
    if left.rms > CONTRADICTED and not mistakes:
        reported.append(f"{_contradiction(left)}, which is no mistake of wiring or units alone")
    return Preflight(tuple(mistakes), tuple(reported))


def _numbered(logs: Sequence[Log]) -> list[str]:
    return ["the log"] if len(logs) == 1 else [f"log {k + 1}" for k in range(len(logs))]


def _mistakes(robot: RobotDescription, misfits: Misfits, found: Found) -> Iterator[Mistake]:
    """Yield the mistakes found; of a combination each mistake separately."""
    nominal, best = found.nominal, found.best
    for hypothesis in best.mistakes:
        alternatives = [candidate for candidate in found.alike if hypothesis not in candidate.mistakes]
        evidence = f"{_contradiction(nominal.misfit)}, and by {_parts(best.misfit)} if so"
        if len(best.mistakes) > 1:
            evidence += f" ({len(best.mistakes)} mistakes together)"
        sentence = f"{hypothesis.what}: {evidence}; {hypothesis.remedy}"
        yield Mistake(sentence, hypothesis.effects, tuple(_named(candidate) for candidate in alternatives))
    yaw = best.misfit.yaw
    if misfits.poses is not None and abs(yaw) > YAW and best.misfit.rms < AGREED:
        straight = [candidate for candidate in found.alike if abs(candidate.misfit.yaw) < YAW]
        side = "left" if yaw > 0 else "right"
        yield Mistake(
            f"the reference's heading points {abs(np.degrees(yaw)):.0f} degrees to the {side} of the robot's front: it "
            "then agrees with the encoders, and is taken so; if it is not mounted so, correct ref_psi",
            alternatives=tuple(_named(candidate) for candidate in straight),
            taken=True,
        )


def _dead(
    robot: RobotDescription, logs: Sequence[Log], misfits: Misfits, found: Found, dead: frozenset[int]
) -> Iterator[Mistake]:
    """Yield channels that never change although the other channels require that they do."""
    columns = LogColumns.of(robot)
    names = (*columns.wheel, *columns.pivot)
    for channel in sorted(dead):
        without = Misfits(robot, logs, dead - {channel}).of(found.best.reading)
        if max(without.total, SEEN) > max(MUCH, 4 * found.best.left):
            yield Mistake(
                f"{names[channel]} never changes, although the other encoders say that it must: with it "
                f"{_contradiction(without)}; check its cable and its column, or give it no encoder in the robot file"
            )


def _poses_off(called: Sequence[Named], misfits: Misfits, reading: Reading) -> list[str]:
    """Return the reference's jumps and outliers: where odometry misses a pose far more than elsewhere."""
    poses = misfits.poses
    if poses is None or not misfits.sees_poses:
        return []
    residual, way = misfits.residuals(reading)
    usual = 1.4826 * float(np.median(residual))
    off = np.flatnonzero((residual > OUTLIER * usual) & (residual > OUTLIER_PART * np.median(way)))
    reported = []
    for number, named_log in enumerate(called):
        places = [
            f"{1e3 * residual[k]:.0f} mm between rows {poses.rows[k, 0] + 1} and {poses.rows[k, 1] + 1} "
            f"(t {named_log.log.t[poses.rows[k, 0]]:.6g} to {named_log.log.t[poses.rows[k, 1]]:.6g} s)"
            for k in off[poses.log[off] == number]
        ]
        if places:
            remainder = f"; and {len(places) - 3} more" if len(places) > 3 else ""
            reported.append(
                f"{named_log.name}: the reference jumps, or wheels slide: {'; '.join(places[:3])}{remainder}"
            )
    return reported


def _named(candidate: Candidate) -> str:
    return " and ".join(mistake.what for mistake in candidate.mistakes) or "the reference is turned"


def _contradiction(misfit: Misfit) -> str:
    return f"as read, the encoders contradict {_parts(misfit)} of the motion (rms)"


def _parts(misfit: Misfit) -> str:
    shares = {"each other": misfit.parity, "the reference": misfit.reference}
    return " and ".join(f"{whom} by {_percent(share)}" for whom, share in shares.items() if share > 0) or "nothing"


def _percent(share: float) -> str:
    """Return the rms of a share of squares as text."""
    percent = 100 * float(np.sqrt(share))
    return f"{percent:.0f} %" if percent >= 10 else f"{percent:.1g} %"
