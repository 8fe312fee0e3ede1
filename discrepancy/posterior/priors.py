"""What is believed before logs speak: which hypotheses there are, how large they are, what is seen in good order."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from pydantic import TypeAdapter

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.posterior.answers import Place, Seen
from discrepancy.posterior.calibrated import FAULT
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.random_effects import GoodOrder, good_order, log_likelihood_of
from discrepancy.posterior.single_effects import Hypothesis
from estimators.calibration.drives import DRIVES, log_of

PARTS = np.arange(7) / 4
"""Of an effect that wheels may hide by coming to terms: each is as likely before logs are seen."""

PATTERN = np.array([[1.0, PARTS.mean()], [PARTS.mean(), np.mean(PARTS**2)]])
"""Covariance of an amplitude and what wheels hide of it, where the variance of the amplitude is 1."""

PARTS_OF = np.geomspace(1.0, 1 / FAULT, 5)
"""Of tolerances: robots in good order are as good as stated, or up to `FAULT` times better."""

ALIKE, UNSEEN = 1e-4, 1e-4
"""Squared sine of the angle between signatures of effects that are one and the same on a robot, in a drive that shows
all it can; and deviance there of an effect of its tolerance that is none at all. What is not the same has over 1e-3."""


ABOUT = 0.3
"""How far what is there or not may look from 1: what whole counts leave over is a little random."""


@lru_cache(maxsize=16)
def same_effects(robot: RobotDescription) -> tuple[dict[str, str], frozenset[str]]:
    """Return which effects are one and the same on a robot, whatever it does: the name that stands for each family; and
    families that change nothing that a log could show."""
    (path,) = DRIVES["a random path of 60 s"](robot)
    log = log_of(robot, path, "all")
    among = [candidate for candidate in candidates_of(robot) if candidate.columns == 1]
    seen = linearise(robot, [log], among=among)
    information = seen.logs[0].information
    single = [(candidate, int(columns[0])) for candidate, columns in zip(seen.candidates, seen.columns, strict=True)]
    shown = [(one, k) for one, k in single if information[k, k] * one.kinds[0].tolerance ** 2 > UNSEEN]
    unseen = {one.family for one, _ in single} - {one.family for one, _ in shown}
    stands: dict[str, str] = {}
    for n, (one, k) in enumerate(shown):
        for other, j in shown[:n]:
            if 1 - information[k, j] ** 2 / (information[k, k] * information[j, j]) < ALIKE:
                stands.setdefault(one.family, stands.get(other.family, other.family))
    return stands, frozenset(unseen)


def tolerances(seen: Seen) -> Array:
    """Return what robots in good order show of each of C sizes, standard deviations."""
    tolerance = seen.usual.copy()
    for candidate, columns in zip(seen.candidates, seen.columns, strict=True):
        if candidate.kinds:
            tolerance[columns] = candidate.kinds[0].tolerance
    return tolerance


def order_of(seen: Seen, clean: Seen | None) -> GoodOrder:
    """Return what a vehicle shows in good order of all candidates of logs, as clean logs tell where there are any.

    Clean logs tell how much better than stated its order is in all, and then of each effect.
    """
    if clean is None:
        return good_order(tolerances(seen), _pattern(seen))
    stated, told = good_order(_part_told_by(clean) * tolerances(seen), _pattern(seen)), _told_by(clean)
    here, there = [], []
    for candidate, columns in zip(seen.candidates, seen.columns, strict=True):
        if candidate in clean.candidates:
            here += columns.tolist()
            there += clean.columns[clean.candidates.index(candidate)].tolist()
    at, of = (
        np.array([k + part * len(each.usual) for part in range(len(_pattern(each))) for k in columns], dtype=np.intp)
        for each, columns in ((seen, here), (clean, there))
    )
    background, doubt, scatter = stated.background.copy(), stated.doubt.copy(), stated.scatter.copy()
    background[at] = told.background[of]
    doubt[np.ix_(at, at)], scatter[np.ix_(at, at)] = told.doubt[np.ix_(of, of)], told.scatter[np.ix_(of, of)]
    return GoodOrder(background, doubt, scatter)


@lru_cache(maxsize=4)
def _part_told_by(clean: Seen) -> float:
    """Return the part of tolerances that clean logs show, rms; each is as likely before they speak."""
    log_likelihood = log_likelihood_of(PARTS_OF, clean.logs, tolerances(clean), _pattern(clean))
    weight = np.exp(log_likelihood - log_likelihood.max())
    return float(np.sqrt(np.average(PARTS_OF**2, weights=weight)))


@lru_cache(maxsize=4)
def _told_by(clean: Seen) -> GoodOrder:
    return good_order(_part_told_by(clean) * tolerances(clean), _pattern(clean), clean.logs)


def _pattern(seen: Seen) -> Array:
    """Return the covariance of the sizes that each effect has in what logs say: of trains only its amplitude."""
    sizes = len(seen.logs[0].score) // max(len(seen.usual), 1)
    return PATTERN[:sizes, :sizes]


def hypotheses_of(robot: RobotDescription, seen: Linearised) -> tuple[list[Hypothesis], list[Place]]:
    """Return all that may be there, and of each hypothesis what it is about.

    Every family is as likely as any other; those at a place, or at a time, that suits the logs share theirs with all
    places or times where they might have been looked for.
    """
    stands, unseen = same_effects(robot.as_described())
    names = [stands.get(candidate.family, candidate.family) for candidate in seen.candidates]
    count = len(seen.usual)
    strength = np.sum([np.diag(log.information) for log in seen.logs], axis=0)
    steps = sum(len(state) - 1 for state in seen.state.states)
    hypotheses, places = [], []
    for k, (candidate, columns) in enumerate(zip(seen.candidates, seen.columns, strict=True)):
        if candidate.family in unseen:
            continue
        hides = bool(candidate.kinds) and bool(np.any(strength[columns + count] > 1e-9 * strength[columns]))
        parts = PARTS.tolist() if hides else [0.0]
        share = 1 / names.count(names[k]) / len(parts) / (steps if candidate.sought_in_steps else 1)
        hypotheses += [hypothesis_of(seen, Place(k, part), names[k], share) for part in parts]
        places += [Place(k, part) for part in parts]
    return hypotheses, places


def hypothesis_of(seen: Seen, place: Place, name: str, share: float) -> Hypothesis:
    """Return the hypothesis that a candidate is there, hidden by wheels in a part."""
    candidate, columns = seen.candidates[place.candidate], seen.columns[place.candidate]
    least, most = bounds_of(candidate.kinds[0]) if candidate.kinds else (-np.inf, np.inf)
    scale = FAULT * float(np.mean(tolerances(seen)[columns]))
    return Hypothesis(name, direction_of(seen, place), scale, share, least, most)


def direction_of(seen: Seen, place: Place) -> Array:
    """Return what the c amplitudes of a candidate, hidden by wheels in a part, change in all sizes (m, c)."""
    columns = seen.columns[place.candidate]
    direction = np.zeros((len(seen.logs[0].score), len(columns)))
    direction[columns, np.arange(len(columns))] = 1.0
    if place.hidden:
        direction[columns + len(seen.usual), np.arange(len(columns))] = place.hidden
    return direction


def sizes_of(candidates: Sequence[int], sizes: Sequence[Array], hidden: Sequence[float], seen: Seen) -> Array:
    """Return b (m,) of candidates of these sizes, hidden in these parts."""
    total = np.zeros(len(seen.logs[0].score))
    for k, size, part in zip(candidates, sizes, hidden, strict=True):
        total += direction_of(seen, Place(k, part)) @ size
    return total


@lru_cache(maxsize=256)
def bounds_of(kind: Effect) -> tuple[float, float]:
    """Return the least and the most that an effect's amplitude can be; of what is there or not, about 1."""
    if kind.binary:
        return 1 - ABOUT, 1 + ABOUT
    value = TypeAdapter(type(kind)).json_schema()["properties"]["value"]
    return max(value.get("minimum", -np.inf), kind.least), value.get("maximum", np.inf)
