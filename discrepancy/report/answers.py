"""The page about a diagnosis by posterior: a pure function of its data (castor-diagnosis/2) and of pictures.

Entries that are missing are left out, and so are sections of nothing; all text from users' files is escaped.
"""

import base64
import json
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from discrepancy.report import sentences
from discrepancy.report.parts import Data, mapping, mappings, names_apart, number
from discrepancy.report.pictures import Picture, learned_curve, probabilities

PAGE = Path(__file__).with_name("report.html")

GAP = (("m", "position", "mm"), ("rad", "heading", "mrad"))
MOTION = (
    ("position_rms_mm", "position", "mm"),
    ("heading_rms_mrad", "heading", "mrad"),
    ("wheels_rms_mm", "wheel counts", "mm"),
    ("pivots_rms_mrad", "pivot counts", "mrad"),
)
"""Of a gap and of a replay's summary: key, what people read, unit."""


def html_of(data: Data, pictures: Sequence[Picture] = ()) -> str:
    """Return the report: the same bytes for the same data and pictures, which go to sections by their names."""
    shown = {picture.name: _figure(picture) for picture in pictures}

    def figures(*names: str) -> str:
        return "".join(shown.get(name, "") for name in names)

    sections = {
        "Wiring and units": _preflight(data),
        "What is missing": "".join(_card(data, answer) for answer in sentences.material(data))
        + figures("curve", "probabilities"),
        "Too small to matter": _trifles(data),
        "The gap": _gap(data) + figures("drift"),
        "The same in full simulation": _replay(mapping(data.get("replay"))) + figures("replay"),
        "Where slip is left": _where(mapping(data.get("where"))) + figures("slip", "floor"),
        "Robot file": _robot_file(data),
        "Numbers in full": "<details><summary>All that this page was made from</summary>"
        f"<pre>{_json_of(data)}</pre></details>",
    }
    gaps = " ".join(f"{line[:1].upper()}{line[1:]}." for line in sentences.gaps_of(data))
    checks = dict.fromkeys(str(answer["check"]) for answer in sentences.material(data) if answer.get("check"))
    robot, verdict = str(data.get("robot") or "robot"), data.get("verdict") or "diagnosis"
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        title=_text(f"{robot}: {verdict}"),
        robot=_text(robot),
        verdict=_text(verdict),
        sentence=_text(sentences.sentence(data)),
        head=_paragraph("The gap.", gaps) + _paragraph("To check.", " ".join(checks)) + _logs(data),
        sections="".join(f"<section><h2>{title}</h2>{body}</section>" for title, body in sections.items() if body),
    )


def drawn(data: Data) -> list[Picture]:
    """Return the pictures that are drawn from the data alone: how likely names are, where there are two to compare; and
    the learned curve, if there is one."""
    names, answers = mapping(data.get("names")), mappings(data["answers"])
    likely = [(str(names[name]), part) for name, part in data["probabilities"].items() if part >= sentences.SHOWN]
    named = [str(answer["what"]) for answer in answers if answer["verdict"] == "named"]
    told = [(name, part, sentences.percent(part)) for name, part in likely]
    learned = [learned_curve(str(answer["what"]), answer["curve"]) for answer in answers if answer.get("curve")]
    return [*([probabilities(told, named)] if len(told) > 1 else []), *learned[:1]]


def _paragraph(title: str, said: str) -> str:
    return f'<p class="check"><b>{title}</b> {_text(said)}</p>' if said else ""


def _logs(data: Data) -> str:
    """Return the line of all logs' names."""
    kinds = (("", "logs"), ("held out: ", "held_out_logs"), ("clean: ", "clean_logs"))
    groups = [(kind, list(data.get(key) or ())) for kind, key in kinds]
    called = names_apart(path for _, paths in groups for path in paths)
    names = [
        f"{kind}{f'log {k}: ' if not kind and len(paths) > 1 else ''}{_text(called[str(path)])}"
        for kind, paths in groups
        for k, path in enumerate(paths, 1)
    ]
    return f'<p class="logs">{", ".join(names)}</p>' if names else ""


def _preflight(data: Data) -> str:
    lines = "".join(f"<li>{_text(line)}</li>" for line in data.get("preflight") or ())
    undone = "<p>They are undone in all that follows, and in the robot file where they are certain.</p>"
    return f'<ul class="loud">{lines}</ul>{undone if data.get("mistakes") else ""}' if lines else ""


def _card(data: Data, answer: Data) -> str:
    reason = sentences.reason_of(data, answer) if answer.get("verdict") != "named" else ""
    rows = {
        "probability": sentences.percent(answer.get("probability")),
        "the same here": sentences.same_of(data, answer),
        "or else": sentences.listed(sentences.others_of(data, answer)),
        "reads too much by" if answer.get("curve") else "size (95 %)": sentences.size_of(answer),
        "costs": sentences.cost_of(answer),
        "not named, because": reason.partition("; nearest")[0],
        "nearest in the catalogue": sentences.nearest_of(answer),
        "a drive that would distinguish them": sentences.drive_of(answer),
        "to check": answer.get("check"),
    }
    entries = "".join(f"<dt>{label}</dt><dd>{_text(said)}</dd>" for label, said in rows.items() if said)
    verdict = f'<span class="verdict">{_text(answer.get("verdict"))}</span>'
    return f"<article><h3>{_text(answer.get('what'))} {verdict}</h3><dl>{entries}</dl></article>"


def _trifles(data: Data) -> str:
    trifles = [answer for answer in mappings(data.get("answers")) if answer.get("verdict") == "negligible"]
    told = [(str(answer.get("what")), sentences.size_of(answer), sentences.cost_of(answer)) for answer in trifles]
    items = "".join(f"<li>{_text(', '.join(part for part in parts if part))}</li>" for parts in told)
    return f"<ul>{items}</ul>" if items else ""


def _gap(data: Data) -> str:
    pairs = [data.get(of) or (None, None) for of in ("gap", "held_out_gap")]
    four: list[Data] = [{} if gap is None else {"m": gap[0], "rad": gap[1]} for pair in pairs for gap in pair]
    table = _before_after("Odometry with predicted creep less reference (rms)", four, GAP, 1e3)
    if not table:
        return "" if "gap" not in data else "<p>There are no reference poses: odometry's gap is not measured.</p>"
    if not (noise := mapping(data.get("noise"))):
        return table
    position, heading = (number(noise.get(key), 1e3, 2) for key in ("position_m", "heading_rad"))
    return f"{table}<p>The reference itself is uncertain by {position} mm and {heading} mrad.</p>"


def _replay(replay: Data) -> str:
    four = [mapping(replay.get(key)) for key in ("before", "after", "held_out_before", "held_out_after")]
    summary = four[0]
    if not summary:
        return ""
    how = {"commands": "the logged commands", "counts": "the counted turns of the wheels"}
    notes = [f"{note[:1].upper()}{note[1:]}." for note in map(str, summary.get("notes") or ())]
    noise = mapping(summary.get("expected"))
    if noise.get("position_rms_mm") is not None:
        position, heading = (number(noise.get(key), 1, 2) for key in ("position_rms_mm", "heading_rms_mrad"))
        notes.append(f"The reference's own noise alone leaves {position} mm and {heading} mrad.")
    return (
        f"<p>The full simulation was driven by {how.get(str(summary.get('drive')), 'the log')} in "
        f"{number(summary.get('windows'))} windows of {number(summary.get('window_s'), 1, 1)} s, each from where the "
        f"robot was measured to be, {number(summary.get('driven_m'), 1, 1)} m in all. {_text(' '.join(notes))}</p>"
    ) + _before_after("Simulation less measurement, at the end of a window (rms)", four, MOTION, 1.0)


def _where(place: Data) -> str:
    if not place:
        return ""
    share, most = number(place.get("share_of_slip"), 100), number(place.get("most_slip_m"), 1e3, 2)
    t, x, y = (number(place.get(key), 1, digits) for key, digits in (("at_s", 1), ("x_m", 2), ("y_m", 2)))
    return (
        f"<p>Most of it is in {_text(place.get('channel'))} ({share} %); the largest, {most} mm in a second, at {t} s "
        f"near x {x}, y {y} m.</p>"
    )


def _robot_file(data: Data) -> str:
    path, effects = data.get("robot_file"), data.get("effects")
    written = f"<p>With what is named: <code>{_text(path)}</code></p>" if path else ""
    added = f'<p>What it adds to <code>"effects"</code>:</p><pre>{_json_of(effects)}</pre>' if effects else ""
    return written + added


def _before_after(caption: str, four: Sequence[Data], rows: Sequence[tuple[str, str, str]], scale: float) -> str:
    """Return a table of gaps before and, if any, after, on the logs and on held-out ones, and what part is left."""
    groups = {"these logs": four[:2]} | ({"held-out logs": four[2:]} if any(four[2:]) else {})
    columns = ["before", "after", "left"] if any(four[1::2]) else ["as described"]
    body = ""
    for key, label, unit in rows:
        pairs = [[gap.get(key) for gap in pair] for pair in groups.values()]
        if any(value is not None for pair in pairs for value in pair):
            cells = [
                (number(before, scale, 2), f'<b class="after">{number(after, scale, 2)}</b>', _left(before, after))
                for before, after in pairs
            ]
            numbers = "".join(f"<td>{cell}</td>" for group in cells for cell in group[: len(columns)])
            body += f'<tr><th>{label} <span class="unit">{unit}</span></th>{numbers}</tr>'
    over = "".join(f'<th colspan="{len(columns)}">{title}</th>' for title in groups) if len(groups) > 1 else ""
    titles = f'<tr class="groups"><th></th>{over}</tr>' if over else ""
    titles += f"<tr>{''.join(f'<th>{column}</th>' for column in ['', *columns * len(groups)])}</tr>"
    table = f"<table><caption>{caption}</caption><thead>{titles}</thead>{body}</table>"
    return f'<div class="wide">{table}</div>' if body else ""


def _left(before: Any, after: Any) -> str:
    """Return what part of a gap is left."""
    return "\N{EN DASH}" if after is None or not before else f"{100 * after / before:.0f} %"


def _figure(picture: Picture) -> str:
    """Return a picture, which needs no other file, with its caption."""
    svg = base64.b64encode(picture.svg.encode()).decode()
    image = f'<img src="data:image/svg+xml;base64,{svg}" alt="{_text(picture.alt)}">'
    return f"<figure>{image}<figcaption>{_text(picture.caption)}</figcaption></figure>"


def _json_of(data: Any) -> str:
    """Return data as JSON to stand in a page; lists of numbers in one line each."""
    spread = json.dumps(data, indent=2, ensure_ascii=False)
    return _text(re.sub(r"\[[-+\d.eE,\s]+\]", lambda numbers: " ".join(numbers[0].split()), spread))


def _text(value: Any) -> str:
    """Return what is safe in a page."""
    return escape("" if value is None else str(value))
