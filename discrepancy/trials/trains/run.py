"""Trials of trains: cases in pymunk physics, and the answers of the train finder with names and places in words."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log, write_log
from castor_envs.motion.paths import SPEED
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.verdicts import Material
from discrepancy.trains.candidates import Candidate, Placed
from discrepancy.trains.posterior import diagnose_train
from discrepancy.trials.folder import LOGS, Task, name_of
from discrepancy.trials.trains.cases import draw
from discrepancy.trials.trains.simulate import log_at_random

FORMAT = "castor-train-trial-case/1"
STANDING = 0.5
"""m by which a path is shorter than the way at full speed: allows for starting, stopping and whole legs."""

ALL = Material(0.0, 0.0)
"""Materiality in a trial: all sizes matter, however small."""


@dataclasses.dataclass(frozen=True)
class TrainPlan:
    """The settings of a trial (`folder.Settings`). train: a preset's name. duration: of a log, s, roughly."""

    cases: int
    seed: int
    train: str
    duration: float
    answers: ClassVar[str] = ""
    head: ClassVar[dict[str, Any]] = {"format": FORMAT}
    unanswered: ClassVar[dict[str, Any]] = {"named": [], "possible": [], "found": []}

    def beforehand(self, missing: Sequence[int], folder: Path) -> list[Task]:
        """Return no tasks."""
        return []

    def make_case(self, number: int, folder: Path) -> dict[str, Any]:
        """Write the files of a case, and return its label."""
        train, case_folder = load_train(self.train), folder / "cases" / name_of(number)
        case = draw(number, self.seed, train)
        real = train
        for effect in case.hidden:
            real = effect.added(real)
        for file, seed in zip(LOGS, case.seeds, strict=True):
            drive = "servo" if case.drive == "held" else "voltage"
            log = log_at_random(real, seed, SPEED * self.duration - STANDING, drive)
            write_log(case_folder / file, log if case.outside is None else case.outside.changed(train, log), train)
        train.save(case_folder / "train.json")
        hidden = zip(case.hidden, case.thirds, strict=True)
        return {
            "format": FORMAT,
            "case": case.number,
            "stratum": case.stratum,
            "drive": case.drive,
            "seeds": case.seeds,
            "hidden": [_plain(placed, train) | {"third": third} for placed, third in hidden],
            "outside": None if case.outside is None else dataclasses.asdict(case.outside),
        }

    def together(self, number: int) -> str:
        """Return nothing: the finder keeps nothing from case to case."""
        return ""

    def answer(self, name: str, folder: Path) -> dict[str, Any]:
        """Return the finder's answer on a case.

        verdict, reason; named: the named effects; possible: these, and effects of the catalogue in ambiguous or
        unexplained credible sets; found: the named effects as plain data, with standard errors.
        """
        case = folder / "cases" / name
        train = TrainDescription.load(case / "train.json")
        log, held_out = (read_log(case / file, train) for file in LOGS)
        diagnosis = diagnose_train(train, [log], [held_out], material=ALL)
        known = {candidate.what for candidate in diagnosis.before.candidates if candidate.kinds}
        named, possible, found = [], [], []
        for answer in diagnosis.answers:
            if answer.verdict == "named" and isinstance(answer.candidate, Candidate):
                placed = answer.candidate.sized(answer.amplitudes)
                named.append(placed.what(train))
                found.append(_plain(placed, train) | {"error": None if placed.effect.binary else answer.error})
            elif answer.verdict in ("ambiguous", "unexplained"):
                possible += [effect for effect in answer.credible if effect in known]
        return {
            "verdict": diagnosis.verdict,
            "reason": "; ".join(f"{answer.verdict}: {answer.reason}" for answer in diagnosis.answers),
            "named": named,
            "possible": list(dict.fromkeys([*named, *possible])),
            "found": found,
        }


def plan_for(cases: int, generator: str, seed: int, train: str, duration: float) -> TrainPlan:
    """Return the settings of a trial; raises InputError for a generator other than pymunk."""
    if generator != "pymunk":
        raise InputError(f"--generator {generator}: trains have pymunk alone")
    return TrainPlan(cases, seed, train, duration)


def _plain(placed: Placed, train: TrainDescription) -> dict[str, Any]:
    """Return a hidden, or found, effect as plain data; `what`: its name and place, in words."""
    return {"what": placed.what(train), "axle": placed.axle, **dataclasses.asdict(placed.effect)}
