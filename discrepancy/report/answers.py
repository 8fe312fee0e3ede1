"""The page about a diagnosis by posterior: a pure function of its data (castor-diagnosis/2) and of pictures.

Entries that are missing are left out, and so are sections of nothing; all text from users' files is escaped.
"""

from collections.abc import Sequence
from typing import Any

from discrepancy.report import sentences
from discrepancy.report.parts import (
    MOTION,
    Data,
    before_after,
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
    text,
)
from discrepancy.report.pictures import Picture, learned_curve, probabilities

GAP = (("m", "position", "mm"), ("rad", "heading", "mrad"))
"""Of a gap: key, what people read, unit of a thousandth."""


def html_of(data: Data, pictures: Sequence[Picture] = ()) -> str:
    """Return the report: the same bytes for the same data and pictures, which go to sections by their names."""
    shown = {picture.name: picture for picture in pictures}
    trifles = [answer for answer in mappings(data.get("answers")) if answer.get("verdict") == "negligible"]
    cards = "".join(_card(data, answer) for answer in sentences.material(data))
    sections = [
        section("Wiring and units", _preflight(data)),
        section("What is missing", cards + figures(shown, "curve", "probabilities")),
        section("Too small to matter", _trifles(trifles)),
        section("The gap", _gap(data) + figures(shown, "drift")),
        section("The same in full simulation", _replay(mapping(data.get("replay"))) + figures(shown, "replay")),
        section("Where slip is left", _where(mapping(data.get("where"))) + figures(shown, "slip", "floor")),
        section("Robot file", _robot_file(data)),
        section("Numbers in full", full(data)),
    ]
    head = _gap_in_short(data) + _checks(data) + logs_line(data)
    return page_of(data, sentences.sentence(data), head, sections)


def drawn(data: Data) -> list[Picture]:
    """Return the pictures that are drawn from the data alone: how likely names are, where there are two to compare; and
    the learned curve, if there is one."""
    learned = [answer for answer in mappings(data.get("answers")) if answer.get("curve")]
    return [*_likely(data), *(learned_curve(str(answer["what"]), answer["curve"]) for answer in learned[:1])]


def _likely(data: Data) -> list[Picture]:
    names = mapping(data.get("names"))
    shown = [(str(names[name]), part) for name, part in data["probabilities"].items() if part >= sentences.SHOWN]
    named = [str(answer["what"]) for answer in data["answers"] if answer["verdict"] == "named"]
    return [probabilities([(*entry, sentences.percent(entry[1])) for entry in shown], named)] if len(shown) > 1 else []


def _gap_in_short(data: Data) -> str:
    lines = [f"{line[:1].upper()}{line[1:]}." for line in sentences.gaps_of(data)]
    return f'<p class="check"><b>The gap.</b> {text(" ".join(lines))}</p>' if lines else ""


def _checks(data: Data) -> str:
    checks = dict.fromkeys(str(answer["check"]) for answer in sentences.material(data) if answer.get("check"))
    return f'<p class="check"><b>To check.</b> {text(" ".join(checks))}</p>' if checks else ""


def _preflight(data: Data) -> str:
    lines = "".join(f"<li>{text(line)}</li>" for line in data.get("preflight") or ())
    undone = "<p>They are undone in all that follows, and in the robot file where they are certain.</p>"
    undone *= bool(data.get("mistakes"))
    return f'<ul class="loud">{lines}</ul>{undone}' if lines else ""


def _card(data: Data, answer: Data) -> str:
    rivals = sentences.others_of(data, answer)
    reason = sentences.reason_of(data, answer) if answer.get("verdict") != "named" else ""
    rows = {
        "probability": sentences.percent(answer.get("probability")),
        "the same here": sentences.same_of(data, answer),
        "or else": sentences.listed(rivals),
        "reads too much by" if answer.get("curve") else "size (95 %)": sentences.size_of(answer),
        "costs": sentences.cost_of(answer),
        "not named, because": reason.partition("; nearest")[0],
        "nearest in the catalogue": sentences.nearest_of(answer),
        "a drive that would distinguish them": sentences.drive_of(answer),
        "to check": answer.get("check"),
    }
    entries = "".join(f"<dt>{label}</dt><dd>{text(said)}</dd>" for label, said in rows.items() if said)
    verdict = f'<span class="verdict">{text(answer.get("verdict"))}</span>'
    return f"<article><h3>{text(answer.get('what'))} {verdict}</h3><dl>{entries}</dl></article>"


def _trifles(trifles: Sequence[Data]) -> str:
    def line(answer: Data) -> str:
        parts = (sentences.size_of(answer), sentences.cost_of(answer))
        return ", ".join([str(answer.get("what")), *(part for part in parts if part)])

    items = "".join(f"<li>{text(line(answer))}</li>" for answer in trifles)
    return f"<ul>{items}</ul>" if items else ""


def _gap(data: Data) -> str:
    pairs = [data.get(of) or (None, None) for of in ("gap", "held_out_gap")]
    four: list[Data] = [{} if gap is None else {"m": gap[0], "rad": gap[1]} for pair in pairs for gap in pair]
    table = before_after("Odometry with predicted creep less reference (rms)", four, GAP, 1e3)
    if not table:
        return "" if "gap" not in data else "<p>There are no reference poses: odometry's gap is not measured.</p>"
    noise = mapping(data.get("noise"))
    alone = (
        f"<p>The reference itself is uncertain by {number(noise.get('position_m'), 1e3, 2)} mm and "
        f"{number(noise.get('heading_rad'), 1e3, 2)} mrad.</p>"
    )
    return table + (alone if noise else "")


def _replay(replay: Data) -> str:
    four = [mapping(replay.get(key)) for key in ("before", "after", "held_out_before", "held_out_after")]
    caption = "Simulation less measurement, at the end of a window (rms)"
    return replayed(four[0]) + before_after(caption, four, MOTION, 1.0)


def _where(place: Data) -> str:
    if not place:
        return ""
    return (
        f"<p>Most of it is in {text(place.get('channel'))} ({number(place.get('share_of_slip'), 100)} %); the largest, "
        f"{number(place.get('most_slip_m'), 1e3, 2)} mm in a second, at {number(place.get('at_s'), 1, 1)} s near x "
        f"{number(place.get('x_m'), 1, 2)}, y {number(place.get('y_m'), 1, 2)} m.</p>"
    )


def _robot_file(data: Data) -> str:
    path, effects = data.get("robot_file"), data.get("effects")
    written = f"<p>With what is named: <code>{text(path)}</code></p>" if path else ""
    added: Any = f'<p>What it adds to <code>"effects"</code>:</p><pre>{json_of(effects)}</pre>' if effects else ""
    return written + added
