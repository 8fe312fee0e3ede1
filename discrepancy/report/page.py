"""The report as one self-contained HTML page: a pure function of the diagnosis' data and of pictures.

`html_of` takes the data that `castor-diagnose` writes as JSON. Entries that are missing there are left out here; all
text from users' files is escaped.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from discrepancy.report.pictures import Picture

Data = Mapping[str, Any]

PAGE = Path(__file__).with_name("report.html")

READ_AS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "s": ("ms", 1e3), "1": ("%", 1e2)}
"""Units of the data, and what people read instead, so many to one."""

PLACES = {"at_s": "when", "from_s": "from", "to_s": "to", "x_m": "where, x", "y_m": "where, y"}
"""Keys of where it is whose numbers are read as they stand."""

SAYS = {
    "named": "Something is missing in the robot's file, and it has a name.",
    "ambiguous": "Something is missing in the robot's file; these motions cannot distinguish several effects.",
    "unconfirmed": "Something seems to be missing in the robot's file, but the held-out logs do not confirm it.",
    "unexplained": "Robot and file disagree, and no effect of the catalogue explains it.",
    "no discrepancy": "The robot's file explains these logs: nothing is missing.",
}

MOTION = (
    ("position_rms_mm", "position", "mm"),
    ("heading_rms_mrad", "heading", "mrad"),
    ("wheels_rms_mm", "wheel counts", "mm"),
    ("pivots_rms_mrad", "pivot counts", "mrad"),
)
"""Of a replay's summary: key, what people read, unit."""

SLIP = (
    ("odometry_rms_m", "position", "mm"),
    ("odometry_rms_rad", "heading", "mrad"),
    ("slip_along_m", "slip along, 1 m", "mm"),
    ("slip_across_m", "slip across, 1 m", "mm"),
)
"""The same of a gap, in m and rad."""


def html_of(data: Data, pictures: Sequence[Picture] = ()) -> str:
    """Return the report: the same bytes for the same data and pictures.

    data: as written by castor-diagnose (castor-diagnosis/1). pictures: by their names each goes to its section, others
    to the end.
    """
    shown = {picture.name: picture for picture in pictures}
    sections = [
        _section("Pre-flight", _preflight(data)),
        _section("Reference", _reference(data)),
        _section("The gap", _gap(data, _figures(shown, "replay", "errors", "paths"))),
        _section("Where it is", _where(data) + _figures(shown, "slip", "floor")),
        _section("What is missing" if data.get("findings") else "Candidates", _findings(data)),
        _section("What else it might be", _alternatives(data) + _figures(shown, "candidates")),
        _section("Robot file", _robot_file(data)),
        _section("More pictures", "".join(_figure(picture) for picture in shown.values())),
        _section("Numbers in full", _full(data)),
    ]
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        title=_text(f"{_name(data)}: {data.get('verdict') or 'diagnosis'}"),
        robot=_text(_name(data)),
        verdict=_text(data.get("verdict") or "diagnosis"),
        sentence=_text(_sentence(data)),
        logs=_logs(data),
        sections="".join(sections),
    )


def _name(data: Data) -> str:
    robot = data.get("robot")
    return str(_map(robot).get("name") or "robot") if isinstance(robot, Mapping) else str(robot or "robot")


def _sentence(data: Data) -> str:
    """Return the verdict in one sentence."""
    verdict, findings = str(data.get("verdict") or ""), _maps(data.get("findings"))
    named = "; ".join(f"{_title(finding)} {_amount(finding)}".strip() for finding in findings)
    if verdict == "named" and named:
        return f"The robot's file lacks {'an effect' if len(findings) == 1 else f'{len(findings)} effects'}: {named}."
    says = SAYS.get(verdict, "")
    if named:
        return f"{says} Found: {named}."
    told = verdict == "ambiguous" and len(data.get("cannot_be_told_apart") or ()) > 1
    reason = "" if told else str(data.get("reason") or "")
    return " ".join(part for part in (says, f"{reason[:1].upper()}{reason[1:].rstrip('.')}." if reason else "") if part)


def _logs(data: Data) -> str:
    groups = (("", data.get("logs")), ("held out: ", data.get("held_out_logs")), ("clean: ", data.get("clean_logs")))
    names = [f"{kind}{_text(Path(str(path)).name)}" for kind, paths in groups for path in paths or ()]
    return f'<p class="logs">{", ".join(names)}</p>' if names else ""


def _preflight(data: Data) -> str:
    if data.get("preflight") is None:
        return ""
    lines = [f"<li>{_text(line)}</li>" for line in data["preflight"]]
    if not lines:
        return "<p>No gross mistake: channels, directions, counts a turn, units and the order of castors agree.</p>"
    return f'<ul class="loud">{"".join(lines)}</ul>'


def _reference(data: Data) -> str:
    reference = _map(data.get("reference"))
    if not reference:
        if "reference" not in data:
            return ""
        return "<p>There are no reference poses. Scale and the robot's common dimensions cannot be seen.</p>"
    clocks, clean = _maps(reference.get("clocks")), _map(reference.get("clean"))
    several = [f", {_file(data, k)}" if len(clocks) > 1 else "" for k in range(len(clocks))]
    rows = _alignment("", _map(reference.get("mount")), zip(several, clocks, strict=True))
    numbered = ((f", clean log {k + 1}", clock) for k, clock in enumerate(_maps(clean.get("clocks"))))
    rows += _alignment(", in the clean logs", _map(clean.get("mount")), numbered)
    body = [[label, _number(value, scale, digits, signed=True), unit] for label, value, scale, unit, digits in rows]
    return "<p>Fitted beside everything else, and no effect of the robot:</p>" + _table(None, body)


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


def _gap(data: Data, figures: str) -> str:
    replay = _map(data.get("replay"))
    parity = [_map(_map(data.get(of)).get(key)) for of in ("gap", "gap_held_out") for key in ("before", "after")]
    parts = [
        _before_after(
            "Simulation less measurement, at the end of a window (rms)",
            [_map(replay.get(key)) for key in ("before", "after", "held_out_before", "held_out_after")],
            MOTION,
            1.0,
        ),
        _before_after(
            "Counts less reference: dead reckoning (rms), and the slip that would explain the rest",
            parity,
            SLIP,
            1e3,
        ),
    ]
    return _replayed(_map(replay.get("before"))) + "".join(parts) + figures


def _replayed(summary: Data) -> str:
    if not summary:
        return ""
    how = {"commands": "the logged commands", "counts": "the counted turns of the wheels"}
    said = (
        f"The full simulation was driven by {how.get(str(summary.get('drive')), 'the log')} in "
        f"{_number(summary.get('windows'))} windows of {_number(summary.get('window_s'), 1, 1)} s, each from where the "
        f"robot was measured to be, {_number(summary.get('driven_m'), 1, 1)} m in all."
    )
    notes = [f"{note[:1].upper()}{note[1:]}." for note in map(str, summary.get("notes") or ())]
    noise = _map(summary.get("expected"))
    if noise.get("position_rms_mm") is not None:
        notes.append(
            f"The reference's own noise alone leaves {_number(noise['position_rms_mm'], 1, 2)} mm and "
            f"{_number(noise.get('heading_rms_mrad'), 1, 2)} mrad."
        )
    return f"<p>{said} {_text(' '.join(notes))}</p>"


def _before_after(caption: str, four: Sequence[Data], rows: Iterable[tuple[str, str, str]], scale: float) -> str:
    """Return a table of gaps before and after, on the logs and on held-out ones, and what part is left."""
    held_out = any(four[2:])
    body = []
    for key, label, unit in rows:
        values = [gap.get(key) for gap in four]
        if all(value is None for value in values):
            continue
        pairs = [values[:2], values[2:]] if held_out else [values[:2]]
        cells = [cell for pair in pairs for cell in (*(_number(value, scale, 2) for value in pair), _left(*pair))]
        body.append([f'{label} <span class="unit">{unit}</span>', *cells, ""])
    if not body:
        return ""
    columns = ["before", "after", "left"] * (2 if held_out else 1)
    groups = [("", 1), ("these logs", 3), ("held-out logs", 3)] if held_out else None
    return _table(["", *columns], body, caption, groups)


def _left(before: Any, after: Any) -> str:
    """Return what part of a gap is left."""
    if before is None or after is None or not before:
        return "\N{EN DASH}"
    return f"{100 * after / before:.0f} %"


def _where(data: Data) -> str:
    where = _map(data.get("where"))
    rows = []
    for key, value in where.items():
        label, unit, scale, digits = _key(key)
        if isinstance(value, bool) or value is None or isinstance(value, Mapping):
            continue
        if isinstance(value, int | float):
            rows.append([label, _number(value, scale, digits), unit])
        else:
            said = ", ".join(map(str, value)) if isinstance(value, Sequence) and not isinstance(value, str) else value
            rows.append([label, _text(said), unit])
    return _table(None, rows) if rows else ""


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
    return "".join(_finding(finding) for finding in _maps(data.get("findings")))


def _finding(finding: Data) -> str:
    effect, unit = _map(finding.get("effect")), str(finding.get("unit") or "1")
    name, scale = READ_AS.get(unit, (unit, 1.0))
    value, error, interval = effect.get("value"), finding.get("standard_error"), finding.get("interval") or (None, None)
    digits = _digits(error, scale)
    low, high = (_number(end, scale, digits, signed=True) for end in interval)
    cost = _map(finding.get("cost"))
    rows = [
        ["value", _number(value, scale, digits, signed=True), _text(name)],
        ["95 % interval", f"{low} to {high}" if interval[0] is not None else "\N{EN DASH}", _text(name)],
        ["standard error", _number(error, scale, digits), _text(name)],
        ["2 ln(likelihood ratio)", _number(finding.get("deviance"), 1, 0), ""],
    ]
    if cost.get("m_per_10_m") is not None:
        rows.append(["what it costs in use", _number(cost["m_per_10_m"], 1e3, 1), "mm per 10 m"])
    if cost.get("rad_per_10_m") is not None:
        rows.append(["", _number(cost["rad_per_10_m"], 1e3, 1), "mrad per 10 m"])
    alternatives = _maps(finding.get("rivals"))
    beaten = [
        [_text(alternative.get("what")), _number(alternative.get("deviance"), 1, 0), ""] for alternative in alternatives
    ]
    check = f'<p class="check"><b>To check.</b> {_text(finding["check"])}</p>' if finding.get("check") else ""
    return (
        f"<article><h3>{_text(_title(finding))}</h3>{_table(None, rows)}{check}"
        + (_table(["other candidates", "2 ln(likelihood ratio)"], beaten) if beaten else "")
        + "</article>"
    )


def _title(finding: Data) -> str:
    """Return an effect as people call it, with where it is: "wheel radius, castor 2, wheel 1"."""
    effect = _map(finding.get("effect"))
    title = str(finding.get("title") or effect.get("name") or "an effect").replace("_", " ")
    places = [f"{key} {effect[key]}" for key in ("castor", "other", "wheel") if effect.get(key) is not None]
    return ", ".join([title, *(place for place in places if place not in title)])


def _amount(finding: Data) -> str:
    """Return an effect's size with its 95 % half width: "(+0.498 ± 0.021 %)"."""
    value, error = _map(finding.get("effect")).get("value"), finding.get("standard_error")
    if value is None:
        return ""
    unit = str(finding.get("unit") or "1")
    name, scale = READ_AS.get(unit, (unit, 1.0))
    digits = _digits(error, scale)
    within = f" \N{PLUS-MINUS SIGN} {_number(1.96 * error, scale, digits)}" if error is not None else ""
    return f"({_number(value, scale, digits, signed=True)}{within} {name})"


def _alternatives(data: Data) -> str:
    parts = []
    together = [str(explanation) for explanation in data.get("cannot_be_told_apart") or ()]
    if len(together) > 1:
        items = "".join(f"<li>{_text(explanation.replace('_', ' '))}</li>" for explanation in together)
        parts.append(f"<p>These motions cannot distinguish:</p><ul>{items}</ul>")
    if data.get("separating_motion"):
        parts.append(f"<p>A motion that would: <b>{_text(data['separating_motion'])}</b>.</p>")
    if data.get("verdict") == "named" and len(together) <= 1:
        parts.append("<p>No other candidate explains these logs as well.</p>")
    return "".join(parts)


def _robot_file(data: Data) -> str:
    effects = [_map(finding.get("effect")) for finding in _maps(data.get("findings"))]
    path = data.get("robot_file")
    written = f"<p>With what was found: <code>{_text(path)}</code></p>" if path else ""
    if not effects:
        return written
    return f'{written}<p>What it adds to <code>"effects"</code>:</p><pre>{_json(effects)}</pre>'


def _full(data: Data) -> str:
    return f"<details><summary>All that this page was made from</summary><pre>{_json(data)}</pre></details>"


def _json(data: Any) -> str:
    return _text(json.dumps(data, indent=2, ensure_ascii=False))


def _figures(shown: dict[str, Picture], *names: str) -> str:
    """Return pictures by their names, and take them from those that are yet to be shown."""
    return "".join(_figure(shown.pop(name)) for name in names if name in shown)


def _figure(picture: Picture) -> str:
    svg = picture.svg.replace("<svg", f'<svg role="img" aria-label="{_text(picture.alt)}"', 1)
    return f"<figure>{svg}<figcaption>{_text(picture.caption)}</figcaption></figure>"


def _section(title: str, body: str) -> str:
    return f"<section><h2>{title}</h2>{body}</section>" if body else ""


def _table(
    head: Sequence[str] | None,
    rows: Sequence[Sequence[str]],
    caption: str = "",
    groups: Sequence[tuple[str, int]] | None = None,
) -> str:
    """Return a table of cells that are HTML already: labels, numbers, and last their unit, shown if there is any."""
    parts = [f"<caption>{caption}</caption>"] if caption else []
    if groups or head:
        parts.append("<thead>")
        if groups:
            over = "".join(f'<th colspan="{n}">{title}</th>' for title, n in groups)
            parts.append(f'<tr class="groups">{over}</tr>')
        if head:
            parts.append(f"<tr>{''.join(f'<th>{_text(cell)}</th>' for cell in head)}</tr>")
        parts.append("</thead>")
    units = any(row[-1] for row in rows)
    for label, *numbers, unit in rows:
        cells = "".join(f"<td>{number}</td>" for number in numbers)
        last = f'<td class="unit">{unit}</td>' if units else ""
        parts.append(f"<tr><th>{label}</th>{cells}{last}</tr>")
    return f'<div class="wide"><table>{"".join(parts)}</table></div>'


def _digits(error: Any, scale: float) -> int:
    """Return after how many decimals a number with this standard error ends: its second figure."""
    if not isinstance(error, int | float) or not error > 0:
        return 3
    return min(max(1 - math.floor(math.log10(error * scale)), 0), 9)


def _number(value: Any, scale: float = 1.0, digits: int = 0, signed: bool = False) -> str:
    """Return a number to so many decimals; a dash for none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "\N{EN DASH}"
    shown = f"{value * scale:{'+' if signed else ''}.{digits}f}"
    return shown.replace("-", "\N{MINUS SIGN}")


def _text(value: Any) -> str:
    return escape("" if value is None else str(value))


def _map(value: Any) -> Data:
    return value if isinstance(value, Mapping) else {}


def _maps(value: Any) -> list[Data]:
    return [_map(item) for item in value] if isinstance(value, list | tuple) else []
