"""A diagnosis by posterior as plain data, and in a few lines for people."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from castor_envs.vehicles.effect import Effect
from discrepancy.posterior.answers import Answer, Seen
from discrepancy.posterior.finder import Diagnosis
from estimators.calibration.identifiability import COVERAGE

FORMAT = "castor-diagnosis/2"

COSTS = ("mm after 10 m", "mrad after a turn")
"""Units of what an effect costs, in thousandths."""

Data = dict[str, Any]


def as_data(diagnosis: Diagnosis[Any, Any], mistakes: Sequence[str] = ()) -> Data:
    """Return a diagnosis as plain data; lengths in m, angles in rad."""
    return {
        "format": FORMAT,
        "robot": diagnosis.robot.name,
        "verdict": diagnosis.verdict,
        "preflight": list(mistakes),
        "answers": [_answer(answer) for answer in diagnosis.answers],
        "probabilities": diagnosis.inclusion,
        "gap": _gaps((diagnosis.before, diagnosis.after)),
        "held_out_gap": _gaps(diagnosis.held_out),
    }


def as_lines(data: Data) -> list[str]:
    """Return the same in words: what is missing, how sure, how large, what it costs, and what is left."""
    lines = [f"verdict: {data['verdict']}", *data["preflight"]]
    for answer in data["answers"]:
        names = ", ".join(f"{name} {100 * part:.3g} %" for name, part in list(answer["probabilities"].items())[:3])
        lines.append(f"{answer['verdict']}: {answer['what']} ({names})")
        if answer["unit"] is not None:
            low, high = answer["interval"]
            lines.append(f"  {answer['size']:.4g} {answer['unit']} ({low:.4g} to {high:.4g})")
        costs = (f"{1e3 * cost:.3g} {of}" for cost, of in zip(answer["cost"], COSTS, strict=True) if cost > 0)
        lines.append(f"  it costs {' and '.join(costs) or 'nothing on these drives'}")
        if answer["check"]:
            lines.append(f"  {answer['check']}")
    for name, of in (("the logs", data["gap"]), ("the held-out logs", data["held_out_gap"])):
        if of is not None:
            before, after = (f"{1e3 * metres:.3g} mm, {1e3 * turned:.3g} mrad" for metres, turned in of)
            lines.append(f"gap on {name}: {before} before, {after} after")
    return lines


def _answer(answer: Answer) -> Data:
    effect = answer.effect
    return {
        "verdict": answer.verdict,
        "reason": answer.reason,
        "what": answer.candidate.what,
        "probabilities": answer.probabilities,
        "credible_set": list(answer.credible),
        "effect": None if effect is None else {"name": effect.name} | _axle(answer) | _fields(effect),
        "size": answer.size,
        "unit": None if effect is None else effect.unit,
        "interval": [answer.size - COVERAGE * answer.error, answer.size + COVERAGE * answer.error],
        "cost": np.abs(answer.size * answer.cost).tolist(),
        "check": "" if effect is None else effect.check,
    }


def _fields(effect: Effect) -> Data:
    return {field.name: getattr(effect, field.name) for field in fields(effect) if field.name != "name"}


def _axle(answer: Answer) -> Data:
    """Return the axle, from 1, whose module has the effect, if it is one of a train's."""
    axle = getattr(answer.candidate, "axle", None)
    return {} if axle is None else {"axle": axle}


def _gaps(seen: tuple[Seen, Seen] | None) -> list[list[float]] | None:
    if seen is None or seen[0].gap is None or seen[1].gap is None:
        return None
    return [list(seen[0].gap), list(seen[1].gap)]
