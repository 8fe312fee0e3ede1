"""Posterior of a sum of single effects: which hypotheses hold, and with which sizes, given information and score.

The log-likelihood of b (m,) is ``score . b - b . information b / 2``. b is a sum of a few single effects, each of which
is one hypothesis of many, or nothing (SuSiE: Wang, Sarkar, Carbonetto and Stephens, J. R. Stat. Soc. B 2020). The prior
of a size is a Cauchy distribution about 0, truncated at its bounds. The posterior is found one component at a time
given the other components (iterative Bayesian stepwise selection), from several starts; the result with the largest
evidence lower bound is returned. Components are taken for independent; for the interval of a size, those of the other
components are integrated out, as intervals of correlated effects would be too narrow.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
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
        """Return the smallest set of names that together have the probability `CREDIBLE` in a component, given that
        there is an effect; empty if "nothing" has a probability above 1 - `CREDIBLE`."""
        if component.nothing > 1 - CREDIBLE:
            return ()
        left, names = CREDIBLE * (1 - component.nothing), []
        for name, probability in self.probabilities(component).items():
            names.append(name)
            left -= probability
            if left <= 0:
                break
        return tuple(names)


class SingleEffects:
    """Hypotheses and an information matrix, with all quantities that stay the same while a posterior is computed."""

    def __init__(self, hypotheses: Sequence[Hypothesis], information: Array) -> None:
        """information (m, m), positive semidefinite."""
        self.hypotheses, self.information = tuple(hypotheses), information
        h, m = len(self.hypotheses), len(information)
        sizes = np.array([hypothesis.direction.shape[1] for hypothesis in self.hypotheses], dtype=np.intp)
        self._most_sizes, self._several = int(sizes.max(initial=1)), sizes > 1
        self._rays = np.zeros((h * self._most_sizes, m))
        for k, hypothesis in enumerate(self.hypotheses):
            self._rays[self._most_sizes * k :][: sizes[k]] = hypothesis.direction.T
        self._seen = self._blocks(self._rays @ information, self._rays)
        self._axes = self._axes_of(self._seen)
        numbers = np.array(
            [(hypothesis.scale, hypothesis.prior, hypothesis.least, hypothesis.most) for hypothesis in self.hypotheses]
        ).reshape(h, 4)
        self._log_prior = np.log(numbers[:, 1] / numbers[:, 1].sum()) + np.log1p(-NOTHING)
        ends = ((numbers[:, 2], -np.inf), (numbers[:, 3], np.inf))
        self._least, self._most = (np.where(self._several, free, end) for end, free in ends)
        self._precision = (numbers[:, :1] * SCALES)[:, :, None] ** -2.0  # (h, scales, 1)
        self._bounded = np.isfinite(self._least) | np.isfinite(self._most)
        cuts = (end[self._bounded, None] / (numbers[self._bounded, :1] * SCALES) for end in (self._least, self._most))
        self._log_allowed = np.logaddexp.reduce(LOG_WEIGHTS + _cut(*cuts)[0], axis=1)  # mass of the prior within bounds

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
        turned, _, mixture, mean, variance = self._given(score, others)
        weight = np.exp(mixture[k])[:, None]
        average = np.sum(weight * mean[k], axis=0)
        spread = np.sum(weight * (variance[k] + (mean[k] - average) ** 2), axis=0)
        c = self.hypotheses[k].direction.shape[1]
        return (turned[k] @ average)[:c], ((turned[k] * spread) @ turned[k].T)[:c, :c]

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
        turned, log_factor, mixture, mean, variance = self._given(score)
        log_each = self._log_prior + log_factor
        log_evidence = float(np.logaddexp.reduce(np.append(log_each, np.log(NOTHING))))
        probability = np.exp(log_each - log_evidence)
        weight = probability[:, None, None] * np.exp(mixture)[:, :, None]
        along = np.einsum("hij,hkj->hi", turned, weight * mean)
        squares = np.einsum("hki,hkj->hij", weight * mean, mean)
        each = np.arange(self._most_sizes)
        squares[:, each, each] += np.sum(weight * variance, axis=1)
        squares = turned @ squares @ np.swapaxes(turned, 1, 2)
        expected, square = along.ravel() @ self._rays, float(np.sum(self._seen * squares))
        divergence = float(score @ expected) - square / 2 - log_evidence
        return Component(float(np.exp(np.log(NOTHING) - log_evidence)), probability, expected, square, divergence)

    def _beside(self, score: Array, others: Sequence[Component]) -> tuple[Array, Array]:
        """Return information (h, c, c) and score (h, c) of the sizes of every hypothesis beside other components.

        Components that are more likely there than not keep what they are, but their sizes are integrated out: the size
        of a component and those of others are correlated. Of the others the mean is subtracted.
        """
        there = [component for component in others if component.nothing < 0.5 and np.any(component.mean)]
        score = score - self.information @ sum((o.mean for o in others if o not in there), np.zeros(len(score)))
        slope, seen = (self._rays @ score).reshape(-1, self._most_sizes), self._seen
        if there:
            free = np.concatenate([self._free(component) for component in there])
            by_free = free @ self.information
            solve = pseudo_inverse(by_free @ free.T)
            crossed = self._rays @ by_free.T
            slope = slope - (crossed @ (solve @ (free @ score))).reshape(slope.shape)
            seen = seen - self._blocks(crossed @ solve, crossed)
        return seen, slope

    def _axes_of(self, seen: Array) -> tuple[Array, Array]:
        """Return the strengths (h, c) and the principal axes (h, c, c) of the information (h, c, c) on sizes."""
        turned = np.tile(np.eye(self._most_sizes), (len(seen), 1, 1))
        strength = np.diagonal(seen, axis1=1, axis2=2).copy()
        strength[self._several], turned[self._several] = np.linalg.eigh(seen[self._several])
        return np.maximum(strength, 0.0), turned

    def _blocks(self, left: Array, right: Array) -> Array:
        """Return for each hypothesis the products (h, c, c) of its c rows of two arrays (h c, m)."""
        rows = (part.reshape(-1, self._most_sizes, part.shape[1]) for part in (left, right))
        return np.einsum("him,hjm->hij", *rows, optimize=True)

    def _free(self, component: Component) -> Array:
        """Return the contributions to b (sizes, m) that a component may have in any multiple."""
        k = int(np.argmax(component.probability))
        if not self._several[k]:
            return component.mean[None]
        return self.hypotheses[k].direction.T * np.linalg.norm(component.mean)

    def _given(self, score: Array, others: Sequence[Component] = ()) -> tuple[Array, Array, Array, Array, Array]:
        """Return for every hypothesis, beside other components of any size, the principal axes of its sizes (h, c, c),
        the log Bayes factor (h,) against nothing, the log probabilities (h, scales) of the normal distributions in its
        prior's mixture, and means and variances (h, scales, c) along the axes."""
        seen, slope = self._beside(score, others)
        strength, turned = self._axes if seen is self._seen else self._axes_of(seen)
        variance = 1 / (strength[:, None, :] + self._precision)
        slope = np.einsum("hij,hi->hj", turned, slope)[:, None, :]
        mean = slope * variance
        log_factor = np.sum(slope * mean / 2 + np.log(variance * self._precision) / 2, axis=-1)
        bounded = self._bounded
        if bounded.any():
            lower, upper = self._least[bounded, None], self._most[bounded, None]
            middle, width = mean[bounded, :, 0], np.sqrt(variance[bounded, :, 0])
            log_mass, moved, narrowed = _cut((lower - middle) / width, (upper - middle) / width)
            log_factor[bounded] += log_mass - self._log_allowed[:, None]
            mean[bounded, :, 0], variance[bounded, :, 0] = middle + width * moved, width**2 * narrowed
        joint: Array = LOG_WEIGHTS + log_factor
        total: Array = np.logaddexp.reduce(joint, axis=1)
        return turned, total, joint - total[:, None], mean, variance

    def _pairs(self, score: Array) -> list[tuple[Component, Component]]:
        """Return the pairs of hypotheses with the largest joint log-likelihood ratio, as components to start from."""
        strength = self._seen[:, 0, 0]
        single = ~self._several & (strength > 0)
        best: dict[str, int] = {}
        slope = (self._rays @ score)[:: self._most_sizes] / np.sqrt(np.where(strength > 0, strength, 1.0))
        for k in np.flatnonzero(single).tolist():
            name = self.hypotheses[k].name
            if name not in best or abs(slope[k]) > abs(slope[best[name]]):
                best[name] = k
        chosen = np.array(list(best.values()), dtype=np.intp)
        if len(chosen) < 2:
            return []
        rays = self._rays[self._most_sizes * chosen] / np.sqrt(strength[chosen])[:, None]
        cosine, slopes = np.clip(rays @ self.information @ rays.T, -1.0, 1.0), slope[chosen]
        sine = np.where(1 - cosine**2 > PARALLEL, 1 - cosine**2, np.inf)
        gain = np.triu((slopes[:, None] ** 2 + slopes**2 - 2 * cosine * np.outer(slopes, slopes)) / sine, 1)
        best_pairs = [at for at in np.argsort(-gain, axis=None)[:PAIRS].tolist() if gain.flat[at] > 0]
        return [self._pair(score, *chosen[list(divmod(at, len(chosen)))].tolist()) for at in best_pairs]

    def _pair(self, score: Array, first: int, second: int) -> tuple[Component, Component]:
        """Return components that are these two hypotheses with certainty, with maximum-likelihood sizes."""
        rays = self._rays[[self._most_sizes * first, self._most_sizes * second]]
        sizes = least_squares(rays @ self.information @ rays.T, rays @ score)
        pair = []
        for k, ray, size in zip((first, second), rays, sizes.tolist(), strict=True):
            surely = np.zeros(len(self.hypotheses))
            surely[k] = 1.0
            pair.append(Component(0.0, surely, size * ray, size**2 * float(self._seen[k, 0, 0]), 0.0))
        return pair[0], pair[1]


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
