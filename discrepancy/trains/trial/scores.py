"""Scores of the train finder: its answers on cases (`discrepancy.trains.trial.run`) against the hidden effects.

Counts of cases with 95 % Wilson intervals, for wheels that yield to each other and wheels held at speed apart. All
sizes count, however small; a name is wrong if no hidden effect is among those that the finder calls possible.
"""

import dataclasses
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from castor_envs.errors import InputError
from castor_envs.files import read_json
from discrepancy.trains.trial.cases import THIRDS, Drive
from discrepancy.trains.trial.run import plan_of
from discrepancy.trials.finders import QUIET
from discrepancy.trials.scores import NORMAL, Rate, wilson

FORMAT = "castor-train-trial/3"


@dataclasses.dataclass(frozen=True)
class Trial:
    """A judged case: its label (the hidden effects) and its outcome (the finder's answer)."""

    label: dict[str, Any]
    outcome: dict[str, Any]

    @property
    def truth(self) -> set[str]:
        """Names and places of the hidden effects."""
        return {hidden["what"] for hidden in self.label["hidden"]}

    @property
    def exact(self) -> bool:
        """Whether the finder names exactly the hidden effects."""
        return set(self.outcome["named"]) == self.truth and self.outcome["verdict"] in ("named", *QUIET)

    @property
    def in_the_set(self) -> bool:
        """Whether all hidden effects are among the possible effects."""
        return self.truth <= set(self.outcome["possible"])

    @property
    def wrong(self) -> bool:
        """Whether effects are called possible, and none of them was hidden."""
        return bool(self.outcome["possible"]) and not self.truth & set(self.outcome["possible"])

    @property
    def alarm(self) -> bool:
        """Whether the finder reports any discrepancy."""
        return self.outcome["verdict"] not in QUIET

    @property
    def flagged(self) -> bool:
        """Whether the finder reports an unexplained or an ambiguous discrepancy."""
        return self.outcome["verdict"] in ("unexplained", "ambiguous")

    @property
    def extra(self) -> bool:
        """Whether the finder names an effect that was not hidden."""
        return bool(set(self.outcome["named"]) - self.truth)


def trials_of(folder: str | os.PathLike[str]) -> list[Trial]:
    """Return all judged cases of a trial; raises InputError if there are none."""
    folder = Path(folder)
    paths = sorted((folder / "outcomes").glob("case-*.json"))
    if not paths:
        raise InputError(f"{folder}: nothing was found yet; judge the cases first")
    return [Trial(read_json(folder / "labels" / path.name), read_json(path)) for path in paths]


def rates(trials: Sequence[Trial]) -> list[Rate]:
    """Return the rates over these cases."""

    def rate(label: str, cases: Sequence[Trial], so: Callable[[Trial], bool]) -> Rate:
        count = sum(map(so, cases))
        return Rate(label, count, len(cases), *wilson(count, len(cases)))

    clean, single, double, outside = (
        [trial for trial in trials if trial.label["stratum"] == kind] for kind in ("clean", "one", "two", "outside")
    )
    thirds = {third: [trial for trial in single if trial.label["hidden"][0]["third"] == third] for third in THIRDS}
    return [
        rate("clean: an effect named (false positive)", clean, lambda trial: trial.wrong),
        rate("clean: any alarm", clean, lambda trial: trial.alarm),
        rate("one effect: named exactly", single, lambda trial: trial.exact),
        *(rate(f"  of {third} size", cases, lambda trial: trial.exact) for third, cases in thirds.items()),
        rate("one effect: the truth among the names", single, lambda trial: trial.in_the_set),
        rate("one effect: sure of something that is not there", single, lambda trial: trial.extra),
        rate("one effect: a wrong name, the truth not among them", single, lambda trial: trial.wrong),
        rate("two effects: both named exactly", double, lambda trial: trial.exact),
        rate("two effects: sure of something that is not there", double, lambda trial: trial.extra),
        rate("outside the catalogue: flagged", outside, lambda trial: trial.flagged),
        rate("outside the catalogue: a sure name", outside, lambda trial: trial.extra),
        rate("the finder broke down", list(trials), lambda trial: trial.outcome["verdict"] == "broken"),
    ]


def by_effect(trials: Sequence[Trial]) -> list[Rate]:
    """Return for each kind of effect the rate at which it was named exactly where it was hidden alone."""
    counts: dict[str, list[bool]] = {}
    for trial in trials:
        if trial.label["stratum"] == "one":
            counts.setdefault(trial.label["hidden"][0]["name"], []).append(trial.exact)
    return [
        Rate(name, sum(named), len(named), *wilson(sum(named), len(named))) for name, named in sorted(counts.items())
    ]


def coverage(trials: Sequence[Trial]) -> Rate:
    """Return the rate at which the true size of a rightly named effect lies in the 95 % interval."""
    inside = [
        abs(found["value"] - hidden["value"]) <= NORMAL * found["error"]
        for trial in trials
        for hidden in trial.label["hidden"]
        for found in trial.outcome["found"]
        if found["what"] == hidden["what"] and found.get("value") is not None and found["error"]
    ]
    return Rate("true size within the 95 % interval", sum(inside), len(inside), *wilson(sum(inside), len(inside)))


def report(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return all scores of a trial as plain data."""
    trials = trials_of(folder)
    drives: dict[str, Any] = {}
    for drive in get_args(Drive):
        driven = [trial for trial in trials if trial.label["drive"] == drive]
        drives[drive] = {
            "rates": [_plain(rate) for rate in (*rates(driven), coverage(driven))],
            "by_effect": [_plain(rate) for rate in by_effect(driven)],
        }
    verdicts = Counter(f"{trial.label['stratum']}, {trial.outcome['verdict']}" for trial in trials)
    return {
        "format": FORMAT,
        "plan": dataclasses.asdict(plan_of(folder)),
        "judged": len(trials),
        "drives": drives,
        "verdicts": dict(sorted(verdicts.items())),
        "seconds": float(np.mean([trial.outcome["seconds"] for trial in trials])),
    }


def lines(scores: dict[str, Any]) -> list[str]:
    """Return the scores of `report` as text."""
    plan = scores["plan"]
    text = [
        f"{scores['judged']} of {plan['cases']} cases, {plan['train']}, seed {plan['seed']}, {plan['duration']:g} s"
    ]
    for drive, rates_of in scores["drives"].items():
        text += ["", "Wheels that yield to each other:" if drive == "yielding" else "Wheels held at speed:"]
        text += [_counted(rate) for rate in rates_of["rates"]]
        text += ["named exactly, of one effect alone:", *(_counted(rate) for rate in rates_of["by_effect"])]
    text += ["", *(f"{count:4d}  {verdict}" for verdict, count in scores["verdicts"].items())]
    return [*text, "", f"A case takes {scores['seconds']:.1f} s to judge."]


def _plain(rate: Rate) -> dict[str, Any]:
    kept = {name: value for name, value in dataclasses.asdict(rate).items() if name not in ("least", "most")}
    return kept | {"share": rate.share if rate.total else None}


def _counted(rate: dict[str, Any]) -> str:
    share = "   -  " if rate["share"] is None else f"{100 * rate['share']:5.1f} %"
    count = f"{rate['count']:3d}/{rate['total']:3d}, {100 * rate['low']:.0f} to {100 * rate['high']:.0f}"
    return f"{share} ({count})  {rate['what']}"
