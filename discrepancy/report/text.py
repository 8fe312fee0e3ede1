"""A diagnosis as lines of text, as JSON data, and as files."""

import dataclasses
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.description import fingerprint
from castor_envs.errors import InputError
from castor_envs.files import write_atomically, write_json
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.load import Vehicle, file_name
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import described
from discrepancy.inference.findings import Diagnosis, Finding, Left, Rank
from discrepancy.preflight import Mistake
from discrepancy.report.parts import READ_AS
from discrepancy.validation.cost import WAY, cost_of
from discrepancy.validation.discriminating_drive import separating_drive
from estimators.calibration.maximum_likelihood import State

FORMAT = "castor-diagnosis/1"
COVERAGE = 1.96
"""Standard errors on either side of a 95 % interval."""

NOTHING = 1e-4
"""m per 10 m that are not worth telling."""

SHOWN = 5
"""Rivals that are shown, best first."""

TOLD_AS = READ_AS | {"s/s": ("ms/s", 1e3)}
"""Units, and what lines of text tell instead, so many to one."""

Data = dict[str, Any]


def as_data(found: Diagnosis, logs: dict[str, Log]) -> Data:
    """Return plain data for JSON; SI units, every number finite or null. logs: by their names."""
    robot = found.found
    return {
        "format": FORMAT,
        "robot": found.robot.name,
        "robot_hash": found.robot.hash(),
        "logs": list(logs),
        "verdict": found.verdict,
        "reason": found.reason,
        "effects": [] if robot is None else robot.to_dict()["effects"][len(found.robot.effects) :],
        "findings": [_finding_data(found.robot, finding, list(logs.values())) for finding in found.findings],
        "reference": _reference_data(found),
        "gap": {"before": _gap_data(found.before), "after": _gap_data(found.after)},
        "gap_held_out": None
        if found.held_out is None
        else {"before": _gap_data(found.held_out[0]), "after": _gap_data(found.held_out[1])},
        "candidates": [_rank_data(rank) for rank in found.ranks],
    }


def as_lines(data: Data) -> list[str]:
    """Return what people read, line by line, of the data of a diagnosis."""
    lines = [*(f"pre-flight: {line}" for line in data["preflight"]), f"{data['robot']}: {data['verdict']}"]
    if not data["findings"]:
        lines.append(data["reason"])
    for finding in data["findings"]:
        lines += _finding_lines(finding)
    slip = data["gap"]["before"]
    lines.append(
        f"estimated slip: {1e3 * slip['slip_along_m']:.2g} mm along, {1e3 * slip['slip_across_m']:.2g} mm across, "
        "after 1 m"
    )
    if (reference := data["reference"]) is not None:
        lines.append(f"reference: {_mount_line(reference['mount'])}")
        lines += [
            f"{name}: the reference is {_clock_line(clock)}"
            for name, clock in zip(data["logs"], reference["clocks"], strict=True)
        ]
        if (clean := reference["clean"]) is not None:
            lines.append(f"in the clean logs: {_mount_line(clean['mount'])}; the reference is")
            lines += [f"  {_clock_line(clock)}" for clock in clean["clocks"]]
        lines.append(f"odometry differs from the reference by {_gap(data['gap'])}")
    if data["gap_held_out"] is not None and data["gap_held_out"]["before"]["odometry_rms_m"] is not None:
        lines.append(f"on the held-out logs by {_gap(data['gap_held_out'])}")
    for key, what in (("", "the logs"), ("held_out_", "the held-out logs")):
        lines += _replay_lines(data["replay"], key, what)
    if not data["findings"]:
        lines.append("candidates, each alone: 2 ln(likelihood ratio), and size:")
        lines += [f"  {_candidate_line(rank)}" for rank in data["candidates"][:SHOWN]]
    return lines


def _mount_line(mount: Data) -> str:
    return (
        f"tracked point at x {1e3 * mount['x_m']:z.1f}, y {1e3 * mount['y_m']:z.1f} mm, turned by "
        f"{np.degrees(mount['psi_rad']):z.2f} deg"
    )


def _clock_line(clock: Data) -> str:
    return (
        f"{1e3 * abs(clock['ahead_s']):.1f} ms {'ahead of' if clock['ahead_s'] > 0 else 'behind'} the counts at the "
        f"start, and gains {1e3 * clock['rate']:z.2f} ms/s"
    )


def write_diagnosis(out: Path, data: Data, found: Vehicle | None, page: str) -> None:
    """Write diagnosis.json, report.html and what is named, as robot.json or train.json, to a new folder; or nothing."""
    partial = out.with_name(f".{out.name}.{fingerprint(data)}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        os.makedirs(partial)
        write_json(partial / "diagnosis.json", data)
        write_atomically(partial / "report.html", page)
        if found is not None:
            found.save(partial / file_name(found))
        partial.rename(out)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise InputError(f"--out {out}: cannot be written to ({error.strerror or error})") from None


def _finding_data(robot: RobotDescription, finding: Finding, logs: Sequence[Log]) -> Data:
    effect, error = finding.effect, finding.error
    separating = None
    if finding.verdict == "ambiguous":
        posed = any(log.reference is not None and np.isfinite(log.reference).any() for log in logs)
        alternatives = [(rank.candidate, np.array(rank.amplitudes)) for rank in finding.chosen]
        separating = separating_drive(robot, alternatives, "all" if posed else "none")
    return {
        "verdict": finding.verdict,
        "reason": finding.reason,
        "title": described(effect) if effect is not None else finding.chosen[0].candidate.what,
        "effect": None if effect is None else dataclasses.asdict(effect),
        "unit": None if effect is None else effect.unit,
        "standard_error": error,
        "interval": None
        if effect is None or error is None
        else [effect.value - COVERAGE * error, effect.value + COVERAGE * error],
        "check": None if effect is None else effect.check,
        "same_as": [] if effect is None else [name for name in effect.indistinguishable_from if name != effect.name],
        "deviance": finding.gain,
        "hidden_by_creep": finding.chosen[0].part,
        "cost": _cost_data(robot, effect, logs),
        "cannot_be_told_apart": list(finding.families),
        "separating_motion": separating,
        "rivals": [_rank_data(rank) for rank in finding.beaten[:SHOWN]],
    }


def mistake_data(mistake: Mistake) -> Data:
    """Return the data of a gross mistake, as of a finding."""
    effects = [dataclasses.asdict(effect) for effect in mistake.effects]
    return {
        "verdict": "ambiguous" if mistake.alternatives else "named",
        "reason": mistake.what,
        "title": mistake.what.split(":")[0],
        "effect": effects[0] if len(effects) == 1 else None,
        "effects": effects,
        "unit": None,
        "standard_error": None,
        "interval": None,
        "check": mistake.effects[0].check,
        "same_as": [],
        "deviance": None,
        "hidden_by_creep": None,
        "cost": None,
        "cannot_be_told_apart": [mistake.what.split(":")[0], *mistake.alternatives],
        "separating_motion": None,
        "rivals": [],
    }


def _cost_data(robot: RobotDescription, effect: Effect | None, logs: Sequence[Log]) -> Data | None:
    cost = None if effect is None else cost_of(robot, effect, logs)
    return None if cost is None else {"m_per_10_m": cost}


def _reference_data(found: Diagnosis) -> Data | None:
    if found.before.position is None:
        return None
    clean = None if found.clean is None or found.clean.position is None else _alignment(found.clean.state)
    return _alignment((found.after or found.before).state) | {"clean": clean}


def _alignment(at: State) -> Data:
    x, y, psi = at.mount.tolist()
    return {
        "mount": {"x_m": x, "y_m": y, "psi_rad": psi},
        "clocks": [{"ahead_s": float(ahead), "rate": float(rate)} for ahead, rate in at.clocks],
    }


def _gap_data(gap: Left | None) -> Data | None:
    if gap is None:
        return None
    return {
        "odometry_rms_m": gap.position,
        "odometry_rms_rad": gap.heading,
        "slip_along_m": gap.noise.along,
        "slip_across_m": gap.noise.across,
    }


def _rank_data(rank: Rank) -> Data:
    return {
        "what": rank.candidate.what,
        "name": rank.candidate.kinds[0].name if rank.candidate.kinds else None,
        "deviance": rank.gain,
        "deviance_if_wheels_creep": rank.sober,
        "amplitude": rank.size,
        "standard_error": rank.error,
    }


def _finding_lines(finding: Data) -> list[str]:
    lines = [f"{finding['verdict']}: {finding['title']}"]
    if finding["reason"] != finding["title"]:
        lines.append(f"  {finding['reason']}")
    if finding["effect"] is not None and finding["interval"] is not None:
        unit, scale = TOLD_AS.get(finding["unit"], (finding["unit"], 1.0))
        half = (finding["interval"][1] - finding["interval"][0]) / 2
        lines.append(f"  value {scale * finding['effect']['value']:.4g} ± {scale * half:.2g} {unit} (95 %)")
    if finding["same_as"]:
        lines.append(f"  no log can distinguish it from: {', '.join(finding['same_as'])}")
    if finding["cost"] is not None and finding["cost"]["m_per_10_m"] > NOTHING:
        lines.append(f"  it costs {1e3 * finding['cost']['m_per_10_m']:.1f} mm per {WAY:.0f} m of odometry")
    if finding["check"]:
        lines.append(f"  to check: {finding['check']}")
    if finding["separating_motion"] is not None:
        lines.append(f"  to distinguish them, drive {finding['separating_motion']}")
    if finding["cannot_be_told_apart"][1:] and finding["deviance"] is None:
        lines.append(f"  or: {'; '.join(finding['cannot_be_told_apart'][1:])}")
    if finding["deviance"] is not None:
        lines.append(
            f"  2 ln(likelihood ratio) {finding['deviance']:.0f}"
            + ("; the other candidates:" if finding["rivals"] else "")
        )
    lines += [f"    {_candidate_line(rank)}" for rank in finding["rivals"]]
    return lines


def _replay_lines(replays: Data | None, key: str, what: str) -> list[str]:
    before, after = ((replays or {}).get(f"{key}{when}") for when in ("before", "after"))
    if before is None:
        return []
    said = f"simulation driven as {what}, {before['window_s']:.0f} s at a time, differs from them by"
    return [f"{said} {_miss(before)} (rms)" + (f"; with what was found: {_miss(after)}" if after else "")]


def _miss(summary: Data) -> str:
    parts = (("position_rms_mm", "mm"), ("heading_rms_mrad", "mrad"), ("wheels_rms_mm", "mm of roll"))
    known = [f"{summary[key]:.2g} {unit}" for key, unit in parts if summary[key] is not None]
    return ", ".join(known) or "nothing that was measured"


def _candidate_line(rank: Data) -> str:
    return f"{rank['deviance']:9.1f}  {rank['what']}: {rank['amplitude']:.4g} ± {COVERAGE * rank['standard_error']:.2g}"


def _gap(gaps: Data) -> str:
    before, after = (
        None if gap is None else f"{1e3 * gap['odometry_rms_m']:.1f} mm and {1e3 * gap['odometry_rms_rad']:.1f} mrad"
        for gap in (gaps["before"], gaps["after"])
    )
    return f"{before} (rms)" + (f"; with what was found: {after}" if after else "")
