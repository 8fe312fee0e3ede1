"""Scores of a trial: how often a finder is right, and whether it knows how sure it is, from what was hidden and said.

Every rate is a count with its 95 % Wilson interval, over all cases, over those of each preset, and over those with and
without clean logs and reference. Effects that no log can distinguish count as the same class. Probabilities are
calibrated where of names told with probability p a part p is right: the reliability diagram shows it, and the expected
calibration error is how far it is off on average.
"""

import dataclasses
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from castor_envs.errors import InputError
from castor_envs.files import read_json
from discrepancy.trials.finders import FINDER, NORMAL, QUIET
from discrepancy.trials.run import Plan, plan_of

__all__ = ["NORMAL", "Rate", "lines", "report", "wilson"]

FORMAT = "castor-trial/3"

MATTERS, COSTLY, SEPARATE, STRONG, LOUD = 1e-3, 2e-3, 5.0, 8.0, 20.0
"""m per 10 m that matter to a user; m per 10 m, z_sep and z of effects that have to be named; z to be flagged at
outside of the catalogue."""

ALIKE = 1.0
"""z_sep below which no log can tell an effect from the one that is nearest."""

TOLD = 0.05
"""Probability from which on a name counts as told: a set of 95 % leaves out no more."""

EDGES = (TOLD, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Of the bins of probability, narrow where names are sure."""


@dataclass(frozen=True)
class Trial:
    """A case after the labels are open: what was hidden in it, and what was said of it."""

    label: dict[str, Any]
    outcome: dict[str, Any]

    @property
    def truth(self) -> frozenset[str]:
        """The classes of what was hidden."""
        return frozenset(hidden["class"] for hidden in self.label["hidden"])

    @property
    def alike(self) -> dict[str, str]:
        """Classes that this robot's log cannot tell from one that was hidden, and that one."""
        log: dict[str, Any] = self.label["log"] or {"z_sep": [], "nearest": []}
        hidden_effects = zip(self.label["hidden"], log["z_sep"], log["nearest"], strict=False)  # wiring has no strength
        return {nearest: hidden["class"] for hidden, z_sep, nearest in hidden_effects if z_sep < ALIKE and nearest}

    @property
    def named(self) -> frozenset[str]:
        """The classes that the finder is sure of."""
        named: Iterable[str] = self.outcome["named"]
        return frozenset(self.alike.get(name, name) for name in named)

    @property
    def credible(self) -> frozenset[str]:
        """The classes in all its credible sets."""
        sets: Iterable[Iterable[str]] = self.outcome["credible"]
        return frozenset(self.alike.get(name, name) for names in sets for name in names)

    @property
    def exact(self) -> bool:
        """Whether it is sure of what was hidden, of nothing else, and says that this is all."""
        return self.outcome["verdict"] == "named" and self.named == self.truth

    @property
    def among(self) -> bool:
        """Whether all that was hidden is in its credible sets."""
        return self.truth <= self.credible

    @property
    def wrong(self) -> bool:
        """Whether it is sure of something that was not hidden."""
        return bool(self.named - self.truth)

    @property
    def alarm(self) -> bool:
        """Whether it says that something is not as described."""
        return self.outcome["verdict"] not in (*QUIET, "broken")

    @property
    def flagged(self) -> bool:
        """Whether it says that nothing it knows may be it."""
        return self.outcome["verdict"] == "unexplained" or self.outcome["unnamed"]

    @property
    def costly_name(self) -> bool:
        """Whether it is sure of something that costs over `MATTERS`; what has no size, as wiring has none, does."""
        sized = {size["class"]: size["cost"] for size in self.outcome["sizes"]}
        return any((sized.get(name) or math.inf) > MATTERS for name in self.named)

    def least(self, key: str, log: str = "log") -> float:
        """Return the least cost, z or z_sep of what was hidden; infinite where there is nothing."""
        return min(self.label[log][key], default=math.inf) if self.label[log] else math.inf

    @property
    def plain(self) -> bool:
        """Whether what was hidden is costly and separate enough to be named, and the held-out log could confirm it."""
        confirmed = self.least("z", "holdout") >= SEPARATE
        return self.least("cost") >= COSTLY and self.least("z_sep") >= SEPARATE and confirmed

    @property
    def strong(self) -> bool:
        """Whether what was hidden, whatever it costs, is strong in both logs, and separate."""
        return min(self.least("z"), self.least("z", "holdout")) >= STRONG and self.least("z_sep") >= SEPARATE

    @property
    def plainly_outside(self) -> bool:
        """Whether what was hidden, and has no name, matters and is loud."""
        return self.least("cost") >= MATTERS and self.least("z") >= LOUD

    @property
    def gap_grew(self) -> bool:
        """Whether what was named made odometry on the held-out log worse."""
        gap = self.outcome["gap"]
        return gap is not None and gap["after"] > gap["before"]

    def told(self) -> list[tuple[float, bool]]:
        """Return the probability of every class that was told, and whether it is there.

        None of wrong wiring: that is for the pre-flight, which tells no probabilities.
        """
        classes = self.outcome["probabilities"].items() if self.label["stratum"] != "wiring" else ()
        return [
            (probability, self.alike.get(name, name) in self.truth)
            for name, probability in classes
            if probability >= TOLD
        ]

    def covered(self) -> list[bool]:
        """Return of every size named rightly, with an interval, whether the true one lies within it."""
        true = {hidden["class"]: hidden["what"] for hidden in self.label["hidden"] if hidden["from"] == "catalogue"}
        return [
            found["low"] <= size_as(true[found["class"]], found["effect"]) <= found["high"]
            for found in self.outcome["sizes"]
            if found["class"] in true and found["low"] is not None
        ]


@dataclass(frozen=True)
class Rate:
    """Of `total`, `count` are so. low, high: the 95 % Wilson interval."""

    what: str
    count: int
    total: int
    low: float
    high: float

    @classmethod
    def of(cls, statement: str, hits: Iterable[bool]) -> "Rate":
        """Return the rate of what is so."""
        results = list(hits)
        return cls(statement, sum(results), len(results), *wilson(sum(results), len(results)))

    @property
    def share(self) -> float:
        """count / total; NaN of none."""
        return self.count / self.total if self.total else math.nan


Which = Callable[[Trial], bool]


def _stratum(*names: str) -> Which:
    return lambda trial: trial.label["stratum"] in names


def _plain(*names: str) -> Which:
    return lambda trial: trial.label["stratum"] in names and trial.plain


ENOUGH = f"{1e3 * COSTLY:g} mm per 10 m and z_sep {SEPARATE:g} or more"

RATES: tuple[tuple[str, Which, Which], ...] = (
    ("clean: any alarm", _stratum("clean"), lambda trial: trial.alarm),
    ("clean: a sure name", _stratum("clean"), lambda trial: trial.wrong),
    (
        f"clean, no clean logs given: a sure name that costs over {1e3 * MATTERS:g} mm per 10 m",
        lambda trial: trial.label["stratum"] == "clean" and not trial.label["clean"],
        lambda trial: trial.costly_name,
    ),
    (f"one effect, {ENOUGH}: named exactly", _plain("one"), lambda trial: trial.exact),
    ("  the truth in the credible set", _plain("one"), lambda trial: trial.among),
    ("  a sure name that is wrong", _plain("one"), lambda trial: trial.wrong),
    (
        f"one effect of any cost, z {STRONG:g} and z_sep {SEPARATE:g} or more: named exactly",
        lambda trial: trial.label["stratum"] == "one" and trial.strong,
        lambda trial: trial.exact,
    ),
    (f"two effects, each {ENOUGH}: named exactly", _plain("two"), lambda trial: trial.exact),
    ("  the truth in the credible sets", _plain("two"), lambda trial: trial.among),
    (f"three effects, each {ENOUGH}: named exactly", _plain("three"), lambda trial: trial.exact),
    ("  the truth in the credible sets", _plain("three"), lambda trial: trial.among),
    (
        f"outside the catalogue, {1e3 * MATTERS:g} mm per 10 m and z {LOUD:g} or more: flagged",
        lambda trial: trial.label["stratum"] == "outside" and trial.plainly_outside,
        lambda trial: trial.flagged,
    ),
    ("outside the catalogue: a sure name", _stratum("outside"), lambda trial: trial.wrong),
    (f"poor motion, {ENOUGH}: named exactly", _plain("poor"), lambda trial: trial.exact),
    ("poor motion: a sure name that is wrong", _stratum("poor"), lambda trial: trial.wrong),
    (
        "wiring: named, or refused with a reason",
        _stratum("wiring"),
        lambda trial: trial.exact or trial.outcome["verdict"] == "refused",
    ),
    (
        "something named: the held-out gap is larger after than before",
        lambda trial: trial.outcome["gap"] is not None,
        lambda trial: trial.gap_grew,
    ),
    ("the finder broke down", lambda trial: True, lambda trial: trial.outcome["verdict"] == "broken"),
)
"""What is asked of a finder: of which cases, and what counts."""

COVERED = "95 % intervals of sizes named rightly: the true size within"


def wilson(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a share; (0, 1) of no cases."""
    if not total:
        return 0.0, 1.0
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def trials_of(folder: str | os.PathLike[str], finder: str) -> list[Trial]:
    """Return all cases of a trial of which a finder has spoken; raises InputError if there are none."""
    folder = Path(folder)
    paths = sorted((folder / "outcomes" / finder).glob("case-*.json"))
    if not paths:
        raise InputError(f"{folder}: finder {finder} has said nothing yet; judge the cases first")
    return [Trial(read_json(folder / "labels" / path.name), read_json(path)) for path in paths]


def rates(trials: Sequence[Trial]) -> list[Rate]:
    """Return all rates of some cases."""
    found = [Rate.of(statement, (so(trial) for trial in trials if among(trial))) for statement, among, so in RATES]
    return [*found, Rate.of(COVERED, (inside for trial in trials for inside in trial.covered()))]


def reliability(told: Sequence[tuple[float, bool]]) -> list[dict[str, Any]]:
    """Return of each bin of probability that holds names how many, their mean probability, and how many are right."""
    bins = []
    probability = np.array([part for part, _ in told])
    place = np.clip(np.searchsorted(EDGES, probability, side="right") - 1, 0, len(EDGES) - 2)
    for k in range(len(EDGES) - 1):
        inside = np.flatnonzero(place == k).tolist()
        if inside:
            rate = Rate.of(f"{EDGES[k]:g} to {EDGES[k + 1]:g}", (told[n][1] for n in inside))
            bins.append(as_plain(rate) | {"probability": float(probability[inside].mean())})
    return bins


def calibration_error(bins: Sequence[dict[str, Any]]) -> float | None:
    """Return by how much told probability and the part that is right differ, on average over names; None of none."""
    total = sum(entry["total"] for entry in bins)
    off = sum(entry["total"] * abs(entry["probability"] - entry["share"]) for entry in bins)
    return off / total if total else None


def size_as(true: dict[str, Any], found: dict[str, Any]) -> float:
    """Return the size that an effect would have, were it the effect found, of the same class.

    A radius larger by a is as counts a turn fewer by a / (1 + a). Of a wave, the part in the phase found counts.
    """
    size = true["value"]
    if {true["name"], found["name"]} == {"wheel_radius", "counts_per_rev"}:
        size = -size / (1.0 + size)
    if "phase" in true and "phase" in found:
        size *= math.cos(true["phase"] - found["phase"])
    return size


def confusion(trials: Sequence[Trial]) -> dict[str, dict[str, int]]:
    """Return what was hidden against what was said, by names without places, as counts of cases.

    Columns: names, several as "a + b", "another place" for the right ones elsewhere; the verdict where none is named.
    """
    table: dict[str, Counter[str]] = {}
    for trial in trials:
        truth = " + ".join(sorted(name.split()[0] for name in trial.truth)) or "clean"
        said = " + ".join(sorted(name.split()[0] for name in trial.named)) or trial.outcome["verdict"]
        if said == truth and trial.named != trial.truth:
            said += ", another place"
        table.setdefault(truth, Counter())[said] += 1
    return {truth: dict(sorted(row.items())) for truth, row in sorted(table.items())}


def report(folder: str | os.PathLike[str], finder: str = FINDER) -> dict[str, Any]:
    """Return all scores of a finder in a trial as plain data."""
    plan, trials = plan_of(folder), trials_of(folder, finder)
    parts: dict[str, Which] = {
        "clean logs given": lambda trial: trial.label["clean"],
        "no clean logs given": lambda trial: not trial.label["clean"],
        "with a reference": lambda trial: trial.label["reference"],
        "without a reference": lambda trial: not trial.label["reference"],
    }
    groups = {name: [trial for trial in trials if trial.label["robot"] == name] for name in plan.robots}
    groups |= {name: [trial for trial in trials if so(trial)] for name, so in parts.items()}
    return {
        "format": FORMAT,
        "plan": dataclasses.asdict(plan),
        "finder": finder,
        "judged": len(trials),
        "all": _scores(trials),
        "groups": {name: _scores(group) for name, group in groups.items() if group},
        "confusion": confusion(trials),
    }


def lines(scores: dict[str, Any]) -> list[str]:
    """Return the scores of `report` as text."""
    plan = Plan(**scores["plan"])
    done = f"{scores['judged']} of {plan.cases} cases, generator {plan.generator}, seed {plan.seed}"
    text = [f"{done}, finder {scores['finder']}, {len(plan.robots)} robots"]
    for name, group in {"all": scores["all"], **scores["groups"]}.items():
        seconds = group["seconds"]
        text += [
            "",
            f"{name}: {group['cases']} cases, "
            f"{seconds['make']:.1f} s to make and {seconds['judge']:.1f} s to judge each",
        ]
        text += [f"{_counted(rate)}  {rate['what']}" for rate in group["rates"] if rate["total"] or name == "all"]
        if group["reliability"]:
            text.append("told probability against the part that is right, of names:")
        text += [
            f"{_counted(entry)}  {entry['what']}, mean {entry['probability']:.3f}" for entry in group["reliability"]
        ]
        if group["calibration_error"] is not None:
            text.append(f"expected calibration error {group['calibration_error']:.3f}")
    text += ["", "Hidden -> said:"]
    for truth, row in scores["confusion"].items():
        text.append(f"{truth}: " + ", ".join(f"{said} {count}" for said, count in row.items()))
    return text


def as_plain(rate: Rate) -> dict[str, Any]:
    """Return a rate as data for JSON."""
    return dataclasses.asdict(rate) | {"share": rate.share if rate.total else None}


def _scores(trials: Sequence[Trial]) -> dict[str, Any]:
    bins = reliability([entry for trial in trials for entry in trial.told()])
    return {
        "cases": len(trials),
        "rates": [as_plain(rate) for rate in rates(trials)],
        "reliability": bins,
        "calibration_error": calibration_error(bins),
        "seconds": {
            "make": float(np.mean([trial.label["seconds"] for trial in trials])),
            "judge": float(np.mean([trial.outcome["seconds"] for trial in trials])),
        },
    }


def _counted(rate: dict[str, Any]) -> str:
    share = "   -  " if rate["share"] is None else f"{100 * rate['share']:5.1f} %"
    return f"{share} ({rate['count']:3d}/{rate['total']:3d}, {100 * rate['low']:.1f} to {100 * rate['high']:.1f})"
