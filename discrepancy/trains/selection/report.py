"""A train's diagnosis as people read it, and as plain data for JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from discrepancy.report.page import COVERAGE, FORMAT
from discrepancy.trains.candidates import Placed
from discrepancy.trains.gap import HORIZON, Gap
from discrepancy.trains.selection.diagnosis import Finding, Rank, TrainDiagnosis

SHOWN = 8
"""Candidates that are shown, best first."""


def as_lines(found: TrainDiagnosis, names: Sequence[str]) -> list[str]:
    """Return what people read, line by line; names: of the logs."""
    lines = [f"{found.train.name}: {found.verdict}"]
    for one in found.findings or ():
        lines += _finding_lines(one)
    if not found.findings:
        lines.append(found.reason)
    rolling, side = found.slip
    lines.append(f"estimated slip: {1e3 * rolling:.2g} mm along, {1e3 * side:.2g} across, after 1 m")
    if found.sliding > 0:
        lines.append(
            f"axles are set against each other so much that some may slide in {100 * found.sliding:.0f} % of the time, "
            "which counts for little; let their wheels yield"
        )
    for name, clock in zip(names, found.clocks, strict=True):
        if clock is not None:
            how = "ahead of" if clock > 0 else "behind"
            lines.append(f"{name}: the reference is {1e3 * abs(clock):.0f} ms {how} the counts")
    lines += _gap_lines("the logs", found.before, found.after)
    if found.held_out is not None:
        lines += _gap_lines("the held-out logs", *found.held_out)
    lines.append("candidates, each alone: predicted 2 ln(likelihood ratio), and size:")
    lines += [
        f"  {one.gain:9.1f}  {one.candidate.what}: {one.amplitude:.4g} ± {COVERAGE * one.error:.2g}"
        for one in found.ranks[:SHOWN]
    ]
    return lines


def as_data(found: TrainDiagnosis, names: Sequence[str]) -> dict[str, Any]:
    """Return plain data for JSON; names: of the logs. SI units, every number finite or null."""
    train = found.found
    first = next((one for one in found.findings if one.verdict == "named"), None)
    with_reference = found.before.position is not None
    return {
        "format": FORMAT,
        "robot_hash": found.train.hash(),
        "logs": list(names),
        "verdict": found.verdict,
        "reason": found.reason,
        "effect": None if first is None or first.placed is None else _effect_data(first.placed),
        "standard_error": None if first is None else _number(first.error),
        "cannot_be_told_apart": list(found.families),
        "findings": [_finding_data(one) for one in found.findings],
        "train": None if train is None else train.to_dict(),
        "reference": {"clocks": [{"ahead_s": _number(clock)} for clock in found.clocks]} if with_reference else None,
        "slip": {"along_m": found.slip[0], "across_m": found.slip[1], "may_slide": found.sliding},
        "gap": {"before": _gap_data(found.before), "after": _gap_data(found.after)},
        "gap_held_out": None
        if found.held_out is None
        else {"before": _gap_data(found.held_out[0]), "after": _gap_data(found.held_out[1])},
        "candidates": [_rank_data(one) for one in found.ranks],
    }


def _finding_lines(one: Finding) -> list[str]:
    lines = [f"{one.verdict}: {one.reason}"]
    if one.placed is None:
        return lines
    effect, unit = one.placed.effect, "" if one.placed.effect.unit == "1" else f" {one.placed.effect.unit}"
    if one.error:
        lines.append(f"  value {one.placed.value:.4g} ± {COVERAGE * one.error:.2g}{unit} (95 %)")
    lines.append(f"  to check: {effect.check}")
    if one.beaten:
        name, gain = one.beaten[0]
        lines.append(f"  2 ln(likelihood ratio) {one.gain:.0f}; of the next best, {name}, {gain:.0f} less")
    return lines


def _gap_lines(where: str, before: Gap, after: Gap | None) -> list[str]:
    lines = [
        f"on {where}, relative poses by wheel counts, {HORIZON:g} s on: "
        f"{_off(before.posture_position, before.posture_heading)} off (rms)"
    ]
    if after is not None:
        lines[-1] += f"; with what was found: {_off(after.posture_position, after.posture_heading)}"
    if before.position is not None:
        lines.append(f"  axles against the reference: {_off(before.position, before.heading)}")
        if after is not None:
            lines[-1] += f"; with what was found: {_off(after.position, after.heading)}"
    return lines


def _off(position: float | None, heading: float | None) -> str:
    return f"{1e3 * (position or 0.0):.1f} mm and {1e3 * (heading or 0.0):.1f} mrad"


def _effect_data(placed: Placed) -> dict[str, Any]:
    """Return an effect as its file has it, `axle` first where an axle's module has it."""
    effect = placed.effect
    data = TypeAdapter(type(effect)).dump_python(effect, mode="json", exclude_none=True)
    own = {"name": effect.name, **data}
    return own if placed.axle is None else {"axle": placed.axle, **own}


def _finding_data(one: Finding) -> dict[str, Any]:
    return {
        "verdict": one.verdict,
        "reason": one.reason,
        "deviance": one.gain,
        "effect": None if one.placed is None else _effect_data(one.placed),
        "unit": None if one.placed is None else one.placed.effect.unit,
        "standard_error": _number(one.error),
        "check": None if one.placed is None else one.placed.effect.check,
        "cannot_be_told_apart": list(one.families[1:]),
        "beaten": [{"what": what, "worse_by": worse} for what, worse in one.beaten],
    }


def _gap_data(gap: Gap | None) -> dict[str, float | None] | None:
    if gap is None:
        return None
    return {
        "posture_rms_m": gap.posture_position,
        "posture_rms_rad": gap.posture_heading,
        "odometry_rms_m": gap.position,
        "odometry_rms_rad": gap.heading,
    }


def _rank_data(one: Rank) -> dict[str, Any]:
    placed = one.candidate.placed
    return {
        "what": one.candidate.what,
        "name": None if placed is None else placed.effect.name,
        "deviance": one.gain,
        "amplitude": one.amplitude,
        "standard_error": one.error,
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
