"""The pre-flight: gross mistakes, reported before any small effect is looked for.

Mistakes of assembly are the most common: encoders swapped or reversed, castors in the wrong order, counts per turn
wrong by a factor, degrees for radians. Each is a hypothesis about how the log was read (`hypotheses`). The simplest
that makes encoders and reference agree with rolling is reported (`search`), with all others that do so equally well.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.checks import MOST_PLACES, check_logs, dead_channels, mistakes_in, not_finite, remarks
from discrepancy.preflight.findings import Mistake, Preflight
from discrepancy.preflight.misfit import SEEN, Misfit, Misfits
from discrepancy.preflight.reading import Channels, Reading
from discrepancy.preflight.search import MUCH, YAW, Candidate, Found, search
from estimators.likelihood.measurements.gyro_check import gyro_against_wheels

__all__ = ["Mistake", "Preflight", "check_logs", "preflight"]

OUTLIER, OUTLIER_PART = 8.0, 0.2
"""A pose is off if the error of odometry there exceeds this multiple of the median, and this part of the way."""

CONTRADICTED, AGREED, SLID = 0.05, 0.1, 0.01
"""Least unexplained part (rms) of a motion that is reported; the part up to which encoders and reference agree well
enough to say how the reference is turned; the part from which on wheels that were driven by wrong readings count as
having slid: robots in good order stay below 0.8 % in all three simulators of `castor-diagnose trial`."""


def preflight(robot: RobotDescription, logs: Sequence[Log], names: Sequence[str] = ()) -> Preflight:
    """Return the gross mistakes in logs of a robot, and remarks on them.

    names: of the logs; "log 1" and so on if left out. Small effects are ignored here.
    """
    numbered = ["the log"] if len(logs) == 1 else [f"log {k}" for k in range(1, len(logs) + 1)]
    named = list(zip(names or numbered, logs, strict=True))
    broken = [Mistake(f"{name}: {what}") for name, log in named for what in not_finite(robot, log)]
    if broken:
        return Preflight(tuple(broken))
    reported = [f"{name}: {remark}" for name, log in named for remark in remarks(robot, log)]
    mistakes = [Mistake(f"{name}: {what}") for name, log in named for what in mistakes_in(robot, log)]
    if mistakes:
        return Preflight(tuple(mistakes), tuple(reported))
    dead = dead_channels(logs)
    misfits = Misfits(robot, logs, dead)
    if not misfits.sees:
        reported.append(
            "too little motion, or too few encoders and reference poses, to look for swapped or reversed encoders"
        )
        of_gyro = [Mistake(f"{name}: {what}") for name, log in named for what in _of_gyro(robot, log)]
        return Preflight(tuple(of_gyro), tuple(reported))
    found = search(robot, misfits)
    mistakes = [*_dead(robot, logs, found, dead), *_mistakes(misfits, found)]
    reported += _poses_off(named, misfits, found.best.reading)
    if not mistakes:
        mistakes = [Mistake(f"{name}: {what}") for name, log in named for what in _of_gyro(robot, log)]
    left = found.best.misfit
    if left.rms > CONTRADICTED and not mistakes:
        reported.append(f"{_contradiction(left)}, which is no mistake of wiring or units alone")
    rewired = any(effect.wiring for mistake in mistakes for effect in mistake.effects)
    if slid := rewired and left.rms > SLID:
        reported.append(
            f"wheels that were driven by wrong readings slid: with these put right, encoders contradict {_parts(left)} "
            "of the motion, so nothing else is looked for; correct the wiring, and record again"
        )
    return Preflight(tuple(mistakes), tuple(reported), slid)


def _of_gyro(robot: RobotDescription, log: Log) -> Iterator[str]:
    """Yield what is wrong with the sign or unit of a gyro, by the wheels."""
    check = None if robot.gyro is None else gyro_against_wheels(robot, log)
    if check is not None and check.mistaken:
        yield f"gyro_z {check.verdict} (it turns {check.scale:.3g} times as much as the wheels say)"


def _mistakes(misfits: Misfits, found: Found) -> Iterator[Mistake]:
    """Yield the mistakes found; of a combination each mistake separately."""
    best, yaw = found.best, found.best.misfit.yaw
    evidence = f"{_contradiction(found.nominal.misfit)}, and once this is undone {_parts(best.misfit)}"
    evidence += f" ({len(best.mistakes)} mistakes together)" if len(best.mistakes) > 1 else ""
    for mistake in best.mistakes:
        alternatives = tuple(_named(rival) for rival in found.alike if mistake not in rival.mistakes)
        yield Mistake(f"{mistake.what}: {evidence}; {mistake.remedy}", mistake.effects, alternatives)
    if misfits.sees_poses and abs(yaw) > YAW and best.misfit.rms < AGREED:
        side = "left" if yaw > 0 else "right"
        yield Mistake(
            f"the reference's heading points {abs(np.degrees(yaw)):.0f} degrees to the {side} of the robot's front: it "
            "then agrees with the encoders, and is taken so; if it is not mounted so, correct ref_psi",
            alternatives=tuple(_named(rival) for rival in found.alike if rival.straight),
            taken=True,
        )


def _dead(robot: RobotDescription, logs: Sequence[Log], found: Found, dead: frozenset[int]) -> Iterator[Mistake]:
    """Yield channels that never change although the other channels require that they do."""
    names = Channels(robot).names
    for channel in sorted(dead):
        without = Misfits(robot, logs, dead - {channel}).of(found.best.reading)
        if max(without.total, SEEN) > max(MUCH, 4 * found.best.left):
            yield Mistake(
                f"{names[channel]} never changes, although the other encoders say that it must: with it "
                f"{_contradiction(without)}; check its cable and its column, or give it no encoder in the robot file"
            )


def _poses_off(named: Sequence[tuple[str, Log]], misfits: Misfits, reading: Reading) -> Iterator[str]:
    """Yield the reference's jumps and outliers: where odometry misses a pose far more than elsewhere."""
    if misfits.stretches is None or not misfits.sees_poses:
        return
    residual, way = misfits.residuals(reading)
    usual = 1.4826 * float(np.median(residual))  # of a normal distribution's median, its standard deviation
    off = np.flatnonzero((residual > OUTLIER * usual) & (residual > OUTLIER_PART * np.median(way)))
    rows, log_of = misfits.stretches.rows, misfits.stretches.log
    for number, (name, log) in enumerate(named):
        places = [
            f"{1e3 * residual[k]:.0f} mm between rows {rows[k, 0] + 1} and {rows[k, 1] + 1} "
            f"(t {log.t[rows[k, 0]]:.6g} to {log.t[rows[k, 1]]:.6g} s)"
            for k in off[log_of[off] == number]
        ]
        if places:
            remainder = f"; and {len(places) - MOST_PLACES} more" if len(places) > MOST_PLACES else ""
            yield f"{name}: the reference jumps, or wheels slide: {'; '.join(places[:MOST_PLACES])}{remainder}"


def _named(candidate: Candidate) -> str:
    return " and ".join(mistake.what for mistake in candidate.mistakes) or "the reference is turned"


def _contradiction(misfit: Misfit) -> str:
    return f"as read, the encoders contradict {_parts(misfit)} of the motion (rms)"


def _parts(misfit: Misfit) -> str:
    shares = {"each other": misfit.parity, "the reference": misfit.reference, "the commands": misfit.commands}
    return " and ".join(f"{whom} by {_percent(share)}" for whom, share in shares.items() if share > 0) or "nothing"


def _percent(share: float) -> str:
    """Return the rms of a share of squares as text."""
    percent = 100 * float(np.sqrt(share))
    return f"{percent:.0f} %" if percent >= 10 else f"{percent:.1g} %"
