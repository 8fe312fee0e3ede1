"""Posterior of a sum of single effects: which hypotheses hold, and with which sizes, given information and score.

The log-likelihood of b (m,) is ``score . b - b . information b / 2``. b is a sum of a few single effects, each of which
is one hypothesis of many, or nothing (SuSiE: Wang, Sarkar, Carbonetto and Stephens, J. R. Stat. Soc. B 2020). The prior
of a size is a Cauchy distribution about 0, truncated at its bounds. The posterior is found one component at a time
given the other components (iterative Bayesian stepwise selection), from several starts; the result with the largest
evidence lower bound is returned. Components are taken for independent; for the interval of a size, those of the other
components are integrated out, as intervals of correlated effects would be too narrow.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from castor_envs.geometry.arrays import Array
from discrepancy.posterior.calibrated import CREDIBLE, MOST, NOTHING
from estimators.likelihood.statistics import least_squares, pseudo_inverse

SCALES = 2.0 ** np.arange(-1, 11)
LOG_WEIGHTS: Array = -np.log(SCALES) - SCALES**-2 / 2
LOG_WEIGHTS = LOG_WEIGHTS - np.logaddexp.reduce(LOG_WEIGHTS)
"""A Cauchy distribution of scale 1 is a mixture of normal distributions whose standard deviations s have the density
exp(-1 / (2 s^2)) / s^2; this discrete mixture approximates its density within 1.1 % up to 100, and 5 % up to 500."""

ROUNDS, CONVERGED = 200, 1e-4
"""Most rounds over all components, and the change of probabilities below which the rounds end."""

COMPETE = 5
"""Rounds after which only the start with the largest evidence lower bound goes on."""

PARALLEL = 1e-4
"""Squared sine of the angle between two signatures up to which they are taken for parallel, and not paired."""

PAIRS = 3
"""Number of best pairs of hypotheses that serve as further starts: two effects together may look most like a third,
which the start from nothing would select."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A hypothesis: an effect that may be present.

    name: hypotheses of one name are one answer. direction (m, c): change of b per unit of each of its c sizes.
    scale: median of the absolute size before logs are seen. prior: relative prior probability among the hypotheses.
    least, most: bounds of a single size.
    """

    name: str
    direction: Array
    scale: float
    prior: float
    least: float = -np.inf
    most: float = np.inf


@dataclass(frozen=True, eq=False)
class Component:
    """Posterior of one single effect.

    nothing: probability that it is absent. probability (h,): of each hypothesis. mean (m,): expected contribution to b;
    square: expected ``b . information b`` of this contribution. divergence: Kullback-Leibler divergence from the prior.
    """

    nothing: float
    probability: Array
    mean: Array
    square: float
    divergence: float


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of all components. bound: evidence lower bound, by which results of several starts are compared."""

    hypotheses: tuple[Hypothesis, ...]
    components: tuple[Component, ...]
    bound: float

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all possible answers."""
        return tuple(dict.fromkeys(hypothesis.name for hypothesis in self.hypotheses))

    def probabilities(self, component: Component) -> dict[str, float]:
        """Return the probability of every name in a component, the largest first."""
        found: dict[str, float] = {}
        for hypothesis, probability in zip(self.hypotheses, component.probability.tolist(), strict=True):
            found[hypothesis.name] = found.get(hypothesis.name, 0.0) + probability
        return {name: min(part, 1.0) for name, part in sorted(found.items(), key=lambda entry: -entry[1])}

    def inclusion(self) -> dict[str, float]:
        """Return for every name the probability that it is among the effects, the largest first."""
        absent: dict[str, float] = {}
        for component in self.components:
            for name, probability in self.probabilities(component).items():
                absent[name] = absent.get(name, 1.0) * (1 - probability)
        return dict(sorted(((name, 1 - part) for name, part in absent.items()), key=lambda entry: -entry[1]))

    def credible_set(self, component: Component) -> tuple[str, ...]:
        """Return the `credible` names of a component, given that there is an effect; empty if "nothing" has a
        probability above 1 - `CREDIBLE`."""
        if component.nothing > 1 - CREDIBLE:
            return ()
        return credible(self.probabilities(component))


def credible(probabilities: Mapping[str, float]) -> tuple[str, ...]:
    """Return the smallest set of names that together have `CREDIBLE` of the probability of all, the likeliest first."""
    names = sorted(probabilities, key=lambda name: -probabilities[name])
    part = np.cumsum([probabilities[name] for name in names])
    return tuple(names[: 1 + int(np.searchsorted(part, CREDIBLE * part[-1]))])


class _Group(NamedTuple):
    """The hypotheses of c sizes each, n of them: their numbers `of` (n,), and those of their sizes among all (n, c).

    seen (n, c, c): information on the sizes. axes: from `_axes_of`. precision (n, scales, 1): of the normal
    distributions in the prior's mixture.
    """

    of: NDArray[np.intp]
    sizes: NDArray[np.intp]
    seen: Array
    axes: tuple[Array, Array]
    precision: Array


class _Given(NamedTuple):
    """Of the hypotheses of a group, beside other components: the principal axes of the sizes (n, c, c), the log Bayes
    factor (n,) against nothing, the log probabilities (n, scales) of the normal distributions in the prior's mixture,
    and means and variances (n, scales, c) along the axes."""

    axes: Array
    log_factor: Array
    mixture: Array
    mean: Array
    variance: Array


class SingleEffects:
    """Hypotheses and an information matrix, with all quantities that stay the same while a posterior is computed."""

    def __init__(self, hypotheses: Sequence[Hypothesis], information: Array) -> None:
        """information (m, m), positive semidefinite."""
        from scipy.sparse import csr_array  # slow to import

        self.hypotheses, self.information = tuple(hypotheses), information
        counts = np.array([hypothesis.direction.shape[1] for hypothesis in self.hypotheses], dtype=np.intp)
        self._count, self._several, self._first = int(counts.sum()), counts > 1, np.cumsum(counts) - counts
        directions = [hypothesis.direction.T for hypothesis in self.hypotheses]
        self._rays = csr_array(np.concatenate([np.zeros((0, len(information))), *directions]))  # 0 but for few numbers
        numbers = np.array(
            [(hypothesis.scale, hypothesis.prior, hypothesis.least, hypothesis.most) for hypothesis in self.hypotheses]
        ).reshape(len(counts), 4)
        self._log_prior = np.log(numbers[:, 1] / numbers[:, 1].sum()) + np.log1p(-NOTHING)
        ends = ((numbers[:, 2], -np.inf), (numbers[:, 3], np.inf))
        self._least, self._most = (np.where(self._several, free, end) for end, free in ends)
        self._bounded = np.isfinite(self._least) | np.isfinite(self._most)
        cuts = (end[self._bounded, None] / (numbers[self._bounded, :1] * SCALES) for end in (self._least, self._most))
        self._log_allowed = np.zeros(len(counts))  # mass of the prior within bounds
        self._log_allowed[self._bounded] = np.logaddexp.reduce(LOG_WEIGHTS + _cut(*cuts)[0], axis=1)
        products = (self._rays @ information) @ self._rays.T
        self._strength = np.diagonal(products)[self._first]  # of each hypothesis's first size
        self._groups = [self._group(count, counts, numbers[:, :1], products) for count in np.unique(counts).tolist()]

    def _group(self, count: int, counts: NDArray[np.intp], scales: Array, products: Array) -> _Group:
        """Return the hypotheses of so many sizes; counts (h,), scales (h, 1): of all; products: information on all
        sizes."""
        of = np.flatnonzero(counts == count)
        sizes = self._first[of, None] + np.arange(count)
        seen = products[sizes[:, :, None], sizes[:, None, :]]
        return _Group(of, sizes, seen, _axes_of(seen), (scales[of] * SCALES)[:, :, None] ** -2.0)

    def posterior(self, score: Array, count: int = MOST) -> Posterior:
        """Return the posterior of a sum of `count` single effects, given the score (m,) at b = 0."""
        empty = Component(1.0, np.zeros(len(self.hypotheses)), np.zeros(len(score)), 0.0, 0.0)
        starts = [(empty,) * count]
        if count > 1:
            starts += [(*pair, *(empty,) * (count - 2)) for pair in self._pairs(score)]
        best = max((self._converged(score, start, COMPETE) for start in starts), key=lambda found: found.bound)
        return self._converged(score, best.components, ROUNDS)

    def sizes(self, score: Array, k: int, others: Sequence[Component]) -> tuple[Array, Array]:
        """Return the sizes (c,) of hypothesis k, given that it is there, and their covariance (c, c), whatever the
        sizes of the other components are."""
        group = next(group for group in self._groups if k in group.of)
        found = self._given(group, *self._beside(score, others))
        n = int(np.searchsorted(group.of, k))
        weight = np.exp(found.mixture[n])[:, None]
        average = np.sum(weight * found.mean[n], axis=0)
        spread = np.sum(weight * (found.variance[n] + (found.mean[n] - average) ** 2), axis=0)
        return found.axes[n] @ average, (found.axes[n] * spread) @ found.axes[n].T

    def _converged(self, score: Array, start: Sequence[Component], rounds: int) -> Posterior:
        found = list(start)
        for _ in range(rounds):
            change = 0.0
            for j in range(len(found)):
                remaining = sum((component.mean for k, component in enumerate(found) if k != j), np.zeros(len(score)))
                new = self._component(score - self.information @ remaining)
                change = max(change, float(np.abs(new.probability - found[j].probability).max(initial=0.0)))
                found[j] = new
            if change < CONVERGED:
                break
        found.sort(key=lambda component: component.nothing)
        return Posterior(self.hypotheses, tuple(found), self._bound(score, found))

    def _bound(self, score: Array, found: Sequence[Component]) -> float:
        """Return the evidence lower bound: the expected log-likelihood less the divergences from the priors."""
        total = sum((component.mean for component in found), np.zeros(len(score)))
        bound = float(score @ total - total @ self.information @ total / 2)
        for component in found:
            variance = component.square - float(component.mean @ self.information @ component.mean)
            bound -= variance / 2 + component.divergence
        return bound

    def _component(self, score: Array) -> Component:
        """Return the posterior of a component, given the score left by the other components."""
        given = [self._given(group, self._rays @ score) for group in self._groups]
        log_factor, along, square = np.zeros(len(self.hypotheses)), np.zeros(self._count), 0.0
        for group, found in zip(self._groups, given, strict=True):
            log_factor[group.of] = found.log_factor
        log_each = self._log_prior + log_factor
        log_evidence = float(np.logaddexp.reduce(np.append(log_each, np.log(NOTHING))))
        probability = np.exp(log_each - log_evidence)
        for group, found in zip(self._groups, given, strict=True):
            weight = probability[group.of][:, None, None] * np.exp(found.mixture)[:, :, None]
            along[group.sizes] = np.einsum("hij,hkj->hi", found.axes, weight * found.mean)
            squares = np.einsum("hki,hkj->hij", weight * found.mean, found.mean)
            each = np.arange(squares.shape[1])
            squares[:, each, each] += np.sum(weight * found.variance, axis=1)
            square += float(np.sum(group.seen * (found.axes @ squares @ np.swapaxes(found.axes, 1, 2))))
        expected = self._rays.T @ along
        divergence = float(score @ expected) - square / 2 - log_evidence
        return Component(float(np.exp(np.log(NOTHING) - log_evidence)), probability, expected, square, divergence)

    def _beside(self, score: Array, others: Sequence[Component]) -> tuple[Array, tuple[Array, Array] | None]:
        """Return the score of all sizes beside other components, and two factors (sizes, free) of what these take of
        the information on sizes; None if they take nothing.

        Components that are more likely there than not keep what they are, but their sizes are integrated out: the size
        of a component and those of others are correlated. Of the others the mean is subtracted.
        """
        there = [component for component in others if component.nothing < 0.5 and np.any(component.mean)]
        score = score - self.information @ sum((o.mean for o in others if o not in there), np.zeros(len(score)))
        slope = self._rays @ score
        if not there:
            return slope, None
        free = np.concatenate([self._free(component) for component in there])
        by_free = free @ self.information
        solve = pseudo_inverse(by_free @ free.T)
        crossed = self._rays @ by_free.T
        return slope - crossed @ (solve @ (free @ score)), (crossed @ solve, crossed)

    def _free(self, component: Component) -> Array:
        """Return the contributions to b (sizes, m) that a component may have in any multiple."""
        k = int(np.argmax(component.probability))
        if not self._several[k]:
            return component.mean[None]
        return self.hypotheses[k].direction.T * np.linalg.norm(component.mean)

    def _given(self, group: _Group, slope: Array, taken: tuple[Array, Array] | None = None) -> _Given:
        """Return what is found of a group's hypotheses, given what `_beside` returns."""
        (strength, turned), of = group.axes, group.of
        if taken is not None:
            left, right = (factor[group.sizes] for factor in taken)
            strength, turned = _axes_of(group.seen - left @ np.swapaxes(right, 1, 2))
        variance = 1 / (strength[:, None, :] + group.precision)
        along = np.einsum("hij,hi->hj", turned, slope[group.sizes])[:, None, :]
        mean = along * variance
        log_factor = np.sum(along * mean / 2 + np.log(variance * group.precision) / 2, axis=-1)
        bounded = self._bounded[of]
        if bounded.any():
            lower, upper = self._least[of][bounded, None], self._most[of][bounded, None]
            middle, width = mean[bounded, :, 0], np.sqrt(variance[bounded, :, 0])
            log_mass, moved, narrowed = _cut((lower - middle) / width, (upper - middle) / width)
            log_factor[bounded] += log_mass - self._log_allowed[of][bounded, None]
            mean[bounded, :, 0], variance[bounded, :, 0] = middle + width * moved, width**2 * narrowed
        joint: Array = LOG_WEIGHTS + log_factor
        total: Array = np.logaddexp.reduce(joint, axis=1)
        return _Given(turned, total, joint - total[:, None], mean, variance)

    def _pairs(self, score: Array) -> list[tuple[Component, Component]]:
        """Return the pairs of hypotheses with the largest joint log-likelihood ratio, as components to start from."""
        strength = self._strength
        single = ~self._several & (strength > 0)
        best: dict[str, int] = {}
        slope = (self._rays @ score)[self._first] / np.sqrt(np.where(strength > 0, strength, 1.0))
        for k in np.flatnonzero(single).tolist():
            name = self.hypotheses[k].name
            if name not in best or abs(slope[k]) > abs(slope[best[name]]):
                best[name] = k
        chosen = np.array(list(best.values()), dtype=np.intp)
        if len(chosen) < 2:
            return []
        rays = self._rays[self._first[chosen]].toarray() / np.sqrt(strength[chosen])[:, None]
        cosine, slopes = np.clip(rays @ self.information @ rays.T, -1.0, 1.0), slope[chosen]
        sine = np.where(1 - cosine**2 > PARALLEL, 1 - cosine**2, np.inf)
        gain = np.triu((slopes[:, None] ** 2 + slopes**2 - 2 * cosine * np.outer(slopes, slopes)) / sine, 1)
        best_pairs = [at for at in np.argsort(-gain, axis=None)[:PAIRS].tolist() if gain.flat[at] > 0]
        return [self._pair(score, *chosen[list(divmod(at, len(chosen)))].tolist()) for at in best_pairs]

    def _pair(self, score: Array, first: int, second: int) -> tuple[Component, Component]:
        """Return components that are these two hypotheses with certainty, with maximum-likelihood sizes."""
        rays = self._rays[self._first[[first, second]]].toarray()
        sizes = least_squares(rays @ self.information @ rays.T, rays @ score)
        pair = []
        for k, ray, size in zip((first, second), rays, sizes.tolist(), strict=True):
            surely = np.zeros(len(self.hypotheses))
            surely[k] = 1.0
            pair.append(Component(0.0, surely, size * ray, size**2 * float(self._strength[k]), 0.0))
        return pair[0], pair[1]


def _axes_of(seen: Array) -> tuple[Array, Array]:
    """Return the strengths (h, c) and the principal axes (h, c, c) of the information (h, c, c) on sizes."""
    strength, turned = (seen[:, 0], np.ones_like(seen)) if seen.shape[1] == 1 else np.linalg.eigh(seen)
    return np.maximum(strength, 0.0), turned


def _cut(low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Return the log mass of a standard normal distribution between two bounds, and its mean and variance there."""
    mirrored = low > 0
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    upper, lower = log_ndtr(high), log_ndtr(low)
    log_mass = upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-300)))
    at_low, at_high = (
        np.exp(-0.5 * np.minimum(end**2, 1e300) - np.log(2 * np.pi) / 2 - log_mass) for end in (low, high)
    )
    mean = at_low - at_high
    finite_low, finite_high = (np.where(np.isfinite(end), end, 0.0) for end in (low, high))
    variance = np.clip(1 + finite_low * at_low - finite_high * at_high - mean**2, 1e-12, 1.0)
    return log_mass, np.where(mirrored, -mean, mean), variance
