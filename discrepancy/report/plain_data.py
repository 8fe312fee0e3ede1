"""A diagnosis by posterior as plain data."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from castor_envs.effects.catalogue import catalogue
from discrepancy.discriminating_drive import SeparatingDrive
from discrepancy.hypotheses.candidates import described, family_of
from discrepancy.posterior.answers import SHOWN, Answer, Learned, Seen
from discrepancy.posterior.finder import Diagnosis
from discrepancy.posterior.model.dimensions import Dimension
from discrepancy.posterior.verdicts import weakest
from discrepancy.preflight import Mistake
from discrepancy.preflight.undo import Logs
from estimators.calibration.identifiability import COVERAGE

FORMAT = "castor-diagnosis/2"

Data = dict[str, Any]
Pair = tuple[Any, Any]


def as_data(
    diagnosis: Diagnosis, logs: Sequence[Logs], seen: Pair, held_out: Pair | None, mistakes: Sequence[Mistake] = ()
) -> Data:
    """Return a diagnosis of a robot or a train as plain data; lengths in m, angles in rad.

    logs: these, held-out and clean ones, by their names. seen, held_out: these, and held-out ones if there are any,
    linearised without and, if anything is named, with it. mistakes: gross ones, undone in the logs.
    """
    noise, gross = (seen[1] or seen[0]).noise, [_mistake(mistake) for mistake in mistakes]
    gap = _gap(seen[0].gap)
    heading = noise.heading if gap is not None and gap[1] is not None else None
    return {
        "format": FORMAT,
        "robot": diagnosis.robot.name,
        "verdict": weakest([diagnosis.verdict, *(mistake["verdict"] for mistake in gross)]),
        "mistakes": gross,
        "answers": [answer_data(answer) for answer in diagnosis.answers],
        "dimensions": [dimension_data(dimension) for dimension in diagnosis.dimensions],
        "probabilities": diagnosis.inclusion,
        "names": _names(diagnosis),
        "gap": _gaps(*seen),
        "held_out_gap": None if held_out is None else _gaps(*held_out),
        "clean_gap": _gap(diagnosis.clean_gap),
        "noise": None
        if gap is None
        else {"position_m": noise.position, "heading_rad": heading, "poses": (seen[1] or seen[0]).poses},
        **dict(zip(("logs", "held_out_logs", "clean_logs"), map(list, logs), strict=True)),
        "replay": None,
        "where": None,
    }


def answer_data(answer: Answer) -> Data:
    """Return an answer as plain data; of an effect of a train's module, with its axle (from 1)."""
    effect, axle = answer.effect, getattr(answer.candidate, "axle", None)
    sized = effect is not None and not effect.binary
    return {
        "verdict": answer.verdict,
        "reason": answer.reason,
        "what": answer.candidate.what,
        "probability": min(answer.probability, 1.0),  # sums of rounded parts may exceed it
        "probabilities": {name: min(part, 1.0) for name, part in answer.probabilities.items()},
        "credible_set": list(answer.credible),
        "same_as": list(answer.alike),
        "effect": None if effect is None else asdict(effect) | ({} if axle is None else {"axle": axle}),
        "size": answer.size,
        "unit": effect.unit if effect is not None and sized else None,
        "interval": [answer.size - COVERAGE * answer.error, answer.size + COVERAGE * answer.error],
        "cost": np.abs(answer.size * answer.cost).tolist(),
        "curve": None if answer.curve is None else _curve(answer.curve),
        "check": "" if effect is None else effect.check,
        "separating_drive": None,
    }


def dimension_data(dimension: Dimension) -> Data:
    """Return a dimension that is guessed together with the others as plain data."""
    candidate, size, error = dimension.sized.candidate, dimension.sized.size, COVERAGE * float(np.max(dimension.error))
    unit = candidate.kinds[0].unit
    return {"what": candidate.what, "size": size, "unit": unit, "interval": [size - error, size + error]}


def drive_data(drive: SeparatingDrive) -> Data:
    """Return a drive as plain data."""
    return {"drive": drive.what, "expected_log_bayes_factor": drive.expected, "duration_s": drive.trajectory.duration}


def _curve(learned: Learned) -> Data:
    """Return a learned curve with the 95 % interval of its values."""
    term = learned.effect
    values, error = (term.value * np.array(of) for of in (term.values, learned.errors))
    nearest = None if learned.nearest is None else dict(zip(("what", "cosine"), learned.nearest, strict=True))
    return {
        "of": term.of,
        "unit": "rad/s" if term.of == "speed" else "rad",
        "knots": list(term.knots),
        "values": values.tolist(),
        "low": (values - COVERAGE * error).tolist(),
        "high": (values + COVERAGE * error).tolist(),
        "nearest": nearest,
    }


def _mistake(mistake: Mistake) -> Data:
    return {
        "verdict": "ambiguous" if mistake.alternatives else "named",
        "what": mistake.what,
        "effects": [asdict(effect) for effect in mistake.effects],
        "alternatives": list(mistake.alternatives),
    }


def _names(diagnosis: Diagnosis) -> dict[str, str]:
    """Return in words what the reported names stand for."""
    kinds = ((family_of(effect), effect) for effect in catalogue(diagnosis.robot.as_described()))
    words = {family: described(effect) for family, effect in kinds if effect.name == family.split()[0]}
    words |= {answer.candidate.family: answer.candidate.what for answer in diagnosis.answers}
    reported = {name for answer in diagnosis.answers for name in (*answer.probabilities, *answer.alike)}
    reported |= {name for name, part in diagnosis.inclusion.items() if part > SHOWN}
    return {name: words.get(name, name) for name in sorted(reported)}


def _gaps(before: Seen, after: Seen | None) -> list[list[float | None] | None] | None:
    """Return the gap, m and rad, without and with what is named."""
    if before.gap is None:
        return None
    return [_gap(before.gap), None if after is None else _gap(after.gap)]


def _gap(gap: tuple[float, float] | None) -> list[float | None] | None:
    """Return a gap, m and rad, None where no heading is known."""
    return None if gap is None else [None if np.isnan(part) else part for part in gap]
