"""Noise of contacts and of the reference beyond that of clean logs: what no named effect, nor creep, explains.

Noise is a variance, and not a column of the linear problem. In robots in good order its logarithm is normal from log to
log, about a level and with a scatter that clean logs tell. A fault outside the catalogue raises the level.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtr

from castor_envs.geometry.arrays import Array
from discrepancy.hypotheses.candidates import Candidate, stacked
from discrepancy.measurement.design_matrix import PROBES, DesignMatrix
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, FREEDOM, prior_log_odds
from discrepancy.posterior.linearise import Linearised
from estimators.likelihood.creep_prediction import UNEVEN
from estimators.likelihood.log_likelihood import Noise
from estimators.likelihood.reduction import Reduced

SCATTER = 0.2
"""Standard deviation, from log to log, of the logarithm of noise in good order, before clean logs are seen. In seven
clean logs each of seven bases with redundant encoders (MuJoCo, wander, 60 s) it is 0.02 to 0.16 along."""

RESOLVED = 1e-4
"""Least noise that is compared: m after 1 m or 1 rad, m and rad. Below it the rounding of counts hides slip, so that
logs do not show how much there is; they count as having this much."""

LEVEL = np.log(RESOLVED) + 0.15 * np.arange(60)
BELOW = LEVEL[0] - 0.3 * np.arange(6, 0, -1)
SCATTERS = SCATTER * 2.0 ** np.arange(-2, 5)
RAISED = np.linspace(0.0, 5.0, 51)
"""Grids to integrate over: logarithm of noise, from the least that is estimated (which all below counts as) to beyond
the most that logs can be fitted with (0.3 rad); levels below that; scatter; and rise of the level by a fault."""

KINDS = {
    "along": "wheels roll {} times less regularly than in the clean logs",
    "across": "wheels slide sideways {} times less regularly than in the clean logs",
    "turning": "contacts that motors turn on the floor slip {} times less regularly than in the clean logs",
    "position": "positions of the reference scatter {} times as much as in the clean logs",
    "heading": "headings of the reference scatter {} times as much as in the clean logs",
}
"""Fields of `Noise`, and what more of each is called."""

FARTHEST, STEPS = 8.0, 9
"""Factor on the noise found, up and down, within which the other noise is fitted, and at how many levels."""

OTHERS, ROUGHLY = (-2.5, 2.5), 0.3
"""Natural logarithm of the factors on the other noise, and how exact the likeliest is: log-likelihoods are within 0.2
of the largest."""

CONTACTS, REFERENCE = ("along", "across"), ("position", "heading")
"""Those of slip in proportion to the way, and those of the reference."""


class Found(NamedTuple):
    """Noise of one kind in one log: variance (m^2 of slip after 1 m, or after 1 rad of turning, m^2 or rad^2 of the
    reference), and the degrees of freedom that determine it."""

    variance: float
    freedom: float

    @property
    def log_likelihood(self) -> Array:
        """Log-likelihood of the levels `LEVEL`, up to a constant."""
        found = -self.freedom / 2 * (2 * LEVEL + self.variance * np.exp(-2 * LEVEL))
        return np.asarray(found - found.max())


class Profile(NamedTuple):
    """Log-likelihood of the levels `LEVEL` of one kind of noise in one log, up to a constant, with the other noise as
    likely as it can be."""

    log_likelihood: Array


def noisy_answers(seen: Linearised, held_out: Linearised | None, clean: Linearised) -> list[Answer]:
    """Return the answers that slip, or the reference's errors, are larger at random than in clean logs.

    seen, held_out: statistics beside the named effects; clean: of clean logs.
    """
    several, answers = [seen, *([] if held_out is None else [held_out])], []
    every, usual = [noise for logs in several for noise in noise_of(logs)], noise_of(clean)
    for kind in KINDS:
        found, good = [log[kind] for log in every], [log[kind] for log in usual]
        if _probability(found, good) < CREDIBLE:
            continue
        profiles = [log for logs in several for log in profiles_of(logs, kind)]
        if _probability(profiles, good) < CREDIBLE:
            continue
        probability = _probability(profiles, profiles_of(clean, kind))
        if probability >= CREDIBLE:
            variance, usually = _pooled(found), _pooled(good)
            noise, cost = float(np.sqrt(variance)), _cost(seen, kind, max(variance - usually, 0.0))
            candidate = Candidate(KINDS[kind].format(f"{noise / max(np.sqrt(usually), RESOLVED):.2g}"))
            answers.append(Answer.judged_apart(candidate, probability, noise, 0.0, cost))
    return answers


def _probability(logs: Sequence[Found | Profile], clean: Sequence[Found | Profile]) -> float:
    return float(expit(log_bayes_factor(logs, clean) + prior_log_odds(1)))


def profiles_of(seen: Linearised, kind: str) -> list[Profile]:
    """Return the log-likelihood of one kind of noise in each log, whatever the other noise is.

    Few poses hardly tell whether wheels slipped or the tracker was off: each explains what the other leaves. With slip
    as large as in clean logs, errors of the reference may be as small. The noise of contacts, or that of the reference,
    if `kind` is of contacts, is multiplied by the factor with which a log is likeliest.
    """
    from scipy.interpolate import PchipInterpolator  # slow to import

    others = [other for other in KINDS if (other in REFERENCE) != (kind in REFERENCE)]
    fitted = replace(seen.noise, **{name: max(getattr(seen.noise, name), RESOLVED) for name in KINDS})
    steps = getattr(fitted, kind) * np.geomspace(1 / FARTHEST, FARTHEST, STEPS)
    levels, profiles = np.unique([RESOLVED, *np.maximum(steps, RESOLVED)]), []
    for design in seen.designs:
        likely = [_likeliest(design, seen.shared.mount, replace(fitted, **{kind: size}), others) for size in levels]
        profile = PchipInterpolator(np.log(levels), likely)(np.clip(LEVEL, *np.log(levels[[0, -1]])))
        profiles.append(Profile(profile - profile.max()))
    return profiles


def _likeliest(design: DesignMatrix, mount: Array, noise: Noise, others: Sequence[str]) -> float:
    """Return the largest log evidence of a log with some of the noise (`others`) multiplied by a factor."""
    from scipy.optimize import fminbound  # slow to import

    def less_likely(log_factor: float) -> float:
        sizes = {other: float(np.exp(log_factor)) * getattr(noise, other) for other in others}
        return -_reduced(design, mount, replace(noise, **sizes)).log_evidence()

    if not design.model.poses:
        return -less_likely(0.0)
    _, least, *_ = fminbound(less_likely, *OTHERS, xtol=ROUGHLY, full_output=True)
    return -float(least)


def log_bayes_factor(logs: Sequence[Found | Profile], clean: Sequence[Found | Profile]) -> float:
    """Return the log Bayes factor (natural logarithm) that a fault raises the level of noise above that of clean logs.

    The scatter's variance has an inverse gamma prior about `SCATTER`, with `FREEDOM` degrees of freedom; the level is
    unknown; a rise is Cauchy distributed, half of all rises are by a factor of more than `FAULT`.
    """
    levels = np.concatenate([BELOW, LEVEL])
    log_prior = -FREEDOM * np.log(SCATTERS) - FREEDOM * SCATTER**2 / (2 * SCATTERS**2)
    rise = -np.log1p((RAISED / np.log(FAULT)) ** 2)
    rise -= np.logaddexp.reduce(rise)
    good, raised = [], []
    for scatter, prior in zip(SCATTERS, log_prior, strict=True):
        edges = ndtr(((LEVEL[1:] + LEVEL[:-1]) / 2 - levels[:, None]) / scatter)
        mass = np.diff(np.pad(edges, ((0, 0), (1, 1)), constant_values=((0, 0), (0, 1))), axis=1)
        log_mass = np.log(np.maximum(mass, 1e-300))
        of_clean, of_logs = (
            np.sum([np.logaddexp.reduce(log_mass + log.log_likelihood, axis=1) for log in group], axis=0)
            for group in (clean, logs)
        )
        good.append(prior + np.logaddexp.reduce(of_clean + of_logs))
        higher = np.array([np.interp(levels + by, levels, of_logs) for by in RAISED])
        raised.append(prior + np.logaddexp.reduce(of_clean + higher + rise[:, None], axis=None))
    return float(np.logaddexp.reduce(raised) - np.logaddexp.reduce(good))


def noise_of(seen: Linearised) -> list[dict[str, Found]]:
    """Return the noise of each kind in each log, by all its residuals; none of the reference in a log without one, nor
    of turning where no motor steers.

    Wheels that effects drive against each other creep by `UNEVEN` more or less than predicted: that is no noise.
    """
    found = []
    for design, caused in zip(seen.designs, seen.caused, strict=True):
        noise = replace(seen.noise, **{kind: max(getattr(seen.noise, kind), RESOLVED) for kind in KINDS})
        reduced = _reduced(design, seen.shared.mount, noise, PROBES)
        _, _, left = reduced.finish(np.zeros((len(reduced.information), 1 + PROBES)))
        by_kind = {kind: (left.squares.get(kind, 0.0), left.expected.get(kind, 0.0)) for kind in KINDS}
        of_log = {k: Found(getattr(noise, k) ** 2 * s / max(free, 1e-9), free) for k, (s, free) in by_kind.items()}
        for kind in CONTACTS:
            way, rows = _way(design, kind)
            doubt = UNEVEN**2 * float(np.sum(caused[:, rows] ** 2)) / max(float(np.sum(way)), 1e-9)
            of_log[kind] = Found(max(of_log[kind].variance - doubt, 0.0), of_log[kind].freedom)
        found.append(of_log)
    return found


def _reduced(design: DesignMatrix, mount: Array, noise: Noise, probes: int = 0) -> Reduced:
    """Return a log's statistics with nothing unknown but its states and clock."""
    unchanged = stacked(design.geometry, [])
    return design.model.reduce(
        design.geometry, unchanged, np.zeros(0), design.state, design.clock, mount, noise, probes
    )


def _way(design: DesignMatrix, kind: str) -> tuple[Array, NDArray[np.bool_]]:
    """Return the way of each contact in each step (K - 1, rows), 0 of those whose slips are not of this kind; and which
    are."""
    rows = (design.model.rows < len(design.geometry.radius)) == (kind == "along")
    return np.abs(design.model.rolled(design.geometry, design.state)) * rows, rows


def _pooled(logs: Sequence[Found]) -> float:
    """Return the variance of several logs together."""
    freedom = sum(log.freedom for log in logs)
    return sum(log.freedom * log.variance for log in logs) / max(freedom, 1e-9)


def _cost(seen: Linearised, kind: str, variance: float) -> Array:
    """Return the rms odometry error (2,) by slip noise of a variance: m after 10 m, rad after a turn; of the reference
    the noise itself, m and rad, by which odometry seems to be off."""
    if kind in REFERENCE:
        return np.sqrt(variance) * (np.array(REFERENCE) == kind)
    random, slipped = np.random.default_rng(0), []
    for design in seen.designs:
        if kind == "turning":
            way = np.abs(design.model.turned(design.geometry, design.state))
        else:
            way, _ = _way(design, kind)
        slipped.append(random.normal(size=(*way.shape, PROBES)) * np.sqrt(variance * way)[..., None])
    return seen.cost_of_slips(slipped)
