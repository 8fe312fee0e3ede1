"""Trials of robots. In addition to what every trial's folder has (`folder`) there are

clean/asoc-prototype/1.csv ...  logs of a robot without any effect, which the finder is also given in some cases
labels/case-0001.npz            the true path of the held-out log
"""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.effects.clocks import SampleJitter
from castor_envs.errors import InputError
from castor_envs.files import read_json, remove_leftovers
from castor_envs.geometry.arrays import Array
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.measurement.fit_states import fit_states
from discrepancy.trials.cases import BOUNDS, Case, hide, motion, setting
from discrepancy.trials.folder import LOGS, Settings, Task, label_file, name_of
from discrepancy.trials.generators import Generator, generator
from discrepancy.trials.hidden import Hidden, Outside, catalogued, class_of, outside_in
from discrepancy.trials.reading import as_recorded
from discrepancy.trials.said import Said, say
from discrepancy.trials.strength.solve_size import Strength, TrialRun, solve_size
from discrepancy.validation.cost import apart, rms_of
from discrepancy.validation.sufficient import redundancy
from estimators.likelihood.creep_prediction import LEAST_NOISE
from estimators.likelihood.log_likelihood import LogLikelihood

DURATION = 60.0
CLEAN = 3
"""Number of clean logs, where there are any."""

ATTEMPTS = 60
"""Most draws of a case's hidden effects until they can have the strength that was drawn."""

OUTSIDE_BELOW = 0.9
"""Largest cosine with a class of the catalogue for an effect to count as outside the catalogue."""

SLACK = 1.1
"""Factor by which a strength may lie outside the bounds of its draw."""


@dataclasses.dataclass(frozen=True)
class Plan(Settings):
    """The settings of a trial of robots."""

    @classmethod
    def of(cls, cases: int, seed: int, generator_name: str, robot: str | None, duration: float) -> "Plan":
        """Return the settings for a preset; None: all whose encoders determine their motion and that the generator can
        drive."""
        return cls(cases, seed, generator_name, robots_for(generator(generator_name), robot), duration)

    def setting(self, number: int) -> Case:
        """Return a case without hidden effects yet."""
        return setting(number, self.seed, self.robots, foreign=generator(self.generator).foreign)

    def beforehand(self, missing: Sequence[int], folder: Path) -> list[Task]:
        """Return the tasks that make clean logs, of robots whose cases have some."""
        (folder / "clean").mkdir(exist_ok=True)
        remove_leftovers(folder / "clean")
        good = {case.robot for case in map(self.setting, missing) if case.clean}
        logs = [(name, k) for name in sorted(good) for k in range(1, CLEAN + 1)]
        return [(_make_clean, (self, *log, folder)) for log in logs if not _clean_log(folder, *log).exists()]

    def make_case(self, number: int, folder: Path) -> dict[str, Any]:
        """Make a case; if no effect can have the z that is drawn, its strength is drawn by cost."""
        begun = self.setting(number)
        for case in dict.fromkeys([begun, dataclasses.replace(begun, measure="cost")]):
            label = _made(self, case, folder)
            if label is not None:
                return label
        raise RuntimeError(f"case {number} could not be had in {ATTEMPTS} attempts")

    def together(self, number: int) -> str:
        """Return the robot of a case: the finder keeps what it computed from clean logs."""
        return self.setting(number).robot

    def answer(self, name: str, folder: Path) -> Said:
        """Return the finder's answer on a case; it is given the case's files and, where the case has them, clean
        logs."""
        label, case = read_json(label_file(folder, name)), folder / "cases" / name
        robot = RobotDescription.load(case / "robot.json")
        log, held_out = (read_log(case / file, robot) for file in LOGS)
        good = _read_clean(folder, label["robot"], label["reference"]) if label["clean"] else {}
        said = say(robot, {LOGS[0]: log}, {LOGS[1]: held_out}, good)
        with np.load(folder / "labels" / f"{name}.npz") as kept:
            return dataclasses.replace(said, gap=_gap(said, robot, held_out, kept["path"]))


def robots_for(source: Generator, robot: str | None = None) -> list[str]:
    """Return the presets that a generator can drive and whose encoders determine their motion, or the given preset.

    Raises InputError if the given preset is not among them.
    """
    found = []
    for name in preset_names() if robot is None else [robot]:
        described = preset(name)
        try:
            redundancy(described)
            course = motion(described, "wander", 0, DURATION)
            source.drive(described, course, 0, duration=2 * described.sample_period)
        except InputError:
            if robot is not None:
                raise
            continue
        found.append(name)
    return found


def _clean_log(folder: Path, robot: str, number: int) -> Path:
    return folder / "clean" / robot / f"{number}.csv"


def _make_clean(plan: Plan, name: str, number: int, folder: Path) -> None:
    robot, seed = preset(name), 10**12 + 1000 * plan.seed + number  # beyond those of cases
    course = motion(robot, "wander", seed, plan.duration)
    log = generator(plan.generator).drive(robot, course, seed, duration=plan.duration)
    path = _clean_log(folder, name, number)
    path.parent.mkdir(exist_ok=True)
    write_log(path, log, robot)


def _made(plan: Plan, begun: Case, folder: Path) -> dict[str, Any] | None:
    """Write the files of a case and return its label; None if no attempt meets the requirements."""
    source = generator(plan.generator)
    first = TrialRun(begun, 0, source, plan.duration)
    trial_runs = [first, TrialRun(begun, 1, source, plan.duration, like=first)]
    for attempt in range(ATTEMPTS):
        case = solve_size(hide(begun, attempt, plan.seed, source.outsiders), first)
        if case is None:
            continue
        try:
            strengths = _strengths(case, trial_runs)
            if strengths is None:
                continue
            logs = [trial_run.drive(*case.hidden) for trial_run in trial_runs]
            path = trial_runs[1].drive(*(hidden for hidden in case.hidden if not _of_reference(hidden))).reference
            assert path is not None  # exact logs have a pose in every row
            _write_files(case, logs, path, folder)
        except (InputError, ValueError, ArithmeticError):
            continue
        return _label(case, strengths) | {"attempts": attempt + 1}
    return None


def _strengths(case: Case, trial_runs: list[TrialRun]) -> list[Strength] | None:
    """Return the strengths of the hidden effects in both logs; None where they miss the case's requirements."""
    if not case.hidden:
        return []
    first = trial_runs[0].strength(case.hidden)
    low, high = BOUNDS[case.measure]
    if case.measure == "z" and len(case.hidden) > 1:
        low = 1e-9  # much of an effect may be projected out with the others
    measured = first.cost if case.measure == "cost" else first.z
    sized = all(item.wiring or low / SLACK <= m <= high * SLACK for item, m in zip(case.hidden, measured, strict=True))
    if not sized or (outside_in(case.hidden) is not None and (first.cosine is None or first.cosine >= OUTSIDE_BELOW)):
        return None
    return [first, trial_runs[1].strength(case.hidden)]


def _write_files(case: Case, logs: list[Log], path: Array, folder: Path) -> None:
    """Write a case's logs, and the true path (K, 3) of the second, which is for the score."""
    robot, name = preset(case.robot), name_of(case.number)
    real, case_folder = robot.with_effects(*catalogued(case.hidden)), folder / "cases" / name
    for file, exact, seed in zip(LOGS, logs, case.seeds, strict=True):
        log = as_recorded(real, exact, np.random.default_rng([seed, 4]))
        write_log(case_folder / file, log if case.reference else dataclasses.replace(log, reference=None), robot)
    robot.save(case_folder / "robot.json")
    np.savez_compressed(folder / "labels" / f"{name}.npz", path=path)


def _of_reference(hidden: Hidden) -> bool:
    """Whether an effect of the catalogue changes when or where the reference sees the robot, which moves as without."""
    if isinstance(hidden, Outside):
        return False
    t, pose = np.arange(3.0), np.arange(9.0).reshape(3, 3)
    return not (np.array_equal(hidden.reference_time(t), t) and np.array_equal(hidden.reference_pose(pose), pose))


def _label(case: Case, strengths: list[Strength]) -> dict[str, Any]:
    kept = ("stratum", "robot", "course", "seeds", "clean", "reference", "measure", "targets")
    log, holdout = (dataclasses.asdict(strength) for strength in strengths) if strengths else (None, None)
    return {
        **{key: getattr(case, key) for key in kept},
        "hidden": [_hidden(hidden) for hidden in case.hidden],
        "log": log,
        "holdout": holdout,
    }


def _hidden(hidden: Hidden) -> dict[str, Any]:
    kind = "outside" if isinstance(hidden, Outside) else "wiring" if hidden.wiring else "catalogue"
    return {"class": class_of(hidden), "from": kind, "what": dataclasses.asdict(hidden)}


def _gap(said: Said, robot: RobotDescription, held_out: Log, path: Array) -> dict[str, float] | None:
    """Return how far the most likely path by the encoders of the held-out log is off the true one, m per 10 m, without
    and with the named effects; None where no effect was named, or an encoder is connected wrongly.

    Jitter is left out: undoing it would need the times that it drew.
    """
    if not said.effects or any(effect.wiring for effect in said.effects):
        return None
    real = robot.with_effects(*(effect for effect in said.effects if not isinstance(effect, SampleJitter)))
    blind = dataclasses.replace(held_out, reference=None)
    off = []
    for vehicle in (robot, real):
        model = LogLikelihood(Geometry.of(vehicle.as_built()), blind)
        at, *_ = fit_states(vehicle, [model], [blind], None, None, LEAST_NOISE)
        off.append(rms_of([apart(path, at.states[0][:, :3])]))
    before, after = off
    return None if before is None or after is None else {"before": before, "after": after}


@lru_cache(maxsize=1)
def _read_clean(folder: Path, name: str, reference: bool) -> dict[str, Log]:
    """Return the clean logs of a robot, which many cases share; without reference if the logs of the case have none."""
    robot = preset(name)
    logs = {f"clean/{k}.csv": read_log(_clean_log(folder, name, k), robot) for k in range(1, CLEAN + 1)}
    return logs if reference else {key: dataclasses.replace(log, reference=None) for key, log in logs.items()}
