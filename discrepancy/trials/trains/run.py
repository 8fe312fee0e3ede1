"""Trials of trains: cases in pymunk physics, and the answers of the train finder, whose classes are names and places.

The cost of hidden effects is that of the train's localisation. It, z and z_sep come from the finder's own equations
(`discrepancy.trains.linearise`), about the motion with the effects in the model, which the finder does not know.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.motion.paths import SPEED
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.answers import Answer
from discrepancy.trains.candidates import Candidate, named_candidates
from discrepancy.trains.examine import examined
from discrepancy.trains.linearise import linearise
from discrepancy.trains.posterior import diagnose_train
from discrepancy.trials.folder import LOGS, Settings, name_of
from discrepancy.trials.said import Said, Single, Size, report, size_of
from discrepancy.trials.trains.cases import draw
from discrepancy.trials.trains.simulate import log_at_random
from estimators.likelihood.statistics import IN_ANY_UNITS, pseudo_inverse
from estimators.likelihood.trains.states import equations_of

STANDING = 0.5
"""m by which a path is shorter than the way at full speed: allows for starting, stopping and whole legs."""


@dataclasses.dataclass(frozen=True)
class TrainPlan(Settings):
    """The settings of a trial of one train; logs have roughly the duration."""

    def __post_init__(self) -> None:
        if self.generator != "pymunk":
            raise InputError(f"--generator {self.generator}: trains have pymunk alone")

    def make_case(self, number: int, folder: Path) -> dict[str, Any]:
        """Write the files of a case, and return its label."""
        (name,) = self.robots
        train, case_folder = load_train(name), folder / "cases" / name_of(number)
        case = draw(number, self.seed, train)
        real = train
        for candidate in case.hidden:
            real = candidate.added(real, _amplitude(candidate))
        drive = "servo" if case.drive == "held" else "voltage"
        logs = [log_at_random(real, seed, SPEED * self.duration - STANDING, drive) for seed in case.seeds]
        if case.outside is not None:
            logs = [case.outside.changed(train, log) for log in logs]
        for file, log in zip(LOGS, logs, strict=True):
            write_log(case_folder / file, log, train)
        train.save(case_folder / "train.json")
        hidden = [
            {"class": candidate.what, "from": "catalogue", "what": dataclasses.asdict(effect)}
            for candidate in case.hidden
            for effect in candidate.kinds
        ]
        if case.outside is not None:
            what = dataclasses.asdict(case.outside)
            hidden.append({"class": case.outside.name, "from": "outside", "what": what})
        return {
            "stratum": case.stratum,
            "robot": name,
            "drive": case.drive,
            "seeds": case.seeds,
            "clean": False,
            "reference": True,
            "hidden": hidden,
            "log": strength_of(real, logs[0], case.hidden),
            "holdout": strength_of(real, logs[1], case.hidden),
        }

    def answer(self, name: str, folder: Path) -> Said:
        """Return the finder's answer on a case. The report is made, too (see `said.say`)."""
        case = folder / "cases" / name
        train = TrainDescription.load(case / "train.json")
        log, held_out = (read_log(case / file, train) for file in LOGS)
        diagnosis = diagnose_train(train, [log], [held_out])
        report(examined(train, diagnosis, {LOGS[0]: log}, {LOGS[1]: held_out}, {}))
        known = {candidate.what for candidate in diagnosis.before.candidates if candidate.kinds}
        singles = [
            Single.of(answer, lambda name: name if name in known else None, _size(answer))
            for answer in diagnosis.answers
        ]
        return Said.of(singles, "; ".join(f"{answer.verdict}: {answer.reason}" for answer in diagnosis.answers))


def strength_of(real: TrainDescription, log: Log, hidden: Sequence[Candidate]) -> dict[str, list[Any]]:
    """Return the costs of ignoring each hidden effect of the catalogue, m per 10 m, z, z_sep, and what is nearest; of
    several effects apart from each other. real: the train with them."""
    if not hidden:
        return {"cost": [], "z": [], "z_sep": [], "nearest": []}
    known = {candidate.what for candidate in hidden}
    others = [other for other in named_candidates(real) if other.what not in known]
    seen, count = linearise(real, *equations_of(real, [log]), [*hidden, *others]), len(hidden)
    sizes = np.array([_amplitude(candidate)[0] for candidate in hidden])
    scale = np.concatenate([sizes, np.ones(len(others))])
    signals = seen.logs[0].information * np.outer(scale, scale)
    z, z_sep, nearest = [], [], []
    for k in range(count):
        beside = [j for j in range(count) if j != k]
        apart = [_apart(signals, k, [*beside, count + j]) for j in range(len(others))]
        z.append(_apart(signals, k, beside))
        z_sep.append(min(apart))
        nearest.append(others[int(np.argmin(apart))].what)
    cost = np.abs(seen.cost[0][:count] * sizes).tolist()
    return {"cost": cost, "z": z, "z_sep": z_sep, "nearest": nearest}


def _apart(information: Array, k: int, others: list[int]) -> float:
    """Return the length of a signal less its projection on others, by the products of all of them."""
    of_others = pseudo_inverse(information[np.ix_(others, others)], IN_ANY_UNITS)
    left = information[k, k] - information[k, others] @ of_others @ information[others, k]
    return float(np.sqrt(max(left, 0.0)))


def _amplitude(candidate: Candidate) -> list[float]:
    return [kind.value for kind in candidate.kinds]


def _size(answer: Answer) -> Size | None:
    effect, cost = answer.effect, abs(answer.size) * float(answer.cost[0])
    return None if effect is None else size_of(answer.candidate.family, effect, answer, cost)
