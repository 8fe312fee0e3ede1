"""A diagnosis by posterior in words, from its data (castor-diagnosis/2): what is missing, how sure, what it costs."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from scipy.stats import chi2

from discrepancy.posterior.calibrated import CREDIBLE
from discrepancy.posterior.verdicts import HALF
from discrepancy.report.parts import MILLI, PERCENT, READ_AS, Data, digits_by, number
from estimators.calibration.identifiability import COVERAGE

LEAST_REPORTED, MOST = 0.01, 3
"""Probability from which on another name is reported; most such names of an answer, and most answers, that a sentence
names: of more answers, it names the costliest of each verdict."""

SHOWN = 0.05
"""Probability from which on a name stands in the picture: many are as likely as they were before logs were seen."""

COSTS = (("mm", "after 10 m"), ("mrad", "after a turn"))
"""Of what an effect costs: units, and of what."""

GAPS = (("", "gap"), (" on the held-out logs", "held_out_gap"))
"""On which logs, and the key of the gap on these."""

SAYS = {
    "named": "The robot's file lacks {}.",
    "ambiguous": "Something is missing that these motions cannot distinguish: {}.",
    "unexplained": "No effect of the catalogue explains what is missing; it looks like {}.",
    "unconfirmed": "The held-out logs do not confirm what seems to be missing: {}.",
}


def sentence(data: Data) -> str:
    """Return what is missing, how sure, and what it costs; before that, if most of the gap stays."""
    answers = material(data)
    mistakes = [f"Gross mistake: {_title(mistake)}." for mistake in data["mistakes"]]
    parts = [stays(data), left_out(data), *mistakes]
    for verdict, says in SAYS.items():
        of = [answer for answer in answers if answer["verdict"] == verdict]
        of.sort(key=lambda answer: -max((cost or 0.0 for cost in answer["cost"]), default=0.0))
        several = [_told(data, answer) for answer in (of if len(answers) <= MOST else of[:1])]
        several += [f"{len(of) - len(several)} more"] if len(several) < len(of) else []
        parts += [says.format("; and ".join(several))] if several else []
    if not answers and mistakes:
        parts.append("Nothing else that matters is missing.")
    elif not answers:
        trifles = "; ".join(answer["reason"] for answer in data["answers"])
        beside = f", beside the reference's own noise of about {off(_noise(data))}" if data["noise"] else ""
        if far_off := unfound(data):
            parts += [far_off, f"Negligible: {trifles}." if trifles else ""]
        elif data.get("too_little"):
            parts.append(f"Nothing is found, but these logs show too little to be sure{beside}: drive on for longer.")
        elif trifles:
            parts.append(f"Nothing that matters is missing: {trifles}.")
        else:
            parts.append(f"The robot's file explains these logs{beside}: nothing is missing.")
    parts.append(together(data))
    return " ".join(part for part in parts if part)


def as_lines(data: Data) -> list[str]:
    """Return the same facts as the page in about ten lines."""
    lines, file = [line for line in (stays(data), left_out(data)) if line], data.get("file", "robot.json")
    lines.append(f"{data['robot']}: {data['verdict']}")
    others = {mistake["what"]: "; ".join(mistake["alternatives"]) for mistake in data["mistakes"]}
    for line in data["preflight"]:
        lines += [f"pre-flight: {line}", *([f"  or: {rivals}"] if (rivals := others.get(line)) else [])]
    for answer in material(data):
        size, check = size_of(answer), answer["check"]
        told = f"{answer['verdict']}: {answer['what']}, {percent(answer['probability'])} sure"
        below = {
            "": reason_of(data, answer),
            "the same on this robot, whatever it does: ": same_of(data, answer),
            "or: ": listed(others_of(data, answer)),
            "to distinguish them, drive ": drive_of(answer),
            "costs ": (cost_of(answer) or "nothing on these drives") + (f"; to check: {check}" if check else ""),
        }
        lines += [told + (f": {size}" if size else ""), *(f"  {name}{said}" for name, said in below.items() if said)]
    if not material(data) and not data["mistakes"]:
        lines.append(sentence(data))
    elif trifles := [answer["reason"] for answer in data["answers"] if answer["verdict"] == "negligible"]:
        lines.append(f"no fault: {'; '.join(trifles)}")
    lines += [said for said in (together(data),) if said and material(data)]
    lines += gaps_of(data)
    if replays := data["replay"]:
        before, after = replays["before"], replays["after"]
        now = f"; with {file} {_errors_of(after)}" if after else ""
        lines.append(f"simulation is off the logs after {before['window_s']:.0f} s by {_errors_of(before)} (rms){now}")
    return lines


def gaps_of(data: Data) -> list[str]:
    """Return how far odometry is off the reference, on these and on held-out logs, before and after."""
    lines, file = [], data.get("file", "robot.json")
    for log_set, of in GAPS:
        if data[of] is not None:
            before, after = data[of]
            now = "" if after is None else f"; with {file} {off(after)}, {_parts(before, after)} stay"
            lines.append(f"odometry with predicted creep is off the reference{log_set} by {off(before)} (rms){now}")
    if lines and data["clean_gap"]:
        lines.append(
            f"odometry with predicted creep is off the reference in the clean logs by {off(data['clean_gap'])} (rms)"
        )
    return lines


def _parts(before: Sequence[float | None], after: Sequence[float | None]) -> str:
    """Return the parts of a gap that stay, in position and, where it is known, in heading."""
    pairs = [(was, now) for was, now in zip(before, after, strict=True) if was is not None and now is not None]
    return " and ".join(f"{PERCENT * now / was:.0f} %" if was > 0 else "all" for was, now in pairs)


def stays(data: Data) -> str:
    """Return what stays of the gap with the robot that is written, if that is half or more; else nothing."""
    if (staying := _staying(data)) is None:
        return ""
    log_set, before, after, usual = staying
    share, of = f"{PERCENT * after / before:.0f} % of the gap{log_set} stays", f"{after:.3g} of {before:.3g} mm (rms)"
    if usual:
        return f"{share}, {of}; {usual}."
    if after >= before:
        return f"What is named does not shrink the gap{log_set}: {after:.3g} instead of {before:.3g} mm (rms)."
    return f"{share} unexplained: {of}."


def unfound(data: Data) -> str:
    """Return by how much odometry is off the reference, if nothing that matters is found and this is more than twice
    what the reference's own noise makes, and than in clean logs; else nothing."""
    if material(data) or data["mistakes"] or data["noise"] is None:
        return ""
    none, doubt = (0.0, 0.0), _doubt_of_noise(data["noise"]["poses"])
    pairs = zip(_noise(data), data["clean_gap"] or none, strict=True)
    usual = [max((noise or 0.0) * doubt, gap or 0.0) for noise, gap in pairs]
    for log_set, of in GAPS:
        gap = (data[of] or [none])[0]
        if any(HALF * (part or 0.0) > known for part, known in zip(gap, usual, strict=True)):
            return (
                f"No effect that matters is found, but odometry is off the reference{log_set} by {off(data[of][0])} "
                f"(rms), of which the reference's own noise makes about {off(_noise(data))}: look for poses that jump "
                "or stand still, and for wheels that slip."
            )
    return ""


def _doubt_of_noise(poses: int) -> float:
    """Return by what factor noise may be larger than its estimate from so many poses, at its 95 % limit."""
    return math.sqrt(poses / float(chi2.ppf(1 - CREDIBLE, poses)))


def _noise(data: Data) -> list[float | None]:
    """Return by how much the reference's own noise alone puts odometry off it (rms), m in x and y together, and rad,
    None of headings that are not known."""
    return [math.sqrt(2) * data["noise"]["position_m"], data["noise"]["heading_rad"]]


def left_out(data: Data) -> str:
    """Return the likeliest names that are not reported, if half or more of the gap stays unexplained; else nothing."""
    staying = _staying(data)
    if staying is None or staying[3]:
        return ""
    reported = {name for answer in data["answers"] for name in answer["credible_set"]}
    best = _likeliest(data, data["probabilities"], reported)
    return f"The likeliest of what is left out: {listed(best)}." if best else ""


def together(data: Data) -> str:
    """Return what is guessed of dimensions that are not sure one by one; nothing if nothing is."""
    told = [f"{of['what']} {_with_interval(of['size'], of['unit'], of['interval'])}" for of in data["dimensions"]]
    said = "Held-out logs confirm dimensions guessed together, which need not be sure one by one"
    return f"{said}; {data.get('file', 'robot.json')} has them: {'; '.join(told)}." if told else ""


def unexplained(data: Data) -> bool:
    """Whether something that matters is not named, or half of the gap stays or nothing is found, and it is no noise."""
    staying = _staying(data)
    named = all(answer["verdict"] == "named" for answer in material(data))
    return not named or (staying is not None and not staying[3]) or bool(unfound(data))


def material(data: Data) -> list[Data]:
    """Return the answers that matter."""
    return [answer for answer in data["answers"] if answer["verdict"] != "negligible"]


def size_of(answer: Data) -> str:
    """Return how large an effect is, with its 95 % interval, or what values a learned curve has; nothing of one without
    a size or a name."""
    if answer["curve"]:
        values = answer["curve"]["values"]
        return f"{number(min(values), PERCENT, 2, signed=True)} to {number(max(values), PERCENT, 2, signed=True)} %"
    return _with_interval(answer["size"], answer["unit"], answer["interval"])


def nearest_of(answer: Data) -> str:
    """Return the effect of the catalogue that does most nearly what a learned curve does, and how nearly."""
    nearest = answer["curve"] and answer["curve"]["nearest"]
    if not nearest:
        return ""
    return f"{nearest['what']}, by what it does to these logs (cosine {number(nearest['cosine'], 1, 2)}; 1: the same)"


def cost_of(answer: Data) -> str:
    """Return what an effect costs in use; nothing where these drives do not show it."""
    costs = zip(answer["cost"], COSTS, strict=False)
    return " and ".join(f"{_figures(MILLI * cost)} {unit} {of}" for cost, (unit, of) in costs if cost)


def others_of(data: Data, answer: Data) -> list[tuple[str, float]]:
    """Return the other names of an answer in words, and their probabilities, the likeliest first."""
    return _likeliest(data, answer["probabilities"], answer["credible_set"][:1])


def same_of(data: Data, answer: Data) -> str:
    """Return in words the effects that no log of this robot distinguishes from an answer's effect."""
    names = data["names"]
    return "; ".join(names.get(name, name) for name in answer["same_as"])


def reason_of(data: Data, answer: Data) -> str:
    """Return why an answer is not named, in words; nothing of one that is."""
    if answer["verdict"] == "named":
        return ""
    names, credible = data["names"], answer["credible_set"]
    if answer["verdict"] == "ambiguous" and credible:
        return f"these motions cannot distinguish: {'; '.join(names.get(name, name) for name in credible)}"
    return answer["reason"].partition("; it looks like")[0]


def drive_of(answer: Data) -> str:
    """Return the drive that would separate an answer's names, and what is expected of it; nothing where none would."""
    if not (drive := answer["separating_drive"]):
        return ""
    lasts, expected = _figures(drive["duration_s"]), _figures(drive["expected_log_bayes_factor"])
    return f"{drive['drive']} ({lasts} s; expected log Bayes factor {expected})"


def why_no_drive(data: Data) -> str:
    """Return why no drive is proposed."""
    ambiguous = any(answer["verdict"] == "ambiguous" for answer in data["answers"])
    return "no drive that is known would distinguish the names" if ambiguous else "nothing is ambiguous"


def listed(rivals: Sequence[tuple[str, float]]) -> str:
    """Return names with their probabilities."""
    return ", ".join(f"{name} ({percent(part)})" for name, part in rivals)


def percent(part: float) -> str:
    """Return a probability; none is reported as certain."""
    if part > 0.999:
        return "over 99.9 %"
    return f"{PERCENT * part:.{1 if part > 0.99 else 0}f} %" if part >= LEAST_REPORTED else "under 1 %"


def off(gap: Sequence[float | None]) -> str:
    """Return a gap (m, rad), of positions alone that of the position."""
    parts = zip(gap, COSTS, strict=True)
    return " and ".join(f"{_figures(MILLI * part)} {unit}" for part, (unit, _) in parts if part is not None)


def _likeliest(data: Data, probabilities: Mapping[str, float], but: Collection[str]) -> list[tuple[str, float]]:
    """Return names in words, but for some, and their probabilities, the likeliest first."""
    likely = [(name, part) for name, part in probabilities.items() if name not in but and part >= LEAST_REPORTED]
    best = sorted(likely, key=lambda entry: -entry[1])[:MOST]
    return [(data["names"].get(name, name), part) for name, part in best]


def _errors_of(summary: Mapping[str, Any]) -> str:
    """Return by how much the simulation misses the measurement, of a replay's summary."""
    parts = (("position_rms_mm", "mm"), ("heading_rms_mrad", "mrad"), ("wheels_rms_mm", "mm of roll"))
    known = [f"{_figures(summary[key])} {unit}" for key, unit in parts if summary[key] is not None]
    return ", ".join(known[:2]) or "nothing that was measured"


def _told(data: Data, answer: Data) -> str:
    """Return an answer in a sentence: its names, how sure, how large, and what it costs."""
    title, sure = answer["what"], f"{percent(answer['probability'])} sure"
    sure += " by these logs alone" if answer["verdict"] == "unconfirmed" else ""
    if answer["verdict"] == "ambiguous" and (rivals := others_of(data, answer)):
        names = " or ".join(f"{name} ({percent(part)})" for name, part in [(title, answer["probability"]), *rivals])
    else:
        size = size_of(answer).partition(" (")[0]
        names = f"{title} ({f'{size}, ' if size else ''}{sure})"
    cost = cost_of(answer)
    return f"{names}, which costs {cost}" if cost else names


def _staying(data: Data) -> tuple[str, float, float, str] | None:
    """Return the first gap of which half or more stays: where, mm before and after, and what is as large in good order,
    if half of it or more is: the reference's own noise, or the gap of clean logs; None if there is none."""
    replays, position, clean = data["replay"] or {}, data["noise"], data["clean_gap"]
    usual = {
        "the reference's own noise is about {:.2g} mm": math.sqrt(2) * position["position_m"] if position else 0.0,
        "it is {:.3g} mm in the clean logs": clean[0] if clean else 0.0,
    }
    gaps = [
        (log_set, [None if gap is None else MILLI * gap[0] for gap in data[of]]) for log_set, of in GAPS if data[of]
    ]
    if not gaps:
        counted = [(replays.get(state) or {}).get("wheels_rms_mm") for state in ("before", "after")]
        gaps, usual = [(" between simulated and measured wheel counts", counted)], {}
    for log_set, (before, after) in gaps:
        if before and after is not None and after >= HALF * before:
            as_usual = (told.format(MILLI * gap) for told, gap in usual.items() if MILLI * gap >= HALF * after)
            return log_set, before, after, next(as_usual, "")
    return None


def _title(mistake: Data) -> str:
    """Return a gross mistake in a few words, and what else it may be."""
    title, rivals = mistake["what"].partition(":")[0], mistake["alternatives"]
    return f"{title}, or else {'; or '.join(rivals)}" if rivals else title


def _with_interval(size: float | None, unit: str | None, interval: Sequence[float] | None) -> str:
    """Return a size with its 95 % interval; nothing without a size or a unit."""
    if size is None or unit is None or not interval:
        return ""
    name, scale = READ_AS.get(str(unit), (str(unit), 1.0))
    digits = digits_by((interval[1] - interval[0]) / (2 * COVERAGE), scale)
    shown, low, high = (number(value, scale, digits, signed=True) for value in (size, *interval))
    return f"{shown} {name} ({low} to {high})"


def _figures(value: float) -> str:
    """Return a number to three figures, as people write it."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
