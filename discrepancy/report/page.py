"""The report as one self-contained HTML page: a pure function of the diagnosis' data and of pictures.

`html_of` takes the data that `castor-diagnose` writes as JSON. Entries that are missing there are left out here; all
text from users' files is escaped.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from discrepancy.report.parts import (
    MOTION,
    READ_AS,
    Data,
    before_after,
    digits_by,
    figure,
    figures,
    full,
    json_of,
    logs_line,
    mapping,
    mappings,
    number,
    page_of,
    replayed,
    section,
    table,
    text,
)
from discrepancy.report.pictures import Picture

FORMAT = "castor-diagnosis/1"

COVERAGE = 1.96
"""Standard errors on either side of a 95 % interval."""

PLACES = {"at_s": "when", "from_s": "from", "to_s": "to", "x_m": "where, x", "y_m": "where, y"}
"""Keys of where it is whose numbers are read as they stand."""

SAYS = {
    "named": "Something is missing in the robot's file, and it has a name.",
    "ambiguous": "Something is missing in the robot's file; these motions cannot distinguish several effects.",
    "unconfirmed": "Something seems to be missing in the robot's file, but the held-out logs do not confirm it.",
    "unexplained": "Robot and file disagree, and no effect of the catalogue explains it.",
    "no discrepancy": "The robot's file explains these logs: nothing is missing.",
}

SLIP = (
    ("odometry_rms_m", "position", "mm"),
    ("odometry_rms_rad", "heading", "mrad"),
    ("slip_along_m", "slip along, 1 m", "mm"),
    ("slip_across_m", "slip across, 1 m", "mm"),
)
"""Of a gap, in m and rad: key, what people read, unit of a thousandth."""


def html_of(data: Data, pictures: Sequence[Picture] = ()) -> str:
    """Return the report: the same bytes for the same data and pictures.

    data: as written by castor-diagnose (castor-diagnosis/1). pictures: by their names each goes to its section, others
    to the end.
    """
    shown = {picture.name: picture for picture in pictures}
    sections = [
        section("Pre-flight", _preflight(data)),
        section("Reference", _reference(data)),
        section("The gap", _gap(data, figures(shown, "replay", "errors", "paths"))),
        section("Where it is", _where(data) + figures(shown, "slip", "floor")),
        section("What is missing" if data.get("findings") else "Candidates", _findings(data)),
        section("What else it might be", _alternatives(data) + figures(shown, "candidates")),
        section("Robot file", _robot_file(data)),
        section("More pictures", "".join(figure(picture) for picture in shown.values())),
        section("Numbers in full", full(data)),
    ]
    return page_of(data, _sentence(data), logs_line(data), sections)


def _sentence(data: Data) -> str:
    """Return the verdict in one sentence."""
    verdict, findings = str(data.get("verdict") or ""), mappings(data.get("findings"))
    named = "; ".join(f"{_title(finding)} {_amount(finding)}".strip() for finding in findings)
    if verdict == "named" and named:
        return f"The robot's file lacks {'an effect' if len(findings) == 1 else f'{len(findings)} effects'}: {named}."
    says = SAYS.get(verdict, "")
    if named:
        return f"{says} Found: {named}."
    told = verdict == "ambiguous" and len(data.get("cannot_be_told_apart") or ()) > 1
    reason = "" if told else str(data.get("reason") or "")
    return " ".join(part for part in (says, f"{reason[:1].upper()}{reason[1:].rstrip('.')}." if reason else "") if part)


def _preflight(data: Data) -> str:
    if data.get("preflight") is None:
        return ""
    lines = [f"<li>{text(line)}</li>" for line in data["preflight"]]
    if not lines:
        return "<p>No gross mistake: channels, directions, counts a turn, units and the order of castors agree.</p>"
    return f'<ul class="loud">{"".join(lines)}</ul>'


def _reference(data: Data) -> str:
    reference = mapping(data.get("reference"))
    if not reference:
        if "reference" not in data:
            return ""
        return "<p>There are no reference poses. Scale and the robot's common dimensions cannot be seen.</p>"
    clocks, clean = mappings(reference.get("clocks")), mapping(reference.get("clean"))
    several = [f", {_file(data, k)}" if len(clocks) > 1 else "" for k in range(len(clocks))]
    rows = _alignment("", mapping(reference.get("mount")), zip(several, clocks, strict=True))
    numbered = ((f", clean log {k + 1}", clock) for k, clock in enumerate(mappings(clean.get("clocks"))))
    rows += _alignment(", in the clean logs", mapping(clean.get("mount")), numbered)
    body = [[label, number(value, scale, digits, signed=True), unit] for label, value, scale, unit, digits in rows]
    return "<p>Fitted beside everything else, and no effect of the robot:</p>" + table(None, body)


def _alignment(of: str, mount: Data, clocks: Iterable[tuple[str, Data]]) -> list[tuple[str, Any, float, str, int]]:
    rows = []
    if mount:
        rows += [
            (f"tracked point, forward of the body's origin{of}", mount.get("x_m"), 1e3, "mm", 1),
            (f"tracked point, left of it{of}", mount.get("y_m"), 1e3, "mm", 1),
            (f"frame turned against the body{of}", mount.get("psi_rad"), 1e3, "mrad", 1),
        ]
    for suffix, clock in clocks:
        rows += [
            (f"reference taken later than its row says{suffix}", clock.get("ahead_s"), 1e3, "ms", 1),
            (f"and drifting by{suffix}", clock.get("rate"), 1e3, "ms/s", 2),
        ]
    return rows


def _file(data: Data, k: int) -> str:
    logs = data.get("logs") or ()
    return Path(str(logs[k])).name if k < len(logs) else f"log {k + 1}"


def _gap(data: Data, drawn: str) -> str:
    replay = mapping(data.get("replay"))
    parity = [mapping(mapping(data.get(of)).get(key)) for of in ("gap", "gap_held_out") for key in ("before", "after")]
    parts = [
        before_after(
            "Simulation less measurement, at the end of a window (rms)",
            [mapping(replay.get(key)) for key in ("before", "after", "held_out_before", "held_out_after")],
            MOTION,
            1.0,
        ),
        before_after(
            "Counts less reference: dead reckoning (rms), and the slip that would explain the rest",
            parity,
            SLIP,
            1e3,
        ),
    ]
    return replayed(mapping(replay.get("before"))) + "".join(parts) + drawn


def _where(data: Data) -> str:
    where = mapping(data.get("where"))
    rows = []
    for key, value in where.items():
        label, unit, scale, digits = _key(key)
        if isinstance(value, bool) or value is None or isinstance(value, Mapping):
            continue
        if isinstance(value, int | float):
            rows.append([label, number(value, scale, digits), unit])
        else:
            said = ", ".join(map(str, value)) if isinstance(value, Sequence) and not isinstance(value, str) else value
            rows.append([label, text(said), unit])
    return table(None, rows) if rows else ""


def _key(key: str) -> tuple[str, str, float, int]:
    """Return label, unit, scale and digits of a key such as "most_slip_m" or "share_of_slip"."""
    if key in PLACES:
        return PLACES[key], key.rsplit("_", 1)[1], 1.0, 1 if key.endswith("_s") else 2
    for end, unit, scale in (("_mm", "mm", 1.0), ("_mrad", "mrad", 1.0), ("_m", "mm", 1e3), ("_rad", "mrad", 1e3)):
        if key.endswith(end):
            return key[: -len(end)].replace("_", " "), unit, scale, 2
    if key.endswith("_s"):
        return key[:-2].replace("_", " "), "s", 1.0, 1
    if key.startswith("share"):
        return key.replace("_", " "), "%", 100.0, 0
    return key.replace("_", " "), "", 1.0, 3


def _findings(data: Data) -> str:
    return "".join(_finding(finding) for finding in mappings(data.get("findings")))


def _finding(finding: Data) -> str:
    effect, unit = mapping(finding.get("effect")), str(finding.get("unit") or "1")
    name, scale = READ_AS.get(unit, (unit, 1.0))
    value, error, interval = effect.get("value"), finding.get("standard_error"), finding.get("interval") or (None, None)
    digits = digits_by(error, scale)
    low, high = (number(end, scale, digits, signed=True) for end in interval)
    cost = mapping(finding.get("cost"))
    rows = [
        ["value", number(value, scale, digits, signed=True), text(name)],
        ["95 % interval", f"{low} to {high}" if interval[0] is not None else "\N{EN DASH}", text(name)],
        ["standard error", number(error, scale, digits), text(name)],
        ["2 ln(likelihood ratio)", number(finding.get("deviance"), 1, 0), ""],
    ]
    if cost.get("m_per_10_m") is not None:
        rows.append(["what it costs in use", number(cost["m_per_10_m"], 1e3, 1), "mm per 10 m"])
    if cost.get("rad_per_10_m") is not None:
        rows.append(["", number(cost["rad_per_10_m"], 1e3, 1), "mrad per 10 m"])
    alternatives = mappings(finding.get("rivals"))
    beaten = [
        [text(alternative.get("what")), number(alternative.get("deviance"), 1, 0), ""] for alternative in alternatives
    ]
    check = f'<p class="check"><b>To check.</b> {text(finding["check"])}</p>' if finding.get("check") else ""
    return (
        f"<article><h3>{text(_title(finding))}</h3>{table(None, rows)}{check}"
        + (table(["other candidates", "2 ln(likelihood ratio)"], beaten) if beaten else "")
        + "</article>"
    )


def _title(finding: Data) -> str:
    """Return an effect as people call it, with where it is: "wheel radius, castor 2, wheel 1"."""
    effect = mapping(finding.get("effect"))
    title = str(finding.get("title") or effect.get("name") or "an effect").replace("_", " ")
    places = [f"{key} {effect[key]}" for key in ("castor", "other", "wheel") if effect.get(key) is not None]
    return ", ".join([title, *(place for place in places if place not in title)])


def _amount(finding: Data) -> str:
    """Return an effect's size with its 95 % half width: "(+0.498 ± 0.021 %)"."""
    value, error = mapping(finding.get("effect")).get("value"), finding.get("standard_error")
    if value is None:
        return ""
    unit = str(finding.get("unit") or "1")
    name, scale = READ_AS.get(unit, (unit, 1.0))
    digits = digits_by(error, scale)
    within = f" \N{PLUS-MINUS SIGN} {number(1.96 * error, scale, digits)}" if error is not None else ""
    return f"({number(value, scale, digits, signed=True)}{within} {name})"


def _alternatives(data: Data) -> str:
    parts = []
    together = [str(explanation) for explanation in data.get("cannot_be_told_apart") or ()]
    if len(together) > 1:
        items = "".join(f"<li>{text(explanation.replace('_', ' '))}</li>" for explanation in together)
        parts.append(f"<p>These motions cannot distinguish:</p><ul>{items}</ul>")
    if data.get("separating_motion"):
        parts.append(f"<p>A motion that would: <b>{text(data['separating_motion'])}</b>.</p>")
    if data.get("verdict") == "named" and len(together) <= 1:
        parts.append("<p>No other candidate explains these logs as well.</p>")
    return "".join(parts)


def _robot_file(data: Data) -> str:
    effects = [mapping(finding.get("effect")) for finding in mappings(data.get("findings"))]
    path = data.get("robot_file")
    written = f"<p>With what was found: <code>{text(path)}</code></p>" if path else ""
    if not effects:
        return written
    return f'{written}<p>What it adds to <code>"effects"</code>:</p><pre>{json_of(effects)}</pre>'
