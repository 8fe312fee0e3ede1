"""The page about a diagnosis by posterior: a pure function of its data (castor-diagnosis/2) and of pictures.

The template `report.html` says where things stand, in the style of all pages; here is what stands there. Sections of
nothing are left out.
"""

import base64
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from castor_envs.rendering.pages.page import render
from discrepancy.report import sentences
from discrepancy.report.parts import MILLI, PERCENT, Data, names_apart, number
from discrepancy.report.pictures import Picture, learned_curve, probabilities

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
    gaps = " ".join(f"{line[:1].upper()}{line[1:]}." for line in sentences.gaps_of(data))
    checks = dict.fromkeys(answer["check"] for answer in sentences.material(data) if answer["check"])
    preflight, mistakes, replay = data["preflight"], len(data["mistakes"]), data["replay"] or {}
    return render(
        Path(__file__).parent,
        "report.html",
        scripted=False,
        robot=data["robot"],
        verdict=data["verdict"],
        sentence=sentences.sentence(data),
        head=[("The gap.", gaps), ("To check.", " ".join(checks))],
        logs=_logs(data),
        mistakes=preflight[:mistakes],
        remarks=preflight[mistakes:],
        cards=[_card(data, answer) for answer in sentences.material(data)],
        trifles=list(_trifles(data)),
        gap=_gap(data),
        gap_notes=list(_gap_notes(data)),
        replay=_replay(replay),
        replay_notes=list(_replay_notes(replay)),
        where=_where(data["where"]),
        robot_file=data.get("robot_file"),
        effects=_json_of(data["effects"]) if data["effects"] else None,
        data=_json_of(data),
        pictures={picture.name: _shown(picture) for picture in pictures},
    )


def drawn(data: Data) -> list[Picture]:
    """Return the pictures that are drawn from the data alone: how likely names are, where there are two to compare; and
    the learned curve, if there is one."""
    names, answers = data["names"], data["answers"]
    likely = [(str(names[name]), part) for name, part in data["probabilities"].items() if part >= sentences.SHOWN]
    named = [answer["what"] for answer in answers if answer["verdict"] == "named"]
    told = [(name, part, sentences.percent(part)) for name, part in likely]
    learned = [learned_curve(answer["what"], answer["curve"]) for answer in answers if answer["curve"]]
    return [*([probabilities(told, named)] if len(told) > 1 else []), *learned[:1]]


def _logs(data: Data) -> str:
    """Return the line of all logs' names."""
    kinds = (("", "logs"), ("held out: ", "held_out_logs"), ("clean: ", "clean_logs"))
    groups = [(kind, data[key]) for kind, key in kinds]
    called = names_apart(path for _, paths in groups for path in paths)
    return ", ".join(
        f"{kind}{f'log {k}: ' if not kind and len(paths) > 1 else ''}{called[str(path)]}"
        for kind, paths in groups
        for k, path in enumerate(paths, 1)
    )


def _card(data: Data, answer: Data) -> Data:
    rows = {
        "probability": sentences.percent(answer["probability"]),
        "the same here": sentences.same_of(data, answer),
        "or else": sentences.listed(sentences.others_of(data, answer)),
        "reads too much by" if answer["curve"] else "size (95 %)": sentences.size_of(answer),
        "costs": sentences.cost_of(answer),
        "not named, because": sentences.reason_of(data, answer).partition("; nearest")[0],
        "nearest in the catalogue": sentences.nearest_of(answer),
        "a drive that would distinguish them": sentences.drive_of(answer),
        "to check": answer["check"],
    }
    return {"what": answer["what"], "verdict": answer["verdict"], "rows": list(rows.items())}


def _trifles(data: Data) -> Iterator[str]:
    for answer in data["answers"]:
        if answer["verdict"] == "negligible":
            told = answer["reason"], sentences.size_of(answer), sentences.cost_of(answer)
            yield ", ".join(part for part in told if part)


def _gap(data: Data) -> Data | None:
    pairs = [data[of] or (None, None) for of in ("gap", "held_out_gap")]
    four: list[Data] = [{} if gap is None else {"m": gap[0], "rad": gap[1]} for pair in pairs for gap in pair]
    return _before_after("Odometry with predicted creep less reference (rms)", four, GAP, MILLI)


def _gap_notes(data: Data) -> Iterator[str]:
    if not _gap(data):
        yield "There are no reference poses: odometry's gap is not measured."
    elif noise := data["noise"]:
        parts = [(noise[key], unit) for key, unit in (("position_m", "mm"), ("heading_rad", "mrad"))]
        uncertain = " and ".join(f"{number(part, MILLI, 2)} {unit}" for part, unit in parts if part is not None)
        yield f"The reference itself is uncertain by {uncertain}."
        if noise["heading_rad"] is None:
            yield (
                "It has no headings: odometry is turned and moved as a whole to come nearest to its positions, and is "
                "compared with them alone."
            )
    if _gap(data) and data["clean_gap"]:
        yield f"In the clean logs it is {sentences.off(data['clean_gap'])}."


def _replay(replay: Data) -> Data | None:
    four = [replay.get(key) or {} for key in ("before", "after", "held_out_before", "held_out_after")]
    counted = four[0].get("drive") == "counts"  # then wheels turn as counted, whatever is missing
    rows = [row for row in MOTION if not (counted and row[0] == "wheels_rms_mm")]
    return _before_after("Simulation less measurement, at the end of a window (rms)", four, rows, 1.0)


def _replay_notes(replay: Data) -> Iterator[str]:
    if not replay:
        return
    summary = replay["before"]
    how = {"commands": "the logged commands", "counts": "the counted turns of the wheels"}
    notes = [f"{note[:1].upper()}{note[1:]}." for note in summary["notes"]]
    noise = summary.get("expected")
    if noise and noise["position_rms_mm"] is not None:
        parts = [(noise[key], unit) for key, unit in (("position_rms_mm", "mm"), ("heading_rms_mrad", "mrad"))]
        left = " and ".join(f"{number(part, 1, 2)} {unit}" for part, unit in parts if part is not None)
        notes.append(f"The reference's own noise alone leaves {left}.")
    yield (
        f"The full simulation was driven by {how[summary['drive']]} in "
        f"{number(summary['windows'])} windows of {number(summary['window_s'], 1, 1)} s, each from where the "
        f"robot was measured to be, {number(summary['driven_m'], 1, 1)} m in all. {' '.join(notes)}"
    )


def _where(place: Data | None) -> str:
    if not place:
        return ""
    share, most = number(place["share_of_slip"], PERCENT), number(place["most_slip_m"], MILLI, 2)
    t, x, y = (number(place[key], 1, digits) for key, digits in (("at_s", 1), ("x_m", 2), ("y_m", 2)))
    return (
        f"Most of it is in {place['channel']} ({share} %); the largest, {most} mm in a second, at {t} s near "
        f"x {x}, y {y} m."
    )


def _before_after(
    caption: str, four: Sequence[Data], rows: Sequence[tuple[str, str, str]], scale: float
) -> Data | None:
    """Return a table of gaps before and, if any, after, on the logs and on held-out ones, and what part is left; None
    where there is no number."""
    groups = {"these logs": four[:2]} | ({"held-out logs": four[2:]} if any(four[2:]) else {})
    columns = ["before", "after", "left"] if any(four[1::2]) else ["as described"]
    table: list[Data] = []
    for key, label, unit in rows:
        pairs = [[gap.get(key) for gap in pair] for pair in groups.values()]
        if any(value is not None for pair in pairs for value in pair):
            cells = [
                (number(before, scale, 2), number(after, scale, 2), _left(before, after)) for before, after in pairs
            ]
            shown = [list(zip(columns, group, strict=False)) for group in cells]
            table.append({"label": label, "unit": unit, "cells": shown})
    return {"caption": caption, "groups": list(groups), "columns": columns, "rows": table} if table else None


def _left(before: Any, after: Any) -> str:
    """Return what part of a gap is left."""
    return "\N{EN DASH}" if after is None or not before else f"{PERCENT * after / before:.0f} %"


def _shown(picture: Picture) -> Data:
    """Return a picture as an address that needs no other file, with its texts."""
    svg = base64.b64encode(picture.svg.encode()).decode()
    return {"address": f"data:image/svg+xml;base64,{svg}", "alt": picture.alt, "caption": picture.caption}


def _json_of(data: Any) -> str:
    """Return data as JSON for people; lists of numbers in one line each."""
    spread = json.dumps(data, indent=2, ensure_ascii=False)
    return re.sub(r"\[[-+\d.eE,\s]+\]", lambda numbers: " ".join(numbers[0].split()), spread)
