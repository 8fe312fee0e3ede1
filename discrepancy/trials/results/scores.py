"""Scores of a trial: how often the finder is right, and whether its probabilities are calibrated.

Every rate is a count with its 95 % Wilson interval, over all cases, over those of each preset, and over those with and
without clean logs and reference. Effects that no log can distinguish count as the same class, and so do effects that
the finder says are the same on the vehicle. Probabilities are calibrated if of names with probability p a part p is
right: the reliability diagram shows this, and the expected calibration error is the mean deviation from it.
"""

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.posterior.calibrated import CREDIBLE
from discrepancy.posterior.verdicts import MATERIAL
from discrepancy.trials.folder import FINDER, asked_of, judged
from discrepancy.trials.said import QUIET

FORMAT = "castor-trial/3"

MATTERS, COSTLY, SEPARATE, STRONG, STRONG_OUTSIDE = MATERIAL.position, 2e-3, 5.0, 8.0, 20.0
"""m per 10 m from which on a cost matters to a user; m per 10 m, z_sep and z from which on an effect should be named; z
from which on an effect outside the catalogue should be flagged."""

ALIKE = 1.0
"""z_sep below which no log can distinguish an effect from the nearest class."""

LEAST_REPORTED = 1 - CREDIBLE
"""Least probability of a name that counts in the reliability diagram: a credible set omits no more."""

EDGES = (LEAST_REPORTED, 0.2, 0.4, 0.6, 0.8, 0.9, CREDIBLE, 0.99, 1.0)
"""Edges of the bins of probability, narrow near 1."""


@dataclass(frozen=True)
class Trial:
    """A judged case: its label (the hidden effects) and its outcome (the finder's answer)."""

    label: dict[str, Any]
    outcome: dict[str, Any]

    @property
    def verdict(self) -> str:
        """The verdict of the whole."""
        return self.outcome["verdict"]

    @property
    def truth(self) -> frozenset[str]:
        """The classes of the hidden effects."""
        return frozenset(hidden["class"] for hidden in self.label["hidden"])

    @property
    def alike(self) -> dict[str, str]:
        """Classes that this log cannot distinguish from a hidden effect, or that the finder says are the same on this
        vehicle, each with the class of that effect."""
        log: dict[str, Any] = self.label["log"] or {"z_sep": [], "nearest": []}
        hidden_effects = zip(self.label["hidden"], log["z_sep"], log["nearest"], strict=False)  # wiring has no strength
        alike = {nearest: hidden["class"] for hidden, z_sep, nearest in hidden_effects if z_sep < ALIKE and nearest}
        same_as: dict[str, list[str]] = self.outcome.get("same_as", {})
        told = {name: other for name, same in same_as.items() if name not in self.truth for other in same}
        return alike | {name: other for name, other in told.items() if other in self.truth}

    @property
    def named(self) -> frozenset[str]:
        """The classes that the finder named."""
        named: Iterable[str] = self.outcome["named"]
        return frozenset(self.alike.get(name, name) for name in named)

    @property
    def credible(self) -> frozenset[str]:
        """The classes in all its credible sets."""
        sets: Iterable[Iterable[str]] = self.outcome["credible"]
        return frozenset(self.alike.get(name, name) for names in sets for name in names)

    def exact(self) -> bool:
        """Whether it names exactly the hidden effects, and the verdict of the whole is "named"."""
        return self.verdict == "named" and self.named == self.truth

    def among(self) -> bool:
        """Whether all hidden effects are in its credible sets."""
        return self.truth <= self.credible

    def wrong(self) -> bool:
        """Whether it names an effect that was not hidden (a false positive)."""
        return bool(self.named - self.truth)

    def costly_name(self) -> bool:
        """Whether it names an effect that costs over `MATTERS`; wiring, which has no size, counts as costly."""
        sized = {size["class"]: size["cost"] for size in self.outcome["sizes"]}
        return any((sized.get(name) or math.inf) > MATTERS for name in self.named)

    def least(self, key: str, log: str = "log") -> float:
        """Return the least cost, z or z_sep of the hidden effects; infinite if there are none, or it is not known."""
        return min(self.label[log][key], default=math.inf) if self.label[log] else math.inf

    def plain(self) -> bool:
        """Whether the hidden effects are costly and separate enough to be named, and the held-out log can confirm
        them."""
        confirmed = self.least("z", "holdout") >= SEPARATE
        return self.least("cost") >= COSTLY and self.least("z_sep") >= SEPARATE and confirmed

    def strong(self) -> bool:
        """Whether the hidden effects, whatever they cost, are strong in both logs, and separate."""
        return min(self.least("z"), self.least("z", "holdout")) >= STRONG and self.least("z_sep") >= SEPARATE

    def to_be_flagged(self) -> bool:
        """Whether what is hidden, outside the catalogue, costs and shows enough to be flagged."""
        return self.least("cost") >= MATTERS and self.least("z") >= STRONG_OUTSIDE

    def flagged(self) -> bool:
        """Whether the answer says that something outside the catalogue is there."""
        return self.verdict == "unexplained" or bool(self.outcome["unnamed"])

    def broke_down(self) -> bool:
        """Whether there is no answer."""
        return self.verdict == "broken"

    def alarmed(self) -> bool:
        """Whether the answer is that something that matters is missing."""
        return self.verdict not in (*QUIET, "broken")

    def has_gaps(self) -> bool:
        """Whether there is a held-out gap before and after: something is named."""
        return self.outcome["gap"] is not None

    def gap_grew(self, tolerance: float = 0.0) -> bool:
        """Whether the held-out gap is larger after than before, by more than this, m per 10 m."""
        return self.has_gaps() and self.outcome["gap"]["after"] > self.outcome["gap"]["before"] + tolerance

    def gap_grew_by_what_matters(self) -> bool:
        """Whether the held-out gap is larger, by more than the 95 % errors of the named sizes cost, too."""
        return self.has_gaps() and self.gap_grew(max(MATTERS, self.cost_of_errors()))

    def cost_of_errors(self) -> float:
        """Return what the 95 % errors of the named sizes cost together, m per 10 m."""
        return math.hypot(
            *(
                (size["high"] - size["low"]) / 2 * size["cost"] / abs(size["effect"]["value"])
                for size in self.outcome["sizes"]
                if size["low"] is not None and size["cost"]
            )
        )

    def reported(self) -> list[tuple[float, bool]]:
        """Return the probability of every reported class, and whether it was hidden.

        Empty for wrong wiring, which the pre-flight reports without probabilities.
        """
        classes = self.outcome["probabilities"].items() if self.label["stratum"] != "wiring" else ()
        return [
            (probability, self.alike.get(name, name) in self.truth)
            for name, probability in classes
            if probability >= LEAST_REPORTED
        ]

    def covered(self) -> list[bool]:
        """Return for every rightly named effect with an interval whether its true size lies within it."""
        true = {hidden["class"]: hidden["what"] for hidden in self.label["hidden"] if hidden["from"] == "catalogue"}
        return [
            found["low"] <= size_as(true[found["class"]], found["effect"]) <= found["high"]
            for found in self.outcome["sizes"]
            if found["class"] in true and found["low"] is not None
        ]


def rate(statement: str, hits: Iterable[bool]) -> dict[str, Any]:
    """Return a statement (`what`) with the `count` of hits of a `total`, the 95 % Wilson interval `low` to `high`, and
    the `share`; None of nothing."""
    results = list(hits)
    count, total = sum(results), len(results)
    low, high = wilson(count, total)
    share = count / total if total else None
    return {"what": statement, "count": count, "total": total, "low": low, "high": high, "share": share}


PLAIN = f"{1e3 * COSTLY:g} mm per 10 m and z_sep {SEPARATE:g} or more"
MATTERING = f"{1e3 * MATTERS:g} mm per 10 m"

RATES: Sequence[tuple[str, str, Callable[[Trial], bool] | None, Callable[[Trial], bool]]] = (
    ("clean: any alarm", "clean", None, Trial.alarmed),
    ("clean: a sure name", "clean", None, Trial.wrong),
    (
        f"clean, no clean logs given: a sure name that costs over {MATTERING}",
        "clean",
        lambda case: not case.label["clean"],
        Trial.costly_name,
    ),
    (f"one effect, {PLAIN}: named exactly", "one", Trial.plain, Trial.exact),
    ("  the truth in the credible set", "one", Trial.plain, Trial.among),
    ("  a sure name that is wrong", "one", Trial.plain, Trial.wrong),
    (
        f"one effect of any cost, z {STRONG:g} and z_sep {SEPARATE:g} or more: named exactly",
        "one",
        Trial.strong,
        Trial.exact,
    ),
    (f"two effects, each {PLAIN}: named exactly", "two", Trial.plain, Trial.exact),
    ("  the truth in the credible sets", "two", Trial.plain, Trial.among),
    (f"three effects, each {PLAIN}: named exactly", "three", Trial.plain, Trial.exact),
    ("  the truth in the credible sets", "three", Trial.plain, Trial.among),
    (
        f"outside the catalogue, {MATTERING} and z {STRONG_OUTSIDE:g} or more: flagged",
        "outside",
        Trial.to_be_flagged,
        Trial.flagged,
    ),
    ("outside the catalogue: a sure name", "outside", None, Trial.wrong),
    (f"poor motion, {PLAIN}: named exactly", "poor", Trial.plain, Trial.exact),
    ("poor motion: a sure name that is wrong", "poor", None, Trial.wrong),
    ("all but wiring: a sure name that is wrong", "", lambda case: case.label["stratum"] != "wiring", Trial.wrong),
    ("wiring: named, or refused with a reason", "wiring", None, lambda case: case.exact() or case.verdict == "refused"),
    ("something named: the held-out gap is larger after than before", "", Trial.has_gaps, Trial.gap_grew),
    (
        f"  by more than {MATTERING}, and than the 95 % errors of the named sizes cost",
        "",
        Trial.has_gaps,
        Trial.gap_grew_by_what_matters,
    ),
    ("the finder broke down", "", None, Trial.broke_down),
)
"""Rates to report: a statement; stratum ("": all) and condition (None: none) of the cases that are counted; and what is
a hit."""

COVERED = "95 % intervals of sizes named rightly: the true size within"


def wilson(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a share; (0, 1) for no cases."""
    if not total:
        return 0.0, 1.0
    from scipy.stats import binomtest  # slow to import

    interval = binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def rates(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Return all rates over these cases."""
    found = []
    for statement, stratum, condition, hit in RATES:
        counted = [trial for trial in trials if stratum in ("", trial.label["stratum"])]
        counted = [trial for trial in counted if condition is None or condition(trial)]
        found.append(rate(statement, map(hit, counted)))
    return [*found, rate(COVERED, (inside for trial in trials for inside in trial.covered()))]


def reliability(reported: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Return for each non-empty bin of probability the number of names, their mean probability, and how many are
    right."""
    bins = []
    place = np.clip(np.searchsorted(EDGES, [part for part, _ in reported], side="right") - 1, 0, len(EDGES) - 2)
    for k in np.unique(place).tolist():
        inside = [entry for entry, where in zip(reported, place, strict=True) if where == k]
        found = rate(f"{EDGES[k]:g} to {EDGES[k + 1]:g}", (right for _, right in inside))
        bins.append(found | {"probability": float(np.mean([part for part, _ in inside]))})
    return bins


def calibration_error(bins: Sequence[dict[str, Any]]) -> float | None:
    """Return the expected calibration error: the mean difference over names between probability and the part that is
    right; None without names."""
    total = sum(entry["total"] for entry in bins)
    off = sum(entry["total"] * abs(entry["probability"] - entry["share"]) for entry in bins)
    return off / total if total else None


def size_as(true: dict[str, Any], found: dict[str, Any]) -> float:
    """Return the size of a true effect, expressed as the effect found, of the same class.

    A radius larger by a is equivalent to counts per turn fewer by a / (1 + a). Of a periodic effect only the part in
    the phase found counts.
    """
    size = true["value"]
    if {true["name"], found["name"]} == {"wheel_radius", "counts_per_rev"}:
        size = -size / (1.0 + size)
    if "phase" in true and "phase" in found:
        size *= math.cos(true["phase"] - found["phase"])
    return size


def confusion(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    """Return the confusion matrix: hidden against named effects, without places, as counts of cases.

    Columns: names, several as "a + b"; "another place" for the right name at a wrong place; the verdict where no effect
    is named.
    """
    table: dict[str, Counter[str]] = {}
    for trial in trials:
        truth = " + ".join(sorted(name.split()[0] for name in trial.truth)) or "clean"
        answer = " + ".join(sorted(name.split()[0] for name in trial.named)) or trial.outcome["verdict"]
        if answer == truth and trial.named != trial.truth:
            answer += ", another place"
        table.setdefault(truth, Counter())[answer] += 1
    return {truth: dict(sorted(row.items())) for truth, row in sorted(table.items())}


GROUPS = (
    ("robot", str),
    ("clean", {True: "clean logs given", False: "no clean logs given"}.get),
    ("reference", {True: "with a reference", False: "without a reference"}.get),
    ("drive", {"yielding": "wheels that yield to each other", "held": "wheels held at speed"}.get),
)
"""What groups cases, as labels have it, and what a group is called."""


def trials_of(folder: str | os.PathLike[str]) -> list[Trial]:
    """Return the judged cases of a trial; raises InputError if there are none."""
    return [Trial(*case) for case in judged(folder)]


def report(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return all scores of a trial as plain data."""
    plan, trials = asked_of(folder), trials_of(folder)
    groups: dict[str, list[Trial]] = {}
    for key, called in GROUPS:
        for trial in trials:
            if key in trial.label:
                groups.setdefault(str(called(trial.label[key])), []).append(trial)
    return {
        "format": FORMAT,
        "plan": plan,
        "finder": FINDER,
        "judged": len(trials),
        "all": _scores(trials),
        "groups": {name: _scores(group) for name, group in groups.items()},
        "confusion": confusion(trials),
    }


def lines(scores: dict[str, Any]) -> list[str]:
    """Return the scores of `report` as text."""
    plan = scores["plan"]
    done = f"{scores['judged']} of {plan['cases']} cases, generator {plan['generator']}, seed {plan['seed']}"
    text = [f"{done}, finder {scores['finder']}, {len(plan['robots'])} robots"]
    parts = {name: group for name, group in scores["groups"].items() if group["cases"] < scores["judged"]}
    for name, group in {"all": scores["all"], **parts}.items():
        seconds = group["seconds"]
        each = f"{seconds['make']:.1f} s to make and {seconds['judge']:.1f} s to judge each"
        text += ["", f"{name}: {group['cases']} cases, {each}"]
        text += [_counted(row) for row in group["rates"] if row["total"] or name == "all"]
        if group["reliability"]:
            text.append("reported probability against the part that is right, of names:")
        text += [f"{_counted(entry)}, mean {entry['probability']:.3f}" for entry in group["reliability"]]
        if group["calibration_error"] is not None:
            text.append(f"expected calibration error {group['calibration_error']:.3f}")
    text += ["", "Hidden -> answered:"]
    for truth, row in scores["confusion"].items():
        text.append(f"{truth}: " + ", ".join(f"{answer} {count}" for answer, count in row.items()))
    return text


def _scores(trials: Sequence[Trial]) -> dict[str, Any]:
    bins = reliability([entry for trial in trials for entry in trial.reported()])
    return {
        "cases": len(trials),
        "rates": rates(trials),
        "reliability": bins,
        "calibration_error": calibration_error(bins),
        "seconds": {
            "make": float(np.mean([trial.label["seconds"] for trial in trials])),
            "judge": float(np.mean([trial.outcome["seconds"] for trial in trials])),
        },
    }


def _counted(row: dict[str, Any]) -> str:
    """Return a rate as text."""
    share = "   -  " if row["share"] is None else f"{100 * row['share']:5.1f} %"
    ends = f"{100 * row['low']:.1f} to {100 * row['high']:.1f}"
    return f"{share} ({row['count']:3d}/{row['total']:3d}, {ends})  {row['what']}"
