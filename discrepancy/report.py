"""A diagnosis as people read it, as JSON, and as files."""

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.description import fingerprint
from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from discrepancy.diagnosis import Diagnosis, Gap, Rank

FORMAT = "castor-diagnosis/1"
COVERAGE = 1.96
"""Standard errors on either side of a 95 % interval."""

SHOWN = 8
"""Candidates that are shown, best first."""


def as_lines(found: Diagnosis, logs: Sequence[str]) -> list[str]:
    """Return what people read, line by line."""
    lines = [f"{found.robot.name}: {found.verdict}", found.reason]
    if found.effect is not None and found.error is not None:
        kind = type(found.effect)
        unit = "" if kind.unit == "1" else f" {kind.unit}"
        lines.append(f"value {found.effect.value:.4g} ± {COVERAGE * found.error:.2g}{unit} (95 %)")
        lines.append(f"to check: {kind.check}")
    lines.append(
        f"slip beside it: {1e3 * found.before.along:.2g} mm along, {1e3 * found.before.across:.2g} across, after 1 m"
    )
    if found.before.position is not None:
        x, y, turned = found.mount
        lines.append(
            f"reference: tracked point at x {1e3 * x:.1f}, y {1e3 * y:.1f} mm, turned by {np.degrees(turned):.2f} deg"
        )
        lines += [
            f"{name}: the reference is {1e3 * abs(ahead):.0f} ms {'ahead of' if ahead > 0 else 'behind'} the counts "
            f"at the start, and gains {1e3 * rate:.1f} ms/s"
            for name, (ahead, rate) in zip(logs, found.clocks, strict=True)
        ]
        lines.append(
            f"odometry off the reference: {_gap(found.before)}"
            + (f", after {_gap(found.after)}" if found.after else "")
        )
    if found.held_out is not None and found.held_out[0].position is not None:
        before, after = found.held_out
        lines.append(f"on the held-out logs: {_gap(before)}, after {_gap(after)}")
    lines.append("deviance that each candidate alone would take away, and its size:")
    lines += [
        f"  {one.gain:9.1f}  {one.candidate.what}: {one.amplitude:.4g} ± {COVERAGE * one.error:.2g}"
        for one in found.ranks[:SHOWN]
    ]
    return lines


def as_data(found: Diagnosis, logs: Sequence[str]) -> dict[str, Any]:
    """Return plain data for JSON; SI units, every number finite or null."""
    robot = found.found
    return {
        "format": FORMAT,
        "robot_hash": found.robot.hash(),
        "logs": list(logs),
        "verdict": found.verdict,
        "reason": found.reason,
        "effect": None if robot is None else robot.to_dict()["effects"][-1],
        "standard_error": found.error if robot is not None else None,
        "cannot_be_told_apart": list(found.families),
        "reference": {
            "mount": {"x_m": float(found.mount[0]), "y_m": float(found.mount[1]), "psi_rad": float(found.mount[2])},
            "clocks": [{"ahead_s": float(ahead), "rate": float(rate)} for ahead, rate in found.clocks],
        }
        if found.before.position is not None
        else None,
        "gap": {"before": _gap_data(found.before), "after": _gap_data(found.after)},
        "gap_held_out": None
        if found.held_out is None
        else {"before": _gap_data(found.held_out[0]), "after": _gap_data(found.held_out[1])},
        "candidates": [_rank_data(one) for one in found.ranks],
    }


def write_diagnosis(out: Path, found: Diagnosis, data: dict[str, Any]) -> None:
    """Write diagnosis.json, and robot.json with the named effect, to a new folder, all or nothing."""
    partial = out.with_name(f".{out.name}.{fingerprint(data)}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        os.makedirs(partial)
        write_atomically(partial / "diagnosis.json", json.dumps(data, indent=2, allow_nan=False) + "\n")
        if found.found is not None:
            found.found.save(partial / "robot.json")
        partial.rename(out)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise InputError(f"--out {out}: cannot be written to ({error.strerror or error})") from None


def _gap(gap: Gap) -> str:
    return f"{1e3 * (gap.position or 0.0):.1f} mm and {1e3 * (gap.heading or 0.0):.1f} mrad (rms)"


def _gap_data(gap: Gap | None) -> dict[str, float | None] | None:
    if gap is None:
        return None
    return {
        "odometry_rms_m": gap.position,
        "odometry_rms_rad": gap.heading,
        "slip_along_m": gap.along,
        "slip_across_m": gap.across,
    }


def _rank_data(one: Rank) -> dict[str, Any]:
    return {
        "what": one.candidate.what,
        "name": None if one.candidate.effect is None else one.candidate.effect.name,
        "deviance": one.gain,
        "amplitude": one.amplitude,
        "standard_error": one.error,
    }
