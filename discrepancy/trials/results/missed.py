"""The cases of a trial that its rates count against the finder: what was hidden in each, and what the finder said."""

from collections.abc import Callable, Sequence
from textwrap import shorten
from typing import Any

from castor_envs.effects.catalogue import EFFECTS, TRAIN_EFFECTS
from discrepancy.report.parts import MILLI, READ_AS, digits_by, number
from discrepancy.trials.results.scores import COSTLY, SEPARATE, Trial

Data = dict[str, Any]

EFFECTS_HIDDEN = ("one", "two", "three", "poor")
"""Strata of cases into which effects of the catalogue are hidden."""

LONGEST = 160
"""Most letters of the finder's reason that are told."""


def _not_named(case: Trial) -> bool:
    """Whether a hidden effect that is costly and separate enough is not named."""
    log, holdout = case.label["log"], case.label["holdout"]
    if case.label["stratum"] not in EFFECTS_HIDDEN or not log or not holdout:
        return False
    strengths = zip(case.label["hidden"], log["cost"], log["z_sep"], holdout["z"], strict=False)  # not always known
    plain = [effect for effect, cost, *z in strengths if cost >= COSTLY and min(z) >= SEPARATE]
    return any(effect["class"] not in case.named for effect in plain)


MISSES: Sequence[tuple[str, Callable[[Trial], bool]]] = (
    ("broke down", Trial.broke_down),
    ("alarm", lambda case: case.label["stratum"] == "clean" and case.alarmed()),
    ("wrong sure name", lambda case: case.label["stratum"] != "wiring" and case.wrong()),
    ("not named", _not_named),
    (
        "not named exactly",
        lambda case: (
            case.label["stratum"] in EFFECTS_HIDDEN and case.plain() and not (case.exact() or _not_named(case))
        ),
    ),
    ("not flagged", lambda case: case.label["stratum"] == "outside" and case.to_be_flagged() and not case.flagged()),
    ("not found", lambda case: case.label["stratum"] == "wiring" and not case.exact() and case.verdict != "refused"),
    ("gap grew", Trial.gap_grew_by_what_matters),
)
"""What counts against the finder, as `scores.RATES` has it, and which cases it holds of."""


def missed(cases: Sequence[Trial]) -> list[Data]:
    """Return the cases of which a miss holds, as plain data."""
    found = []
    for case in cases:
        label, misses = case.label, [what for what, holds in MISSES if holds(case)]
        if misses:
            costs = label["log"]["cost"] if label["log"] else []
            hidden = [_hidden(what, costs[k] if k < len(costs) else None) for k, what in enumerate(label["hidden"])]
            named = [_named(size) for size in case.outcome["sizes"]]
            motion = label.get("course", label.get("drive"))
            found.append(
                {"case": label["case"], "missed": misses, "robot": label["robot"], "motion": motion, "hidden": hidden}
                | {key: label[key] for key in ("clean", "reference")}
                | {
                    "verdict": case.verdict,
                    "named": named,
                    "reason": shorten(case.outcome["reason"], LONGEST, placeholder=" ..."),
                }
            )
    return found


def as_line(miss: Data) -> str:
    """Return a miss as text."""
    where = f"{miss['robot']}, {given_of(miss)}"
    said = f"{miss['verdict']}: {said_of(miss)}" if said_of(miss) else miss["verdict"]
    hidden = "; ".join(miss["hidden"]) or "nothing hidden"
    return f"case {miss['case']}, {', '.join(miss['missed'])} ({where}): {hidden} -> {said}"


def given_of(miss: Data) -> str:
    """Return how a robot was driven, and what the finder was given."""
    given = [
        f"{'' if miss[key] else 'no '}{called}" for key, called in (("clean", "clean logs"), ("reference", "reference"))
    ]
    return ", ".join([miss["motion"], *given])


def said_of(miss: Data) -> str:
    """Return what the finder named, or else its reason."""
    return "; ".join(miss["named"]) or miss["reason"]


def _hidden(effect: Data, cost: float | None) -> str:
    """Return what is hidden, its size, and its cost."""
    what = effect["what"]
    kind = EFFECTS.get(what.get("name", "")) or TRAIN_EFFECTS.get(what.get("name", ""))
    size = "" if kind is None or kind.binary else f" {_size(kind.unit, what['value'], abs(what['value']) / 10)}"
    return f"{_class(effect)}{size}" + ("" if cost is None else f" ({number(cost, MILLI, digits_by(cost, MILLI))} mm)")


def _named(size: Data) -> str:
    """Return a named effect with its 95 % interval."""
    if size["low"] is None or size["effect"] is None:
        return _class(size)
    name, value = size["effect"]["name"], size["effect"]["value"]
    kind = EFFECTS.get(name) or TRAIN_EFFECTS[name]
    return f"{_class(size)} {_size(kind.unit, value, (size['high'] - size['low']) / 2, interval=True)}"


def _size(unit: str, value: float, error: float, interval: bool = False) -> str:
    """Return a value, with its error or not, to the second figure of the error."""
    called, scale = READ_AS.get(unit, (unit, 1.0))
    digits = digits_by(error, scale)
    shown = number(value, scale, digits) + (f" ± {number(error, scale, digits)}" if interval else "")
    return f"{shown} {called}"


def _class(of: Data) -> str:
    """Return the class of an effect; that of a castor's own encoder has no wheel."""
    return str(of["class"]).removesuffix(" None")
