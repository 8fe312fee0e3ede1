"""What pages of reports are made of: numbers in units that people read, tables, figures, and the frame of a page.

Text is escaped here, unless it is marked as HTML.
"""

import json
import math
import re
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

MOTION = (
    ("position_rms_mm", "position", "mm"),
    ("heading_rms_mrad", "heading", "mrad"),
    ("wheels_rms_mm", "wheel counts", "mm"),
    ("pivots_rms_mrad", "pivot counts", "mrad"),
)
"""Of a replay's summary: key, what people read, unit."""


def page_of(data: Data, sentence: str, head: str, sections: Iterable[str]) -> str:
    """Return a page about a diagnosis. head, sections: HTML."""
    robot = str(data.get("robot") or "robot")
    return Template(PAGE.read_text(encoding="utf-8")).substitute(
        title=text(f"{robot}: {data.get('verdict') or 'diagnosis'}"),
        robot=text(robot),
        verdict=text(data.get("verdict") or "diagnosis"),
        sentence=text(sentence),
        head=head,
        sections="".join(sections),
    )


def names_apart(paths: Iterable[Any]) -> dict[str, str]:
    """Return what to call files: by their names, and as many of the folders above as distinguish them."""
    parts_of = {str(path): Path(str(path)).parts for path in paths}

    def called(parts: tuple[str, ...]) -> str:
        for n in range(1, len(parts)):
            if sum(rival[-n:] == parts[-n:] for rival in parts_of.values()) == 1:
                return str(Path(*parts[-n:]))
        return str(Path(*parts))

    return {path: called(parts) for path, parts in parts_of.items()}


def logs_line(data: Data) -> str:
    """Return the line of all logs' names."""
    kinds = (("", "logs"), ("held out: ", "held_out_logs"), ("clean: ", "clean_logs"))
    groups = [(kind, list(data.get(key) or ())) for kind, key in kinds]
    called = names_apart(path for _, paths in groups for path in paths)
    names = [
        f"{kind}{f'log {k}: ' if not kind and len(paths) > 1 else ''}{text(called[str(path)])}"
        for kind, paths in groups
        for k, path in enumerate(paths, 1)
    ]
    return f'<p class="logs">{", ".join(names)}</p>' if names else ""


def replayed(summary: Data) -> str:
    """Return how the full simulation was driven, of a replay's summary."""
    if not summary:
        return ""
    how = {"commands": "the logged commands", "counts": "the counted turns of the wheels"}
    sentence = (
        f"The full simulation was driven by {how.get(str(summary.get('drive')), 'the log')} in "
        f"{number(summary.get('windows'))} windows of {number(summary.get('window_s'), 1, 1)} s, each from where the "
        f"robot was measured to be, {number(summary.get('driven_m'), 1, 1)} m in all."
    )
    notes = [f"{note[:1].upper()}{note[1:]}." for note in map(str, summary.get("notes") or ())]
    noise = mapping(summary.get("expected"))
    if noise.get("position_rms_mm") is not None:
        notes.append(
            f"The reference's own noise alone leaves {number(noise['position_rms_mm'], 1, 2)} mm and "
            f"{number(noise.get('heading_rms_mrad'), 1, 2)} mrad."
        )
    return f"<p>{sentence} {text(' '.join(notes))}</p>"


def before_after(caption: str, four: Sequence[Data], rows: Iterable[tuple[str, str, str]], scale: float) -> str:
    """Return a table of gaps before and, if any, after, on the logs and on held-out ones, and what part is left."""
    held_out, found = any(four[2:]), any(four[1::2])
    body = []
    for key, label, unit in rows:
        values = [gap.get(key) for gap in four]
        if all(value is None for value in values):
            continue
        pairs = [values[:2], values[2:]] if held_out else [values[:2]]
        cells = []
        for before, after in pairs:
            after_cell = f'<b class="after">{number(after, scale, 2)}</b>'
            cells += [number(before, scale, 2), *([after_cell, left(before, after)] if found else [])]
        body.append([f'{label} <span class="unit">{unit}</span>', *cells])
    if not body:
        return ""
    columns = ["before", "after", "left"] if found else ["as described"]
    groups = [("", 1), ("these logs", len(columns)), ("held-out logs", len(columns))] if held_out else None
    return _table(caption, groups, ["", *columns * (2 if held_out else 1)], body)


def left(before: Any, after: Any) -> str:
    """Return what part of a gap is left."""
    if before is None or after is None or not before:
        return "\N{EN DASH}"
    return f"{100 * after / before:.0f} %"


def full(data: Data) -> str:
    """Return all data, folded."""
    return f"<details><summary>All that this page was made from</summary><pre>{json_of(data)}</pre></details>"


def json_of(data: Any) -> str:
    """Return data as JSON to stand in a page; lists of numbers in one line each."""
    spread = json.dumps(data, indent=2, ensure_ascii=False)
    return text(re.sub(r"\[[-+\d.eE,\s]+\]", lambda numbers: " ".join(numbers[0].split()), spread))


def figures(shown: dict[str, Picture], *names: str) -> str:
    """Return pictures by their names, and take them from those that are yet to be shown."""
    return "".join(figure(shown.pop(name)) for name in names if name in shown)


def figure(picture: Picture) -> str:
    """Return a picture with its caption."""
    svg = picture.svg.replace("<svg", f'<svg role="img" aria-label="{text(picture.alt)}"', 1)
    return f"<figure>{svg}<figcaption>{text(picture.caption)}</figcaption></figure>"


def section(title: str, body: str) -> str:
    """Return a section of a body of HTML; nothing of none."""
    return f"<section><h2>{title}</h2>{body}</section>" if body else ""


def _table(
    caption: str, groups: Sequence[tuple[str, int]] | None, head: Sequence[str], rows: Sequence[Sequence[str]]
) -> str:
    """Return a table of cells that are HTML already: labels and numbers. groups: titles over so many columns."""
    over = "".join(f'<th colspan="{n}">{title}</th>' for title, n in groups or ())
    parts = [f"<caption>{caption}</caption><thead>", f'<tr class="groups">{over}</tr>' if groups else ""]
    parts.append(f"<tr>{''.join(f'<th>{text(cell)}</th>' for cell in head)}</tr></thead>")
    for label, *numbers in rows:
        parts.append(f"<tr><th>{label}</th>{''.join(f'<td>{cell}</td>' for cell in numbers)}</tr>")
    return f'<div class="wide"><table>{"".join(parts)}</table></div>'


def digits_by(error: Any, scale: float) -> int:
    """Return after how many decimals a number with this standard error ends: its second figure."""
    if not isinstance(error, int | float) or not error > 0:
        return 3
    return min(max(1 - math.floor(math.log10(error * scale)), 0), 9)


def number(value: Any, scale: float = 1.0, digits: int = 0, signed: bool = False) -> str:
    """Return a number to so many decimals; a dash for none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "\N{EN DASH}"
    shown = f"{value * scale:{'+' if signed else ''}.{digits}f}"
    return shown.replace("-", "\N{MINUS SIGN}")


def text(value: Any) -> str:
    """Return what is safe in a page."""
    return escape("" if value is None else str(value))


def mapping(value: Any) -> Data:
    """Return data that should be a mapping; an empty one of anything else."""
    return value if isinstance(value, Mapping) else {}


def mappings(value: Any) -> list[Data]:
    """Return data that should be a list of mappings."""
    return [mapping(item) for item in value] if isinstance(value, list | tuple) else []
