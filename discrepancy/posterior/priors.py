"""Priors: which hypotheses there are, how large their effects may be, and what robots in good order show."""

from collections.abc import Collection, Iterable
from functools import lru_cache
from itertools import product

import numpy as np
from pydantic import TypeAdapter

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, candidates_of
from discrepancy.posterior.answers import Cause, Place, Seen
from discrepancy.posterior.calibrated import FAULT
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.random_effects import GoodOrder, good_order, log_likelihood_of, summed
from discrepancy.posterior.single_effects import Hypothesis
from estimators.calibration.drives import logged
from estimators.calibration.maximum_likelihood.tracker import mount_prior

PARTS = np.arange(7) / 4
"""Parts of an effect that wheel creep may mask, all with the same prior probability."""

ABOUT_FITTED = np.linspace(-PARTS[1], PARTS[1], 9)
"""By how much another part of an effect in the model may be masked than fits found, as contacts are not as predicted:
finer than `PARTS`, as references tell."""

SHOWN_AND_MASKED = np.sqrt([np.mean((1 - PARTS) ** 2), np.mean(PARTS**2)])
"""Standard deviations of the shown and of the masked amount of an effect whose amplitude is 1."""

PARTS_OF = np.geomspace(1.0, 1 / FAULT, 5)
"""Factors on tolerances: robots in good order are as good as stated, or up to `FAULT` times better."""

ALIKE, UNSEEN = 1e-4, 1e-4
"""Largest squared sine of the angle between signatures of indistinguishable effects, on a drive that excites all
effects; and deviance on it below which an effect of the size of its tolerance is unobservable. Distinguishable effects
have over 1e-3."""


EXCITING = 40.0
"""s: duration of a random path that excites all effects. On every preset 60 s give the same result."""

ABOUT = 0.3
"""How far the amplitude of a binary effect may be estimated from 1: the rounding of counts makes it a little random."""


@lru_cache(maxsize=16)
def same_effects(robot: RobotDescription) -> tuple[dict[str, str], dict[str, Array]]:
    """Return the indistinguishable effects of a robot, as the family whose name represents each family; and the
    families that are unobservable in any log, each with the place of the tracked point (3,), m, m, rad, that looks the
    same as a unit of it. Forces, as of a slope, are neither: commands show them."""
    path = wander(np.random.default_rng(0), duration=EXCITING, holonomic=moves_sideways(robot))
    ahead = roll(robot, path)  # some robots turn their wheels one way on it: they come back, too
    back = Rolled(ahead.t, *(joints[::-1] for joints in ahead[1:]))
    logs = [logged(robot, rolled, "all") for rolled in (ahead, back)]
    single_sized = [candidate for candidate in candidates_of(robot) if candidate.columns == 1]
    among = [candidate for candidate in single_sized if candidate.kinds[0].creep != "forces"]
    seen = linearise(robot, logs, among=among)
    information = summed(seen.logs).information
    single: list[tuple[Cause, int]] = [(candidate, int(columns[0])) for candidate, columns in seen.columns.items()]
    shown = [
        (candidate, k) for candidate, k in single if information[k, k] * candidate.kinds[0].tolerance ** 2 > UNSEEN
    ]
    unseen = [candidate for candidate in seen.candidates if candidate not in dict(shown)]
    stands: dict[str, str] = {}
    for n, (candidate, k) in enumerate(shown):
        for earlier, j in shown[:n]:
            if alike(information, k, j):
                stands.setdefault(candidate.family, stands.get(earlier.family, earlier.family))
    return stands, {candidate.family: _as_mount(seen, candidate) for candidate in unseen}


def _as_mount(seen: Linearised, candidate: Candidate) -> Array:
    """Return the place of the tracked point (3,), m, m, rad, with which logs fit best if a unit of a candidate is not
    known."""
    size, shared = candidate.columns + len(seen.shared.creep) + len(seen.shared.mount), seen.shared
    information, gradient = np.zeros((size, size)), np.zeros((size, 1))
    for design in seen.designs:
        information += design.reduce(shared.mount, seen.noise, [candidate]).information
    shared.add_priors(information, gradient, candidate.columns)
    nuisances = information[candidate.columns :, candidate.columns :]
    looks = np.linalg.solve(nuisances, information[candidate.columns :, 0])
    return np.asarray(looks[-len(shared.mount) :], dtype=np.float64)


def alike(information: Array, first: int, second: int) -> bool:
    """Whether sizes with these numbers do the same, by their information (m, m), so that nothing distinguishes them."""
    squared_cosine = information[first, second] ** 2 / (information[first, first] * information[second, second])
    return bool(1 - squared_cosine < ALIKE)


def tolerances(seen: Seen) -> Array:
    """Return the standard deviations of C sizes in robots in good order: as the robot file states them, or usually."""
    tolerance = seen.usual.copy()
    for candidate, columns in seen.columns.items():
        if candidate.kinds:
            stated = tolerance[columns]
            tolerance[columns] = np.where(stated > 0, stated, candidate.kinds[0].tolerance)
    return tolerance


def order_of(seen: Seen, clean: Seen | None) -> GoodOrder:
    """Return the sizes of all candidates that a vehicle in good order shows, from clean logs where there are any.

    Clean logs give common factors on all tolerances first, then how much effects of each class scatter, and the
    background of each effect, but for those that are of a certain time in one log.
    """
    if clean is None:
        return good_order(_usual(seen)).of_sizes(_basis(seen))
    factors, learned = _order_of_clean(clean)
    stated = good_order(np.repeat(factors, len(seen.usual)) * _usual(seen))
    of_class = dict(zip(_classes(clean), np.diag(learned.scatter) / _usual(clean) ** 2, strict=True))
    own = np.diag(stated.scatter) / _usual(seen) ** 2
    scatter = np.diag([of_class.get(alike, own[k]) for k, alike in enumerate(_classes(seen))] * _usual(seen) ** 2)
    of_seen, of_clean = [], []
    for candidate, columns in seen.columns.items():
        if candidate in clean.columns and not candidate.when:
            of_seen += columns.tolist()
            of_clean += clean.columns[candidate].tolist()
    at, of = (
        np.array([k + part * len(source.usual) for part in range(len(factors)) for k in columns], dtype=np.intp)
        for source, columns in ((seen, of_seen), (clean, of_clean))
    )
    background, doubt = stated.background.copy(), stated.doubt.copy()
    background[at], doubt[np.ix_(at, at)] = learned.background[of], learned.doubt[np.ix_(of, of)]
    return GoodOrder(background, doubt, scatter).of_sizes(_basis(seen))


@lru_cache(maxsize=4)
def _order_of_clean(clean: Seen) -> tuple[Array, GoodOrder]:
    """Return the rms factors on tolerances that clean logs show, of shown and of masked amounts, and the distribution
    of these amounts; all pairs of `PARTS_OF` have the same prior probability.

    What wheels mask is seen by the reference alone and depends on how they slip; it may scatter otherwise than what
    the encoders of robots in good order show.
    """
    logs, usual = [log.of_combinations(_basis(clean)) for log in clean.logs], _usual(clean)
    pairs = np.array(list(product(PARTS_OF, repeat=len(usual) // len(clean.usual))))
    log_likelihood = np.array([log_likelihood_of(logs, np.repeat(pair, len(clean.usual)) * usual) for pair in pairs])
    factors = np.sqrt(np.average(pairs**2, axis=0, weights=np.exp(log_likelihood - log_likelihood.max())))
    _, alike = np.unique(_classes(clean), return_inverse=True)
    return factors, good_order(np.repeat(factors, len(clean.usual)) * usual, logs, alike)


def _classes(seen: Seen) -> list[str]:
    """Return the class of each size, of the shown amounts and then of the masked ones: all effects that do the same
    scatter alike, whichever castor or wheel they are of."""
    alike = [candidate.alike for candidate in seen.candidates for _ in range(candidate.columns)]
    return [f"{name}, {part}" for part in range(_kinds(seen)) for name in alike]


def _kinds(seen: Seen) -> int:
    """Return the number of sizes that each effect has in the statistics of logs; trains have only the amplitude."""
    return len(seen.logs[0].score) // max(len(seen.usual), 1)


def _usual(seen: Seen) -> Array:
    """Return the standard deviations in good order of the shown amounts, then of the masked amounts, of C effects."""
    kinds = _kinds(seen)
    return np.kron(SHOWN_AND_MASKED if kinds > 1 else np.ones(1), tolerances(seen)).astype(np.float64)


def _basis(seen: Seen) -> Array:
    """Return the matrix from shown and masked amounts to sizes: an amplitude is their sum."""
    kinds = _kinds(seen)
    return np.kron(np.triu(np.ones((kinds, kinds))), np.eye(len(seen.usual))).astype(np.float64)


def hypotheses_of(
    robot: RobotDescription, seen: Linearised, in_model: Collection[Cause] = ()
) -> tuple[list[Hypothesis], list[Place]]:
    """Return all hypotheses, and the candidate and masked part of each: for effects in the model (`in_model`) parts
    near the one that logs show, for all others `PARTS`.

    All families have the same prior probability. Candidates whose place or time was chosen to suit the logs share that
    of their family with all places or times that were searched; the unnamed alternatives of one encoder, wheel or
    castor share that of one family, as more logs are no reason to expect more of them.
    """
    stands, unseen = same_effects(robot.as_described())
    candidates: tuple[Cause, ...] = seen.candidates
    names = [stands.get(candidate.family, candidate.family) for candidate in candidates]
    family_of = {candidate: name for candidate, name in zip(candidates, names, strict=True) if candidate.kinds}
    families = [family_of.get(candidate, candidate.family.partition(" ")[0]) for candidate in candidates]
    count, width = len(seen.usual), 2 * float(mount_prior(Geometry.of(robot))[0])
    scale = FAULT * tolerances(seen)
    strength = np.sum([np.diag(log.information) for log in seen.logs], axis=0)
    steps = sum(len(state) - 1 for state in seen.state.states)
    hypotheses, places = [], []
    for k, (candidate, columns) in enumerate(seen.columns.items()):
        if candidate.family in unseen:
            continue
        hides = bool(candidate.kinds) and bool(np.any(strength[columns + count] > 1e-9 * strength[columns]))
        parts = (parts_about_fitted(seen) if candidate in in_model else PARTS).tolist() if hides else [0.0]
        share = 1 / families.count(families[k]) / len(parts) / (steps if candidate.searched_over_steps else 1)
        hypotheses += [hypothesis_of(seen, Place(candidate, part), names[k], share, scale, width) for part in parts]
        places += [Place(candidate, part) for part in parts]
    return hypotheses, places


def parts_about_fitted(seen: Seen) -> Array:
    """Return the parts (P,) of an effect in the model that wheel creep may mask, as fits found and near that."""
    parts: Array = seen.masked + ABOUT_FITTED
    return parts if seen.masked == 1 else parts[(parts - 1) * (seen.masked - 1) > 0]  # beyond 1 the sign changes


def hypothesis_of(seen: Seen, place: Place, name: str, share: float, scale: Array, width: float = np.inf) -> Hypothesis:
    """Return the hypothesis that a candidate is present, with a part of it masked by wheel creep.

    scale (C,): of a fault of each size. width (m) of the vehicle: no length of it is wrong by more.
    """
    candidate, columns = place.candidate, seen.columns[place.candidate]
    lower, upper = bounds_of(candidate.kinds[0]) if candidate.kinds else (-np.inf, np.inf)
    if candidate.kinds and candidate.kinds[0].unit == "m":
        lower, upper = max(lower, -width), min(upper, width)
    return Hypothesis(name, direction_of(seen, place), float(np.mean(scale[columns])), share, lower, upper)


def direction_of(seen: Seen, place: Place) -> Array:
    """Return the change of b (m, c) per unit of a candidate's c amplitudes, with a part masked by creep."""
    columns = seen.columns[place.candidate]
    direction = np.zeros((len(seen.logs[0].score), len(columns)))
    direction[columns, np.arange(len(columns))] = 1.0
    if place.masked and len(direction) > len(seen.usual):
        direction[columns + len(seen.usual), np.arange(len(columns))] = place.masked
    return direction


def directions_in_model(seen: Seen, candidates: Iterable[Cause], masked: float | None = None) -> Array:
    """Return the change of b (m, columns) per unit of the amplitudes of candidates in the model: creep masks a part of
    each, None: as much as these logs show."""
    part = seen.masked if masked is None else masked
    directions = [direction_of(seen, Place(candidate, part)) for candidate in candidates]
    return np.concatenate([np.zeros((len(seen.logs[0].score), 0)), *directions], axis=1)


@lru_cache(maxsize=256)
def bounds_of(kind: Effect) -> tuple[float, float]:
    """Return the bounds of an effect's amplitude; for a binary effect an interval about 1."""
    if kind.binary:
        return 1 - ABOUT, 1 + ABOUT
    value = TypeAdapter(type(kind)).json_schema()["properties"]["value"]
    return max(value.get("minimum", -np.inf), kind.least), value.get("maximum", np.inf)
