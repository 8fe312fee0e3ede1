"""Scores of a trial: how often diagnoses are right, from what was found (`run`) and what was hidden.

Every score is a count of cases with its 95 % Wilson interval. Effects that no log can distinguish count as the same
class. Cases whose effect has z below `STRONG` in the held-out log do not count, as that log could not confirm it.
A diagnosis is wrong (a false positive) if it names or lists effects, and what was hidden is not among them.
"""

import dataclasses
import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from castor_envs.effects.catalogue import EFFECTS
from castor_envs.errors import InputError
from castor_envs.files import read_json
from discrepancy.trials.run import Plan, plan_of
from discrepancy.trials.strength.separation import JITTER

FORMAT = "castor-trial/2"

STRONG, SEPARATE, STRONG_OF_TWO, LOUD, JITTERY = 8.0, 5.0, 10.0, 20.0, 10.0
"""z of one effect, z_sep, the weaker z of two, z to be flagged at outside of the catalogue, and z of jitter."""

NORMAL = 1.959964
"""Standard deviations to either side of a 95 % interval."""


@dataclass(frozen=True)
class Trial:
    """A case after the labels are open: what was hidden in it, what was said of it, and what is left."""

    label: dict[str, Any]
    outcome: dict[str, Any]
    left: dict[str, Any]

    @property
    def stratum(self) -> str:
        """Of the case."""
        return self.label["stratum"]

    @property
    def truth(self) -> tuple[str, ...]:
        """The classes of what was hidden."""
        return tuple(hidden["class"] for hidden in self.label["hidden"])

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the effects hidden, whose classes know castors and wheels besides."""
        return tuple(hidden["what"].get("name", hidden["class"]) for hidden in self.label["hidden"])

    @property
    def named(self) -> tuple[str, ...]:
        """The classes that the finder is sure of."""
        return tuple(self.outcome["named"])

    @property
    def possible(self) -> tuple[str, ...]:
        """The classes that the finder says it may be."""
        return tuple(self.outcome["possible"])

    @property
    def flagged(self) -> bool:
        """Whether the finder says that nothing it knows may be it."""
        return self.outcome["verdict"] == "unexplained" or bool(self.outcome["unnamed_rival"])

    @property
    def z(self) -> float:
        """The least z of what was hidden in the log; infinite where there is nothing."""
        return min(self.label["log"]["z"], default=math.inf) if self.label["log"] else math.inf

    @property
    def z_held_out(self) -> float:
        """The least z in the held-out log."""
        return min(self.label["holdout"]["z"], default=math.inf) if self.label["holdout"] else math.inf

    @property
    def z_sep(self) -> float:
        """The least z_sep in the log."""
        return min(self.label["log"]["z_sep"], default=math.inf) if self.label["log"] else math.inf

    @property
    def wiring(self) -> bool:
        """Whether encoders were swapped or reversed."""
        return any(name in EFFECTS and EFFECTS[name].wiring for name in self.names)


@dataclass(frozen=True)
class Rate:
    """Of `total` cases, `count` are so. low, high: the 95 % Wilson interval.

    least, most: what is to be reached with the own and with the foreign simulator; None where it is only reported.
    """

    what: str
    count: int
    total: int
    low: float
    high: float
    least: tuple[float, float] | None = None
    most: tuple[float, float] | None = None

    @property
    def share(self) -> float:
        """count / total; NaN of no cases."""
        return self.count / self.total if self.total else math.nan

    def reached(self, foreign: bool) -> bool | None:
        """Whether the share is what it has to be; None where nothing is asked or nothing is known."""
        if not self.total:
            return None
        if self.least is not None:
            return self.share >= self.least[foreign]
        return self.share <= self.most[foreign] if self.most is not None else None


def wilson(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a share; (0, 1) of no cases."""
    if not total:
        return 0.0, 1.0
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def trials_of(folder: str | os.PathLike[str]) -> list[Trial]:
    """Return all cases of a trial of which the finder has spoken; raises InputError if there are none."""
    folder = Path(folder)
    found = []
    for path in sorted((folder / "outcomes").glob("case-*.json")):
        left = folder / "left" / path.name
        label, outcome = (read_json(file) for file in (folder / "labels" / path.name, path))
        after = read_json(left) if left.exists() else {"left": None}
        found.append(Trial(label, outcome, after))
    if not found:
        raise InputError(f"{folder}: nothing was found yet; judge the cases first")
    return found


def rates(trials: Sequence[Trial]) -> list[Rate]:
    """Return all rates that are asked for, and some more."""

    def among(*strata: str, strong: float = 0.0, separate: float = 0.0) -> list[Trial]:
        """Cases of some strata, wiring left out, with z of at least `strong` in both logs."""
        held_out = min(strong, STRONG)
        return [
            trial
            for trial in trials
            if trial.stratum in strata
            and not trial.wiring
            and trial.z >= strong
            and trial.z_held_out >= held_out
            and trial.z_sep >= separate
        ]

    def rate(what: str, cases: Sequence[Trial], so: Callable[[Trial], bool], **asked: tuple[float, float]) -> Rate:
        count = sum(map(so, cases))
        return Rate(what, count, len(cases), *wilson(count, len(cases)), **asked)

    single, poor = among("one", "large", strong=STRONG), among("poor", strong=STRONG)
    jitter = [trial for trial in among("one", "large", strong=JITTERY) if JITTER in trial.names]
    wired = [trial for trial in trials if trial.wiring]
    return [
        rate(
            f"one effect, z >= {STRONG:g}, z_sep >= {SEPARATE:g}: named exactly",
            among("one", "large", strong=STRONG, separate=SEPARATE),
            _exact,
            least=(0.97, 0.85),
        ),
        rate(f"one effect, z >= {STRONG:g}: the truth among the names", single, _in_the_set, least=(0.99, 0.92)),
        rate(f"one effect, z >= {STRONG:g}: a wrong name, the truth not among them", single, _wrong, most=(0.01, 0.02)),
        rate(
            "clean: an effect named (false positive)",
            among("clean"),
            lambda trial: bool(trial.possible),
            most=(0.01, 0.05),
        ),
        rate(
            f"two effects, the weaker z >= {STRONG_OF_TWO:g}: both named exactly",
            among("two", strong=STRONG_OF_TWO),
            _exact,
            least=(0.88, 0.0),
        ),
        rate("outside the catalogue: a name said to be sure", among("outside"), _sure, most=(0.03, 0.05)),
        rate(
            f"outside the catalogue, z >= {LOUD:g}: flagged",
            [trial for trial in among("outside") if trial.z >= LOUD],
            lambda trial: trial.flagged,
            least=(0.90, 0.80),
        ),
        rate(f"jitter, z >= {JITTERY:g}: found", jitter, _exact, least=(0.80, 0.80)),
        rate(f"poor motion, z >= {STRONG:g}: named exactly", poor, _exact),
        rate(f"poor motion, z >= {STRONG:g}: a wrong name, the truth not among them", poor, _wrong),
        rate("wiring gone wrong: found, or refused with a reason", wired, _wired),
        rate(
            "the finder broke down", list(trials), lambda trial: trial.outcome["verdict"] == "broken", most=(0.0, 0.0)
        ),
    ]


def signal_left(trials: Sequence[Trial]) -> tuple[float, int]:
    """Return the median part of the held-out signal of one effect that the robot found leaves, and of how many cases.

    Where nothing was named, all of it is left. Jitter has no signal.
    """
    left = [
        trial.left["left"]
        for trial in trials
        if trial.stratum in ("one", "large")
        and not trial.wiring
        and min(trial.z, trial.z_held_out) >= STRONG
        and trial.left["left"] is not None
        and JITTER not in trial.names
    ]
    return (float(np.median(left)), len(left)) if left else (math.nan, 0)


def coverage(trials: Sequence[Trial]) -> dict[str, Rate]:
    """Return for each effect how often its true size lies in the 95 % interval of the one named at its place."""
    inside: dict[str, list[bool]] = {}
    for trial in trials:
        for hidden in trial.label["hidden"]:
            for found in trial.outcome["found"]:
                if hidden["from"] != "catalogue" or found["error"] is None or found["class"] != hidden["class"]:
                    continue
                true = size_as(hidden["what"], found["effect"])
                covered = abs(found["effect"]["value"] - true) <= NORMAL * found["error"]
                inside.setdefault(hidden["what"]["name"], []).append(covered)
    return {
        name: Rate(name, sum(hits), len(hits), *wilson(sum(hits), len(hits))) for name, hits in sorted(inside.items())
    }


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
        truth = " + ".join(sorted(_name(hidden_class) for hidden_class in trial.truth)) or "clean"
        said = " + ".join(sorted(_name(hidden_class) for hidden_class in trial.named)) or trial.outcome["verdict"]
        if said == truth and sorted(trial.named) != sorted(trial.truth):
            said += ", another place"
        table.setdefault(truth, Counter())[said] += 1
    return {truth: dict(sorted(row.items())) for truth, row in sorted(table.items())}


def report(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return all scores of a trial as plain data."""
    plan, trials = plan_of(folder), trials_of(folder)
    foreign = plan.generator != "pymunk"
    left, of = signal_left(trials)
    return {
        "format": FORMAT,
        "plan": dataclasses.asdict(plan),
        "judged": len(trials),
        "rates": [_plain(rate) | {"reached": rate.reached(foreign)} for rate in rates(trials)],
        "held_out_signal_left": {"median": None if math.isnan(left) else left, "cases": of, "most": 0.2},
        "coverage": [_plain(rate) for rate in coverage(trials).values()],
        "confusion": confusion(trials),
        "seconds": {
            "make": float(np.mean([trial.label["seconds"] for trial in trials])),
            "judge": float(np.mean([trial.outcome["seconds"] for trial in trials])),
        },
    }


def lines(scores: dict[str, Any]) -> list[str]:
    """Return the scores of `report` as text."""
    plan, foreign = Plan(**scores["plan"]), scores["plan"]["generator"] != "pymunk"
    text = [f"{scores['judged']} of {plan.cases} cases, generator {plan.generator}, seed {plan.seed}, {plan.robot}", ""]
    for rate in scores["rates"]:
        asked = rate["least"] or rate["most"]
        bound = "" if asked is None else f"   asked: {'>=' if rate['least'] else '<='} {100 * asked[foreign]:g} %"
        text.append(f"{_counted(rate)}  {rate['what']}{bound}{_mark(rate['reached'])}")
    left = scores["held_out_signal_left"]
    if left["median"] is not None:
        mark = _mark(left["median"] <= left["most"])
        what = f"median part of the held-out signal left, {left['cases']} cases   asked: <= 0.2"
        text.append(f"{left['median']:.2f}  {what}{mark}")
    text += ["", "True size within the 95 % interval:"]
    text += [f"{_counted(rate)}  {rate['what']}" for rate in scores["coverage"]]
    text += ["", "Hidden -> said:"]
    for truth, row in scores["confusion"].items():
        text.append(f"{truth}: " + ", ".join(f"{said} {count}" for said, count in row.items()))
    each = scores["seconds"]
    text += ["", f"A case takes {each['make']:.1f} s to make and {each['judge']:.1f} s to judge."]
    return text


def _exact(trial: Trial) -> bool:
    return sorted(trial.named) == sorted(trial.truth) and not trial.flagged


def _in_the_set(trial: Trial) -> bool:
    return set(trial.truth) <= set(trial.possible)


def _wrong(trial: Trial) -> bool:
    return bool(trial.possible) and not set(trial.truth) & set(trial.possible)


def _sure(trial: Trial) -> bool:
    return bool(trial.named)


def _wired(trial: Trial) -> bool:
    return _exact(trial) or trial.outcome["verdict"] == "refused"


def _name(label: str) -> str:
    return label.split()[0]


def _plain(rate: Rate) -> dict[str, Any]:
    return dataclasses.asdict(rate) | {"share": None if not rate.total else rate.share}


def _counted(rate: dict[str, Any]) -> str:
    share = "   -  " if rate["share"] is None else f"{100 * rate['share']:5.1f} %"
    return f"{share} ({rate['count']:3d}/{rate['total']:3d}, {100 * rate['low']:.1f} to {100 * rate['high']:.1f})"


def _mark(reached: bool | None) -> str:
    return "" if reached is None else ", reached" if reached else ", NOT reached"
